"""Places along a source facet in the plane where the partner passes from one target facet to another, of two facets.

Between two points of a source facet whose partners are known to be of two facets, the partner changes at one of these
places, if at no third facet:

* where the foot of the source point, or its ray, passes an end of one of the two facets: the point is over the end;
* where two facets are as near as each other: those that meet at a concave vertex are, before either foot is at it;
* where a facet is no partner any more: it is too far away, or turns away from the point.

Each is a condition on one facet or two, and changes once between the two points: it is halved to the last digit, with
the solvers of the search for one facet and its rules for which one wins (`pcontact.contact.search`), and without a
search. Whether a place is one where the partner does change is for the search to say.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.facet import GRID, LocalFacet, closest_on_facet, ray_on_facet
from pcontact.contact.search.nearest import BEHIND, CORNER, EVEN, ROUNDING, TIE, TOUCH
from pcontact.contact.search.projection import Criteria
from pcontact.contact.surface.facet_maps import SEGMENT3, fill_jet, jet_normal, load_nodes, simplest_kinds
from pcontact.runtime.jit import njit_exact, njit_inner_exact

# places of a bracket: over both ends of the facet at either side of it, and one of equal distance or without a partner
PLACES = 5
LAST = 4
# what is to be known of a facet: on which side of its end a point is, whether it is nearer, whether it is a partner
OVER, NEARER, PARTNER = range(3)
# reference segment of the source: feet that pass the same vertex from both sides in one place, but for rounding
TOGETHER = 1e-10
# and an end that is passed where a facet ceases to be the partner: the latter counts, rays go a little over an end
BESIDE = 1e-7


class Brackets(NamedTuple):
    """Intervals (n) of source facets, at the two sides of which other facets are partners.

    Attributes
    ----------
    source : (n, 3, 2) float64
        Nodes of the source facets [length], of degree 2.
    a, b : (n,) float64
        Ends of the intervals, in the reference segment.
    ids : (n, 2) int64
        Numbers of the partners' facets, -1: none.
    nodes : (n, 2, 2) int64
        Numbers of the nodes at the ends of these.
    x : (n, 2, m, 2) float64
        Their nodes, of degree m - 1 [length].
    kinds : (n, 2) int64
        Their simplest kinds.
    """

    source: np.ndarray
    a: np.ndarray
    b: np.ndarray
    ids: np.ndarray
    nodes: np.ndarray
    x: np.ndarray
    kinds: np.ndarray


def crossings(source, interval, partners, criteria, radius):
    """Places in some intervals of source facets where the partner may change.

    Parameters
    ----------
    source : (n, 3, 2) float64
        Nodes of the source facets, of degree 2 [length].
    interval : (n, 2) float64
        In the reference segment.
    partners : (ids (n, 2) int64, nodes (n, 2, 2) int64, x (n, 2, m, 2) float64)
        Of the facets at both ends, see :class:`Brackets`.
    criteria : pcontact.contact.search.projection.Criteria
    radius : float
        Search radius [length].

    Returns
    -------
    (n, PLACES) float64
        In the reference segment, inside the intervals; nan: no such place.
    """
    ids, nodes, x = partners
    n, m = len(source), x.shape[2]
    kinds = np.full(2 * n, m - 2, dtype=np.int64)
    simplest_kinds(np.ascontiguousarray(x.reshape(2 * n, m, 2)), kinds.copy(), kinds)
    a, b = (np.ascontiguousarray(end) for end in interval.T)
    out = np.full((n, PLACES), np.nan)
    brackets = Brackets(np.ascontiguousarray(source), a, b, *partners, kinds.reshape(n, 2))
    fill_crossings(brackets, Criteria(*criteria), float(radius), out)
    return out


@njit_exact
def fill_crossings(brackets, criteria, radius, out):
    """Write to `out` (n, PLACES) the places in each of the brackets."""
    local = LocalFacet(np.zeros((9, 3)), np.zeros(3), np.zeros((6, 9)), np.zeros((6, 3)), np.zeros((GRID, GRID)))
    rules, ids = (criteria, radius, local, np.zeros(3)), brackets.ids
    for i in range(brackets.a.size):
        _fill_ends(brackets, rules, i, out)
        if ids[i, 0] == ids[i, 1]:
            continue
        none = ids[i, 0] < 0 or ids[i, 1] < 0
        first, second = (-1, -1) if none else _shared(brackets.nodes, i)
        if first >= 0:
            if not criteria.rays and _is_concave(brackets, rules, i, first, second, out):
                out[i, first], out[i, 2 + second] = np.nan, np.nan
                out[i, LAST] = _halved(brackets, rules, i, (NEARER, 0, 0))
            continue
        out[i, LAST] = _halved(brackets, rules, i, (PARTNER if none else NEARER, 1 if ids[i, 0] < 0 else 0, 0))
        for k in range(LAST):
            if abs(out[i, k] - out[i, LAST]) < BESIDE:
                out[i, k] = np.nan


@njit_inner_exact
def _fill_ends(brackets, rules, i, out):
    """The places over the ends of the facets of a bracket."""
    for side in range(2):
        if brackets.ids[i, side] < 0 or (side == 1 and brackets.ids[i, 0] == brackets.ids[i, 1]):
            continue
        for end in range(2):
            out[i, 2 * side + end] = _halved(brackets, rules, i, (OVER, side, end))


@njit_inner_exact
def _shared(nodes, i):
    """Ends of the two facets of a bracket that are the same node; -1: there are none."""
    for first in range(2):
        for second in range(2):
            if nodes[i, 0, first] == nodes[i, 1, second]:
                return first, second
    return -1, -1


@njit_inner_exact
def _is_concave(brackets, rules, i, first, second, out):
    """Return True if a point is over both of two facets that meet before it leaves the first one."""
    leaves, enters = out[i, first], out[i, 2 + second]
    a, b = brackets.a[i], brackets.b[i]
    if np.isnan(leaves):
        # over the first facet up to the end of the bracket, or nowhere in it
        leaves = np.inf if _holds(brackets, rules, i, (OVER, 0, first), b) else -np.inf
    if np.isnan(enters):
        enters = -np.inf if _holds(brackets, rules, i, (OVER, 1, second), a) else np.inf
    return leaves > enters + TOGETHER


@njit_inner_exact
def _halved(brackets, rules, i, what):
    """Place where what holds at one end of a bracket ceases to hold; nan: it does not change."""
    a, b = brackets.a[i], brackets.b[i]
    before = _holds(brackets, rules, i, what, a)
    if _holds(brackets, rules, i, what, b) == before:
        return np.nan
    middle = 0.5 * (a + b)
    while a < middle < b:
        if _holds(brackets, rules, i, what, middle) == before:
            a = middle
        else:
            b = middle
        middle = 0.5 * (a + b)
    return middle


@njit_inner_exact
def _source_at(source, i, s):
    """Point (two floats) of a source facet, and the derivative."""
    left, right, centre = 0.5 * s * (s - 1.0), 0.5 * s * (s + 1.0), (1.0 - s) * (1.0 + s)
    x = source[i, 0, 0] * left + source[i, 1, 0] * right + source[i, 2, 0] * centre
    y = source[i, 0, 1] * left + source[i, 1, 1] * right + source[i, 2, 1] * centre
    left, right, centre = s - 0.5, s + 0.5, -2.0 * s
    along = source[i, 0, 0] * left + source[i, 1, 0] * right + source[i, 2, 0] * centre
    across = source[i, 0, 1] * left + source[i, 1, 1] * right + source[i, 2, 1] * centre
    return x, y, along, across


@njit_inner_exact
def _holds(brackets, rules, i, what, s):
    """Return True if something holds at a point s of a bracket."""
    kind, side, end = what
    if kind == OVER:
        return _is_over(brackets, rules[0].rays, i, side, end, s)
    if kind == PARTNER:
        return _distance(brackets, rules, i, side, s)[0] < np.inf
    own, size, held = _distance(brackets, rules, i, 0, s)
    other, other_size, other_held = _distance(brackets, rules, i, 1, s)
    if own == np.inf or other == np.inf:
        return own < other
    rounding = 0.0
    for k in range(3):
        rounding = max(rounding, ROUNDING * (abs(brackets.source[i, k, 0]) + abs(brackets.source[i, k, 1])))
    # the search's rule, see `pcontact.contact.search.nearest.goes_before`
    if held != other_held and abs(own - other) <= TIE * (size if own < other else other_size) + rounding:
        return held < other_held
    if own < other - EVEN * (other + 0.1 * other_size) - rounding:
        return True
    if other < own - EVEN * (own + 0.1 * size) - rounding:
        return False
    return brackets.ids[i, 0] < brackets.ids[i, 1]


@njit_inner_exact
def _is_over(brackets, rays, i, side, end, s):
    """Return True if the foot of a point, or its ray, is on the facet's side of one of its ends."""
    x, y, along, across = _source_at(brackets.source, i, s)
    nodes = brackets.x[i, side]
    # along the facet, at the end; the middle node is the third
    t0, t1 = nodes[1, 0] - nodes[0, 0], nodes[1, 1] - nodes[0, 1]
    if brackets.kinds[i, side] == SEGMENT3:
        sign = -1.0 if end == 0 else 1.0
        b0, b1 = 0.5 * (nodes[0, 0] + nodes[1, 0]) - nodes[2, 0], 0.5 * (nodes[0, 1] + nodes[1, 1]) - nodes[2, 1]
        t0, t1 = t0 + 4.0 * sign * b0, t1 + 4.0 * sign * b1
    x, y = x - nodes[end, 0], y - nodes[end, 1]
    if rays:
        # the source runs against the facet that it faces
        back = along * t0 + across * t1
        ahead = (x * along + y * across) * (1.0 if back > 0.0 else -1.0)
    else:
        ahead = x * t0 + y * t1
    return ahead > 0.0 if end == 0 else ahead < 0.0


@njit_inner_exact
def _distance(brackets, rules, i, side, s):
    """Distance of a facet as a partner, inf if it is none, its size, and how it is held as `table.HELD` has it; its
    neighbours have no say."""
    criteria, radius, local, n = rules
    nodes, p, shapes, jet, _ = local
    facets, kind = brackets.x[i], brackets.kinds[i, side]
    x, y, along, across = _source_at(brackets.source, i, s)
    load_nodes(facets, side, kind, nodes)
    p[0], p[1], p[2] = x - facets[side, 0, 0], y - facets[side, 0, 1], 0.0
    size = np.sqrt(nodes[1, 0] ** 2 + nodes[1, 1] ** 2)
    length = np.sqrt(along * along + across * across)
    n0, n1 = across / length, -along / length
    if criteria.rays:
        n[0], n[1] = n0, n1
        g, _, _, over = ray_on_facet(kind, local, n, criteria.facing, 0.0)
        return (abs(g) if abs(g) <= radius else np.inf), size, max(over - 1e-14, 0.0)
    u, v = closest_on_facet(kind, local)
    fill_jet(kind, u, v, nodes, 3, shapes, jet)
    r0, r1 = jet[0, 0] - p[0], jet[0, 1] - p[1]
    distance = np.sqrt(r0 * r0 + r1 * r1)
    m0, m1, _ = jet_normal(kind, jet)
    outward, sideways = r0 * m0 + r1 * m1, abs(r0 * m1 - r1 * m0)
    held, facing = sideways > TOUCH * size, -(n0 * m0 + n1 * m1)
    if held:
        facing = (n0 * r0 + n1 * r1) / (-distance if outward > 0.0 else distance)
    beside = held and outward > 0.0 and outward < BEHIND * distance
    lost = distance > radius or facing < criteria.facing or beside
    return (np.inf if lost else distance), size, (CORNER if held else max(sideways / size - 1e-14, 0.0))
