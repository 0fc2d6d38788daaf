"""Logarithmic strain at a point, and its first two derivatives, without lost digits.

With the displacement gradient H and F = I + H,

    2 G = H + H^T + H^T H,    C = F^T F = I + 2 G,    E = 1/2 log C = sum_i 1/2 log1p(a_i) N_i (x) N_i

where a_i, N_i are the eigenpairs of 2 G: those of C would hide strains below the rounding error of 1. Along the
principal axes N_i, in Mandel components (`pcontact.material.elastic`),

    dE/dG = diag(f),             f_ij = log[c_i, c_j],             c_i = 1 + a_i
    T : d2E/dG2 = L(T),          h_ijk = 4 log[c_i, c_j, c_k]      (divided differences of the logarithm)

    L[ii, ii] = t_ii h_iii              L[ij, ij] = (t_ii h_iij + t_jj h_ijj) / 2
    L[ii, ij] = t_ij h_iij / 2          L[jj, ij] = t_ij h_ijj / 2          L[il, jl] = t_ij h_123 / (2 sqrt 2)

with Mandel components t of T. Nothing is divided by a difference of eigenvalues that are close: equal ones are no
special case.

Of small strains both are had without eigenpairs, by Gauss's rule for an integral over 0 < x < 1:

    log(I + 2 G) = int 2 G S_x dx,    d log(I + 2 G) = int S_x 2 dG S_x dx,    S_x = (I + x 2 G)^-1

The error of n points falls as r^-2n, where r = t + sqrt(t^2 - 1) with t = 2 / |2 G| - 1.

Tensors are arrays (3, 3), also in the plane, where the third direction stands alone; m = 6 in 3D, 4 in 2D.
"""

import numpy as np

from pcontact.material.elastic import indices
from pcontact.runtime.jit import njit_inline, njit_inner, njit_inner_exact

ROOT = np.sqrt(2.0)
# sweeps of Jacobi's method, which converges quadratically; off-diagonal part, squared, at which it ends
SWEEPS, NOTHING = 30, 1e-36
# below these differences, series
CLOSE, NEAR = 0.2, 0.1
# of the sum: what no longer changes it
LAST = 1e-18
# numbers of Gauss's points, and norms of 2 G up to which they leave rounding errors alone
COUNTS, SIZES = (4, 6, 8), (0.02, 0.12, 0.25)
# points and weights on (0, 1), a row for each number
POINTS, WEIGHTS = (
    np.array([np.pad(part, (0, COUNTS[-1] - len(part))) for part in parts])
    for parts in zip(*((0.5 + 0.5 * x, 0.5 * w) for x, w in map(np.polynomial.legendre.leggauss, COUNTS)), strict=True)
)


@njit_inner_exact
def volume_change(h):
    """J - 1 of a displacement gradient (3, 3): tr H + (tr(H)^2 - tr(H^2)) / 2 + det H."""
    second = (
        h[0, 0] * h[1, 1] - h[0, 1] * h[1, 0] + h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1] + h[0, 0] * h[2, 2]
        - h[0, 2] * h[2, 0]
    )  # fmt: skip
    third = (
        h[0, 0] * (h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1])
        - h[0, 1] * (h[1, 0] * h[2, 2] - h[1, 2] * h[2, 0])
        + h[0, 2] * (h[1, 0] * h[2, 1] - h[1, 1] * h[2, 0])
    )
    return h[0, 0] + h[1, 1] + h[2, 2] + second + third


@njit_inner_exact
def twice_green(h, out):
    """2 G of a displacement gradient into ``out``, both (3, 3)."""
    for i in range(3):
        for j in range(i, 3):
            value = h[i, j] + h[j, i] + (h[0, i] * h[0, j] + h[1, i] * h[1, j] + h[2, i] * h[2, j])
            out[i, j] = value
            out[j, i] = value


@njit_inner
def _inverse(xx, yy, zz, xy, yz, xz):
    """Inverse of a symmetric tensor, by components."""
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    factor = 1.0 / (xx * a + xy * b + xz * c)
    return (
        factor * a, factor * (xx * zz - xz * xz), factor * (xx * yy - xy * xy), factor * b,
        factor * (xy * xz - xx * yz), factor * c,
    )  # fmt: skip


@njit_inner
def fill_product(a, b, out):
    """Product of symmetric tensors that have the same axes, all by components XX, YY, ZZ, XY, YZ, XZ."""
    out[0] = a[0] * b[0] + a[3] * b[3] + a[5] * b[5]
    out[1] = a[3] * b[3] + a[1] * b[1] + a[4] * b[4]
    out[2] = a[5] * b[5] + a[4] * b[4] + a[2] * b[2]
    out[3] = a[0] * b[3] + a[3] * b[1] + a[5] * b[4]
    out[4] = a[3] * b[5] + a[1] * b[4] + a[4] * b[2]
    out[5] = a[0] * b[5] + a[3] * b[4] + a[5] * b[2]


@njit_inner
def small_log(a, wants, rows, products):
    """E = 1/2 log(I + a) of a small symmetric tensor in space, and what its derivative is made of.

    Parameters
    ----------
    a : ndarray (3, 3)
        2 G.
    wants : bool
        Whether ``products`` are wanted.
    rows : ndarray (6, 6)
        Overwritten: E and C^-1 = (I + a)^-1 in the first two rows, by components XX, YY, ZZ, XY, YZ, XZ.
    products : ndarray (6, 6)
        Overwritten where wanted: the upper triangle of the sum of w (B S + S B) over the points, products of
        components of S and of B = C^-1 S.

    Returns
    -------
    bool
        Whether it is small enough; nothing is written where not.
    """
    xx, yy, zz, xy, yz, xz = a[0, 0], a[1, 1], a[2, 2], a[0, 1], a[1, 2], a[0, 2]
    square, rule = xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + xz * xz), 0
    for k in range(len(SIZES)):
        rule += 0 if square <= SIZES[k] ** 2 else 1
    if rule == len(SIZES):
        return False
    strain, inverse, s, b, total, own = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5] = _inverse(
        1.0 + xx, 1.0 + yy, 1.0 + zz, xy, yz, xz
    )
    own[0], own[1], own[2], own[3], own[4], own[5] = 0.5 * xx, 0.5 * yy, 0.5 * zz, 0.5 * xy, 0.5 * yz, 0.5 * xz
    for i in range(6):
        total[i] = 0.0
        for j in range(6):
            products[i, j] = 0.0
    for k in range(COUNTS[rule]):
        x, w = POINTS[rule, k], WEIGHTS[rule, k]
        s[0], s[1], s[2], s[3], s[4], s[5] = _inverse(
            1.0 + x * xx, 1.0 + x * yy, 1.0 + x * zz, x * xy, x * yz, x * xz
        )
        for i in range(6):
            total[i] += w * s[i]
        if wants:
            fill_product(inverse, s, b)
            for i in range(6):
                for j in range(i, 6):
                    products[i, j] += w * (b[i] * s[j] + s[i] * b[j])
    fill_product(own, total, strain)
    return True


@njit_inner_exact
def _jacobi(a, values, vectors):
    """Eigenpairs of a symmetric (3, 3) by Jacobi's rotations; ``a`` is overwritten."""
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
        if off <= NOTHING * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            break
        for k in range(3):
            p, q = (0, 1) if k == 0 else ((0, 2) if k == 1 else (1, 2))
            r, between = 3 - p - q, a[p, q]
            if between == 0.0:
                continue
            ratio = (a[q, q] - a[p, p]) / (2.0 * between)
            t = 1.0 / (abs(ratio) + np.sqrt(ratio**2 + 1.0))
            if ratio < 0.0:
                t = -t
            c = 1.0 / np.sqrt(t**2 + 1.0)
            s = t * c
            a[p, p] -= t * between
            a[q, q] += t * between
            a[p, q] = 0.0
            a[q, p] = 0.0
            x, y = a[r, p], a[r, q]
            a[r, p] = c * x - s * y
            a[p, r] = a[r, p]
            a[r, q] = s * x + c * y
            a[q, r] = a[r, q]
            for i in range(3):
                x, y = vectors[i, p], vectors[i, q]
                vectors[i, p] = c * x - s * y
                vectors[i, q] = s * x + c * y
    for i in range(3):
        values[i] = a[i, i]


@njit_inner_exact
def _plane(a, values, vectors):
    """Eigenpairs of a symmetric (3, 3) whose third direction stands alone, in closed form."""
    mean, q, b = 0.5 * (a[0, 0] + a[1, 1]), 0.5 * (a[0, 0] - a[1, 1]), a[0, 1]
    r = np.hypot(q, b)
    if r == 0.0:
        c, s = 1.0, 0.0
    elif q >= 0.0:
        c = np.sqrt(0.5 * (1.0 + q / r))
        s = b / (2.0 * r * c)
    else:
        s = np.copysign(np.sqrt(0.5 * (1.0 - q / r)), b)
        c = b / (2.0 * r * s)
    values[0], values[1], values[2] = mean + r, mean - r, a[2, 2]
    vectors[:, :] = 0.0
    vectors[0, 0] = c
    vectors[1, 0] = s
    vectors[0, 1] = -s
    vectors[1, 1] = c
    vectors[2, 2] = 1.0


@njit_inner_exact
def eigenpairs(a, m, values, vectors):
    """Eigenvalues (3,) and eigenvectors, columns of (3, 3), of a symmetric (3, 3), which may be overwritten.

    For m = 4 the third direction stands alone, and stays the third one.
    """
    if m == 4:
        _plane(a, values, vectors)
    else:
        _jacobi(a, values, vectors)


@njit_inner_exact
def compose(values, vectors, out):
    """sum_i values_i N_i (x) N_i into ``out`` (3, 3)."""
    for i in range(3):
        for j in range(i, 3):
            value = 0.0
            for k in range(3):
                value += values[k] * vectors[i, k] * vectors[j, k]
            out[i, j] = value
            out[j, i] = value


@njit_inner_exact
def axes_operator(vectors, out):
    """Orthogonal matrix (m, m) that takes Mandel components to those along the axes, the columns of ``vectors``."""
    m = out.shape[0]
    for k in range(m):
        i, j = indices(k)
        factor = 1.0 if k < 3 else ROOT
        for n in range(3):
            out[k, n] = factor * vectors[n, i] * vectors[n, j]
        for n in range(3, m):
            a, b = indices(n)
            if k < 3:
                out[k, n] = ROOT * vectors[a, i] * vectors[b, i]
            else:
                out[k, n] = vectors[a, i] * vectors[b, j] + vectors[b, i] * vectors[a, j]


@njit_inner_exact
def log_difference(a, b):
    """log[1 + a, 1 + b], the first divided difference of the logarithm; 1 / (1 + a) where both are equal."""
    total = 2.0 + (a + b)
    x = (a - b) / total
    if abs(x) < CLOSE:
        square, power, ratio = x * x, 1.0, 1.0
        for k in range(1, 13):
            power *= square
            ratio += power / (2 * k + 1)
            if power < LAST:
                break
    else:
        ratio = np.arctanh(x) / x
    return 2.0 / total * ratio


@njit_inner_exact
def log_difference_2(a, b, c):
    """log[1 + a, 1 + b, 1 + c], the second divided difference; -1 / (2 (1 + a)^2) where all are equal."""
    low, high = min(a, b, c), max(a, b, c)
    middle = max(min(a, b), min(max(a, b), c))
    mean = 1.0 + (a + b + c) / 3.0
    if high - low > NEAR * mean:
        return (log_difference(middle, high) - log_difference(low, middle)) / (high - low)
    # offsets from the mean, in parts of it
    x = ((low - middle) + (low - high)) / (3.0 * mean)
    y = ((middle - low) + (middle - high)) / (3.0 * mean)
    z = ((high - low) + (high - middle)) / (3.0 * mean)
    e2, e3 = x * y + y * z + x * z, x * y * z
    # complete symmetric polynomials of the offsets, whose sum is zero
    s0, s1, s2 = 1.0, 0.0, -e2
    total, sign = -0.5, -1.0
    for k in range(2, 19):
        total += sign * s2 / (k + 2)
        if abs(s2) + abs(s1) < LAST:
            break
        sign = -sign
        s0, s1, s2 = s1, s2, -e2 * s1 + e3 * s0
    return total / mean**2


@njit_inner_exact
def slopes(values, out):
    """f (m,): dE/dG along the principal axes is diag(f), for the eigenvalues (3,) of 2 G."""
    for i in range(3):
        out[i] = 1.0 / (1.0 + values[i])
    out[3] = log_difference(values[0], values[1])
    if out.shape[0] == 6:
        out[4] = log_difference(values[1], values[2])
        out[5] = log_difference(values[0], values[2])


@njit_inline
def _add_both(out, i, j, value):
    out[i, j] += value
    out[j, i] += value


@njit_inner_exact
def add_curvature(values, stress, out):
    """Add L(T) along the principal axes to ``out`` (m, m); ``stress`` (m,) is T, ``values`` (3,) those of 2 G."""
    m, sheared = out.shape[0], False
    for i in range(3):
        out[i, i] -= 2.0 * stress[i] / (1.0 + values[i]) ** 2
    for k in range(3, m):
        i, j = indices(k)
        a, b = 2.0 * log_difference_2(values[i], values[i], values[j]), 2.0 * log_difference_2(
            values[i], values[j], values[j]
        )
        out[k, k] += stress[i] * a + stress[j] * b
        if stress[k] != 0.0:
            sheared = True
            _add_both(out, i, k, stress[k] * a)
            _add_both(out, j, k, stress[k] * b)
    if sheared and m == 6:
        h = ROOT * log_difference_2(values[0], values[1], values[2])
        _add_both(out, 5, 4, stress[3] * h)
        _add_both(out, 3, 5, stress[4] * h)
        _add_both(out, 3, 4, stress[5] * h)
