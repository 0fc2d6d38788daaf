"""Isotropic linear elasticity: constants, the stress of a displacement gradient, and what every material says.

A *material* of small strain is an :class:`Elastic`, or derived from it. Its stress has up to four parts:

    sigma = C_iso : eps  +  C_dev : eps  +  excess(eps, state)  -  C : alpha dT

C_iso is isotropic, its constants are :attr:`Elastic.constants`: they give scales, too, and a mean dilatation is one of
this part. C_dev is linear (:meth:`Elastic.deviation`), both are integrated once. The excess is all that is not linear
in the strain, of laws that say :attr:`Elastic.nonlinear`: it is integrated anew for every displacement, and has
internal variables. The last part is what keeps a heated body from expanding.

Components are Mandel's: a shear component is sqrt(2) times that of the tensor, for strain as for stress, so inner
products and norms are the plain ones. Order XX, YY, ZZ, XY, YZ, XZ in 3D (m = 6), and 11, 22, 33, 12 in 2D (m = 4),
where 33 is across the plane: its strain is 0 in plane strain, the hoop strain with axial symmetry, and is not read in
plane stress, where the stress 33 is 0.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit_inline, njit_inner_exact

HALF = np.sqrt(0.5)


@njit_inline
def indices(k):
    """Row and column of a component in 3D; where a kernel does much for each, this costs less than `PAIRS`."""
    return (k, k) if k < 3 else ((0, 1) if k == 3 else ((1, 2) if k == 4 else (0, 2)))


# those of all components
PAIRS = np.array([indices.py_func(k) for k in range(6)])


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


class Moment(NamedTuple):
    """Arguments of a law besides strain and state.

    Attributes
    ----------
    step : float
        Increment of the load step [time]; 0 where the state is that at its end.
    temperature : ndarray (n,) or None
        Of the points; None where nothing heats them.
    """

    step: float = 0.0
    temperature: np.ndarray | None = None


NOW = Moment()


class Response(NamedTuple):
    """Stress and tangent that points add to linear elasticity.

    Attributes
    ----------
    excess : ndarray (n, m)
        Stress [stress].
    tangent : ndarray (n, m, m)
        Its derivative by the strain, of points that flow; anything elsewhere, and (0, m, m) where it was not wanted.
    active : ndarray (n,)
        STILL: neither of them, both are zero; LOADED: the stress alone; FLOWS: both.
    """

    excess: np.ndarray
    tangent: np.ndarray
    active: np.ndarray


STILL, LOADED, FLOWS = 0, 1, 2


class Elastic:
    """Isotropic linear elasticity of small strain.

    Parameters
    ----------
    lam, mu : float
        Lame constants [stress].
    kinematics : str
        "plane_strain" in space.
    expansion : float
        Thermal [1/temperature].

    Attributes
    ----------
    constants : (float, float)
        Lame constants of C_iso, in plane stress those of the plane [stress].
    nonlinear : bool
        Whether there is an excess.
    symmetric : bool
        Whether the derivative of the stress is symmetric.
    reads_temperature : bool
        Whether the excess depends on the temperature.
    anisotropic, uniform : bool
        Whether there is a C_dev, and whether it is the same everywhere.
    width : int
        Numbers that a point has as internal variables.
    limit : float
        Equivalent stress of the first yield [stress].
    expansion_energy : float
        Twice the energy per volume, and per temperature squared, of a body that is kept from expanding; 0 where it does
        not expand.
    """

    nonlinear = anisotropic = reads_temperature = False
    symmetric = uniform = True
    width, limit = 0, np.inf

    def __init__(self, lam, mu, kinematics="plane_strain", expansion=0.0):
        self.constants, self.plane_stress = in_plane(lam, mu, kinematics), kinematics == "plane_stress"
        # in plane stress the third direction is free to expand
        normal = 2.0 if self.plane_stress else 3.0
        self._beta = (normal * self.constants[0] + 2.0 * self.constants[1]) * expansion
        self.expansion, self.expansion_energy = expansion, normal * self._beta * expansion

    @classmethod
    def of(cls, material, dim, kinematics):
        """That of a material of a scene, whatever else it has."""
        return cls(*lame(material.E, material.nu), kinematics, material.expansion or 0.0)

    def moduli(self, m):
        """Moduli (m, m) of the strain that flow changes: of the deviator, in plane stress of all in the plane."""
        out = isotropic(*self.constants, m, self.plane_stress)
        if not self.plane_stress:
            out[:3, :3] = 2.0 * self.constants[1] * (np.eye(3) - 1.0 / 3.0)
        return out

    def stiffness(self, x):
        """Linear elasticity C_iso + C_dev (k, m, m) [stress] at points x (n, d): k = 1 where it is uniform, else n."""
        plain = isotropic(*self.constants, 6 if x.shape[1] == 3 else 4, self.plane_stress)
        return plain[None] + self.deviation(x) if self.anisotropic else plain[None]

    def thermal(self, x):
        """Stress (k, m) per temperature that keeps the body from expanding, C : alpha, at points x (n, d): k = 1, or n
        where it is not uniform."""
        return self._beta * (np.arange(6 if x.shape[1] == 3 else 4) < (2 if self.plane_stress else 3))[None]

    def deviation(self, x):
        """C_dev (k, m, m) [stress] at points x (n, d): k = 0 without, 1 where it is uniform, else n."""
        m = 6 if x.shape[1] == 3 else 4
        return np.zeros((0, m, m))


def isotropic(lam, mu, m, plane_stress):
    """Isotropic stiffness (m, m) [stress]; with the constants of the plane in plane stress, where 33 is zero."""
    out, normal = 2.0 * mu * np.eye(m), 2 if plane_stress else 3
    out[:normal, :normal] += lam
    if plane_stress:
        out[2, :] = out[:, 2] = 0.0
    return out


def equivalent_stress(stress):
    """Von Mises stress (n,) of stresses (n, 6), order XX, YY, ZZ, XY, YZ, XZ [stress]."""
    s = np.asarray(stress)
    normal = (s[:, 0] - s[:, 1]) ** 2 + (s[:, 1] - s[:, 2]) ** 2 + (s[:, 2] - s[:, 0]) ** 2
    return np.sqrt(0.5 * normal + 3.0 * (s[:, 3:] ** 2).sum(axis=1))
