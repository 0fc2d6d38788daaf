"""Places and tangents of a source point and its target facet under nodal displacements, and some algebra with them.

Parameters not told: see `pcontact.contact.formulation.finite_geometry`.
"""

import numpy as np

from pcontact.runtime.jit import njit_inner


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
