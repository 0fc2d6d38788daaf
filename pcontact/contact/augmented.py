"""Augmented Lagrangian: the penalty method with multipliers, updated around Newton's method (Uzawa).

Each quadrature point has a multiplier lam [stress], which stands where Nitsche's method has the traction of the body:

    tau = lam + gamma g n - alpha gamma D_T,   update  lam <- mean of P(tau)  at the solution of Newton's method

The mean is that of the closed points in the patches of the source's nodes. At a fixed point of the update gap and
slip have no local mean where points are closed or stick, and what is left, (P - mean of P) / gamma, is small with the
mesh and zero for a uniform traction. With lam <- P(tau) they would be zero at every point: more conditions than
displacements can meet. The pressure then sits on a few points, and an update takes away little (cylinder on a block, 10
facets in the half width: error of the pressure in L2 92 % after 33 updates instead of 7 % after 5).

gamma says how fast multipliers settle, nothing else: where it is smaller than the default one it grows with every
update, up to that. Each attempt of a load step starts with the gamma that the scene says. An update is by gamma times
the gap: with a small gamma it is small whatever the gap, and counts as that of the default gamma.

Committed multipliers belong to the end of the last load step; an attempt starts from them, and one that is cut back
leaves nothing behind.
"""

import numpy as np

from pcontact.contact.averages import patch_means
from pcontact.contact.frictional import FrictionalItem
from pcontact.contact.item import ContactItem
from pcontact.contact.laws import OPEN
from pcontact.contact.parameters import TRACELESS
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# of gamma, at once
GROWTH = 10.0


class Multipliers:
    """What multipliers add to an item of contact; stands before it among the bases of a class.

    Attributes
    ----------
    multiplier : ndarray (np, d)
        Of the load step that is being solved [stress]; without friction its normal part alone counts.
    """

    def __init__(self, *args, **more):
        super().__init__(*args, **more)
        self.multiplier = np.zeros_like(self.source.x)
        self._kept, self._base, self._grown = self.multiplier, self.gamma, 1.0

    def update_multipliers(self, u, rtol):
        """Replace the multipliers by means of the traction that acts at ``u``, unless they have settled. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            Where the residual is zero.
        rtol : float
            Multipliers that change by no more stay as they are: state and equilibrium remain those of ``u``.

        Returns
        -------
        float
            Norm of the change over the surface, by the default gamma if that is larger, relative to that of the
            multipliers; 0 where nothing touches.
        """
        traction, status = self._acting(self.pairing.exchange.gather(u))
        closed = status > OPEN
        new = np.where(closed[:, None], patch_means(self.space, self.pairing, self.source, traction, closed), 0.0)
        weight, sizes = self.source.jxw, (new - self.multiplier, new, self.multiplier)
        sums = self.space.comm.allreduce(
            np.array([np.einsum("p,pd,pd->", weight, size, size) for size in sizes]), op=MPI.SUM
        )
        scale = float(max(sums[1], sums[2]))
        change = float(np.sqrt(sums[0] / scale)) if scale > 0.0 else 0.0
        change *= self._short()
        if change > rtol:
            self.multiplier = new
        return change

    def _short(self):
        """The default gamma over that which acts; 1 where that is no smaller."""
        return max(TRACELESS["augmented_lagrangian"] / (self._grown * self.gamma0), 1.0)

    def stiffen(self):
        """Let gamma grow, not beyond the default one."""
        self._grown *= min(GROWTH, self._short())
        self.gamma = self._grown * self._base

    def _begin(self, u, time):
        self.multiplier, self.gamma, self._grown = self._kept, self._base, 1.0
        super()._begin(u, time)

    def _end(self, values):
        super()._end(values)
        self._kept = self.multiplier

    def _evaluate(self, values, wanted=None):
        traction, gap = super()._evaluate(values, wanted)
        return traction + np.einsum("pd,pd->p", self.multiplier, self.pairing.normal), gap

    def memory(self):
        """See :meth:`ContactItem.memory`."""
        rows = np.flatnonzero(self._kept.any(axis=1))
        return {**super().memory(), "multiplier": (self.source.point_keys()[rows], self._kept[rows])}

    def recall(self, name, chunks):
        """See :meth:`ContactItem.recall`."""
        if name != "multiplier":
            return super().recall(name, chunks)
        self._kept = np.zeros_like(self.source.x)
        return take_rows(self.source.point_keys(), chunks, self._kept)


class AugmentedItem(Multipliers, ContactItem):
    """Frictionless contact of one pair by the augmented Lagrangian method; parameters as for `ContactItem`."""

    def _acting(self, values):
        tau, status = self._augmented(values)
        return np.where(status > OPEN, tau, 0.0)[:, None] * self.pairing.normal, status


class AugmentedFrictionalItem(Multipliers, FrictionalItem):
    """Contact with friction of one pair by the augmented Lagrangian method; parameters as for `FrictionalItem`."""

    def _acting(self, values):
        _, tau, _ = self._tau(values, self.pairing.acts)
        return self._project(tau)

    def _traction(self, values, wanted):
        return self.multiplier.copy()
