"""Facets that two cells share, and what the cell on the other side says there, on any rank."""

from functools import cache

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_nodes, shape
from pcontact.runtime.petsc import MPI


def facet_rule(cell, degree):
    """Quadrature points and weights of the facets of a cell for a displacement of a degree."""
    return quadrature(CELLS[cell].facet, 2 * degree + 2)


@cache
def _common_order(kind, degree, order):
    """Points of a facet in an order that does not depend on which cell looks at it.

    Points are sorted by their shape functions of degree 1 at the vertices, the vertices by their global numbers
    (``order`` sorts them).
    """
    xi, _ = quadrature(kind, 2 * degree + 2)
    weights = np.round(shape(kind, 1, xi)[:, list(order)], 9)
    return np.lexsort(weights.T)


class FacetPairs:
    """All facets of this rank's cells, and who is on the other side of each.

    Facets are numbered block after block, cell after cell, each cell's in their local order.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Attributes
    ----------
    first : ndarray (n_blocks + 1,)
        First facet of each block.
    points : ndarray (n_blocks + 1,)
        First point of each block: every facet has those of :func:`facet_rule`.
    inner : ndarray (n,) of bool
        Facets with a cell on the other side.
    other : ndarray (n_points,) of int
        Row of :meth:`room` that has the other side of each point, -1 where there is none.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space):
        self.space = space
        blocks, width = space.mesh.blocks, 2 if space.dim == 2 else 4
        ones = np.zeros((space.n_local, space.dim))
        ones[:, 0] = 1.0
        shared = space.together(ones)[:, 0] > 1.5
        keys, border, self._order = [], [], []
        self.first = np.cumsum([0, *(len(b.nodes) * len(CELLS[b.cell].facets) for b in blocks)])
        for block, cells in zip(blocks, space.cells, strict=True):
            corners = cells[:, facet_nodes(block.cell, 1)].reshape(-1, CELLS[CELLS[block.cell].facet].n_vertices)
            numbers = space.nodes[corners]
            order = np.argsort(numbers, axis=1)
            key = np.full((len(corners), width), -1, dtype=np.int64)
            key[:, : corners.shape[1]] = np.take_along_axis(numbers, order, axis=1)
            keys.append(key)
            border.append(shared[corners].all(axis=1))
            self._order.append(order)
        self._keys = np.concatenate([np.zeros((0, width), np.int64), *keys])
        border = np.concatenate([np.zeros(0, bool), *border])
        self._first, self._second, alone = _pairs(self._keys)
        self._border = np.sort(alone[border[alone]])
        self.inner = np.zeros(len(self._keys), dtype=bool)
        self.inner[self._first] = self.inner[self._second] = True
        self._number_points()

    def _number_points(self):
        """Say where the other side of each point is."""
        space, blocks = self.space, self.space.mesh.blocks
        count = np.array([len(facet_rule(block.cell, space.degree)[1]) for block in blocks], dtype=np.int64)
        self.points = np.cumsum([0, *(count * np.diff(self.first))])
        width = int(space.comm.allreduce(max(count, default=0), op=MPI.MAX))
        # rows of the points of each facet, in an order that is common to both sides
        places = np.full((len(self._keys), width), -1, dtype=np.int64)
        for number, block in enumerate(blocks):
            own = places[self.first[number] : self.first[number + 1], : count[number]]
            start = self.points[number] + count[number] * np.arange(len(own))
            for code, rows in _alike(CELLS[block.cell].facet, self._order[number]):
                own[rows] = start[rows, None] + _common_order(CELLS[block.cell].facet, space.degree, code)
        self.other = np.full(self.points[-1] + 1, -1, dtype=np.int64)
        one, two = places[self._first].ravel(), places[self._second].ravel()
        self.other[one], self.other[two] = two, one
        # those of fewer points than others, whose rows -1 stand for none
        self.other = self.other[:-1]
        self._places = places[self._border]
        if space.comm.size > 1:
            rows, _ = self._meet(np.zeros((len(self._border), 0)))
            self.inner[rows] = True
            beyond = self.points[-1] + np.arange(self._places.size).reshape(self._places.shape)
            known = self.inner[self._border][:, None] & (self._places >= 0)
            self.other[self._places[known]] = beyond[known]

    def room(self, d):
        """Table (n_points and more, d) for values at the points of all facets: those of blocks from their row in
        `points` on, the rest for :meth:`meet`."""
        return np.empty((self.points[-1] + self._places.size, d))

    def meet(self, table):
        """Let the rest of a table of :meth:`room` have what other ranks say on the other side. *Collective.*"""
        if self.space.comm.size == 1:
            return
        n, (border, width) = self.points[-1], self._places.shape
        # facets of fewer points than others take any in the place of those that they do not have
        own = table[:n][self._places]
        rows, found = self._meet(own.reshape(border, width * table.shape[1]))
        table[n:].reshape(border, width * table.shape[1])[np.searchsorted(self._border, rows)] = found

    def other_side(self, values):
        """Values (n, k) of the cell on the other side of every facet, of those of this rank's cells; zero where there
        is no other cell. *Collective.*"""
        out = np.zeros_like(values)
        out[self._first], out[self._second] = values[self._second], values[self._first]
        if self.space.comm.size > 1:
            rows, found = self._meet(values[self._border])
            out[rows] = found
        return out

    def _meet(self, values):
        """Facets between ranks, and values (m, k) there: each rank tells a third one, which a facet's vertices name,
        those (n, k) of its facets that may be between ranks, and it passes on. *Collective.*"""
        space, exchanger, rows = self.space, self.space.exchanger, self._border
        keys, width = self._keys[rows], self._keys.shape[1]
        home = keys[:, 0] * space.comm.size // space.numbering.n_total
        table = np.concatenate([keys, rows[:, None], values], axis=1)
        order = np.argsort(home, kind="stable")
        ranks, starts = np.unique(home[order], return_index=True)
        pieces = np.split(table[order], starts[1:]) if len(ranks) else []
        told = exchanger(dict(zip(ranks.tolist(), pieces, strict=True)), np.float64, table.shape[1])
        sources = np.concatenate([np.zeros(0, np.int64), *(np.full(len(t), r) for r, t in told.items())])
        joined = np.concatenate([np.zeros((0, table.shape[1])), *told.values()])
        a, b, _ = _pairs(joined[:, :width].astype(np.int64))
        to, what = np.concatenate([sources[a], sources[b]]), np.concatenate([b, a])
        answer = joined[what][:, width:].copy()
        answer[:, 0] = joined[np.concatenate([a, b]), width]
        replies = {int(r): answer[to == r] for r in np.unique(to)}
        got = exchanger(replies, np.float64, answer.shape[1])
        found = np.concatenate([np.zeros((0, answer.shape[1])), *got.values()])
        return found[:, 0].astype(np.int64), found[:, 1:]


def _alike(kind, order):
    """The orders of vertices that facets of a kind have, with the facets: a list of (tuple, ndarray)."""
    code = order @ (CELLS[kind].n_vertices ** np.arange(order.shape[1]))
    found = [np.flatnonzero(code == one) for one in np.unique(code)]
    return [(tuple(order[rows[0]].tolist()), rows) for rows in found]


def _pairs(keys):
    """Rows that are there twice: the two row numbers (m,), (m,), and the rows (k,) that are there once."""
    if not len(keys):
        none = np.zeros(0, dtype=np.int64)
        return none, none, none
    order = np.lexsort(keys.T[::-1])
    same = (keys[order][1:] == keys[order][:-1]).all(axis=1)
    start = np.flatnonzero(same)
    alone = np.ones(len(keys), dtype=bool)
    alone[start], alone[start + 1] = False, False
    return order[start], order[start + 1], order[alone]
