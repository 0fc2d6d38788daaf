"""How far nodes are from the ends of their body, in cells, along which long and bent bodies are cut across; and from
the place where its cells are densest, around which few cells are cut.

Distances are whole numbers, found by all ranks together, and do not depend on which rank has which cell.
"""

import numpy as np

from pcontact.mesh.planes import MOMENT_BITS, moments, reduced
from pcontact.mesh.plex import least_told, owners
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI

# ends of each connected component from which distances are taken
ENDS = 2
# numbers of cells are below 2^NUMBER
NUMBER = 40
# the level of a node that has not been reached
FAR = np.int64(2**20)


@njit
def _cells_of_nodes(table, n_nodes):
    """Cells around every node: offsets (n_nodes + 1,), cells."""
    offsets = np.zeros(n_nodes + 2, dtype=np.int64)
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            offsets[table[c, v] + 2] += 1
    for k in range(n_nodes):
        offsets[k + 2] += offsets[k + 1]
    cells = np.empty(table.size, dtype=np.int32)
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            node = table[c, v]
            cells[offsets[node + 1]] = c
            offsets[node + 1] += 1
    return offsets[:-1], cells


@njit
def _spread(table, offsets, cells, expanded, level, waiting, start):
    """Lower the levels of nodes to one more than those of nodes with a common cell, beginning at some nodes.

    expanded (n_cells,): level from which a cell was last seen. waiting (n_nodes,) bool: in the queue.
    """
    size = level.shape[0] + 1
    queue = np.empty(size, dtype=np.int64)
    first, end = 0, 0
    for node in start:
        if not waiting[node]:
            waiting[node] = True
            queue[end] = node
            end += 1
    while first != end:
        node = queue[first]
        first = (first + 1) % size
        waiting[node] = False
        here = level[node]
        for at in range(offsets[node], offsets[node + 1]):
            c = cells[at]
            if expanded[c] <= here:
                continue
            expanded[c] = here
            for v in range(table.shape[1]):
                other = table[c, v]
                if level[other] > here + 1:
                    level[other] = here + 1
                    if not waiting[other]:
                        waiting[other] = True
                        queue[end] = other
                        end = (end + 1) % size


@njit
def _radii(points, table, component, middles, out):
    """Distance of the vertices of cells from the middle of their component."""
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            total = 0.0
            for i in range(middles.shape[1]):
                total += (points[table[c, v], i] - middles[component[c], i]) ** 2
            out[table[c, v]] = np.sqrt(total)


class CellDistances:
    """Distances of the nodes of the cells of this rank.

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
    nodes : ndarray (n_nodes,)
        Places of the nodes, ascending.
    tables : list of ndarray (n, k)
        Vertices of the cells, by their positions in ``nodes``, for every block.
    """

    def __init__(self, piece, nodes, tables):
        self.comm = piece.comm
        width = max(table.shape[1] for table in tables)
        if len(tables) == 1:
            self._table = np.ascontiguousarray(tables[0])
        else:
            # a vertex twice does no harm
            padded = [table[:, np.minimum(np.arange(width), table.shape[1] - 1)] for table in tables]
            self._table = np.concatenate(padded)
        self._n_nodes = len(nodes)
        self._around = _cells_of_nodes(self._table, len(nodes))
        self._ids, self._component, self._count = piece.ids, piece.component, piece.n_components
        alone = self.comm.allreduce(int(len(self._ids) > 0)) <= 1
        self._sf = None if alone else owners(self.comm, nodes, piece.n_nodes_total)

    def _ends(self, distance):
        """One cell (rows of those of this rank) of every component: the farthest, the first of them. *Collective.*"""
        key = (distance << NUMBER) + (2**NUMBER - 1 - self._ids)
        best = np.full(self._count, -1, dtype=np.int64)
        np.maximum.at(best, self._component, key)
        return np.flatnonzero(reduced(self.comm, best, MPI.MAX)[self._component] == key)

    def _from(self, rows):
        """Levels (n_nodes,) of all nodes, 0 at those of some cells. *Collective.*

        Every rank goes as far as it can by itself; nodes of several ranks then have the least of their levels, until
        none is lowered any more.
        """
        n = self._n_nodes
        level, expanded = np.full(n, FAR), np.full(len(self._ids), FAR)
        waiting = np.zeros(n, dtype=bool)
        start = np.unique(self._table[rows])
        level[start] = 0
        while True:
            _spread(self._table, *self._around, expanded, level, waiting, start)
            if self._sf is None:
                return level
            least = least_told(self._sf, level)
            start = np.flatnonzero(least < level)
            start, level = start[np.argsort(least[start], kind="stable")], least
            if not self.comm.allreduce(len(start)):
                return level

    def radii(self, points, centres, box):
        """Distances (n_nodes,) [length] from the middle of the component, which is where most cells are. *Collective.*

        Parameters
        ----------
        points : ndarray (n_nodes, d)
        centres : ndarray (n, d)
            Of the cells.
        box : ndarray (d,), ndarray (d,)
            Around all of them.
        """
        low, span = box[0], float(np.max(box[1] - box[0])) or 1.0
        d = points.shape[1]
        sums = np.zeros((self._count, 1 + d + d * d), dtype=np.int64)
        moments(self._component, ((centres - low) * (2**MOMENT_BITS / span)).astype(np.int64), sums)
        sums = reduced(self.comm, sums, MPI.SUM)
        middles = low + sums[:, 1 : 1 + d] / np.maximum(sums[:, :1], 1) * (span / 2**MOMENT_BITS)
        out = np.zeros(len(points))
        _radii(points, self._table, self._component, middles, out)
        return out

    def __call__(self):
        """Distances (n_nodes, ENDS) from ends of the components, each far from those before. *Collective.*"""
        zero = np.zeros(len(self._ids), dtype=np.int64)
        level = self._from(self._ends(zero))
        levels, least = [], None
        for _ in range(ENDS):
            near = level if least is None else least
            level = self._from(self._ends(near[self._table].sum(axis=1) if len(self._table) else zero))
            levels.append(level)
            least = level if least is None else np.minimum(least, level)
        return np.column_stack(levels)
