"""Compiled kernels of bodies with finite strain, cell by cell, over their undeformed shape (total Lagrangian).

With the first Piola-Kirchhoff stress P and what `pcontact.material.finite` gives at a point (S, A, Fb, Gb_a = Ui G_a),

    R_a = int P G_a,    P = Fb S Ui
    K_ab = int (Gb_a . S Gb_b) I + B_a^T A B_b,    B_a[v] = Mandel components of sym(Fb^T (v (x) Gb_a))

With axial symmetry the gradient has F33 = 1 + u_r / R, a 33 component of B, Fb33 Ui33 N_a / R v_r, and K_rr has
S33 Ui33^2 N_a N_b / R^2 more.

The mean dilatation is th, the projection of ln J on constants or linear functions over the undeformed cell
(`pcontact.element.dilatation`); b are the members of its basis, of which the mean of b b is 1. The energy U(th) of the
cell gives the points the pressure  proj U'(th) = sum_b b mean(b U'(th)),  and with  m_b = mean of b F^-T G_a

    K += sum_bb' m_b M_bb' m_b',    M_bb' = int b b' U''(th),    dS += c sum_b b (sum_b' M_bb' m_b') / V,    c = Cb^-1

This is symmetric, since all of it comes from an energy. At u = 0 it is the mean dilatation of small strain.

In a cell in which a point cannot be integrated (J <= 0), forces are NaN: no step of Newton's method may end there.

The energy per undeformed volume is, with the logarithmic strain e along the principal axes, and e_e what of it is
elastic, at a point

* Hencky:  mu e_e : e_e + own/2 (tr e)^2 + shared/2 th^2, and (2/3 Hk)/2 E_p : E_p in what hardens kinematically; in
  plane stress 1/2 e_e : C_e : e_e of the plane, across which nothing does work;
* rubber:  sum_p mu_p / alpha_p sum_i g(alpha_p dev e_i) + own/4 g(2 tr e) + shared/4 g(2 th),  g(x) = exp(x) - 1 - x.

With g no digit of a small strain is lost: the deviators of the e_i sum to zero, and so do the parts x of the g.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.material.elastic import HALF, indices, moduli_of
from pcontact.material.finite import (
    CONSISTENT,
    STRESS,
    FiniteMaterial,
    PointWork,
    new_plastic_strain,
    point_work,
    pressure_of,
    pressure_slope,
    stress_at,
    thickness,
    to_tensor,
)
from pcontact.material.log_strain import compose, eigenpairs, twice_green, volume_change
from pcontact.runtime.jit import njit, njit_inner, njit_within

# below this, the series of g; of the sum: what no longer changes it
CLOSE, LAST = 0.5, 1e-18


class FiniteCells(NamedTuple):
    """Cells of one block, with their undeformed shape.

    Attributes
    ----------
    nodes : ndarray (nc, nn)
        Numbers into nodal values.
    grad : ndarray (nc, nq, nn, d)
        Shape gradients [1/length].
    jxw : ndarray (nc, nq)
        Quadrature weights.
    ring : ndarray (nc, nq, nn)
        N / R with axial symmetry [1/length], else (0, 0, 0).
    basis : ndarray (nc, nq, nb)
        Of the mean dilatation at the points, see `pcontact.element.dilatation.components`; nb = 0 without.
    volume : ndarray (nc,)
    """

    nodes: np.ndarray
    grad: np.ndarray
    jxw: np.ndarray
    ring: np.ndarray
    basis: np.ndarray
    volume: np.ndarray


class FiniteState(NamedTuple):
    """Material and internal variables of the cells of one block, or of some of them.

    Attributes
    ----------
    material : pcontact.material.finite.FiniteMaterial
        With the volumetric moduli of these cells.
    strain : ndarray (nc, nq, m)
        Committed plastic strain at the quadrature points, Mandel components; one row of zeros where none may yield.
    p : ndarray (nc, nq)
        Committed equivalent plastic strain, likewise.
    """

    material: FiniteMaterial
    strain: np.ndarray
    p: np.ndarray


class CellWork(NamedTuple):
    """Results and scratch of a cell.

    Attributes
    ----------
    h : ndarray (nq, 3, 3)
        Displacement gradients.
    log_volume, pressure : ndarray (nq,)
        ln J where there is a mean dilatation, and what that adds to the mean Kirchhoff stress [stress].
    inverse : ndarray (nq, 3, 3)
        F^-1.
    means : ndarray (nb, nn d)
        m_b [1/length].
    moduli : ndarray (nb, nb)
        M_bb' [stress * length^d].
    deformation, stretch : ndarray (3, 3)
        Fb and Ui of a point.
    tensor, piola : ndarray (3, 3)
        S and P of a point [stress].
    operator, pulled : ndarray (nn d, nq m)
        B and weight A B of all points, the components of a point beside each other: sums over points are dot
        products of rows.
    grad, bent : ndarray (nn, nq d)
        Gb_a and weight S Gb_a of all points.
    hoop, bent_hoop : ndarray (nn, nq)
        Ui33 N_a / R, and the same times weight and S33, with axial symmetry.
    stiffness : ndarray (nn d, nn d)
    point : pcontact.material.finite.PointWork
    """

    h: np.ndarray
    log_volume: np.ndarray
    pressure: np.ndarray
    inverse: np.ndarray
    means: np.ndarray
    moduli: np.ndarray
    weighted: np.ndarray
    amount: np.ndarray
    deformation: np.ndarray
    stretch: np.ndarray
    tensor: np.ndarray
    piola: np.ndarray
    operator: np.ndarray
    pulled: np.ndarray
    grad: np.ndarray
    bent: np.ndarray
    hoop: np.ndarray
    bent_hoop: np.ndarray
    stiffness: np.ndarray
    point: PointWork


def cell_work(cells):
    """A :class:`CellWork` for cells of a kind."""
    nq, nn, d = cells.grad.shape[1:]
    m, nb, n = 6 if d == 3 else 4, cells.basis.shape[2], nn * d
    shapes = [(nq, 3, 3), (nq,), (nq,), (nq, 3, 3), (nb, n), (nb, nb), (nb, n), (nb,), (3, 3), (3, 3), (3, 3), (3, 3),
              (n, nq * m), (n, nq * m), (nn, nq * d), (nn, nq * d), (nn, nq), (nn, nq), (n, n)]  # fmt: skip
    return CellWork(*(np.zeros(shape) for shape in shapes), point_work(m))


@njit_inner
def gradient_at(cells, nodal, c, q, h):
    """Displacement gradient of a point into ``h`` (3, 3)."""
    nn, d = cells.grad.shape[2], cells.grad.shape[3]
    h[:, :] = 0.0
    for a in range(nn):
        node = cells.nodes[c, a]
        for i in range(d):
            for j in range(d):
                h[i, j] += nodal[node, i] * cells.grad[c, q, a, j]
    if cells.ring.shape[0] > 0:
        for a in range(nn):
            h[2, 2] += nodal[cells.nodes[c, a], 0] * cells.ring[c, q, a]


@njit_inner
def _invert(h, volume, out):
    """F^-1 of F = I + h, of determinant ``volume``, into ``out`` (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = h[i, j]
        out[i, i] += 1.0
    a, b, c = out[0, 0], out[0, 1], out[0, 2]
    d, e, f = out[1, 0], out[1, 1], out[1, 2]
    g, k, m = out[2, 0], out[2, 1], out[2, 2]
    out[0, 0], out[0, 1], out[0, 2] = (e * m - f * k) / volume, (c * k - b * m) / volume, (b * f - c * e) / volume
    out[1, 0], out[1, 1], out[1, 2] = (f * g - d * m) / volume, (a * m - c * g) / volume, (c * d - a * f) / volume
    out[2, 0], out[2, 1], out[2, 2] = (d * k - e * g) / volume, (b * g - a * k) / volume, (a * e - b * d) / volume


@njit_inner
def _add_means(cells, c, q, work):
    """Add the part of a point to m_b; its F^-1 is known."""
    nn, d = cells.grad.shape[2], cells.grad.shape[3]
    inverse = work.inverse[q]
    for b in range(len(work.means)):
        factor = cells.jxw[c, q] * cells.basis[c, q, b] / cells.volume[c]
        for a in range(nn):
            for i in range(d):
                value = 0.0
                for j in range(d):
                    value += inverse[j, i] * cells.grad[c, q, a, j]
                work.means[b, a * d + i] += factor * value
            if cells.ring.shape[0] > 0:
                work.means[b, a * d] += factor * inverse[2, 2] * cells.ring[c, q, a]


@njit_within
def _begin_cell(state, cells, nodal, c, mode, work):
    """Displacement gradients of a cell, and its mean dilatation; False if a point of it cannot be integrated."""
    material = state.material
    nq, nb = cells.grad.shape[1], cells.basis.shape[2]
    if mode != STRESS:
        work.means[:, :] = 0.0
        work.moduli[:, :] = 0.0
    for q in range(nq):
        gradient_at(cells, nodal, c, q, work.h[q])
        change = volume_change(work.h[q])
        if not (change > -1.0 and change < np.inf):
            return False
        work.pressure[q] = 0.0
        if nb > 0:
            work.log_volume[q] = np.log1p(change)
        if nb > 0 and mode != STRESS:
            _invert(work.h[q], 1.0 + change, work.inverse[q])
            _add_means(cells, c, q, work)
    if nb == 0:
        return True
    # amounts of th on the basis, then of U'(th)
    for b in range(nb):
        work.amount[b] = 0.0
        for q in range(nq):
            work.amount[b] += cells.jxw[c, q] * cells.basis[c, q, b] * work.log_volume[q] / cells.volume[c]
    for q in range(nq):
        mean = 0.0
        for b in range(nb):
            mean += cells.basis[c, q, b] * work.amount[b]
        work.log_volume[q] = mean
    for b in range(nb):
        work.amount[b] = 0.0
    for q in range(nq):
        value = cells.jxw[c, q] * pressure_of(material, material.shared, work.log_volume[q])
        for b in range(nb):
            work.amount[b] += cells.basis[c, q, b] * value / cells.volume[c]
        if mode != STRESS:
            slope = cells.jxw[c, q] * pressure_slope(material, material.shared, work.log_volume[q])
            for b in range(nb):
                for k in range(nb):
                    work.moduli[b, k] += slope * cells.basis[c, q, b] * cells.basis[c, q, k]
    for q in range(nq):
        for b in range(nb):
            work.pressure[q] += cells.basis[c, q, b] * work.amount[b]
    if mode != STRESS:
        for b in range(nb):
            work.weighted[b, :] = 0.0
            for k in range(nb):
                factor = work.moduli[b, k]
                for n in range(work.means.shape[1]):
                    work.weighted[b, n] += factor * work.means[k, n]
    return True


@njit_inner
def begin_cell(state, cells, nodal, c, mode, work):
    """:func:`_begin_cell`, apart."""
    return _begin_cell(state, cells, nodal, c, mode, work)


@njit_within
def _point_of_cell(state, cells, c, q, mode, work):
    """S of a point, with its tangent, Fb, Ui and P; False if it cannot be integrated. After :func:`begin_cell`."""
    row = c if len(state.material.small.curve) > 0 else 0
    good, plastic, _, _ = stress_at(
        state.material, work.h[q], state.strain[row, q], state.p[row, q], work.pressure[q], mode, work.point
    )
    if not good:
        return False
    to_tensor(work.point.stress, work.tensor)
    fb, ui, h = work.deformation, work.stretch, work.h[q]
    for i in range(3):
        for j in range(3):
            fb[i, j] = h[i, j] + (1.0 if i == j else 0.0)
            ui[i, j] = 1.0 if i == j else 0.0
    if plastic:
        for i in range(3):
            for j in range(3):
                ui[i, j] = work.point.unplastic[i, j]
        for i in range(3):
            x, y, z = fb[i, 0], fb[i, 1], fb[i, 2]
            for j in range(3):
                fb[i, j] = x * ui[0, j] + y * ui[1, j] + z * ui[2, j]
    for i in range(3):
        x = fb[i, 0] * work.tensor[0, 0] + fb[i, 1] * work.tensor[1, 0] + fb[i, 2] * work.tensor[2, 0]
        y = fb[i, 0] * work.tensor[0, 1] + fb[i, 1] * work.tensor[1, 1] + fb[i, 2] * work.tensor[2, 1]
        z = fb[i, 0] * work.tensor[0, 2] + fb[i, 1] * work.tensor[1, 2] + fb[i, 2] * work.tensor[2, 2]
        for j in range(3):
            work.piola[i, j] = x * ui[0, j] + y * ui[1, j] + z * ui[2, j]
    return True


@njit_inner
def point_of_cell(state, cells, c, q, mode, work):
    """:func:`_point_of_cell`, apart."""
    return _point_of_cell(state, cells, c, q, mode, work)


@njit_within
def _fill_operators(cells, c, q, weight, work):
    """Gb_a, S Gb_a, B and A B of a point. After :func:`point_of_cell`."""
    nn, d, m = cells.grad.shape[2], cells.grad.shape[3], work.point.stress.shape[0]
    fb, ui, s, operator, at = work.deformation, work.stretch, work.tensor, work.operator, q * m
    hoop = cells.ring.shape[0] > 0
    for a in range(nn):
        g, bent, first = work.grad[a], work.bent[a], q * d
        for i in range(d):
            value = 0.0
            for j in range(d):
                value += ui[i, j] * cells.grad[c, q, a, j]
            g[first + i] = value
        for i in range(d):
            value = 0.0
            for j in range(d):
                value += s[i, j] * g[first + j]
            bent[first + i] = weight * value
        x, y = g[first], g[first + 1]
        for i in range(d):
            row = operator[a * d + i]
            row[at] = fb[i, 0] * x
            row[at + 1] = fb[i, 1] * y
            row[at + 3] = HALF * (fb[i, 0] * y + fb[i, 1] * x)
            if d == 3:
                z = g[first + 2]
                row[at + 2] = fb[i, 2] * z
                row[at + 4] = HALF * (fb[i, 1] * z + fb[i, 2] * y)
                row[at + 5] = HALF * (fb[i, 0] * z + fb[i, 2] * x)
            else:
                row[at + 2] = 0.0
        if hoop:
            work.hoop[a, q] = ui[2, 2] * cells.ring[c, q, a]
            work.bent_hoop[a, q] = weight * s[2, 2] * work.hoop[a, q]
            operator[a * d, at + 2] = fb[2, 2] * work.hoop[a, q]
    tangent = work.point.tangent
    if m == 6:
        # written out: loops of a length that the compiler does not know take three times as long
        for n in range(nn * d):
            row, out = operator[n], work.pulled[n]
            x, y, z = weight * row[at], weight * row[at + 1], weight * row[at + 2]
            xy, yz, xz = weight * row[at + 3], weight * row[at + 4], weight * row[at + 5]
            for k in range(6):
                t = tangent[k]
                out[at + k] = t[0] * x + t[1] * y + t[2] * z + t[3] * xy + t[4] * yz + t[5] * xz
        return
    for n in range(nn * d):
        row, out = operator[n], work.pulled[n]
        x, y, z, xy = weight * row[at], weight * row[at + 1], weight * row[at + 2], weight * row[at + 3]
        for k in range(4):
            t = tangent[k]
            out[at + k] = t[0] * x + t[1] * y + t[2] * z + t[3] * xy


@njit_inner
def _dot(a, b):
    value = 0.0
    for k in range(a.shape[0]):
        value += a[k] * b[k]
    return value


@njit
def add_forces(state, cells, nodal, work, out):
    """Add the nodal forces to ``out`` (n, d) [force]; NaN in cells that cannot be integrated."""
    nq, nn, d = cells.grad.shape[1], cells.grad.shape[2], cells.grad.shape[3]
    for c in range(len(cells.nodes)):
        good = _begin_cell(state, cells, nodal, c, STRESS, work)
        for q in range(nq):
            good = good and _point_of_cell(state, cells, c, q, STRESS, work)
            if not good:
                break
            for a in range(nn):
                node = cells.nodes[c, a]
                for i in range(d):
                    force = 0.0
                    for j in range(d):
                        force += work.piola[i, j] * cells.grad[c, q, a, j]
                    out[node, i] += cells.jxw[c, q] * force
                if cells.ring.shape[0] > 0:
                    out[node, 0] += cells.jxw[c, q] * work.piola[2, 2] * cells.ring[c, q, a]
        if not good:
            for a in range(nn):
                for i in range(d):
                    out[cells.nodes[c, a], i] = np.nan


@njit
def add_sizes(modulus, cells, nodal, out):
    """Add the sizes of the terms of the forces to ``out`` (n, d) [force]: a stress has the rounding errors of the
    displacements and gradients of which it is made, times the modulus [stress]."""
    nq, nn, d = cells.grad.shape[1], cells.grad.shape[2], cells.grad.shape[3]
    for c in range(len(cells.nodes)):
        for q in range(nq):
            size = 0.0
            for a in range(nn):
                u, g = 0.0, 0.0
                for i in range(d):
                    u += abs(nodal[cells.nodes[c, a], i])
                    g += abs(cells.grad[c, q, a, i])
                size += u * g
                if cells.ring.shape[0] > 0:
                    size += abs(nodal[cells.nodes[c, a], 0]) * abs(cells.ring[c, q, a])
            size = modulus * size * (1.0 + size) * cells.jxw[c, q]
            for a in range(nn):
                for i in range(d):
                    out[cells.nodes[c, a], i] += size * abs(cells.grad[c, q, a, i])
                if cells.ring.shape[0] > 0:
                    out[cells.nodes[c, a], 0] += size * abs(cells.ring[c, q, a])


@njit_within
def cell_stiffness(state, cells, nodal, c, work):
    """Upper triangle of the stiffness of a cell; False if it cannot be integrated."""
    nq, nn, d = cells.grad.shape[1], cells.grad.shape[2], cells.grad.shape[3]
    stiffness = work.stiffness
    if not _begin_cell(state, cells, nodal, c, CONSISTENT, work):
        return False
    for q in range(nq):
        if not _point_of_cell(state, cells, c, q, CONSISTENT, work):
            return False
        _fill_operators(cells, c, q, cells.jxw[c, q], work)
    n = nn * d
    for i in range(n):
        for j in range(i, n):
            stiffness[i, j] = _dot(work.operator[i], work.pulled[j])
    for a in range(nn):
        for b in range(a, nn):
            value = _dot(work.grad[a], work.bent[b])
            for i in range(d):
                stiffness[a * d + i, b * d + i] += value
            if cells.ring.shape[0] > 0:
                stiffness[a * d, b * d] += _dot(work.hoop[a], work.bent_hoop[b])
    for b in range(len(work.means)):
        for i in range(n):
            factor = work.means[b, i]
            for j in range(i, n):
                stiffness[i, j] += factor * work.weighted[b, j]
    return True


@njit_within
def _scatter(stiffness, nodes, c, blocks):
    """Add the symmetric matrix of cell ``c``, of which the upper triangle is known, to block rows."""
    rowptr, columns, out = blocks.rowptr, blocks.columns, blocks.values
    nn, d = nodes.shape[1], out.shape[1]
    for a in range(nn):
        row = nodes[c, a]
        for b in range(nn):
            k = find(columns, rowptr[row], rowptr[row + 1], nodes[c, b])
            # written out: loops of a length that the compiler does not know take several times as long
            if d == 3:
                for i in range(3):
                    for j in range(3):
                        m, n = a * 3 + i, b * 3 + j
                        out[k, i, j] += stiffness[min(m, n), max(m, n)]
            else:
                for i in range(2):
                    for j in range(2):
                        m, n = a * 2 + i, b * 2 + j
                        out[k, i, j] += stiffness[min(m, n), max(m, n)]


@njit
def add_tangent(state, cells, nodal, work, blocks):
    """Add the stiffness of cells to block rows; returns how many could not be integrated."""
    missed = 0
    for c in range(len(cells.nodes)):
        if cell_stiffness(state, cells, nodal, c, work):
            _scatter(work.stiffness, cells.nodes, c, blocks)
        else:
            missed += 1
    return missed


@njit_inner
def cell_piola(state, cells, nodal, c, mode, work, piola, slope):
    """First Piola-Kirchhoff stress of a cell at its points, and its derivative.

    Parameters
    ----------
    state : FiniteState
    cells : FiniteCells
    nodal : ndarray (n, d)
        Displacement.
    c : int
        Cell.
    mode : int
        STRESS; CONSISTENT; or ELASTIC: derivative with the elastic moduli, which at the committed displacement is a
        linear operator that does not depend on what rounding errors say of yielding.
    work : CellWork
    piola : ndarray (nq, d, d)
        Overwritten: P [stress]; P N is the traction on a facet with the normal N, per undeformed area.
    slope : ndarray (nq, d, d, nn d)
        Overwritten unless STRESS: dP_ij / du of the nodes [stress/length].

    Returns
    -------
    bool
        False if the cell cannot be integrated; both mean nothing then.
    """
    nq, nn, d = cells.grad.shape[1], cells.grad.shape[2], cells.grad.shape[3]
    nb, m = cells.basis.shape[2], state.strain.shape[2]
    if not begin_cell(state, cells, nodal, c, mode, work):
        return False
    for q in range(nq):
        if not point_of_cell(state, cells, c, q, mode, work):
            return False
        for i in range(d):
            for j in range(d):
                piola[q, i, j] = work.piola[i, j]
        if mode == STRESS:
            continue
        _fill_operators(cells, c, q, 1.0, work)
        fb, ui, out, pulled = work.deformation, work.stretch, slope[q], work.pulled
        out[:, :, :] = 0.0
        for i in range(d):
            for j in range(d):
                # dFb S Ui
                for a in range(nn):
                    value = 0.0
                    for k in range(d):
                        value += work.bent[a, q * d + k] * ui[k, j]
                    out[i, j, a * d + i] += value
                # Fb dS Ui, by components
                for k in range(m):
                    if k < 3:
                        factor = fb[i, k] * ui[k, j]
                    else:
                        s, t = indices(k)
                        factor = HALF * (fb[i, s] * ui[t, j] + fb[i, t] * ui[s, j])
                    if factor != 0.0:
                        for n in range(nn * d):
                            out[i, j, n] += factor * pulled[n, q * m + k]
                # Fb Cb^-1 Ui = F^-T
                for b in range(nb):
                    factor = work.inverse[q, j, i] * cells.basis[c, q, b] / cells.volume[c]
                    for n in range(nn * d):
                        out[i, j, n] += factor * work.weighted[b, n]
    return True


@njit_inner
def acoustic(state, cells, c, q, normal, work, out):
    """Acoustic tensor of a point along a direction N: the derivative of the traction P N by the displacement gradient
    v (x) N, per undeformed area. After :func:`point_of_cell` in a mode other than STRESS.

        Q = (g . S g) I + B^T A B + U'' n n,    g = Ui N,    n = F^-T N

    Parameters
    ----------
    normal : ndarray (d,)
        N, of the undeformed body.
    work : CellWork
        ``operator`` is overwritten.
    out : ndarray (3, 3)
        Overwritten: Q [stress], symmetric; zeros in the third direction of a plane.
    """
    d, m, fb, s = normal.shape[0], work.point.stress.shape[0], work.deformation, work.tensor
    g, rows, along, slope = work.point.row, work.operator, 0.0, 0.0
    out[:, :] = 0.0
    for i in range(3):
        g[i] = 0.0
        for j in range(d):
            g[i] += work.stretch[i, j] * normal[j]
    for i in range(3):
        for j in range(3):
            along += g[i] * s[i, j] * g[j]
    for i in range(d):
        for k in range(m):
            a, b = indices(k)
            rows[i, k] = fb[i, a] * g[a] if k < 3 else HALF * (fb[i, a] * g[b] + fb[i, b] * g[a])
    if cells.basis.shape[2] > 0:
        slope = pressure_slope(state.material, state.material.shared, work.log_volume[q])
    for i in range(d):
        out[i, i] += along
        for j in range(d):
            for k in range(m):
                for n in range(m):
                    out[i, j] += rows[i, k] * work.point.tangent[k, n] * rows[j, n]
    if slope > 0.0:
        for i in range(d):
            g[i] = 0.0
            for j in range(d):
                g[i] += work.inverse[q, j, i] * normal[j]
        for i in range(d):
            for j in range(d):
                out[i, j] += slope * g[i] * g[j]


@njit
def commit(state, cells, nodal, work):
    """Let the state of all points of the cells, in place, follow the displacement; returns how many could not."""
    missed = 0
    for c in range(len(cells.nodes)):
        for q in range(cells.grad.shape[1]):
            gradient_at(cells, nodal, c, q, work.h[q])
            good, _, p, yields = stress_at(
                state.material, work.h[q], state.strain[c, q], state.p[c, q], 0.0, STRESS, work.point
            )
            missed += 0 if good else 1
            if good and yields:
                new_plastic_strain(state.material, state.strain[c, q], work.point)
                state.p[c, q] = p
    return missed


@njit
def cauchy(state, cells, nodal, work, stress, strain, volume):
    """Means over the deformed cells of the Cauchy stress (nc, 6) and the logarithmic strain ln V (nc, 6).

    ``volume`` (nc,) is that of the undeformed cells. Components XX, YY, ZZ, XY, YZ, XZ of the tensors.
    """
    nq, material, logs = cells.grad.shape[1], state.material, work.point.row
    for c in range(len(cells.nodes)):
        stress[c, :] = 0.0
        strain[c, :] = 0.0
        total = 0.0
        good = begin_cell(state, cells, nodal, c, STRESS, work)
        for q in range(nq):
            if not (good and point_of_cell(state, cells, c, q, STRESS, work)):
                stress[c, :] = np.nan
                break
            ratio, across = 1.0 + volume_change(work.h[q]), 0.0
            if material.small.plane_stress:
                row = c if len(material.small.curve) > 0 else 0
                across = thickness(material, state.strain[row, q], state.p[row, q] > 0.0, work.point)
                ratio *= np.exp(across)
            weight = cells.jxw[c, q] * ratio
            total += weight
            # tau = Fb S Fb^T
            fb, s = work.deformation, work.tensor
            for k in range(6):
                i, j = indices(k)
                value = 0.0
                for a in range(3):
                    for b in range(3):
                        value += fb[i, a] * s[a, b] * fb[j, b]
                stress[c, k] += cells.jxw[c, q] * value
            for i in range(3):
                for j in range(3):
                    work.piola[i, j] = work.h[q, j, i]
            twice_green(work.piola, work.tensor)
            eigenpairs(work.tensor, state.strain.shape[2], work.point.values, work.point.vectors)
            for i in range(3):
                logs[i] = 0.5 * np.log1p(work.point.values[i])
            compose(logs, work.point.vectors, work.tensor)
            if material.small.plane_stress:
                work.tensor[2, 2] = across
            for k in range(6):
                i, j = indices(k)
                strain[c, k] += weight * work.tensor[i, j]
        volume[c] = 0.0
        for q in range(nq):
            volume[c] += cells.jxw[c, q]
        stress[c, :] /= total
        strain[c, :] /= total


@njit_inner
def _beyond_linear(x):
    """exp(x) - 1 - x."""
    if abs(x) > CLOSE:
        return np.expm1(x) - x
    term, total = 0.5 * x * x, 0.0
    for k in range(3, 24):
        total += term
        term *= x / k
        if abs(term) < LAST * total:
            break
    return total


@njit_inner
def _volumetric(material, modulus, log_volume):
    """Energy whose derivative is `pcontact.material.finite.pressure_of` [stress]."""
    if len(material.terms) > 0:
        return 0.25 * modulus * _beyond_linear(2.0 * log_volume)
    return 0.5 * modulus * log_volume**2


@njit_inner
def _hencky_energy(material, work):
    """Elastic energy of the deviator (in plane stress all of it), and what kinematic hardening stores [stress]."""
    lam, shear, back = moduli_of(material.small.constants, material.small.plane_stress)
    energy, stored, total = 0.0, 0.0, 0.0
    for i in range(work.new.shape[0]):
        across = i == 2 and material.small.plane_stress
        elastic = 0.0 if across else work.strain[i] - work.new[i]
        total += elastic if i < 3 else 0.0
        energy += 0.5 * shear * elastic**2
        stored += 0.5 * back * work.new[i] ** 2
    if material.small.plane_stress:
        energy += 0.5 * lam * total**2
    return energy + stored


@njit_inner
def _rubber_energy(terms, strain):
    """Energy of the deviator [stress]."""
    mean, energy = (strain[0] + strain[1] + strain[2]) / 3.0, 0.0
    for n in range(len(terms)):
        for i in range(3):
            energy += terms[n, 0] / terms[n, 1] * _beyond_linear(terms[n, 1] * (strain[i] - mean))
    return energy


@njit
def stored_energy(state, cells, nodal, work, stored, p):
    """Energy density at all points of the cells, for the state that goes with a displacement.

    Parameters
    ----------
    state : pcontact.assembly.finite_kernels.FiniteState
    cells : pcontact.assembly.finite_kernels.FiniteCells
    nodal : ndarray (n, d)
        Displacement.
    work : pcontact.assembly.finite_kernels.CellWork
    stored : ndarray (nc, nq)
        Overwritten: elastic energy and that of kinematic hardening [stress]; NaN where J <= 0.
    p : ndarray (nc, nq)
        Overwritten: equivalent plastic strain.
    """
    material = state.material
    for c in range(len(cells.nodes)):
        good = begin_cell(state, cells, nodal, c, STRESS, work)
        row = c if len(material.small.curve) > 0 else 0
        for q in range(cells.grad.shape[1]):
            stored[c, q] = np.nan
            if not good:
                continue
            fine, _, p[c, q], _ = stress_at(
                material, work.h[q], state.strain[row, q], state.p[row, q], 0.0, STRESS, work.point
            )
            if not fine:
                continue
            strain = work.point.strain
            if len(material.terms) > 0:
                stored[c, q] = _rubber_energy(material.terms, strain)
            else:
                stored[c, q] = _hencky_energy(material, work.point)
            if not material.small.plane_stress:
                stored[c, q] += _volumetric(material, material.own, strain[0] + strain[1] + strain[2])
            if cells.basis.shape[2] > 0:
                stored[c, q] += _volumetric(material, material.shared, work.log_volume[q])
