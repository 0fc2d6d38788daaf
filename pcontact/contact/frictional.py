"""One contact pair with friction."""

import numpy as np

from pcontact.contact import friction
from pcontact.contact.averages import patch_means
from pcontact.contact.item import ContactItem
from pcontact.contact.laws import OPEN, SLIP, STICK
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# a law whose bound nothing reaches
HELD = np.array([0.0, 1e8, np.inf])


class FrictionalItem(ContactItem):
    """Contact with friction of one pair by Nitsche's method, or by penalty where the source has no traction.

    The slip of a load step counts from the tangential jump of the committed displacement on the present pair of points
    (plus what a rigid obstacle has moved since the committed time), so a point that is handed to another target facet
    loses nothing. Traction and law agree weakly: at a point that sticks the jump differs from its reference by

        lag = (t_T - P_T) / (alpha gamma),

    small with the mesh. The lag is taken off the next reference. Each load step would otherwise start from the jump as
    it is, and stick would creep by the lag in every step. Points that stick carry the lag's local average, over the
    patches of the shape functions: its changes from point to point are those of the stress of the cells and of meshes
    that do not match, and would add up from step to step. Points that slip carry their own: they stay at their bound.
    Without a traction of the source (penalty) the lag is that of the spring which bears the traction, exact at a point.

    Parameters
    ----------
    law : ndarray (3,)
        See `pcontact.contact.laws`.
    alpha : float
        Tangential over normal Nitsche parameter [1].
    others
        See `ContactItem`.
    """

    def __init__(self, space, contact, source, target, radius, law, alpha=1.0, floats=False, plastic=None):
        super().__init__(space, contact, source, target, radius, floats, plastic)
        self.law, self.alpha = law, float(alpha)
        self._law = law
        self._lag = np.zeros_like(source.x)

    def _begin(self, u, time):
        """Remember the jump at the beginning of the step, and the one from which the law counts slip."""
        self._start = self._jump(self.pairing.exchange.gather(u), self.pairing.acts)
        if self.rigid:
            self._start += self.target.moved(self.time, time)
        self._before = self._start - self._lag

    def _end(self, values):
        """Also by how much the jump lags behind the law. *Collective.*"""
        p = self.pairing
        traction, tau, _ = self._tau(values, self.pairing.acts)
        force, status = self._project(tau)
        self.committed = status
        lag = (traction - force) / (self.alpha * self.gamma[self.source.facet])[:, None]
        stick = status == STICK
        if self.source.grad.shape[1]:
            lag = np.where(stick[:, None], patch_means(self.space, p, self.source, lag, stick), lag)
        lag -= np.einsum("pd,pd->p", lag, p.normal)[:, None] * p.normal
        self._lag = np.where(self.closed[:, None], lag, 0.0)

    def memory(self):
        """See :meth:`ContactItem.memory`."""
        rows = np.flatnonzero(self._lag.any(axis=1))
        return {**super().memory(), "lag": (self.source.point_keys()[rows], self._lag[rows])}

    def recall(self, name, chunks):
        """See :meth:`ContactItem.recall`."""
        if name != "lag":
            return super().recall(name, chunks)
        return take_rows(self.source.point_keys(), chunks, self._lag)

    def glue(self, glued):
        """See :meth:`ContactItem.glue`; closed points stick."""
        super().glue(glued)
        self.hold(glued)

    def hold(self, held):
        """Let closed points stick whatever the law says, or give them back to it."""
        self._law = HELD if held else self.law

    def defer(self, before, u):
        """See :meth:`ContactItem.defer`. Where most of the contact sticks, all of it does for that iteration: at points
        that have overlapped the bound of the traction means nothing, and Newton's method has to take back, with steps
        cut short, what slips too early; from what sticks too long it goes straight on. A bound that does not follow the
        pressure acts at open points, too: there the edge of the contact is another one.
        """
        if self.law[1] == 0.0 or not super().defer(before, u):
            return False
        self._followed = self._law
        status, comm = self._status, self.space.comm
        stick, slip = comm.allreduce(np.array([self.source.jxw[status == s].sum() for s in (STICK, SLIP)]), op=MPI.SUM)
        if stick > slip:
            self._law = HELD
        return True

    def admit(self):
        """See :meth:`ContactItem.admit`."""
        if self._admitted is not None:
            self._law = self._followed
        super().admit()

    def _couples(self, closed):
        # a bound that does not follow the pressure acts wherever there is a partner
        return self.pairing.paired & (closed | (self.law[1] == 0.0))

    def _jump(self, values, wanted):
        p, source = self.pairing, self.source
        jump = np.empty_like(source.x)
        friction.jumps(values, p.cells, p.targets, source.facet, source.shape, p.target_shape, wanted, jump)
        return jump

    def _tau(self, values, wanted):
        """Boundary traction, augmented traction, jump (np, d) of the points that are wanted (np,)."""
        p, tau = self.pairing, np.empty_like(self.source.x)
        traction, jump = self._traction(values, wanted), self._jump(values, wanted)
        friction.augment(
            traction, jump, self._before, p.gap0, p.normal, self.gamma, self.alpha, self.source.facet, wanted, tau
        )
        return traction, tau, jump

    def _traction(self, values, wanted):
        """Boundary traction (np, d) of the points that are wanted (np,)."""
        traction = self._elastic(values, wanted)
        if self.plastic is not None:
            traction += self.plastic.traction(values, self.pairing.cells)
        return traction

    def _elastic(self, values, wanted):
        p, source, traction = self.pairing, self.source, np.empty_like(self.source.x)
        friction.tractions(
            values, p.cells, source.facet, source.grad, source.volumetric, source.mu, source.normal, wanted, traction
        )
        return traction

    def _operator(self, normal):
        return np.empty((len(normal), 0, normal.shape[1]))

    def _evaluate(self, values, wanted=None):
        p = self.pairing
        wanted = p.every if wanted is None else wanted
        return np.einsum("pd,pd->p", self._elastic(values, wanted), p.normal), self._gap(values, wanted)

    def _gap(self, values, wanted=None):
        p = self.pairing
        jump = self._jump(values, p.every if wanted is None else wanted)
        return p.gap0 - np.einsum("pd,pd->p", jump, p.normal)

    def _add_residual(self, values, local):
        p, source = self.pairing, self.source
        traction, tau, _ = self._tau(values, self.pairing.acts)
        friction.add_residual(
            self.theta, self.alpha, self._law, self.bilateral, p.paired, source.jxw, self.gamma, traction, tau, p.cells,
            p.targets, source.facet, source.shape, p.target_shape, source.grad, source.volumetric, source.mu,
            source.normal, p.normal, local,
        )  # fmt: skip

    def _augmented(self, values):
        _, tau, _ = self._tau(values, self.pairing.acts)
        _, status = self._project(tau)
        return tau, status

    def _weights(self, values):
        traction, tau, _ = self._tau(values, self.pairing.acts)
        normal, source = self.pairing.normal, self.source
        rest = self._project(tau)[0] - traction
        along = np.einsum("pd,pd->p", rest, normal)[:, None] * normal
        factor = self.theta * source.jxw / self.gamma[source.facet]
        return factor[:, None] * (along + (rest - along) / self.alpha)

    def _project(self, tau):
        traction = np.empty_like(tau)
        status = friction.project_all(
            self._law, self.bilateral, self.pairing.paired, self.pairing.normal, tau, traction
        )
        return traction, status

    def _add_tangent(self, tau, operators, local):
        p, source = self.pairing, self.source
        return friction.add_tangent(
            self.theta, self.alpha, self._law, self.bilateral, p.paired, source.jxw, self.gamma, tau, p.cells,
            p.targets, source.facet, source.shape, p.target_shape, source.grad, source.volumetric, source.mu,
            *operators, source.normal, p.normal, self._rowptr, self._columns, local,
        )  # fmt: skip

    def state(self, u):
        """Contact at the quadrature points of this rank. *Collective.*

        Returns
        -------
        dict of str to ndarray
            As for `ContactItem`, with ``status`` 0 open, 1 stick, 2 slip, and ``slip`` (np, d), the tangential slip of
            the load step [length], and ``own_traction`` (np, d), that of the source's stress.
        """
        state = super().state(u)
        p = self.pairing
        own, tau, jump = self._tau(p.exchange.gather(u), p.every)
        traction, status = self._project(tau)
        slip = jump - self._start
        slip -= np.einsum("pd,pd->p", slip, p.normal)[:, None] * p.normal
        state["status"] = np.where(state["status"] > OPEN, status, OPEN)
        slip = np.where(p.paired[:, None], slip, 0.0)
        return {**state, "traction": traction, "own_traction": own, "slip": slip}
