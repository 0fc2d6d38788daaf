"""Refined meshes with their groups as files, and new ones of a geometry, which gmsh makes after a field of sizes."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, edge_nodes
from pcontact.mesh.msh import apart, write_file
from pcontact.mesh.raw import NAMED, FileMesh, facet_vertices, number_rows
from pcontact.runtime import process
from pcontact.runtime.errors import TOLD, InputError
from pcontact.runtime.files import GEOMETRIES, require_end, written_aside

try:
    import gmsh
except (ImportError, OSError):  # not installed, or a system library that it needs is missing
    gmsh = None

# cells whose corners carry the sizes, as gmsh calls them in a list of data
_VIEWS = {"triangle": "ST", "quadrilateral": "SQ", "tetrahedron": "SS", "hexahedron": "SH",
          "quadrilateral8": "SQ", "hexahedron20": "SH"}  # fmt: skip
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
    process.take_back()
    try:
        for name, value in _OPTIONS.items():
            gmsh.option.setNumber(name, value)
        yield
    finally:
        gmsh.finalize()


def write_refined(path, raw):
    """Write a mesh with its groups. Serial.

    Parameters
    ----------
    path : str or pathlib.Path
        .msh file.
    raw : pcontact.mesh.raw.RawMesh
        All cells of one degree.
    """
    file = FileMesh.of(raw.points)
    for k, (block, first) in enumerate(zip(raw.blocks, raw.offsets[:-1], strict=True)):
        file.add_elements(path, MESHIO_NAMES[block.cell, block.degree], raw.dim, block.nodes)
        for name, cells in raw.cell_groups.items():
            own = cells[(cells >= first) & (cells < first + len(block.nodes))] - first
            file.groups.setdefault((raw.dim, name), []).append((k, own))
    for name, (cells, local) in raw.facet_groups.items():
        for _, nodes in facet_vertices(raw, cells, local, raw.blocks[0].degree):
            _add(file, name, raw.dim - 1, NAMED[raw.dim - 1, nodes.shape[1]], nodes)
    for name, edges in raw.edge_groups.items():
        _add(file, name, 1, "line" if raw.blocks[0].degree == 1 else "line3", _lines(raw, edges))
    file.point_groups = {name: nodes for name, nodes in raw.node_groups.items() if name not in raw.edge_groups}
    write_file(path, file)


def _add(file, name, dim, kind, nodes):
    """Add elements that are a group, or a part of one."""
    if len(nodes):
        file.add(dim, name, file.add_elements(name, kind, dim, nodes), np.arange(len(nodes)))


def _lines(raw, edges):
    """Edges (n, 2) given by their vertices, with the nodes in their middles where there are some."""
    if raw.blocks[0].degree == 1:
        return edges
    pairs = np.concatenate([block.nodes[:, edge_nodes(block.cell)].reshape(-1, 2) for block in raw.blocks])
    counts = [(CELLS[block.cell].n_vertices, len(CELLS[block.cell].edges)) for block in raw.blocks]
    middles = [block.nodes[:, n : n + m].ravel() for block, (n, m) in zip(raw.blocks, counts, strict=True)]
    first, number = number_rows(np.concatenate([pairs, edges]), len(raw.points))
    return np.column_stack([edges, np.concatenate(middles)[first[number[len(pairs) :]]]])


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
        full = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
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
    if geometry.suffix.lower() not in GEOMETRIES:
        raise InputError(f"command line: -geometry: found {str(geometry)!r}; allowed: a file {', '.join(GEOMETRIES)}")
    if not geometry.is_file():
        raise InputError(f"command line: -geometry: found no file {str(geometry)!r}; allowed: a file of gmsh")
    with _fresh():
        try:
            with apart(geometry) as file:
                gmsh.open(str(file))
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
