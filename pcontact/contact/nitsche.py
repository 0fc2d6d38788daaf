"""Nitsche's method without friction: compiled kernels at the quadrature points of the source.

Notation of every kernel, one row per quadrature point p on facet f = facet[p]:

* jump operator along the normal  N = n (x) [shape, -target_shape]
* normal traction of the source   t_n = b . u_cell,  b = n . d(sigma(u) n_X)/du
* gap  g = g0 - N u,  augmented traction  tau = t_n + gamma g,  P = min(tau, 0)

    residual   R  = - int P N . v + (theta / gamma) int (P - t_n) b . v
    tangent    K  = int H (gamma N N^T - N c^T - theta b N^T) - theta / gamma (1 - H) b c^T,   H = 1 where tau <= 0

with c = dt_n/du, which is b unless the cell yields; this is (R) and its generalised derivative with the normal parts
alone (Chouly, Hild 2013). A point without partner has P = 0. Bilateral contact (no separation) has H = 1 and P = tau
always. ``cells`` and ``targets`` hold numbers into ``u`` (n, d); a pair with an obstacle has targets of width 0. Where
``b`` has width 0 there is no traction of the source, t_n = c = 0 at theta = 0: the penalty method, see
`pcontact.contact.penalty`.
"""

import numpy as np

from pcontact.assembly.graph import find
from pcontact.runtime.jit import njit


@njit
def traction_operator(points, grad, volumetric, facet, mu, normal_x, normal, out):
    """b (np, nn, d) of some points: derivative of the normal component of the elastic boundary traction.

    Parameters
    ----------
    points : ndarray (n,)
        Those whose rows of ``out`` are written.
    grad : ndarray (np, nn, d)
        Shape gradients of the parent cell [1/length].
    volumetric : ndarray (np, nn, d)
        Volumetric operator P of the parent cell, lam G in plane strain [stress/length].
    facet : ndarray (np,)
    mu : ndarray (nf,)
        Shear modulus [stress].
    normal_x : ndarray (np, d)
        Outward normal of the source facet.
    normal : ndarray (np, d)
        Contact normal.
    out : ndarray (np, nn, d)
        (n_X . n) P_a + mu ((G_a . n_X) n + (G_a . n) n_X) [stress/length].
    """
    d = grad.shape[2]
    for k in range(len(points)):
        p = points[k]
        shear = mu[facet[p]]
        cosine = 0.0
        for i in range(d):
            cosine += normal_x[p, i] * normal[p, i]
        for a in range(grad.shape[1]):
            along_x = 0.0
            along_n = 0.0
            for i in range(d):
                along_x += grad[p, a, i] * normal_x[p, i]
                along_n += grad[p, a, i] * normal[p, i]
            for i in range(d):
                out[p, a, i] = cosine * volumetric[p, a, i] + shear * (
                    along_x * normal[p, i] + along_n * normal_x[p, i]
                )


@njit
def interpolate(values, cells, facet, shape, out):
    """Nodal values (n, d) at the points: out (np, d)."""
    d = values.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        for i in range(d):
            out[p, i] = 0.0
        for a in range(shape.shape[1]):
            node = cells[f, a]
            for i in range(d):
                out[p, i] += shape[p, a] * values[node, i]


@njit
def evaluate(u, cells, targets, facet, shape, target_shape, b, normal, gap0, traction, gap):
    """Normal traction t_n (np,) and gap (np,) at the displacement u (n, d)."""
    d = normal.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        t = 0.0
        g = gap0[p]
        for a in range(b.shape[1]):
            node = cells[f, a]
            for i in range(d):
                t += b[p, a, i] * u[node, i]
                g -= shape[p, a] * normal[p, i] * u[node, i]
        for a in range(b.shape[1], cells.shape[1]):
            node = cells[f, a]
            for i in range(d):
                g -= shape[p, a] * normal[p, i] * u[node, i]
        for m in range(targets.shape[1]):
            node = targets[p, m]
            for i in range(d):
                g += target_shape[p, m] * normal[p, i] * u[node, i]
        traction[p] = t
        gap[p] = g


@njit
def add_residual(
    theta, bilateral, paired, jxw, gamma, traction, gap, cells, targets, facet, shape, target_shape, b, normal, out
):
    """Add the residual of the pair to ``out`` (n, d) [force]."""
    d, traces = normal.shape[1], b.shape[1] if theta != 0.0 else 0
    for p in range(len(facet)):
        f = facet[p]
        tau = traction[p] + gamma[f] * gap[p]
        pressure = 0.0
        if paired[p] and (bilateral or tau < 0.0):
            pressure = tau
        weight = theta / gamma[f] * (pressure - traction[p]) * jxw[p]
        push = pressure * jxw[p]
        if pressure == 0.0 and theta == 0.0:
            continue
        for a in range(traces):
            node = cells[f, a]
            for i in range(d):
                out[node, i] += weight * b[p, a, i] - push * shape[p, a] * normal[p, i]
        for a in range(traces, cells.shape[1]):
            node = cells[f, a]
            for i in range(d):
                out[node, i] -= push * shape[p, a] * normal[p, i]
        for m in range(targets.shape[1]):
            node = targets[p, m]
            for i in range(d):
                out[node, i] += push * target_shape[p, m] * normal[p, i]


@njit
def add_tangent(
    theta, bilateral, paired, jxw, gamma, tau, cells, targets, facet, shape, target_shape, b, at, extra, consistent,
    normal, rowptr, columns, values,
):
    """Add the generalised Jacobian of the pair to block values (nnz, d, d); returns how many entries had no place.

    ``at`` (np,) and ``extra`` (n, nn, d) are what plasticity adds to b in c, see `pcontact.contact.plastic_trace`; with
    a ``consistent`` adjoint c stands in the place of b.
    """
    d, nn, nt = normal.shape[1], cells.shape[1], targets.shape[1]
    # the block of rows r and columns c is w (jump[r] (x) push[c] - trac[r] (x) pull[c])
    jump, push = np.zeros((nn + nt, d)), np.zeros((nn + nt, d))
    trac, pull = np.zeros((nn + nt, d)), np.zeros((nn + nt, d))
    missing = 0
    for p in range(len(facet)):
        f = facet[p]
        closed = paired[p] and (bilateral or tau[p] <= 0.0)
        if not closed and theta == 0.0:
            continue
        w, g = jxw[p], gamma[f]
        for a in range(nn):
            for i in range(d):
                jump[a, i] = w * shape[p, a] * normal[p, i] if closed else 0.0
        for m in range(nt):
            for i in range(d):
                jump[nn + m, i] = -w * target_shape[p, m] * normal[p, i] if closed else 0.0
        for r in range(nn + nt):
            for i in range(d):
                slope, adjoint = 0.0, 0.0
                if r < b.shape[1]:
                    slope = adjoint = b[p, r, i]
                    if len(at) > 0 and at[p] >= 0:
                        slope += extra[at[p], r, i]
                        if consistent:
                            adjoint = slope
                push[r, i] = g * jump[r, i] / w - slope
                trac[r, i] = theta * adjoint
                pull[r, i] = jump[r, i] if closed else w / g * slope
        width = nn + nt if closed else nn
        for r in range(width):
            row = cells[f, r] if r < nn else targets[p, r - nn]
            if theta == 0.0:
                # nodes of the cell that are not on the facet feel nothing
                still = True
                for i in range(d):
                    still = still and jump[r, i] == 0.0
                if still:
                    continue
            for c in range(width):
                column = cells[f, c] if c < nn else targets[p, c - nn]
                k = find(columns, rowptr[row], rowptr[row + 1], column)
                if k < 0:
                    missing += 1
                    continue
                for i in range(d):
                    for j in range(d):
                        values[k, i, j] += jump[r, i] * push[c, j] - trac[r, i] * pull[c, j]
    return missing


def no_operators(n_nodes, d):
    """What :func:`add_tangent` is given in place of the operators of cells that yield, where there are none."""
    return np.zeros(0, dtype=np.int64), np.zeros((0, n_nodes, d, d))
