"""A soft layer between the bodies: the contact pressure is a given function of the overclosure h = -g.

The layer has no mesh and no inertia of its own: at each quadrature point the normal part of the augmented traction is

    tau_n = -p(h),    dtau_n / dg = p'(h) = r gamma,

in the place of gamma g of the penalty method, all else is that of it: R = - int P . [[v]] with P = project(tau), so
that any law of friction acts under the pressure of the layer, and points stick by springs of the stiffness alpha gamma.
The curve p is piecewise linear and does not decrease. Where it has not begun yet, h < h_0, tau_n = gamma (g + h_0) is
positive: open.

The kernels of the penalty method take a traction that is linear in the gap. Let tau be theirs, with tau_n = gamma g,
and P'(tau) = P(f(tau_n) n + tau_T), f the curve over tau_n. Then dP'/dtau = D (r n n + (I - n n)). The tangent of the
penalty method with this derivative in the place of D is that of the layer, at finite motion, too: P' is isotropic as P
is. So curves need no kernels of their own.

Pressure is per undeformed area of the source, as all tractions of contact at finite motion are.
"""

import numpy as np

from pcontact.contact.formulation.finite import FiniteTerms
from pcontact.contact.formulation.methods import STIFF, TRACELESS, Penalty
from pcontact.contact.formulation.small import SmallTerms


class Layer(Penalty):
    """The penalty method with a curve for the pressure.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With `pressure_overclosure`.
    trace : ndarray (np,)
        Constant of the trace inequality of the parent cells of the points [stress/length].
    softest : float
        The smallest one of all ranks [stress/length].

    Attributes
    ----------
    overclosure, pressure : ndarray (n,)
        Corners of the curve [length], [stress].
    slope : ndarray (n - 1,)
        Between them; the last one goes on [stress/length].
    begins : float
        Gap below which there is a pressure [length].
    """

    def __init__(self, contact, trace, softest):
        super().__init__(contact, trace)
        curve = contact.pressure_overclosure
        rows = np.array(curve if isinstance(curve, tuple | list) else ((0.0, 0.0), (1.0, curve)), dtype=float)
        self.overclosure, self.pressure = rows.T.copy()
        self.slope = np.diff(self.pressure) / np.diff(self.overclosure)
        self.begins = -float(self.overclosure[0])
        self._sticks = contact.stick_stiffness
        if self._sticks is not None:
            self._default = self.gamma = np.full_like(trace, self._sticks / self.alpha)
        self._steepest = float(self.slope.max())
        self._stiff = self._steepest > STIFF * TRACELESS["penalty"] * softest
        # what holds in tension goes on as it begins
        self._before = self.slope[0] if contact.bilateral else None

    @property
    def stiff(self):
        """Return True if multigrid alone fares badly."""
        return self._stiff

    @property
    def firmest(self):
        """See :attr:`Method.firmest`."""
        return np.maximum(self.gamma, self._steepest)

    def begin(self, growth=None):
        """See :meth:`Method.begin`: a stiffness that is said does not depend on cells."""
        super().begin(growth if self._sticks is None else None)

    def normal(self, gap):
        """The curve at gaps (np,) of the points.

        Returns
        -------
        tau : ndarray (np,)
            Augmented normal traction [stress].
        ratio : ndarray (np,)
            Its derivative over gamma.
        """
        closing, gamma = -gap, self.gamma
        piece = np.searchsorted(self.overclosure, closing, side="left") - 1
        inside = np.clip(piece, 0, len(self.slope) - 1)
        tau = -(self.pressure[inside] + self.slope[inside] * (closing - self.overclosure[inside]))
        # the corner at which the curve begins belongs to it
        ahead = closing < self.overclosure[0]
        before = gamma if self._before is None else self._before
        tau = np.where(ahead, before * (self.overclosure[0] - closing), tau)
        return tau, np.where(ahead, before, self.slope[inside]) / gamma


def turned(slope, ratio, normal):
    """Derivatives (np, m, m) of a law, times r n n + (I - n n) with ratios r (np,) and normals n (np, m)."""
    along = np.einsum("pij,pj->pi", slope, normal)
    return slope + (ratio - 1.0)[:, None, None] * along[:, :, None] * normal[:, None, :]


class LayerTerms(SmallTerms):
    """Residual and tangent of a pair with a layer; parameters as for `SmallTerms`."""

    def normal_state(self, p, values, wanted=None):
        """Normal traction, so that gamma times the gap makes it that of the layer, and gap (np,)."""
        gap = self.gap(p, values, wanted)
        return self.method.normal(gap)[0] - self.method.gamma * gap, gap

    def _augmented(self, p, values, wanted):
        traction, tau = super()._augmented(p, values, wanted)
        return traction, layered(self.method, p.operator.normal, tau)[0]

    def slopes(self, p, values, view):
        """Derivatives of the law that :meth:`add_tangent` needs, and status (np,)."""
        (status, slope), _ = super().slopes(p, values, view)
        ratio = self.method.normal(self.gap(p, values, p.acts))[1]
        return (status, turned(slope, ratio, p.operator.normal)), status

    def state(self, p, values, view):
        """See :meth:`SmallTerms.state`; the source's stress does not enter."""
        return {**super().state(p, values, view), "normal_stress": np.zeros(len(p.paired))}


class FiniteLayerTerms(FiniteTerms):
    """Residual and tangent of a pair with a layer at finite motion; parameters as for `FiniteTerms`."""

    @property
    def parameters(self):
        """Weights of the terms; a layer is pressed together at solutions, however deep that is."""
        return super().parameters._replace(depth=np.full(len(self.source.size), np.inf))

    def normal_state(self, p, values, wanted=None):
        """See :meth:`LayerTerms.normal_state`. *Collective.*"""
        gap = self._gap(p, values, self.place(p, values))
        return self.method.normal(gap)[0] - self.method.gamma * gap, gap

    def _projected(self, view, normal, tau, slope):
        tau, ratio = layered(self.method, normal, tau)
        force, status = super()._projected(view, normal, tau, slope)
        if len(slope):
            slope[:] = turned(slope, ratio, normal)
        return force, status


def layered(method, normal, tau):
    """Augmented tractions (np, m) of the layer and ratios (np,), from those of the penalty method."""
    pushed = np.einsum("pd,pd->p", tau, normal)
    along, ratio = method.normal(pushed / method.gamma)
    return tau + (along - pushed)[:, None] * normal, ratio
