"""How deep nodes of two surfaces are inside each other: the points of the source do not see what is between them."""

import numpy as np

from pcontact.contact.active_set import DEEPER
from pcontact.contact.search.partners import find_partners
from pcontact.contact.search.projection import QueryPoints
from pcontact.contact.surface.sides import target_surface
from pcontact.runtime.petsc import MPI

# [-] So many times as deep as the deepest point a node has to be. From: chosen; what points have, too, is the
# formulation's.
HIDDEN = 1.25


class NodeDepths:
    """Nodes of source and target of a pair, which look for their places on the other surface.

    Parameters
    ----------
    pair : pcontact.contact.pair.ContactPair
        With a target that is a surface of bodies, and another one than the source.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, pair):
        self._pair, self._source = pair, target_surface(pair.space, pair.contact.source)
        size = pair.space.comm.allreduce(np.array([pair.source.size.sum(), len(pair.source.size)]), op=MPI.SUM)
        self._size = size[0] / max(size[1], 1.0)

    def sinks(self, depth, points):
        """Whether a node of the target is so deep [length] that the points, as deep as `points`, do not see it."""
        return depth > max(DEEPER * self._size, HIDDEN * points)

    def of_source(self, u):
        """Depth of the deepest node of the source in the target [length], and its reference position (d,); 0 where none
        is inside. *Collective.*"""
        p, source = self._pair.pairing, self._pair.source
        near = np.flatnonzero(self._pair.rows.coupled)
        own = p.cells[source.facet[near]]
        return self._deepest(u, self._pair.search.target, np.where(source.shape[near] != 0.0, own, -1), p.normal[near])

    def of_target(self, u):
        """The same of the nodes of the target in the source. *Collective.*"""
        p, near = self._pair.pairing, np.flatnonzero(self._pair.rows.coupled)
        return self._deepest(u, self._source, p.targets[near], -p.normal[near])

    def _deepest(self, u, surface, nodes, normal):
        """Deepest of some nodes (n, m) of the pair (-1: none) of points with outward normals (n, d) in a surface."""
        pair, space = self._pair, self._pair.space
        local = np.zeros((len(pair.pairing.exchange.nodes), space.dim))
        for column in nodes.T:
            some = column >= 0
            np.add.at(local, column[some], normal[some])
        # a node has the mean normal of the points around it
        normal = space.summed(pair.pairing.exchange, local)
        length = np.linalg.norm(normal, axis=1)
        owned = np.flatnonzero(length > 0.0)
        x = space.points[space.owned_local[owned]]
        moved = u.getArray(readonly=True).reshape(-1, space.dim)[owned]
        query = QueryPoints((x - pair.search.origin) + moved, normal[owned] / length[owned, None], pair.radius)
        found = find_partners(space, surface, space.local.gather(u), query, "closest_point", pair.search.origin)
        depth = np.where(found.id >= 0, -found.gap, 0.0)
        k = int(np.argmax(depth)) if len(depth) else -1
        deepest = (float(depth[k]), x[k]) if k >= 0 else (0.0, np.zeros(space.dim))
        return max(space.comm.allgather(deepest), key=lambda entry: entry[0])


def node_depths(contact, pairs):
    """The :class:`NodeDepths` of a contact with one pair; None where the target is rigid, its own source, or has points
    of its own, and where gaps are not those of the facets. *Collective.*"""
    pair = pairs[0]
    given = contact.clearance is not None or contact.interference_amplitude is not None
    other = given or contact.interference == "adjust" or contact.smooth_geometry
    if len(pairs) > 1 or pair.rigid or pair.law.tied or contact.target == contact.source or contact.all or other:
        return None
    return NodeDepths(pair)
