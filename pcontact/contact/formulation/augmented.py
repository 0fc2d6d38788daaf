"""Augmented Lagrangian: the penalty method with multipliers, updated around Newton's method (Uzawa).

Each quadrature point has a multiplier lam [stress], which stands where Nitsche's method has the traction of the body:

    tau = lam + gamma g n - alpha gamma D_T,   update  lam <- M P(tau)  at the solution of Newton's method

M takes the local mean over the closed points, see `pcontact.contact.formulation.small`. At a fixed point of the
update gap and slip have no local mean where points are closed or stick, and what is left, (P - M P) / gamma, is small
with the mesh and zero for a uniform traction. With lam <- P(tau) they would be zero at every point: more conditions
than displacements can meet. The pressure then sits on a few points, and an update takes away little (cylinder on a
block, 10 facets in the half width: error of the pressure in L2 92 % after 33 updates instead of 7 % after 5).

Let H be the compliance of the bodies, the gap that a traction at the points opens. While no point changes its status
an update multiplies the error of the multipliers by M (1 + gamma H)^-1, and neither factor makes anything larger. A
traction that changes from point to point is taken away by M. One that is smooth moves the bodies farther than it
presses a layer of their cells: gamma H is large, and the second factor takes it away.

Unbiased contact and self contact have two points at each place, one on either surface, each with a multiplier. Equal
and opposite changes of the two press nothing (gamma H = 0), and a mean over the points of one surface keeps them if
they are smooth: they fade as slowly as heat, or grow where points slip, and the pressures of the two surfaces drift
apart. There M is the mean over the points of both surfaces, see :func:`local_means`: what they differ by is gone at
once. Largest eigenvalue of an update, two blocks with 6 and 8 facets: 1, the next 0.96 and 0.98 with degree 1 and 2,
where each surface is alone; 0.15 and 0.10 with both.

gamma says how fast multipliers settle, nothing else: where it is smaller than the default one it grows with every
update, up to that. Each attempt of a load step starts with the gamma that the scene says. An update is by gamma times
the gap: with a small gamma it is small whatever the gap, and counts as that of the default gamma.

Committed multipliers belong to the end of the last load step; an attempt starts from them, and one that is cut back
leaves nothing behind.
"""

import numpy as np

from pcontact.contact.formulation.methods import TRACELESS, Penalty, is_unbiased
from pcontact.contact.formulation.small import Acting, local_means
from pcontact.contact.law import OPEN
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# of gamma, at once
GROWTH = 10.0


class AugmentedLagrangian(Penalty):
    """Multipliers in the place of the source's traction.

    Parameters
    ----------
    contact, trace, shape
        See `pcontact.contact.formulation.methods.Method`; of the shape are the multipliers.

    Attributes
    ----------
    multiplier : ndarray (np, d)
        Of the load step that is being solved [stress]; without friction its normal part alone counts.
    """

    def __init__(self, contact, trace, shape):
        super().__init__(contact, trace, shape)
        self.multiplier = np.zeros(shape)
        self._kept, self._first, self._grown = self.multiplier, self.gamma, 1.0

    def short(self):
        """The default gamma over that which acts; 1 where that is no smaller."""
        return max(TRACELESS["augmented_lagrangian"] / (self._grown * self.gamma0), 1.0)

    def stiffen(self):
        """Let gamma grow, not beyond the default one."""
        self._grown *= min(GROWTH, self.short())
        self.gamma = self._grown * self._first

    def begin(self, growth=None):
        """Start from the multipliers of the last load step, with the gamma that the scene says."""
        super().begin(growth)
        self.multiplier, self._first, self._grown = self._kept, self.gamma, 1.0

    def commit(self):
        """Keep the multipliers for the next load step."""
        self._kept = self.multiplier

    def normal_traction(self, traction, normal):
        """See :meth:`Method.normal_traction`."""
        return np.einsum("pd,pd->p", self.multiplier, normal)

    def traction(self, traction):
        """See :meth:`Method.traction`."""
        return self.multiplier.copy()

    def memory(self, keys):
        """See :meth:`Method.memory`."""
        rows = np.flatnonzero(self._kept.any(axis=1))
        return {"multiplier": (keys[rows], self._kept[rows])}

    def recall(self, name, keys, chunks):
        """See :meth:`Method.recall`."""
        if name != "multiplier":
            return None
        self._kept = np.zeros_like(self._kept)
        return take_rows(keys, chunks, self._kept)


def acting(pair, u):
    """Traction at ``u`` of the points of a pair that are closed. *Collective.*

    Returns
    -------
    pcontact.contact.formulation.small.Acting
    """
    traction, status = pair.forces(u)
    return Acting(pair.pairing, pair.source, traction, status > OPEN, pair.target_shape(u))


def update_multipliers(parts, u, rtol):
    """Replace the multipliers of a pair by means of the traction that acts at ``u``, unless they have settled.
    *Collective.*

    Parameters
    ----------
    parts : list of pcontact.contact.pair.ContactPair
        With multipliers: the pair of a contact, or the two of an unbiased one.
    u : PETSc.Vec
        Where the residual is zero.
    rtol : float
        Multipliers that change by no more stay as they are: state and equilibrium remain those of ``u``.

    Returns
    -------
    change : float
        Norm of the change over the surfaces, by the default gamma if that is larger, relative to that of the
        multipliers; 0 where nothing touches, and where rounding errors of the gap make as much.
    size : float
        The norm itself, by the gamma that acts [stress length^((d - 1) / 2)].
    """
    first, found = parts[0], [acting(part, u) for part in parts]
    means = local_means(first.space, found, both=is_unbiased(first.contact))
    updates = [np.where(one.chosen[:, None], mean, 0.0) for one, mean in zip(found, means, strict=True)]
    sums = np.zeros(4)
    for part, one, new in zip(parts, found, updates, strict=True):
        old = part.method.multiplier
        rounding = (part.method.gamma * part.search.rounding * one.chosen)[:, None]
        for k, size in enumerate((new - old, new, old, rounding)):
            sums[k] += np.einsum("p,pd,pd->", part.source.jxw, size, size)
    sums = first.space.comm.allreduce(sums, op=MPI.SUM)
    scale = float(max(sums[1], sums[2]))
    change = float(np.sqrt(sums[0] / scale)) * first.method.short() if sums[0] > sums[3] and scale > 0.0 else 0.0
    if change > rtol:
        for part, new in zip(parts, updates, strict=True):
            part.method.multiplier = new
    return change, float(np.sqrt(sums[0]))
