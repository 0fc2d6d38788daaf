"""The item of a viscosity that resists every motion: what steadies bodies that snap, without inertia."""

import numpy as np

from pcontact.assembly.item import LAW, Item, Sum
from pcontact.assembly.loads import lumped_volume
from pcontact.runtime.petsc import MPI


class ViscousStabilisation(Item):
    """Dashpots between all nodes and the surroundings: R += (eta / dt) M (u - u_k), M the lumped volume.

    Parameters
    ----------
    space : pcontact.space.space.Space
    eta : float
        [stress * time / length^2]
    bulk : pcontact.assembly.solid.Bulk
        The bodies, whose stresses do the work that the viscosity is to be small against.

    Attributes
    ----------
    taken : Sum
        What the dashpots have taken up [force * length].
    stressed : Sum
        Magnitudes of the works of the stresses in the load steps [force * length]: bodies that snap give back what
        they have taken up, and the sum of their works may be nothing.

    Notes
    -----
    The constructor is *Collective*.
    """

    name = "viscous stabilisation"

    def __init__(self, space, eta, bulk):
        self.space, self._eta, self._volume, self._bulk = space, eta, lumped_volume(space), bulk
        self._since, self._rate, self._begin = 0.0, 0.0, np.zeros((space.n_owned, space.dim))
        self._stresses = np.zeros_like(self._begin)
        self.taken, self.stressed = Sum(), Sum()

    def detect(self, u, time, motion=0.0, ahead=None):
        """The load step begins at ``u``. *Collective.*"""
        self._begin, self._stresses[:] = self.space.of_owned(u).copy(), 0.0
        self._bulk.residual(u, self._stresses)
        self._rate = self._eta / (time - self._since) if time > self._since else 0.0

    def commit(self, u, time):
        """The next load step begins at ``time``."""
        self._since = time

    def _forces(self, u):
        return self._rate * self._volume[:, None] * (self.space.of_owned(u) - self._begin)

    def pattern(self):
        """The diagonal."""
        start, n = self.space.start, self.space.n_owned
        return np.arange(n + 1, dtype=np.int64), np.arange(start, start + n, dtype=np.int64)

    def residual(self, u, out, rule=LAW):
        """Add the forces of the dashpots to ``out`` (n_owned, d)."""
        out += self._forces(u)

    def drag(self, u, out):
        """Add the forces of the dashpots on the bodies to ``out`` (n_owned, d) [force]."""
        out -= self._forces(u)

    def add_magnitude(self, u, out):
        """Add the magnitudes of the forces to ``out`` (n_owned, d)."""
        out += self._rate * self._volume[:, None] * (np.abs(self.space.of_owned(u)) + np.abs(self._begin))

    def tangent(self, u, rule=LAW):
        """Values (n_owned, d, d) on the diagonal."""
        return (self._rate * self._volume)[:, None, None] * np.eye(self.space.dim)

    def report(self, u):
        """Add the works of the load step that has been committed at ``u`` to the sums: what the dashpots have taken up
        so far, and that over what the stresses have done. *Collective.*"""
        moved, stresses = self.space.of_owned(u) - self._begin, np.zeros_like(self._stresses)
        self._bulk.residual(u, stresses)
        own = np.array([np.sum(self._forces(u) * moved), 0.5 * np.sum((self._stresses + stresses) * moved)])
        taken, stressed = self.space.comm.allreduce(own, op=MPI.SUM)
        self.taken.carried += float(taken)
        self.stressed.carried += abs(float(stressed))
        ratio = self.taken.carried / self.stressed.carried if self.stressed.carried > 0.0 else 0.0
        return {"viscous": {"work": self.taken.carried, "ratio": ratio}}
