"""Closest point projection and ray tracing of points onto a surface of facets.

Both return one partner per point, with the contact normal n pointing from the source (the point) to the
target, and the gap g = (y - x) . n: positive open, negative penetration.

Which facet wins. Facets are visited in the order of their distance. Those that fail the facing rule, nX . n
>= facing, never win, and never hide a farther one. Among accepted facets whose distances agree to 1e-10 of
the facet size, a projection inside its facet is preferred to one held at an edge, that to one held at a corner, and
of two inside the one that hangs less over its border; then the nearer one as far as rounding tells, then the smallest
global facet number. The outcome depends neither on the order of the facets nor, by the same rule between ranks
(`pcontact.contact.search.partners`), on how they are spread, nor, but for rounding, on their numbers. Facets that meet
in the nearest point give the same partner, whichever has the smaller number; it decides between different points only
where a point is exactly as far from the insides of two facets.

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

The search is a compiled best-first walk of the tree, one point after the other. A heap holds, by distance, tree nodes
and facets (with the distance of their boxes, a lower bound) and facets already solved (with their own distance). Solved
facets therefore leave the heap in the order of their distance; those that agree within a tolerance form a group, in
which normals are combined and the winner is chosen. The walk ends with the first group that holds an accepted facet:
facets behind it are never solved.

What cannot hold a partner (`Cones`) is set aside, and solved only where it meets a facet that may: there its normals
count, and whether it is nearer.

What a search is asked are tuples that kernels take as they are; their arrays are then of the types below, and none is
left out.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.exclusion import is_around, is_own, no_exclusion, writable
from pcontact.contact.search.facet import GRID, LocalFacet, closest_on_facet, ray_on_facet
from pcontact.contact.search.tree import Cones, Tree, build_tree, holds_none, is_behind, no_cones
from pcontact.contact.surface.facet_maps import (
    SQUARE_CORNERS,
    TRIANGLE_CORNERS,
    facet_boxes,
    fill_jet,
    is_segment,
    is_triangle,
    jet_normal,
    load_nodes,
    simplest_kinds,
)
from pcontact.runtime.jit import njit_exact, njit_inline, njit_inner_exact

# points that are searched together at most, and how far they are from the first one, over the distance of the second
TOGETHER, SPREAD = 32, 4.0
ROUNDING = 1e-15  # of the largest coordinate: what a stored coordinate is worth


class Queue(NamedTuple):
    """Stack of the walk for a point; items are nodes of the tree, then facets in the order of the leaves.

    Attributes
    ----------
    keys : (n,) float64
        A heap: lower bounds of distances [length].
    items : (n,) int64
        What they belong to; after the facets come rows of the table of solved facets.
    aside : (m,) int64
        Items that hold no partner, but perhaps a neighbour of one: visited only beside a facet that may win.
    """

    keys: np.ndarray
    items: np.ndarray
    aside: np.ndarray


class QueryPoint(NamedTuple):
    """The point whose partner is looked for.

    Attributes
    ----------
    number : int
        Among the points of the search.
    x, n : (3,) float64
        Its place [length] and unit normal.
    rounding : float
        What its coordinates are worth [length].
    radius : float
        Largest distance of a partner [length].
    """

    number: int
    x: np.ndarray
    n: np.ndarray
    rounding: float
    radius: float


@njit_inner_exact
def load_point(query, q, x, n):
    """Copy a point and its normal, made a unit vector; return the rounding length, inf if unusable."""
    points, normals, offset, length2 = query.x, query.normal, 0.0, 0.0
    for k in range(points.shape[1]):
        x[k], n[k] = points[q, k], normals[q, k]
        offset, length2 = offset + abs(x[k]), length2 + n[k] * n[k]
    if not (0.0 < length2 < np.inf and offset < np.inf):
        return np.inf
    length = np.sqrt(length2)
    for k in range(points.shape[1]):
        n[k] /= length
    return ROUNDING * offset


@njit_inner_exact
def push(queue, count, key, item):
    """Add to the heap; return its size."""
    keys, items, i = queue.keys, queue.items, count
    while i > 0:
        parent = (i - 1) // 2
        if keys[parent] <= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        i = parent
    keys[i], items[i] = key, item
    return count + 1


@njit_inner_exact
def pop(queue, count):
    """Remove the first of the heap; return its size."""
    keys, items = queue.keys, queue.items
    count -= 1
    key, item, i = keys[count], items[count], 0
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and keys[child + 1] < keys[child]:
            child += 1
        if key <= keys[child]:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item
    return count


@njit_inner_exact
def expand(target, criteria, exclusion, point, node, queue, count, n_aside):
    """Push the children of a node, or the facets of a leaf, that may hold a partner; return the new counts."""
    tree, cones, q, x, n = target.tree, target.cones, point.number, point.x, point.n
    inner = tree.child[node] >= 0
    lower, upper = (tree.lower, tree.upper) if inner else (tree.facet_lower, tree.facet_upper)
    first, last = (tree.child[node], tree.child[node] + 2) if inner else (tree.first[node], tree.last[node])
    shift = 0 if inner else tree.child.size
    known, on_it = cones.cosine.size > 0 and not criteria.rays, exclusion.parts.size > 0
    xq = exclusion.x[q if on_it else 0 : (q if on_it else 0) + 1]
    part, slack = (exclusion.parts[q], exclusion.slack[q]) if on_it else (-1, 0.0)
    whole = exclusion.whole
    for i in range(first, last):
        item = shift + i
        if item < whole.size and whole[item] == part:
            continue  # nothing but the point's own body
        if criteria.rays:
            key = ray_bound(lower, upper, i, x, n, point.rounding)
        else:
            key = bound(lower, upper, i, x, n, criteria.facing, point.rounding)
        if not key <= point.radius:
            continue
        if known and (
            holds_none(cones, item, lower, upper, i, x, n, criteria.facing)
            or (on_it and is_behind(cones, item, part, xq[0], slack))
        ):
            queue.aside[n_aside] = item
            n_aside += 1
        else:
            count = push(queue, count, key, item)
    return count, n_aside


@njit_inner_exact
def start_bound(tree, criteria, point, node):
    """Lower bound of the distance of any accepted partner in a node of the tree."""
    if criteria.rays:
        return ray_bound(tree.lower, tree.upper, node, point.x, point.n, point.rounding)
    return bound(tree.lower, tree.upper, node, point.x, point.n, criteria.facing, point.rounding)


@njit_inner_exact
def starts_of(tree, points, q, end, reach, exclusion, starts, box):
    """Starts of the walks of points that lie together: nodes of the tree within reach of the box around them.

    Parameters
    ----------
    q, end : int
        The points are q to end - 1. All pass by the body of the first.
    reach : float
        How far from the points a partner may be [length].
    starts : (n,) int64
        Filled with nodes, as far down as there is room.
    box : (2, 3) float64
        Scratch.

    Returns
    -------
    int
        The number of nodes.
    """
    d, offset, passing = points.shape[1], 0.0, exclusion.whole.size > 0
    for k in range(d):
        box[0, k], box[1, k] = np.inf, -np.inf
    for p in range(q, end):
        for k in range(d):
            box[0, k], box[1, k] = min(box[0, k], points[p, k]), max(box[1, k], points[p, k])
    for k in range(d):
        offset = max(offset, abs(box[0, k]), abs(box[1, k]))
    reach = reach * (1.0 + 1e-12) + 8.0 * ROUNDING * offset
    count, at = 1, 0
    starts[0] = 0
    while at < count:
        node = starts[at]
        if tree.child[node] < 0 or count == starts.size:
            at += 1
            continue
        count -= 1
        starts[at] = starts[count]
        for child in range(tree.child[node], tree.child[node] + 2):
            if passing and exclusion.whole[child] == exclusion.parts[q]:
                continue
            away2 = 0.0
            for k in range(d):
                away2 += max(tree.lower[child, k] - box[1, k], box[0, k] - tree.upper[child, k], 0.0) ** 2
            if not away2 > reach * reach:
                starts[count] = child
                count += 1
    return count


@njit_inner_exact
def end_of(points, q, exclusion):
    """The first point that does not lie together with point q: on another facet, or some distances further on.

    Points of a facet come one after the other; where nothing says of which facet they are, those belong together
    whose distance from point q is not much larger than that of the next one.
    """
    end, d = q + 1, points.shape[1]
    if exclusion.whole.size > 0:
        cells, parts = exclusion.cells, exclusion.parts
        while end < points.shape[0] and cells[end] == cells[q] and parts[end] == parts[q]:
            end += 1
        return end
    near2 = 0.0
    while end < points.shape[0] and end < q + TOGETHER:
        away2 = 0.0
        for k in range(d):
            away2 += (points[end, k] - points[q, k]) ** 2
        if end == q + 1:
            near2 = SPREAD * SPREAD * away2
        if not away2 <= near2:
            break
        end += 1
    return end


@njit_inner_exact
def apart_from(points, p, q):
    """Distance of two points."""
    total = 0.0
    for k in range(points.shape[1]):
        total += (points[p, k] - points[q, k]) ** 2
    return np.sqrt(total)


@njit_inline
def bound(lower, upper, row, x, n, facing, rounding):
    """Lower bound of the distance of any accepted partner inside a box; inf: there is none."""
    distance2, along, reach, size = 0.0, 0.0, 0.0, 0.0
    for k in range(lower.shape[1]):
        low, high = lower[row, k] - x[k], upper[row, k] - x[k]
        out, half = max(low, -high, 0.0), 0.5 * (high - low)
        distance2, size = distance2 + out * out, size + half
        along, reach = along + 0.5 * (low + high) * n[k], reach + half * abs(n[k])
    # the contact normal is along the offset, and must stay in the double cone about nX (but for offsets too
    # small to have a direction): a box outside the cone holds no partner, nor a neighbour that shares a
    # partner's point
    distance = np.sqrt(distance2)
    outside = facing > 0.0 and abs(along) + reach < facing * (distance - 1e-8 * size - 4.0 * rounding)
    return np.inf if outside else distance * (1.0 - 1e-14)


@njit_inner_exact
def ray_bound(lower, upper, row, x, n, rounding):
    """Smallest abs(t) for which x + t n is in a box that is a little enlarged; inf: it misses."""
    diagonal, start, end = 0.0, -np.inf, np.inf
    for k in range(lower.shape[1]):
        diagonal += upper[row, k] - lower[row, k]
    slack = 1e-8 * diagonal + 4.0 * rounding
    for k in range(lower.shape[1]):
        low, high = lower[row, k] - x[k] - slack, upper[row, k] - x[k] + slack
        if n[k] == 0.0:
            if low > 0.0 or high < 0.0:
                return np.inf
        else:
            a, b = low / n[k], high / n[k]
            start, end = max(start, min(a, b)), min(end, max(a, b))
    if start > end:
        return np.inf
    return max(start, -end, 0.0)


TIE = 1e-10  # of the facet size: distances that count as equal
TOUCH = 1e-9  # of the facet size: offsets that have no direction, and how far over a border a point may hang
SAME_POINT = 1e-6  # of the facet size: closest points of neighbours that count as one
BEHIND = 0.9  # how far an offset that leads out of a body may leave the cone of the normals at its end (in cosines)
ALONG = 1.0 - 1e-6  # the same of any offset, where only points opposite the surface have partners
EVEN = 1e-14  # of the distance and a tenth of it of the facet size: by how much rounding tells distances apart
AT_CORNER = 1e-13  # reference coordinates that are those of a corner
# how a projection is held: inside by how far it hangs over the border, below 1; at an edge, at a corner
EDGE, CORNER = 1.0, 2.0
# in the place of the facet of a point that has none because the search was not patient enough
GIVEN_UP = -2
# columns of the table of solved facets: distance, gap, reference coordinates, y - x (3), target normal (3),
# contact normal (3), interior (0 or 1), angle at y, facet size, rounding length, whether it is no partner (0 or 1),
# how it is held, whether the point is on it or on a neighbour (0 or 1)
DISTANCE, GAP, U, V, R, NY, N = 0, 1, 2, 3, 4, 7, 10
INTERIOR, ANGLE, SIZE, SLACK, LOST, HELD, AROUND, COLUMNS = 13, 14, 15, 16, 17, 18, 19, 20


class Solved(NamedTuple):
    """Facets that are solved for a point, in the order in which they were.

    Attributes
    ----------
    found : (nf, COLUMNS) float64
        The table.
    leaves : (nf,) int64
        Number of each of these facets in the order of the leaves of the tree.
    group : (nf,) int64
        Rows of those whose distances agree.
    """

    found: np.ndarray
    leaves: np.ndarray
    group: np.ndarray


@njit_inner_exact
def sort_group(solved, count, order, ids):
    """Sort a group by global number: sums over it and its winner must not depend on the facets' order."""
    group, leaves = solved.group, solved.leaves
    for i in range(1, count):
        slot, j = group[i], i
        while j > 0 and ids[order[leaves[group[j - 1]]]] > ids[order[leaves[slot]]]:
            group[j] = group[j - 1]
            j -= 1
        group[j] = slot


@njit_inner_exact
def goes_before(row, other):
    """Return whether one of two facets of a group is the partner, by their shapes: else the smaller number is."""
    if row[HELD] != other[HELD]:
        return row[HELD] < other[HELD]
    rounding = EVEN * (other[DISTANCE] + 0.1 * other[SIZE]) + other[SLACK]
    return row[DISTANCE] < other[DISTANCE] - rounding


@njit_inner_exact
def set_normal(solved, count, row, strict, opposite):
    """Contact normal and gap of one facet of a group, see the head of `projection`; no normal: no partner.

    A point that touches another surface lies on its own facets, too: those say nothing of the other one.
    """
    found, group = solved.found, solved.group
    touching = row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]
    if row[INTERIOR] > 0.0 and not touching:
        n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    else:
        m0, m1, m2, same, cone = 0.0, 0.0, 0.0, (SAME_POINT * row[SIZE] + row[SLACK]) ** 2, np.inf
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same and not other[AROUND] > row[AROUND]:
                w = other[ANGLE]
                m0, m1, m2 = m0 + w * other[NY], m1 + w * other[NY + 1], m2 + w * other[NY + 2]
        length = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same and not other[AROUND] > row[AROUND]:
                cone = min(cone, m0 * other[NY] + m1 * other[NY + 1] + m2 * other[NY + 2])
        if not touching:
            # outside, the offset looks against the normals
            along = row[R] * m0 + row[R + 1] * m1 + row[R + 2] * m2
            inside = along > 0.0
            length = -row[DISTANCE] if inside else row[DISTANCE]
            n0, n1, n2 = row[R] / length, row[R + 1] / length, row[R + 2] / length
            if strict and (inside or opposite) and abs(along) < (ALONG if opposite else BEHIND) * cone * row[DISTANCE]:
                # out of the cone of the normals: beside the border of the target, not behind it or in front of it
                n0, n1, n2 = 0.0, 0.0, 0.0
        elif length > 0.0:
            n0, n1, n2 = -m0 / length, -m1 / length, -m2 / length
        else:
            n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    row[N], row[N + 1], row[N + 2] = n0, n1, n2
    row[GAP] = row[R] * n0 + row[R + 1] * n1 + row[R + 2] * n2


@njit_inner_exact
def write_partner(projections, q, x, row, facet, ids):
    """Copy the winner to the arrays of the result."""
    projections.facet[q], projections.id[q] = facet, ids[facet]
    projections.gap[q], projections.distance[q] = row[GAP], row[DISTANCE]
    projections.size[q], projections.held[q] = row[SIZE], row[HELD]
    projections.xi[q, 0] = row[U]
    if projections.xi.shape[1] == 2:
        projections.xi[q, 1] = row[V]
    for k in range(projections.y.shape[1]):
        projections.y[q, k], projections.normal[q, k] = x[k] + row[R + k], row[N + k]


# by how much more than the distance of a known partner points beside its own look, over that and over the facet's size
NEARLY = 1e-5
STARTS = 32  # nodes below the root at most from which the points of a facet start


class Workspace(NamedTuple):
    """Scratch of a search, for one point after the other.

    Attributes
    ----------
    queue : Queue
    solved : Solved
    starts : (STARTS,) int64
        Nodes of the tree at which the walks start.
    box : (2, 3) float64
        Around points that lie together [length].
    x, n : (3,) float64
        The point [length] and its normal.
    local : LocalFacet
    """

    queue: Queue
    solved: Solved
    starts: np.ndarray
    box: np.ndarray
    x: np.ndarray
    n: np.ndarray
    local: LocalFacet


@njit_exact
def search_all(target, query, criteria, exclusion, projections):
    """Write where all points are projected to.

    Parameters
    ----------
    target : pcontact.contact.search.projection.TargetFacets
    query : pcontact.contact.search.projection.QueryPoints
    criteria : pcontact.contact.search.projection.Criteria
    exclusion : pcontact.contact.search.exclusion.Exclusion
    projections : pcontact.contact.search.projection.Projections
        Comes filled for points without a partner.
    """
    n_nodes, nf = target.tree.child.size, target.kinds.size
    # heap items: nodes, then facets in the order of the leaves, then rows of solved facets
    keys, items = np.empty(n_nodes + 2 * nf), np.empty(n_nodes + 2 * nf, dtype=np.int64)
    queue = Queue(keys, items, np.empty(n_nodes + nf, dtype=np.int64))
    leaves, group = np.empty(nf, dtype=np.int64), np.empty(nf, dtype=np.int64)
    solved = Solved(np.zeros((nf, COLUMNS)), leaves, group)
    starts, box, x, n = np.zeros(STARTS, dtype=np.int64), np.zeros((2, 3)), np.zeros(3), np.zeros(3)
    local = LocalFacet(np.zeros((9, 3)), np.zeros(3), np.zeros((6, 9)), np.zeros((6, 3)), np.zeros((GRID, GRID)))
    work = Workspace(queue, solved, starts, box, x, n, local)
    _search_points(target, query, criteria, exclusion, projections, work)


@njit_inner_exact
def _search_points(target, query, criteria, exclusion, projections, work):
    """One point after the other."""
    tree, kinds, points, radii = target.tree, target.kinds, query.x, query.radius
    rays, facing, opposite = criteria
    queue, solved, starts, box, x, n, local = work
    found, leaves, group = solved
    n_nodes, nf, on_it = tree.child.size, kinds.size, exclusion.parts.size > 0
    # points that lie together start together below the root, as far down as the partner of the first one allows
    first, end, n_starts, hint = 0, 0, 0, np.inf
    q, again, done = 0, False, False
    while q < points.shape[0] and n_nodes > 0:
        if again:
            n_starts = starts_of(tree, points, q, q + 1, radii[q], exclusion, starts, box)
        elif q >= end:
            first, end, hint = q, end_of(points, q, exclusion), np.inf
            n_starts = starts_of(tree, points, q, q + 1, radii[q], exclusion, starts, box)
        rounding = load_point(query, q, x, n)
        if n_starts == 0 or not rounding < np.inf:
            # the starts are those of this point alone
            end = q + 1 if q == first or again else end
            q, again = q + 1, False
            continue
        radius, n_queue, n_found, n_group, nearest, limit, n_aside = radii[q], 0, 0, 0, 0.0, 0.0, 0
        if not again and hint < np.inf:
            # the partner of the first point is no farther than that; whether it is this one's, too, is to be seen
            radius = min(radius, hint + apart_from(points, q, first) * (1.0 + NEARLY) + 16.0 * rounding)
        point = QueryPoint(q, x, n, rounding, radius)
        done, winner = False, -1
        for i in range(n_starts):
            key = start_bound(tree, criteria, point, starts[i])
            if key <= radius:
                n_queue = push(queue, n_queue, key, starts[i])
        while n_queue > 0 or n_group > 0:
            key, item = (queue.keys[0], queue.items[0]) if n_queue > 0 else (np.inf, -1)
            if n_group > 0 and not key <= limit:
                if n_aside > 0:
                    n_all = n_found
                    for i in range(n_group):
                        row, leaf = found[group[i]], leaves[group[i]]
                        if row[LOST] > 0.0 or not _asks(row):
                            continue
                        side = _side(row, target.cones, n_nodes + leaf)
                        row[LOST] = _loses(row, side, n, facing)
                        if on_it and row[LOST] == 0.0:
                            row[LOST] = _is_own_on(exclusion, q, tree.order[leaf], kinds, row, side, local.shapes)
                        if row[LOST] == 0.0 and _is_passed_by(target, point, solved, group[i], n_found, local):
                            row[LOST] = 1.0
                        if row[LOST] > 0.0:
                            continue
                        n_aside, n_all = _fetch(target, criteria, point, work, row, n_all, n_aside)
                    joined = n_group
                    for slot in range(n_found, n_all):
                        tie = TIE * found[slot, SIZE] + rounding
                        if found[slot, DISTANCE] <= radius and abs(found[slot, DISTANCE] - nearest) <= tie:
                            limit = max(limit, nearest * (1.0 + 1e-14) + tie)
                            group[n_group] = slot
                            n_group += 1
                    projections.candidates[q] += n_all - n_found
                    n_found = n_all
                    if n_group > joined:
                        continue
                sort_group(solved, n_group, tree.order, target.ids)
                if not rays:
                    for i in range(n_group if on_it else 0):
                        around = is_around(exclusion, q, tree.order[leaves[group[i]]])
                        found[group[i], AROUND] = 1.0 if around else 0.0
                    for i in range(n_group):
                        set_normal(solved, n_group, found[group[i]], facing > 0.0, opposite)
                winner = -1
                for i in range(n_group):
                    slot = group[i]
                    row, facet = found[slot], tree.order[leaves[slot]]
                    if (
                        row[LOST] > 0.0
                        or n[0] * row[N] + n[1] * row[N + 1] + n[2] * row[N + 2] < facing
                        or (on_it and _is_own(exclusion, q, facet, kinds[facet], row, N, 1.0, local.shapes))
                        or _is_passed_by(target, point, solved, slot, n_found, local)
                    ):
                        continue
                    if target.own[facet]:
                        if winner < 0 or goes_before(row, found[winner]):
                            winner = slot
                    elif not _asks(row):
                        # held at an edge whose neighbours are not known here, another one hides nothing
                        done = True
                if winner >= 0:
                    write_partner(projections, q, x, found[winner], tree.order[leaves[winner]], target.ids)
                    done = True
                if done:
                    break
                n_group = 0
                continue
            n_queue = pop(queue, n_queue)
            if item < n_nodes:
                n_queue, n_aside = expand(target, criteria, exclusion, point, item, queue, n_queue, n_aside)
            elif item < n_nodes + nf:
                if projections.candidates[q] >= query.patience:
                    projections.facet[q] = GIVEN_UP
                    break
                row = found[n_found]
                projections.candidates[q] += 1
                _solve(target, criteria, point, local, item - n_nodes, row)
                if row[DISTANCE] <= radius and row[DISTANCE] < np.inf:
                    leaves[n_found] = item - n_nodes
                    n_queue = push(queue, n_queue, row[DISTANCE], n_nodes + nf + n_found)
                    n_found += 1
            else:
                slot = item - n_nodes - nf
                if n_group == 0:
                    nearest = limit = key
                limit = max(limit, nearest * (1.0 + 1e-14) + TIE * found[slot, SIZE] + rounding)
                group[n_group] = slot
                n_group += 1
        if not done and not again and hint < np.inf and projections.facet[q] != GIVEN_UP:
            again = True
            continue
        if again:
            end, again = q + 1, False
        elif q == first and end > q + 1:
            if winner >= 0:
                hint = nearest * (1.0 + NEARLY) + NEARLY * found[winner, SIZE] + 16.0 * rounding
            reach = 0.0
            for other in range(q + 1, end):
                reach = max(reach, min(radii[other], hint + apart_from(points, other, q) * (1.0 + NEARLY)))
            n_starts = starts_of(tree, points, q + 1, end, reach, exclusion, starts, box)
        q += 1


@njit_inner_exact
def _is_own(exclusion, q, facet, kind, row, column, factor, shapes):
    """`exclusion.is_own` with a multiple of three columns of a solved facet as the normal."""
    normal = factor * row[column], factor * row[column + 1], factor * row[column + 2]
    return is_own(exclusion, q, facet, kind, (row[U], row[V]), normal, shapes)


@njit_inner_exact
def _asks(row):
    """Return whether the contact normal of a solved facet depends on its neighbours: held at an edge, or touching."""
    return not row[INTERIOR] > 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]


@njit_inner_exact
def _side(row, cones, item):
    """The multiple of the offset r of a facet held at an edge that is its contact normal, if it has one.

    It is along r, and against a normal of the cone. Returns -1 / |r| (inside), 1 / |r| (outside), 0 (along no normal of
    the cone: a neighbour is nearer), inf (not known).
    """
    axes, cosine = cones.axis, cones.cosine[item]
    if cosine < 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]:
        return np.inf
    along = row[R] * axes[item, 0] + row[R + 1] * axes[item, 1] + row[R + 2] * axes[item, 2]
    if abs(along) < cosine * row[DISTANCE]:
        return 0.0
    return -1.0 / row[DISTANCE] if along > 0.0 else 1.0 / row[DISTANCE]


@njit_inner_exact
def _loses(row, side, n, facing):
    """1 if a facet held at an edge has no contact normal that faces the point, else 0."""
    if side == np.inf:
        return 0.0
    cosine = side * (n[0] * row[R] + n[1] * row[R + 1] + n[2] * row[R + 2])
    return 0.0 if side != 0.0 and cosine >= facing - 1e-9 else 1.0


@njit_inner_exact
def _is_own_on(exclusion, q, facet, kinds, row, side, shapes):
    """1 if a facet belongs to the point's neighbourhood on the side that is known, else 0."""
    if side == np.inf:
        return 0.0
    return 1.0 if _is_own(exclusion, q, facet, kinds[facet], row, R, side, shapes) else 0.0


@njit_inner_exact
def _fetch(target, criteria, point, work, row, n_found, n_aside):
    """Solve the facets set aside at the nearest point of a solved facet.

    They hold no partner, but their normals count there, and whether they are nearer. Returns how many are left aside,
    and how many facets are solved (they were `n_found`).
    """
    tree, x, aside, solved = target.tree, point.x, work.queue.aside, work.solved
    n_nodes, k = tree.child.size, 0
    lower, upper, facet_lower, facet_upper = tree.lower, tree.upper, tree.facet_lower, tree.facet_upper
    slack = SAME_POINT * row[SIZE] + row[SLACK]
    while k < n_aside:
        item = aside[k]
        if item < n_nodes:
            away = _distance_to_box(lower, upper, item, x, row)
        else:
            away = _distance_to_box(facet_lower, facet_upper, item - n_nodes, x, row)
        if away > slack:
            k += 1
            continue
        n_aside -= 1
        aside[k] = aside[n_aside]
        if item >= n_nodes:
            _solve(target, criteria, point, work.local, item - n_nodes, solved.found[n_found])
            solved.leaves[n_found] = item - n_nodes
            n_found += 1
            continue
        first, last, shift = tree.child[item], tree.child[item] + 2, 0
        if first < 0:
            first, last, shift = tree.first[item], tree.last[item], n_nodes
        for child in range(first, last):
            aside[n_aside] = shift + child
            n_aside += 1
    return n_aside, n_found


@njit_inline
def _distance_to_box(lower, upper, row, x, solved):
    """Distance (largest component) between a box and the point x + r of a solved facet."""
    away = 0.0
    for k in range(lower.shape[1]):
        y = x[k] + solved[R + k]
        away = max(away, lower[row, k] - y, y - upper[row, k])
    return away


@njit_inner_exact
def _solve(target, criteria, point, local, leaf, row):
    """Fill the row of one facet; distance inf if it is no partner whatever its neighbours are."""
    tree, x_facets, x, n, rounding = target.tree, target.x, point.x, point.n, point.rounding
    nodes, p, shapes, jet, _ = local
    facet = tree.order[leaf]
    kind, size2 = target.kinds[facet], 0.0
    load_nodes(x_facets, facet, kind, nodes)
    for k in range(x_facets.shape[2]):
        p[k] = x[k] - x_facets[facet, 0, k]
        size2 += (tree.facet_upper[leaf, k] - tree.facet_lower[leaf, k]) ** 2
    row[SIZE], row[SLACK] = np.sqrt(size2), rounding
    row[DISTANCE], row[INTERIOR], row[ANGLE], row[LOST], row[HELD], row[AROUND] = np.inf, 1.0, 1.0, 0.0, 0.0, 0.0
    if not row[SIZE] > 0.0:
        return
    if criteria.rays:
        slack = 1e-12 * row[SIZE] + row[SLACK]
        g, row[U], row[V], over = ray_on_facet(kind, local, n, criteria.facing, slack)
        row[DISTANCE], row[GAP], row[HELD] = abs(g), g, max(over - 1e-14 - rounding / row[SIZE], 0.0)
        for k in range(3):
            row[R + k], row[N + k] = g * n[k], n[k]
        return
    row[U], row[V] = closest_on_facet(kind, local)
    fill_jet(kind, row[U], row[V], nodes, 3, shapes, jet)
    r0, r1, r2 = jet[0, 0] - p[0], jet[0, 1] - p[1], jet[0, 2] - p[2]
    distance = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
    row[ANGLE] = _corner_angle(kind, row[U], row[V], jet)
    n0, n1, n2 = jet_normal(kind, jet)
    if n0 == 0.0 and n1 == 0.0 and n2 == 0.0:
        # a collapsed corner has the normal of the middle
        middle = 1.0 / 3.0 if is_triangle(kind) else 0.0
        fill_jet(kind, middle, middle, nodes, 3, shapes, jet)
        n0, n1, n2 = jet_normal(kind, jet)
        if n0 == 0.0 and n1 == 0.0 and n2 == 0.0:
            return
    along = r0 * n0 + r1 * n1 + r2 * n2
    s0, s1, s2 = r0 - along * n0, r1 - along * n1, r2 - along * n2
    sideways = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    slack = row[SLACK] + 1e-14 * distance
    if sideways > TOUCH * row[SIZE] + slack:
        row[INTERIOR], row[HELD] = 0.0, CORNER if _is_corner(kind, row[U], row[V]) else EDGE
    else:
        row[HELD] = max(sideways - 1e-14 * row[SIZE] - slack, 0.0) / row[SIZE]
    row[DISTANCE] = distance
    row[R], row[R + 1], row[R + 2], row[NY], row[NY + 1], row[NY + 2] = r0, r1, r2, n0, n1, n2


@njit_inner_exact
def _is_corner(kind, u, v):
    """Return whether a reference point is at a corner."""
    if is_segment(kind):
        return True
    corners = 3 if is_triangle(kind) else 4
    table = TRIANGLE_CORNERS if is_triangle(kind) else SQUARE_CORNERS
    for i in range(corners):
        if max(abs(u - table[i, 0]), abs(v - table[i, 1])) <= AT_CORNER:
            return True
    return False


@njit_inner_exact
def _corner_angle(kind, u, v, jet):
    """Angle of the facet at a reference point: that of the corner there, pi elsewhere."""
    if is_segment(kind):
        return np.pi
    corners = 3 if is_triangle(kind) else 4
    table = TRIANGLE_CORNERS if is_triangle(kind) else SQUARE_CORNERS
    for i in range(corners):
        if max(abs(u - table[i, 0]), abs(v - table[i, 1])) > 1e-9:
            continue
        before, after = (i + corners - 1) % corners, (i + 1) % corners
        a0, a1 = table[after, 0] - table[i, 0], table[after, 1] - table[i, 1]
        b0, b1 = table[before, 0] - table[i, 0], table[before, 1] - table[i, 1]
        dot, aa, bb = 0.0, 0.0, 0.0
        for k in range(3):
            a, b = a0 * jet[1, k] + a1 * jet[2, k], b0 * jet[1, k] + b1 * jet[2, k]
            dot, aa, bb = dot + a * b, aa + a * a, bb + b * b
        if not aa * bb > 0.0:
            return 0.0
        return np.arccos(min(max(dot / np.sqrt(aa * bb), -1.0), 1.0))
    return np.pi


@njit_inner_exact
def _is_passed_by(target, point, solved, slot, count, local):
    """Return whether a projection held at an edge is passed by: a neighbour at that edge has a nearer point.

    The neighbour has been solved: it is nearer. It counts even if the facing rule rejected it: a point beside
    a box, its nearest side rejected, must not be taken for one that has gone through the top.
    """
    found, row = solved.found, solved.found[slot]
    if row[INTERIOR] > 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]:
        return False
    tree, x_facets, kinds, x = target.tree, target.x, target.kinds, point.x
    nodes, p, shapes, jet, _ = local
    d, slack = x_facets.shape[2], SAME_POINT * row[SIZE] + row[SLACK]
    lower, upper = tree.facet_lower, tree.facet_upper
    nearer = row[DISTANCE] * (1.0 - 1e-14) - TIE * row[SIZE] - row[SLACK]
    for other in range(count):
        if not found[other, DISTANCE] < nearer:
            continue
        leaf = solved.leaves[other]
        if _distance_to_box(lower, upper, leaf, x, row) > slack:
            continue
        facet = tree.order[leaf]
        load_nodes(x_facets, facet, kinds[facet], nodes)
        for k in range(d):
            p[k] = (x[k] - x_facets[facet, 0, k]) + row[R + k]
        u, v = closest_on_facet(kinds[facet], local)
        fill_jet(kinds[facet], u, v, nodes, 1, shapes, jet)
        if (jet[0, 0] - p[0]) ** 2 + (jet[0, 1] - p[1]) ** 2 + (jet[0, 2] - p[2]) ** 2 <= slack * slack:
            return True
    return False


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
        the best partner of all ranks is then exactly that of the search in the whole surface.
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
        Size of the facet (diagonal of its box) [length]: the scale of the tolerances.
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
    """Tree over facets, see `TargetFacets` for the arrays."""
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


def _search(target, query, criteria, exclusion):
    """Check and convert the arguments (one compiled specialisation serves all), run the kernel."""
    x, points, normals = (np.require(one, np.float64, ["C", "W"]) for one in (target.x, query.x, query.normal))
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
