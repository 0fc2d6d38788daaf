"""A surface that is its own target: what its points and facets need to know to tell neighbours from partners.

Contact of all surfaces has the whole boundary of all bodies as one surface that is source and target. One item, one
search and one tree per rank serve all bodies, however many there are; which of them touch is what the search finds.
Other pairs of the scene come first: two surfaces that a pair brings together are no partners here, but each of them
meets all others. Facets that carry a load, or whose nodes have a prescribed displacement along the normal (with
friction: any), have a traction that is not that of contact alone: they take part without it, as in the penalty method.
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from pcontact.contact.search.exclusion import SLACK, no_exclusion, whole_branches, writable
from pcontact.contact.surface.facet_maps import padded
from pcontact.contact.surface.sides import FACETS, Rim, TargetSurface
from pcontact.mesh.mesh import Facets
from pcontact.mesh.topology import outer_facets
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import OUTER
from pcontact.space.modes import component_boxes, near_pairs

# columns of the table before the nodes
NODES = 4


@dataclass
class SelfSurface(TargetSurface):
    """Facets of one rank, with those of other ranks around them.

    Attributes
    ----------
    table : ndarray (nf, 4 + m)
        Of each facet: cell, connected body, slack [length], sides (`pcontact.contact.search.exclusion`), global nodes.
    rim : Rim
    about : ndarray (np, d + 4 + m) or None
        Of each point that looks for a partner: its place in the undeformed body, and the row of its facet.
    meets_itself : bool
        Whether a body is its own partner.
    """

    table: np.ndarray = field(default=None)
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
        *others, _ = super().around(x_facets)
        return *others, np.concatenate([self.table, self.rim.table])[:, NODES:].astype(np.int64)

    def may_meet(self, own, other, ahead):
        """See :meth:`TargetSurface.may_meet`: a body does not meet itself through its material."""
        return (own != other) | ((ahead > 0.0) if self.meets_itself else False)

    def bodies(self):
        """Bodies of the facets of :meth:`around` if they are no partners of themselves, else None."""
        return None if self.meets_itself else np.concatenate([self.table, self.rim.table])[:, 1]

    def exclusion(self, tree):
        """Places of the facets of :meth:`around`, in a tree, in the undeformed bodies; without points."""
        table = np.concatenate([self.table, self.rim.table])
        whole = np.zeros(0) if self.meets_itself else whole_branches(tree, table[:, 1])
        facets = no_exclusion(self.x.shape[2])._replace(
            facet_x=np.concatenate([self.x, self.rim.x]), facet_cells=table[:, 0], facet_parts=table[:, 1],
            facet_nodes=table[:, NODES:], facet_sides=table[:, 3], whole=whole,
        )  # fmt: skip
        return writable(facets)

    def placed(self, exclusion, about):
        """The same with points of any rank, from their rows of :attr:`about`."""
        d = self.x.shape[2]
        point = about[:, d:]
        points = {"cells": point[:, 0], "parts": point[:, 1], "slack": point[:, 2], "sides": point[:, 3]}
        return writable(exclusion._replace(x=about[:, :d], nodes=point[:, NODES:], **points))


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
        Surfaces of other pairs that the facets are in, see `pcontact.contact.search.exclusion.clash`.

    Returns
    -------
    SelfSurface
        As the points of the source see it.
    """
    widths = [int(space.comm.allreduce(table.shape[1], op=MPI.MAX)) for table in (target.x, target.nodes)]
    x, nodes = padded(target.x, widths[0]), padded(target.nodes, widths[1])
    corners = space.points[source.cells]
    behind = np.einsum("pad,pd->pa", source.x[:, None] - corners[source.facet], source.normal)
    depth = np.full(len(source.cells), np.inf)
    np.minimum.at(depth, source.facet, behind.max(axis=1, initial=0.0))
    slack = SLACK * np.minimum(_shortest(space.points[nodes]), depth)
    sides = np.zeros(len(nodes)) if sides is None else sides
    table = np.column_stack([target.ids // FACETS, target.components, slack, sides, space.nodes[nodes]]).astype(float)
    said = {one.name: getattr(target, one.name) for one in fields(TargetSurface)}
    x = np.ascontiguousarray(x)
    rim = Rim(space, space.nodes[nodes], target.kinds, target.ids, x, table)
    said.update(x=x, nodes=nodes, table=table, meets_itself=meets_itself, rim=rim)
    surface = SelfSurface(**said)
    return surface.seen_from(source.facet, source.x)


# cosine between a facet's normal and a direction along which its displacement says nothing of its normal traction
ALONG = 1e-3


def outer_surfaces(space):
    """Facets of one cell alone, but for those on the axis of symmetry. *Collective.*

    Returns
    -------
    list of pcontact.mesh.mesh.Facets
    """
    axis, result = space.on_axis(), []
    for facets in outer_facets(space.mesh, space.exchanger):
        off = ~axis[space.facet_nodes(facets)].all(axis=1)
        if off.any():
            result.append(Facets(facets.block, facets.cell, facets.cells[off], facets.local[off]))
    return result


def facet_ids(space, name):
    """Global numbers (n,) of the facets of a group on this rank."""
    mesh = space.mesh
    parts = [mesh.blocks[f.block].ids[f.cells] * FACETS + f.local for f in mesh.facet_groups.get(name, [])]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def paired_elsewhere(space, contacts, ids):
    """Surfaces of other pairs that each facet is in, see `pcontact.contact.search.exclusion.clash`.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contacts : list of pcontact.scene.model.Contact
        All of the scene.
    ids : ndarray (nf,)
        Global numbers of the facets.

    Returns
    -------
    ndarray (nf,) int64
    """
    marks = np.zeros(len(ids), dtype=np.int64)
    pairs = [contact for contact in contacts if not contact.all and contact.target is not None]
    for number, contact in enumerate(pairs):
        for side, name in enumerate((contact.source, contact.target)):
            marks |= np.where(np.isin(ids, facet_ids(space, name)), 1 << (2 * number + side), 0)
    return marks


def burdened(space, supports, loaded, source, tangential):
    """Facets (nf,) of the outer surfaces with a load, or with a prescribed displacement of all their nodes.

    Parameters
    ----------
    space : pcontact.space.space.Space
    supports : pcontact.space.supports.Supports
    loaded : list of str
        Groups with loads or springs.
    source : pcontact.contact.surface.sides.SourceSurface
        The outer surfaces.
    tangential : bool
        Whether displacements along the facet count, too: with friction.
    """
    parts = [supports.fixed[space.facet_nodes(f)].all(axis=1) for f in space.mesh.facet_groups.get(OUTER, [])]
    fixed = np.concatenate([np.zeros((0, space.dim), dtype=bool), *parts])
    normal = np.zeros(fixed.shape)
    np.maximum.at(normal, source.facet, np.abs(source.normal))
    flags = (fixed & ((normal > ALONG) | tangential)).any(axis=1)
    for region in loaded:
        flags |= np.isin(source.facet_ids, facet_ids(space, region))
    return flags


def meetings(space, sides, radius):
    """Pairs of components that a contact may bring together: all of two single ones, else those near each other.

    Parameters
    ----------
    space : pcontact.space.space.Space
    sides : list of set of int
        Components of the source and of the target.
    radius : float
        Farthest that partners are looked for [length].

    Returns
    -------
    set of (int, int)

    Notes
    -----
    *Collective.*
    """
    one, other = sides
    if len(one) == len(other) == 1:
        return {(a, b) for a in one for b in other if a != b}
    pairs = near_pairs(*component_boxes(space), radius)
    return {(a, b) for a, b in pairs.tolist() if (a in one and b in other) or (b in one and a in other)}
