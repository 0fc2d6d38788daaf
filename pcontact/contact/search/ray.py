"""One line against one facet: the intersection.

Both are relative to the facet's node 0, see `closest_point.LocalFacet`. Affine facets and plane curves are solved in
closed form, other facets by Newton's method from every local minimum, on a 5 x 5 grid, of the distance to the line.
"""

import numpy as np

from pcontact.contact.search.closest_point import GRID, grid_point, is_grid_minimum
from pcontact.contact.surface.facet_maps import (
    PARALLELOGRAM,
    SEGMENT3,
    TRIANGLE3,
    clamp,
    fill_jet,
    is_segment,
    is_triangle,
    jet_normal,
)
from pcontact.runtime.jit import njit_inner_exact

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
