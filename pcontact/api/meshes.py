"""Meshes from memory: arrays, meshio, pyvista, a model of gmsh."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, facet_kinds, facet_nodes
from pcontact.io.vtu import CELL_NAMES
from pcontact.mesh.plex_reader import LOWER, Tables, read_plex
from pcontact.mesh.raw import KINDS
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.scene import MeshSpec

_folder: list[Path] = []
_KINDS = {2: "line", 3: "triangle", 4: "quad"}


def mesh_from(
    source: Any,
    groups: Mapping[str, Any] | None = None,
    facets: Mapping[str, Any] | None = None,
    **keys: Any,
) -> MeshSpec:
    """The mesh of a scene, from a file or from memory.

    Parameters
    ----------
    source : str, pathlib.Path, meshio.Mesh, pyvista dataset, PETSc.DMPlex, the module gmsh, or (points, cells)
        Of a DMPlex (or what has one as ``topology_dm``, as Firedrake's meshes), with faces or without, on any number of
        ranks, the labels are the groups; *collective* then. Of gmsh, its current model with its physical groups; of
        arrays, points (n, d) and a dict from types of cells as
        meshio calls them to nodes (nc, nn) in VTK's order. Cells and groups (cell sets) of meshio are kept.
    groups : dict, optional
        Further groups of cells: numbers (k,) or a mask (n_cells,) over all cells, block after block; "all" names them
        all.
    facets : dict, optional
        Further groups of facets: their corners (k, 2 to 4) as rows of the points, or a function of points (n, d) that
        says (n,) which of them are on it: facets of the boundary with all corners there belong to it.
    **keys
        Other keys of ``[mesh]``: `order`, `kinematics`, `strain`, ...

    Returns
    -------
    pcontact.scene.MeshSpec

    Raises
    ------
    InputError
        It is nothing of these, or a group has no facets.
    """
    if isinstance(source, MeshSpec):
        return source
    if isinstance(source, (str, Path)) and not groups and not facets:
        return MeshSpec(file=source, **keys)
    return MeshSpec(file=_written(source, groups or {}, facets or {}), **keys)


def own_folder() -> Path:
    """A new directory of this process's own, that goes when it ends."""
    if not _folder:
        _folder.append(Path(tempfile.mkdtemp(prefix="pcontact_")))
        atexit.register(shutil.rmtree, _folder[0], ignore_errors=True)
    return Path(tempfile.mkdtemp(dir=_folder[0]))


def _place() -> Path:
    """A file of this process's own, that goes when it ends."""
    return own_folder() / "mesh.msh"


def _written(source: Any, groups: Mapping[str, Any], facets: Mapping[str, Any]) -> Path:
    path = _place()
    if getattr(source, "__name__", "") == "gmsh" and not groups and not facets:
        source.option.setNumber("Mesh.MshFileVersion", 4.1)
        source.write(str(path))
        return path
    try:
        import meshio
    except ModuleNotFoundError as error:
        raise InputError(f"mesh_from: needs the Python package {error.name!r}; allowed: pip install meshio") from None

    source = getattr(source, "topology_dm", source)
    if not hasattr(source, "getHeightStratum"):
        _fill(path, (*_parts(source, meshio), []), groups, facets)
        return path
    tables, comm = read_plex(source), source.comm.tompi4py()
    on_root(comm, lambda: _fill(path, _of_plex(tables), groups, facets))
    return comm.bcast(path)


def _of_plex(
    tables: Tables,
) -> tuple[np.ndarray, list[tuple[str, np.ndarray]], dict[str, list[np.ndarray]], list[tuple[str, str, np.ndarray]]]:
    """Points, blocks, groups of cells, and facets, edges and nodes of groups of a DMPlex."""
    blocks = [(MESHIO_NAMES[kind, 1], nodes) for kind, nodes in tables.cells.items()]
    none = np.zeros(0, dtype=np.int64)
    named = {name: [rows.get(kind, none) for kind in tables.cells] for name, rows in tables.cell_groups.items()}
    lower = [(name, LOWER[rows.shape[1]][0], rows) for name, parts in tables.lower_groups.items() for rows in parts]
    return _solid(tables.points), blocks, named, lower


def _fill(path: Path, parts: tuple, groups: Mapping[str, Any], facets: Mapping[str, Any]) -> None:
    """Write a file of points (n, 3), blocks, groups of cells, and further entries, with the groups that are added."""
    import meshio

    points, blocks, named, entries = parts
    solid = any(_dim(kind) == 3 for kind, _ in blocks)
    flat = points if solid or np.ptp(points[:, 2]) else points[:, :2]
    ends = np.cumsum([0, *(len(nodes) for _, nodes in blocks)])
    for name, chosen in groups.items():
        rows = np.arange(ends[-1]) if isinstance(chosen, str) and chosen == "all" else np.asarray(chosen)
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        named[name] = [rows[(rows >= a) & (rows < b)] - a for a, b in zip(ends[:-1], ends[1:], strict=True)]
    entries = [(name, kind, nodes[rows]) for name, parts in named.items()
               for (kind, nodes), rows in zip(blocks, parts, strict=True) if len(rows)] + entries  # fmt: skip
    for name, chosen in facets.items():
        entries += [(name, kind, nodes) for kind, nodes in _facets(name, chosen, flat, blocks)]
    taken = [np.isin(np.arange(len(nodes)), np.concatenate([np.zeros(0, int), *(parts[k] for parts in named.values())]))
             for k, (_, nodes) in enumerate(blocks)]  # fmt: skip
    entries += [("", kind, nodes[~own]) for (kind, nodes), own in zip(blocks, taken, strict=True) if not own.all()]
    _write(path, points, entries, meshio)


def _parts(source: Any, meshio: Any) -> tuple[np.ndarray, list[tuple[str, np.ndarray]], dict[str, list[np.ndarray]]]:
    """Points (n, 3), blocks of cells, and named groups: rows of each block."""
    if isinstance(source, (str, Path)):
        source = meshio.read(source)
    if isinstance(source, tuple) and len(source) == 2:
        points, cells = source
        blocks = [(kind, np.asarray(nodes, dtype=np.int64)) for kind, nodes in dict(cells).items()]
        return _solid(points), blocks, {}
    if isinstance(source, meshio.Mesh):
        blocks = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in source.cells]
        sets = {name: [np.asarray([] if rows is None else rows, dtype=np.int64) for rows in parts]
                for name, parts in source.cell_sets.items() if not name.startswith("gmsh:")}  # fmt: skip
        return _solid(source.points), blocks, sets
    if hasattr(source, "cast_to_unstructured_grid"):
        grid = source.cast_to_unstructured_grid()
        blocks = [(CELL_NAMES[int(kind)][0], np.asarray(nodes, dtype=np.int64))
                  for kind, nodes in grid.cells_dict.items() if CELL_NAMES.get(int(kind), ("vertex",))[0] != "vertex"]
        return _solid(grid.points), blocks, {}
    raise InputError(
        f"mesh: found {type(source).__name__}; allowed: a file, meshio.Mesh, a pyvista dataset, a DMPlex, the module "
        "gmsh, or (points, cells)"
    )


def _dim(kind: str) -> int:
    """Dimension of cells, by meshio's name."""
    return CELLS[KINDS[kind][0]].dim if kind in KINDS else 0


def _solid(points: Any) -> np.ndarray:
    array = np.asarray(points, dtype=float)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))


def _facets(
    name: str, chosen: Any, points: np.ndarray, blocks: Sequence[tuple[str, np.ndarray]]
) -> list[tuple[str, np.ndarray]]:
    """Facets of a group by their corners."""
    if not callable(chosen):
        corners = np.atleast_2d(np.asarray(chosen, dtype=np.int64))
        return [(_KINDS[corners.shape[1]], corners)]
    on = np.asarray(chosen(points), dtype=bool)
    found = [(kind, corners[on[corners].all(axis=1)]) for kind, corners in _boundary(blocks)]
    if not any(len(corners) for _, corners in found):
        raise InputError(f"mesh: facets {name!r}: found no facet of the boundary there; allowed: a group with some")
    return [(kind, corners) for kind, corners in found if len(corners)]


def _boundary(blocks: Sequence[tuple[str, np.ndarray]]) -> list[tuple[str, np.ndarray]]:
    """Corners of the facets that belong to one cell only."""
    top = max((_dim(kind) for kind, _ in blocks), default=2)
    found: dict[str, list[np.ndarray]] = {}
    for kind, nodes in blocks:
        for view, rows in facet_kinds(KINDS[kind][0]) if _dim(kind) == top else []:
            table, facet = facet_nodes(view, 1)[rows], MESHIO_NAMES[str(CELLS[view].facet), 1]
            found.setdefault(facet, []).append(nodes[:, table].reshape(-1, table.shape[1]))
    result = []
    for facet, parts in found.items():
        every = np.concatenate(parts)
        _, first, count = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
        result.append((facet, every[first[count == 1]]))
    return result


def _write(path: Path, points: np.ndarray, entries: Sequence[tuple[str, str, np.ndarray]], meshio: Any) -> None:
    """A .msh file; a cell of two groups is listed in each."""
    tags: dict[tuple[str, int], int] = {}
    cells, numbers = [], []
    for name, kind, nodes in entries:
        dim = _dim(kind)
        tag = tags.setdefault((name, dim), len(tags) + 1) if name else 0
        cells.append((kind, nodes))
        numbers.append(np.full(len(nodes), tag, dtype=np.int32))
    data = {"gmsh:physical": numbers, "gmsh:geometrical": [array.copy() for array in numbers]}
    names = {name: np.array([tag, dim]) for (name, dim), tag in tags.items()}
    made = meshio.Mesh(points, cells, cell_data=data, field_data=names)
    meshio.write(path, made, file_format="gmsh22", binary=False)
