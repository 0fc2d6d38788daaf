"""Triangles and tetrahedra cut in halves at their longest edges, until none has a node on one of its edges.

A cell that is cut is cut at its longest edge, whatever is wanted of it (Rivara 1984). What becomes of a cell thus
depends on the cell alone: all meshes that come from a base are parts of one tree of cells, a cell is known by the
cell of the base and by the sides that were taken (its *path*), and the coarsest mesh that has certain cells and fits
together is unique: the order of the cuts, and the ranks that make them, do not matter. A face is cut at its own
longest edge by both of its cells, since the longest edge of a cell is the longest one of the faces that have it.
Lengths are compared to 5e-6 (`STEPS`), equal ones by keys.

Edges are known by the node in their middle, which is a node of the mesh with cells of degree 2, and else from the
time the edge is cut. Values at new nodes, of coordinates and of fields alike, are those of the cell that is cut: on
an edge with ends a, b and middle m, the node between a and m has

    3/8 a + 3/4 m - 1/8 b                               (`HALF`)

and the node between m and the vertex c, with the middles ac and bc of two more edges of the face,

    -1/8 (a + b) + 1/4 m + 1/2 (ac + bc)                (`FACE`)

which are the shape functions of degree 2; with degree 1 it is the mean of the ends.

The trees of cells that grow from the triangles or tetrahedra of a base, each rank those of its own cells.

Keys of nodes: numbers of 64 bits by which all ranks know a node, whatever came before it, and a table of them.

A node of the base has the mixed bits of its number. The node in the middle of an edge has those of the keys of the
edge's ends, in any order: so two ranks that cut the edge they share agree on the new node without a message, and a
mesh that is made again from the base has the same keys. Two of n nodes have the same key with a probability of n^2 /
2^65: 1e-6 for 5 million.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes
from pcontact.mesh.mesh import mixed, scattered
from pcontact.runtime.errors import InputError
from pcontact.runtime.jit import njit_exact, njit_inline, njit_inner_exact

# value of a place of the table that is free, and of a key that is known, but has no node here yet
FREE, AWAITED = -2, -1
# how a node came to be
BASE, HALF, FACE = 0, 1, 2
# by what rule nodes get values: means of the ends; formulas of degree 2, for coordinates too (`CURVED`) or not
LINEAR, STRAIGHT, CURVED = 0, 1, 2
# steps per doubling of the square of a length: a relative difference of 5e-6
STEPS = 65536.0
# cuts that lead to a cell, at most: the bits of its path
DEEPEST = 63
# bisections of a cell that can be wished for: those that neighbours ask for come on top. From: in the plane its edges
# are 4e-9 of what they were then, which coordinates just tell apart.
WISHED = 56
# rows that arrays have room for, over what is there
ROOM = 1.5


_scattered = njit_inline(scattered)


@njit_inline
def middle_key(a, b):
    """Key of the node between two others."""
    low, high = min(a, b), max(a, b)
    return _scattered(low * np.uint64(3) + _scattered(high))


def middle_keys(one, other):
    """Keys (n,) uint64 of nodes between pairs of others, by the keys of these."""
    return mixed(np.minimum(one, other) * np.uint64(3) + mixed(np.maximum(one, other)))


@njit_inline
def place(keys, values, key):
    """Return the place of a key in the table, or the free place where it belongs."""
    last = np.int64(keys.shape[0] - 1)
    at = np.int64(key & np.uint64(last))
    while values[at] != FREE and keys[at] != key:
        at = (at + 1) & last
    return at


@njit_exact
def enter(keys, values, entered, numbers):
    """Put keys (n,) with their values (n,) into a table that has room for them."""
    for k in range(entered.shape[0]):
        at = place(keys, values, entered[k])
        keys[at], values[at] = entered[k], numbers[k]


def new_table(n):
    """A table of keys with room for n of them: keys uint64, values int32, both (a power of two,)."""
    size = 2 << max(int(n), 8).bit_length()
    return np.zeros(size, dtype=np.uint64), np.full(size, FREE, dtype=np.int32)


def home_of_key(keys, size):
    """The rank (n,) that keeps what all ranks have to know of a node, by its key."""
    return ((keys >> np.uint64(32)) * np.uint64(size) >> np.uint64(32)).astype(np.int64)


class Nodes(NamedTuple):
    """Nodes of one rank, vertices and middles of edges; with room for more.

    Attributes
    ----------
    key : ndarray (n,) uint64
    points : ndarray (n, d)
        Coordinates [length].
    length : ndarray (n,) int64
        Of the edge whose middle it is: logarithm of the square, in `STEPS`.
    kind : ndarray (n,) int8
        `BASE`, `HALF`, `FACE`.
    parents : ndarray (n, 5) int32
        The nodes of the formulas above, in their order; with degree 1, and in the middles of edges of the base, the
        ends.
    split : ndarray (n,) uint8
        Whether it is in the middle of an edge that is cut.
    shared : ndarray (n,) uint64
        Bits of the neighbours that may have it, too.
    groups : ndarray (n, m) int64
        Bits of the groups of nodes that it is in.
    """

    key: np.ndarray
    points: np.ndarray
    length: np.ndarray
    kind: np.ndarray
    parents: np.ndarray
    split: np.ndarray
    shared: np.ndarray
    groups: np.ndarray


class Cells(NamedTuple):
    """Cells of one rank, with room for more.

    Attributes
    ----------
    vertices : ndarray (n, d + 1) int32
    middles : ndarray (n, n_edges) int32
    base : ndarray (n,) int32
        Row of the cell of the base.
    path : ndarray (n,) uint64
        Sides that were taken, from the highest bit on.
    level : ndarray (n,) int32
        How many cuts lead to it.
    facets : ndarray (n, d + 1) int32
        Of the facet opposite each vertex: number of the facet of the base that it is a part of, or -1.
    wishes : ndarray (n, 2) int32
        First and last + 1 of the wishes that touch it.
    """

    vertices: np.ndarray
    middles: np.ndarray
    base: np.ndarray
    path: np.ndarray
    level: np.ndarray
    facets: np.ndarray
    wishes: np.ndarray


class Wishes(NamedTuple):
    """Levels that are wanted in cells of the tree, by base row and path.

    Attributes
    ----------
    path : ndarray (n,) uint64
    level : ndarray (n,) int32
        Of the cell.
    wanted : ndarray (n,) int32
    """

    path: np.ndarray
    level: np.ndarray
    wanted: np.ndarray


@njit_inline
def _make(nodes, table, count, a, b):
    """Number of the node between two others, and whether it is new: then without coordinates."""
    key = middle_key(nodes.key[a], nodes.key[b])
    at = place(table[0], table[1], key)
    if table[1][at] >= 0:
        return table[1][at], False
    n = count[0]
    nodes.split[n] = 1 if table[1][at] == AWAITED else 0
    table[0][at], table[1][at] = key, n
    nodes.key[n] = key
    count[0] = n + 1
    return np.int32(n), True


@njit_inline
def _measure(nodes, n, a, b):
    square = 0.0
    for i in range(nodes.points.shape[1]):
        square += (nodes.points[a, i] - nodes.points[b, i]) ** 2
    nodes.length[n] = np.int64(np.floor(STEPS * np.log2(max(square, 1e-300))))


@njit_inline
def _half(nodes, table, count, rule, a, m, b):
    """The node between an end a of an edge and its middle m."""
    n, new = _make(nodes, table, count, a, m)
    if new:
        nodes.kind[n] = HALF
        nodes.parents[n, 0], nodes.parents[n, 1], nodes.parents[n, 2] = a, m, b
        for i in range(nodes.points.shape[1]):
            if rule == CURVED:
                x = 0.375 * nodes.points[a, i] + 0.75 * nodes.points[m, i] - 0.125 * nodes.points[b, i]
            else:
                x = 0.5 * (nodes.points[a, i] + nodes.points[m, i])
            nodes.points[n, i] = x
        _measure(nodes, n, a, m)
        nodes.shared[n] = nodes.shared[a] & nodes.shared[m]
        for i in range(nodes.groups.shape[1]):
            nodes.groups[n, i] = nodes.groups[a, i] & nodes.groups[m, i] & nodes.groups[b, i]
    return n


@njit_inline
def _across(nodes, table, count, rule, face):
    """The node between the middle m of an edge a b and the vertex c; face: a, b, m, c, and the middles of a c, b c."""
    a, b, m, c, ac, bc = face
    n, new = _make(nodes, table, count, m, c)
    if new:
        nodes.kind[n] = FACE
        if rule == LINEAR:
            nodes.parents[n, 0], nodes.parents[n, 1] = m, c
        else:
            nodes.parents[n, 0], nodes.parents[n, 1], nodes.parents[n, 2] = a, b, m
            nodes.parents[n, 3], nodes.parents[n, 4] = ac, bc
        x = nodes.points
        for i in range(x.shape[1]):
            if rule == CURVED:
                x[n, i] = -0.125 * (x[a, i] + x[b, i]) + 0.25 * x[m, i] + 0.5 * (x[ac, i] + x[bc, i])
            else:
                x[n, i] = 0.5 * (x[m, i] + x[c, i])
        _measure(nodes, n, m, c)
        nodes.shared[n] = nodes.shared[m] & nodes.shared[c]
        for i in range(nodes.groups.shape[1]):
            nodes.groups[n, i] = 0
    return n


@njit_inline
def _due(nodes, cells, wishes, c):
    """Return whether a cell has to be cut: it has a node on an edge, or is wanted smaller."""
    for e in range(cells.middles.shape[1]):
        if nodes.split[cells.middles[c, e]]:
            return True
    level = cells.level[c]
    for k in range(cells.wishes[c, 0], cells.wishes[c, 1]):
        if wishes.wanted[k] > level:
            return True
    return False


@njit_inline
def _longest(nodes, cells, c):
    best = 0
    for e in range(1, cells.middles.shape[1]):
        one, other = cells.middles[c, e], cells.middles[c, best]
        longer = nodes.length[one] > nodes.length[other]
        if longer or (nodes.length[one] == nodes.length[other] and nodes.key[one] > nodes.key[other]):
            best = e
    return best


@njit_inline
def _divide_wishes(cells, wishes, c, n, level):
    """Give each half of a cell the wishes that touch it."""
    first, end = cells.wishes[c, 0], cells.wishes[c, 1]
    if end > first and wishes.level[first] <= level:
        cells.wishes[n, 0], cells.wishes[n, 1] = first, end
        return
    cut = first
    while cut < end and (wishes.path[cut] >> np.uint64(DEEPEST - level)) & np.uint64(1) == np.uint64(0):
        cut += 1
    cells.wishes[c, 1] = cut
    cells.wishes[n, 0], cells.wishes[n, 1] = cut, end


@njit_exact
def cut_all(nodes, cells, wishes, table, edges, count, rule, told):
    """Cut cells, from number ``count[2]`` on, until none is due that was not looked at before another one was cut.

    The first half of a cell takes its place, the second one comes last. Stops where there is no room for another cut.

    Parameters
    ----------
    nodes, cells, wishes : Nodes, Cells, Wishes
    table : tuple of ndarray
        Nodes by their keys, see `pcontact.mesh.refinement.simplices`.
    edges : ndarray (n_edges, 2) int64
        Local vertices.
    count : ndarray (5,) int64
        Nodes, cells, the cell to begin with, cuts so far, entries of ``told``.
    rule : int
        `LINEAR`, `STRAIGHT`, `CURVED`.
    told : ndarray int32
        Nodes that have become middles of cut edges, and may be of interest to other ranks.

    Returns
    -------
    bool
        Whether it came to the end.
    """
    room = told, np.empty(cells.vertices.shape[1], dtype=np.int32)
    return _cut_on(nodes, cells, wishes, table, edges, count, rule, room)


@njit_inner_exact
def _cut_on(nodes, cells, wishes, table, edges, count, rule, room):
    """The same, with room for what is told, and for the nodes between the middle of an edge and the other vertices."""
    told, across = room
    d1 = cells.vertices.shape[1]
    c = count[2]
    while c < count[1]:
        if not _due(nodes, cells, wishes, c):
            c += 1
            continue
        if (
            count[0] + d1 >= nodes.key.shape[0]
            or count[1] >= cells.base.shape[0]
            or count[4] >= told.shape[0]
            or cells.level[c] >= DEEPEST
        ):
            count[2] = c
            return False
        e = _longest(nodes, cells, c)
        i, j = edges[e, 0], edges[e, 1]
        a, b, m = cells.vertices[c, i], cells.vertices[c, j], cells.middles[c, e]
        if nodes.split[m] == 0:
            nodes.split[m] = 1
            if nodes.shared[a] & nodes.shared[b] != np.uint64(0):
                told[count[4]] = m
                count[4] += 1
        near = _half(nodes, table, count, rule, a, m, b)
        far = _half(nodes, table, count, rule, b, m, a)
        for v in range(d1):
            if v != i and v != j:
                ac, bc = m, m
                for k in range(edges.shape[0]):
                    u, w = edges[k, 0], edges[k, 1]
                    if (u == i and w == v) or (u == v and w == i):
                        ac = cells.middles[c, k]
                    elif (u == j and w == v) or (u == v and w == j):
                        bc = cells.middles[c, k]
                across[v] = _across(nodes, table, count, rule, (a, b, m, cells.vertices[c, v], ac, bc))
        n, level = count[1], cells.level[c]
        for v in range(d1):
            cells.vertices[n, v], cells.facets[n, v] = cells.vertices[c, v], cells.facets[c, v]
        for k in range(edges.shape[0]):
            cells.middles[n, k] = cells.middles[c, k]
        cells.base[n], cells.level[n], cells.path[n] = cells.base[c], level + 1, cells.path[c]
        cells.level[c] = level + 1
        cells.path[n] |= np.uint64(1) << np.uint64(DEEPEST - level)
        _divide_wishes(cells, wishes, c, n, level)
        # the first half has m in place of b, the second one in place of a
        cells.vertices[c, j], cells.vertices[n, i] = m, m
        cells.facets[c, i], cells.facets[n, j] = -1, -1
        for k in range(edges.shape[0]):
            u, w = edges[k, 0], edges[k, 1]
            if k == e:
                cells.middles[c, k], cells.middles[n, k] = near, far
            elif u == j or w == j:
                cells.middles[c, k] = across[w if u == j else u]
            elif u == i or w == i:
                cells.middles[n, k] = across[w if u == i else u]
        count[1] = n + 1
        count[3] += 1
    count[2] = c
    return True


@njit_exact
def take_in(nodes, table, keys):
    """Mark the edges that other ranks have cut, by the keys (n,) of their middles; how many of them are not cut here
    yet."""
    news = 0
    for k in range(keys.shape[0]):
        at = place(table[0], table[1], keys[k])
        n = table[1][at]
        if n == FREE:
            table[0][at], table[1][at] = keys[k], AWAITED
        elif n >= 0 and nodes.split[n] == 0:
            nodes.split[n] = 1
            news += 1
    return news


@njit_exact
def base_middles(nodes, cells, table, edges, count, given):
    """Number the edges of the base: ``cells.middles`` for the first ``count[1]`` cells; in the middles of edges are
    nodes ``given`` (n_cells, n_edges) where these are known, and new ones at the means of the ends where ``given``
    has no columns.
    """
    for c in range(count[1]):
        for e in range(edges.shape[0]):
            a, b = cells.vertices[c, edges[e, 0]], cells.vertices[c, edges[e, 1]]
            key = middle_key(nodes.key[a], nodes.key[b])
            at = place(table[0], table[1], key)
            if table[1][at] == FREE:
                if given.shape[1]:
                    n = given[c, e]
                else:
                    n = count[0]
                    count[0] = n + 1
                    for i in range(nodes.points.shape[1]):
                        nodes.points[n, i] = 0.5 * (nodes.points[a, i] + nodes.points[b, i])
                    for i in range(nodes.groups.shape[1]):
                        nodes.groups[n, i] = 0
                table[0][at], table[1][at] = key, n
                nodes.key[n], nodes.kind[n], nodes.split[n] = key, BASE, 0
                nodes.parents[n, 0], nodes.parents[n, 1] = a, b
                nodes.shared[n] = nodes.shared[a] & nodes.shared[b]
                _measure(nodes, n, a, b)
            cells.middles[c, e] = table[1][at]


@njit_exact
def interpolate(nodes, kind, parents, values):
    """Values (n, k) of a field at some nodes, each after its parents, from those at these."""
    p = parents
    for s in nodes:
        for i in range(values.shape[1]):
            if kind[s] == BASE:
                values[s, i] = 0.5 * (values[p[s, 0], i] + values[p[s, 1], i])
            elif kind[s] == HALF:
                values[s, i] = 0.375 * values[p[s, 0], i] + 0.75 * values[p[s, 1], i] - 0.125 * values[p[s, 2], i]
            else:
                ends, sides = values[p[s, 0], i] + values[p[s, 1], i], values[p[s, 3], i] + values[p[s, 4], i]
                values[s, i] = -0.125 * ends + 0.25 * values[p[s, 2], i] + 0.5 * sides


def grown(array, n):
    """An array with room for n rows, the present ones first."""
    out = np.empty((n, *array.shape[1:]), dtype=array.dtype)
    out[: len(array)] = array
    return out


def rehashed(nodes, n, awaited, room):
    """A table with room for more keys: the first n nodes, and keys that are awaited. Returns table."""
    table = new_table(room + len(awaited))
    enter(*table, awaited, np.full(len(awaited), AWAITED, dtype=np.int32))
    enter(*table, nodes.key[:n], np.arange(n, dtype=np.int32))
    return table


def opposite(cell):
    """Local facet (d + 1,) opposite each vertex of a simplex."""
    facets = [set(facet) for facet in CELLS[cell].facets]
    return np.array([next(k for k, facet in enumerate(facets) if v not in facet) for v in range(len(facets))])


class Forest:
    """Cells that grow from the simplices of a mesh.

    Parameters
    ----------
    base : pcontact.mesh.mesh.Mesh
    cell : str
        "triangle" or "tetrahedron".
    node_groups : ndarray (n_nodes, m) int64
        Bits of the groups of the nodes of the base.
    edge_groups : list of (ndarray (k, 2), int, int)
        Local vertices of the edges of a group, and its column and bit in ``node_groups``.

    Attributes
    ----------
    nodes, cells : Nodes, Cells
        With room; the first ``n_nodes`` and ``n_cells`` count.
    rule : int
    base_nodes : int
        Nodes of the base, which come first.
    """

    def __init__(self, base, cell, node_groups, edge_groups):
        self.cell, self.edges = cell, edge_nodes(cell)
        blocks = [block for block in base.blocks if block.cell == cell]
        self.rule = LINEAR if base.degree == 1 else CURVED if base.curved else STRAIGHT
        table = np.concatenate([block.nodes for block in blocks])
        n, d1, ne = len(table), base.dim + 1, len(self.edges)
        self.base_nodes = len(base.points)
        self._count = np.array([self.base_nodes, n, 0, 0, 0], dtype=np.int64)
        self._told, self._awaited = np.zeros(1024, dtype=np.int32), 0
        self.cells = self._new_cells(n, d1, ne)
        self.cells.vertices[:n] = table[:, :d1]
        self.nodes = self._new_nodes(base, node_groups, n)
        self.table = new_table(len(self.nodes.key))
        first = table[:, :d1].ravel()
        flags = np.zeros(self.base_nodes, dtype=bool)
        flags[first] = True
        numbers = np.flatnonzero(flags)
        enter(*self.table, self.nodes.key[numbers], numbers.astype(np.int32))
        given = np.ascontiguousarray(table[:, d1:])
        base_middles(self.nodes, self.cells, self.table, self.edges, self._count, given)
        for edges, column, bit in edge_groups:
            self._join_edges(edges, column, bit)

    def _new_cells(self, n, d1, ne):
        room = int(ROOM * n) + 64
        cells = Cells(
            np.zeros((room, d1), np.int32), np.zeros((room, ne), np.int32), np.zeros(room, np.int32),
            np.zeros(room, np.uint64), np.zeros(room, np.int32), np.full((room, d1), -1, np.int32),
            np.zeros((room, 2), np.int32),
        )  # fmt: skip
        cells.base[:n] = np.arange(n)
        return cells

    def _new_nodes(self, base, node_groups, n_cells):
        n = self.base_nodes
        # no mesh has more edges than vertices and thrice its cells; room that nothing is written to costs nothing
        room = (2 * n + 3 * n_cells if base.degree == 1 else int(ROOM * n)) + 256
        nodes = Nodes(
            np.zeros(room, np.uint64), np.zeros((room, base.dim)), np.zeros(room, np.int64), np.zeros(room, np.int8),
            np.full((room, 2 if self.rule == LINEAR else 5), -1, np.int32), np.zeros(room, np.uint8),
            np.zeros(room, np.uint64), np.zeros((room, node_groups.shape[1]), np.int64),
        )  # fmt: skip
        nodes.key[:n] = mixed(base.file_nodes)
        nodes.points[:n], nodes.groups[:n] = base.points, node_groups
        return nodes

    def _join_edges(self, edges, column, bit):
        """Let the middles of edges of the base be in a group."""
        ends = self.nodes.parents[: self._count[0], :2].astype(np.int64)
        n = self._count[0]
        keys = np.where(ends[:, 0] >= 0, ends.min(axis=1) * n + ends.max(axis=1), -1)
        chosen = np.isin(keys, edges.min(axis=1) * n + edges.max(axis=1))
        self.nodes.groups[:n][chosen, column] |= np.int64(1) << np.int64(bit)

    @property
    def n_nodes(self):
        """int : nodes so far."""
        return int(self._count[0])

    @property
    def n_cells(self):
        """int : cells so far."""
        return int(self._count[1])

    @property
    def cuts(self):
        """int : cells cut so far."""
        return int(self._count[3])

    def share(self, shared):
        """Take the bits of the neighbours (n_base_nodes,) that have the nodes of the base, too."""
        nodes, n = self.nodes, self.n_nodes
        nodes.shared[: self.base_nodes] = shared
        ends = nodes.parents[:n, :2]
        middle = ends[:, 0] >= 0
        nodes.shared[:n][middle] = shared[ends[middle, 0]] & shared[ends[middle, 1]]

    def grow(self, wishes):
        """Cut what is due. Returns the nodes (n,) in the middle of edges that other ranks may have, too."""
        parts = [np.zeros(0, dtype=np.int64)]
        while True:
            self._count[2] = 0
            before = self.cuts
            while not self._cut(wishes):
                if self.cells.level[self._count[2]] >= DEEPEST:
                    raise InputError(f"found a cell that was to be cut {DEEPEST + 1} times; allowed: {DEEPEST} times")
                parts.append(self._taken())
                self._make_room()
            if self.cuts == before:
                break
        parts.append(self._taken())
        return np.concatenate(parts)

    def _cut(self, wishes):
        return cut_all(self.nodes, self.cells, wishes, self.table, self.edges, self._count, self.rule, self._told)

    def _taken(self):
        told = self._told[: self._count[4]].astype(np.int64)
        self._count[4] = 0
        return told

    def _make_room(self):
        nodes, cells = self.n_nodes, self.n_cells
        if cells >= len(self.cells.base):
            self.cells = Cells(*(grown(array, int(ROOM * cells) + 64) for array in self.cells))
        if nodes + self.cells.vertices.shape[1] >= len(self.nodes.key):
            room = int(ROOM * nodes) + 256
            self.nodes = Nodes(*(grown(array, room) for array in self.nodes))
            self._rehash(room)

    def take_in(self, keys):
        """Mark edges that other ranks have cut, by the keys (n,) of their middles; how many are not cut here yet."""
        self._awaited += len(keys)
        if 2 * (len(self.nodes.key) + self._awaited) > len(self.table[0]):
            self._rehash(len(self.nodes.key))
        return take_in(self.nodes, self.table, keys)

    def _rehash(self, room):
        awaited = self.table[0][self.table[1] == AWAITED]
        self._awaited = len(awaited)
        self.table = rehashed(self.nodes, self.n_nodes, awaited, room + 2 * len(awaited))
