"""What all generators share: one gmsh model per mesh, size fields, groups, checks, writing.

A generator opens a model, draws its bodies (never fragmented, so that two bodies never share a node), names
its groups and calls `finish`, which meshes, raises the degree, checks every cell and writes a binary MSH
4.1 file.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import gmsh
import numpy as np

logger = logging.getLogger(__name__)

CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
ALIGNED = ("quadrilateral", "hexahedron")

_OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.MaxNumThreads1D": 1,
    "Mesh.MaxNumThreads2D": 1,
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.MshFileVersion": 4.1,
    "Mesh.Binary": 1,
    "Mesh.SaveAll": 0,
    "Mesh.SecondOrderIncomplete": 0,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.Algorithm3D": 10,
    "Geometry.AutoCoherence": 0,
}


@contextmanager
def gmsh_model(name: str) -> Iterator[None]:
    """Open gmsh with fixed options (one thread, silent, no user configuration) and close it whatever happens.

    Raises
    ------
    RuntimeError
        When gmsh is already open in this process: its options would not be the fixed ones.
    """
    if gmsh.isInitialized():
        raise RuntimeError(f"mesh '{name}': gmsh is already open in this process; finalise it first")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        for key, value in _OPTIONS.items():
            gmsh.option.setNumber(key, value)
        gmsh.model.add(name)
        yield
    finally:
        gmsh.finalize()


def check_cell(name: str, cell: str, dim: int, order: int) -> None:
    """Raise ValueError unless `cell` is a cell of dimension `dim` and `order` is 1 or 2."""
    if cell not in CELLS.get(dim, ()):
        raise ValueError(
            f"mesh '{name}': cell '{cell}' in dimension {dim}; allowed: {', '.join(CELLS.get(dim, ()))}"
        )
    if order not in (1, 2):
        raise ValueError(f"mesh '{name}': order {order}; allowed: 1, 2")


def check_choice(name: str, key: str, value: object, allowed: Sequence[object]) -> None:
    """Raise ValueError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ValueError(f"mesh '{name}': {key} '{value}'; allowed: {', '.join(map(str, allowed))}")


def group(dim: int, name: str, tags: Iterable[int]) -> None:
    """Name the entities `tags` (signs are ignored) of dimension `dim`; no tags, no group."""
    found = sorted({abs(tag) for tag in tags})
    if found:
        gmsh.model.addPhysicalGroup(dim, found, name=name)


def point_size_field(point: int, near: float, far: float, radius: float, growth: float) -> int:
    """Size field: `near` within `radius` of a point, then growing by `growth` per unit length up to `far`."""
    distance = gmsh.model.mesh.field.add("Distance")
    gmsh.model.mesh.field.setNumbers(distance, "PointsList", [point])
    field = gmsh.model.mesh.field.add("Threshold")
    far = max(far, near * (1 + 1e-12))
    values = {
        "InField": distance,
        "SizeMin": near,
        "SizeMax": far,
        "DistMin": radius,
        "DistMax": radius + (far - near) / growth,
    }
    for key, value in values.items():
        gmsh.model.mesh.field.setNumber(field, key, value)
    return field


def restrict_field(field: int, dim: int, tags: Sequence[int]) -> int:
    """Restrict a size field to the entities `tags` and their boundary; the new field's tag."""
    restricted = gmsh.model.mesh.field.add("Restrict")
    gmsh.model.mesh.field.setNumber(restricted, "InField", field)
    gmsh.model.mesh.field.setNumbers(restricted, {2: "SurfacesList", 3: "VolumesList"}[dim], list(tags))
    return restricted


def use_fields(fields: Sequence[int]) -> None:
    """Let the smallest of the size fields decide."""
    smallest = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(smallest, "FieldsList", list(fields))
    gmsh.model.mesh.field.setAsBackgroundMesh(smallest)


def unstructured(cell: str) -> None:
    """Choose the algorithms for unstructured cells of this kind.

    Quadrilaterals: triangles of twice the size are joined in pairs where that gives good cells, then every
    cell is halved, so that no triangle is left and no corner of a cell is flat (a flat corner degenerates
    when its edges are curved).
    """
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    if cell in ALIGNED:
        for key, value in {
            "Mesh.RecombineAll": 1,
            "Mesh.RecombinationAlgorithm": 1,
            "Mesh.RecombineMinimumQuality": 0.3,
            "Mesh.SubdivisionAlgorithm": 1,
            "Mesh.Smoothing": 5,
            "Mesh.MeshSizeFactor": 2,
        }.items():
            gmsh.option.setNumber(key, value)


def generate(dim: int, order: int) -> None:
    """Mesh the model and raise its degree; the nodes of degree 2 lie on the geometry."""
    gmsh.model.mesh.generate(dim)
    if order > 1:
        gmsh.model.mesh.setOrder(order)


def node_count() -> int:
    """Nodes of the current mesh that belong to cells, facets or edges (lone points do not count)."""
    types, _, nodes = gmsh.model.mesh.getElements(gmsh.model.getDimension())
    return int(np.unique(np.concatenate(nodes)).size) if len(types) else 0


def cells() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield gmsh's type name, element tags (n,) and node tags (n, nodes) of every kind of cell."""
    types, tags, nodes = gmsh.model.mesh.getElements(gmsh.model.getDimension())
    for kind, tag, node in zip(types, tags, nodes, strict=True):
        name, _, _, count, _, _ = gmsh.model.mesh.getElementProperties(kind)
        yield name, np.asarray(tag), np.asarray(node).reshape(-1, count)


def move_nodes(move: Callable[[np.ndarray, tuple[int, int]], np.ndarray]) -> None:
    """Replace the node positions x (n, 3) of every entity (dim, tag) by `move(x, entity)`; the cells stay.

    gmsh moves single nodes only, so the mesh is taken out and put back entity by entity.
    """
    entities = gmsh.model.getEntities()
    nodes = [gmsh.model.mesh.getNodes(*entity)[:2] for entity in entities]
    elements = [gmsh.model.mesh.getElements(*entity) for entity in entities]
    gmsh.model.mesh.clear()
    for entity, (tags, points) in zip(entities, nodes, strict=True):
        gmsh.model.mesh.addNodes(*entity, tags, move(np.reshape(points, (-1, 3)), entity).ravel())
    for entity, element in zip(entities, elements, strict=True):
        gmsh.model.mesh.addElements(*entity, *element)


def smallest_jacobian() -> float:
    """Smallest Jacobian determinant of all cells (signed: negative where a 2D cell runs clockwise)."""
    dim, smallest = gmsh.model.getDimension(), np.inf
    for kind in gmsh.model.mesh.getElementTypes(dim):
        name, _, order, *_ = gmsh.model.mesh.getElementProperties(kind)
        points, _ = gmsh.model.mesh.getIntegrationPoints(kind, f"CompositeGauss{2 * order + 1}")
        jacobians, determinants, _ = gmsh.model.mesh.getJacobians(kind, points)
        # gmsh's determinant of a surface cell is an area without sign; the cross product has the sign.
        j = np.reshape(jacobians, (-1, 9))
        signed = j[:, 0] * j[:, 4] - j[:, 1] * j[:, 3] if dim == 2 else np.asarray(determinants)
        smallest = min(smallest, float(signed.min()))
    return smallest


def finish(path: str | Path, dim: int, order: int) -> Path:
    """Mesh, check and write; see `generate` and `write`."""
    generate(dim, order)
    return write(path)


def write(path: str | Path) -> Path:
    """Check the current mesh and write it to `path` (binary MSH 4.1, the named groups only).

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    RuntimeError
        When a cell is turned inside out.
    """
    path = Path(path)
    smallest = smallest_jacobian()
    if not smallest > 0:
        raise RuntimeError(
            f"{path}: a cell is turned inside out (smallest Jacobian {smallest:.3g}); take a smaller size h"
        )
    gmsh.write(str(path))
    count = {name: len(tags) for name, tags, _ in cells()}
    logger.info("%s: %d nodes, %s", path, node_count(), ", ".join(f"{n} {name}" for name, n in count.items()))
    return path
