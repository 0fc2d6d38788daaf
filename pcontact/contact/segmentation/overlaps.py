"""Source facets in space cut along the edges of the target facets they face, see the module `pieces` beside.

The corners of target facets, of all ranks, are moved along the normal of a source facet onto it, and the polygons that
they make there are clipped: neighbours share their corners, so that what they cover fits together to rounding. Edges
are straight in the facet's reference domain; where facets are curved, or far apart and not parallel, the partner
changes a little beside the cut, by a length of second order. Facets that face no target nearby keep their rule.

Polygons are cut into tiles for quadrature rules by compiled kernels. A polygon is an array (m, 2) of vertices,
counter-clockwise, of which the first n count.

A tile is a triangle or a parallelogram. How a polygon is cut depends on its shape alone, not on which vertex comes
first, which way round the facet is seen, or how the vertices of the facet are numbered: a parallelogram stays whole,
other polygons lose one corner after the other, that with the shortest diagonal first, and where diagonals are equally
long and cross, all triangles meet in the centroid. Lengths are measured in the regular triangle and the square. What
polygons leave over of a facet is cut along the whole lines on which its border lies.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from pcontact.contact.search.partners import route
from pcontact.contact.search.tree import build_tree, meeting
from pcontact.contact.surface.facet_maps import SQUARE_CORNERS, TRIANGLE_CORNERS, facet_boxes
from pcontact.element.reference import facet_nodes, shape, shape_gradient
from pcontact.runtime.jit import njit_exact, njit_inner_exact
from pcontact.runtime.parallel import Asked

# vertices of a polygon at most: a quadrilateral that four lines cut has eight, one that is cut off again a few more
MOST = 24
# polygons that are left over of one facet at most
PIECES = 512
# area that counts as none, and by which the parts of a facet may miss the whole, over that of the facet
SLIVER, WHOLE = 1e-13, 1e-10
# distance from a line, over its length and in reference coordinates, below which a vertex is on it
ON_LINE = 1e-13
# the same between two neighbours of a polygon that is to be tiled: such a vertex is no corner
STRAIGHT = 1e-10
# distance of vertices of neighbours that count as one [reference length]
SAME = 1e-9
# by how much the sides of a parallelogram differ at most [reference length]
PARALLEL = 1e-11
# by how much squares of lengths that count as equal differ at most, over their sum
EQUAL = 1e-8


class Polygons(NamedTuple):
    """Convex polygons, counter-clockwise, in the reference domain of a facet.

    Attributes
    ----------
    vertices : (m, k, 2) float64
    corners : (m,) int64
        How many vertices each has, the first ones; 0: the polygon is no more.
    """

    vertices: np.ndarray
    corners: np.ndarray


class Tiles(NamedTuple):
    """Room for tiles.

    Attributes
    ----------
    owners, kinds : (n,) int64
        Facet of each tile, and its number of vertices, 3 or 4 (a parallelogram).
    vertices : (n, 3, 2) float64
        A vertex of each tile and its two neighbours, counter-clockwise.
    """

    owners: np.ndarray
    kinds: np.ndarray
    vertices: np.ndarray


class TiledFacet(NamedTuple):
    """A facet that is tiled.

    Attributes
    ----------
    number : int
    domain : (n, 2) float64
        Vertices of the reference domain: the unit triangle or the square.
    least : float
        Area that counts as none [reference area].
    """

    number: int
    domain: np.ndarray
    least: float


@njit_exact
def area(p, n):
    """Signed area of a polygon."""
    total = 0.0
    for i in range(1, n - 1):
        total += (p[i, 0] - p[0, 0]) * (p[i + 1, 1] - p[0, 1]) - (p[i, 1] - p[0, 1]) * (p[i + 1, 0] - p[0, 0])
    return 0.5 * total


@njit_inner_exact
def _copy(p, n, out):
    """Copy the first vertices of a polygon."""
    for i in range(n):
        out[i, 0], out[i, 1] = p[i, 0], p[i, 1]


@njit_inner_exact
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
def clip(polygons, lines, clipped):
    """Clip convex polygons (n, k, 2), each by the left sides of lines (n, m, 2, 2), given by two points each.

    Parameters
    ----------
    polygons : Polygons
    lines : (n, m, 2, 2) float64
    clipped : Polygons
        Output, with room for k + m vertices; where nothing is left there are no corners.
    """
    work = np.empty((3, MOST, 2))
    for j in range(len(polygons.corners)):
        n = polygons.corners[j]
        _copy(polygons.vertices[j], n, work[0])
        for e in range(lines.shape[1]):
            n, _ = split(work[0], n, lines[j, e, 0], lines[j, e, 1], work[1], work[2])
            _copy(work[1], n, work[0])
            if n < 3:
                n = 0
                break
        clipped.corners[j] = n
        _copy(work[0], n, clipped.vertices[j])


@njit_inner_exact
def _length2(regular, x, y):
    """Square of a length in the regular triangle (up to a factor) or the square, from reference coordinates."""
    return x * x + y * y + (x + y) ** 2 if regular == 3 else x * x + y * y


@njit_inner_exact
def _tidied(p, n):
    """Leave out, in place, vertices that coincide or lie on the line between their neighbours; return how many stay."""
    i, left = 0, n
    while left > 0 and n >= 3:
        i = i % n
        before, after = (i + n - 1) % n, (i + 1) % n
        tx, ty = p[after, 0] - p[before, 0], p[after, 1] - p[before, 1]
        length = np.sqrt(tx * tx + ty * ty)
        away = abs(tx * (p[i, 1] - p[before, 1]) - ty * (p[i, 0] - p[before, 0]))
        left -= 1
        if length < STRAIGHT or away < STRAIGHT * length:
            for k in range(i, n - 1):
                p[k, 0], p[k, 1] = p[k + 1, 0], p[k + 1, 1]
            n -= 1
            # the neighbours are looked at again
            left, i = n, i + n - 1
        else:
            i += 1
    return n if n >= 3 else 0


@njit_inner_exact
def _add(a, b, c, sides, facet, count, tiles):
    """Append a tile with the neighbouring vertices b, a, c, or only count it if there is no room."""
    size = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if 0.5 * size <= facet.least:
        return count
    if count < len(tiles.owners):
        tiles.owners[count], tiles.kinds[count], vertices = facet.number, sides, tiles.vertices
        for k in range(2):
            vertices[count, 0, k], vertices[count, 1, k], vertices[count, 2, k] = a[k], b[k], c[k]
    return count + 1


@njit_exact
def _around_centroid(p, n, facet, count, tiles):
    """Append the triangles between the edges of a polygon and its centroid."""
    centre, whole = np.zeros(2), 0.0
    for i in range(1, n - 1):
        size = (p[i, 0] - p[0, 0]) * (p[i + 1, 1] - p[0, 1]) - (p[i, 1] - p[0, 1]) * (p[i + 1, 0] - p[0, 0])
        whole += size
        for k in range(2):
            centre[k] += size * ((p[i, k] - p[0, k]) + (p[i + 1, k] - p[0, k])) / 3.0
    for k in range(2):
        centre[k] = p[0, k] + centre[k] / whole
    for i in range(n):
        count = _add(centre, p[i], p[(i + 1) % n], 3, facet, count, tiles)
    return count


@njit_exact
def _cut_corners(p, n, facet, count, tiles):
    """Cut off, in place, the corners with the shortest diagonals; return how many are left (0: all), and tiles."""
    regular, lengths, shortest = len(facet.domain), np.empty(n), np.inf
    for i in range(n):
        before, after = (i + n - 1) % n, (i + 1) % n
        lengths[i] = _length2(regular, p[after, 0] - p[before, 0], p[after, 1] - p[before, 1])
        shortest = min(shortest, lengths[i])
    cut = lengths <= shortest * (1.0 + EQUAL)
    for i in range(n):
        if cut[i] and cut[(i + 1) % n]:
            return 0, _around_centroid(p, n, facet, count, tiles)
    for i in range(n):
        if cut[i]:
            count = _add(p[i], p[(i + 1) % n], p[(i + n - 1) % n], 3, facet, count, tiles)
    left = 0
    for i in range(n):
        if not cut[i]:
            p[left, 0], p[left, 1] = p[i, 0], p[i, 1]
            left += 1
    return left, count


@njit_exact
def _emit(p, n, facet, count, tiles):
    """Append the tiles of a polygon, which is lost, or only count them if there is no room."""
    n, regular = _tidied(p, n), len(facet.domain)
    while n > 4:
        n, count = _cut_corners(p, n, facet, count, tiles)
    if n == 4:
        x, y = p[0, 0] - p[1, 0] + p[2, 0] - p[3, 0], p[0, 1] - p[1, 1] + p[2, 1] - p[3, 1]
        if abs(x) + abs(y) <= PARALLEL:
            return _add(p[0], p[1], p[3], 4, facet, count, tiles)
        one = _length2(regular, p[2, 0] - p[0, 0], p[2, 1] - p[0, 1])
        other = _length2(regular, p[3, 0] - p[1, 0], p[3, 1] - p[1, 1])
        if abs(one - other) <= EQUAL * (one + other):
            return _around_centroid(p, n, facet, count, tiles)
        # corners 1 and 3, or 0 and 2
        i, j = (1, 3) if one < other else (0, 2)
        count = _add(p[i], p[i + 1], p[(i + 3) % 4], 3, facet, count, tiles)
        return _add(p[j], p[(j + 1) % 4], p[j - 1], 3, facet, count, tiles)
    if n == 3:
        count = _add(p[0], p[1], p[2], 3, facet, count, tiles)
    return count


@njit_inner_exact
def _within(polygon, n, domain, work):
    """Part of a polygon within the reference domain, into work[0]; return its number of vertices."""
    _copy(polygon, n, work[0])
    for e in range(len(domain)):
        n, _ = split(work[0], n, domain[e], domain[(e + 1) % len(domain)], work[1], work[2])
        _copy(work[1], n, work[0])
        if n < 3:
            return 0
    return n


@njit_exact
def _take(polygon, m, remains, n_pieces, facet, count, tiles, work):
    """Take a polygon out of the pieces that are left; return how many there are, and tiles. -1: no room."""
    regular, least, lengths = len(facet.domain), facet.least, np.empty(m)
    pieces, sizes = remains.vertices, remains.corners
    for e in range(m):
        x, y = polygon[(e + 1) % m, 0] - polygon[e, 0], polygon[(e + 1) % m, 1] - polygon[e, 1]
        lengths[e] = -_length2(regular, x, y)
    # what is left is cut along the longest edges first, whichever vertex the polygon begins with
    order = np.arange(m)
    for e in range(1, m):
        k = e
        while k > 0 and lengths[order[k - 1]] > lengths[e]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = e
    for r in range(n_pieces):
        n = sizes[r]
        _copy(pieces[r], n, work[0])
        room = n_pieces
        for e in order:
            n, rest = split(work[0], n, polygon[e], polygon[(e + 1) % m], work[1], work[2])
            _copy(work[1], n, work[0])
            if n < 3 or area(work[0], n) <= least:
                n = 0
                break
            if rest >= 3 and area(work[2], rest) > least:
                if room == PIECES:
                    return -1, count
                sizes[room] = rest
                _copy(work[2], rest, pieces[room])
                room += 1
        if n == 0:
            # nothing in common: the piece stays whole, and what was cut off on the way is forgotten
            continue
        count = _emit(work[0], n, facet, count, tiles)
        sizes[r] = 0
        if room > n_pieces:
            room -= 1
            sizes[r] = sizes[room]
            _copy(pieces[room], sizes[r], pieces[r])
        n_pieces = room
    return n_pieces, count


@njit_inner_exact
def _crosses(a, b, domain):
    """Return True if a segment from a to b has a part inside the domain."""
    start, end, x, y = 0.0, 1.0, b[0] - a[0], b[1] - a[1]
    length = np.sqrt(x * x + y * y)
    for e in range(len(domain)):
        o, t = domain[e], domain[(e + 1) % len(domain)]
        tx, ty = t[0] - o[0], t[1] - o[1]
        side = np.sqrt(tx * tx + ty * ty)
        height, climb = (tx * (a[1] - o[1]) - ty * (a[0] - o[0])) / side, (tx * y - ty * x) / side
        if abs(climb) < SAME:
            if height < SAME:
                return False
        elif climb > 0.0:
            start = max(start, -height / climb)
        else:
            end = min(end, -height / climb)
    return (end - start) * length > SAME


@njit_inner_exact
def _is_shared(polygons, j, e):
    """Return True if edge e of polygon j is also one of another polygon, run through the other way."""
    vertices, corners = polygons.vertices, polygons.corners
    a, b = vertices[j, e], vertices[j, (e + 1) % corners[j]]
    for i in range(len(corners)):
        for k in range(corners[i] if i != j else 0):
            c, d = vertices[i, (k + 1) % corners[i]], vertices[i, k]
            if abs(a[0] - c[0]) + abs(a[1] - c[1]) + abs(b[0] - d[0]) + abs(b[1] - d[1]) < SAME:
                return True
    return False


@njit_inner_exact
def _is_covered(polygons, p, n):
    """Return True if the mean of the vertices of a polygon is in one of some polygons."""
    vertices, corners = polygons.vertices, polygons.corners
    x, y = 0.0, 0.0
    for i in range(n):
        x, y = x + p[i, 0] / n, y + p[i, 1] / n
    for j in range(len(corners)):
        inside = True
        for e in range(corners[j]):
            a, b = vertices[j, e], vertices[j, (e + 1) % corners[j]]
            inside = inside and (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
        if inside:
            return True
    return False


@njit_exact
def _left_over(facet, polygons, remains, work):
    """Pieces of a facet outside of polygons that do not overlap; how many there are, and their area. -1: no room.

    The lines through all edges that are no other polygon's divide the facet into pieces that are covered or not.
    """
    vertices, corners, pieces, sizes = polygons.vertices, polygons.corners, remains.vertices, remains.corners
    domain, least, n_pieces, total = facet.domain, facet.least, 1, 0.0
    sizes[0] = len(domain)
    _copy(domain, len(domain), pieces[0])
    for j in range(len(corners)):
        for e in range(corners[j]):
            a, b = vertices[j, e], vertices[j, (e + 1) % corners[j]]
            if not _crosses(a, b, domain) or _is_shared(polygons, j, e):
                continue
            for r in range(n_pieces):
                n, rest = split(pieces[r], sizes[r], a, b, work[1], work[2])
                if n < 3 or rest < 3 or area(work[1], n) <= least or area(work[2], rest) <= least:
                    continue
                if n_pieces == PIECES:
                    return -1, 0.0
                _copy(work[1], n, pieces[r])
                _copy(work[2], rest, pieces[n_pieces])
                sizes[r], sizes[n_pieces] = n, rest
                n_pieces += 1
    for r in range(n_pieces):
        if _is_covered(polygons, pieces[r], sizes[r]):
            sizes[r] = 0
        else:
            total += area(pieces[r], sizes[r])
    return n_pieces, total


@njit_exact
def _take_all(facet, polygons, remains, count, tiles, work):
    """Tiles of polygons that overlap, each as far as those before have left it; pieces that remain, and tiles."""
    domain, corners, n_pieces, copy = facet.domain, polygons.corners, 1, np.empty((MOST, 2))
    remains.corners[0] = len(domain)
    _copy(domain, len(domain), remains.vertices[0])
    for j in range(len(corners)):
        _copy(polygons.vertices[j], corners[j], copy)
        n_pieces, count = _take(copy, corners[j], remains, n_pieces, facet, count, tiles, work)
        if n_pieces < 0:
            break
    return n_pieces, count


@njit_exact
def _emit_whole(facet, polygons, count, tiles, work):
    """Append the tiles of some polygons of a facet, each as far as it is within the domain; return area and tiles."""
    total = 0.0
    for j in range(len(polygons.corners)):
        n = _within(polygons.vertices[j], polygons.corners[j], facet.domain, work)
        own = area(work[0], n) if n >= 3 else 0.0
        if own > facet.least:
            total += own
            count = _emit(work[0], n, facet, count, tiles)
    return total, count


@njit_exact
def tile(domain, first, polygons, cut, tiles):
    """Tiles of facets, none of which crosses the edge of a polygon.

    Each polygon is cut off at the border of its facet, and what is left of the facet is tiled, too. Where several lie
    over each other, each takes what those before it have left.

    Parameters
    ----------
    domain : (n, 2) float64
        Vertices of the reference domain: the unit triangle or the square.
    first : (nf + 1,) int64
        The polygons of facet f are first[f] to first[f + 1], the nearest first.
    polygons : Polygons
        With eight vertices at most.
    cut : (nf,) bool
        Output: false where a facet has no polygons within it, or too many pieces; it has no tiles.
    tiles : Tiles
        Output, as far as there is room.

    Returns
    -------
    int
        Number of tiles.
    """
    work = np.empty((3, MOST, 2))
    remains = Polygons(np.empty((PIECES, MOST, 2)), np.empty(PIECES, dtype=np.int64))
    whole, count = area(domain, len(domain)), 0
    for f in range(len(first) - 1):
        start, low, high = count, first[f], first[f + 1]
        facet = TiledFacet(f, domain, SLIVER * whole)
        own = Polygons(polygons.vertices[low:high], polygons.corners[low:high])
        total, count = _emit_whole(facet, own, count, tiles, work)
        cut[f] = total > WHOLE * whole
        if not cut[f] or abs(total - whole) <= WHOLE * whole:
            count = count if cut[f] else start
            continue
        n_pieces, rest = _left_over(facet, own, remains, work)
        if n_pieces < 0 or abs(total + rest - whole) > WHOLE * whole:
            n_pieces, count = _take_all(facet, own, remains, start, tiles, work)
        cut[f] = n_pieces >= 0
        if not cut[f]:
            count = start
        for r in range(n_pieces):
            if remains.corners[r] >= 3:
                count = _emit(remains.vertices[r], remains.corners[r], facet, count, tiles)
    return count


# how far along its normal a facet looks for those it is cut by, over its extent
REACH = 2.0
# margin of the boxes for curved facets, over their extent, and of what is seen of target facets, over the width
MARGIN = 0.05
# cosine of the angle of a target facet that is not yet seen edge-on
EDGE_ON = 0.02
# difference of distances and areas that rounding may make, over the extent and in the reference domain
ALIKE = 1e-8
# twice the area by which a polygon may be concave: rounding [square of the extent, reference area]
BENT = 1e-12
# Newton iterations, of which curved facets need a few
ITERATIONS = 12
# corners of the kinds of `pcontact.contact.surface.facet_maps`
KIND_CORNERS = np.array([2, 2, 3, 3, 4, 4, 4])


class _Frames:
    """Source facets of one part: nodes (n, m, 3), centre, unit normal and two tangents (n, 3), extent (n,).

    The extent is the largest distance between two nodes; ``body`` (n,) are the connected bodies.
    """

    def __init__(self, space, facets):
        mesh, block = space.mesh, space.mesh.blocks[facets.block]
        table, self.degree = mesh.geometry_nodes(block)
        self.kind, self.body = facets.kind, block.components[facets.cells]
        nodes = table[facets.cells[:, None], facet_nodes(facets.cell, self.degree)[facets.local]]
        self.nodes = mesh.points[nodes]
        centre = _corners(self.kind).mean(axis=0, keepdims=True)
        self.centre = np.einsum("a,nai->ni", shape(self.kind, self.degree, centre)[0], self.nodes)
        slope = np.einsum("ak,nai->nik", shape_gradient(self.kind, self.degree, centre)[0], self.nodes)
        normal = np.cross(slope[:, :, 0], slope[:, :, 1])
        self.normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        first = slope[:, :, 0] / np.linalg.norm(slope[:, :, 0], axis=1)[:, None]
        self.tangents = np.stack([first, np.cross(self.normal, first)], axis=1)
        self.extent = np.linalg.norm(self.nodes[:, :, None] - self.nodes[:, None], axis=3).max(axis=(1, 2))

    def boxes(self):
        """Boxes around the facets and what they may face: two arrays (n, 3)."""
        way = REACH * self.extent[:, None] * self.normal
        ends = np.concatenate([self.nodes + way[:, None], self.nodes - way[:, None]], axis=1)
        margin = MARGIN * self.extent[:, None]
        return ends.min(axis=1) - margin, ends.max(axis=1) + margin

    def beside(self, rows, y):
        """Points y (n, m, 3) beside facets ``rows`` (n,), in these facets' planes: (n, m, 2), over their extents."""
        away = (y - self.centre[rows][:, None]) / self.extent[rows][:, None, None]
        return np.einsum("nki,nmi->nmk", self.tangents[rows], away)

    @cached_property
    def borders(self):
        """Lines (n, e, 2, 2) in the planes of the facets, two points each, which have the facets on their left."""
        every = self.beside(np.arange(len(self.nodes)), self.nodes)
        n = len(_corners(self.kind))
        start, way = every[:, :n], np.roll(every[:, :n], -1, axis=1) - every[:, :n]
        out = np.stack([way[:, :, 1], -way[:, :, 0]], axis=2) / np.linalg.norm(way, axis=2)[:, :, None]
        height = np.einsum("nek,neak->nea", out, every[:, None] - start[:, :, None])
        bulge, depth = height.max(axis=2), -height.min(axis=2)
        start = start + (bulge + MARGIN * depth)[:, :, None] * out
        return np.stack([start, start + way], axis=2)

    def inverse(self, rows, y):
        """Reference points (n, 2) of facets ``rows`` (n,) whose places are points y (n, 2) of their planes."""
        flat = self.beside(rows, self.nodes[rows])
        xi = np.tile(_corners(self.kind).mean(axis=0), (len(rows), 1))
        for _ in range(1 if self.kind == "triangle" and self.degree == 1 else ITERATIONS):
            miss = y - np.einsum("pa,pak->pk", shape(self.kind, self.degree, xi), flat)
            slope = np.einsum("pai,pak->pki", shape_gradient(self.kind, self.degree, xi), flat)
            det = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
            with np.errstate(all="ignore"):
                xi = xi + np.column_stack([
                    (slope[:, 1, 1] * miss[:, 0] - slope[:, 0, 1] * miss[:, 1]) / det,
                    (slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]) / det,
                ])  # fmt: skip
        return xi


def _corners(kind):
    """Vertices (n, 2) of the reference domain, counter-clockwise."""
    return TRIANGLE_CORNERS if kind == "triangle" else SQUARE_CORNERS


def _faced(space, target, low, high):
    """Target facets of all ranks whose boxes meet those of this rank's source facets. *Collective.*

    Returns
    -------
    row : ndarray (n,)
        Number of the box.
    number, count, body : ndarray (n,)
        Global number of the facet, how many corners it has, and its connected body.
    corners : ndarray (n, 4, 3)
        Padded.
    """
    boxes = facet_boxes(target.x, target.kinds)
    tree = build_tree(*boxes)
    half = 0.5 * np.linalg.norm(high - low, axis=1)
    ranks, away = route(space.comm, *boxes, 0.5 * (low + high), float(np.max(half, initial=0.0)))
    box, k = np.nonzero((away <= half).T)
    asked = Asked(space.exchanger, ranks[k], np.column_stack([low[box], high[box]]))
    query, facet = meeting(tree, asked.rows[:, :3], asked.rows[:, 3:])
    corners = target.x[facet][:, [0, 1, 2, 3 if target.x.shape[1] > 3 else 2]].reshape(-1, 12)
    numbers = target.ids[facet], KIND_CORNERS[target.kinds[facet]], target.components[facet]
    row, heard = asked.reply_some(query, np.column_stack([*numbers, corners]))
    return box[row], *heard[:, :3].astype(np.int64).T, heard[:, 3:].reshape(-1, 4, 3)


def _convex(polygons, corners):
    """Polygons (n, k, 2) with their numbers of corners as convex ones: rows, polygons and corners of these.

    Vertices beyond the corners repeat one of them.
    """
    k = polygons.shape[1]
    place = np.arange(k)
    rows = np.arange(len(polygons))[:, None]
    after, before = (place + 1) % corners[:, None], (place - 1) % corners[:, None]
    ahead, behind = polygons[rows, after] - polygons, polygons - polygons[rows, before]
    turn = behind[:, :, 0] * ahead[:, :, 1] - behind[:, :, 1] * ahead[:, :, 0]
    turn[place >= corners[:, None]] = np.inf
    bent = np.any(turn < -BENT, axis=1)
    rows = np.flatnonzero(~bent)
    found = [(rows, polygons[rows], corners[rows])]
    # all triangles begin at the corner that turns the other way
    start = np.argmin(turn, axis=1)
    for second in range(1, k - 1):
        rows = np.flatnonzero(bent & (corners >= second + 2))
        chosen = (start[rows, None] + np.minimum(place, 2) + (place > 0) * (second - 1)) % corners[rows, None]
        found.append((rows, polygons[rows[:, None], chosen], np.full(len(rows), 3)))
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))


def _ranking(frames, row, away, centre, polygons):
    """Keys (n,) by which polygons of a facet are ordered, the last one first: nearness, then size and place.

    Numbers that rounding errors may tell apart are equal.
    """
    scale = ALIKE * frames.extent[row]
    aside = np.linalg.norm(centre - frames.centre[row], axis=1)
    x, y = np.moveaxis(polygons.vertices - polygons.vertices[:, :1], 2, 0)
    size = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return np.rint(aside / scale), np.rint(-size / ALIKE), np.rint(away / scale)


def _polygons(target, frames, row, number, count, body, corners):
    """Polygons of source facets that target facets cover: first (nf + 1,), and their polygons."""
    centre = np.where((count == 3)[:, None], corners[:, :3].mean(axis=1), corners.mean(axis=1))
    ahead = np.einsum("ni,ni->n", centre - frames.centre[row], frames.normal[row])
    away = np.abs(ahead)
    diagonals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    diagonals[count == 3] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[count == 3]
    facing = np.einsum("ni,ni->n", diagonals, frames.normal[row])
    kept = (facing < -EDGE_ON * np.linalg.norm(diagonals, axis=1)) & (away <= REACH * frames.extent[row])
    kept &= target.may_meet(frames.body[row], body, ahead)
    row, number, count, corners, away = row[kept], number[kept], count[kept], corners[kept], away[kept]
    # seen from the source they run the other way round
    back = np.where((count == 3)[:, None], [2, 1, 0, 0], [3, 2, 1, 0])
    flat = frames.beside(row, np.take_along_axis(corners, back[:, :, None], axis=1))
    which, flat, count = _convex(flat, count)
    lines = frames.borders[row[which]]
    room = flat.shape[1] + lines.shape[1]
    clipped = Polygons(np.zeros((len(which), room, 2)), np.zeros(len(which), dtype=np.int64))
    clip(Polygons(flat, count), lines, clipped)
    left = np.flatnonzero(clipped.corners)
    count, which = clipped.corners[left], which[left]
    place = np.arange(room)
    polygon, corner = np.nonzero(place < count[:, None])
    xi = np.zeros((len(left), room, 2))
    xi[polygon, corner] = frames.inverse(row[which[polygon]], clipped.vertices[left[polygon], corner])
    rows, polygons, count = _convex(xi[np.arange(len(left))[:, None], place * (place < count[:, None])], count)
    which = which[rows]
    kept = np.all(np.isfinite(polygons), axis=(1, 2))
    which, polygons = which[kept], Polygons(np.ascontiguousarray(polygons[kept]), count[kept])
    keys = _ranking(frames, row[which], away[which], centre[which], polygons)
    order = np.lexsort((number[which], *keys, row[which]))
    first = np.searchsorted(row[which][order], np.arange(len(frames.centre) + 1))
    return first, Polygons(*(values[order] for values in polygons))


def tiles(space, parts, target):
    """Tiles of the source facets of this rank which face a target nearby. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Three-dimensional.
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    target : pcontact.contact.surface.sides.TargetSurface

    Returns
    -------
    part, row : ndarray (n,)
        Part, and row in it, of each tile's facet.
    kinds : ndarray (n,)
        3: a triangle, 4: a parallelogram.
    vertices : ndarray (n, 3, 2)
        In the facet's reference domain: a vertex and its two neighbours.
    """
    every = [_Frames(space, facets) for facets in parts]
    boxes = [frames.boxes() for frames in every] or [(np.zeros((0, 3)), np.zeros((0, 3)))]
    faced = _faced(space, target, *(np.concatenate(side) for side in zip(*boxes, strict=True)))
    none = np.zeros(0, dtype=np.int64)
    found, begin = [(none, none, none, np.zeros((0, 3, 2)))], 0
    for k, frames in enumerate(every):
        end = begin + len(frames.centre)
        own = (faced[0] >= begin) & (faced[0] < end)
        arguments = (
            _corners(frames.kind), *_polygons(target, frames, faced[0][own] - begin, *(a[own] for a in faced[1:])),
            np.zeros(len(frames.centre), dtype=bool),
        )  # fmt: skip
        begin, room = end, tile(*arguments, Tiles(none, none, np.zeros((0, 3, 2))))
        cut = Tiles(np.zeros(room, np.int64), np.zeros(room, np.int64), np.zeros((room, 3, 2)))
        tile(*arguments, cut)
        found.append((np.full(room, k), *cut))
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))
