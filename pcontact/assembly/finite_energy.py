"""Compiled kernel of what cells with finite strain store, per undeformed volume.

With the logarithmic strain e along the principal axes, e_e what of it is elastic, and the mean dilatation th of the
cell (`pcontact.assembly.finite_kernels`), at a point

* Hencky:  mu e_e : e_e + own/2 (tr e)^2 + shared/2 th^2, and (2/3 Hk)/2 E_p : E_p in what hardens kinematically; in
  plane stress 1/2 e_e : C_e : e_e of the plane, across which nothing does work;
* rubber:  sum_p mu_p / alpha_p sum_i g(alpha_p dev e_i) + own/4 g(2 tr e) + shared/4 g(2 th),  g(x) = exp(x) - 1 - x.

With g no digit of a small strain is lost: the deviators of the e_i sum to zero, and so do the parts x of the g.
"""

import numpy as np

from pcontact.assembly.finite_kernels import begin_cell
from pcontact.material.finite import STRESS, stress_at
from pcontact.material.mandel import moduli_of
from pcontact.runtime.jit import njit, njit_inner

# below this, the series of g; of the sum: what no longer changes it
CLOSE, LAST = 0.5, 1e-18


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
    material, m = state.material, work.point.stress.shape[0]
    for c in range(len(cells.nodes)):
        good = begin_cell(state, cells, nodal, c, STRESS, work)
        row = c if len(material.small.curve) > 0 else 0
        for q in range(cells.grad.shape[1]):
            stored[c, q] = np.nan
            if not good:
                continue
            own = state.values[row, q]
            fine, _, p[c, q], _ = stress_at(material, work.h[q], own[:m], own[m], 0.0, STRESS, work.point)
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
