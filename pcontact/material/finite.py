"""Finite strain at a point: stress, consistent tangent and new state, from the displacement gradient.

Stress T belongs to the logarithmic strain E (`pcontact.material.log_strain`), S = T : dE/dG to Green's strain G:

    S = dE/dG : T,    A = dS/dG = dE/dG : dT/dE : dE/dG + T : d2E/dG2,    first Piola-Kirchhoff stress  P = F S

T is the Kirchhoff stress turned back. Two kinds of law say what it is along the principal axes of the strain:

* **Hencky and von Mises:** the law of small strain, at the logarithmic strain: T = C_e : (E - E_p), and the return
  mapping of `pcontact.material.plastic` as it is. With the additive split E is that of F and E_p the state. With the
  multiplicative one the state is E_p = ln U_p, of trace 0, where F = F_e U_p up to a rotation: the law is asked at the
  strain of F exp(-E_p), from plastic strain 0, and what it returns is the increment. S and A then belong to
  Fb = F Ui, Ui = exp(-E_p), and gradients Gb_a = Ui G_a; P = Fb S Ui.
* **rubber:** W = sum_p mu_p / alpha_p (l1^alpha_p + l2^alpha_p + l3^alpha_p - 3) + K/4 (J^2 - 1 - 2 ln J), with the
  principal stretches l of J^(-1/3) F (Ogden). Neo-Hooke is (mu, 2), Mooney-Rivlin (2 c10, 2), (-2 c01, -2). Its moduli
  in small strain are K and mu = 1/2 sum_p mu_p alpha_p. With logarithmic strains e_i and their deviator,

      t_i = dev_i sum_p mu_p exp(alpha_p dev e_i),    (t_i - t_j) / (e_i - e_j) without a difference of equal numbers

Hencky's law of small strains in space where nothing yields or has other axes asks for no axes: with M = 2 mu E + p I,
p = lambda tr E and what the cell adds, and S_x, w of `pcontact.material.log_strain`,

    S = C^-1 M,    A dG = lambda C^-1 (C^-1 : dG) + mu sum w (B dG S_x + S_x dG B) - (C^-1 dG S + S dG C^-1),
    B = C^-1 S_x

The volumetric part of the stress is that of a modulus at the point, ``own``, and a pressure that the cell adds: with a
mean dilatation (`pcontact.element.dilatation`) it is that of the projection of ln J.

Components are those of `pcontact.material.elastic`. J <= 0 is said, not computed with.
"""

from typing import NamedTuple

import numpy as np

from pcontact.material.elastic import PAIRS, add_elastic_tangent, elastic_stress, indices, lame
from pcontact.material.hardening import curve_of
from pcontact.material.log_strain import (
    ROOT,
    add_curvature,
    axes_operator,
    compose,
    eigenpairs,
    fill_product,
    log_difference,
    slopes,
    small_log,
    twice_green,
    volume_change,
)
from pcontact.material.plastic import VonMises, plastic_constants, return_map, thickness_strain
from pcontact.runtime.jit import njit_inline, njit_inner_exact, njit_within, njit_within_exact

# what is asked of a point: the stress alone, with the consistent tangent, with the elastic one
STRESS, CONSISTENT, ELASTIC = 0, 1, 2


class FiniteMaterial(NamedTuple):
    """A material for finite strain.

    Attributes
    ----------
    small : pcontact.material.plastic.VonMises
        The law of small strain; the curve has the length 0 for what does not yield.
    terms : ndarray (n, 2)
        mu_p [stress] and alpha_p of rubber; of length 0 for Hencky's law.
    multiplicative : bool
        Split of elastic and plastic strain.
    own, shared : float
        Volumetric modulus at the point, and of the mean dilatation [stress].
    """

    small: VonMises
    terms: np.ndarray
    multiplicative: bool
    own: float
    shared: float

    @classmethod
    def of(cls, material, kinematics):
        """That of a material of a scene; its volumetric moduli are those of cells, and not known yet."""
        constants = plastic_constants(*lame(material.E, material.nu), material.kinematic_hardening)
        small = VonMises(constants, curve_of(material), kinematics == "plane_stress")
        terms = np.array(material.terms, dtype=np.float64).reshape(-1, 2)
        return cls(small, terms, material.multiplicative, 0.0, 0.0)

    @property
    def yields(self):
        """Return whether it may yield."""
        return len(self.small.curve) > 0

    @staticmethod
    def flow(state):
        """Equivalent plastic strain of states (..., m + 1), a view."""
        return state[..., -1]


class PointWork(NamedTuple):
    """Results at a point, then what is of use on the way.

    Attributes
    ----------
    stress : ndarray (m,)
        S [stress].
    tangent : ndarray (m, m)
        A [stress], symmetric.
    unplastic : ndarray (3, 3)
        Ui; written only where :func:`stress_at` says so.
    new : ndarray (m,)
        Along the axes: the plastic strain, with the multiplicative split its increment.
    values, vectors, axes : ndarray (3,), (3, 3), (m, m)
        Eigenpairs of 2 G, and the operator of its axes.
    kirchhoff, strain : ndarray (m,)
        T and E along the axes.
    """

    stress: np.ndarray
    tangent: np.ndarray
    unplastic: np.ndarray
    new: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    axes: np.ndarray
    kirchhoff: np.ndarray
    strain: np.ndarray
    slope: np.ndarray
    plastic: np.ndarray
    moduli: np.ndarray
    part: np.ndarray
    twice: np.ndarray
    tensor: np.ndarray
    other: np.ndarray
    row: np.ndarray


def point_work(m):
    """A :class:`PointWork` for m components."""
    shapes = [(m,), (m, m), (3, 3), (m,), (3,), (3, 3), (m, m), (m,), (m,), (m,), (m,), (m, m), (m, m), (3, 3), (3, 3),
              (3, 3), (3,)]  # fmt: skip
    return PointWork(*(np.zeros(shape) for shape in shapes))


@njit_inner_exact
def to_tensor(v, out):
    """Tensor (3, 3) of Mandel components (m,)."""
    half = np.sqrt(0.5)
    out[0, 0], out[1, 1], out[2, 2] = v[0], v[1], v[2]
    out[0, 1] = half * v[3]
    out[1, 0] = out[0, 1]
    yz, xz = (half * v[4], half * v[5]) if v.shape[0] == 6 else (0.0, 0.0)
    out[1, 2] = yz
    out[2, 1] = yz
    out[0, 2] = xz
    out[2, 0] = xz


@njit_inner_exact
def from_tensor(a, out):
    """Mandel components (m,) of a symmetric (3, 3)."""
    root = np.sqrt(2.0)
    out[0], out[1], out[2], out[3] = a[0, 0], a[1, 1], a[2, 2], root * a[0, 1]
    if out.shape[0] == 6:
        out[4], out[5] = root * a[1, 2], root * a[0, 2]


@njit_inner_exact
def _conjugate(b, a, out):
    """out = b a b for symmetric b and a (3, 3)."""
    for i in range(3):
        x = b[i, 0] * a[0, 0] + b[i, 1] * a[1, 0] + b[i, 2] * a[2, 0]
        y = b[i, 0] * a[0, 1] + b[i, 1] * a[1, 1] + b[i, 2] * a[2, 1]
        z = b[i, 0] * a[0, 2] + b[i, 1] * a[1, 2] + b[i, 2] * a[2, 2]
        for j in range(i, 3):
            value = x * b[0, j] + y * b[1, j] + z * b[2, j]
            out[i, j] = value
            out[j, i] = value


@njit_inner_exact
def _take_plastic(m, plastic_strain, work):
    """Ui = exp(-E_p), and  Ui 2G Ui + expm1(-2 E_p)  in the place of 2 G."""
    to_tensor(plastic_strain, work.tensor)
    eigenpairs(work.tensor, m, work.values, work.vectors)
    for i in range(3):
        work.row[i] = np.expm1(-work.values[i])
    compose(work.row, work.vectors, work.unplastic)
    for i in range(3):
        work.row[i] = work.row[i] * (2.0 + work.row[i])
        work.unplastic[i, i] += 1.0
    compose(work.row, work.vectors, work.tensor)
    _conjugate(work.unplastic, work.twice, work.other)
    for i in range(3):
        for j in range(3):
            work.twice[i, j] = work.other[i, j] + work.tensor[i, j]


@njit_inline
def pressure_of(material, modulus, log_volume):
    """Mean of T at the logarithm of the volume ratio for a volumetric modulus [stress]."""
    if len(material.terms) > 0:
        return 0.5 * modulus * np.expm1(2.0 * log_volume)
    return modulus * log_volume


@njit_inline
def pressure_slope(material, modulus, log_volume):
    """Its derivative [stress]."""
    if len(material.terms) > 0:
        return modulus * np.exp(2.0 * log_volume)
    return modulus


@njit_inner_exact
def _rubber(terms, strain, mode, stress, moduli):
    """Isochoric T and dT/dE along the axes; both are overwritten, the other components of dT/dE are zero."""
    m = stress.shape[0]
    mean = (strain[0] + strain[1] + strain[2]) / 3.0
    stress[:] = 0.0
    for n in range(len(terms)):
        mu, alpha = terms[n, 0], terms[n, 1]
        x = np.expm1(alpha * (strain[0] - mean))
        y = np.expm1(alpha * (strain[1] - mean))
        z = np.expm1(alpha * (strain[2] - mean))
        middle = (x + y + z) / 3.0
        stress[0] += mu * (x - middle)
        stress[1] += mu * (y - middle)
        stress[2] += mu * (z - middle)
        if mode == STRESS:
            continue
        factor, powers = mu * alpha, (1.0 + x, 1.0 + y, 1.0 + z)
        for i in range(3):
            for j in range(3):
                moduli[i, j] += factor * ((1.0 + middle) - powers[i] - powers[j]) / 3.0
            moduli[i, i] += factor * powers[i]
        for k in range(3, m):
            i, j = indices(k)
            half = 0.5 * alpha * (strain[i] - strain[j])
            # sinh(x) / x, by its series where x is small
            square = half * half
            ratio = 1.0 + square / 6.0 * (1.0 + square / 20.0 * (1.0 + square / 42.0 * (1.0 + square / 72.0)))
            if square > 0.01:
                ratio = np.sinh(half) / half
            moduli[k, k] += factor * ratio * np.exp(0.5 * alpha * (strain[i] + strain[j] - 2.0 * mean))


@njit_inner_exact
def _hencky(material, p, mode, work):
    """Isochoric T and dT/dE along the axes of the law of small strain, and the new state; p and whether it yields."""
    strain, stress, moduli, yields = work.strain, work.kirchhoff, work.moduli, False
    constants, m = material.small.constants, work.stress.shape[0]
    work.slope[:] = 0.0
    work.new[:] = 0.0
    if len(material.small.curve) > 0:
        if mode != STRESS:
            work.part[:, :] = 0.0
        p, yields = return_map(
            material.small, strain, work.plastic, p, mode == CONSISTENT, work.new, work.slope, work.part
        )
        if yields and mode == CONSISTENT:
            for i in range(m):
                for j in range(m):
                    moduli[i, j] += work.part[i, j]
    if material.small.plane_stress:
        elastic_stress(constants, True, strain, stress)
        if mode != STRESS:
            add_elastic_tangent(constants, True, moduli)
    else:
        for i in range(m):
            stress[i] = 2.0 * constants[1] * strain[i]
            if mode != STRESS:
                moduli[i, i] += 2.0 * constants[1]
    for i in range(m):
        stress[i] += work.slope[i]
    return p, yields


# number of the component that has two indices
NUMBER = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])


@njit_within
def _hencky_small(material, p, pressure, mode, work):
    """:func:`stress_at` for a small 2 G in ``work.twice``, in space and without flow; False where it is not that."""
    rows, products, strain = work.moduli, work.part, work.strain
    if not small_log(work.twice, mode != STRESS, rows, products):
        return False
    logs, inverse, own, s = rows[0], rows[1], rows[2], rows[3]
    for k in range(6):
        strain[k] = logs[k] if k < 3 else ROOT * logs[k]
        work.plastic[k] = 0.0
        work.new[k] = 0.0
    if len(material.small.curve) > 0:
        if return_map(material.small, strain, work.plastic, p, False, work.new, work.slope, work.tangent)[1]:
            return False
    mu, lam, trace = material.small.constants[1], material.own, logs[0] + logs[1] + logs[2]
    for k in range(6):
        own[k] = 2.0 * mu * logs[k] + (lam * trace + pressure if k < 3 else 0.0)
    fill_product(inverse, own, s)
    for k in range(6):
        work.stress[k] = s[k] if k < 3 else ROOT * s[k]
    if mode == STRESS:
        return True
    for i in range(6):
        for j in range(i, 6):
            products[i, j] = mu * products[i, j] - inverse[i] * s[j] - s[i] * inverse[j]
            products[j, i] = products[i, j]
    for k in range(6):
        i, j = PAIRS[k, 0], PAIRS[k, 1]
        for n in range(k, 6):
            r, t = PAIRS[n, 0], PAIRS[n, 1]
            value = 0.5 * (products[NUMBER[i, r], NUMBER[j, t]] + products[NUMBER[i, t], NUMBER[j, r]])
            value += lam * inverse[k] * inverse[n]
            value *= (1.0 if k < 3 else ROOT) * (1.0 if n < 3 else ROOT)
            work.tangent[k, n] = value
            work.tangent[n, k] = value
    return True


@njit_within_exact
def stress_at(material, h, plastic_strain, p, pressure, mode, work):
    """Stress at a point, with its tangent, and the state that goes with it.

    Parameters
    ----------
    material : FiniteMaterial
    h : ndarray (3, 3)
        Displacement gradient.
    plastic_strain : ndarray (m,)
        At the last committed state: E_p.
    p : float
        Equivalent plastic strain there.
    pressure : float
        Mean stress that the mean dilatation of the cell adds to T [stress].
    mode : int
        STRESS, CONSISTENT or ELASTIC.
    work : PointWork
        ``stress`` and, unless STRESS, ``tangent`` are written.

    Returns
    -------
    good : bool
        False where J <= 0 or something is not finite: nothing else means anything then.
    plastic : bool
        Whether ``work.unplastic`` has been written; Ui is the identity where not.
    p : float
        New equivalent plastic strain.
    yields : bool
    """
    m, stress, moduli = work.stress.shape[0], work.kirchhoff, work.moduli
    if not volume_change(h) > -1.0:
        return False, False, p, False
    twice_green(h, work.twice)
    plastic = material.multiplicative and p > 0.0
    if plastic:
        _take_plastic(m, plastic_strain, work)
    if m == 6 and len(material.terms) == 0 and (plastic or p == 0.0):
        if _hencky_small(material, p, pressure, mode, work):
            return True, plastic, p, False
    eigenpairs(work.twice, m, work.values, work.vectors)
    values = work.values
    if not (values[0] > -1.0 and values[1] > -1.0 and values[2] > -1.0 and values[0] + values[1] + values[2] < np.inf):
        return False, plastic, p, False
    axes_operator(work.vectors, work.axes)
    work.strain[:] = 0.0
    for i in range(3):
        work.strain[i] = 0.5 * np.log1p(values[i])
    if mode != STRESS:
        moduli[:, :] = 0.0
    yields, crossed = False, len(material.small.curve) > 0 and not material.multiplicative and p > 0.0
    if len(material.terms) > 0:
        _rubber(material.terms, work.strain, mode, stress, moduli)
    else:
        work.plastic[:] = 0.0
        if not material.multiplicative and p > 0.0:
            for k in range(m):
                for n in range(m):
                    work.plastic[k] += work.axes[k, n] * plastic_strain[n]
        p, yields = _hencky(material, p, mode, work)
    if not material.small.plane_stress:
        log_volume = work.strain[0] + work.strain[1] + work.strain[2]
        pressure += pressure_of(material, material.own, log_volume)
        slope = pressure_slope(material, material.own, log_volume)
        for i in range(3):
            stress[i] += pressure
            if mode != STRESS:
                for j in range(3):
                    moduli[i, j] += slope
    # strain that has flowed before along other axes leaves shear stresses along these
    if crossed or (mode == ELASTIC and yields):
        _to_green(mode, work)
    else:
        _to_green_along(mode, work)
    return True, plastic, p, yields


@njit_inner_exact
def _turn_tangent(m, axes, part, work):
    """Write axes^T part, the tangent in the axes of the mesh, which is symmetric."""
    for i in range(m):
        for n in range(i, m):
            value = 0.0
            for k in range(m):
                value += axes[k, i] * part[k, n]
            work.tangent[i, n] = value
            work.tangent[n, i] = value


@njit_inner_exact
def _to_green_along(mode, work):
    """:func:`_to_green` of a stress that has the axes of the strain whatever the strain is, and its derivative.

    S_i = t_i / c_i along the axes, and, since the law is isotropic,

        dS_i/dG_j = dt_i/de_j / (c_i c_j) - 2 t_i / c_i^2 (i = j),
        (S_i - S_j) / (G_i - G_j) = dt_ij/de_ij f_ij (1 / c_i + 1 / c_j) / 2 - (t_i + t_j) / (c_i c_j)

    where no second divided difference of the logarithm is left.
    """
    m, axes, moduli, part, stress = work.stress.shape[0], work.axes, work.moduli, work.part, work.kirchhoff
    x, y, z = 1.0 / (1.0 + work.values[0]), 1.0 / (1.0 + work.values[1]), 1.0 / (1.0 + work.values[2])
    for n in range(m):
        work.stress[n] = axes[0, n] * (x * stress[0]) + axes[1, n] * (y * stress[1]) + axes[2, n] * (z * stress[2])
    if mode == STRESS:
        return
    work.row[0], work.row[1], work.row[2] = x, y, z
    for i in range(3):
        for j in range(3):
            moduli[i, j] *= work.row[i] * work.row[j]
        moduli[i, i] -= 2.0 * stress[i] * work.row[i] ** 2
        for n in range(m):
            part[i, n] = moduli[i, 0] * axes[0, n] + moduli[i, 1] * axes[1, n] + moduli[i, 2] * axes[2, n]
    for k in range(3, m):
        i, j = indices(k)
        factor = 0.5 * moduli[k, k] * log_difference(work.values[i], work.values[j]) * (work.row[i] + work.row[j])
        factor -= (stress[i] + stress[j]) * work.row[i] * work.row[j]
        for n in range(m):
            part[k, n] = factor * axes[k, n]
    _turn_tangent(m, axes, part, work)


@njit_inner_exact
def _to_green(mode, work):
    """From T and dT/dE along the axes to S and A in the axes of the mesh."""
    m, f, axes, moduli, part = work.stress.shape[0], work.slope, work.axes, work.moduli, work.part
    slopes(work.values, f)
    for n in range(m):
        value = 0.0
        for k in range(m):
            value += axes[k, n] * (f[k] * work.kirchhoff[k])
        work.stress[n] = value
    if mode == STRESS:
        return
    for i in range(m):
        for j in range(m):
            moduli[i, j] *= f[i] * f[j]
    add_curvature(work.values, work.kirchhoff, moduli)
    for i in range(m):
        part[i, :] = 0.0
        for k in range(m):
            factor = moduli[i, k]
            if factor != 0.0:
                for n in range(m):
                    part[i, n] += factor * axes[k, n]
    _turn_tangent(m, axes, part, work)


@njit_inner_exact
def new_plastic_strain(material, plastic_strain, work):
    """Overwrite E_p (m,) by that after a point has yielded; ``work`` is that of :func:`stress_at`."""
    m = plastic_strain.shape[0]
    if not material.multiplicative:
        for n in range(m):
            value = 0.0
            for k in range(m):
                value += work.axes[k, n] * work.new[k]
            plastic_strain[n] = value
        plastic_strain[2] = -(plastic_strain[0] + plastic_strain[1])
        return
    # 2 G_p = expm1(2 E_p) + exp(E_p) expm1(2 dE_p) exp(E_p)
    for i in range(3):
        work.row[i] = np.expm1(2.0 * work.new[i])
    compose(work.row, work.vectors, work.twice)
    to_tensor(plastic_strain, work.tensor)
    eigenpairs(work.tensor, m, work.values, work.vectors)
    for i in range(3):
        work.row[i] = np.exp(work.values[i])
    compose(work.row, work.vectors, work.tensor)
    _conjugate(work.tensor, work.twice, work.other)
    for i in range(3):
        work.row[i] = np.expm1(2.0 * work.values[i])
    compose(work.row, work.vectors, work.twice)
    for i in range(3):
        for j in range(3):
            work.twice[i, j] += work.other[i, j]
    eigenpairs(work.twice, m, work.values, work.vectors)
    mean = 0.0
    for i in range(3):
        work.row[i] = 0.5 * np.log1p(work.values[i])
        mean += work.row[i] / 3.0
    for i in range(3):
        work.row[i] -= mean
    compose(work.row, work.vectors, work.tensor)
    from_tensor(work.tensor, plastic_strain)
    plastic_strain[2] = -(plastic_strain[0] + plastic_strain[1])


@njit_inner_exact
def thickness(material, plastic_strain, plastic, work):
    """Logarithmic strain 33 in plane stress, of the state that :func:`stress_at` has found."""
    if not material.multiplicative:
        return thickness_strain(material.small.constants, work.strain, work.new)
    elastic = thickness_strain(material.small.constants, work.strain, work.new)
    return elastic + (plastic_strain[2] if plastic else 0.0)
