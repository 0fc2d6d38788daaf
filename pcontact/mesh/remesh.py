"""Meshes that gmsh writes: refined ones with their groups, and new ones of a geometry after a field of sizes."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, facet_nodes
from pcontact.mesh.msh import VTK_ORDER, apart
from pcontact.mesh.raw import number_rows
from pcontact.runtime import process
from pcontact.runtime.errors import TOLD, InputError
from pcontact.runtime.files import GEOMETRIES, require_end, written_aside

try:
    import gmsh
except (ImportError, OSError):  # not installed, or a system library that it needs is missing
    gmsh = None

# gmsh's element types by kind and degree
_TYPES = {("point", 1): 15, ("point", 2): 15, ("segment", 1): 1, ("segment", 2): 8, ("triangle", 1): 2,
          ("triangle", 2): 9, ("quadrilateral", 1): 3, ("quadrilateral", 2): 10, ("tetrahedron", 1): 4,
          ("tetrahedron", 2): 11, ("hexahedron", 1): 5, ("hexahedron", 2): 12}  # fmt: skip
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
    with _fresh():
        gmsh.model.add("refined")
        degree, flags = raw.blocks[0].degree, []
        for cells in raw.cell_groups.values():
            flags.append(np.zeros(raw.offsets[-1], dtype=bool))
            flags[-1][cells] = True
        tables = [(block.cell, block.nodes) for block in raw.blocks]
        _add(raw.dim, tables, dict(zip(raw.cell_groups, flags, strict=True)), degree, raw.points)
        for dim, groups in _lower(raw).items():
            for tables, flags in groups:
                _add(dim, tables, flags, degree)
        _write_mesh(path)


def _lower(raw):
    """Elements of the groups of lower dimension: by dimension, tables of one kind and the groups of their rows."""
    result = {dim: [] for dim in range(raw.dim)}
    nodes = {name: members[:, None] for name, members in raw.node_groups.items() if name not in raw.edge_groups}
    lines = {name: _lines(raw, edges) for name, edges in raw.edge_groups.items()}
    for dim, kind, groups in ((0, "point", nodes), (1, "segment", lines), *_facets(raw)):
        if not groups:
            continue
        every = np.concatenate(list(groups.values()))
        _, first, number = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_inverse=True)
        ends = np.cumsum([len(rows) for rows in groups.values()])[:-1]
        flags = {name: np.zeros(len(first), dtype=bool) for name in groups}
        for name, rows in zip(groups, np.split(number.ravel(), ends), strict=True):
            flags[name][rows] = True
        result[dim].append(([(kind, every[first])], flags))
    return result


def _facets(raw):
    """Facets of groups by their kind: dimension, kind, nodes (n, n_facet_nodes) by group."""
    found = {}
    for name, (cells, local) in raw.facet_groups.items():
        number = np.searchsorted(raw.offsets, cells, side="right") - 1
        for k, block in enumerate(raw.blocks):
            rows = number == k
            columns = facet_nodes(block.cell, block.degree)[local[rows]]
            nodes = block.nodes[(cells[rows] - raw.offsets[k])[:, None], columns]
            found.setdefault(CELLS[block.cell].facet, {}).setdefault(name, []).append(nodes)
    for kind, groups in found.items():
        yield raw.dim - 1, kind, {name: np.concatenate(parts) for name, parts in groups.items()}


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


def _add(dim, tables, flags, degree, points=None):
    """Add elements, an entity for each set of groups that they belong to; points go to the first one.

    tables : kind and nodes (n, n_nodes) of elements. flags : by group, of the rows of all tables.
    """
    names, count = list(flags), sum(len(nodes) for _, nodes in tables)
    table = np.stack([flags[name] for name in names], axis=1) if names else np.zeros((count, 0), bool)
    sets, number = np.unique(table, axis=0, return_inverse=True)
    entities = [gmsh.model.addDiscreteEntity(dim) for _ in sets]
    if points is not None:
        full = np.zeros((len(points), 3))
        full[:, : points.shape[1]] = points
        gmsh.model.mesh.addNodes(dim, entities[0], np.arange(1, len(full) + 1), full.ravel())
    ends = np.cumsum([len(nodes) for _, nodes in tables])[:-1]
    for (cell, nodes), of_set in zip(tables, np.split(number.ravel(), ends), strict=True):
        kind = _TYPES[cell, degree]
        order = VTK_ORDER.get(kind, range(nodes.shape[1]))
        for k, entity in enumerate(entities):
            rows = np.empty((int((of_set == k).sum()), nodes.shape[1]), dtype=np.int64)
            rows[:, order] = nodes[of_set == k] + 1
            if len(rows):
                gmsh.model.mesh.addElementsByType(entity, kind, [], rows.ravel())
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
