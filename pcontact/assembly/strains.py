"""Compiled kernels between displacement and strain, cell by cell: what laws of small strain say at points becomes
forces and stiffness.

Elastic forces and stiffness of isotropic bodies are integrated once (`pcontact.assembly.solid`). Here are integrated
what an orthotropic stiffness differs by, and the excess of laws that are not linear, which is zero where nothing ever
yielded. An excess that is a deviator (in plane stress: without a 33 component) is not seen by a mean dilatation.

Common arguments, one row per cell c and quadrature point q; of points in a row the number is c nq + q:

    points : CellPoints          the points
    jxw (nc, nq)                 their weights, see `pcontact.assembly.geometry.chunks`
    active (n,)                  of a `pcontact.material.elastic.Response`
    nodal (n, d)                 displacement [length]
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.material.elastic import FLOWS, HALF, STILL
from pcontact.runtime.jit import njit, njit_inline, njit_inner

NO_RING = np.zeros((0, 0, 0))


class CellPoints(NamedTuple):
    """Quadrature points of cells: what takes the displacement of the nodes to the strain of the points.

    Attributes
    ----------
    cells : ndarray (nc, nn)
        Nodes, numbers into the displacement (n, d) that the kernels are given.
    grad : ndarray (nc, nq, nn, d)
        Shape gradients [1/length].
    ring : ndarray (nc, nq, nn)
        N / r with axial symmetry [1/length], else (0, 0, 0).
    """

    cells: np.ndarray
    grad: np.ndarray
    ring: np.ndarray


def cell_points(cells, grad, ring):
    """The :class:`CellPoints` of gradients, and of N / r or None."""
    return CellPoints(cells, grad, NO_RING if ring is None else np.ascontiguousarray(ring))


@njit_inline
def strain_at(points, nodal, c, q, strain):
    """Mandel strain (m,) of a point, see `pcontact.material.elastic`."""
    cells, grad, ring = points.cells, points.grad, points.ring
    d = nodal.shape[1]
    strain[:] = 0.0
    for a in range(cells.shape[1]):
        node = cells[c, a]
        x, y = grad[c, q, a, 0], grad[c, q, a, 1]
        u, v = nodal[node, 0], nodal[node, 1]
        strain[0] += u * x
        strain[1] += v * y
        strain[3] += HALF * (u * y + v * x)
        if d == 3:
            z, w = grad[c, q, a, 2], nodal[node, 2]
            strain[2] += w * z
            strain[4] += HALF * (v * z + w * y)
            strain[5] += HALF * (u * z + w * x)
        elif ring.shape[0] > 0:
            strain[2] += u * ring[c, q, a]


@njit_inline
def fill_operator(points, c, q, out):
    """Strain operator (m, nn, d) of a point: strain = sum over the nodes of out[:, a, :] u_a."""
    grad, ring = points.grad, points.ring
    nn, d = grad.shape[2], grad.shape[3]
    out[:] = 0.0
    for a in range(nn):
        x, y = grad[c, q, a, 0], grad[c, q, a, 1]
        out[0, a, 0] = x
        out[1, a, 1] = y
        out[3, a, 0] = HALF * y
        out[3, a, 1] = HALF * x
        if d == 3:
            z = grad[c, q, a, 2]
            out[2, a, 2] = z
            out[4, a, 1] = HALF * z
            out[4, a, 2] = HALF * y
            out[5, a, 0] = HALF * z
            out[5, a, 2] = HALF * x
        elif ring.shape[0] > 0:
            out[2, a, 0] = ring[c, q, a]


@njit
def write_strains(points, nodal, out):
    """Write the strains of all points of the cells into ``out`` (n, m)."""
    nq = points.grad.shape[1]
    for c in range(points.cells.shape[0]):
        for q in range(nq):
            strain_at(points, nodal, c, q, out[c * nq + q])


def strains(points, nodal):
    """Mandel strains (n, m) of all points of the cells."""
    nc, nq, _, d = points.grad.shape
    out = np.empty((nc * nq, 6 if d == 3 else 4))
    write_strains(points, nodal, out)
    return out


def add_means(jxw, values, out):
    """Add the means over cells with weights (nc, nq) of Mandel stresses (n, m) of their points to ``out`` (nc, 6)."""
    mean = np.einsum("cq,cqm->cm", jxw, values.reshape(*jxw.shape, -1)) / jxw.sum(axis=1)[:, None]
    mean[:, 3:] *= HALF
    out[:, : mean.shape[1]] += mean


@njit
def add_forces(points, jxw, stress, active, absolute, out):
    """Add the nodal forces of stresses (n, m) to ``out`` (n, d) [force], or the sizes of their terms (``absolute``)."""
    cells, grad = points.cells, points.grad
    nq, nn, d, m = grad.shape[1], grad.shape[2], grad.shape[3], stress.shape[1]
    operator = np.zeros((m, nn, d))
    for c in range(cells.shape[0]):
        for q in range(nq):
            if active[c * nq + q] == STILL:
                continue
            own = stress[c * nq + q]
            fill_operator(points, c, q, operator)
            for a in range(nn):
                for i in range(d):
                    force = 0.0
                    for k in range(m):
                        term = operator[k, a, i] * own[k]
                        force += abs(term) if absolute else term
                    out[cells[c, a], i] += jxw[c, q] * force


@njit
def add_stiffness(points, jxw, moduli, active, blocks):
    """Add int B^T C B of the cells with points that flow to block rows.

    Parameters
    ----------
    moduli : ndarray (k, m, m)
        C [stress], of all points (k = 1), or of each.
    active : ndarray (k,)
    blocks : pcontact.assembly.graph.BlockRows

    Returns
    -------
    cells : int
        With such points.
    missing : int
        Blocks without a place.
    """
    grad, count, missing = points.grad, 0, 0
    nq, nn, d, m = grad.shape[1], grad.shape[2], grad.shape[3], moduli.shape[1]
    operator, pulled = np.zeros((m, nn, d)), np.zeros((m, nn * d))
    flat, stiffness = operator.reshape(m, nn * d), np.zeros((nn * d, nn * d))
    for c in range(grad.shape[0]):
        touched = False
        for q in range(nq):
            k = c * nq + q if len(moduli) > 1 else 0
            if active[k] != FLOWS:
                continue
            if not touched:
                stiffness[:] = 0.0
                touched = True
            fill_operator(points, c, q, operator)
            pull(moduli[k], flat, jxw[c, q], pulled)
            square(flat, pulled, stiffness)
        if touched:
            count += 1
            missing += scatter(stiffness, points.cells, c, blocks)
    return count, missing


@njit_inner
def pull(tangent, operator, weight, out):
    """out = weight C B, with B and the result as (m, nn d)."""
    m, n = operator.shape
    out[:] = 0.0
    for k in range(m):
        for other in range(m):
            factor = weight * tangent[k, other]
            if factor != 0.0:
                for j in range(n):
                    out[k, j] += factor * operator[other, j]


@njit_inner
def square(operator, pulled, out):
    """Add B^T (C B) to ``out`` (nn d, nn d)."""
    m, n = operator.shape
    for i in range(n):
        for k in range(m):
            factor = operator[k, i]
            # half of the strain operator is zero
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * pulled[k, j]


@njit_inner
def scatter(stiffness, cells, c, blocks):
    """Add the matrix (nn d, nn d) of cell ``c`` to block rows; returns how many blocks had no place."""
    rowptr, columns, out = blocks.rowptr, blocks.columns, blocks.values
    nn, d, missing = cells.shape[1], out.shape[1], 0
    for a in range(nn):
        row = cells[c, a]
        for b in range(nn):
            k = find(columns, rowptr[row], rowptr[row + 1], cells[c, b])
            if k < 0:
                missing += 1
                continue
            for i in range(d):
                for j in range(d):
                    out[k, i, j] += stiffness[a * d + i, b * d + j]
    return missing
