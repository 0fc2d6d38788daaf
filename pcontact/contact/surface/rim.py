"""Facets of other ranks around those of this one.

Whether a projection is held at an edge, and on which side of the surface a point is there, is decided by all facets
that share the edge. A rank that knows the neighbours of its facets decides as if it had the whole surface, so that
partners do not depend on the ranks.
"""

import numpy as np

from pcontact.runtime.parallel import split_by_rank


class Rim:
    """Facets of other ranks that share a node with one of this rank's, and the plan that brings their coordinates.

    Parameters
    ----------
    space : pcontact.space.space.Space
    nodes : ndarray (nf, m)
        Global nodes of this rank's facets.
    kinds, ids : ndarray (nf,)
        As of `pcontact.contact.surface.sides.TargetSurface`.
    x : ndarray (nf, n, d)
        Reference coordinates [length], of the same width on all ranks.
    table : ndarray (nf, k), optional
        What else is to be known of them, of the same width on all ranks.

    Attributes
    ----------
    kinds, ids, x, table
        Of the facets of other ranks.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, space, nodes, kinds, ids, x, table=None):
        self._exchanger = space.exchanger
        shared = neighbours(space, nodes)
        table = np.zeros((len(kinds), 0)) if table is None else table
        self._rows = {rank: np.flatnonzero(np.isin(nodes, there).any(axis=1)) for rank, there in shared.items()}
        statics = np.column_stack([kinds, ids, table]).astype(float)
        columns = self._bring(statics)
        self.kinds, self.ids = (np.ascontiguousarray(columns[:, k].astype(np.int64)) for k in (0, 1))
        self.table = columns[:, 2:]
        self.x = self.gather(x)

    def _bring(self, values):
        """Rows (n, columns) of the rim out of those of all ranks' surfaces (nf, columns). *Collective.*"""
        sends = {rank: values[rows] for rank, rows in self._rows.items()}
        received = self._exchanger(sends, np.float64, values.shape[1])
        return np.concatenate([np.zeros((0, values.shape[1])), *received.values()])

    def gather(self, x_facets):
        """Coordinates (n, m, d) of the rim's facets. *Collective.*"""
        shape = x_facets.shape[1:]
        return self._bring(x_facets.reshape(len(x_facets), shape[0] * shape[1])).reshape(-1, *shape)


def neighbours(space, nodes):
    """Other ranks whose facets have nodes of these (nf, m), and which, by rank. *Collective.*

    The owner of a node hears of all ranks that have facets with it and tells each of them of the others.
    """
    mine = np.unique(nodes)
    sends, _ = split_by_rank(space.numbering.owner(mine), mine)
    heard = space.exchanger(sends, np.int64, 1)
    node = np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in heard.values())])
    rank = np.concatenate([np.zeros(0, np.int64), *(np.full(len(part), r) for r, part in heard.items())])
    order = np.argsort(node, kind="stable")
    node, rank = node[order], rank[order]
    _, first, place, count = np.unique(node, return_index=True, return_inverse=True, return_counts=True)
    # every rank of a node with every other
    one = np.repeat(np.arange(len(node)), count[place])
    start = np.cumsum(count[place]) - count[place]
    other = first[place[one]] + np.arange(len(one)) - start[one]
    pairs = np.column_stack([node[one], rank[other]])[rank[one] != rank[other]]
    sends, _ = split_by_rank(rank[one][rank[one] != rank[other]], pairs)
    told = space.exchanger(sends, np.int64, 2)
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *told.values()])
    return split_by_rank(pairs[:, 1], pairs[:, 0])[0]
