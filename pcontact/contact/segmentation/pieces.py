"""Source facets cut where the target facet changes, so that no quadrature rule straddles a kink of the target.

The trace of the target's displacement along a source facet has a kink (and its gap a corner) wherever the partner moves
from one target facet to the next. A Gauss rule across such kinks leaves an error in the nodal forces of the target that
does not shrink relative to them when the mesh is refined, which limits the energy norm to order 1/2. In the plane the
partners of some points of each source facet are searched. Between two whose partners are on other facets these facets
tell where the partner changes (:func:`crossings`), and one more search around there whether it does. What is left, such
as facets between the two that no point has met, is divided further, and halved in the end, with the search itself, so
that every method of search, curved facets and partners on other ranks need nothing of their own.

A convex vertex of the target is the nearest point of all source points between the normals of the two facets that meet
there. The partner enters it from one facet and leaves it to the other: both places are kinks, and the source is cut at
both. Which of the two facets the search names in between, by their numbers, does not matter. At the end of a target
there is no other facet, and no cut.

Between two points of a source facet whose partners are known to be of two facets, the partner changes at one of these
places, if at no third facet:

* where the foot of the source point, or its ray, passes an end of one of the two facets: the point is over the end;
* where two facets are as near as each other: those that meet at a concave vertex are, before either foot is at it;
* where a facet is no partner any more: it is too far away, or turns away from the point.

Each is a condition on one facet or two, and changes once between the two points: it is halved to the last digit, with
the solvers of the search for one facet and its rules for which one wins (`pcontact.contact.search`), and without a
search. Whether a place is one where the partner does change is for the search to say.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from pcontact.contact.search.facet import GRID, LocalFacet, closest_on_facet, ray_on_facet
from pcontact.contact.search.partners import PartnerSearch
from pcontact.contact.search.projection import BEHIND, CORNER, EVEN, FACING, ROUNDING, TIE, TOUCH, Criteria, QueryPoints
from pcontact.contact.segmentation.overlaps import tiles
from pcontact.contact.surface.facet_maps import SEGMENT3, fill_jet, jet_normal, load_nodes, simplest_kinds
from pcontact.contact.surface.sides import at_places, default_quadrature
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_nodes, shape, shape_gradient
from pcontact.runtime.jit import njit_exact, njit_inner_exact
from pcontact.runtime.petsc import MPI

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
    # the search's rule, see `pcontact.contact.search.projection.goes_before`
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
    """Distance of a facet as a partner, inf if it is none, its size, and how it is held as `Projections` have it; its
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


# intervals that each source facet starts with: a target facet shorter than one of them may be missed
SAMPLES = 8
# in the reference segment: how far on both sides of a place the partners are looked at, to tell whether it is a cut;
# more than what a node of the target holds to itself (`AT_NODE`) and what rays may pass beyond a facet, unless facets
# are ten times as large as the source's
AROUND = 1e-8
# width of an interval with a cut that is known to the last digit
LAST_DIGIT = 2.0**-52
# bisections that one search of more points stands for, at most, and how many points it may have; from: a search takes
# 0.6 ms, and 2 microseconds a point more
AT_ONCE, POINTS = 6, 5000
# shortest piece, in the reference segment
SLIVER = 1e-7
# shape function of a node that a partner sits on, but for rounding
AT_NODE = 1.0 - 1e-12


def _ends(space, target):
    """Global numbers (n,) of the nodes at the ends of a target in the plane: they are of one facet. *Collective.*"""
    node, count = np.unique(space.nodes[target.nodes[:, :2]], return_counts=True)
    # few are left of a rank's facets
    once = np.concatenate(space.comm.allgather(node[count == 1]))
    node, count = np.unique(once, return_counts=True)
    return node[count == 1]


class _Seen(NamedTuple):
    """Partners of points (n) of a source.

    Attributes
    ----------
    label : ndarray (n,) int64
        Number of the facet, -1: no partner, -2 and below: between two facets, on the node -2 minus this.
    id : ndarray (n,) int64
        Number of the facet, -1: no partner.
    ends : ndarray (n, 2) int64
        Numbers of the nodes at its ends.
    x : ndarray (n, m, 2)
        Its nodes [length].
    """

    label: np.ndarray
    id: np.ndarray
    ends: np.ndarray
    x: np.ndarray


class _Partners:
    """Places on the target of the partners of points of a source in the plane, in the undeformed bodies.

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    search : (TargetSurface, float, str)
        Target, search radius [length] and method.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, space, parts, search):
        self._target, self._radius, method = search
        still = np.zeros((space.n_local, space.dim))
        self._search = PartnerSearch(space, self._target, still, method, facets=True)
        self._criteria = Criteria(method == "ray_tracing", FACING, False)
        self._ends = _ends(space, self._target)
        none = np.zeros((0, 3, 2))
        self._nodes = np.concatenate([none, *(_nodes(space, facets) for facets in parts)])

    def __call__(self, facet, s):
        """Of points s (n,) on facets (n,): a :class:`_Seen`. *Collective.*"""
        some = self._nodes[facet]
        x = np.einsum("pa,pai->pi", shape("segment", 2, s[:, None]), some)
        along = np.einsum("pa,pai->pi", shape_gradient("segment", 2, s[:, None])[:, :, 0], some)
        normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        found = self._search(QueryPoints(x, normal, self._radius), self._target.seen_from(facet, x).about)
        # the first two are the ends of a facet: its middle is no place to cut
        ends, weights = found.nodes[:, :2], found.shape[:, :2]
        second = weights[:, 1] > weights[:, 0]
        node = np.where(second, ends[:, 1], ends[:, 0])
        held = found.paired & (weights.max(axis=1) > AT_NODE)
        held[held] = ~np.isin(node[held], self._ends)
        return _Seen(np.where(held, -2 - node, found.ids), found.ids, ends, found.facets)

    def between(self, facet, interval, seen, at):
        """Places (n, m) inside intervals (n, 2) of facets (n,) where the partner may change, or nan, from the partners
        of the points `at` (n, 2) of those seen: those of the ends of the intervals."""
        partners = seen.id[at], seen.ends[at], seen.x[at]
        return crossings(self._nodes[facet], interval, partners, self._criteria, self._radius)


def _nodes(space, facets):
    """Nodes (n, 3, 2) of facets of one part in the plane, of degree 2."""
    table, degree = space.mesh.geometry_nodes(space.mesh.blocks[facets.block])
    columns = facet_nodes(facets.cell, degree)[facets.local]
    x = space.mesh.points[table[facets.cells[:, None], columns]]
    return x if degree == 2 else np.concatenate([x, x.mean(axis=1, keepdims=True)], axis=1)


def _apart(facet, at):
    """Cuts of facets (n,), sorted, without slivers: cuts next to an end are left out, and several become their mean."""
    if not len(at):
        return facet, at
    new = (np.diff(facet, prepend=-1) != 0) | (np.diff(at, prepend=-np.inf) > SLIVER)
    cluster = np.cumsum(new) - 1
    mean = np.bincount(cluster, at) / np.bincount(cluster)
    lowest, highest = at[new], at[np.append(np.flatnonzero(new)[1:], len(at)) - 1]
    return facet[new], np.where(lowest == -1.0, -1.0, np.where(highest == 1.0, 1.0, mean))


def _at_once(n):
    """Bisections of n intervals that one search is to stand for."""
    return max([bits for bits in range(2, AT_ONCE + 1) if n * 4**bits <= POINTS], default=1)


class _Intervals(NamedTuple):
    """Intervals (n) of source facets at whose ends the partners are on other facets.

    Attributes
    ----------
    facet : ndarray (n,)
    a, b : ndarray (n,)
        Ends in the reference segment.
    at : ndarray (n, 2)
        The ends among the points that have been seen.
    """

    facet: np.ndarray
    a: np.ndarray
    b: np.ndarray
    at: np.ndarray

    def chosen(self, rows):
        """Some of them."""
        return _Intervals(*(column[rows] for column in self))


def _changes(partners, n, comm):
    """Places where the partners of points of n source facets change. *Collective.*

    Parameters
    ----------
    partners : _Partners
    n : int
        Facets of this rank.

    Returns
    -------
    facet, place : ndarray (m,)
        The place is in the reference segment.
    """
    # just inside the facet: at its ends the partner is a matter of rounding
    grid = np.linspace(-1.0 + 1e-9, 1.0 - 1e-9, SAMPLES + 1)
    facet, s = np.repeat(np.arange(n), SAMPLES + 1), np.tile(grid, n)
    seen, known, found = partners(facet, s), 0, []
    intervals = _changing(facet, s, np.arange(len(s)), seen.label)
    while True:
        width = intervals.b - intervals.a
        places = partners.between(intervals.facet, np.column_stack(intervals[1:3]), seen, intervals.at)
        several = ~np.isnan(places)
        near = (width <= 3.0 * AROUND) & several.any(axis=1)
        halved = (width <= LAST_DIGIT) & ~near
        k, j = np.nonzero(several & near[:, None])
        found.append((intervals.facet[k], places[k, j]))
        found.append((intervals.facet[halved], 0.5 * (intervals.a + intervals.b)[halved]))
        left = np.flatnonzero(~near & ~halved)
        most = comm.allreduce(len(left), op=MPI.MAX)
        if not most:
            break
        intervals, places = intervals.chosen(left), places[left]
        # where nothing is said, or was said twice and is not so, all of the interval is looked at
        lost = np.ones(len(left), dtype=bool) if known > 1 else np.isnan(places).all(axis=1)
        which, s = _inside(intervals, places, lost, _at_once(most))
        more = partners(intervals.facet[which], s)
        first, known = len(seen.label), known + 1
        seen = _Seen(*(np.concatenate(columns) for columns in zip(seen, more, strict=True)))
        # with the ends that were there
        which = np.concatenate([which, np.tile(np.arange(len(left)), 2)])
        s = np.concatenate([s, intervals.a, intervals.b])
        at = np.concatenate([first + np.arange(len(more.label)), *intervals.at.T])
        order = np.lexsort((s, which))
        intervals = _changing(which[order], s[order], at[order], seen.label[at[order]], intervals.facet)
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))


def _changing(group, s, at, label, facet=None):
    """Intervals between points s (n,) of the same group, one after the other, with other labels (n,)."""
    k = np.flatnonzero((group[1:] == group[:-1]) & (label[1:] != label[:-1]))
    rows = group[k] if facet is None else facet[group[k]]
    return _Intervals(rows, s[k], s[k + 1], np.column_stack([at[k], at[k + 1]]))


def _inside(intervals, places, lost, bits):
    """Points to look at: on both sides of some places (n, m) in intervals (n), and all over those that are lost (n,).

    Returns
    -------
    which : ndarray (k,)
        The interval.
    s : ndarray (k,)
        In the reference segment.
    """
    around = np.concatenate([places - AROUND, places + AROUND], axis=1)
    k, j = np.nonzero((around > intervals.a[:, None]) & (around < intervals.b[:, None]))
    rows = np.flatnonzero(lost)
    a, b = intervals.a[rows, None], intervals.b[rows, None]
    inner = a + (b - a) * (np.arange(1, 2**bits) / 2**bits)
    # of the narrowest there may be no number in between
    row, column = np.nonzero((inner > a) & (inner < b))
    return np.concatenate([k, rows[row]]), np.concatenate([around[k, j], inner[row, column]])


def cuts(space, parts, search):
    """Pieces of all source facets, sorted. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    search : (TargetSurface, float, str)
        Target, search radius [length] and method.

    Returns
    -------
    part, row, facet : ndarray (n,)
        Part, row in it, and running number of each piece's facet.
    a, b : ndarray (n,)
        Ends of the piece in the facet's reference segment.
    """
    count = np.array([len(f.cells) for f in parts], dtype=np.int64)
    part = np.repeat(np.arange(len(parts)), count)
    row = np.concatenate([np.arange(n) for n in count]) if len(count) else np.zeros(0, dtype=np.int64)
    n = len(part)
    f, places = _changes(_Partners(space, parts, search), n, space.comm)
    facet = np.concatenate([np.arange(n), np.arange(n), f])
    at = np.concatenate([np.full(n, -1.0), np.full(n, 1.0), places])
    order = np.lexsort((at, facet))
    facet, at = _apart(facet[order], at[order])
    start = np.flatnonzero(facet[1:] == facet[:-1])
    return part[facet[start]], row[facet[start]], facet[start], at[start], at[start + 1]


def _in_plane(space, parts, search, degree, key):
    """Points of all pieces of this rank in the plane, see :func:`_in_space`. *Collective.*"""
    known = {} if key is None else space.mesh.pieces
    if key not in known:
        known[key] = cuts(space, parts, search)
    part, row, _, a, b = known[key]
    xi, weights = quadrature("segment", degree or default_quadrature("segment", space.degree))
    s = 0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * xi[:, 0]
    n = len(weights)
    return np.repeat(part, n), np.repeat(row, n), s.reshape(-1, 1), (0.5 * (b - a)[:, None] * weights).ravel()


def _in_space(space, parts, target, degree):
    """Points of all tiles of this rank, of the facets that are cut. *Collective.*

    Returns
    -------
    part, row : ndarray (n,)
        Part, and row in it, of each point's facet.
    s : ndarray (n, d - 1)
        Reference coordinates.
    w : ndarray (n,)
        Weights.
    """
    part, row, kinds, corners = tiles(space, parts, target)
    columns, degree = [], degree or 2 * space.degree
    for sides, name, origin, unit in ((3, "triangle", 0.0, 1.0), (4, "quadrilateral", 1.0, 0.5)):
        xi, weights = quadrature(name, degree)
        chosen = np.flatnonzero(kinds == sides)
        # from the reference domain to shares of the two sides
        share, a = unit * (xi + origin), corners[chosen]
        along = a[:, 1:] - a[:, :1]
        s = a[:, :1] + np.einsum("qk,pki->pqi", share, along)
        size = along[:, 0, 0] * along[:, 1, 1] - along[:, 0, 1] * along[:, 1, 0]
        w = size[:, None] * (unit**2 * weights)
        n = len(weights)
        columns.append((np.repeat(part[chosen], n), np.repeat(row[chosen], n), s.reshape(-1, 2), w.ravel()))
    return tuple(np.concatenate(several) for several in zip(*columns, strict=True))


def cut_source(space, source, name, target, radius, method, degree=None, onto=None):
    """The source surface with a quadrature rule on every piece. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : SourceSurface
    name : str
        Its facet group.
    target : TargetSurface
    radius : float
        Search radius [length].
    method : {"closest_point", "ray_tracing"}
    degree : int, optional
        Of the rule on each piece.
    onto : str, optional
        Facet group of the target, where it is another surface: pieces in the plane are then kept with the mesh, for
        other settings and other runs.

    Returns
    -------
    SourceSurface
        The same facets; the cuts are those of the undeformed bodies. Facets that are not cut keep their points.
    """
    parts = space.mesh.facet_groups.get(name, [])
    if space.dim == 2:
        key = None if onto is None else (name, onto, radius, method, space.degree)
        part, row, s, w = _in_plane(space, parts, (target, radius, method), degree, key)
    else:
        part, row, s, w = _in_space(space, parts, target, degree)
    n, nn, d = len(w), source.shape.shape[1], space.dim
    facet = np.cumsum([0, *(len(facets.cells) for facets in parts)], dtype=np.int64)[part] + row
    x, normal, jxw = np.empty((n, d)), np.empty((n, d)), np.empty(n)
    values, slope, grad = np.zeros((n, nn)), np.zeros((n, nn, d)), np.zeros((n, nn, d))
    for k, facets in enumerate(parts):
        c = np.flatnonzero(part == k)
        x[c], normal[c], area, v, g, strain = at_places(space, facets, row[c], s[c])
        values[c, : v.shape[1]], slope[c, : v.shape[1]], grad[c, : v.shape[1]] = v, g, strain
        jxw[c] = w[c] * area * space.circumference(x[c])
    whole = ~np.isin(source.facet, facet)
    columns = {"facet": facet, "x": x, "normal": normal, "jxw": jxw, "shape": values, "grad": grad}
    if source.slope is not None:
        columns["slope"] = slope
    columns = {key: np.concatenate([getattr(source, key)[whole], value]) for key, value in columns.items()}
    order = np.argsort(columns["facet"], kind="stable")
    return dataclasses.replace(source, **{key: value[order] for key, value in columns.items()})
