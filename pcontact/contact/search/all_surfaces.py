"""Contact of all surfaces: the whole boundary of all bodies as one surface that is source and target.

One item, one search and one tree per rank serve all bodies, however many there are; which of them touch is what the
search finds. Other pairs of the scene come first: two surfaces that a pair brings together are no partners here, but
each of them meets all others. Facets that carry a load, or whose nodes have a prescribed displacement along the normal
(with friction: any), have a traction that is not that of contact alone: they take part without it, as in the penalty
method.
"""

import numpy as np

from pcontact.contact.surface.sides import FACETS
from pcontact.mesh.mesh import Facets
from pcontact.mesh.topology import outer_facets
from pcontact.scene.model import OUTER
from pcontact.space.modes import component_boxes, near_pairs

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
    """Which surfaces of other pairs each facet is in, see `pcontact.contact.search.exclusion.clash`.

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
