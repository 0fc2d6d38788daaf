"""The trees of cells that grow from the triangles or tetrahedra of a base, each rank those of its own cells."""

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes
from pcontact.mesh.refinement.keys import AWAITED, enter, new_table, vertex_keys
from pcontact.mesh.refinement.simplices import (
    CURVED,
    DEEPEST,
    LINEAR,
    STRAIGHT,
    Cells,
    Nodes,
    base_middles,
    cut_all,
    grown,
    rehashed,
    take_in,
)
from pcontact.runtime.errors import InputError

# rows that arrays have room for, over what is there
ROOM = 1.5


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
        vertex_keys(base.file_nodes, nodes.key)
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
