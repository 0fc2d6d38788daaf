"""Orthotropic linear elasticity: constants along the axes of a material frame, turned into the directions of the mesh.

Along its axes 1, 2, 3 the material has the compliance

    eps_ii = sigma_ii / E_i - sum_(j != i) nu_ij / E_i sigma_jj,    2 eps_ij = sigma_ij / G_ij

with nu_ij / E_i = nu_ji / E_j: nu12 is the contraction along 2 under a stress along 1. Components are those of
`pcontact.material.elastic`; a turn of the frame is an orthogonal matrix of them.

The stiffness is split, C = C_iso + C_dev. C_iso is the isotropic stiffness that is nearest to C (in the sum of the
squares of the components; Fedorov 1968, Norris 2006):

    3 K = 1/3 sum_(i, j <= 3) C_ij,    2 mu = (tr C - 3 K) / 5

Its constants serve wherever two numbers do, such as for scales; what is done with C_iso alone is done as for an
isotropic body, and C_dev is added where an orthotropic body is.
"""

import numpy as np

from pcontact.material.elastic import HALF, PAIRS, Elastic, isotropic

# a radius below this fraction of the distance from the origin is one on the axis of the frame
_ON_AXIS = 1e-12
# couplings of stresses in the plane with shear across it that are rounding errors, over the stiffness
_ROUNDING = 1e-9


def _basis():
    """Tensors (6, 3, 3) whose Mandel components are those of the unit vectors."""
    out = np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        out[k, i, j] = out[k, j, i] = 1.0 if i == j else HALF
    return out


_BASIS = _basis()


def stiffness(young, poisson, shear):
    """Stiffness (6, 6) [stress] along the axes of the material.

    Parameters
    ----------
    young : sequence of float
        E1, E2, E3 [stress].
    poisson : sequence of float
        nu12, nu13, nu23.
    shear : sequence of float
        G12, G13, G23 [stress].
    """
    (e1, e2, e3), (nu12, nu13, nu23), (g12, g13, g23) = young, poisson, shear
    normal = np.diag([1.0 / e1, 1.0 / e2, 1.0 / e3])
    normal[0, 1] = normal[1, 0] = -nu12 / e1
    normal[0, 2] = normal[2, 0] = -nu13 / e1
    normal[1, 2] = normal[2, 1] = -nu23 / e2
    out = np.zeros((6, 6))
    out[:3, :3] = np.linalg.inv(normal)
    out[:3, :3] = 0.5 * (out[:3, :3] + out[:3, :3].T)
    out[3, 3], out[4, 4], out[5, 5] = 2.0 * g12, 2.0 * g23, 2.0 * g13
    return out


def frame(first, second):
    """Unit vectors (3, 3), a row for each axis: along the first vector, in the plane of both, square to both."""
    one = np.array(first, dtype=np.float64)
    one /= np.linalg.norm(one)
    two = np.array(second, dtype=np.float64)
    two -= (two @ one) * one
    two /= np.linalg.norm(two)
    return np.array([one, two, np.cross(one, two)])


def turn(frames):
    """Matrices (n, 6, 6) that take Mandel components along axes to those in the directions that the axes are given in.

    Parameters
    ----------
    frames : ndarray (n, 3, 3)
        Unit vectors, a row for each axis.
    """
    tensors = np.einsum("nia,kij,njb->nkab", frames, _BASIS, frames, optimize=True)
    out = np.empty((len(frames), 6, 6))
    for k, (i, j) in enumerate(PAIRS):
        out[:, k] = tensors[:, :, i, j] * (1.0 if i == j else 1.0 / HALF)
    return out


def nearest_isotropic(moduli):
    """Lame constants [stress] of the isotropic stiffness that is nearest to one (6, 6)."""
    triple_bulk = moduli[:3, :3].sum() / 3.0
    shear = (np.trace(moduli) - triple_bulk) / 5.0
    return (triple_bulk - shear) / 3.0, 0.5 * shear


class Orthotropic(Elastic):
    """Orthotropic elasticity of a body in the directions of the mesh: x, y, z, or r, axis, hoop with axial symmetry.

    Parameters
    ----------
    moduli : ndarray (6, 6)
        Stiffness along the axes of the material [stress].
    axes : ndarray (3, 3)
        Unit vectors, a row for each axis of the material: in the directions of the mesh, or, around an axis, in the
        radial, hoop and axial direction.
    dim : int
        Of the mesh.
    kinematics : str
        "plane_strain" in space.
    around : (ndarray (d,), ndarray (3,)), optional
        A point of the axis around which the frame goes, and its direction.
    expansion : sequence of float, optional
        Thermal expansion along the axes of the material [1/temperature].

    Attributes
    ----------
    size : int
        Number m of components.
    """

    anisotropic = True

    def __init__(self, moduli, axes, dim, kinematics, around=None, expansion=None):
        self.size = 6 if dim == 3 else 4
        self._around = None
        if around is not None:
            self._around = np.array(around[0], dtype=np.float64), np.array(around[1], dtype=np.float64)
            self._around[1][:] /= np.linalg.norm(self._around[1])
        matrix = turn(axes[None])[0]
        self._local = matrix @ moduli @ matrix.T
        super().__init__(*nearest_isotropic(moduli), kinematics)
        self._isotropic = isotropic(*self.constants, self.size, self.plane_stress)
        self._expansion = np.zeros(6)
        if expansion is not None and np.any(expansion):
            self._expansion = matrix @ np.array([*expansion, 0.0, 0.0, 0.0])
            self.expansion_energy = self._expansion_energy()

    @classmethod
    def of(cls, material, dim, kinematics):
        """That of a material of a scene which has constants along three axes; None for others."""
        if not material.orthotropic:
            return None
        moduli = stiffness(material.E, material.nu, material.G)
        around = None if material.point is None else (material.point, material.axis or (0.0, 0.0, 1.0))
        return cls(moduli, frame(*material.frame), dim, kinematics, around, material.expansion)

    @property
    def uniform(self):
        """Return True if the stiffness is the same everywhere."""
        return self._around is None

    def _turned(self, x):
        """Matrices (k, 6, 6) that take components along the frame to those of the mesh, k = 1 or n."""
        if self._around is None:
            return np.eye(6)[None]
        point, axis = self._around
        place = np.zeros((len(x), 3))
        place[:, : x.shape[1]] = x - point
        radial = place - np.outer(place @ axis, axis)
        length = np.linalg.norm(radial, axis=1)
        # on the axis no direction is radial: any will do
        some = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        alone = length <= _ON_AXIS * np.linalg.norm(place, axis=1)
        radial[alone], length[alone] = some / np.linalg.norm(some), 1.0
        radial /= length[:, None]
        hoop = np.cross(axis[None], radial)
        return turn(np.stack([radial, hoop, np.broadcast_to(axis, radial.shape)], axis=1))

    def _reduced(self, full):
        """Stiffness (k, m, m) in the directions of the mesh, condensed in plane stress."""
        if self.size == 6:
            return full
        plane = full[:, :4, :4].copy()
        if self.plane_stress:
            plane -= plane[:, :, 2:3] * plane[:, 2:3, :] / plane[:, 2:3, 2:3]
            plane[:, 2, :] = plane[:, :, 2] = 0.0
        return plane

    def moduli(self, x):
        """Stiffness (k, m, m) [stress] at points x (n, d): k = 1 where it is uniform, else n."""
        matrix = self._turned(x)
        return self._reduced(matrix @ self._local @ matrix.transpose(0, 2, 1))

    def deviation(self, x):
        """See :meth:`pcontact.material.elastic.Elastic.deviation`."""
        return np.ascontiguousarray(self.moduli(x) - self._isotropic)

    def acoustic(self, normal):
        """Largest eigenvalue (n,) of n . C . n for unit normals (n, d), of a uniform stiffness [stress].

        It is the largest |C : e . n|^2 over e : C : e, and lam + 2 mu of an isotropic body.
        """
        matrix = traction_matrix(normal)
        return np.linalg.eigvalsh(matrix @ self.moduli(normal) @ matrix.transpose(0, 2, 1))[:, -1]

    def shear(self, x, normal):
        """Four times the largest |C : e . n|^2 across n over e : C : e, over the largest one in any direction, or 1.

        Parameters
        ----------
        x, normal : ndarray (n, d)
            Points, and unit normals there.

        Returns
        -------
        ndarray (n,)
            4 mu / (lam + 2 mu) of an isotropic body with lam >= 2 mu.
        """
        matrix = traction_matrix(normal)
        acoustic = matrix @ self.moduli(x) @ matrix.transpose(0, 2, 1)
        across = np.eye(normal.shape[1]) - normal[:, :, None] * normal[:, None, :]
        part, whole = (np.linalg.eigvalsh(one)[:, -1] for one in (across @ acoustic @ across, acoustic))
        return np.minimum(1.0, 4.0 * part / whole)

    def _expansion_energy(self):
        """Twice the energy per volume, and per temperature squared, of a body that is kept from expanding."""
        local = self._reduced(self._local[None])[0]
        return float(self._expansion[: self.size] @ local @ self._expansion[: self.size])

    def thermal(self, x):
        """See :meth:`pcontact.material.elastic.Elastic.thermal`."""
        stress = self._local @ self._expansion
        full = self._turned(x) @ stress
        if self.size == 6:
            return full
        plane = full[:, :4].copy()
        if self.plane_stress:
            matrix = self._turned(x)
            across = (matrix @ self._local @ matrix.transpose(0, 2, 1))[:, :4, 2]
            plane -= across / across[:, 2:3] * plane[:, 2:3]
        return plane


def traction_matrix(normal):
    """Matrices (n, d, m) that take Mandel components of a stress to the traction on unit normals (n, d)."""
    n, d = normal.shape
    out = np.zeros((n, d, 6 if d == 3 else 4))
    for i in range(d):
        out[:, i, i] = normal[:, i]
    for k, (i, j) in enumerate(PAIRS[3:], start=3):
        if j < d and k < out.shape[2]:
            out[:, i, k], out[:, j, k] = HALF * normal[:, j], HALF * normal[:, i]
    return out
