"""The walk of the tree of facets: a heap of boxes by their distance, and what bounds that distance from below."""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.cones import holds_none, is_behind
from pcontact.runtime.jit import njit_inline, njit_inner_exact

# points that are searched together at most, and how far they are from the first one, over the distance of the second
TOGETHER, SPREAD = 32, 4.0
ROUNDING = 1e-15  # of the largest coordinate: what a stored coordinate is worth


class Queue(NamedTuple):
    """What the walk for a point has before it; items are nodes of the tree, then facets in the order of the leaves.

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
    """Where the walks of points that lie together start: nodes of the tree within reach of the box around them.

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
