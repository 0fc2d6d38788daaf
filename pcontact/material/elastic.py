"""Isotropic linear elasticity: constants and the stress of a displacement gradient."""

import numpy as np

from pcontact.runtime.jit import njit


def lame(young, poisson):
    """Lame constants [stress] from Young's modulus [stress] and Poisson's ratio.

    Returns
    -------
    lam, mu : float
    """
    mu = young / (2.0 * (1.0 + poisson))
    lam = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    return lam, mu


def in_plane(lam, mu, kinematics):
    """Lame constants that give the stress in the plane of the mesh from the strain in it.

    In plane stress  eps_33 = -lam / (lam + 2 mu) (eps_11 + eps_22),  hence lam* = 2 lam mu / (lam + 2 mu); all other
    kinematics keep the constants.
    """
    return (2.0 * lam * mu / (lam + 2.0 * mu), mu) if kinematics == "plane_stress" else (lam, mu)


@njit
def mean_stress(grad, jxw, nodal, cells, lam, mu, out, volume):
    """Volume average of the stress of each cell, plane strain in 2D.

    Parameters
    ----------
    grad : ndarray (nc, nq, nn, d)
        Physical shape gradients [1/length].
    jxw : ndarray (nc, nq)
    nodal : ndarray (n, d)
        Displacement of local nodes [length].
    cells : ndarray (nc, nn)
    lam, mu : float
    out : ndarray (nc, 6)
        XX, YY, ZZ, XY, YZ, XZ [stress].
    volume : ndarray (nc,)
        Volume (area in 2D) of each cell.
    """
    d = grad.shape[3]
    h = np.zeros((3, 3))
    for c in range(cells.shape[0]):
        out[c, :] = 0.0
        volume[c] = 0.0
        for q in range(grad.shape[1]):
            h[:, :] = 0.0
            for a in range(cells.shape[1]):
                for i in range(d):
                    for j in range(d):
                        h[i, j] += nodal[cells[c, a], i] * grad[c, q, a, j]
            w = jxw[c, q]
            trace = lam * (h[0, 0] + h[1, 1] + h[2, 2])
            volume[c] += w
            out[c, 0] += w * (trace + 2.0 * mu * h[0, 0])
            out[c, 1] += w * (trace + 2.0 * mu * h[1, 1])
            out[c, 2] += w * (trace + 2.0 * mu * h[2, 2])
            out[c, 3] += w * mu * (h[0, 1] + h[1, 0])
            out[c, 4] += w * mu * (h[1, 2] + h[2, 1])
            out[c, 5] += w * mu * (h[0, 2] + h[2, 0])
        for k in range(6):
            out[c, k] /= volume[c]


def equivalent_stress(stress):
    """Von Mises stress (n,) of stresses (n, 6), order XX, YY, ZZ, XY, YZ, XZ [stress]."""
    s = np.asarray(stress)
    normal = (s[:, 0] - s[:, 1]) ** 2 + (s[:, 1] - s[:, 2]) ** 2 + (s[:, 2] - s[:, 0]) ** 2
    return np.sqrt(0.5 * normal + 3.0 * (s[:, 3:] ** 2).sum(axis=1))
