"""Points whose partner is held at an edge or a corner of its facet: the normal is along the line to it.

Formulas and parameters that are not told: see `pcontact.contact.formulation.finite_geometry`.
"""

import numpy as np

from pcontact.contact.formulation.finite_places import dot, target_at
from pcontact.contact.surface.facet_maps import NODE_COUNTS, fill_shapes, is_triangle
from pcontact.runtime.jit import njit_inner

# [reference coordinates] How near to an edge a partner is on it. From: chosen, rounding errors of shape functions.
ON = 1e-9
# [-] Cosine of the angle by which the line to the partner may turn from the normal that was found. From: chosen, 60
# degrees; a corner between facets that meet in a smooth surface has a fraction of it.
AWAY = 0.5
# of Newton's method along an edge: iterations, largest step and last one in reference coordinates
ITERATIONS, FARTHEST, SMALLEST = 40, 1.0, 1e-13


@njit_inner
def _edge_of(kind, u, v, d, edge):
    """The direction in reference coordinates of the edge that a reference point is on; zero at a corner."""
    edge[0], edge[1] = 0.0, 0.0
    if d == 2:
        return
    if is_triangle(kind):
        left, low, across = abs(u) <= ON, abs(v) <= ON, abs(1.0 - u - v) <= ON
        if left + low + across == 1:
            edge[0], edge[1] = (0.0 if left else 1.0), (0.0 if low else (1.0 if left else -1.0))
        return
    side, low = abs(abs(u) - 1.0) <= ON, abs(abs(v) - 1.0) <= ON
    if side != low:
        edge[0], edge[1] = (0.0 if side else 1.0), (1.0 if side else 0.0)


@njit_inner
def _along(edge, first, second):
    """Component of a sum of tangents along the edge."""
    return edge[0] * first + edge[1] * second


@njit_inner
def _steepness(w):
    """y,e . r and y,e . y,e + r . y,ee with r = y - x in w.r."""
    e, slope, bend = w.edge, 0.0, 0.0
    for k in range(len(w.n)):
        tangent = _along(e, w.a[0, k], w.a[1, k])
        turn = e[0] * e[0] * w.bend[0, k] + 2.0 * e[0] * e[1] * w.bend[1, k] + e[1] * e[1] * w.bend[2, k]
        slope += tangent * w.r[k]
        bend += tangent * tangent + w.r[k] * turn
    return slope, bend


@njit_inner
def hold(kind, nodes, motion, found, w):
    """Partner on the edge or corner that w.xi is on, normal and gap; ``found`` is the normal that was found."""
    d = len(w.n)
    _edge_of(kind, w.xi[0], w.xi[1], d, w.edge)
    for _ in range(ITERATIONS):
        fill_shapes(kind, w.xi[0], w.xi[1], w.shapes)
        target_at(nodes, NODE_COUNTS[kind], motion.x, motion.u, w.shapes, w.y, w.a, w.bend)
        for k in range(d):
            w.r[k] = w.y[k] - w.x[k]
        slope, bend = _steepness(w)
        if not bend > 0.0:
            break
        step = -slope / bend
        if abs(step) <= SMALLEST:
            break
        step *= min(1.0, FARTHEST / abs(step))
        w.xi[0] += step * w.edge[0]
        w.xi[1] += step * w.edge[1]
    length, along = np.sqrt(dot(w.r, w.r)), dot(w.r, found)
    turns = abs(along) > AWAY * length
    w.edge[2], w.gap[0] = (1.0 if turns else 0.0), along
    for k in range(d):
        w.n[k] = found[k]
    if turns:
        w.gap[0] = length if along > 0.0 else -length
        for k in range(d):
            w.n[k] = w.r[k] / w.gap[0]


@njit_inner
def held_column(gap, value, m, j, w, k):
    """Derivatives in column k, of displacement j of target node m (a source node where m < 0), along which [[du]] is
    ``value``. w has what :func:`hold` left, and the committed tangents."""
    d, e, moved = len(w.n), w.edge, 0.0
    if e[0] != 0.0 or e[1] != 0.0:
        for i in range(d):
            w.r[i] = w.y[i] - w.x[i]
        _, bend = _steepness(w)
        if bend > 0.0:
            moved = value * _along(e, w.a[0, j], w.a[1, j])
            if m >= 0:
                moved -= w.r[j] * _along(e, w.shapes[1, m], w.shapes[2, m])
            moved /= bend
    w.dxi[0, k], w.dxi[1, k] = moved * e[0], moved * e[1]
    for i in range(d):
        w.ds[i, k] = moved * (_along(e, w.old_a[0, i], w.old_a[1, i]) - _along(e, w.a[0, i], w.a[1, i]))
        w.r[i] = moved * _along(e, w.a[0, i], w.a[1, i])
    w.ds[j, k] += value
    w.r[j] -= value
    w.dg[k] = dot(w.n, w.r)
    if e[2] > 0.0:
        for i in range(d):
            w.dn[i, k] = (w.r[i] - w.n[i] * w.dg[k]) / gap
