"""How far nodes are from the ends of their body, in cells, along which long and bent bodies are cut across; and from
the place where its cells are densest, around which few cells are cut.

Distances are whole numbers, found level by level on all ranks together, and do not depend on which rank has which cell.
"""

import numpy as np

from pcontact.mesh.planes import MOMENT_BITS, moments, reduced
from pcontact.runtime.jit import njit
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI

# ends of each connected component from which distances are taken
ENDS = 2
# numbers of cells are below 2^NUMBER
NUMBER = 40


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
def _grow(table, offsets, cells, seen, level, queue, first, end, steps):
    """Give the nodes of cells around those of the queue from first to end their levels; so many steps, or all (-1).

    Returns where the new nodes begin and end in the queue.
    """
    while first < end and steps != 0:
        last = end
        for k in range(first, last):
            node = queue[k]
            for at in range(offsets[node], offsets[node + 1]):
                c = cells[at]
                if seen[c]:
                    continue
                seen[c] = True
                for v in range(table.shape[1]):
                    other = table[c, v]
                    if level[other] < 0:
                        level[other] = level[node] + 1
                        queue[end] = other
                        end += 1
        first = last
        steps -= 1
    return first, end


def _sharing(exchanger, starts, nodes):
    """Local nodes that other ranks have too, and which (n,), (n,). *Collective.*

    nodes (n_nodes,): places, ascending; `starts`: whose rank keeps the books about which places.
    """
    rank = exchanger.comm.rank
    cuts = np.searchsorted(nodes, starts)
    sends = {r: nodes[cuts[r] : cuts[r + 1]] for r in range(len(starts) - 1) if cuts[r + 1] > cuts[r]}
    asked = exchanger(sends, np.int64, 1)
    none = np.zeros(0, dtype=np.int64)
    place = np.concatenate([none, *(a.ravel() for a in asked.values())])
    owner = np.concatenate([none, *(np.full(len(a), r) for r, a in asked.items())])
    order = np.argsort(place, kind="stable")
    place, owner = place[order], owner[order]
    rows, shift = [np.zeros((0, 3), dtype=np.int64)], 1
    while len(same := np.flatnonzero(place[shift:] == place[:-shift])):
        a, b = owner[same], owner[same + shift]
        rows += [np.column_stack([a, place[same], b]), np.column_stack([b, place[same], a])]
        shift += 1
    rows = np.concatenate(rows)
    replies, _ = split_by_rank(rows[:, 0], rows[:, 1:])
    answers = exchanger(replies, np.int64, 2)
    table = np.concatenate([np.zeros((0, 2), dtype=np.int64), *answers.values()])
    table = table[table[:, 1] != rank]
    return np.searchsorted(nodes, table[:, 0]), table[:, 1]


@njit
def _radii(points, table, component, middles, out):
    """Distance of the vertices of cells from the middle of their component."""
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            total = 0.0
            for i in range(middles.shape[1]):
                total += (points[table[c, v], i] - middles[component[c], i]) ** 2
            out[table[c, v]] = np.sqrt(total)


class Depths:
    """Distances of the nodes of the cells of this rank.

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    piece : pcontact.mesh.slices.MeshSlice
    nodes : ndarray (n_nodes,)
        Places of the nodes, ascending.
    tables : list of ndarray (n, k)
        Vertices of the cells, by their positions in ``nodes``, for every block.
    """

    def __init__(self, exchanger, piece, nodes, tables):
        self._exchanger, self.comm, self._nodes = exchanger, piece.comm, nodes
        width = max(table.shape[1] for table in tables)
        # a vertex twice does no harm
        padded = [table[:, np.minimum(np.arange(width), table.shape[1] - 1)] for table in tables if len(table)]
        self._table = np.concatenate([np.zeros((0, width), dtype=np.int64), *padded])
        self._around = _cells_of_nodes(self._table, len(nodes))
        self._ids, self._component, self._count = piece.ids, piece.component, piece.n_components
        alone = self.comm.allreduce(int(len(self._ids) > 0)) <= 1
        self._shared = None if alone else _sharing(exchanger, piece.point_starts, nodes)

    def _ends(self, distance):
        """One cell (rows of those of this rank) of every component: the farthest, the first of them. *Collective.*"""
        key = (distance << NUMBER) + (2**NUMBER - 1 - self._ids)
        best = np.full(self._count, -1, dtype=np.int64)
        np.maximum.at(best, self._component, key)
        return np.flatnonzero(reduced(self.comm, best, MPI.MAX)[self._component] == key)

    def _from(self, rows):
        """Levels (n_nodes,) of all nodes, 0 at those of some cells. *Collective.*"""
        n = len(self._nodes)
        level, queue, seen = np.full(n, -1, dtype=np.int64), np.empty(n, dtype=np.int64), np.zeros(len(self._ids), bool)
        start = np.unique(self._table[rows])
        level[start], queue[: len(start)] = 0, start
        first, end = 0, len(start)
        if self._shared is None:
            _grow(self._table, *self._around, seen, level, queue, first, end, -1)
            return level
        end = self._told(level, queue, 0, end)
        while self.comm.allreduce(end - first):
            first, end = _grow(self._table, *self._around, seen, level, queue, first, end, 1)
            end = self._told(level, queue, first, end)
        return level

    def _told(self, level, queue, first, end):
        """Tell other ranks of new nodes (first to end in the queue) that they have, too; the new end. *Collective.*"""
        local, ranks = self._shared
        fresh = np.zeros(len(level), dtype=bool)
        fresh[queue[first:end]] = True
        chosen = np.flatnonzero(fresh[local])
        rows = np.column_stack([self._nodes[local[chosen]], level[local[chosen]]])
        received = self._exchanger(split_by_rank(ranks[chosen], rows)[0], np.int64, 2)
        for table in received.values():
            at = np.searchsorted(self._nodes, table[:, 0])
            new = level[at] < 0
            level[at[new]] = table[new, 1]
            queue[end : end + new.sum()] = at[new]
            end += int(new.sum())
        return end

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
