"""Convex polygons in the reference domain of a facet, cut into triangles that tile it: compiled kernels.

A polygon is an array (m, 2) of vertices, counter-clockwise, of which the first n count.
"""

import numpy as np

from pcontact.runtime.jit import njit_exact

# vertices of a polygon at most: a quadrilateral that four lines cut has eight, one that is cut off again a few more
MOST = 24
# polygons that are left over of one facet at most
PIECES = 512
# area that counts as none, and by which the parts of a facet may miss the whole, over that of the facet
SLIVER, WHOLE = 1e-13, 1e-10
# distance from a line, over its length and in reference coordinates, below which a vertex is on it
ON_LINE = 1e-13


@njit_exact
def area(p, n):
    """Signed area of a polygon."""
    total = 0.0
    for i in range(1, n - 1):
        total += (p[i, 0] - p[0, 0]) * (p[i + 1, 1] - p[0, 1]) - (p[i, 1] - p[0, 1]) * (p[i + 1, 0] - p[0, 0])
    return 0.5 * total


@njit_exact
def split(p, n, a, b, left, right):
    """Cut a polygon along the line from a to b; return how many vertices the parts on its two sides have."""
    tx, ty = b[0] - a[0], b[1] - a[1]
    length = np.sqrt(tx * tx + ty * ty)
    n_left = n_right = 0
    if length == 0.0:
        return 0, 0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        d = (tx * (p[i, 1] - a[1]) - ty * (p[i, 0] - a[0])) / length
        e = (tx * (p[j, 1] - a[1]) - ty * (p[j, 0] - a[0])) / length
        d, e = 0.0 if abs(d) < ON_LINE else d, 0.0 if abs(e) < ON_LINE else e
        if d >= 0.0:
            left[n_left, 0], left[n_left, 1] = p[i, 0], p[i, 1]
            n_left += 1
        if d <= 0.0:
            right[n_right, 0], right[n_right, 1] = p[i, 0], p[i, 1]
            n_right += 1
        if d * e < 0.0:
            s = d / (d - e)
            for k in range(2):
                left[n_left, k] = right[n_right, k] = p[i, k] + s * (p[j, k] - p[i, k])
            n_left += 1
            n_right += 1
    return n_left, n_right


@njit_exact
def _emit(p, n, facet, least, count, owners, triangles):
    """Append the triangles of a polygon, or only count them if there is no room."""
    for i in range(1, n - 1):
        size = (p[i, 0] - p[0, 0]) * (p[i + 1, 1] - p[0, 1]) - (p[i, 1] - p[0, 1]) * (p[i + 1, 0] - p[0, 0])
        if 0.5 * size <= least:
            continue
        if count < len(owners):
            owners[count] = facet
            for k in range(2):
                triangles[count, 0, k] = p[0, k]
                triangles[count, 1, k] = p[i, k]
                triangles[count, 2, k] = p[i + 1, k]
        count += 1
    return count


@njit_exact
def _within(polygon, n, domain, work):
    """Part of a polygon within the reference domain, into work[0]; return its number of vertices."""
    for i in range(n):
        work[0, i, 0], work[0, i, 1] = polygon[i, 0], polygon[i, 1]
    for e in range(len(domain)):
        n, _ = split(work[0], n, domain[e], domain[(e + 1) % len(domain)], work[1], work[2])
        for i in range(n):
            work[0, i, 0], work[0, i, 1] = work[1, i, 0], work[1, i, 1]
        if n < 3:
            return 0
    return n


@njit_exact
def _take(polygon, m, pieces, sizes, n_pieces, facet, least, count, owners, triangles, work):
    """Take a polygon out of the pieces that are left; return how many there are, and triangles. -1: no room."""
    for r in range(n_pieces):
        n = sizes[r]
        for i in range(n):
            work[0, i, 0], work[0, i, 1] = pieces[r, i, 0], pieces[r, i, 1]
        room = n_pieces
        for e in range(m):
            n, rest = split(work[0], n, polygon[e], polygon[(e + 1) % m], work[1], work[2])
            for i in range(n):
                work[0, i, 0], work[0, i, 1] = work[1, i, 0], work[1, i, 1]
            if n < 3 or area(work[0], n) <= least:
                n = 0
                break
            if rest >= 3 and area(work[2], rest) > least:
                if room == PIECES:
                    return -1, count
                sizes[room] = rest
                for i in range(rest):
                    pieces[room, i, 0], pieces[room, i, 1] = work[2, i, 0], work[2, i, 1]
                room += 1
        if n == 0:
            # nothing in common: the piece stays whole, and what was cut off on the way is forgotten
            continue
        count = _emit(work[0], n, facet, least, count, owners, triangles)
        sizes[r] = 0
        if room > n_pieces:
            room -= 1
            sizes[r] = sizes[room]
            for i in range(sizes[r]):
                pieces[r, i, 0], pieces[r, i, 1] = pieces[room, i, 0], pieces[room, i, 1]
        n_pieces = room
    return n_pieces, count


@njit_exact
def tile(domain, first, polygons, corners, cut, owners, triangles):
    """Triangles that tile facets, none of which crosses the edge of a polygon.

    Where the polygons of a facet together are the facet, each is cut off at its border. Otherwise, at the border of
    a target or where several lie over each other, each takes what those before it have left, and the rest of the facet
    is tiled, too.

    Parameters
    ----------
    domain : (n, 2) float64
        Vertices of the reference domain.
    first : (nf + 1,) int64
        The polygons of facet f are first[f] to first[f + 1], the nearest first.
    polygons : (m, 4, 2) float64
        Convex, counter-clockwise.
    corners : (m,) int64
        How many vertices each has.
    cut : (nf,) bool
        Output: false where a facet has no polygons within it, or too many pieces; it has no triangles.
    owners : (n,) int64
    triangles : (n, 3, 2) float64
        Output, as far as there is room: facet and vertices of each triangle.

    Returns
    -------
    int
        Number of triangles.
    """
    work, copy = np.empty((3, MOST, 2)), np.empty((MOST, 2))
    pieces, sizes = np.empty((PIECES, MOST, 2)), np.empty(PIECES, dtype=np.int64)
    whole, count = area(domain, len(domain)), 0
    least = SLIVER * whole
    for f in range(len(first) - 1):
        total, start = 0.0, count
        for j in range(first[f], first[f + 1]):
            n = _within(polygons[j], corners[j], domain, work)
            if n < 3:
                continue
            own = area(work[0], n)
            if own > least:
                total += own
                count = _emit(work[0], n, f, least, count, owners, triangles)
        cut[f] = total > WHOLE * whole
        if not cut[f] or abs(total - whole) <= WHOLE * whole:
            count = count if cut[f] else start
            continue
        count, n_pieces = start, 1
        sizes[0] = len(domain)
        pieces[0, : len(domain)] = domain
        for j in range(first[f], first[f + 1]):
            copy[: corners[j]] = polygons[j, : corners[j]]
            n_pieces, count = _take(
                copy, corners[j], pieces, sizes, n_pieces, f, least, count, owners, triangles, work
            )  # fmt: skip
            if n_pieces < 0:
                break
        cut[f] = n_pieces >= 0
        if not cut[f]:
            count = start
        for r in range(n_pieces):
            if sizes[r] >= 3:
                count = _emit(pieces[r], sizes[r], f, least, count, owners, triangles)
    return count
