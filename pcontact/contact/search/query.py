"""What a search is asked: the facets that it looks among, the points, and which facets may be partners.

Kernels take these tuples as they are; their arrays are then of the types below, and none is left out.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.cones import Cones
from pcontact.contact.search.tree import Tree


class TargetFacets(NamedTuple):
    """Facets (nf) among which partners are looked for.

    Attributes
    ----------
    tree : Tree
        Of these facets.
    x : (nf, m, d) float64
        Deformed node coordinates [length], m at least the largest node count.
    kinds : (nf,) int64
        `facet_maps.KIND`; in kernels the simplest ones, see `facet_maps.simplest_kinds`.
    ids : (nf,) int64
        Global facet numbers.
    own : (nf,) bool or None
        Facets that may be partners; None: all. The others take part in the decisions about edges and corners, and hide
        what is behind them where a point projects inside of them: they are its partners for those who own them. A rank
        that is also given the neighbours of its facets (those that share a node) decides as if it had them all, and
        `projection.better` of all ranks is then exactly the search in the whole surface.
    cones : pcontact.contact.search.cones.Cones or None
        Of these facets and these places: facets that can hold no partner are left out early, and partners stay the
        same.
    """

    tree: Tree
    x: np.ndarray
    kinds: np.ndarray
    ids: np.ndarray
    own: np.ndarray | None = None
    cones: Cones | None = None


class QueryPoints(NamedTuple):
    """Points (np) that look for a partner.

    Attributes
    ----------
    x, normal : (np, d) float64
        Points [length] and outward normals of the source; a point without a (finite) normal has no partner.
    radius : (np,) float64 or float
        Largest distance of a partner [length], in penetration too.
    patience : int
        So many facets are tried for a point before it is given up.
    """

    x: np.ndarray
    normal: np.ndarray
    radius: np.ndarray | float
    patience: int = np.iinfo(np.int64).max


class Criteria(NamedTuple):
    """Which facets may be partners.

    Attributes
    ----------
    rays : bool
        Whether partners are where the normal of the source meets a facet; else they are the nearest.
    facing : float
        Smallest nX . n of a partner, in (0, 1).
    opposite : bool
        Whether no point beside the border of the surface has a partner there.
    """

    rays: bool
    facing: float
    opposite: bool
