"""Meshes that gmsh writes: refined ones with their groups, and new ones of a geometry after a field of sizes."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pcontact.runtime import signals
from pcontact.runtime.errors import TOLD, InputError
from pcontact.runtime.files import require_end, written_aside

try:
    import gmsh
except (ImportError, OSError):  # not installed, or a system library that it needs is missing
    gmsh = None

# gmsh's element types by dimension and degree, and where its node order differs from VTK's
_TYPES = {(0, 1): 15, (0, 2): 15, (1, 1): 1, (1, 2): 8, (2, 1): 2, (2, 2): 9, (3, 1): 4, (3, 2): 11}
_ORDER = {11: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}
# cells whose corners carry the sizes, as gmsh calls them in a list of data
_VIEWS = {"triangle": "ST", "quadrilateral": "SQ", "tetrahedron": "SS", "hexahedron": "SH",
          "quadrilateral8": "SQ", "hexahedron20": "SH"}  # fmt: skip
SUFFIXES = (".geo", ".geo_unrolled", ".brep", ".step", ".stp")
_OPTIONS = {
    "General.Terminal": 0,
    "Mesh.MshFileVersion": 4.1,
    "Mesh.Binary": 1,
    "Mesh.SaveAll": 0,
    "Mesh.SecondOrderIncomplete": 0,
    # the sizes alone decide
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
}


@contextmanager
def _fresh():
    """gmsh with nothing in it; it is closed at the end."""
    if gmsh is None:
        raise InputError("pcontact refine: found no Python package gmsh; allowed: pip install gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    signals.take_back()
    try:
        for name, value in _OPTIONS.items():
            gmsh.option.setNumber(name, value)
        yield
    finally:
        gmsh.finalize()


def write_refined(path, refined):
    """Write a refined mesh with its groups. Serial.

    Parameters
    ----------
    path : str or pathlib.Path
        .msh file.
    refined : pcontact.mesh.refine.Refined
    """
    with _fresh():
        gmsh.model.add("refined")
        d = refined.dim
        elements, flags = refined.groups[d]
        _add(d, refined.nodes, flags, refined)
        for dim, (elements, flags) in refined.groups.items():
            if dim != d:
                _add(dim, elements, flags, None, refined.degree)
        _write_mesh(path)


def _write_mesh(path):
    """Write what gmsh has; it does not notice a disk that is full."""
    with written_aside(path, "-o") as part:
        _call(part, gmsh.write, str(part))
        require_end(part, b"$End")


def _call(part, write, *args):
    """Have gmsh write a file that can be made."""
    with open(part, "wb"):
        pass
    write(*args)


def _add(dim, elements, flags, refined=None, degree=1):
    """Add elements, an entity for each set of groups that they belong to; with a mesh, its nodes too."""
    names = list(flags)
    table = np.stack([flags[name] for name in names], axis=1) if names else np.zeros((len(elements), 0), bool)
    sets, number = np.unique(table, axis=0, return_inverse=True)
    entities = [gmsh.model.addDiscreteEntity(dim) for _ in sets]
    if refined is not None:
        degree = refined.degree
        points = np.zeros((len(refined.points), 3))
        points[:, :dim] = refined.points
        gmsh.model.mesh.addNodes(dim, entities[0], np.arange(1, len(points) + 1), points.ravel())
    kind = _TYPES[dim, degree]
    for k, entity in enumerate(entities):
        nodes = elements[number == k] + 1
        nodes = nodes[:, _ORDER[kind]] if kind in _ORDER else nodes
        gmsh.model.mesh.addElementsByType(entity, kind, [], nodes.ravel())
    for column, name in enumerate(names):
        members = [entity for entity, chosen in zip(entities, sets, strict=True) if chosen[column]]
        gmsh.model.addPhysicalGroup(dim, members, name=name)


def write_sizes(path, points, cells, sizes):
    """Write a field of sizes as a view of gmsh (.pos). Serial.

    Parameters
    ----------
    path : str or pathlib.Path
    points : ndarray (n, dim)
    cells : list of (str, ndarray (nc, n_vertices))
        Kind of cell, vertices.
    sizes : ndarray (n,)
        At the points [length].
    """
    with _fresh():
        gmsh.model.add("sizes")
        full = np.zeros((len(points), 3))
        full[:, : points.shape[1]] = points
        view = gmsh.view.add("size")
        for kind, table in cells:
            rows = np.concatenate([full[table].transpose(0, 2, 1).reshape(len(table), -1), sizes[table]], axis=1)
            gmsh.view.addListData(view, _VIEWS[kind], len(table), rows.ravel())
        with written_aside(path, "-o") as part:
            _call(part, gmsh.view.write, view, str(part))
            require_end(part, b"};")


def remesh(path, geometry, sizes, dim, degree, groups):
    """Mesh a geometry anew with a field of sizes. Serial.

    Parameters
    ----------
    path : str or pathlib.Path
        .msh file to write.
    geometry : str or pathlib.Path
        .geo file with physical groups.
    sizes : str or pathlib.Path
        Of :func:`write_sizes`.
    dim, degree : int
        Of the cells.
    groups : set of (int, str)
        Dimensions and names of the groups that the mesh has to have.

    Returns
    -------
    int
        Number of cells.

    Raises
    ------
    InputError
        The geometry cannot be read or meshed, or lacks a group.
    """
    geometry = Path(geometry)
    if geometry.suffix.lower() not in SUFFIXES:
        raise InputError(f"command line: -geometry: found {str(geometry)!r}; allowed: a file {', '.join(SUFFIXES)}")
    if not geometry.is_file():
        raise InputError(f"command line: -geometry: found no file {str(geometry)!r}; allowed: a file of gmsh")
    with _fresh():
        try:
            gmsh.open(str(geometry))
            for name, value in _OPTIONS.items():
                gmsh.option.setNumber(name, value)
            _require_groups(geometry, groups)
            gmsh.merge(str(sizes))
            field = gmsh.model.mesh.field.add("PostView")
            gmsh.model.mesh.field.setNumber(field, "ViewTag", gmsh.view.getTags()[-1])
            gmsh.model.mesh.field.setAsBackgroundMesh(field)
            gmsh.model.mesh.generate(dim)
            gmsh.model.mesh.setOrder(degree)
            _write_mesh(path)
        except TOLD:
            raise
        except Exception as error:  # gmsh knows no other class
            raise InputError(f"{geometry}: gmsh cannot mesh it: {' '.join(str(error).split())}") from None
        return sum(len(tags) for tags in gmsh.model.mesh.getElements(dim)[1])


def _require_groups(geometry, groups):
    found = {(dim, gmsh.model.getPhysicalName(dim, tag)) for dim, tag in gmsh.model.getPhysicalGroups()}
    lost = sorted(name for _, name in groups - found)
    if lost:
        raise InputError(
            f"{geometry}: found no physical groups {', '.join(lost)}; allowed: a geometry with all groups of the mesh "
            "(a .geo file can merge a .step or .brep file and name its parts)"
        )
