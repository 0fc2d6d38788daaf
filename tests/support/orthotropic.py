"""Orthotropic materials: constants of wood and of a laminate, and stiffness as a tensor of four indices."""

import numpy as np

from pcontact.material.elastic import in_plane
from pcontact.material.orthotropic import Orthotropic, frame, stiffness

# spruce along fibre, radius and ring, and a unidirectional laminate [GPa]
WOOD = ([10.0, 0.8, 0.45], [0.37, 0.42, 0.47], [0.65, 0.6, 0.05])
LAMINATE = ([140.0, 10.0, 9.0], [0.3, 0.28, 0.45], [5.0, 4.5, 3.4])
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def tensor_of(moduli):
    """C_ijkl (3, 3, 3, 3) of a stiffness (6, 6) in Mandel components."""
    out = np.zeros((3, 3, 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        for n, (p, q) in enumerate(PAIRS):
            value = moduli[k, n] * (1.0 if i == j else np.sqrt(0.5)) * (1.0 if p == q else np.sqrt(0.5))
            for a, b in {(i, j), (j, i)}:
                for c, e in {(p, q), (q, p)}:
                    out[a, b, c, e] = value
    return out


def law_of(constants, axes, dim, kinematics="plane_strain", split=None, **more):
    """The law of E, nu, G with axes along two vectors; `split`: Lame constants of C_iso, not the nearest ones."""
    law = Orthotropic(stiffness(*constants), frame(*axes), dim, kinematics, **more)
    if split is not None:
        law.constants = in_plane(*split, kinematics)
        law._isotropic = np.zeros_like(law._isotropic)
        normal = 2 if kinematics == "plane_stress" else 3
        law._isotropic[:] = 2.0 * law.constants[1] * np.eye(law.size)
        law._isotropic[:normal, :normal] += law.constants[0]
        if normal == 2:
            law._isotropic[2] = law._isotropic[:, 2] = 0.0
    return law


def isotropic(young, poisson):
    """E, nu, G of an isotropic material."""
    return [young] * 3, [poisson] * 3, [0.5 * young / (1.0 + poisson)] * 3


def plane_axes(angle):
    """Axes turned in the plane [degrees]."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return [c, s, 0.0], [-s, c, 0.0]


SKEW = ([1.0, 2.0, 3.0], [0.0, 1.0, 1.0])
