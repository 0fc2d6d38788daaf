"""What a mesh file holds, what the program makes of it, and how physical groups find their cells and facets.

A reader of a file format fills a `FileMesh`; `pcontact.mesh.reader` turns that into a `RawMesh`. Facets of
a group are matched with the facets of the cells by their vertices.
"""

from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, facet_kinds, facet_nodes, n_nodes
from pcontact.mesh.complete import number_rows
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.jit import njit

# element types that the program knows, by meshio's names: (cell, degree); quad8, hexahedron20, wedge15 and pyramid13
# are filled
KINDS = {name: (CELLS[cell].complete or cell, degree) for (cell, degree), name in MESHIO_NAMES.items()}

# names of groups without a name, by dimension: "surface_12" is group 12 of dimension 2
DIMENSION_NAMES = ("point", "curve", "surface", "volume")


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
    """What a mesh file holds, whatever its format.

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

    @classmethod
    def of(cls, points):
        """A file with points (n, d), whose nodes and elements have numbers from 1 on, in its order."""
        full = np.zeros((len(points), 3))
        full[:, : points.shape[1]] = points
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


@contextmanager
def reading(path, kind):
    """Turn what goes wrong in a reader of files of a kind, which may be anything, into an input error."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            f"{path}: cannot be read as {kind}: {reason}; allowed: a complete file of that type"
        ) from None


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


def default_name(dim, tag):
    """Name of a group that has only a number, for example "surface_12"."""
    return f"{DIMENSION_NAMES[dim]}_{tag}"


@njit
def _wanted_cells(wanted, nodes, n_corners, least):
    """Whether cells, whose vertices are their first nodes, have at least so many wanted vertices, (n,) bool."""
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
    parts, first = [], 0
    for block in blocks:
        for kind, rows in facet_kinds(block.cell):
            if CELLS[CELLS[kind].facet].n_vertices == n_vertices:
                table, vertices = facet_nodes(kind, 1)[rows], block.vertices
                near = np.flatnonzero(_wanted_cells(wanted, block.nodes, vertices.shape[1], n_vertices))
                corners = vertices[near][:, table]
                row, local = np.nonzero(wanted[corners].all(axis=2))
                parts.append((corners[row, local], first + near[row], rows[local]))
        first += len(block.nodes)
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


def facet_vertices(raw, cells, local_facets):
    """Vertices of facets, by the number of vertices that a facet has.

    Parameters
    ----------
    raw : RawMesh
    cells, local_facets : ndarray, (n,) int64

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
                table = facet_nodes(kind, 1)[local_facets[rows]]
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
