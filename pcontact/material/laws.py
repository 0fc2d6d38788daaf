"""From the materials of a scene to their laws of small strain: a row for each, of which the first that answers counts;
and the laws that programs add.

A law that a program adds is a subclass of :class:`PointLaw` with a method :meth:`~PointLaw.respond` for points in
space, from which the plane and axial symmetry follow; :func:`add_material` gives it a name.
"""

import numpy as np

from pcontact.material.elastic import FLOWS, NOW, Elastic, Response, isotropic, lame
from pcontact.material.orthotropic import Orthotropic
from pcontact.material.plastic import Plastic

# Iterations on the strain across the plane in plane stress, at most. From: Newton's method on a law that hardens takes
# some 5.
MOST_ACROSS = 50
# [-] Stress across the plane over the largest one at which they end. From: some rounding errors.
ACROSS = 1e-13
# [-] Step of differences of the tangent over the strain. From: the third root of the rounding error, for differences
# on both sides.
DIFFERENCE = 1e-5


class PointLaw(Elastic):
    """A stress-strain law that a program adds; with it :meth:`respond` is to be written, all else has defaults.

    `E` and `nu` of the material are those of the linear elasticity that the law is compared with: the unloaded state's,
    if it has one. They scale contact, preconditioner and tests of convergence, and are integrated once; where cells
    take their mean dilatation, so does the change of volume of this elasticity alone: what the law has beyond it there
    should not depend on the change of volume.

    Components of strain and stress are XX, YY, ZZ, XY, YZ, XZ in the directions of the mesh, with axial symmetry those
    of radius, axis and hoop, and a shear component is sqrt(2) times that of the tensor (Mandel): products and norms are
    the plain ones.

    Parameters
    ----------
    material : pcontact.scene.model.Material
        Its ``parameters`` are numbers for the law.
    dim : int
        Of the mesh.
    kinematics : str
        "plane_strain" in space.

    Attributes
    ----------
    width : int
        Numbers that a point has as its state, all 0 at first; of subclasses.
    symmetric : bool
        Whether the tangent is, of subclasses.
    energy : callable or None
        Of subclasses: from strain (n, 6) and committed state (n, width) to the energy that points store (n,) and what
        they have dissipated (n,) [stress]. ``output.energy`` asks for it.
    """

    nonlinear = symmetric = reads_temperature = True
    energy = None

    def __init__(self, material, dim, kinematics):
        super().__init__(*lame(material.E, material.nu), kinematics, material.expansion or 0.0)
        self.material, self._state = material, self.width
        self._elastic = isotropic(*self.constants, 6 if dim == 3 else 4, self.plane_stress)
        # in plane stress the strain across the plane stands behind the law's own state
        self.width = self._state + self.plane_stress

    def respond(self, strain, state, step, temperature):
        """Stress and new state of points.

        Parameters
        ----------
        strain : ndarray (n, 6)
            Without that of thermal expansion.
        state : ndarray (n, width)
            At the end of the last load step.
        step : float
            Increment of the load step [time]. With 0 it has ended: ``state`` and ``strain`` are those at its end, and
            the stress is to be that at its end, too.
        temperature : ndarray (n,)
            Of ``[[temperatures]]``, 0 without.

        Returns
        -------
        stress : ndarray (n, 6)
            [stress]
        tangent : ndarray (n, 6, 6)
            Its derivative by the strain at constant ``state`` [stress].
        state : ndarray (n, width)
            At the end of this load step.
        """
        raise NotImplementedError

    def plastic_strain(self, state):
        """Equivalent plastic strain (...) of states (..., width), for reports; none if this is not written."""
        return np.zeros(state.shape[:-1])

    # -- what bodies ask ----------------------------------------------------------------------------------------------

    def _evaluated(self, strain, state, moment):
        """Stress (n, m), tangent (n, m, m) and new state of points in the kinematics of the mesh."""
        n, m = strain.shape
        full, old = np.zeros((n, 6)), state[:, : self._state]
        full[:, :m] = strain
        temperature = np.zeros(n) if moment.temperature is None else moment.temperature
        if not self.plane_stress:
            stress, tangent, new = self.respond(full, old, moment.step, temperature)
            return stress[:, :m], tangent[:, :m, :m], new
        full[:, 2] = state[:, -1]
        for _ in range(MOST_ACROSS):
            stress, tangent, new = self.respond(full, old, moment.step, temperature)
            if np.all(np.abs(stress[:, 2]) <= ACROSS * np.abs(stress).max(axis=1, initial=0.0)):
                break
            full[:, 2] -= stress[:, 2] / tangent[:, 2, 2]
        else:
            stress = np.full_like(stress, np.nan)
        plane = tangent[:, :m, :m] - tangent[:, :m, 2:3] * tangent[:, 2:3, :m] / tangent[:, 2:3, 2:3]
        # exactly, and not only but for rounding errors
        plane[:, 2, :] = plane[:, :, 2] = 0.0
        stress = stress[:, :m] * np.array([1.0, 1.0, 0.0, 1.0])
        return stress, plane, np.column_stack([new, full[:, 2]])

    def stress(self, strain, state, moment=NOW, tangent=False):
        """A `Response` of points to a strain (n, m), from a committed state (n, width)."""
        stress, moduli, _ = self._evaluated(strain, state, moment)
        wanted = moduli - self._elastic if tangent else np.zeros((0, *self._elastic.shape))
        excess = np.ascontiguousarray(stress - strain @ self._elastic)
        return Response(excess, np.ascontiguousarray(wanted), np.full(len(strain), FLOWS, dtype=np.int8))

    def commit(self, strain, state, moment=NOW):
        """Let a state, in place, follow the strain."""
        state[:] = self._evaluated(strain, state, moment)[2]

    def curvature(self, strain, state, weight, moment=NOW):
        """Second derivatives (n, m, m) of weights (n, m) times the stress, by differences, and flags of all points."""
        out, sizes = np.empty((*strain.shape, strain.shape[1])), np.abs(strain).max(axis=1)
        sizes = DIFFERENCE * np.where(sizes > 0.0, sizes, 1.0)
        for k in range(strain.shape[1]):
            ends = []
            for sign in (1.0, -1.0):
                moved = strain.copy()
                moved[:, k] += sign * sizes
                ends.append(np.einsum("ni,nij->nj", weight, self._evaluated(moved, state, moment)[1]))
            out[:, :, k] = (ends[0] - ends[1]) / (2.0 * sizes[:, None])
        return out, np.full(len(strain), FLOWS, dtype=np.int8)

    def flow(self, state):
        """Equivalent plastic strain of states (..., width)."""
        return self.plastic_strain(state[..., : self._state])

    def energies(self, strain, state, excess):
        """Energy that points store beyond that of linear elasticity at a committed state, and have dissipated."""
        full = np.zeros((len(strain), 6))
        full[:, : strain.shape[1]] = strain
        if self.plane_stress:
            full[:, 2] = state[:, -1]
        stored, dissipated = self.energy(full, state[:, : self._state])
        return stored - 0.5 * np.einsum("ni,ij,nj->n", strain, self._elastic, strain), dissipated


LAWS = {"orthotropic": Orthotropic.of, "plastic": Plastic.of, "elastic": Elastic.of}

# laws that programs have added, by the name that a material says with `law`
ADDED = {}


def add_material(name, make):
    """Add a stress-strain law of small strain: materials of scenes of this process choose it with ``law = "NAME"``.

    Parameters
    ----------
    name : str
    make : callable
        From a :class:`pcontact.scene.model.Material`, the dimension of the mesh and its kinematics to a law: a subclass
        of :class:`pcontact.material.laws.PointLaw`, or a function.
    """
    ADDED[name] = make


def small_strain(material, dim, kinematics):
    """The law of small strain of a material.

    Parameters
    ----------
    material : pcontact.scene.model.Material
    dim : int
        Of the mesh.
    kinematics : str
        "plane_strain" in space.

    Returns
    -------
    pcontact.material.elastic.Elastic
    """
    if material.added:
        return ADDED[material.law](material, dim, kinematics)
    return next(law for law in (make(material, dim, kinematics) for make in LAWS.values()) if law is not None)
