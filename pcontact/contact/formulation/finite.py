"""The terms of a pair at finite motion, with friction and without: all of the traction, and what moves with the bodies.

The lag of the law behind the slip of a load step is taken off the next reference, as in
`pcontact.contact.formulation.frictional`; it is a vector in the committed state, which the convected slip carries on.
Multipliers of the augmented Lagrangian method do not turn within a run of Newton's method; the updates around it turn
them, and nothing is left of that where they have settled.

With the ratio w = |F^-T N| of the committed state, the largest one on a facet, gamma grows by (1 + ln w) w^2 where that
is more than 1: the constant of the trace inequality of a cell that has been compressed along its normal does so.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.formulation.averages import patch_means
from pcontact.contact.formulation.finite_geometry import Motion, evaluate, point_work, stretch
from pcontact.contact.formulation.finite_kernels import (
    FiniteParameters,
    add_residual,
    add_tangent,
    augment,
    tangent_work,
)
from pcontact.contact.formulation.frictional import across
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.runtime.parallel import take_rows


class Contact(NamedTuple):
    """What :func:`pcontact.contact.formulation.finite_geometry.evaluate` finds, with the partner and motion it had."""

    partner: object
    motion: Motion
    live: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    slip: np.ndarray
    shape: np.ndarray
    xi: np.ndarray


class Acting(NamedTuple):
    """Tractions of the points: t, tau, P (np, d) [stress], status (np,), D (np, d, d) or of length 0."""

    traction: np.ndarray
    tau: np.ndarray
    force: np.ndarray
    status: np.ndarray
    slope: np.ndarray


class FiniteTerms:
    """Residual and tangent of a pair at its points, as functions of nodal values (n, d) and the view of a rule.

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : pcontact.contact.surface.sides.SourceSurface
    method : pcontact.contact.formulation.methods.Method
    traction : pcontact.contact.traction.finite.FiniteTraction or NoTraction
    law : pcontact.contact.law.Frictionless
    """

    def __init__(self, space, source, method, traction, law):
        self.space, self.source, self.method, self.traction, self.law = space, source, method, traction, law
        self.slides, alpha = law.tangential, method.alpha if law.tangential else 0.0
        self._weights = method.theta, alpha, 1.0 / alpha if law.tangential else 0.0
        self._gamma, self._lag = method.gamma, np.zeros_like(source.x)
        # that of the load step; what the next one will start from is known when this one has been committed
        self._carried = self._lag
        self._before = self._adjoint = None

    # -- a load step ----------------------------------------------------------------------------------------------

    def begin(self, p, values, moved):
        """A load step begins, with a pairing and the committed displacements (n, d)."""
        self.method.begin()
        self._before, self._carried = values, self._lag
        w = np.empty(len(p.cells))
        stretch(p.points, self.source.grad, values, w)
        w = np.maximum(w, 1.0)
        self.method.gamma = self._gamma * ((1.0 + np.log(w)) * w**2)
        d, nn = self.space.dim, p.cells.shape[1]
        self._adjoint = np.zeros((0, nn, d, d))
        if self.method.theta != 0.0:
            self._adjoint = self.traction.slopes(values, p, p.every, elastic=True).rows

    def commit(self, p, values, view):
        """The load step has ended; returns the status (np,) of the points. *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact)
        if self.slides and not self.law.tied:
            lag = (at.traction - at.force) / (self.method.alpha * self.method.gamma[self.source.facet])[:, None]
            stick = at.status == STICK
            if self.method.has_traction:
                lag = np.where(stick[:, None], patch_means(self.space, p, self.source, lag, stick), lag)
            self._lag = np.where((at.status > OPEN)[:, None], across(lag, contact.normal), 0.0)
        self.method.commit()
        return at.status

    def memory(self, keys):
        """Tables for a checkpoint, see `pcontact.assembly.item.Item.memory`."""
        rows = np.flatnonzero(self._lag.any(axis=1))
        lag = {"lag": (keys[rows], self._lag[rows])} if self.slides and not self.law.tied else {}
        return {**lag, **self.method.memory(keys)}

    def recall(self, name, keys, chunks):
        """Take a table back, see `pcontact.assembly.item.Item.recall`."""
        if name != "lag" or not self.slides or self.law.tied:
            return self.method.recall(name, keys, chunks)
        self._lag = np.zeros_like(self.source.x)
        return take_rows(keys, chunks, self._lag)

    # -- at the points --------------------------------------------------------------------------------------------

    @property
    def parameters(self):
        """Weights of the terms."""
        return FiniteParameters(*self._weights, self.method.gamma)

    def _work(self, p):
        return point_work(self.space.dim, p.points.on.shape[1] + p.targets.shape[1])

    def place(self, p, values, slides=False, tangent=False):
        """Normal, gap and partner at nodal values (n, d), see :func:`evaluate`; with slip where it `slides`.
        *Collective.*
        """
        partner = p.partner_at(values, tangent)
        motion = Motion(p.x, values, values if self._before is None else self._before, self._carried)
        return self._placed(p, partner, motion, slides)

    def _placed(self, p, partner, motion, slides):
        d, n, width = self.space.dim, len(p.paired), p.targets.shape[1]
        found = Contact(
            partner, motion, np.empty(n, dtype=bool), np.empty((n, d)), np.empty(n), np.empty((n, d)),
            np.empty((n, width)), np.empty((n, 2)),
        )  # fmt: skip
        evaluate(p.points, partner, motion, slides, self._work(p), *found[2:])
        return found

    def _contact(self, p, values, tangent=False):
        return self.place(p, values, self.slides, tangent)

    def _traction(self, p, values, wanted):
        return self.method.traction(self.traction.traction(values, p, wanted))

    def _acting(self, p, values, view, contact, wanted=None, sloped=False):
        """Tractions at the points, an :class:`Acting`."""
        n, d = len(p.paired), self.space.dim
        traction, tau = self._traction(p, values, p.acts if wanted is None else wanted), np.empty((n, d))
        augment(
            self.parameters, p.points.facet, contact.normal, traction, contact.gap, contact.slip, contact.live, tau
        )  # fmt: skip
        view = view._replace(paired=view.paired & contact.live)
        slope = np.zeros((n, d, d)) if sloped else None
        if self.slides:
            force, status = self.law.project(view, contact.normal, tau, slope)
        else:
            tau_n = np.einsum("pd,pd->p", tau, contact.normal)
            closed = self.law.closed(view, tau_n)
            force, status = np.where(closed, tau_n, 0.0)[:, None] * contact.normal, np.where(closed, SLIP, OPEN)
            if sloped:
                slope[closed] = contact.normal[closed, :, None] * contact.normal[closed, None, :]
        return Acting(traction, tau, force, status, slope)

    def gap(self, p, values, wanted=None):
        """Gap (np,) [length]. Without a partner that of a plane across the normal, which the last search has left.
        *Collective.*
        """
        return self._gap(p, values, self.place(p, values))

    def _gap(self, p, values, contact):
        alone = np.flatnonzero(~contact.live)
        gap = contact.gap.copy()
        jump = np.einsum("pa,pad->pd", self.source.shape[alone], values[p.cells[self.source.facet[alone]]])
        jump -= np.einsum("pm,pmd->pd", p.target_shape[alone], values[p.targets[alone]])
        gap[alone] = p.gap0[alone] - np.einsum("pd,pd->p", jump, p.normal[alone])
        return gap

    def approach(self, p, u, y):
        """How far a step -y from u (distributed vectors) closes the gap (np,) [length]. *Collective.*"""
        values = p.exchange.gather(u)
        return self.gap(p, values) - self.gap(p, values - p.exchange.gather(y))

    def normal_state(self, p, values, wanted=None):
        """Normal traction and gap (np,), at least of the points that are wanted (np,). *Collective.*"""
        contact = self.place(p, values)
        traction = self._traction(p, values, p.every if wanted is None else wanted)
        return np.einsum("pd,pd->p", traction, contact.normal), self._gap(p, values, contact)

    def forces(self, p, values, view):
        """Tractions P (np, d) that act on the source, and status (np,). *Collective.*"""
        at = self._acting(p, values, view, self._contact(p, values))
        return at.force, at.status

    def slopes(self, p, values, view):
        """What :meth:`add_tangent` needs of the law, and status (np,). *Collective.*"""
        contact = self._contact(p, values, tangent=True)
        at = self._acting(p, values, view, contact, sloped=True)
        return (contact, at), at.status

    # -- residual and tangent -------------------------------------------------------------------------------------

    def add_residual(self, p, values, view, local):
        """Add to forces ``local`` (n, d). *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact)
        add_residual(
            self.parameters, p.points, contact.partner, contact.shape, contact.normal, at.traction, at.force,
            at.status, self._adjoint, local,
        )  # fmt: skip

    def add_tangent(self, p, values, view, slopes, blocks):
        """Add to blocks (BlockRows); returns how many entries had no place."""
        contact, at = slopes
        wanted = p.every if self.method.theta != 0.0 else at.status > OPEN
        tractions = self.traction.slopes(values, p, wanted)
        return add_tangent(
            self.parameters, p.points, contact.partner, contact.motion, at.traction, at.tau, at.force, at.status,
            at.slope, tractions, self._adjoint, self._work(p),
            tangent_work(self.space.dim, p.cells.shape[1] + p.targets.shape[1]), blocks,
        )  # fmt: skip

    # -- report ---------------------------------------------------------------------------------------------------

    def state(self, p, values, view):
        """What `pcontact.contact.pair.ContactPair.state` says of the points. *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact, p.every)
        along = np.einsum("pd,pd->p", at.force, contact.normal)
        state = {
            "pressure": -along, "gap": self._gap(p, values, contact), "traction": at.force, "normal": contact.normal,
            "status": at.status, "normal_stress": np.einsum("pd,pd->p", at.traction, contact.normal),
            "paired": p.paired & contact.live,
        }  # fmt: skip
        if self.slides:
            # of the load step alone
            motion = contact.motion._replace(lag=np.zeros_like(self._carried))
            slip = self._placed(p, contact.partner, motion, True).slip
            state.update(own_traction=at.traction, slip=slip)
        return state
