"""Closest point projection and ray tracing of points onto a surface of facets.

Both return one partner per point, with the contact normal n pointing from the source (the point) to the
target, and the gap g = (y - x) . n: positive open, negative penetration.

Which facet wins. Facets are visited in the order of their distance. Those that fail the facing rule, nX . n
>= facing, never win, and never hide a farther one. Among accepted facets whose distances agree to 1e-10 of
the facet size, a projection inside its facet is preferred to one held at an edge, that to one held at a corner, and
of two inside the one that hangs less over its border; then the nearer one as far as rounding tells, then the smallest
global facet number. The outcome depends neither on the order of the facets nor, through `better`, on how they are
spread over ranks, nor, but for rounding, on their numbers. Facets that meet in the nearest point give the same
partner, whichever has the smaller number; it decides between different points only where a point is exactly as far
from the insides of two facets.

Normals of the projection. Inside a facet n = -nY. At an edge or corner (the offset has a part tangential to
the facet of more than 1e-9 of its size) n is along the offset y - x: from the point to the surface when the
point is outside, reversed when inside. The side is decided by the sum of the normals of the facets that share
the closest point, each weighted by its angle there (Baerentzen and Aanaes, IEEE TVCG 11, 2005). A point that
touches (offset below 1e-9 of the facet size) gets the mean of those normals. A projection held at an edge
counts only if no neighbour at that edge has a nearer point, accepted or not; one at the border of the surface
has no neighbour, and is left to the facing rule. A point inside whose offset leaves the cone of the normals at its
closest point by more than some 25 degrees is not behind the surface but beside its border: it has no partner there.
Where only points `opposite` the surface are asked for, none beside the border has a partner, inside or outside, however
small that angle: contact that bears tension would pull what juts out over the border towards it.

What a search is asked: the facets that it looks among, the points, and which facets may be partners.

Kernels take these tuples as they are; their arrays are then of the types below, and none is left out.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.exclusion import no_exclusion, writable
from pcontact.contact.search.nearest import EVEN, ROUNDING, TIE, search_all
from pcontact.contact.search.tree import Cones, Tree, build_tree, no_cones
from pcontact.contact.surface.facet_maps import facet_boxes, simplest_kinds


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
    cones : pcontact.contact.search.tree.Cones or None
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
    """Conditions on facets that may be partners.

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


# cosine: normals up to 78 degrees apart may be partners; sideways neighbours beyond a border may not
FACING = 0.2
NO_ID = np.iinfo(np.int64).max


class Projections(NamedTuple):
    """One partner per point among the facets searched.

    Without a partner: facet -1, id NO_ID, gap and distance inf, y the point itself.

    Attributes
    ----------
    facet : (np,) int64
        Position of the facet in the arrays searched, -1 if the point has no partner, `GIVEN_UP` where nobody knows.
    xi : (np, d-1) float64
        Reference coordinates on the facet.
    y : (np, d) float64
        Partner point [length].
    normal : (np, d) float64
        Contact normal, from the source to the target.
    gap : (np,) float64
        (y - x) . normal [length], negative in penetration.
    distance : (np,) float64
        abs(y - x) [length], what candidates are compared by.
    id : (np,) int64
        Global facet number.
    candidates : (np,) int64
        Facets tried; depends on the shape of the tree, hence on the order of the facets.
    size : (np,) float64
        Size of the facet (diagonal of its box) [length]: the scale of the tolerances in `better`.
    held : (np,) float64
        Inside of its facet: how far it hangs over the border, over the facet's size, or how far the ray passes beyond
        it, in reference coordinates; `EDGE` or `CORNER` where it is held there.
    """

    facet: np.ndarray
    xi: np.ndarray
    y: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    distance: np.ndarray
    id: np.ndarray
    candidates: np.ndarray
    size: np.ndarray
    held: np.ndarray


def surface_tree(x_facets, kinds):
    """Tree over facets, see `query.TargetFacets` for the arrays."""
    return build_tree(*facet_boxes(x_facets, kinds))


def no_projections(points, normals):
    """For points that have no partner.

    Parameters
    ----------
    points, normals : (np, d) float64

    Returns
    -------
    Projections
    """
    n, d = points.shape
    return Projections(
        np.full(n, -1, dtype=np.int64), np.zeros((n, d - 1)), np.array(points), np.array(normals),
        np.full(n, np.inf), np.full(n, np.inf), np.full(n, NO_ID, dtype=np.int64),
        np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n),
    )  # fmt: skip


def closest_points(target, query, facing=FACING, exclusion=None, opposite=False):
    """Closest point projection.

    Parameters
    ----------
    target : pcontact.contact.search.projection.TargetFacets
    query : pcontact.contact.search.projection.QueryPoints
    facing : float, optional
        Smallest nX . n of a partner, in (0, 1).
    exclusion : pcontact.contact.search.exclusion.Exclusion, optional
        The points are on the surface searched (self contact): facets that are no partners although they face the
        point.
    opposite : bool, optional
        No point beside the border of the surface has a partner there.

    Returns
    -------
    Projections

    Raises
    ------
    ValueError
        If arrays do not fit together.
    """
    return _search(target, query, Criteria(False, float(facing), bool(opposite)), exclusion)


def ray_tracing(target, query, facing=FACING, exclusion=None, opposite=False):
    """Partners along the source normal: y = x + g nX, smallest abs(g) <= radius, n = nX.

    Only facets with nX . nY <= -facing count. Parameters and result as in `closest_points`; `distance` is
    abs(g); a ray that meets the surface is not beside its border. Cones tell nothing here.
    """
    return _search(target, query, Criteria(True, float(facing), bool(opposite)), exclusion)


def better(a, b):
    """Merge what two searches over different facets found for the same points; the rule of the module's head.

    A projection to an edge or corner is decided from the facets that share it. Where these are spread over
    searches that did not know them as neighbours (`own` of `query.TargetFacets`), each decided from its part of
    them: no mean normal can be formed here, and the rule for ties chooses one of the results.

    Parameters
    ----------
    a, b : Projections
        For the same points in the same order.

    Returns
    -------
    Projections
        `facet` still counts within the search that found it; `id` tells facets exclusion. `candidates` are
        summed.
    """
    offset = np.maximum(np.abs(a.y), np.abs(b.y)).max(axis=1, initial=0.0)
    tie = TIE * np.maximum(a.size, b.size) + ROUNDING * offset
    nearest = np.minimum(a.distance, b.distance) + tie
    tied_a, tied_b = a.distance <= nearest, b.distance <= nearest
    even = EVEN * (nearest + 0.1 * np.maximum(a.size, b.size)) + ROUNDING * offset
    by_distance = (b.distance > a.distance + even) | ((a.distance <= b.distance + even) & (a.id <= b.id))
    first = np.where(a.held == b.held, by_distance, a.held < b.held)
    take = np.where(tied_a & tied_b, first, tied_a)
    merged = [np.where(take[:, None] if u.ndim == 2 else take, u, v) for u, v in zip(a, b, strict=True)]
    return Projections(*merged)._replace(candidates=a.candidates + b.candidates)


def _search(target, query, criteria, exclusion):
    """Check and convert the arguments (one compiled specialisation serves all), run the kernel."""
    x, points, normals = (_floats(array) for array in (target.x, query.x, query.normal))
    kinds, ids = (np.require(array, np.int64, ["C", "W"]) for array in (target.kinds, target.ids))
    d = points.shape[1]
    radii = np.empty(len(points))
    radii[:] = query.radius
    if normals.shape != points.shape or x.shape[2] != d:
        raise ValueError(f"points {points.shape}, normals {normals.shape}, facets {x.shape} do not fit")
    if not x.shape[0] == kinds.size == ids.size == target.tree.order.size:
        counts = f"{x.shape[0]} facets, {kinds.size} kinds, {ids.size} ids, tree of {target.tree.order.size}"
        raise ValueError(counts)
    if np.any((kinds < 2) != (d == 2)):
        raise ValueError(f"facet kinds do not fit the dimension {d}")
    projections = no_projections(points, normals)
    if kinds.size and len(points):
        simple = np.empty_like(kinds)
        simplest_kinds(x, kinds, simple)
        own = np.ones(kinds.size) if target.own is None else target.own
        exclusion = no_exclusion(d) if exclusion is None else writable(exclusion)
        cones = no_cones(d) if target.cones is None or criteria.rays else target.cones
        own = np.require(own, np.bool_, ["C", "W"])
        facets = target._replace(x=x, kinds=simple, ids=ids, own=own, cones=cones)
        search_all(facets, QueryPoints(points, normals, radii, int(query.patience)), criteria, exclusion, projections)
    return projections


def _floats(array):
    return np.require(array, np.float64, ["C", "W"])
