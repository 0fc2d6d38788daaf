"""What orthotropic bodies add to the stiffness and the stress of isotropic ones: those of C_dev = C - C_iso.

See `pcontact.material.orthotropic`; the strain is that of `pcontact.assembly.plastic_kernels`.
"""

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of
from pcontact.assembly.graph import BlockRows
from pcontact.assembly.plastic_kernels import CellPoints, fill_operator, pull, scatter, square, strain_at
from pcontact.material.mandel import HALF
from pcontact.runtime.jit import njit

NO_RING = np.zeros((0, 0, 0))
# cells whose stiffness is turned at once
PART = 1024


@njit
def add_stiffness(points, jxw, moduli, blocks):
    """Add int B^T C B of cells to block rows.

    Parameters
    ----------
    points : pcontact.assembly.plastic_kernels.CellPoints
    jxw : ndarray (nc, nq)
    moduli : ndarray (k, m, m)
        C [stress], of all points (k = 1), or of each of the nc nq points.
    blocks : pcontact.assembly.graph.BlockRows

    Returns
    -------
    int
        Blocks without a place.
    """
    grad, missing = points.grad, 0
    nq, nn, d, m = grad.shape[1], grad.shape[2], grad.shape[3], moduli.shape[1]
    operator, pulled = np.zeros((m, nn, d)), np.zeros((m, nn * d))
    flat, stiffness = operator.reshape(m, nn * d), np.zeros((nn * d, nn * d))
    for c in range(grad.shape[0]):
        stiffness[:] = 0.0
        for q in range(nq):
            fill_operator(points, c, q, operator)
            pull(moduli[c * nq + q if len(moduli) > 1 else 0], flat, jxw[c, q], pulled)
            square(flat, pulled, stiffness)
        missing += scatter(stiffness, points.cells, c, blocks)
    return missing


@njit
def add_mean_stress(points, jxw, moduli, nodal, out):
    """Add the mean of the stress C : eps of cells to ``out`` (nc, 6), XX, YY, ZZ, XY, YZ, XZ [stress]; parameters as
    for :func:`add_stiffness`, and displacements (n, d)."""
    nq, m = jxw.shape[1], moduli.shape[1]
    strain = np.zeros(m)
    for c in range(jxw.shape[0]):
        volume = 0.0
        for q in range(nq):
            volume += jxw[c, q]
        for q in range(nq):
            strain_at(points, nodal, c, q, strain)
            stiffness = moduli[c * nq + q if len(moduli) > 1 else 0]
            for k in range(m):
                stress = 0.0
                for n in range(m):
                    stress += stiffness[k, n] * strain[n]
                out[c, k] += jxw[c, q] / volume * stress * (1.0 if k < 3 else HALF)


def parts(space, number, law):
    """Iterate over some cells of a block of an orthotropic body at a time.

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.
    law : pcontact.material.orthotropic.Orthotropic

    Yields
    ------
    rows : slice
    points : pcontact.assembly.plastic_kernels.CellPoints
    jxw : ndarray (nc, nq)
    x : ndarray (nc nq, d)
        The points [length]; of a uniform law the first one alone.
    """
    for rows, grad, jxw, shapes in chunks(space, number):
        ring = hoop(space, number, rows, shapes)
        for first in range(0, len(grad), PART):
            some = slice(first, min(first + PART, len(grad)))
            own = slice(rows.start + some.start, rows.start + some.stop)
            around = NO_RING if ring is None else np.ascontiguousarray(ring[some])
            x = points_of(space, number, slice(own.start, own.start + 1) if law.uniform else own)
            points = CellPoints(space.cells[number][own], grad[some], around)
            yield own, points, np.ascontiguousarray(jxw[some]), x.reshape(-1, space.dim)[: 1 if law.uniform else None]


def add_block(space, number, law, rowptr, columns, values):
    """Add the stiffness of C_dev of a block to values (nnz, d, d) on a local pattern; others as for :func:`parts`."""
    blocks = BlockRows(rowptr, columns, values)
    for _, points, jxw, x in parts(space, number, law):
        add_stiffness(points, jxw, law.deviation(x), blocks)


def add_stress(space, number, law, nodal, out):
    """Add the mean stress C_dev : eps of the cells of a block to ``out`` (nc, 6); parameters as for :func:`parts`."""
    for rows, points, jxw, x in parts(space, number, law):
        add_mean_stress(points, jxw, law.deviation(x), nodal, out[rows])
