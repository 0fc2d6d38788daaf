"""Compiled kernel that says how far bodies with small strain are from what small strain represents, a point per cell.

With the displacement gradient H at the centre of a cell, small strain e = sym H and the rotation w, the axial vector of
skew H, the strain that leaves rigid motions out is

    e + 1/2 (|w|^2 I - w w) + O(e^2)

What small strain leaves out of it does the work  1/2 s : (|w|^2 I - w w)  with the stress s, and beyond  s : O(e^2),
which is |e| / 2 times the work  s : e  or less.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit

# sums of `add_distortion`, one after the other
VOLUME, WORK, STRAIN, TURN, TURN_WORK, STIFFENING = range(6)
SUMS = 6
ROOT = np.sqrt(2.0)


class Centres(NamedTuple):
    """Cells of a block with what takes nodes to their centres.

    Attributes
    ----------
    places : ndarray (n, d)
        Of the nodes of the geometry [length].
    table : ndarray (nc, ng)
        Nodes of the geometry.
    cells : ndarray (nc, nn)
        Nodes of the displacement.
    geo, dgeo : ndarray (ng,), (ng, d)
        Shape functions of the geometry at the centre, and their reference gradients.
    shape, dshape : ndarray (nn,), (nn, d)
        The same of the displacement.
    weight : float
        Volume of the reference cell.
    ring : bool
        Whether x is the radius of an axisymmetric body.
    """

    places: np.ndarray
    table: np.ndarray
    cells: np.ndarray
    geo: np.ndarray
    dgeo: np.ndarray
    shape: np.ndarray
    dshape: np.ndarray
    weight: float
    ring: bool


class Stiffness(NamedTuple):
    """What says how much work the strain of a cell stands for.

    Attributes
    ----------
    lam, mu : float
        Lame constants [stress].
    limit : float
        Size of the strain beyond which stresses do not grow; infinite where nothing yields.
    rest : ndarray (k, 6, 6)
        What an orthotropic stiffness differs by, in Mandel components [stress]: of all cells (k = 1), or of each of
        them; k = 0 of an isotropic one.
    """

    lam: float
    mu: float
    limit: float
    rest: np.ndarray


@njit
def add_distortion(centres, nodal, stiffness, held, sums, largest):
    """Add what the cells of a block say of small strain to ``sums``.

    Parameters
    ----------
    centres : Centres
    nodal : ndarray (n, d)
        Displacement [length].
    stiffness : Stiffness
    held : ndarray (nc,) of bool
        Whether a support holds the body of a cell: what stiffens others lets them go elsewhere.
    sums : ndarray (6,)
        Integrals of 1, of the work density W = s : e, of W |e|, |w|^2, W |w|^2, and of
        1/2 s : (|w|^2 I - w w) where held.
    largest : ndarray (2,)
        Overwritten: largest of the errors |e| / 2 and |w|^2 / 2 of a cell, and its number; -1, -1 without cells.
    """
    places, table, cells, dgeo, dshape = centres.places, centres.table, centres.cells, centres.dgeo, centres.dshape
    lam, mu, limit = stiffness.lam, stiffness.mu, stiffness.limit
    d, rest = nodal.shape[1], stiffness.rest
    strain, stress = np.zeros(6), np.zeros(6)
    jacobian, inverse, reference, h = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    largest[:] = -1.0
    for c in range(cells.shape[0]):
        jacobian[:, :] = 0.0
        reference[:, :] = 0.0
        h[:, :] = 0.0
        jacobian[2, 2] = 1.0 if d == 2 else 0.0
        radius, across = 0.0, 0.0
        for a in range(table.shape[1]):
            node = table[c, a]
            radius += centres.geo[a] * places[node, 0]
            for i in range(d):
                for j in range(d):
                    jacobian[i, j] += places[node, i] * dgeo[a, j]
        for a in range(cells.shape[1]):
            node = cells[c, a]
            across += centres.shape[a] * nodal[node, 0]
            for i in range(d):
                for j in range(d):
                    reference[i, j] += nodal[node, i] * dshape[a, j]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                p, q = (j + 1) % 3, (j + 2) % 3
                inverse[j, i] = jacobian[k, p] * jacobian[m, q] - jacobian[k, q] * jacobian[m, p]
        det = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
        scale = 1.0 / det
        for i in range(d):
            for j in range(d):
                for k in range(d):
                    h[i, j] += reference[i, k] * inverse[k, j] * scale
        volume = centres.weight * det
        if centres.ring:
            h[2, 2] = across / radius
            volume *= 2.0 * np.pi * radius
        yz, xz, xy = 0.5 * (h[1, 2] + h[2, 1]), 0.5 * (h[0, 2] + h[2, 0]), 0.5 * (h[0, 1] + h[1, 0])
        wx, wy, wz = 0.5 * (h[2, 1] - h[1, 2]), 0.5 * (h[0, 2] - h[2, 0]), 0.5 * (h[1, 0] - h[0, 1])
        xx, yy, zz = h[0, 0], h[1, 1], h[2, 2]
        trace = xx + yy + zz
        square = xx * xx + yy * yy + zz * zz + 2.0 * (yz * yz + xz * xz + xy * xy)
        size, turn = np.sqrt(square), wx * wx + wy * wy + wz * wz
        part = volume if size <= limit else volume * limit / size
        work = part * (2.0 * mu * square + lam * trace * trace)
        if len(rest) > 0:
            strain[0], strain[1], strain[2] = xx, yy, zz
            strain[3], strain[4], strain[5] = ROOT * xy, ROOT * yz, ROOT * xz
            for i in range(6):
                stress[i] = 0.0
                for j in range(6):
                    stress[i] += rest[c if len(rest) > 1 else 0, i, j] * strain[j]
                work += part * stress[i] * strain[i]
        sums[VOLUME] += volume
        sums[WORK] += work
        sums[STRAIN] += work * size
        sums[TURN] += volume * turn
        sums[TURN_WORK] += work * turn
        if held[c]:
            # the stress across the plane of a rotation, if it has one, cancels
            along = xx * wx * wx + yy * wy * wy + zz * wz * wz + 2.0 * (yz * wy * wz + xz * wx * wz + xy * wx * wy)
            sums[STIFFENING] += part * ((lam + mu) * turn * trace - mu * along)
            if len(rest) > 0:
                across = stress[3] * wx * wy + stress[4] * wy * wz + stress[5] * wx * wz
                along = stress[0] * wx * wx + stress[1] * wy * wy + stress[2] * wz * wz + ROOT * across
                sums[STIFFENING] += 0.5 * part * (turn * (stress[0] + stress[1] + stress[2]) - along)
        error = 0.5 * max(size, turn)
        if error > largest[0]:
            largest[0], largest[1] = error, c
