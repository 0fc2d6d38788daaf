"""One point against one facet: the closest point.

Both come as a :class:`LocalFacet`; kernels that take some of its arrays alone call them by the same names.

The closest point of a facet is either interior, hence a stationary point of the distance, or lies on an edge.
Edges are solved exactly (straight: closed form; quadratic: all roots of a cubic). Interiors are solved in
closed form where the map is affine; otherwise, unless control points exclude them, by Newton's method from every
local minimum of the distance on a 5 x 5 grid and from the closest point of the edges; where Newton wants to leave
the facet the edges hold the answer.

One line against one facet: the intersection.

Both are relative to the facet's node 0, see `closest_point.LocalFacet`. Affine facets and plane curves are solved in
closed form, other facets by Newton's method from every local minimum, on a 5 x 5 grid, of the distance to the line.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.facet_maps import (
    ALONG_U,
    ALONG_V,
    DIFFERENCES,
    NODE_COUNTS,
    PARALLELOGRAM,
    QUADRILATERAL9,
    SEGMENT2,
    SEGMENT3,
    SQUARE_CORNERS,
    TRIANGLE3,
    TRIANGLE6,
    TRIANGLE_CORNERS,
    clamp,
    fill_jet,
    is_segment,
    is_triangle,
    jet_normal,
    to_bezier,
)
from pcontact.runtime.jit import njit_inner_exact

GRID = 5
# squares of distances that are the same but for rounding, over them
ALIKE = 2e-15
# reference coordinates by which a point is inside
INSIDE = 1e-14


class LocalFacet(NamedTuple):
    """A facet and a point in coordinates relative to its node 0, and room to evaluate its map.

    Attributes
    ----------
    nodes : (9, 3) float64
        Nodes of the facet, see `facet_maps.load_nodes` [length].
    p : (3,) float64
        The point [length].
    shapes, jet : (6, 9), (6, 3) float64
        Scratch for `facet_maps.fill_jet`: shape functions, the map, and their derivatives.
    grid : (GRID, GRID) float64
        Scratch for values at the starts of Newton's method.
    """

    nodes: np.ndarray
    p: np.ndarray
    shapes: np.ndarray
    jet: np.ndarray
    grid: np.ndarray


@njit_inner_exact
def closest_on_facet(kind, local):
    """Reference coordinates (u, v) of the point of a facet that is closest to its `p`."""
    nodes, p = local.nodes, local.p
    if kind == SEGMENT2:
        return _closest_on_line(nodes, 0, 1, p)[0], 0.0
    if kind == SEGMENT3:
        return _closest_on_parabola(nodes, 0, 1, 2, p)[0], 0.0
    if kind == TRIANGLE3 or kind == PARALLELOGRAM:
        u, v, inside = _closest_on_plane(kind, nodes, p)
        if inside:
            return u, v
        u, v, _ = _closest_on_edges(kind, nodes, p)
        return u, v
    return _closest_on_curved(kind, local)


@njit_inner_exact
def _closest_on_line(nodes, a, b, p):
    """Parameter in [-1, 1] and squared distance of the closest point of a straight edge."""
    e0, e1, e2 = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
    w0, w1, w2 = p[0] - nodes[a, 0], p[1] - nodes[a, 1], p[2] - nodes[a, 2]
    length2 = e0 * e0 + e1 * e1 + e2 * e2
    t = (w0 * e0 + w1 * e1 + w2 * e2) / length2 if length2 > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    w0, w1, w2 = w0 - t * e0, w1 - t * e1, w2 - t * e2
    return 2.0 * t - 1.0, w0 * w0 + w1 * w1 + w2 * w2


@njit_inner_exact
def _closest_on_parabola(nodes, a, b, m, p):
    """The same for a quadratic edge with middle node m: global minimum, from all roots of the cubic f'(s).

    An end counts only where the distance falls towards it: that of a root beside it is the same to rounding as soon as
    they are 1e-8 of the distance apart.
    """
    k0, k1, k2, k3 = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        c, l = nodes[m, k] - p[k], 0.5 * (nodes[b, k] - nodes[a, k])  # noqa: E741
        q = 0.5 * (nodes[a, k] + nodes[b, k]) - nodes[m, k]
        k0, k1, k2, k3 = k0 + c * l, k1 + l * l + 2.0 * c * q, k2 + 3.0 * l * q, k3 + 2.0 * q * q
    # between the stationary points of the cubic it is monotone: at most one root in each of three intervals
    r0, r1 = 1.0, 1.0
    root = k2 * k2 - 3.0 * k1 * k3
    if root > 0.0:
        t = -(k2 + (np.sqrt(root) if k2 >= 0.0 else -np.sqrt(root)))
        r0 = t / (3.0 * k3) if k3 > 0.0 else 1.0
        r1 = k1 / t if t != 0.0 else 1.0
        r0, r1 = min(max(min(r0, r1), -1.0), 1.0), min(max(max(r0, r1), -1.0), 1.0)
    best, best2, left, f_left = -1.0, np.inf, -1.0, _cubic(k0, k1, k2, k3, -1.0)
    if f_left >= 0.0:
        best2 = _parabola_distance2(nodes, a, b, m, p, -1.0)
    for i in range(4):
        right = r0 if i == 0 else (r1 if i == 1 else 1.0)
        f_right = _cubic(k0, k1, k2, k3, right)
        if i == 3:
            s = 1.0
        elif f_left <= 0.0 and f_right >= 0.0:
            s = _cubic_root(k0, k1, k2, k3, left, right)
        else:
            s = np.nan
        if i < 3 or f_right <= 0.0:
            d2 = _parabola_distance2(nodes, a, b, m, p, s)
            if d2 < best2:
                best, best2 = s, d2
        left, f_left = right, f_right
    return best, best2


@njit_inner_exact
def _cubic(k0, k1, k2, k3, s):
    return k0 + s * (k1 + s * (k2 + s * k3))


@njit_inner_exact
def _parabola_distance2(nodes, a, b, m, p, s):
    total = 0.0
    for k in range(3):
        c, l = nodes[m, k] - p[k], 0.5 * (nodes[b, k] - nodes[a, k])  # noqa: E741
        q = 0.5 * (nodes[a, k] + nodes[b, k]) - nodes[m, k]
        r = c + s * (l + s * q)
        total += r * r
    return total


@njit_inner_exact
def _cubic_root(k0, k1, k2, k3, left, right):
    """Root of a cubic that is monotone on [left, right], by Newton with bisection; else the right end."""
    f_left, f_right = _cubic(k0, k1, k2, k3, left), _cubic(k0, k1, k2, k3, right)
    if f_left == 0.0:
        return left
    if f_right == 0.0 or (f_left > 0.0) == (f_right > 0.0) or not left < right:
        return right
    s = 0.5 * (left + right)
    for _ in range(100):
        f = _cubic(k0, k1, k2, k3, s)
        if f == 0.0:
            return s
        if (f > 0.0) == (f_left > 0.0):
            left = s
        else:
            right = s
        slope = k1 + s * (2.0 * k2 + s * 3.0 * k3)
        new = s - f / slope if slope != 0.0 else left
        if not left < new < right:
            new = 0.5 * (left + right)
        if abs(new - s) <= 1e-16 or not left < new < right:
            return new
        s = new
    return s


@njit_inner_exact
def _edge_point(kind, edge, s):
    """Reference point at parameter s in [-1, 1] of an edge; the ends are exactly the corners."""
    a, b = 0.5 * (1.0 - s), 0.5 * (1.0 + s)
    if is_triangle(kind):
        i, j = edge, (edge + 1) % 3
        return (
            a * TRIANGLE_CORNERS[i, 0] + b * TRIANGLE_CORNERS[j, 0],
            a * TRIANGLE_CORNERS[i, 1] + b * TRIANGLE_CORNERS[j, 1],
        )
    i, j = edge, (edge + 1) % 4
    return (
        a * SQUARE_CORNERS[i, 0] + b * SQUARE_CORNERS[j, 0],
        a * SQUARE_CORNERS[i, 1] + b * SQUARE_CORNERS[j, 1],
    )


@njit_inner_exact
def _closest_on_edges(kind, nodes, p):
    """Reference coordinates and squared distance of the closest point of the facet's edges."""
    corners = 3 if is_triangle(kind) else 4
    best2, best, edge = np.inf, -1.0, 0
    for i in range(corners):
        j = (i + 1) % corners
        if kind == TRIANGLE6 or kind == QUADRILATERAL9:
            s, d2 = _closest_on_parabola(nodes, i, j, corners + i, p)
        else:
            s, d2 = _closest_on_line(nodes, i, j, p)
        # a corner is as near, to rounding, as the foot beside it on the next edge
        if d2 < best2 * (1.0 + ALIKE * ((abs(best) == 1.0) - (abs(s) == 1.0))):
            best2, best, edge = d2, s, i
    u, v = _edge_point(kind, edge, best)
    return u, v, best2


@njit_inner_exact
def _closest_on_plane(kind, nodes, p):
    """Foot of the perpendicular on a facet with an affine map, and whether it is inside."""
    c = 2 if kind == TRIANGLE3 else 3
    a0, a1, a2, b0, b1, b2 = nodes[1, 0], nodes[1, 1], nodes[1, 2], nodes[c, 0], nodes[c, 1], nodes[c, 2]
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    area2 = n0 * n0 + n1 * n1 + n2 * n2
    if not area2 > 0.0:
        return 0.0, 0.0, False
    # cross products, not the normal equations: they keep their digits on slivers
    u = ((p[1] * b2 - p[2] * b1) * n0 + (p[2] * b0 - p[0] * b2) * n1 + (p[0] * b1 - p[1] * b0) * n2) / area2
    v = ((a1 * p[2] - a2 * p[1]) * n0 + (a2 * p[0] - a0 * p[2]) * n1 + (a0 * p[1] - a1 * p[0]) * n2) / area2
    if kind == TRIANGLE3:
        return u, v, u >= 0.0 and v >= 0.0 and u + v <= 1.0
    return 2.0 * u - 1.0, 2.0 * v - 1.0, 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0


@njit_inner_exact
def grid_point(kind, i, j):
    """Node (i, j) of the grid of starts; for triangles only those with i + j < GRID."""
    a, b = i / (GRID - 1.0), j / (GRID - 1.0)
    if is_triangle(kind):
        return a, b
    return 2.0 * a - 1.0, 2.0 * b - 1.0


@njit_inner_exact
def _is_inner(kind, i, j):
    last = GRID - 2 - i if is_triangle(kind) else GRID - 2
    return 1 <= i <= GRID - 2 and 1 <= j <= last


@njit_inner_exact
def is_grid_minimum(kind, grid, i, j):
    """Return True if a grid value is not above those beside it: a start for Newton's method.

    Diagonal neighbours do not count (they may lie in another valley), nor do those at the border for an inner
    value: a valley inside must not be missed because the border is as low.
    """
    value, inner = grid[i, j], _is_inner(kind, i, j)
    for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
        if 0 <= a < GRID and 0 <= b < GRID and grid[a, b] < value and (not inner or _is_inner(kind, a, b)):
            return False
    return value < np.inf


@njit_inner_exact
def _distance2(jet, p):
    r0, r1, r2 = jet[0, 0] - p[0], jet[0, 1] - p[1], jet[0, 2] - p[2]
    return r0 * r0 + r1 * r1 + r2 * r2


@njit_inner_exact
def _may_be_inside(kind, nodes, p, scratch):
    """Return True if the distance can be stationary inside a facet; `scratch` is (6, 9).

    The derivatives (y - p) . dy/du and (y - p) . dy/dv are, in Bezier form, positive combinations of products of
    control points and their differences: where all products have one sign there is no zero.
    """
    for k in range(3):
        for i in range(NODE_COUNTS[kind]):
            scratch[k, i] = nodes[i, k] - p[k]
        to_bezier(kind, scratch[k])
    for table in (ALONG_U, ALONG_V):
        low, high = np.inf, -np.inf
        for j in range(DIFFERENCES[kind]):
            a, b = table[kind, j, 0], table[kind, j, 1]
            t0, t1, t2 = scratch[0, b] - scratch[0, a], scratch[1, b] - scratch[1, a], scratch[2, b] - scratch[2, a]
            for i in range(NODE_COUNTS[kind]):
                product = scratch[0, i] * t0 + scratch[1, i] * t1 + scratch[2, i] * t2
                low, high = min(low, product), max(high, product)
        if low > 0.0 or high < 0.0:
            return False
    return True


@njit_inner_exact
def _closest_on_curved(kind, local):
    """Global minimum of the distance over a curved or bilinear facet."""
    nodes, p, shapes, jet, grid = local
    best_u, best_v, best2 = _closest_on_edges(kind, nodes, p)
    if not _may_be_inside(kind, nodes, p, shapes):
        return best_u, best_v
    for i in range(GRID):
        for j in range(GRID):
            grid[i, j] = np.inf
            if not is_triangle(kind) or i + j < GRID:
                u, v = grid_point(kind, i, j)
                fill_jet(kind, u, v, nodes, 1, shapes, jet)
                grid[i, j] = _distance2(jet, p)
    edge_u, edge_v = best_u, best_v
    for start in range(GRID * GRID + 1):
        i, j = start // GRID, start % GRID
        if start == GRID * GRID:
            u, v = edge_u, edge_v
        elif is_grid_minimum(kind, grid, i, j):
            u, v = grid_point(kind, i, j)
        else:
            continue
        u, v = _descend(kind, local, u, v)
        fill_jet(kind, u, v, nodes, 1, shapes, jet)
        d2 = _distance2(jet, p)
        # from the edges' point the way goes inside only downhill, though distances may not show it
        if d2 < best2 or (start == GRID * GRID and d2 < best2 * (1.0 + ALIKE) and _is_inside(kind, u, v)):
            best_u, best_v, best2 = u, v, d2
    return best_u, best_v


@njit_inner_exact
def _is_inside(kind, u, v):
    """Return True if a reference point is off the border."""
    if is_triangle(kind):
        return min(u, v, 1.0 - u - v) > INSIDE
    return max(abs(u), abs(v)) < 1.0 - INSIDE


@njit_inner_exact
def _room(kind, u, v, du, dv):
    """The largest multiple (at most 1) of the step (du, dv) that stays in the reference domain."""
    t = 1.0
    if is_triangle(kind):
        if du < 0.0:
            t = min(t, -u / du)
        if dv < 0.0:
            t = min(t, -v / dv)
        if du + dv > 0.0:
            t = min(t, (1.0 - u - v) / (du + dv))
    else:
        if du != 0.0:
            t = min(t, ((1.0 if du > 0.0 else -1.0) - u) / du)
        if dv != 0.0:
            t = min(t, ((1.0 if dv > 0.0 else -1.0) - v) / dv)
    return max(t, 0.0)


@njit_inner_exact
def _newton_step(jet, r0, r1, r2):
    """Descent direction for |y - p|^2 / 2: Newton's where the Hessian is positive, else Gauss-Newton's.

    Returns du, dv, the slope along it, and whether it is Newton's.
    """
    g1 = r0 * jet[1, 0] + r1 * jet[1, 1] + r2 * jet[1, 2]
    g2 = r0 * jet[2, 0] + r1 * jet[2, 1] + r2 * jet[2, 2]
    a11 = jet[1, 0] ** 2 + jet[1, 1] ** 2 + jet[1, 2] ** 2
    a12 = jet[1, 0] * jet[2, 0] + jet[1, 1] * jet[2, 1] + jet[1, 2] * jet[2, 2]
    a22 = jet[2, 0] ** 2 + jet[2, 1] ** 2 + jet[2, 2] ** 2
    h11 = a11 + r0 * jet[3, 0] + r1 * jet[3, 1] + r2 * jet[3, 2]
    h12 = a12 + r0 * jet[4, 0] + r1 * jet[4, 1] + r2 * jet[4, 2]
    h22 = a22 + r0 * jet[5, 0] + r1 * jet[5, 1] + r2 * jet[5, 2]
    det = h11 * h22 - h12 * h12
    newton = h11 > 0.0 and h22 > 0.0 and det > 1e-10 * h11 * h22
    if not newton:
        # a little of the diagonal keeps a singular map (collapsed facet) solvable
        h11, h12, h22 = a11 + 1e-6 * (a11 + a22), a12, a22 + 1e-6 * (a11 + a22)
        det = h11 * h22 - h12 * h12
        if not det > 0.0:
            return 0.0, 0.0, 0.0, False
    du, dv = (h12 * g2 - h22 * g1) / det, (h12 * g1 - h11 * g2) / det
    return du, dv, g1 * du + g2 * dv, newton


@njit_inner_exact
def _steepest(jet, r0, r1, r2):
    """Step against the gradient of |y - p|^2 / 2; its projection onto the reference domain descends too."""
    scale = 0.0
    for k in range(3):
        scale += jet[1, k] ** 2 + jet[2, k] ** 2
    g1 = r0 * jet[1, 0] + r1 * jet[1, 1] + r2 * jet[1, 2]
    g2 = r0 * jet[2, 0] + r1 * jet[2, 1] + r2 * jet[2, 2]
    return -g1 / scale, -g2 / scale


@njit_inner_exact
def _descend(kind, local, u, v):
    """Minimise the distance from (u, v) by Newton's method with backtracking inside the reference domain."""
    nodes, p, shapes, jet, _ = local
    for _ in range(100):
        fill_jet(kind, u, v, nodes, 6, shapes, jet)
        y0, y1, y2 = jet[0, 0], jet[0, 1], jet[0, 2]
        r0, r1, r2 = y0 - p[0], y1 - p[1], y2 - p[2]
        du, dv, slope, newton = _newton_step(jet, r0, r1, r2)
        step = max(abs(du), abs(dv))
        t = _room(kind, u, v, du, dv)
        if not slope < 0.0:
            return u, v
        held = t < 1e-3
        if held:
            du, dv = _steepest(jet, r0, r1, r2)
            t = 1.0
        if newton and not held and t == 1.0 and step < 1e-6:
            # quadratic convergence: differences of the distance no longer show it
            u, v = u + du, v + dv
            if step < 1e-14:
                return u, v
            continue
        g1 = r0 * jet[1, 0] + r1 * jet[1, 1] + r2 * jet[1, 2]
        g2 = r0 * jet[2, 0] + r1 * jet[2, 1] + r2 * jet[2, 2]
        t = t if t == 1.0 else 0.9 * t
        for _ in range(40):
            a, b = clamp(kind, u + t * du, v + t * dv)
            fill_jet(kind, a, b, nodes, 1, shapes, jet)
            c0, c1, c2 = jet[0, 0] - y0, jet[0, 1] - y1, jet[0, 2] - y2
            # half the change of the squared distance, without its cancellation
            change = c0 * (r0 + 0.5 * c0) + c1 * (r1 + 0.5 * c1) + c2 * (r2 + 0.5 * c2)
            if change <= 1e-4 * (g1 * (a - u) + g2 * (b - v)):
                break
            t *= 0.5
        step = max(abs(a - u), abs(b - v))
        if step < 1e-15:
            return u, v
        u, v = a, b
        if held and step < 1e-3:
            return u, v  # no way along the boundary: the edges are solved apart
    return u, v


# reference coordinates: how far outside a ray may still hit, so that none slips between facets
EDGE_TOLERANCE = 1e-9


@njit_inner_exact
def ray_on_facet(kind, local, n, facing, slack):
    """The intersection p + g n of a line with a facet that faces it, with the smallest abs(g).

    Parameters
    ----------
    kind : int
        Of the facet, see `facet_maps`.
    local : LocalFacet
    n : (3,) float64
        Unit direction.
    facing : float
        A facet faces the line where (outward normal) . n <= -facing.
    slack : float
        Distance from the line that is taken for zero in Newton's method [length].

    Returns
    -------
    g, u, v : float
        g = inf: no intersection.
    over : float
        How far beyond the border of the facet the line passes, in reference coordinates.
    """
    nodes, p, grid = local.nodes, local.p, local.grid
    best, best_u, best_v, best_over = np.inf, 0.0, 0.0, 0.0
    if is_segment(kind):
        s0, s1 = _line_parameters(kind, nodes, p, n)
        for s in (s0, s1):
            g, u, v, over = _accept(kind, local, n, s, 0.0, facing)
            if abs(g) < abs(best):
                best, best_u, best_v, best_over = g, u, v, over
        return best, best_u, best_v, best_over
    if kind == TRIANGLE3 or kind == PARALLELOGRAM:
        u, v = _plane_parameters(kind, nodes, p, n)
        return _accept(kind, local, n, u, v, facing)
    _fill_line_grid(kind, local, n)
    for start in range(GRID * GRID):
        if not is_grid_minimum(kind, grid, start // GRID, start % GRID):
            continue
        u, v = grid_point(kind, start // GRID, start % GRID)
        u, v = _shoot(kind, local, n, u, v, slack)
        g, u, v, over = _accept(kind, local, n, u, v, facing)
        if abs(g) < abs(best):
            best, best_u, best_v, best_over = g, u, v, over
    return best, best_u, best_v, best_over


@njit_inner_exact
def _accept(kind, local, n, u, v, facing):
    """Check that the reference point is on the facet and that the facet faces the line there."""
    nodes, p, shapes, jet, _ = local
    c, d = clamp(kind, u, v)
    over = max(abs(c - u), abs(d - v))
    if not over <= EDGE_TOLERANCE:
        return np.inf, 0.0, 0.0, 0.0
    fill_jet(kind, c, d, nodes, 3, shapes, jet)
    n0, n1, n2 = jet_normal(kind, jet)
    cosine = n0 * n[0] + n1 * n[1] + n2 * n[2]
    if not cosine <= -facing or not cosine < 0.0:
        return np.inf, 0.0, 0.0, 0.0
    # along the facet's plane, so that an edge missed by a hair gives the gap of the unclamped point
    g = (n0 * (jet[0, 0] - p[0]) + n1 * (jet[0, 1] - p[1]) + n2 * (jet[0, 2] - p[2])) / cosine
    return g, c, d, over


@njit_inner_exact
def _line_parameters(kind, nodes, p, n):
    """Both parameters where a plane line meets a segment: roots of a quadratic, nan where there is none."""
    x0, x1 = nodes[0, 0] * n[1] - nodes[0, 1] * n[0], nodes[1, 0] * n[1] - nodes[1, 1] * n[0]
    xp = p[0] * n[1] - p[1] * n[0]
    c, b, a = 0.5 * (x0 + x1) - xp, 0.5 * (x1 - x0), 0.0
    if kind == SEGMENT3:
        x2 = nodes[2, 0] * n[1] - nodes[2, 1] * n[0]
        c, a = x2 - xp, 0.5 * (x0 + x1) - x2
    root = b * b - 4.0 * a * c
    if root < 0.0:
        return np.nan, np.nan
    q = -0.5 * (b + (np.sqrt(root) if b >= 0.0 else -np.sqrt(root)))
    return (c / q if q != 0.0 else (0.0 if c == 0.0 else np.nan)), (q / a if a != 0.0 else np.nan)


@njit_inner_exact
def _plane_parameters(kind, nodes, p, n):
    """Reference coordinates where a line meets the plane of an affine facet; nan if parallel."""
    c = 2 if kind == TRIANGLE3 else 3
    a0, a1, a2, b0, b1, b2 = nodes[1, 0], nodes[1, 1], nodes[1, 2], nodes[c, 0], nodes[c, 1], nodes[c, 2]
    # Cramer's rule for u a + v b - g n = p; determinant - n . (a x b)
    det = n[0] * (a1 * b2 - a2 * b1) + n[1] * (a2 * b0 - a0 * b2) + n[2] * (a0 * b1 - a1 * b0)
    if det == 0.0:
        return np.nan, np.nan
    u = n[0] * (p[1] * b2 - p[2] * b1) + n[1] * (p[2] * b0 - p[0] * b2) + n[2] * (p[0] * b1 - p[1] * b0)
    v = n[0] * (a1 * p[2] - a2 * p[1]) + n[1] * (a2 * p[0] - a0 * p[2]) + n[2] * (a0 * p[1] - a1 * p[0])
    u, v = u / det, v / det
    if kind == TRIANGLE3:
        return u, v
    return 2.0 * u - 1.0, 2.0 * v - 1.0


@njit_inner_exact
def _off_line(jet, p, n):
    """The part of y - p that is perpendicular to the line."""
    r0, r1, r2 = jet[0, 0] - p[0], jet[0, 1] - p[1], jet[0, 2] - p[2]
    g = r0 * n[0] + r1 * n[1] + r2 * n[2]
    return r0 - g * n[0], r1 - g * n[1], r2 - g * n[2]


@njit_inner_exact
def _fill_line_grid(kind, local, n):
    """Squared distance between the line and the facet at the starts of Newton's method."""
    nodes, p, shapes, jet, grid = local
    for i in range(GRID):
        for j in range(GRID):
            grid[i, j] = np.inf
            if not is_triangle(kind) or i + j < GRID:
                u, v = grid_point(kind, i, j)
                fill_jet(kind, u, v, nodes, 1, shapes, jet)
                q0, q1, q2 = _off_line(jet, p, n)
                grid[i, j] = q0 * q0 + q1 * q1 + q2 * q2


@njit_inner_exact
def _shoot(kind, local, n, u, v, slack):
    """Newton's method with backtracking for the point of the facet that lies on the line; nan if it fails."""
    nodes, p, shapes, jet, _ = local
    for _ in range(50):
        fill_jet(kind, u, v, nodes, 3, shapes, jet)
        q0, q1, q2 = _off_line(jet, p, n)
        before = q0 * q0 + q1 * q1 + q2 * q2
        c0 = jet[1, 1] * jet[2, 2] - jet[1, 2] * jet[2, 1]
        c1 = jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2]
        c2 = jet[1, 0] * jet[2, 1] - jet[1, 1] * jet[2, 0]
        det = c0 * n[0] + c1 * n[1] + c2 * n[2]
        if det == 0.0:
            return np.nan, np.nan
        # J (du, dv) = -q in the plane perpendicular to n
        du = -(n[0] * (q1 * jet[2, 2] - q2 * jet[2, 1]) + n[1] * (q2 * jet[2, 0] - q0 * jet[2, 2])
               + n[2] * (q0 * jet[2, 1] - q1 * jet[2, 0])) / det  # fmt: skip
        dv = -(n[0] * (jet[1, 1] * q2 - jet[1, 2] * q1) + n[1] * (jet[1, 2] * q0 - jet[1, 0] * q2)
               + n[2] * (jet[1, 0] * q1 - jet[1, 1] * q0)) / det  # fmt: skip
        t = min(1.0, 1.0 / max(abs(du), abs(dv), 1.0))
        if max(abs(du), abs(dv)) < 1e-14:
            return u + du, v + dv
        for _ in range(20):
            fill_jet(kind, u + t * du, v + t * dv, nodes, 1, shapes, jet)
            q0, q1, q2 = _off_line(jet, p, n)
            if q0 * q0 + q1 * q1 + q2 * q2 < before:
                break
            t *= 0.5
        else:
            return (u, v) if before <= slack * slack else (np.nan, np.nan)
        u, v = u + t * du, v + t * dv
    return (u, v) if before <= slack * slack else (np.nan, np.nan)
