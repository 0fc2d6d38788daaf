"""Contents of a mesh file, what the program makes of them, and how physical groups find their cells and facets.

A reader of a file format fills a `FileMesh`; `pcontact.mesh.read` turns that into a `RawMesh`. Facets of
a group are matched with the facets of the cells by their vertices.

Edges and faces numbered, and their middle nodes: cells raised to degree 2, serendipity cells filled up.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pcontact.element.reference import (
    CELLS,
    MESHIO_NAMES,
    SERENDIPITY,
    edge_nodes,
    face_nodes,
    facet_kinds,
    facet_nodes,
    n_nodes,
)
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.jit import njit

# element types that the program knows, by meshio's names: (cell, degree); quad8, hexahedron20, wedge15 and pyramid13
# are filled
KINDS = {name: (CELLS[cell].complete or cell, degree) for (cell, degree), name in MESHIO_NAMES.items()}
# meshio's names by dimension and number of nodes, and those of what has so many vertices and is lower than a cell
NAMED = {(CELLS[cell].dim, n_nodes(cell, degree)): name for (cell, degree), name in MESHIO_NAMES.items()}
LOWER = {1: ("vertex", 0), 2: ("line", 1), 3: ("triangle", 2), 4: ("quad", 2)}

# names of groups without a name, by dimension: "surface_12" is group 12 of dimension 2
DIMENSION_NAMES = ("point", "curve", "surface", "volume")


@njit
def _number_rows(rows, bound, number, first):
    """Number equal rows alike: rows with the same first entry are compared with each other.

    rows (n, k), entries of the first column below `bound`; out: number (n,), first (n,), of which
    the leading part is used. Returns the count of distinct rows.
    """
    start = np.zeros(bound + 1, dtype=np.int64)
    for i in range(rows.shape[0]):
        start[rows[i, 0] + 1] += 1
    for v in range(bound):
        start[v + 1] += start[v]
    cursor = start[:-1].copy()
    order = np.empty(rows.shape[0], dtype=np.int64)
    for i in range(rows.shape[0]):
        order[cursor[rows[i, 0]]] = i
        cursor[rows[i, 0]] += 1
    count = 0
    for v in range(bound):
        base = count
        for at in range(start[v], start[v + 1]):
            i = order[at]
            match = count
            for c in range(base, count):
                same = True
                for k in range(1, rows.shape[1]):
                    if rows[i, k] != rows[first[c], k]:
                        same = False
                        break
                if same:
                    match = c
                    break
            if match == count:
                first[count] = i
                count += 1
            number[i] = match
    return count


@njit
def _sort_rows(rows):
    """Sort every row (n, k) in place, by insertion: rows are short."""
    for i in range(rows.shape[0]):
        for a in range(1, rows.shape[1]):
            value, b = rows[i, a], a
            while b > 0 and rows[i, b - 1] > value:
                rows[i, b] = rows[i, b - 1]
                b -= 1
            rows[i, b] = value


def sorted_rows(rows):
    """A copy of rows (n, k) of node numbers with every row sorted."""
    rows = np.array(rows, dtype=np.int64, order="C")
    _sort_rows(rows)
    return rows


def number_rows(rows, bound):
    """Number rows of node numbers so that rows with the same members, in any order, get the same number.

    Parameters
    ----------
    rows : ndarray, (n, k) int64
        Entries from 0 to `bound` - 1.
    bound : int

    Returns
    -------
    first : ndarray, (n_distinct,) int64
        First row of each number.
    number : ndarray, (n,) int64
    """
    number, first = np.empty((2, len(rows)), dtype=np.int64)
    rows = sorted_rows(rows)
    count = _number_rows(rows, bound, number, first)
    return first[:count], number


def complete(raw, degree):
    """Raise all cells to a degree.

    New nodes lie at the centres of edges, quadrilateral faces and cells and are shared between neighbours; a
    neighbour that has such a node already keeps it. Existing nodes keep their numbers.

    Parameters
    ----------
    raw : RawMesh
    degree : int
        1 or 2. Cells are never lowered: with 1 the mesh is returned as it is.

    Returns
    -------
    RawMesh
        At degree 2 all blocks are of degree 2, and groups of edges contain the edges' middle nodes.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2.
    """
    if degree not in (1, 2):
        raise ValueError(f"degree {degree}: only 1 and 2 exist")
    if degree == 1 or all(block.degree == 2 for block in raw.blocks):
        return raw
    blocks = [replace(block, degree=2, nodes=with_gaps(block.cell, block.nodes)) for block in raw.blocks]
    points, pairs, middles = fill(raw.points, blocks)
    groups = dict(raw.node_groups)
    for name, edges in raw.edge_groups.items():
        first, number = number_rows(np.concatenate([pairs, edges]), len(raw.points))
        edge = first[number[len(pairs) :]]
        groups[name] = np.union1d(groups[name], middles[edge[edge < len(pairs)]])
    return replace(raw, points=points, blocks=blocks, node_groups=groups)


def raised(raw, order, serendipity=False):
    """Give a mesh the nodes that displacements of a degree need, and tell whether its cells are curved.

    Parameters
    ----------
    raw : RawMesh
    order : int
        1 or 2; cells of degree 2, which are curved, are never lowered.
    serendipity : bool
        Whether cells of degree 2 are to have no nodes in the middles of faces and cells.
    """
    curved = any(block.degree == 2 for block in raw.blocks)
    if curved or order == 2:
        raw = complete(raw, 2)
        raw = without_middles(raw) if serendipity else raw
    return raw, curved


def without_middles(raw):
    """Take the nodes in the middles of faces and cells out of quadrilaterals and hexahedra of degree 2.

    Parameters
    ----------
    raw : RawMesh
        Of degree 2.

    Returns
    -------
    RawMesh
        With serendipity cells; the mesh as it is if it has none to take them from.
    """
    if not any(block.cell in SERENDIPITY for block in raw.blocks):
        return raw
    blocks, used = [], np.zeros(len(raw.points), dtype=bool)
    for block in raw.blocks:
        cell = SERENDIPITY.get(block.cell, block.cell)
        blocks.append(replace(block, cell=cell, nodes=block.nodes[:, : n_nodes(cell, 2)]))
        used[blocks[-1].nodes] = True
    number = np.cumsum(used) - 1
    for block in blocks:
        block.nodes = number[block.nodes]
    groups = {name: number[nodes[used[nodes]]] for name, nodes in raw.node_groups.items()}
    edges = {name: number[ends] for name, ends in raw.edge_groups.items()}
    return replace(raw, points=raw.points[used], blocks=blocks, node_groups=groups, edge_groups=edges)


def with_gaps(cell, nodes):
    """Connectivity (n, m) widened to that of the degree-2 cell; -1 where there is no node yet."""
    wide = np.full((len(nodes), n_nodes(cell, 2)), -1, dtype=np.int64)
    wide[:, : nodes.shape[1]] = nodes
    return wide


def fill(points, blocks):
    """Give every gap in the connectivity of degree-2 cells a node.

    Edges get their midpoint. Faces and cells get the point where the serendipity interpolation of their
    boundary puts their centre: ``-1/4 sum(vertices) + 1/2 sum(edge nodes)`` on a quadrilateral (8 nodes),
    ``-1/4 sum(vertices) + 1/4 sum(edge nodes)`` in a hexahedron (20 nodes); with straight edges that is the
    mean of the vertices.

    Parameters
    ----------
    points : ndarray, (n_points, d) float64
    blocks : list of Block
        Of degree 2; -1 marks a gap. Their nodes are filled in place.

    Returns
    -------
    points : ndarray, (n_points + n_new, d) float64
    pairs : ndarray, (n_edges, 2) int64
        Vertices of the edges.
    middles : ndarray, (n_edges,) int64
        Middle node of each.
    """
    n_old = len(points)
    edges = [block.nodes[:, edge_nodes(block.cell)] for block in blocks]
    pairs = np.concatenate([e.reshape(-1, 2) for e in edges])
    first, number = number_rows(pairs, n_old)
    middles, fresh = _number(blocks, "edges", first, number, n_old)
    points = np.concatenate([points, points[pairs[fresh]].mean(axis=1)])
    points = _fill_faces(points, blocks, n_old)
    return _fill_centres(points, blocks), pairs[first], middles


def _columns(cell, what):
    """Columns of the middle nodes of the edges or of the faces in the connectivity of the degree-2 cell."""
    first = CELLS[cell].n_vertices
    if what == "edges":
        return slice(first, first + len(CELLS[cell].edges))
    first += len(CELLS[cell].edges)
    return slice(first, first + len(CELLS[cell].faces))


def _number(blocks, what, first, number, start):
    """Number the edges or faces that have no node from `start`, and write the numbers into the blocks.

    first, number: what `number_rows` says of the entities of all cells. Returns the node of every distinct
    entity and, for each new node, a position where its entity occurs.
    """
    columns = [_columns(block.cell, what) for block in blocks]
    known = np.concatenate([block.nodes[:, c].ravel() for block, c in zip(blocks, columns, strict=True)])
    nodes = np.full(len(first), -1, dtype=np.int64)
    has = known >= 0
    nodes[number[has]] = known[has]
    new = np.flatnonzero(nodes < 0)
    nodes[new] = start + np.arange(len(new))
    known = np.where(has, known, nodes[number])
    at = 0
    for block, c in zip(blocks, columns, strict=True):
        part = block.nodes[:, c]
        block.nodes[:, c] = known[at : at + part.size].reshape(part.shape)
        at += part.size
    return nodes, first[new]


def _face_edges(cell):
    """Columns of the middle nodes of the edges of every quadrilateral face, (n_faces, 4)."""
    reference = CELLS[cell]
    edges = [(reference.n_vertices + k, set(edge)) for k, edge in enumerate(reference.edges)]
    rows = [[column for column, edge in edges if edge <= set(face)] for face in reference.faces]
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


def _fill_faces(points, blocks, n_old):
    """Nodes at the centres of the faces of hexahedra."""
    blocks = [block for block in blocks if CELLS[block.cell].faces]
    if not any(np.any(block.nodes[:, _columns(block.cell, "faces")] < 0) for block in blocks):
        return points
    corners = np.concatenate([block.nodes[:, face_nodes(block.cell)].reshape(-1, 4) for block in blocks])
    middles = np.concatenate([block.nodes[:, _face_edges(block.cell)].reshape(-1, 4) for block in blocks])
    _, fresh = _number(blocks, "faces", *number_rows(corners, n_old), len(points))
    return np.concatenate([points, _quadrilateral_centre(points, corners[fresh], middles[fresh])])


def _quadrilateral_centre(points, corners, middles):
    return 0.5 * points[middles].sum(axis=1) - 0.25 * points[corners].sum(axis=1)


def _fill_centres(points, blocks):
    """Nodes inside quadrilaterals and hexahedra, not shared with anyone."""
    for block in blocks:
        reference = CELLS[block.cell]
        if not reference.is_tensor:
            continue
        rows = np.flatnonzero(block.nodes[:, -1] < 0)
        corners, middles = block.vertices[rows], block.nodes[rows, _columns(block.cell, "edges")]
        if reference.dim == 2:
            centres = _quadrilateral_centre(points, corners, middles)
        else:
            centres = 0.25 * (points[middles].sum(axis=1) - points[corners].sum(axis=1))
        block.nodes[rows, -1] = len(points) + np.arange(len(rows))
        points = np.concatenate([points, centres])
    return points


@dataclass
class Table:
    """Elements of one type, as they stand in a file.

    Attributes
    ----------
    kind : str
        Type, by meshio's name where it has one.
    dim : int
        Dimension of the elements, 0 to 3.
    nodes : ndarray, (n, n_nodes) int64
        Rows of `FileMesh.points`, in VTK's order.
    tags : ndarray, (n,) int64
        The file's own element numbers.
    """

    kind: str
    dim: int
    nodes: np.ndarray
    tags: np.ndarray


@dataclass
class FileMesh:
    """Contents of a mesh file, whatever its format.

    Attributes
    ----------
    points : ndarray, (n, 3) float64
    tags : ndarray, (n,) int64
        The file's own node numbers.
    free : ndarray, (n,) bool
        Nodes that may be left out without a word when no cell uses them: they only served the construction.
    tables : list of Table
    groups : dict of (int, str) to list of (int, ndarray)
        (dimension, name): positions in `tables`, and rows in that table.
    point_groups : dict of str to ndarray
        Rows of `points`.
    repeats : bool
        The format repeats an element once per group that it is in.
    declared : list of (int, str)
        (dimension, name) of the groups that the file names; some may be empty.
    lost : dict of str to str
        Groups that cannot be used, and why: see `RawMesh.lost`.
    shared : ndarray, (n_vertices,) bool, optional
        Where every rank has a part of a mesh, vertices that others may have, too, with the same numbers; they come
        first.
    outer : set of str
        Groups of facets on the boundary of the part that are meant to be on that of the mesh.
    """

    points: np.ndarray
    tags: np.ndarray
    free: np.ndarray
    tables: list
    groups: dict = field(default_factory=dict)
    point_groups: dict = field(default_factory=dict)
    repeats: bool = False
    declared: list = field(default_factory=list)
    lost: dict = field(default_factory=dict)
    shared: np.ndarray | None = None
    outer: set = field(default_factory=set)

    @classmethod
    def of(cls, points):
        """A file with points (n, d), whose nodes and elements have numbers from 1 on, in its order."""
        full = np.pad(np.asarray(points, dtype=float), ((0, 0), (0, 3 - points.shape[1])))
        return cls(full, np.arange(1, len(points) + 1), np.zeros(len(points), dtype=bool), [])

    def add_elements(self, path, kind, dim, nodes):
        """Add a table of elements with nodes (n, k), rows of the points; its number.

        Raises
        ------
        InputError
            There is no such node.
        """
        first = 1 + sum(len(table.tags) for table in self.tables)
        lost = np.argwhere((nodes < 0) | (nodes >= len(self.points)))
        if len(lost):
            raise InputError(
                f"{path}: element {first + lost[0][0]} ({kind}) refers to node {nodes[tuple(lost[0])] + 1}; "
                f"allowed: the {len(self.points)} nodes of the file"
            )
        nodes = np.ascontiguousarray(nodes, dtype=np.int64)
        self.tables.append(Table(kind, dim, nodes, np.arange(first, first + len(nodes))))
        return len(self.tables) - 1

    def add(self, dim, name, table, rows):
        """Put rows (n,) of a table into the group `name` of dimension `dim`."""
        self.groups.setdefault((dim, name), []).append((table, rows))


@dataclass
class Block:
    """Cells of one type and degree.

    Attributes
    ----------
    cell : str
        Name in `pcontact.element.reference.CELLS`.
    degree : int
        1 or 2, of the geometry.
    nodes : ndarray, (n_cells, n_nodes) int64
        Rows of `RawMesh.points`, VTK order; at degree 2 always the complete cell.
    """

    cell: str
    degree: int
    nodes: np.ndarray

    @property
    def vertices(self):
        """ndarray, (n_cells, n_vertices) : the nodes at the vertices."""
        return self.nodes[:, : CELLS[self.cell].n_vertices]


@dataclass
class RawMesh:
    """A whole mesh on one process, checked.

    Attributes
    ----------
    path : pathlib.Path
        The file, for messages.
    dim : int
        2 or 3.
    points : ndarray, (n_points, dim) float64
        Coordinates [length]. Every point is a node of a cell.
    blocks : list of Block
        Cells are numbered globally, block after block.
    cell_groups : dict of str to ndarray (n,) int64
        Cell numbers, ascending.
    facet_groups : dict of str to (ndarray (n,) int64, ndarray (n,) int64)
        Cell number and local facet number, each facet once. A facet between two cells is listed with the
        cell of lower number.
    node_groups : dict of str to ndarray (n,) int64
        Nodes of groups of dimension 0 and, in three dimensions, of groups of edges; ascending.
    edge_groups : dict of str to ndarray (n, 2) int64
        Vertices of the edges of those groups, from which `complete` knows the new nodes of a group.
    tags : ndarray (n_cells,) int64, optional
        The file's own cell numbers, for messages; without them cells are numbered from 1.
    lost : dict of str to str
        Groups of nodes and facets that belong to no cell, and what is found and allowed, for a message if a scene
        names one. No other attribute has them.
    """

    path: Path
    dim: int
    points: np.ndarray
    blocks: list
    cell_groups: dict = field(default_factory=dict)
    facet_groups: dict = field(default_factory=dict)
    node_groups: dict = field(default_factory=dict)
    edge_groups: dict = field(default_factory=dict)
    tags: np.ndarray | None = None
    lost: dict = field(default_factory=dict)

    @property
    def offsets(self):
        """ndarray, (n_blocks + 1,) int64 : first cell of every block; last, the number of cells."""
        return np.cumsum([0] + [len(block.nodes) for block in self.blocks])


def say_lost(path, lost):
    """Warn of groups that cannot be used.

    Parameters
    ----------
    path : pathlib.Path
    lost : dict of str to str
        See `RawMesh.lost`.
    """
    if not lost:
        return
    names = [f'"{name}"' for name in lost]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    why = next(iter(lost.values())).partition(";")[0]
    word = "groups" if len(names) > 1 else "group"
    log.warning("%s: left out: %s %s%s: %s", path, word, ", ".join(names[:3]), more, why)


def distinct(*keys, ties=()):
    """Of equal rows of keys (n,) one each, in the order of the keys, that with the least ties (n,), or the first one:
    places (m,) of those; and among them that of each row (n,)."""
    order = np.lexsort((*ties, *keys[::-1]))
    first = np.ones(len(order), dtype=bool)
    first[1:] = np.any([np.diff(key[order]) != 0 for key in keys], axis=0)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.cumsum(first) - 1
    return order[first], place


def numbered(blocks):
    """Blocks, each with the rows of its cells among those of all."""
    first = 0
    for block in blocks:
        end = first + len(block.nodes)
        yield block, slice(first, end)
        first = end


def default_name(dim, tag):
    """Name of a group that has only a number, for example "surface_12"."""
    return f"{DIMENSION_NAMES[dim]}_{tag}"


@njit
def _wanted_cells(wanted, nodes, n_corners, least):
    """Return whether cells, whose vertices are their first nodes, have at least so many wanted vertices, (n,) bool."""
    out = np.empty(nodes.shape[0], dtype=np.bool_)
    for c in range(nodes.shape[0]):
        count = 0
        for v in range(n_corners):
            count += wanted[nodes[c, v]]
        out[c] = count >= least
    return out


def facets_among(blocks, wanted, n_vertices):
    """Facets whose vertices are all wanted.

    Parameters
    ----------
    blocks : list of Block
    wanted : ndarray, (n_points,) bool
    n_vertices : int
        Of a facet.

    Returns
    -------
    vertices : ndarray, (n, n_vertices) int64
        In the facet's own order, outward.
    cells, local : ndarray, (n,) int64
        Cell numbers, and local facet numbers.
    """
    parts = []
    for block, own in numbered(blocks):
        for kind, rows in facet_kinds(block.cell):
            if CELLS[CELLS[kind].facet].n_vertices == n_vertices:
                table, vertices = facet_nodes(kind, 1)[rows], block.vertices
                near = np.flatnonzero(_wanted_cells(wanted, block.nodes, vertices.shape[1], n_vertices))
                corners = vertices[near][:, table]
                row, local = np.nonzero(wanted[corners].all(axis=2))
                parts.append((corners[row, local], own.start + near[row], rows[local]))
    if not parts:
        return np.zeros((0, n_vertices), np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64)
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def find_facets(blocks, n_points, vertices):
    """Find the cells that own given facets.

    Parameters
    ----------
    blocks : list of Block
    n_points : int
    vertices : ndarray, (n, k) int64
        Vertices of the facets, in any order.

    Returns
    -------
    cells : ndarray, (n,) int64
        Number of the cell; of the first one when there are several; -1 if there is none.
    local : ndarray, (n,) int64
        Local facet number in that cell.
    multiplicity : ndarray, (n,) int64
        Number of cells that own the facet.
    """
    wanted = np.zeros(n_points, dtype=bool)
    wanted[vertices] = True
    corners, cells, local = facets_among(blocks, wanted, vertices.shape[1])
    n = len(cells)
    first, number = number_rows(np.concatenate([corners, vertices]), n_points)
    multiplicity = np.bincount(number[:n], minlength=len(first))[number[n:]]
    owner = first[number[n:]]
    found = owner < n  # else the first such row is the facet itself: no cell has it
    cells, local = np.append(cells, -1), np.append(local, -1)
    owner[~found] = n
    return cells[owner], local[owner], multiplicity


def facet_vertices(raw, cells, local_facets, degree=1):
    """Vertices of facets, or all of their nodes, by the number of vertices that a facet has.

    Parameters
    ----------
    raw : RawMesh
    cells, local_facets : ndarray, (n,) int64
    degree : int
        2: nodes in the middles, too.

    Yields
    ------
    rows : ndarray, (m,) int64
        Positions in `cells`.
    vertices : ndarray, (m, k) int64
        In the facet's own order.
    """
    offsets = raw.offsets
    number = np.searchsorted(offsets, cells, side="right") - 1
    for index, block in enumerate(raw.blocks):
        for kind, numbers in facet_kinds(block.cell):
            rows = np.flatnonzero((number == index) & np.isin(local_facets, numbers))
            if len(rows):
                table = facet_nodes(kind, degree)[local_facets[rows]]
                yield rows, block.nodes[(cells[rows] - offsets[index])[:, None], table]


def facet_multiplicity(raw, cells, local_facets):
    """Number of cells that own each facet: 1 on the boundary, 2 between two cells.

    Parameters
    ----------
    raw : RawMesh
    cells : ndarray, (n,) int64
    local_facets : ndarray, (n,) int64

    Returns
    -------
    ndarray, (n,) int64
    """
    result = np.zeros(len(cells), dtype=np.int64)
    for rows, vertices in facet_vertices(raw, np.asarray(cells), np.asarray(local_facets)):
        result[rows] = find_facets(raw.blocks, len(raw.points), vertices)[2]
    return result


def facets_of_nodes(raw, nodes):
    """Boundary facets whose vertices all belong to a set of nodes.

    Some formats know only sets of nodes; this makes a surface of such a set.

    Parameters
    ----------
    raw : RawMesh
    nodes : ndarray, (n,) int64

    Returns
    -------
    cells, local_facets : ndarray, (m,) int64
    """
    wanted = np.zeros(len(raw.points), dtype=bool)
    wanted[nodes] = True
    parts = [facets_among(raw.blocks, wanted, k)[1:] for k in ((2,) if raw.dim == 2 else (3, 4))]
    cells, local = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    outer = facet_multiplicity(raw, cells, local) == 1
    return _each_once(cells[outer], local[outer])


def _each_once(cells, local):
    """Facets in ascending order, each once."""
    pairs = np.unique(cells * 8 + local)
    return pairs // 8, pairs % 8


def cell_groups(file, start, dim):
    """Cells of every group of the highest dimension.

    Parameters
    ----------
    file : FileMesh
    start : dict of int to int
        Number of the first cell of every table of cells.
    dim : int

    Returns
    -------
    dict of str to ndarray (n,) int64
        Ascending.
    """
    groups = {}
    for (group_dim, name), parts in file.groups.items():
        if group_dim == dim:
            groups[name] = np.unique(np.concatenate([start[table] + rows for table, rows in parts]))
    return groups


def lower_groups(file, raw, new_number):
    """Fill the facet, edge and node groups of a mesh whose nodes have been renumbered.

    Parameters
    ----------
    file : FileMesh
    raw : RawMesh
        Its three dictionaries are filled.
    new_number : ndarray, (n,) int64
        Number in `raw` of every node of the file.

    Notes
    -----
    A group with a facet that belongs to no cell goes to `RawMesh.lost`.
    """
    facets, nodes, edges = {}, {}, {}
    raw.lost = dict(file.lost)
    for (dim, name), parts in file.groups.items():
        for index, rows in parts:
            table = file.tables[index]
            if dim == raw.dim - 1:
                found = _group_facets(file, raw, new_number, table, rows)
                if isinstance(found, str):
                    raw.lost.setdefault(name, found)
                else:
                    facets.setdefault(name, []).append(found)
            elif dim < raw.dim:
                nodes.setdefault(name, []).append(new_number[table.nodes[rows]].ravel())
                if dim == 1:
                    edges.setdefault(name, []).append(new_number[table.nodes[rows, :2]])
    for name, members in file.point_groups.items():
        nodes.setdefault(name, []).append(new_number[members])
    for name in raw.lost:
        facets.pop(name, None)
    raw.facet_groups = {n: _each_once(*map(np.concatenate, zip(*p, strict=True))) for n, p in facets.items()}
    raw.node_groups = {name: np.unique(np.concatenate(parts)) for name, parts in nodes.items()}
    raw.edge_groups = {n: np.unique(np.sort(np.concatenate(p), axis=1), axis=0) for n, p in edges.items()}


def _group_facets(file, raw, new_number, table, rows):
    """Cells and local facet numbers of some elements of one table; or why they have none."""
    corners = table.nodes[rows, : n_nodes(KINDS[table.kind][0], 1)]
    cells, local, _ = find_facets(raw.blocks, len(raw.points), new_number[corners])
    lost = np.flatnonzero(cells < 0)
    if len(lost):
        return (
            f"facet {table.tags[rows[lost[0]]]} with nodes "
            f"{', '.join(map(str, file.tags[corners[lost[0]]]))} belongs to no cell ({len(lost)} in all); "
            f"allowed: facets of cells of dimension {raw.dim}"
        )
    return cells, local


def cells_by_place(raw, test, within=None):
    """Cells whose middle a test takes.

    Parameters
    ----------
    raw : RawMesh
    test : callable
        From places (n, d) [length] and outward unit normals (n, d), or None, to (n,) bool.
    within : ndarray (m,) of int, optional
        Cells to choose from; absent: all.

    Returns
    -------
    ndarray (n,) int64
        Ascending.
    """
    middles = np.concatenate([raw.points[block.vertices].mean(axis=1) for block in raw.blocks])
    chosen = np.flatnonzero(test(middles, None))
    return chosen if within is None else np.intersect1d(chosen, within)


def facets_by_place(raw, test, within=None):
    """Facets of the boundary of which a test takes all vertices.

    Parameters
    ----------
    raw, test, within
        As of :func:`cells_by_place`: facets of the cells that are given. Normals are those in the middle of the facet.

    Returns
    -------
    cells, local_facets : ndarray (n,) int64
    """
    cells, local = facets_of_nodes(raw, np.arange(len(raw.points)))
    if within is not None:
        own = np.isin(cells, within)
        cells, local = cells[own], local[own]
    middles = np.concatenate([raw.points[block.vertices].mean(axis=1) for block in raw.blocks])[cells]
    chosen = np.zeros(len(cells), dtype=bool)
    for rows, vertices in facet_vertices(raw, cells, local):
        x = raw.points[vertices]
        normal = _normals(x, x.mean(axis=1) - middles[rows])
        taken = test(x.reshape(-1, raw.dim), np.repeat(normal, x.shape[1], axis=0))
        chosen[rows] = taken.reshape(len(x), -1).all(axis=1)
    return cells[chosen], local[chosen]


def nodes_by_place(raw, test, within=None):
    """Nodes that a test takes.

    Parameters
    ----------
    raw, test, within
        As of :func:`cells_by_place`: nodes of the cells that are given.

    Returns
    -------
    nodes : ndarray (n,) int64
        Ascending.
    edges : ndarray (m, 2) int64
        Vertices of edges both ends and the middle of which are taken: nodes that come there belong to the group.
    """
    nodes, edges = [], []
    chosen = np.ones(raw.offsets[-1], dtype=bool) if within is None else np.isin(np.arange(raw.offsets[-1]), within)
    for block, rows in numbered(raw.blocks):
        own = block.nodes[chosen[rows]]
        nodes.append(own.ravel())
        edges.append(np.sort(own[:, edge_nodes(block.cell)].reshape(-1, 2), axis=1))
    nodes, edges = np.unique(np.concatenate(nodes)), np.unique(np.concatenate(edges), axis=0)
    nodes = nodes[test(raw.points[nodes], None)]
    edges = edges[np.isin(edges, nodes).all(axis=1)]
    return nodes, edges[test(raw.points[edges].mean(axis=1), None)]


def _normals(x, outward):
    """Unit normals (n, d) of facets with vertices (n, k, d), on the side of given vectors (n, d)."""
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        normal = np.column_stack([along[:, 1], -along[:, 0]])
    else:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, -1] - x[:, 0])
    side = np.sign(np.einsum("nd,nd->n", normal, outward))
    return normal * (side / np.linalg.norm(normal, axis=1))[:, None]


BY_PLACE = {"cells": cells_by_place, "facets": facets_by_place, "nodes": nodes_by_place}
