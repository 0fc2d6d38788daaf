"""Mandel components of strain and stress: linear elasticity, and the axes in which plane stress falls apart.

A shear component is sqrt(2) times that of the tensor, for strain as for stress, so inner products and norms are the
plain ones. Order XX, YY, ZZ, XY, YZ, XZ in 3D (m = 6), and 11, 22, 33, 12 in 2D (m = 4), where 33 is across the plane:
its strain is 0 in plane strain, the hoop strain with axial symmetry, and is not read in plane stress, where the stress
33 is 0.
"""

import numpy as np

from pcontact.runtime.jit import njit_inline, njit_inner_exact

HALF = np.sqrt(0.5)


@njit_inline
def moduli_of(constants, plane_stress):
    """lam (in plane stress that of the plane), 2 mu, 2/3 Hk of a material's constants (lam, mu, Hk) [stress].

    A tuple, because each array that is handed from kernel to kernel costs as much as the arithmetic of a component.
    """
    lam, shear = constants[0], 2.0 * constants[1]
    if plane_stress:
        lam = lam * shear / (lam + shear)
    return lam, shear, 2.0 / 3.0 * constants[2]


@njit_inner_exact
def elastic_stress(constants, plane_stress, strain, stress):
    """C_e : eps into ``stress`` (m,), to which the excess is to be added."""
    lam, shear, _ = moduli_of(constants, plane_stress)
    normal = 2 if plane_stress else 3
    trace = strain[0] + strain[1] + (0.0 if plane_stress else strain[2])
    for i in range(strain.shape[0]):
        stress[i] = shear * strain[i]
    for i in range(normal):
        stress[i] += lam * trace
    if plane_stress:
        stress[2] = 0.0


@njit_inner_exact
def add_elastic_tangent(constants, plane_stress, tangent):
    """Add C_e to ``tangent`` (m, m)."""
    lam, shear, _ = moduli_of(constants, plane_stress)
    normal = 2 if plane_stress else 3
    for i in range(normal):
        tangent[i, i] += shear
        for j in range(normal):
            tangent[i, j] += lam
    for i in range(3, tangent.shape[0]):
        tangent[i, i] += shear


@njit_inner_exact
def to_axes(v):
    """From components (a, b, 0, c) to (11, 22, 33, 12), in place."""
    a, b = v[0], v[1]
    v[0], v[1] = HALF * (a + b), HALF * (a - b)


@njit_inner_exact
def add_diagonal(a, b, out):
    """Add to ``out`` (4, 4) what is diag(a, b, 0, b) in the components (a, b, 0, c)."""
    out[0, 0] += 0.5 * (a + b)
    out[1, 1] += 0.5 * (a + b)
    out[0, 1] += 0.5 * (a - b)
    out[1, 0] += 0.5 * (a - b)
    out[3, 3] += b
