"""Von Mises plasticity at one point: return mapping, consistent tangent and second derivative of the stress.

Small strains, associated flow, linear kinematic (Prager) and piecewise linear isotropic hardening, backward Euler:

    sigma = C_e : (eps - eps_p),    |dev sigma - beta| <= R(p),    d eps_p = x m,    m = (dev sigma - beta) / R

with R, x, p and beta as in :mod:`pcontact.material.hardening`.

Components are those of :mod:`pcontact.material.elastic`: m = 6 in 3D, 4 in 2D.

A material is a :class:`Plastic`; kernels need of it a :class:`VonMises`. The state of a point is its plastic strain
(m,), deviatoric, and the equivalent plastic strain p, accumulated; both begin at 0. Flow is a matter of the deviator,
which thermal strain does not change but in plane stress.

The kernels give the **excess** over linear elasticity, sigma - C_e : eps, and its derivative: elastic stiffness is
integrated once for all cells, and what is added to it has no rounding error where nothing ever yielded. In plane stress
C_e is the elasticity of plane stress, and row and column 33 are 0.

Plane stress needs no iteration on the strain across the plane. Its elasticity and the norm of the deviator have the
same eigenvectors: a = (11 + 22) / sqrt 2, b = (11 - 22) / sqrt 2 and the shear c = 12. With ``y`` the trial stress
minus back stress (back stress shifted by a multiple of the identity so that its 33 is 0), the norm of the deviator
is sqrt(y_a^2 / 3 + y_b^2 + y_c^2), and each part shrinks on its own; one scalar equation remains, see
:func:`pcontact.material.hardening.flow_length`. The idea is that of Simo and Taylor (1986); the unknown x instead of
x / R keeps the equation well behaved for any hardening.
"""

from typing import NamedTuple

import numpy as np

from pcontact.material.elastic import (
    FLOWS,
    HALF,
    LOADED,
    NOW,
    STILL,
    Elastic,
    Response,
    add_diagonal,
    lame,
    moduli_of,
    to_axes,
)
from pcontact.material.hardening import RADIUS, curve_of, flow_length, yield_radius, yield_work
from pcontact.runtime.jit import njit, njit_inline, njit_inner_exact

# A state that was brought back to the yield surface is found there again up to this many times the rounding error of
# the trial stress: it has to count as elastic, whatever the last digits are.
ROUNDING = 16.0 * 2.220446049250313e-16


class VonMises(NamedTuple):
    """A material that may yield.

    Attributes
    ----------
    constants : ndarray (3,)
        lam, mu, Hk [stress], see :func:`plastic_constants`.
    curve : ndarray (k, 3)
        Isotropic hardening, see `pcontact.material.hardening`.
    plane_stress : bool
        For m = 4 only.
    """

    constants: np.ndarray
    curve: np.ndarray
    plane_stress: bool


def plastic_constants(lam, mu, kinematic_hardening=0.0):
    """The row of numbers (3,) of a material: Lame constants and Prager's Hk, all [stress]."""
    return np.array([lam, mu, kinematic_hardening], dtype=np.float64)


@njit_inline
def _stiffness(moduli, plane_stress):
    """Rates at which parts a and b of the relative stress shrink while the point flows."""
    lam, shear, back = moduli
    return ((shear + 2.0 * lam) / 3.0 + back if plane_stress else 0.0), shear + back


@njit_inline
def _trial(moduli, plane_stress, strain, plastic_strain, y):
    """Trial stress minus back stress into ``y``; squares of its parts a and b.

    ``y`` (m,) is the deviator, or in plane stress the components (a, b, 0, c).
    """
    lam, shear, back = moduli
    square_a = square_b = 0.0
    if plane_stress:
        total, plastic = strain[0] + strain[1], plastic_strain[0] + plastic_strain[1]
        y[0] = HALF * ((shear + 2.0 * lam) * (total - plastic) - 3.0 * back * plastic)
        total, plastic = strain[0] - strain[1], plastic_strain[0] - plastic_strain[1]
        y[1] = HALF * (shear * (total - plastic) - back * plastic)
        y[2] = 0.0
        square_a, square_b = y[0] ** 2 / 3.0, y[1] ** 2
    else:
        mean = (strain[0] + strain[1] + strain[2]) / 3.0
        for i in range(3):
            y[i] = shear * (strain[i] - mean - plastic_strain[i]) - back * plastic_strain[i]
            square_b += y[i] ** 2
    for i in range(3, strain.shape[0]):
        y[i] = shear * (strain[i] - plastic_strain[i]) - back * plastic_strain[i]
        square_b += y[i] ** 2
    return square_a, square_b


@njit_inline
def _beyond_rounding(moduli, plane_stress, strain, plastic_strain, norm, radius):
    """Return True if the norm of a trial state exceeds the radius by more than rounding errors, or is NaN."""
    _, shear, back = moduli
    strain_size, plastic_size = 0.0, 0.0
    for i in range(strain.shape[0]):
        if i != 2 or not plane_stress:
            strain_size = max(strain_size, abs(strain[i]))
        plastic_size = max(plastic_size, abs(plastic_strain[i]))
    size = radius + shear * (strain_size + plastic_size) + back * plastic_size
    return not (norm - radius < ROUNDING * size)


@njit_inline
def flows(material, strain, plastic_strain, p, work):
    """Return True if a point yields at a strain; one exactly on the yield surface does not.

    Parameters as those of :func:`return_map`; ``work`` (m,) is overwritten.
    """
    plane_stress = material.plane_stress
    moduli = moduli_of(material.constants, plane_stress)
    square_a, square_b = _trial(moduli, plane_stress, strain, plastic_strain, work)
    square, radius = square_a + square_b, yield_radius(material.curve, p)
    return not square <= radius**2 and _beyond_rounding(
        moduli, plane_stress, strain, plastic_strain, np.sqrt(square), radius
    )


@njit_inner_exact
def return_map(material, strain, plastic_strain, p, want_tangent, new_plastic_strain, excess, tangent):
    """Stress in excess of linear elasticity, and the state that goes with it.

    Parameters
    ----------
    material : VonMises
    strain : ndarray (m,)
        Total strain.
    plastic_strain : ndarray (m,)
        At the last committed state.
    p : float
        Equivalent plastic strain there.
    want_tangent : bool
    new_plastic_strain : ndarray (m,)
        Overwritten; may be ``plastic_strain`` itself.
    excess : ndarray (m,)
        Overwritten: sigma - C_e : eps [stress]. Zero where the plastic strain is.
    tangent : ndarray (m, m)
        d excess / d strain [stress], symmetric. Overwritten only where the point yields and ``want_tangent``: it is
        zero elsewhere, and the caller has nothing to add.

    Returns
    -------
    p : float
        New equivalent plastic strain.
    yields : bool

    Notes
    -----
    NaN or infinity in what is given ends as NaN in ``excess`` and a ``p`` that is not finite, with ``yields`` true.
    Closed form apart from plane stress, where a scalar equation takes a few Newton steps. With
    h = 2 mu + 2/3 (Hk + slope), q the norm of the trial state and m its direction,

        excess = -2 mu eps_p,    tangent = -4 mu^2 [(1/h - x/q) m (x) m + x/q I_dev].
    """
    curve, plane_stress = material.curve, material.plane_stress
    moduli = moduli_of(material.constants, plane_stress)
    square_a, square_b = _trial(moduli, plane_stress, strain, plastic_strain, excess)
    square, radius = square_a + square_b, yield_radius(curve, p)
    if square <= radius**2 or not _beyond_rounding(
        moduli, plane_stress, strain, plastic_strain, np.sqrt(square), radius
    ):
        for i in range(strain.shape[0]):
            new_plastic_strain[i] = plastic_strain[i]
        _elastic_excess(moduli, plane_stress, new_plastic_strain, excess)
        return p, False
    stiff_a, stiff_b = _stiffness(moduli, plane_stress)
    x, radius, slope, _ = flow_length(curve, p, square_a, square_b, stiff_a, stiff_b)
    if want_tangent and plane_stress:
        _plane_tangent(moduli, excess, x, radius, slope, tangent)
    elif want_tangent:
        _tangent(moduli, excess, x, radius, slope, tangent)
    b = x / (radius + stiff_b * x)
    if plane_stress:
        a = x / (radius + stiff_a * x) / 3.0
        new_plastic_strain[0] = plastic_strain[0] + HALF * (a * excess[0] + b * excess[1])
        new_plastic_strain[1] = plastic_strain[1] + HALF * (a * excess[0] - b * excess[1])
    else:
        new_plastic_strain[0] = plastic_strain[0] + b * excess[0]
        new_plastic_strain[1] = plastic_strain[1] + b * excess[1]
    # the trace stays zero however many steps there are
    new_plastic_strain[2] = -(new_plastic_strain[0] + new_plastic_strain[1])
    for i in range(3, strain.shape[0]):
        new_plastic_strain[i] = plastic_strain[i] + b * excess[i]
    _elastic_excess(moduli, plane_stress, new_plastic_strain, excess)
    return p + RADIUS * x, True


@njit_inline
def _elastic_excess(moduli, plane_stress, plastic_strain, excess):
    """-C_e : eps_p of a deviatoric plastic strain."""
    lam, shear, _ = moduli
    for i in range(plastic_strain.shape[0]):
        excess[i] = 0.0 - shear * plastic_strain[i]
    if plane_stress:
        mean = lam * (plastic_strain[0] + plastic_strain[1])
        excess[0] -= mean
        excess[1] -= mean
        excess[2] = 0.0


@njit_inner_exact
def _tangent(moduli, y, x, radius, slope, tangent):
    """Consistent tangent of the excess, of a point which yields; ``y`` is the trial deviator."""
    _, shear, back = moduli
    stiff = shear + back
    q = radius + stiff * x
    # 1/h - x/q, without a difference of almost equal numbers
    along = -(shear**2) * (radius - slope * x) / (q * (slope + stiff)) / q**2
    across = -(shear**2) * x / q
    n = y.shape[0]
    for i in range(n):
        for j in range(n):
            tangent[i, j] = along * (y[i] * y[j])
        tangent[i, i] += across
    for i in range(3):
        for j in range(3):
            tangent[i, j] -= across / 3.0


@njit_inner_exact
def _length_gradient(moduli, y, x, radius, slope, out):
    """d x / d strain of plane stress into ``out`` (a, b, 0, c), and the sum S by which it was divided.

    From the equation of :func:`flow_length`, of which half the derivative with respect to -x is S.
    """
    mean, shear = moduli[1] + 2.0 * moduli[0], moduli[1]
    stiff_a, stiff_b = _stiffness(moduli, True)
    a, b = radius + stiff_a * x, radius + stiff_b * x
    out[0], out[1], out[2], out[3] = mean * y[0] / (3.0 * a**2), shear * y[1] / b**2, 0.0, shear * y[3] / b**2
    total = y[0] ** 2 / 3.0 / a**3 * (slope + stiff_a) + (y[1] ** 2 + y[3] ** 2) / b**3 * (slope + stiff_b)
    for i in range(4):
        out[i] /= total
    return total


@njit_inner_exact
def _plane_tangent(moduli, y, x, radius, slope, tangent):
    """Consistent tangent of the excess in plane stress; ``y`` (4,) holds (a, b, 0, c) of the trial state.

    The increment of plastic strain is w_i y_i x / D_i with w = (1/3, 1, 1) and D_i = R + stiffness_i x. Its derivative,
    multiplied by the moduli C_i, is diag(w_i C_i^2 x / D_i) + (R - slope x) S X (x) X with X = dx/d eps.
    """
    mean, shear = moduli[1] + 2.0 * moduli[0], moduli[1]
    stiff_a, stiff_b = _stiffness(moduli, True)
    gradient = tangent[2]
    total = _length_gradient(moduli, y, x, radius, slope, gradient)
    to_axes(gradient)
    factor = -(radius - slope * x) * total
    for i in (0, 1, 3):
        for j in (0, 1, 3):
            tangent[i, j] = factor * gradient[i] * gradient[j]
    for i in range(4):
        tangent[2, i] = 0.0
        tangent[i, 2] = 0.0
    a, b = radius + stiff_a * x, radius + stiff_b * x
    add_diagonal(-(mean**2) * x / (3.0 * a), -(shear**2) * x / b, tangent)


@njit_inner_exact
def second_derivative(material, strain, plastic_strain, p, weight, work, out):
    """Second derivative of ``weight . sigma`` with respect to the strain.

    Parameters
    ----------
    material, strain, plastic_strain, p
        As those of :func:`return_map`.
    weight : ndarray (m,)
        Mandel components; 33 is not read in plane stress.
    work : ndarray (2, m)
        Overwritten.
    out : ndarray (m, m)
        Overwritten where the point yields [stress * unit of the weight], symmetric; zero elsewhere, and left alone.

    Returns
    -------
    bool
        Whether the point yields.
    """
    y = work[0]
    if not flows(material, strain, plastic_strain, p, y):
        return False
    curve, plane_stress = material.curve, material.plane_stress
    moduli = moduli_of(material.constants, plane_stress)
    square_a, square_b = _trial(moduli, plane_stress, strain, plastic_strain, y)
    stiff_a, stiff_b = _stiffness(moduli, plane_stress)
    x, radius, slope, _ = flow_length(curve, p, square_a, square_b, stiff_a, stiff_b)
    if plane_stress:
        _plane_second(moduli, y, x, radius, slope, weight, work[1], out)
    else:
        _second(moduli, y, x, radius, slope, weight, work[1], out)
    return True


@njit_inner_exact
def _second(moduli, y, x, radius, slope, weight, v, out):
    """-(2 mu)^3 (R - slope x) / (h q^2) [(Pm w) (x) m + m (x) (Pm w) + (w . m) Pm], Pm = I_dev - m (x) m."""
    _, shear, back = moduli
    stiff = shear + back
    q = radius + stiff * x
    n = y.shape[0]
    dot = 0.0
    for i in range(n):
        y[i] /= q
        dot += weight[i] * y[i]
    mean = (weight[0] + weight[1] + weight[2]) / 3.0
    for i in range(n):
        v[i] = weight[i] - dot * y[i]
        if i < 3:
            v[i] -= mean
    factor = -(shear**3) * (radius - slope * x) / (slope + stiff) / q**2
    for i in range(n):
        for j in range(n):
            out[i, j] = factor * (v[i] * y[j] + y[i] * v[j] - dot * (y[i] * y[j]))
        out[i, i] += factor * dot
    for i in range(3):
        for j in range(3):
            out[i, j] -= factor * dot / 3.0


@njit_inner_exact
def _plane_second(moduli, y, x, radius, slope, weight, v, out):
    """The same in plane stress, by the chain rule.

    With f_i(x) = x / D_i and the notation of :func:`_plane_tangent`, d^2 of w_i y_i f_i(x) is

        w_i [f_i'' y_i X (x) X + f_i' C_i (e_i (x) X + X (x) e_i) + f_i' y_i X2],   X = dx/d eps,  X2 = d^2 x/d eps^2

    where X2 follows from the second derivative of the equation of x.
    """
    mean, shear = moduli[1] + 2.0 * moduli[0], moduli[1]
    stiff_a, stiff_b = _stiffness(moduli, True)
    a, b = radius + stiff_a * x, radius + stiff_b * x
    rate_a, rate_b = slope + stiff_a, slope + stiff_b
    gradient = out[2]
    _length_gradient(moduli, y, x, radius, slope, gradient)
    rest = radius - slope * x
    v[0], v[1], v[2], v[3] = HALF * (weight[0] + weight[1]), HALF * (weight[0] - weight[1]), 0.0, weight[3]
    along = 0.0
    for i in range(4):
        along += v[i] * gradient[i]
    along *= rest
    bending = square = 0.0
    for i in range(4):
        modulus, share, d, rate = (mean, 1.0 / 3.0, a, rate_a) if i == 0 else (shear, 1.0, b, rate_b)
        bending -= 2.0 * rest * v[i] * modulus * share * y[i] * rate / d**3
        square += 3.0 * share * y[i] ** 2 * rate**2 / d**4
        v[i] = modulus * share * (modulus * rest * v[i] / d**2 - 2.0 * along * y[i] * rate / d**3)
    to_axes(gradient)
    to_axes(v)
    for i in (0, 1, 3):
        for j in (0, 1, 3):
            outer = gradient[i] * gradient[j]
            out[i, j] = -(bending + along * square) * outer - v[i] * gradient[j] - gradient[i] * v[j]
    for i in range(4):
        out[2, i] = 0.0
        out[i, 2] = 0.0
    add_diagonal(-along * mean**2 / (3.0 * a**2), -along * shear**2 / b**2, out)


@njit_inner_exact
def thickness_strain(constants, strain, plastic_strain):
    """Strain 33 (float) in plane stress, from the strain in the plane (4,) and the plastic strain (4,) at its end."""
    lam, shear, _ = moduli_of(constants, False)
    elastic = strain[0] + strain[1] - plastic_strain[0] - plastic_strain[1]
    return plastic_strain[2] - lam / (lam + shear) * elastic


@njit
def respond(law, strain, state, excess, tangent, active):
    """Excess of points, and its derivative unless ``tangent`` has the length 0.

    Parameters
    ----------
    law : VonMises
    strain : ndarray (n, m)
    state : ndarray (n, m + 1)
        Plastic strain and equivalent plastic strain.
    excess, tangent, active : ndarray
        Overwritten, see `pcontact.material.elastic.Response`.
    """
    m, wanted = strain.shape[1], len(tangent) > 0
    work, unused = np.zeros(m), np.zeros((m, m))
    for k in range(len(strain)):
        plastic, p = state[k, :m], state[k, m]
        if p == 0.0 and not flows(law, strain[k], plastic, 0.0, work):
            excess[k, :] = 0.0
            active[k] = STILL
            continue
        _, yields = return_map(
            law, strain[k], plastic, p, wanted, work, excess[k], tangent[k] if wanted else unused
        )
        active[k] = FLOWS if yields else LOADED


@njit
def advance(law, strain, state):
    """Let the state (n, m + 1) of points, in place, follow the strain (n, m)."""
    m = strain.shape[1]
    excess, work, tangent = np.zeros(m), np.zeros(m), np.zeros((m, m))
    for k in range(len(strain)):
        plastic = state[k, :m]
        if flows(law, strain[k], plastic, state[k, m], work):
            state[k, m], _ = return_map(law, strain[k], plastic, state[k, m], False, plastic, excess, tangent)


@njit
def bend(law, strain, state, weight, second, active):
    """:func:`second_derivative` of points with weights (n, m) into ``second`` (n, m, m), where they flow."""
    m = strain.shape[1]
    work = np.zeros((2, m))
    for k in range(len(strain)):
        if second_derivative(law, strain[k], state[k, :m], state[k, m], weight[k], work, second[k]):
            active[k] = FLOWS


class Plastic(Elastic):
    """Von Mises plasticity.

    Parameters
    ----------
    lam, mu : float
        Lame constants [stress].
    curve : ndarray (k, 3)
        Isotropic hardening, see `pcontact.material.hardening`.
    kinematic_hardening : float
        Prager's Hk [stress].
    dim : int
    kinematics, expansion
        See `pcontact.material.elastic.Elastic`.

    Attributes
    ----------
    law : VonMises
    """

    nonlinear = True

    def __init__(self, lam, mu, curve, kinematic_hardening=0.0, dim=3, kinematics="plane_strain", expansion=0.0):
        super().__init__(lam, mu, kinematics, expansion)
        self.law = VonMises(plastic_constants(lam, mu, kinematic_hardening), curve, self.plane_stress)
        self.size, self.limit = 6 if dim == 3 else 4, float(curve[0, 1])
        self.width = self.size + 1

    @classmethod
    def of(cls, material, dim, kinematics):
        """That of a material of a scene which may yield; None for others."""
        if not material.plastic:
            return None
        constants, expansion = lame(material.E, material.nu), material.expansion or 0.0
        return cls(*constants, curve_of(material), material.kinematic_hardening, dim, kinematics, expansion)

    @property
    def reads_temperature(self):
        """In plane stress a stress that is uniform in the plane has a deviator."""
        return self.plane_stress

    def stress(self, strain, state, moment=NOW, tangent=False):
        """A `Response` of points to a strain (n, m), from a committed state (n, m + 1)."""
        n, m = strain.shape
        found = Response(np.empty((n, m)), np.empty((n if tangent else 0, m, m)), np.empty(n, dtype=np.int8))
        respond(self.law, strain, state, *found)
        return found

    def commit(self, strain, state, moment=NOW):
        """Let a state, in place, follow the strain."""
        advance(self.law, strain, state)

    def curvature(self, strain, state, weight, moment=NOW):
        """Second derivatives (n, m, m) of weights (n, m) times the stress, and where they are not zero, as `active`."""
        second, active = np.zeros((*strain.shape, strain.shape[1])), np.zeros(len(strain), dtype=np.int8)
        bend(self.law, strain, state, weight, second, active)
        return second, active

    def flow(self, state):
        """Equivalent plastic strain of states (..., width), a view."""
        return state[..., self.size]

    def energies(self, strain, state, excess):
        """Energy that points store beyond 1/2 eps C_e eps at a committed state, and have dissipated (n,) [stress].

        Stored are 1/2 eps_e C_e eps_e and what Prager's back stress stores, 1/2 (2/3 Hk) eps_p eps_p; dissipated is the
        integral of the yield stress over the equivalent plastic strain. With the excess s = -C_e eps_p the first is
        1/2 eps C_e eps + eps s - 1/2 eps_p s.
        """
        plastic, across = state[:, : self.size], state[:, : self.size].copy()
        if self.plane_stress:
            # plastic flow keeps the volume
            across[:, 2] = -across[:, 0] - across[:, 1]
        back = moduli_of(self.law.constants, False)[2]
        stored = 0.5 * back * np.sum(across**2, axis=1) + np.sum((strain - 0.5 * plastic) * excess, axis=1)
        return stored, yield_work(self.law.curve, self.flow(state))
