"""A surface that is its own target: what its points and facets need to know to tell neighbours from partners."""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from pcontact.contact.apart import SLACK, nobody, whole_branches, writable
from pcontact.contact.surface import FACETS, TargetSurface
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI

# columns of the table before the nodes
NODES = 4


@dataclass
class SelfSurface(TargetSurface):
    """Facets of one rank, with those of other ranks around them.

    Attributes
    ----------
    table : ndarray (nf, 4 + m)
        Of each facet: cell, connected body, slack [length], sides (see `pcontact.contact.apart`), global nodes.
    rim : Rim
    about : ndarray (np, d + 4 + m) or None
        Of each point that looks for a partner: its place in the undeformed body, and the row of its facet.
    meets_itself : bool
        Whether a body is its own partner.
    """

    table: np.ndarray = field(default=None)
    rim: object = None
    about: np.ndarray | None = None
    meets_itself: bool = True

    def seen_from(self, facet, x):
        """The surface as points x (n, d) of its own facets (n,) see it in the undeformed body."""
        return replace(self, about=np.column_stack([x, self.table[facet]]))

    def around(self, x_facets):
        """Deformed coordinates, kinds, numbers, ownership and nodes of the facets here and of the rim. *Collective.*

        The rim decides with the others whether a projection is held at an edge, as if all facets were on one rank, but
        holds no partner itself.
        """
        rim = self.rim
        x = np.ascontiguousarray(np.concatenate([x_facets, rim.gather(x_facets)]))
        kinds, ids = np.concatenate([self.kinds, rim.kinds]), np.concatenate([self.ids, rim.ids])
        nodes = np.concatenate([self.table, rim.table])[:, NODES:].astype(np.int64)
        return x, kinds, ids, np.arange(len(x)) < len(x_facets), nodes

    def may_meet(self, own, other, ahead):
        """See :meth:`TargetSurface.may_meet`: a body does not meet itself through its material."""
        return (own != other) | ((ahead > 0.0) if self.meets_itself else False)

    def bodies(self):
        """Bodies of the facets of :meth:`around` if they are no partners of themselves, else None."""
        return None if self.meets_itself else np.concatenate([self.table, self.rim.table])[:, 1]

    def apart(self, tree):
        """Where the facets of :meth:`around`, in a tree, are in the undeformed bodies; without points."""
        table = np.concatenate([self.table, self.rim.table])
        whole = np.zeros(0) if self.meets_itself else whole_branches(tree, table[:, 1])
        facets = nobody(self.x.shape[2])._replace(
            facet_x=np.concatenate([self.x, self.rim.x]), facet_cells=table[:, 0], facet_parts=table[:, 1],
            facet_nodes=table[:, NODES:], facet_sides=table[:, 3], whole=whole,
        )  # fmt: skip
        return writable(facets)

    def placed(self, apart, about):
        """The same with points of any rank, from their rows of :attr:`about`."""
        d = self.x.shape[2]
        point = about[:, d:]
        points = {"cells": point[:, 0], "parts": point[:, 1], "slack": point[:, 2], "sides": point[:, 3]}
        return writable(apart._replace(x=about[:, :d], nodes=point[:, NODES:], **points))


class Rim:
    """Facets of other ranks that share a node with one of this rank's, and the plan that brings their coordinates.

    Parameters
    ----------
    space : pcontact.space.space.Space
    surface : SelfSurface
        Its ``x`` and ``table`` have the same width on all ranks.

    Attributes
    ----------
    kinds, ids, x, table
        As those of the surface.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, space, surface):
        self._exchanger = space.exchanger
        nodes = surface.table[:, NODES:].astype(np.int64)
        shared = neighbours(space, nodes)
        self._rows = {rank: np.flatnonzero(np.isin(nodes, there).any(axis=1)) for rank, there in shared.items()}
        statics = np.column_stack([surface.kinds, surface.ids, surface.table]).astype(float)
        columns = self._bring(statics)
        self.kinds, self.ids = (np.ascontiguousarray(columns[:, k].astype(np.int64)) for k in (0, 1))
        self.table = columns[:, 2:]
        self.x = self.gather(surface.x)

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


def _shortest(x):
    """Shortest distance (nf,) between two nodes of facets (nf, m, d), some of which may be there twice."""
    distance = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    return np.min(np.where(distance > 0.0, distance, np.inf), axis=(1, 2), initial=np.inf)


def self_surface(space, target, source, meets_itself=True, sides=None):
    """A target surface whose facets are also those of the source. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    target : TargetSurface
    source : SourceSurface
        Of the same facet group.
    meets_itself : bool
        Whether a body is its own partner.
    sides : ndarray (nf,), optional
        Surfaces of other pairs that the facets are in, see `pcontact.contact.apart.clash`.

    Returns
    -------
    SelfSurface
        As the points of the source see it.
    """
    widths = [int(space.comm.allreduce(table.shape[1], op=MPI.MAX)) for table in (target.x, target.nodes)]
    x = np.pad(target.x, ((0, 0), (0, widths[0] - target.x.shape[1]), (0, 0)), mode="edge")
    nodes = np.pad(target.nodes, ((0, 0), (0, widths[1] - target.nodes.shape[1])), mode="edge")
    corners = space.points[source.cells]
    behind = np.einsum("pad,pd->pa", source.x[:, None] - corners[source.facet], source.normal)
    depth = np.full(len(source.cells), np.inf)
    np.minimum.at(depth, source.facet, behind.max(axis=1, initial=0.0))
    slack = SLACK * np.minimum(_shortest(space.points[nodes]), depth)
    sides = np.zeros(len(nodes)) if sides is None else sides
    table = np.column_stack([target.ids // FACETS, target.components, slack, sides, space.nodes[nodes]]).astype(float)
    said = {one.name: getattr(target, one.name) for one in fields(TargetSurface)}
    said.update(x=np.ascontiguousarray(x), nodes=nodes, table=table, meets_itself=meets_itself)
    surface = SelfSurface(**said)
    surface.rim = Rim(space, surface)
    return surface.seen_from(source.facet, source.x)
