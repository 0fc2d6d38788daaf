"""One contact pair with friction."""

import numpy as np

from pcontact.contact import friction
from pcontact.contact.item import ContactItem
from pcontact.contact.laws import OPEN


class FrictionalItem(ContactItem):
    """Contact with friction of one pair by Nitsche's method.

    The slip of a load step is the change of the tangential jump on the present pair of points since the committed
    displacement (and the motion of a rigid obstacle since the committed time), so a point that is handed to another
    target facet carries nothing over and loses nothing.

    Parameters
    ----------
    law : ndarray (3,)
        See `pcontact.contact.laws`.
    alpha : float
        Tangential over normal Nitsche parameter [1].
    others
        See `ContactItem`.
    """

    def __init__(self, space, contact, source, target, radius, law, alpha=1.0, floats=False):
        super().__init__(space, contact, source, target, radius, floats)
        self.law, self.alpha = law, float(alpha)

    def _begin(self, u, time):
        """Remember the jump from which the slip of the step counts."""
        self._before = self._jump(self.pairing.exchange.gather(u))
        if self.rigid:
            self._before += self.target.moved(self.time, time)

    def _couples(self, closed):
        # a bound that does not follow the pressure acts wherever there is a partner
        return self.pairing.paired & (closed | (self.law[1] == 0.0))

    def _jump(self, values):
        p, source = self.pairing, self.source
        jump = np.empty_like(source.x)
        friction.jumps(values, p.cells, p.targets, source.facet, source.shape, p.target_shape, jump)
        return jump

    def _tau(self, values):
        """Boundary traction, augmented traction, jump (np, d)."""
        p, source = self.pairing, self.source
        traction, tau, jump = np.empty_like(source.x), np.empty_like(source.x), self._jump(values)
        friction.tractions(
            values, p.cells, source.facet, source.grad, source.volumetric, source.mu, source.normal, traction
        )
        friction.augment(
            traction, jump, self._before, p.gap0, p.normal, self.gamma, self.alpha, source.facet, tau
        )
        return traction, tau, jump

    def _add_residual(self, values, local):
        p, source = self.pairing, self.source
        traction, tau, _ = self._tau(values)
        friction.add_residual(
            self.theta, self.alpha, self.law, self.bilateral, p.paired, source.jxw, self.gamma, traction, tau, p.cells,
            p.targets, source.facet, source.shape, p.target_shape, source.grad, source.volumetric, source.mu,
            source.normal, p.normal, local,
        )  # fmt: skip

    def _augmented(self, values):
        _, tau, _ = self._tau(values)
        _, status = self._project(tau)
        return tau, status

    def _project(self, tau):
        traction = np.empty_like(tau)
        status = friction.project_all(
            self.law, self.bilateral, self.pairing.paired, self.pairing.normal, tau, traction
        )
        return traction, status

    def _add_tangent(self, tau, local):
        p, source = self.pairing, self.source
        return friction.add_tangent(
            self.theta, self.alpha, self.law, self.bilateral, p.paired, source.jxw, self.gamma, tau, p.cells, p.targets,
            source.facet, source.shape, p.target_shape, source.grad, source.volumetric, source.mu, source.normal,
            p.normal, self._rowptr, self._columns, local,
        )  # fmt: skip

    def state(self, u):
        """Contact at the quadrature points of this rank. *Collective.*

        Returns
        -------
        dict of str to ndarray
            As for `ContactItem`, with ``status`` 0 open, 1 stick, 2 slip, and ``slip`` (np, d), the tangential slip of
            the load step [length].
        """
        state = super().state(u)
        p = self.pairing
        _, tau, jump = self._tau(p.exchange.gather(u))
        traction, status = self._project(tau)
        slip = jump - self._before
        slip -= np.einsum("pd,pd->p", slip, p.normal)[:, None] * p.normal
        state["status"] = np.where(state["status"] > OPEN, status, OPEN)
        return {**state, "traction": traction, "slip": np.where(p.paired[:, None], slip, 0.0)}
