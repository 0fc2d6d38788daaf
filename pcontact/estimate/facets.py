"""Which facets are shared by two cells, and what the cell on the other side says there, on any rank."""

from functools import cache

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.element.shape import shape


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
    inner : ndarray (n,) of bool
        Facets with a cell on the other side; known after :meth:`other_side`.

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
        keys, border, self._order, self._codes = [], [], [], {}
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
        self._border = alone[border[alone]]
        self.inner = np.zeros(len(self._keys), dtype=bool)

    def canonical(self, number, values, back=False):
        """Values (nc, nf, nq, k) at the points of a block's facets, from the cells' order to the common one.

        Parameters
        ----------
        number : int
            Block.
        values : ndarray
        back : bool
            The other way round.
        """
        block = self.space.mesh.blocks[number]
        kind = CELLS[block.cell].facet
        flat = values.reshape(-1, *values.shape[2:])
        out = np.empty_like(flat)
        for code, rows in self._alike(number, kind):
            points = _common_order(kind, self.space.degree, code)
            if back:
                points = np.argsort(points)
            out[rows] = flat[rows[:, None], points]
        return out.reshape(values.shape)

    def _alike(self, number, kind):
        """The orders of vertices that facets of a block have, with the facets: a list of (tuple, ndarray)."""
        if number not in self._codes:
            order = self._order[number]
            code = order @ (CELLS[kind].n_vertices ** np.arange(order.shape[1]))
            found = [np.flatnonzero(code == one) for one in np.unique(code)]
            self._codes[number] = [(tuple(order[rows[0]].tolist()), rows) for rows in found]
        return self._codes[number]

    def other_side(self, values):
        """Values of the cell on the other side of every facet. *Collective.*

        Parameters
        ----------
        values : ndarray (n, k)
            In an order common to both sides; all ranks have the same k.

        Returns
        -------
        ndarray (n, k)
            Zero where there is no other cell.
        """
        out = np.zeros_like(values)
        out[self._first], out[self._second] = values[self._second], values[self._first]
        self.inner[self._first] = self.inner[self._second] = True
        comm = self.space.comm
        if comm.size > 1:
            rows, found = self._meet(values)
            out[rows] = found
            self.inner[rows] = True
        return out

    def _meet(self, values):
        """Facets between ranks: each rank tells a third one, which a facet's vertices name, and it passes on."""
        space, exchanger, rows = self.space, self.space.exchanger, self._border
        keys, width = self._keys[rows], self._keys.shape[1]
        home = keys[:, 0] * space.comm.size // space.numbering.n_total
        table = np.concatenate([keys, rows[:, None], values[rows]], axis=1)
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
