"""Self contact: which facets are no partners of a point because they belong to its own neighbourhood.

A point of a surface that is searched for partners on the same surface has its own facet at distance 0, and the far side
of its own body behind it. The facing rule of the search (`projection.FACING`) leaves out its own facet and those around
it. Of facets of the point's own connected body these are left out, too:

* facets of the point's own cell, and facets that share a node with the point's facet;
* facets behind the point, through the material: in the undeformed body a partner is in front of the point. A slack of
  `SLACK` of the shortest edge of the facet, or of the depth of its cell if that is less, makes room for surfaces that
  touch. It is the undeformed body that is asked, for it has no overlap: in the deformed one a point may go deeper.

Parts of a body that are thinner than the search radius thus need no care, nor does a body whose opposite skins lie
closer to each other than the faces of a gap. An overlap of the undeformed body with itself is not seen. Other bodies in
the same group of facets are partners like any others.

Where bodies are to meet others only, a point passes by whole branches of the tree that hold nothing but its own body.
Two surfaces that another pair of the scene brings together are no partners here, see `clash`.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.facet_maps import NODE_COUNTS, fill_shapes
from pcontact.runtime.jit import njit_inner_exact

# of the edges of a facet and of the depth of its cell: overlap of the undeformed body that counts as none
SLACK = 0.1


class Exclusion(NamedTuple):
    """Places of points and facets in the undeformed bodies; all arrays empty where points are not on the surface.

    Attributes
    ----------
    x : ndarray (np, d)
        Points [length].
    cells, parts : ndarray (np,)
        Global number of the parent cell and connected body of each point's facet.
    nodes : ndarray (np, k)
        Global nodes of that facet.
    slack : ndarray (np,)
        How deep behind the point a partner may be [length].
    facet_x : ndarray (nf, m, d)
        Nodes of the facets searched [length].
    facet_cells, facet_parts : ndarray (nf,)
    facet_nodes : ndarray (nf, k)
    sides : ndarray (np,)
        Which surfaces of other pairs of the scene the facet of each point is in, see `clash`.
    facet_sides : ndarray (nf,)
    whole : ndarray (n,)
        Where bodies are no partners of themselves: the connected body that a node of the tree, and after the nodes a
        facet in the order of the tree, belongs to; -1: several. Else empty.
    """

    x: np.ndarray
    cells: np.ndarray
    parts: np.ndarray
    nodes: np.ndarray
    slack: np.ndarray
    facet_x: np.ndarray
    facet_cells: np.ndarray
    facet_parts: np.ndarray
    facet_nodes: np.ndarray
    sides: np.ndarray
    facet_sides: np.ndarray
    whole: np.ndarray


def writable(exclusion):
    """As one compiled specialisation takes it."""
    kinds = {"x": float, "slack": float, "facet_x": float}
    arrays = exclusion._asdict().items()
    return Exclusion(*(np.require(array, kinds.get(name, np.int64), ["C", "W"]) for name, array in arrays))


@cache
def no_exclusion(d):
    """For points that are not on the surface searched."""
    none, pairs = np.zeros(0), np.zeros((0, 0))
    none_of = np.zeros((0, d)), none, none, pairs, none, np.zeros((0, 0, d)), none, none, pairs, none, none, none
    return writable(Exclusion(*none_of))


def whole_branches(tree, parts):
    """Body that each node of a tree, and each facet in the tree's order, belongs to; -1: several.

    Parameters
    ----------
    tree : pcontact.contact.search.tree.Tree
    parts : ndarray (nf,)
        Connected body of each facet.

    Returns
    -------
    ndarray (n_nodes + nf,) int64
    """
    ordered = parts[tree.order]
    changes = np.cumsum(np.concatenate([[0], ordered[1:] != ordered[:-1]])) if len(ordered) else ordered
    uniform = changes[tree.first] == changes[tree.last - 1]
    return np.concatenate([np.where(uniform, ordered[tree.first], -1), ordered]).astype(np.int64)


@njit_inner_exact
def clash(one, other):
    """Return True if another pair brings two facets together: bit 2 k: source of pair k, 2 k + 1: its target."""
    even = 0x5555555555555555
    return one & (((other >> 1) & even) | ((other & even) << 1)) != 0


@njit_inner_exact
def is_around(exclusion, q, facet):
    """Return True if a facet of the body of point q is the point's, or shares its cell or a node with it."""
    if exclusion.parts[q] != exclusion.facet_parts[facet]:
        return False
    if exclusion.cells[q] == exclusion.facet_cells[facet]:
        return True
    for i in range(exclusion.nodes.shape[1]):
        for j in range(exclusion.facet_nodes.shape[1]):
            if exclusion.nodes[q, i] == exclusion.facet_nodes[facet, j]:
                return True
    return False


@njit_inner_exact
def is_own(exclusion, q, facet, kind, xi, normal, shapes):
    """Return True if a facet belongs to the neighbourhood of point q, see the head of the module.

    Parameters
    ----------
    exclusion : Exclusion
    q, facet : int
    kind : int
        Of the facet, see `facet_maps`.
    xi : (float, float)
        Reference coordinates of the partner.
    normal : (float, float, float)
        Contact normal.
    shapes : (6, 9) float64
        Scratch.
    """
    if clash(exclusion.sides[q], exclusion.facet_sides[facet]):
        return True
    if exclusion.parts[q] != exclusion.facet_parts[facet]:
        return False
    if is_around(exclusion, q, facet):
        return True
    fill_shapes(kind, xi[0], xi[1], shapes)
    gap = 0.0
    for k in range(exclusion.x.shape[1]):
        y = 0.0
        for i in range(NODE_COUNTS[kind]):
            y += shapes[0, i] * exclusion.facet_x[facet, i, k]
        gap += (y - exclusion.x[q, k]) * normal[k]
    return gap < -exclusion.slack[q]
