"""Contact at finite motion: partner, gap, normal and slip of one point at a displacement, and their derivatives.

x is the present place of a source point, y(xi) a point of its target facet, which is frozen while the point on it
moves; a_i = y,i are the target's tangents and c_b = x,b those of the source, with the dual bases a^i and c^b. The
contact normal n points from source to target, the gap is g = (y - x) . n (>= 0 open), [[du]] = du_S(X) - du_T(xi).

* ray: y = x + g n with the outward normal n of the source;  dn = - sum_b c^b (n . du_S,b),
  [a_i, -n] (dxi, dg) = [[du]] + g dn
* closest: (x - y) . a_i = 0, n is minus the outward normal of the target;  dg = -n . [[du]],
  (a_i . a_j + g n . y,ij) dxi_j = a_i . [[du]] - g n . du_T,i,  dn = - sum_i a^i (n . da_i)
* both: da_i = du_T,i + y,ij dxi_j

Slip is convected: with the committed state k at the same point of the target, and A+ the matrix with the rows a^i,

    z = y_k(xi) - x_k - g n_k    (closest: without g n_k),    zeta = A_k+ z + B+ lag,    s = A zeta

goes from where the point was over the target to the present partner's place of then, in components on the old
tangents, which the new ones carry. The lag is a vector across n_k, in components on B = (I - n_k n_k) A_k (closest: it
is across the target, and added to z): at rest it stays what it is. Turning either state alone changes nothing. With
dA_k,i = y_k,ij dxi_j and zeta_z = A_k+ z

    ds = dA zeta + A dzeta,    dzeta = A_k+ (A_k dxi - n_k dg - dA_k zeta_z)
                                       + (A_k^T A_k)^-1 dA_k^T (z - A_k zeta_z) - B+ dA_k (B+ lag)

* held at a corner or an edge, whose unit of xi is e: r = y - x is along n and across e; it slides, a corner stays,
  dr = -[[du]] + y,e de,  de = (y,e . [[du]] - r . du_T,e) / (y,e . y,e + r . y,ee),  dg = n . dr,
  dn = (I - n n) dr / g,  s = x - y - (x_k - y_k) + lag. Where r has turned from the normal that was found by more than
  `AWAY`, the point has gone past the corner: n is that normal, and fixed
* fixed: n and xi are frozen, s = [[u]] - [[u_k]] + lag
* tied: xi is frozen, and w = y - x - A zeta_0 - g_0 n with the components of the offset that the undeformed bodies
  have;  g = w . n, s = -w
* obstacle: normal, gap and Hessian of the distance are given;  dg = -n . dx, dn = -Hess dx, s = x - x_c with the place
  x_c to which the obstacle has carried the point since then
* without partner: n is the outward normal of the source, g = 0, s = 0

Undeformed areas that face each other, of the target over the source, are as

    J = |A_1 x A_2| (c_1 x c_2 . n) / -(a_1 x a_2 . n),

with the undeformed tangents A_i = X,i of the target and source tangents c_b of unit area where undeformed (in the plane
tangents turned by -90 degrees in the place of products), times the ratio of undeformed radii with axial symmetry. The
ray on straight source facets, and the closest point on straight target facets, map areas so; the curvature of others
adds a part of the order of g over its radius, which is left out. The product with a unit of n to the facets is held at
`ASKEW` times that of facets across n.

A facet goes on beyond its edges up to `BEYOND` in reference coordinates, of triangles up to barycentric coordinates of
`-BESIDE`; farther a point has no partner. To g a number of the point is added (`shift`) that does not change.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.facet_maps import NODE_COUNTS, fill_shapes, is_triangle
from pcontact.runtime.jit import njit, njit_inner


@njit_inner
def dot(a, b):
    """a . b"""
    value = 0.0
    for i in range(len(a)):
        value += a[i] * b[i]
    return value


@njit_inner
def unit_normal(c, n):
    """Write the unit normal of tangents: the tangent turned by -90 degrees, or the cross product; their length."""
    if len(n) == 2:
        n[0], n[1] = c[0, 1], -c[0, 0]
    else:
        n[0] = c[0, 1] * c[1, 2] - c[0, 2] * c[1, 1]
        n[1] = c[0, 2] * c[1, 0] - c[0, 0] * c[1, 2]
        n[2] = c[0, 0] * c[1, 1] - c[0, 1] * c[1, 0]
    length = np.sqrt(dot(n, n))
    for i in range(len(n)):
        n[i] /= length
    return length


@njit_inner
def invert(h11, h12, h22, nb, out):
    if nb == 1:
        out[0, 0] = 1.0 / h11
        return h11
    det = h11 * h22 - h12 * h12
    out[0, 0], out[0, 1], out[1, 0], out[1, 1] = h22 / det, -h12 / det, -h12 / det, h11 / det
    return det if h11 > 0.0 else -abs(det)


@njit_inner
def dual_basis(a, metric, out):
    """Dual basis of tangents a (2, d), and the inverse of their metric."""
    d = a.shape[1]
    nb = d - 1
    invert(dot(a[0], a[0]), dot(a[0], a[1]), dot(a[1], a[1]), nb, metric)
    for i in range(nb):
        for k in range(d):
            out[i, k] = metric[i, 0] * a[0, k]
            if nb == 2:
                out[i, k] += metric[i, 1] * a[1, k]


@njit_inner
def source_at(source, p, u, x, c):
    """Place and tangents of a source point under nodal displacements."""
    f, d = source.facet[p], u.shape[1]
    for k in range(d):
        x[k] = source.x[p, k]
        for b in range(d - 1):
            c[b, k] = source.tangent[p, b, k]
    for a in range(source.on.shape[1]):
        node = source.cells[f, source.on[f, a]]
        for k in range(d):
            x[k] += source.shape[p, a] * u[node, k]
            for b in range(d - 1):
                c[b, k] += source.slope[p, b, a] * u[node, k]


@njit_inner
def target_at(nodes, count, x, u, shapes, y, a, bend):
    """Place, tangents and second derivatives of the target facet from its shape functions."""
    d = u.shape[1]
    for k in range(d):
        y[k] = 0.0
        for i in range(2):
            a[i, k] = 0.0
        for i in range(3):
            bend[i, k] = 0.0
    for m in range(count):
        node = nodes[m]
        for k in range(d):
            place = x[node, k] + u[node, k]
            y[k] += shapes[0, m] * place
            a[0, k] += shapes[1, m] * place
            bend[0, k] += shapes[3, m] * place
            if d == 3:
                a[1, k] += shapes[2, m] * place
                bend[1, k] += shapes[4, m] * place
                bend[2, k] += shapes[5, m] * place


# [reference coordinates] How near to an edge a partner is on it. From: chosen, rounding errors of shape functions.
ON = 1e-9
# [-] Cosine of the angle by which the line to the partner may turn from the normal that was found. From: chosen, 60
# degrees; a corner between facets that meet in a smooth surface has a fraction of it.
AWAY = 0.5
# of Newton's method for the partner, along an edge, too: iterations, largest step and last one in reference coordinates
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
def _place_target(kind, nodes, motion, w):
    """The target at w.xi: place, tangents and second derivatives."""
    fill_shapes(kind, w.xi[0], w.xi[1], w.shapes)
    target_at(nodes, NODE_COUNTS[kind], motion.x, motion.u, w.shapes, w.y, w.a, w.bend)


@njit_inner
def hold(kind, nodes, motion, found, w):
    """Partner on the edge or corner that w.xi is on, normal and gap; ``found`` is the normal that was found."""
    d = len(w.n)
    _edge_of(kind, w.xi[0], w.xi[1], d, w.edge)
    for _ in range(ITERATIONS):
        _place_target(kind, nodes, motion, w)
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


NONE, RAY, CLOSEST, HELD, FIXED, TIED, OBSTACLE = range(7)
BEYOND, BESIDE = 1.5, 0.25
# [-] Largest ratio of the areas of facets to those across the normal. From: chosen; facets at 75 degrees to each other.
ASKEW = 4.0


class FiniteSource(NamedTuple):
    """Points (np) of a source with nf facets, of whose parent cells ms nodes are on the facet.

    Attributes
    ----------
    facet : ndarray (np,)
    cells : ndarray (nf, nn)
        Nodes of the parent cells, numbers into nodal values (n, d).
    on : ndarray (nf, ms)
        Which of them are on the facet.
    shape : ndarray (np, ms)
        Their shape functions at the points.
    slope : ndarray (np, d - 1, ms)
        Derivatives of these along the tangents of the undeformed facet [1/length].
    x : ndarray (np, d)
        Undeformed places of the points, relative to the origin [length].
    tangent : ndarray (np, d - 1, d)
        Orthonormal tangents of the undeformed facet; (t_y, -t_x) and t_1 x t_2 are its outward normal.
    jxw : ndarray (np,)
        Weights [length^(d - 1)].
    """

    facet: np.ndarray
    cells: np.ndarray
    on: np.ndarray
    shape: np.ndarray
    slope: np.ndarray
    x: np.ndarray
    tangent: np.ndarray
    jxw: np.ndarray


class FinitePartner(NamedTuple):
    """Frozen partners of the points.

    Attributes
    ----------
    mode : ndarray (np,)
        NONE, RAY, CLOSEST, HELD, FIXED, TIED or OBSTACLE.
    nodes : ndarray (np, mt)
        Of the target facets, numbers into nodal values; of width 0 for an obstacle.
    kind : ndarray (np,)
        See `pcontact.contact.surface.facet_maps`.
    xi : ndarray (np, 2)
        Where Newton's method for the partner begins; the partner itself where that is frozen.
    normal : ndarray (np, d)
        Where it is frozen, of points that are held where they were found, and of obstacles.
    shift : ndarray (np,)
        Added to the gap [length].
    offset : ndarray (np, d)
        Of tied points: zeta_0 and g_0 [length].
    gap : ndarray (np,)
        Of obstacles [length].
    curvature : ndarray (np, d, d)
        Hessian of the distance of obstacles [1/length]; else of length 0.
    start : ndarray (np, d)
        x_c, of obstacles, relative to the origin [length].
    others : ndarray (np, no)
        Nodes of the partners' cells that are not on their facets; of width 0 where only the source has a traction.
    """

    mode: np.ndarray
    nodes: np.ndarray
    kind: np.ndarray
    xi: np.ndarray
    normal: np.ndarray
    shift: np.ndarray
    offset: np.ndarray
    gap: np.ndarray
    curvature: np.ndarray
    start: np.ndarray
    others: np.ndarray


class Motion(NamedTuple):
    """Nodal values (n, d): undeformed places relative to the origin, displacements now and committed [length]; and the
    lag (np, d) of the points, see `pcontact.contact.formulation.small`, in the committed state."""

    x: np.ndarray
    u: np.ndarray
    before: np.ndarray
    lag: np.ndarray


class PointWork(NamedTuple):
    """Results and scratch of one point; of two values or rows for tangents the first alone counts in the plane.

    Attributes
    ----------
    shapes : ndarray (6, 9)
        Of the target facet and their derivatives, see `facet_maps.fill_shapes`.
    xi, zeta, zeta_lag : ndarray (2,)
        zeta_z and B+ lag.
    x, old_x, y, old_y, n, old_n, slip, rest : ndarray (d,)
        ``rest`` is z - A_k zeta_z.
    gap : ndarray (1,)
    c, c_dual, old_c, a, a_dual, old_a, old_dual, across : ndarray (2, d)
        ``across`` are the rows of B+.
    bend, old_bend : ndarray (3, d)
        y,11, y,12, y,22.
    metric, old_metric : ndarray (2, 2)
        Inverse of a_i . a_j + g n . y,ij, and of the old a_i . a_j.
    inverse : ndarray (d, d)
        Of [a_i, -n].
    dn, ds : ndarray (d, k)
    dg : ndarray (k,)
    dxi : ndarray (2, k)
    dj : ndarray (k,)
        Of ln J.
        Derivatives with respect to the displacements of the ms nodes of the source facet and the mt ones of the target.
    edge : ndarray (3,)
        Of held points e, zero at a corner, and whether n turns (1.0).
    r, t, da, dz : ndarray (d,), (d,), (2, d), (2,)
        Scratch.
    """

    shapes: np.ndarray
    xi: np.ndarray
    zeta: np.ndarray
    zeta_lag: np.ndarray
    x: np.ndarray
    old_x: np.ndarray
    y: np.ndarray
    old_y: np.ndarray
    n: np.ndarray
    old_n: np.ndarray
    slip: np.ndarray
    rest: np.ndarray
    gap: np.ndarray
    c: np.ndarray
    c_dual: np.ndarray
    old_c: np.ndarray
    a: np.ndarray
    a_dual: np.ndarray
    old_a: np.ndarray
    old_dual: np.ndarray
    across: np.ndarray
    bend: np.ndarray
    old_bend: np.ndarray
    metric: np.ndarray
    old_metric: np.ndarray
    inverse: np.ndarray
    dn: np.ndarray
    ds: np.ndarray
    dg: np.ndarray
    dxi: np.ndarray
    dj: np.ndarray
    edge: np.ndarray
    r: np.ndarray
    t: np.ndarray
    da: np.ndarray
    dz: np.ndarray


def point_work(d, width):
    """Scratch for points in d dimensions with ``width`` nodes of both sides."""
    v, m, k = (lambda: np.zeros(d)), (lambda rows: np.zeros((rows, d))), width * d
    return PointWork(
        np.zeros((6, 9)), np.zeros(2), np.zeros(2), np.zeros(2), v(), v(), v(), v(), v(), v(), v(), v(), np.zeros(1),
        m(2), m(2), m(2), m(2), m(2), m(2), m(2), m(2), m(3), m(3), np.zeros((2, 2)), np.zeros((2, 2)),
        np.zeros((d, d)), np.zeros((d, k)), np.zeros((d, k)), np.zeros(k), np.zeros((2, k)), np.zeros(k), np.zeros(3),
        v(), v(), m(2), np.zeros(2),
    )  # fmt: skip


@njit_inner
def _is_near(kind, u, v, d):
    """Return whether a reference point is on the facet as it goes on beyond its edges."""
    if is_triangle(kind):
        return u >= -BESIDE and v >= -BESIDE and 1.0 - u - v >= -BESIDE
    return abs(u) <= BEYOND and (d == 2 or abs(v) <= BEYOND)


@njit_inner
def _cross_rows(w):
    """Inverse of [a_i, -n] in w.inverse; False where n is along the facet or leaves it on the wrong side."""
    a, n, out = w.a, w.n, w.inverse
    if len(n) == 2:
        det = n[0] * a[0, 1] - n[1] * a[0, 0]
        out[0, 0], out[0, 1] = n[1] / -det, n[0] / det
        out[1, 0], out[1, 1] = a[0, 1] / -det, a[0, 0] / det
        return det < 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[0, k] = a[1, i] * n[j] - a[1, j] * n[i]
        out[1, k] = n[i] * a[0, j] - n[j] * a[0, i]
        out[2, k] = -(a[0, i] * a[1, j] - a[0, j] * a[1, i])
    det = -dot(n, out[2])
    for i in range(3):
        for k in range(3):
            out[i, k] /= det
    return det < 0.0


@njit_inner
def _hessian(w, nb, gap_n):
    """Inverse of a_i . a_j + gap_n . y,ij in w.metric, where gap_n is y - x; False where that is not positive."""
    h11 = dot(w.a[0], w.a[0]) + dot(gap_n, w.bend[0])
    h12 = dot(w.a[0], w.a[1]) + dot(gap_n, w.bend[1])
    h22 = dot(w.a[1], w.a[1]) + dot(gap_n, w.bend[2])
    return invert(h11, h12, h22, nb, w.metric) > 0.0


@njit_inner
def _trace_ray(kind, nodes, motion, w):
    """Partner along the normal, from w.xi on; whether there is one."""
    d, g = len(w.n), 0.0
    nb = d - 1
    for _ in range(ITERATIONS):
        _place_target(kind, nodes, motion, w)
        if not _cross_rows(w):
            return False
        for k in range(d):
            w.r[k] = w.x[k] + g * w.n[k] - w.y[k]
        step = 0.0
        for i in range(nb):
            w.dz[i] = dot(w.inverse[i], w.r)
            step = max(step, abs(w.dz[i]))
        g += dot(w.inverse[nb], w.r)
        if step <= SMALLEST:
            w.gap[0] = g
            return _is_near(kind, w.xi[0], w.xi[1], d)
        part = min(1.0, FARTHEST / step)
        for i in range(nb):
            w.xi[i] += part * w.dz[i]
    return False


@njit_inner
def _project(kind, nodes, motion, w):
    """Closest point of the facet, from w.xi on, and the normal; whether there is one."""
    d = len(w.n)
    nb = d - 1
    for _ in range(ITERATIONS):
        _place_target(kind, nodes, motion, w)
        for k in range(d):
            w.r[k] = w.y[k] - w.x[k]
        if not _hessian(w, nb, w.r):
            return False
        step, first, second = 0.0, dot(w.r, w.a[0]), dot(w.r, w.a[1])
        for i in range(nb):
            w.dz[i] = -w.metric[i, 0] * first
            if nb == 2:
                w.dz[i] -= w.metric[i, 1] * second
            step = max(step, abs(w.dz[i]))
        if step <= SMALLEST:
            unit_normal(w.a, w.n)
            for k in range(d):
                w.n[k] = -w.n[k]
            w.gap[0] = dot(w.r, w.n)
            return _is_near(kind, w.xi[0], w.xi[1], d)
        part = min(1.0, FARTHEST / step)
        for i in range(nb):
            w.xi[i] += part * w.dz[i]
    return False


@njit_inner
def _slip(mode, source, p, nodes, kind, motion, w):
    """Slip of a point against its target, and zeta."""
    d = len(w.n)
    nb = d - 1
    source_at(source, p, motion.before, w.old_x, w.old_c)
    target_at(nodes, NODE_COUNTS[kind], motion.x, motion.before, w.shapes, w.old_y, w.old_a, w.old_bend)
    if mode == HELD or mode == FIXED:
        for k in range(d):
            w.slip[k] = w.x[k] - w.y[k] - w.old_x[k] + w.old_y[k] + motion.lag[p, k]
        return
    over = 0.0
    if mode == RAY:
        unit_normal(w.old_c, w.old_n)
        over = w.gap[0]
    for k in range(d):
        w.rest[k] = w.old_y[k] - w.old_x[k] - over * w.old_n[k] + (motion.lag[p, k] if mode == CLOSEST else 0.0)
        w.slip[k] = 0.0
    if mode == RAY:
        for i in range(nb):
            along = dot(w.old_n, w.old_a[i])
            for k in range(d):
                w.da[i, k] = w.old_a[i, k] - along * w.old_n[k]
        dual_basis(w.da, w.old_metric, w.across)
    dual_basis(w.old_a, w.old_metric, w.old_dual)
    for i in range(nb):
        w.zeta[i] = dot(w.old_dual[i], w.rest)
        w.zeta_lag[i] = dot(w.across[i], motion.lag[p]) if mode == RAY else 0.0
    for i in range(nb):
        for k in range(d):
            w.rest[k] -= w.old_a[i, k] * w.zeta[i]
            w.slip[k] += w.a[i, k] * (w.zeta[i] + w.zeta_lag[i])


@njit_inner
def place_point(source, partner, motion, p, slides, w):
    """Normal, gap, partner and, where the point `slides` with friction, slip of a point; whether it has a partner."""
    mode, kind, d = partner.mode[p], partner.kind[p], motion.u.shape[1]
    source_at(source, p, motion.u, w.x, w.c)
    w.gap[0] = 0.0
    for k in range(d):
        w.slip[k] = 0.0
    if mode == OBSTACLE:
        w.gap[0] = partner.gap[p] + partner.shift[p]
        for k in range(d):
            w.n[k] = partner.normal[p, k]
            w.slip[k] = w.x[k] - partner.start[p, k] + motion.lag[p, k]
        return True
    unit_normal(w.c, w.n)
    if mode == NONE:
        return False
    nodes = partner.nodes[p]
    w.xi[0], w.xi[1] = partner.xi[p, 0], partner.xi[p, 1]
    if mode == RAY or mode == CLOSEST:
        found = _trace_ray(kind, nodes, motion, w) if mode == RAY else _project(kind, nodes, motion, w)
        if not found:
            unit_normal(w.c, w.n)
            w.gap[0] = 0.0
            return False
    elif mode == HELD:
        hold(kind, nodes, motion, partner.normal[p], w)
    elif mode == FIXED:
        _place_target(kind, nodes, motion, w)
        for k in range(d):
            w.n[k] = partner.normal[p, k]
            w.gap[0] += (w.y[k] - w.x[k]) * w.n[k]
    else:
        _place_target(kind, nodes, motion, w)
        unit_normal(w.a, w.n)
        for k in range(d):
            w.n[k] = -w.n[k]
        for k in range(d):
            w.slip[k] = w.x[k] - w.y[k] + partner.offset[p, d - 1] * w.n[k]
            for i in range(d - 1):
                w.slip[k] += w.a[i, k] * partner.offset[p, i]
        w.gap[0] = -dot(w.slip, w.n)
        return True
    if slides:
        _slip(mode, source, p, nodes, kind, motion, w)
    w.gap[0] += partner.shift[p]
    return True


@njit_inner
def _turn_of_source(source, p, a, j, w, k):
    """dn of the source's normal in column k, from node a of the facet along j. w.c_dual is known."""
    for i in range(len(w.n)):
        value = 0.0
        for b in range(len(w.n) - 1):
            value -= w.c_dual[b, i] * source.slope[p, b, a]
        w.dn[i, k] = value * w.n[j]


@njit_inner
def derive_point(source, partner, p, mode, slides, w):
    """Derivatives of what :func:`place_point` has just found at a point; ``mode`` is NONE where it found no partner."""
    d = len(w.n)
    nb, ms, mt = d - 1, source.on.shape[1], partner.nodes.shape[1]
    gap = w.gap[0] - (partner.shift[p] if mode != TIED else 0.0)
    if mode == RAY or mode == NONE:
        dual_basis(w.c, w.metric, w.c_dual)
    if mode == CLOSEST or mode == TIED:
        dual_basis(w.a, w.metric, w.a_dual)
    if mode == CLOSEST:
        for k in range(d):
            w.r[k] = gap * w.n[k]
        _hessian(w, nb, w.r)
    for slot in range(ms + mt):
        m = slot - ms
        if mode != NONE and mode != OBSTACLE and m >= NODE_COUNTS[partner.kind[p]]:
            for k in range(slot * d, (slot + 1) * d):
                w.dg[k] = 0.0
                for i in range(d):
                    w.dn[i, k], w.ds[i, k] = 0.0, 0.0
                w.dxi[0, k], w.dxi[1, k] = 0.0, 0.0
            continue
        for j in range(d):
            _column(source, partner, p, mode, slot, j, slides, w)


@njit_inner
def _column(source, partner, p, mode, slot, j, slides, w):
    """Derivatives with respect to displacement j of a node."""
    d = len(w.n)
    nb, k, m = d - 1, slot * d + j, slot - source.on.shape[1]
    # of [[du]] along j
    value = source.shape[p, slot] if m < 0 else -w.shapes[0, m]
    gap = w.gap[0] - (partner.shift[p] if mode != TIED else 0.0)
    w.dg[k], w.dxi[0, k], w.dxi[1, k] = 0.0, 0.0, 0.0
    for i in range(d):
        w.dn[i, k], w.ds[i, k] = 0.0, 0.0
    if mode == NONE:
        if m < 0:
            _turn_of_source(source, p, slot, j, w, k)
        return
    if mode == OBSTACLE or mode == FIXED:
        w.dg[k] = -w.n[j] * value
        w.ds[j, k] = value
        if mode == OBSTACLE:
            for i in range(d):
                w.dn[i, k] = -partner.curvature[p, i, j] * value
        return
    if mode == HELD:
        held_column(gap, value, m, j, w, k)
        return
    if mode == RAY:
        if m < 0:
            _turn_of_source(source, p, slot, j, w, k)
        for i in range(d):
            w.r[i] = gap * w.dn[i, k]
        w.r[j] += value
        for i in range(nb):
            w.dxi[i, k] = dot(w.inverse[i], w.r)
        w.dg[k] = dot(w.inverse[nb], w.r)
    elif mode == CLOSEST:
        w.dg[k] = -w.n[j] * value
        for i in range(nb):
            w.dz[i] = w.a[i, j] * value - (gap * w.n[j] * w.shapes[1 + i, m] if m >= 0 else 0.0)
        for i in range(nb):
            w.dxi[i, k] = w.metric[i, 0] * w.dz[0]
            if nb == 2:
                w.dxi[i, k] += w.metric[i, 1] * w.dz[1]
    for i in range(nb):
        for q in range(d):
            w.da[i, q] = w.bend[i, q] * w.dxi[0, k]
            if nb == 2:
                w.da[i, q] += w.bend[i + 1, q] * w.dxi[1, k]
        if m >= 0:
            w.da[i, j] += w.shapes[1 + i, m]
    if mode != RAY:
        for i in range(nb):
            along = dot(w.n, w.da[i])
            for q in range(d):
                w.dn[q, k] -= w.a_dual[i, q] * along
    if mode == TIED:
        _tied_column(partner, p, j, value, w, k)
    elif slides:
        _slip_column(mode, w, k)


@njit_inner
def _tied_column(partner, p, j, value, w, k):
    """ds = [[du]] + dA zeta_0 + g_0 dn and dg = -(n . ds + s . dn)."""
    d = len(w.n)
    w.ds[j, k] = value
    for q in range(d):
        w.ds[q, k] += partner.offset[p, d - 1] * w.dn[q, k]
        for i in range(d - 1):
            w.ds[q, k] += w.da[i, q] * partner.offset[p, i]
    for q in range(d):
        w.dg[k] -= w.n[q] * w.ds[q, k] + w.slip[q] * w.dn[q, k]


@njit_inner
def _slip_column(mode, w, k):
    """ds from dxi, dg and da."""
    d = len(w.n)
    nb = d - 1
    over = w.dg[k] if mode == RAY else 0.0
    for i in range(nb):
        w.dz[i] = 0.0
    for q in range(d):
        # A_k dxi - n_k dg - dA_k zeta_z, and dA_k (B+ lag)
        w.r[q], w.t[q] = -over * w.old_n[q], 0.0
        for i in range(nb):
            w.r[q] += w.old_a[i, q] * w.dxi[i, k]
            turn = w.old_bend[i, q] * w.dxi[0, k]
            if nb == 2:
                turn += w.old_bend[i + 1, q] * w.dxi[1, k]
            w.r[q] -= turn * w.zeta[i]
            w.t[q] += turn * w.zeta_lag[i]
            w.dz[i] += turn * w.rest[q]
    for i in range(nb):
        dzeta = dot(w.old_dual[i], w.r) + w.old_metric[i, 0] * w.dz[0] - dot(w.across[i], w.t)
        if nb == 2:
            dzeta += w.old_metric[i, 1] * w.dz[1]
        for q in range(d):
            w.ds[q, k] += w.da[i, q] * (w.zeta[i] + w.zeta_lag[i]) + w.a[i, q] * dzeta


@njit_inner
def _area_vector(a, out):
    """Tangent turned by -90 degrees, or cross product of two, and its length."""
    length = unit_normal(a, out)
    for k in range(len(out)):
        out[k] *= length
    return length


@njit_inner
def _turned(a, da, out):
    """Derivative of :func:`_area_vector` along da (2, d)."""
    if len(out) == 2:
        out[0], out[1] = da[0, 1], -da[0, 0]
        return
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] = da[0, i] * a[1, j] - da[0, j] * a[1, i] + a[0, i] * da[1, j] - a[0, j] * da[1, i]


@njit_inner
def _ratio(nodes, count, motion, radius, axis, w):
    """J of a point that has been placed, whether the target is too askew, its radius and area, undeformed. Leaves area
    vectors of the source, the target and the undeformed target in w.r, w.t and w.rest, and tangents and second
    derivatives of the latter."""
    d = len(w.n)
    _area_vector(w.c, w.r)
    over, other = _area_vector(w.a, w.t), -dot(w.t, w.n)
    for k in range(d):
        w.old_y[k] = 0.0
        for i in range(2):
            w.old_a[i, k] = 0.0
        for i in range(3):
            w.old_bend[i, k] = 0.0
    for m in range(count):
        for k in range(d):
            place = motion.x[nodes[m], k]
            w.old_y[k] += w.shapes[0, m] * place
            for i in range(d - 1):
                w.old_a[i, k] += w.shapes[1 + i, m] * place
            for i in range(2 * d - 3):
                w.old_bend[i, k] += w.shapes[3 + i, m] * place
    area, askew = _area_vector(w.old_a, w.rest), ASKEW * other < over
    ratio = area * max(dot(w.r, w.n), 0.0) / (over / ASKEW if askew else other)
    if axis < np.inf:
        ratio *= (w.old_y[0] - axis) / radius
    return ratio, askew, area


@njit
def area_ratios(source, partner, motion, axis, work, out):
    """J of points on targets: ``out`` (np,), where it is not zero; 0 without a partner.

    Parameters
    ----------
    source, partner, motion, work
        As for :func:`evaluate`.
    axis : float
        Place of the axis of symmetry relative to the origin, infinite without one [length].
    out : ndarray (np,)
    """
    for p in range(len(out)):
        if out[p] == 0.0:
            continue
        out[p] = 0.0
        if place_point(source, partner, motion, p, False, work):
            nodes, count = partner.nodes[p], NODE_COUNTS[partner.kind[p]]
            out[p] = _ratio(nodes, count, motion, source.x[p, 0] - axis, axis, work)[0]


@njit_inner
def derive_ratio(source, partner, motion, p, axis, w):
    """J of a point on a target, with derivatives of its logarithm in w.dj, where :func:`derive_point` has been."""
    d, ms, count = len(w.n), source.on.shape[1], NODE_COUNTS[partner.kind[p]]
    ratio, askew, area = _ratio(partner.nodes[p], count, motion, source.x[p, 0] - axis, axis, w)
    w.dj[:] = 0.0
    if ratio == 0.0:
        return ratio
    own, other = dot(w.r, w.n), -dot(w.t, w.n)
    if askew:
        other = np.sqrt(dot(w.t, w.t))
    for slot in range(ms + count):
        m = slot - ms
        for j in range(d):
            k = slot * d + j
            value = 0.0
            for q in range(d):
                value += w.r[q] * w.dn[q, k] / own
            if m < 0:
                _fill_tangents(w.da, 0.0, w.dxi, k, w.bend)
                for b in range(d - 1):
                    w.da[b, j] = source.slope[p, b, slot]
                _turned(w.c, w.da, w.old_n)
                value += dot(w.old_n, w.n) / own
            # the undeformed target
            _fill_tangents(w.da, 1.0, w.dxi, k, w.old_bend)
            _turned(w.old_a, w.da, w.old_n)
            value += dot(w.old_n, w.rest) / area**2
            if axis < np.inf:
                for i in range(d - 1):
                    value += w.old_a[i, 0] * w.dxi[i, k] / (w.old_y[0] - axis)
            _fill_tangents(w.da, 1.0, w.dxi, k, w.bend)
            if m >= 0:
                for i in range(d - 1):
                    w.da[i, j] += w.shapes[1 + i, m]
            _turned(w.a, w.da, w.old_n)
            if askew:
                value -= dot(w.old_n, w.t) / other**2
            else:
                value += dot(w.old_n, w.n) / other
                for q in range(d):
                    value += w.t[q] * w.dn[q, k] / other
            w.dj[k] = value
    return ratio


@njit_inner
def _fill_tangents(da, factor, dxi, k, bend):
    """Motion of tangents (2, d) along a facet in column k, times a factor."""
    d = da.shape[1]
    for i in range(2):
        for q in range(d):
            da[i, q] = 0.0
    for i in range(d - 1):
        for q in range(d):
            da[i, q] = factor * bend[i, q] * dxi[0, k]
            if d == 3:
                da[i, q] += factor * bend[i + 1, q] * dxi[1, k]


class Placed(NamedTuple):
    """Contact at the points (np).

    Attributes
    ----------
    live : ndarray (np,) of bool
        Whether the point has a partner at this displacement.
    normal : ndarray (np, d)
        n.
    gap : ndarray (np,)
        g; 0 without partner [length].
    slip : ndarray (np, d)
        (I - n n) s, likewise [length].
    shape : ndarray (np, mt)
        Shape functions of the target facet at the partner.
    xi : ndarray (np, 2)
        Reference coordinates there.
    """

    live: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    slip: np.ndarray
    shape: np.ndarray
    xi: np.ndarray


def unplaced(n, d, mt):
    """A :class:`Placed` of n points in d dimensions, with partners of mt nodes, to be written."""
    return Placed(
        np.empty(n, dtype=bool), np.empty((n, d)), np.empty(n), np.empty((n, d)), np.empty((n, mt)), np.empty((n, 2))
    )


@njit
def evaluate(source, partner, motion, slides, work, out):
    """Contact at all points.

    Parameters
    ----------
    source : FiniteSource
    partner : FinitePartner
    motion : Motion
    slides : bool
        Whether slip is wanted.
    work : PointWork
    out : Placed
        Out.
    """
    d, mt = out.normal.shape[1], partner.nodes.shape[1]
    for p in range(len(source.facet)):
        live = place_point(source, partner, motion, p, slides, work)
        along = dot(work.slip, work.n)
        out.live[p], out.gap[p] = live, work.gap[0]
        for k in range(d):
            out.normal[p, k] = work.n[k]
            out.slip[p, k] = work.slip[k] - along * work.n[k]
        count = NODE_COUNTS[partner.kind[p]] if live else 0
        for m in range(mt):
            out.shape[p, m] = work.shapes[0, m] if m < count else 0.0
        out.xi[p, 0], out.xi[p, 1] = work.xi[0], work.xi[1]


@njit
def stretch(source, grad, u, out):
    """Largest ratio w = |F^-T N| on each facet: lengths along the normal shrink by 1/w where they are free to.

    Parameters
    ----------
    source : FiniteSource
    grad : ndarray (np, nn, d)
        Shape gradients of the parent cells [1/length].
    u : ndarray (n, d)
        Displacement.
    out : ndarray (nf,)
        Out.
    """
    d = u.shape[1]
    f, x, c, n = np.zeros((d, d)), np.zeros(d), np.zeros((2, d)), np.zeros(d)
    out[:] = 0.0
    for p in range(len(source.facet)):
        facet = source.facet[p]
        for i in range(d):
            for j in range(d):
                f[i, j] = 1.0 if i == j else 0.0
        for a in range(grad.shape[1]):
            for i in range(d):
                for j in range(d):
                    f[i, j] += u[source.cells[facet, a], i] * grad[p, a, j]
        det = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
        if d == 3:
            det = f[2, 2] * det
            det += f[0, 1] * f[1, 2] * f[2, 0] - f[0, 0] * f[1, 2] * f[2, 1]
            det += f[0, 2] * f[1, 0] * f[2, 1] - f[0, 2] * f[1, 1] * f[2, 0]
        source_at(source, p, u, x, c)
        if det > 0.0:
            out[facet] = max(out[facet], unit_normal(c, n) / det)


@njit
def current_normals(source, u, normal):
    """Outward unit normals (np, d) of the source under nodal displacements (n, d)."""
    d = u.shape[1]
    x, c, n = np.zeros(d), np.zeros((2, d)), np.zeros(d)
    for p in range(len(source.facet)):
        source_at(source, p, u, x, c)
        unit_normal(c, n)
        for k in range(d):
            normal[p, k] = n[k]


@njit
def tied_offsets(source, partner, x, u, offset):
    """Components zeta_0 and g_0 of y - x at tied points: offset (np, d), at nodal values (n, d) [length]."""
    d = u.shape[1]
    nb, shapes, metric = d - 1, np.zeros((6, 9)), np.zeros((2, 2))
    place, c, y, n = np.zeros(d), np.zeros((2, d)), np.zeros(d), np.zeros(d)
    a, dual, bend = np.zeros((2, d)), np.zeros((2, d)), np.zeros((3, d))
    for p in range(len(source.facet)):
        if partner.mode[p] != TIED:
            continue
        kind = partner.kind[p]
        source_at(source, p, u, place, c)
        fill_shapes(kind, partner.xi[p, 0], partner.xi[p, 1], shapes)
        target_at(partner.nodes[p], NODE_COUNTS[kind], x, u, shapes, y, a, bend)
        dual_basis(a, metric, dual)
        unit_normal(a, n)
        for k in range(d):
            y[k] -= place[k]
        for i in range(nb):
            offset[p, i] = dot(dual[i], y)
        offset[p, nb] = -dot(n, y)
