"""The terms of a pair with friction: all of the traction.

The slip of a load step counts from the tangential jump of the committed displacement on the present pair of points
(plus what a rigid obstacle has moved since the committed time), so a point that is handed to another target facet
loses nothing. Traction and law agree weakly: at a point that sticks the jump differs from its reference by

    lag = (t_T - P_T) / (alpha gamma),

small with the mesh. The lag is taken off the next reference. Each load step would otherwise start from the jump as it
is, and stick would creep by the lag in every step. Points that stick carry the lag's local average, over the patches of
the shape functions: its changes from point to point are those of the stress of the cells and of meshes that do not
match, and would add up from step to step. Points that slip carry their own: they stay at their bound. Without a
traction of the source (penalty) the lag is that of the spring which bears the traction, exact at a point.

A tied point obeys the law of stick without a bound: the projection is the identity, P = tau, and Nitsche's method
becomes that of an interface condition [[u]] = 0,

    R  = - int tau . [[v]] + theta int (tau - t) . G^-1 T[v],   tau = t - G [[u]],

without a gap: what lies between the surfaces at the beginning, or how far they overlap, stays there without any force.
The condition is linear. Partners are found once, in the undeformed bodies, and the jump counts from there.
"""

import numpy as np

from pcontact.contact.formulation.averages import patch_means
from pcontact.contact.formulation.frictional_kernels import add_residual, add_tangent, augment, jumps
from pcontact.contact.formulation.frictionless import FrictionlessTerms
from pcontact.contact.law import OPEN, STICK
from pcontact.runtime.parallel import take_rows


def across(vectors, normal):
    """Tangential part (np, d) of vectors."""
    return vectors - np.einsum("pd,pd->p", vectors, normal)[:, None] * normal


class FrictionalTerms(FrictionlessTerms):
    """Residual and tangent of a pair at its points; parameters as for `FrictionlessTerms`, with a law of friction."""

    def __init__(self, space, source, method, traction, law):
        super().__init__(space, source, method, traction, law)
        self._start = self._before = self._lag = np.zeros_like(source.x)

    # -- a load step ----------------------------------------------------------------------------------------------

    def operator(self, normal, last):
        """Of width 0: all of the traction counts."""
        return np.empty((len(normal), 0, normal.shape[1]))

    def begin(self, p, values, moved, turned):
        """Remember the jump at the beginning of the step, and the one from which the law counts slip."""
        super().begin(p, values, moved, turned)
        if not self.law.tied:
            self._start = self._jump(p, values, p.acts) + moved
            self._before = self._start - turned(self._lag)

    def commit(self, p, values, view):
        """Also by how much the jump lags behind the law. *Collective.*"""
        traction, tau = self._augmented(p, values, p.acts)
        force, status = self.law.project(view, p.normal, tau)
        if not self.law.tied:
            lag = (traction - force) / (self.method.alpha * self.method.gamma)[self.source.facet, None]
            stick = status == STICK
            if self.source.grad.shape[1]:
                lag = np.where(stick[:, None], patch_means(self.space, p, self.source, lag, stick), lag)
            self._lag = np.where((status > OPEN)[:, None], across(lag, p.normal), 0.0)
        self.method.commit()
        return status

    def memory(self, keys):
        """See :meth:`FrictionlessTerms.memory`."""
        if self.law.tied:
            return super().memory(keys)
        rows = np.flatnonzero(self._lag.any(axis=1))
        return {"lag": (keys[rows], self._lag[rows]), **super().memory(keys)}

    def recall(self, name, keys, chunks):
        """See :meth:`FrictionlessTerms.recall`."""
        if name != "lag" or self.law.tied:
            return super().recall(name, keys, chunks)
        self._lag = np.zeros_like(self.source.x)
        return take_rows(keys, chunks, self._lag)

    # -- at the points --------------------------------------------------------------------------------------------

    def _jump(self, p, values, wanted):
        out = np.empty_like(self.source.x)
        jumps(values, p.source, p.partner, wanted, out)
        return out

    def gap(self, p, values, wanted=None):
        """Gap (np,) [length], of the points that are wanted (np,)."""
        jump = self._jump(p, values, p.every if wanted is None else wanted)
        return p.gap0 - np.einsum("pd,pd->p", jump, p.normal)

    def _traction(self, p, values, wanted):
        """What stands in the place of the source's traction (np, d)."""
        traction = self.traction.elastic(values, p, wanted)
        self.traction.add_excess(values, p, traction)
        return self.method.traction(traction)

    def normal_state(self, p, values, wanted=None):
        """Normal traction and gap (np,), at least of the points that are wanted (np,)."""
        wanted = p.every if wanted is None else wanted
        traction = np.einsum("pd,pd->p", self.traction.elastic(values, p, wanted), p.normal)
        self.traction.add_normal_excess(values, p, traction)
        return self.method.normal_traction(traction, p.normal), self.gap(p, values, wanted)

    def _augmented(self, p, values, wanted):
        """Boundary traction and augmented traction (np, d) of the points that are wanted (np,)."""
        traction, jump, tau = self._traction(p, values, wanted), self._jump(p, values, wanted), np.empty_like(p.normal)
        augment(self.method.parameters, p.source, p.partner, traction, jump, self._before, wanted, tau)
        return traction, tau

    def forces(self, p, values, view):
        """Tractions P (np, d) that act on the source, and status (np,)."""
        return self.law.project(view, p.normal, self._augmented(p, values, p.acts)[1])

    def slopes(self, p, values, view):
        """What :meth:`add_tangent` needs of the law, and status (np,)."""
        tau, d = self._augmented(p, values, p.acts)[1], self.space.dim
        slope = np.zeros((len(tau), d, d))
        _, status = self.law.project(view, p.normal, tau, slope)
        return (status, slope), status

    def derivative(self, p, values, view):
        """See :meth:`FrictionlessTerms.derivative`."""
        return self.slopes(p, values, view)[0][1]

    # -- residual and tangent -------------------------------------------------------------------------------------

    def add_residual(self, p, values, view, local):
        """Add to forces ``local`` (n, d)."""
        traction, tau = self._augmented(p, values, p.acts)
        force, status = self.law.project(view, p.normal, tau)
        add_residual(self.method.parameters, p.source, p.partner, traction, force, status, local)
        if self.traction.consistent:
            self.traction.add_adjoint(values, p, self._weights(p, traction, force), local)

    def _weights(self, p, traction, force):
        """What the adjoint operator is tested with: theta G^-1 (P - t) (np, d), times the weights of the points."""
        rest, method = force - traction, self.method
        tangential = across(rest, p.normal)
        factor = method.theta * self.source.jxw / method.gamma[self.source.facet]
        return factor[:, None] * (rest - tangential + tangential / method.alpha[self.source.facet, None])

    def add_tangent(self, p, values, view, slopes, blocks):
        """Add to blocks (BlockRows); returns how many entries had no place."""
        excess = self.traction.excess(values, p)
        missing = add_tangent(self.method.parameters, p.source, p.partner, excess, *slopes, blocks)
        if self.traction.consistent:
            traction, tau = self._augmented(p, values, p.acts)
            force, _ = self.law.project(view, p.normal, tau)
            missing += self.traction.add_curvature(values, p, self._weights(p, traction, force), blocks)
        return missing

    def slip(self, p, values):
        """Tangential slip (np, d) of the load step [length], zero without a partner."""
        slip = across(self._jump(p, values, p.every) - self._start, p.normal)
        return np.where(p.paired[:, None], slip, 0.0)

    # -- report ---------------------------------------------------------------------------------------------------

    def state(self, p, values, view):
        """``traction`` with its tangential part, ``status``, ``slip`` of the load step (np, d) [length], and
        ``own_traction`` (np, d), that of the source's stress."""
        own, tau = self._augmented(p, values, p.every)
        traction, status = self.law.project(view, p.normal, tau)
        return {"traction": traction, "own_traction": own, "slip": self.slip(p, values), "status": status}
