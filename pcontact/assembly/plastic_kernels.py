"""Compiled kernels of bodies that may yield: what plasticity adds to linear elasticity, cell by cell.

Elastic forces and stiffness are integrated once. Only the excess of the stress over linear elasticity, which is zero
where nothing ever yielded, is integrated here, with its consistent tangent (`pcontact.material.plastic`). The excess is
a deviator (in plane stress it has no 33 component): a mean dilatation of the cell does not see it.

Common arguments, one row per cell c and quadrature point q:

    points : CellPoints          the points
    jxw (nc, nq)                 their weights, see `pcontact.assembly.geometry.chunks`
    state : PlasticState         the material, and the committed state of the points
    nodal (n, d)                 displacement [length]
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.material.mandel import HALF
from pcontact.material.plastic import VonMises, flows, return_map
from pcontact.runtime.jit import njit, njit_inline, njit_inner


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


class PlasticState(NamedTuple):
    """Material and internal variables of the cells of one block, or of some of them.

    Attributes
    ----------
    material : pcontact.material.plastic.VonMises
    strain : ndarray (nc, nq, m)
        Committed plastic strain at the quadrature points, Mandel components.
    p : ndarray (nc, nq)
        Committed equivalent plastic strain.
    """

    material: VonMises
    strain: np.ndarray
    p: np.ndarray

    def of(self, rows):
        """That of some cells, views for a slice."""
        return PlasticState(self.material, self.strain[rows], self.p[rows])


@njit_inline
def strain_at(points, nodal, c, q, strain):
    """Mandel strain (m,) of a point, see `pcontact.material.mandel`."""
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
def add_forces(points, jxw, state, nodal, absolute, out):
    """Add the nodal forces of the excess to ``out`` (n, d) [force], or the sizes of their terms (``absolute``)."""
    cells, grad = points.cells, points.grad
    material, plastic_strain, p = state.material, state.strain, state.p
    nq, nn, d = grad.shape[1], grad.shape[2], grad.shape[3]
    m = plastic_strain.shape[2]
    strain, excess, work, tangent = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    operator = np.zeros((m, nn, d))
    for c in range(cells.shape[0]):
        for q in range(nq):
            strain_at(points, nodal, c, q, strain)
            if p[c, q] == 0.0 and not flows(material, strain, plastic_strain[c, q], 0.0, work):
                continue
            return_map(material, strain, plastic_strain[c, q], p[c, q], False, work, excess, tangent)
            fill_operator(points, c, q, operator)
            for a in range(nn):
                for i in range(d):
                    force = 0.0
                    for k in range(m):
                        term = operator[k, a, i] * excess[k]
                        force += abs(term) if absolute else term
                    out[cells[c, a], i] += jxw[c, q] * force


@njit
def add_tangent(points, jxw, state, nodal, blocks):
    """Add the derivative of the forces to block rows; returns how many cells yield."""
    cells, grad = points.cells, points.grad
    material, plastic_strain, p = state.material, state.strain, state.p
    nq, nn, d = grad.shape[1], grad.shape[2], grad.shape[3]
    m = plastic_strain.shape[2]
    strain, excess, work, tangent = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    operator, pulled = np.zeros((m, nn, d)), np.zeros((m, nn * d))
    flat, stiffness = operator.reshape(m, nn * d), np.zeros((nn * d, nn * d))
    count = 0
    for c in range(cells.shape[0]):
        touched = False
        for q in range(nq):
            strain_at(points, nodal, c, q, strain)
            if not flows(material, strain, plastic_strain[c, q], p[c, q], work):
                continue
            _, yields = return_map(material, strain, plastic_strain[c, q], p[c, q], True, work, excess, tangent)
            if not yields:
                continue
            if not touched:
                stiffness[:] = 0.0
                touched = True
            fill_operator(points, c, q, operator)
            pull(tangent, flat, jxw[c, q], pulled)
            square(flat, pulled, stiffness)
        if touched:
            count += 1
            scatter(stiffness, cells, c, blocks)
    return count


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


@njit
def commit(points, state, nodal):
    """Let the state of all points, in place, follow the displacement."""
    material, plastic_strain, p = state.material, state.strain, state.p
    m = plastic_strain.shape[2]
    strain, excess, work, tangent = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    for c in range(p.shape[0]):
        for q in range(p.shape[1]):
            strain_at(points, nodal, c, q, strain)
            if flows(material, strain, plastic_strain[c, q], p[c, q], work):
                p[c, q], _ = return_map(
                    material, strain, plastic_strain[c, q], p[c, q], False, plastic_strain[c, q], excess, tangent
                )


@njit
def excess_at(points, state, nodal, want_tangent, excess, tangent):
    """Excess (nc, nq, m) of cells and, if wanted, its derivative (nc, nq, m, m); flags (nc,) of those that yield.

    Both are overwritten.
    """
    material, plastic_strain, p = state.material, state.strain, state.p
    nc, nq, m = excess.shape
    strain, work = np.zeros(m), np.zeros(m)
    unused = np.zeros((m, m))
    yielding = np.zeros(nc, dtype=np.bool_)
    excess[:] = 0.0
    if want_tangent:
        tangent[:] = 0.0
    for c in range(nc):
        for q in range(nq):
            strain_at(points, nodal, c, q, strain)
            if p[c, q] == 0.0 and not flows(material, strain, plastic_strain[c, q], 0.0, work):
                continue
            _, yields = return_map(
                material, strain, plastic_strain[c, q], p[c, q], want_tangent, work,
                excess[c, q], tangent[c, q] if want_tangent else unused,
            )  # fmt: skip
            yielding[c] |= yields
    return yielding
