"""The terms of a pair at finite motion, with friction and without: all of the traction, and what moves with the bodies.

The lag of the law behind the slip of a load step is taken off the next reference, as in
`pcontact.contact.formulation.small`; it is a vector in the committed state, which the convected slip carries on.
Multipliers of the augmented Lagrangian method do not turn within a run of Newton's method; the updates around it turn
them, and nothing is left of that where they have settled.

In the committed state a cell may be stiffer along the normal of its facet than undeformed: compressed, or of rubber
that has been stretched. The constant of its trace inequality grows, and gamma with it: by what the law says
(`pcontact.contact.traction.finite`), and no less than Hencky's law says of a cell that is compressed along the normal
alone, (1 + ln w) w^2 with the ratio w = |F^-T N|, the largest one on a facet. Rubber grows stiffer more slowly there,
but a gamma that follows has load steps of ironing it cut. Tangential tractions need what shear says, which may grow
alone: that of rubber which hardly changes its volume.
"""

from operator import ge
from typing import NamedTuple

import numpy as np

from pcontact.contact.formulation.finite_geometry import (
    Motion,
    Placed,
    evaluate,
    point_work,
    stretch,
    unplaced,
)
from pcontact.contact.formulation.finite_kernels import (
    Acting,
    FiniteParameters,
    add_residual,
    add_tangent,
    augment,
    tangent_work,
)
from pcontact.contact.formulation.small import Terms
from pcontact.contact.law import OPEN, SLIP
from pcontact.runtime.petsc import MPI

# [facet sizes] Overlap beyond which the tangent turns normals and moves partners in part only, see
# `pcontact.contact.formulation.finite_kernels`, in the first tangents of a load step; [tangents] these, and by how many
# more it doubles: what overlaps that much then does so at the solution. From: ball on block, 50,000 unknowns, pressed
# by half a facet in one load step: 6 iterations at 0.03, 9 at 0.1, no convergence without; ironing with coarse cells,
# whose solutions overlap by 0.07.
DEEP, EARLY = 0.03, 3


class Contact(NamedTuple):
    """Places of the points, a :class:`Placed`, with the partner and the motion by which they are there.

    Attributes
    ----------
    partner, motion, placed
    frozen : pcontact.contact.formulation.finite_geometry.FinitePartner
        Of the pairing, with which the partner was found.
    asked : (bool, bool)
        Whether with the curvature of an obstacle, and with slip.
    tractions : list of (ndarray (np,) of bool, ndarray (np, d))
        Points that were asked for their tractions here, and these.
    """

    partner: object
    motion: Motion
    placed: Placed
    frozen: object
    asked: tuple
    tractions: list


class FiniteTerms(Terms):
    """Those of a pair at finite motion; parameters as for `pcontact.contact.formulation.small.Terms`."""

    def __init__(self, space, source, method, traction, law):
        super().__init__(space, source, method, traction, law)
        self.slides = law.tangential
        self._lag = np.zeros_like(source.x)
        # that of the load step; what the next one will start from is known when this one has been committed
        self._carried = self._lag
        self._before = self._adjoint = self._last = None
        self._made = 0

    # -- a load step ----------------------------------------------------------------------------------------------

    def start(self):
        """The next tangent is the first one of a load step."""
        self._made = 0

    def weigh(self, found, nodal):
        """See :meth:`pcontact.contact.formulation.small.SmallTerms.weigh`. *Collective.*"""
        return self.traction.weigh(found, nodal)

    def wide(self, p):
        """See :meth:`pcontact.contact.formulation.small.SmallTerms.wide`."""
        return self.traction.reaches(p)

    def operator(self, normal, last):
        """None: the derivative of the traction is another one at other displacements."""
        return None

    def begin(self, p, values, moved, turned):
        """See :meth:`pcontact.contact.formulation.small.SmallTerms.begin`; the displacements are the
        committed ones."""
        self._before, self._carried, self._last = values, turned(self._lag), None
        w = np.empty(len(p.cells))
        stretch(p.points, self.source.grad, values, w)
        w = np.maximum(w, 1.0)
        growth = self.traction.growth(values, p)
        growth[:, 0] = np.maximum((1.0 + np.log(w)) * w**2, growth[:, 0])
        self.traction.begin(self.method, growth[self.source.facet], values, p)
        d, nn = self.space.dim, p.cells.shape[1]
        self._adjoint = np.zeros((0, nn, d, d))
        if self.method.theta != 0.0:
            self._adjoint = self.traction.adjoint(values, p)

    def commit(self, p, values, view):
        """The load step has ended; returns the status (np,) of the points. *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact)
        self._end_step(p, contact.placed.normal, at.traction, at.force, at.status)
        self._last = None
        return at.status

    # -- at the points --------------------------------------------------------------------------------------------

    @property
    def parameters(self):
        """Weights of the terms."""
        deep = DEEP * 2.0 ** max(0, self._made - EARLY)
        method, none = self.method, np.zeros_like(self.method.alpha)
        alpha, inverse = (method.alpha, 1.0 / method.alpha) if self.slides else (none, none)
        return FiniteParameters(method.theta, alpha, inverse, method.gamma, self._adjoint, deep * self.source.size)

    def place(self, p, values):
        """Places of the points at nodal values (n, d), without slip: a :class:`Placed`. *Collective.*"""
        return self._contact(p, values, slides=False).placed

    def _contact(self, p, values, tangent=False, slides=None):
        """The :class:`Contact` at a displacement, kept for the next who asks at the same one: Newton's method does so
        several times. *Collective.*"""
        before = values if self._before is None else self._before
        asked = tangent and p.obstacle is not None, self.slides if slides is None else slides
        last = self._last
        known = last is not None and last.frozen is p.frozen and last.motion.before is before
        known = known and all(map(ge, last.asked, asked)) and np.array_equal(last.motion.u, values)
        if not self.space.comm.allreduce(known, op=MPI.LAND):
            partner, motion = p.partner_at(values, asked[0]), Motion(p.x, values, before, self._carried)
            self._last = Contact(partner, motion, self._placed(p, partner, motion, asked[1]), p.frozen, asked, [])
        return self._last

    def _placed(self, p, partner, motion, slides):
        d, (n, width) = self.space.dim, p.targets.shape
        placed, work = unplaced(n, d, width), point_work(d, p.points.on.shape[1] + width)
        evaluate(p.points, partner, motion, slides, work, placed)
        return placed

    def _traction(self, p, values, wanted, contact):
        own = next((own for some, own in contact.tractions if some is wanted), None)
        if own is None:
            own = self.traction.traction(values, p, wanted, contact)
            contact.tractions.append((wanted, own))
        return self.method.traction(own)

    def _acting(self, p, values, view, contact, wanted=None, sloped=False):
        """Tractions at the points, an :class:`Acting`."""
        n, d, placed = len(p.paired), self.space.dim, contact.placed
        traction, tau = self._traction(p, values, p.acts if wanted is None else wanted, contact), np.empty((n, d))
        augment(self.parameters, placed, traction, tau)
        view, slope = view._replace(paired=view.paired & placed.live), np.zeros((n if sloped else 0, d, d))
        return Acting(traction, tau, *self._projected(view, placed.normal, tau, slope), slope)

    def _projected(self, view, normal, tau, slope):
        """Traction P (np, d) and status (np,), by normals and augmented tractions (np, d); fills ``slope`` (np, d, d)
        unless it has the length 0."""
        if self.slides:
            return self.law.project(view, normal, tau, slope)
        tau_n = np.einsum("pd,pd->p", tau, normal)
        closed = self.law.closed(view, tau_n)
        if len(slope):
            slope[closed] = normal[closed, :, None] * normal[closed, None, :]
        return np.where(closed, tau_n, 0.0)[:, None] * normal, np.where(closed, SLIP, OPEN)

    def gap(self, p, values, wanted=None):
        """Gap (np,) [length]. Without a partner that of a plane across the normal, which the last search has left.
        *Collective.*
        """
        return self._gap(p, values, self.place(p, values))

    def _gap(self, p, values, placed):
        alone = np.flatnonzero(~placed.live)
        gap = placed.gap.copy()
        jump = np.einsum("pa,pad->pd", self.source.shape[alone], values[p.cells[self.source.facet[alone]]])
        jump -= np.einsum("pm,pmd->pd", p.target_shape[alone], values[p.targets[alone]])
        gap[alone] = p.gap0[alone] - np.einsum("pd,pd->p", jump, p.normal[alone])
        return gap

    def approach(self, p, u, y):
        """Closing of the gap (np,) by a step -y from u (distributed vectors) [length]. *Collective.*"""
        values = p.exchange.gather(u)
        return self.gap(p, values) - self.gap(p, values - p.exchange.gather(y))

    def normal_state(self, p, values, wanted=None):
        """Normal traction and gap (np,), at least of the points that are wanted (np,). *Collective.*"""
        contact = self._contact(p, values, slides=False)
        traction, placed = self._traction(p, values, p.every if wanted is None else wanted, contact), contact.placed
        return np.einsum("pd,pd->p", traction, placed.normal), self._gap(p, values, placed)

    def forces(self, p, values, view):
        """Tractions P (np, d) that act on the source, and status (np,). *Collective.*"""
        at = self._acting(p, values, view, self._contact(p, values))
        return at.force, at.status

    def slopes(self, p, values, view):
        """Derivatives of the law that :meth:`add_tangent` needs, and status (np,). *Collective.*"""
        contact = self._contact(p, values, tangent=True)
        at = self._acting(p, values, view, contact, sloped=True)
        return (contact, at), at.status

    # -- residual and tangent -------------------------------------------------------------------------------------

    def add_residual(self, p, values, view, local):
        """Add to forces ``local`` (n, d). *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact)
        add_residual(self.parameters, p.points, contact.partner, contact.placed, at, local)

    def shifted(self, p, values, view, xi):
        """Forces (n, d) by which those of the adjoint term at nodal values (n, d) would be others with partners at xi
        (np, 2) on their facets. *Collective.*"""
        contact, local = self._contact(p, values), np.zeros_like(values)
        at = self._acting(p, values, view, contact)
        change = self.parameters._replace(adjoint=self.traction.adjoint(self._before, p, xi) - self._adjoint)
        none = at._replace(status=np.full_like(at.status, OPEN))
        add_residual(change, p.points, contact.partner, contact.placed, none, local)
        return local

    def add_tangent(self, p, values, view, slopes, blocks):
        """Add to blocks (BlockRows); returns how many entries had no place."""
        contact, at = slopes
        self._made += 1
        wanted = p.every if self.method.theta != 0.0 else at.status > OPEN
        tractions, others = self.traction.slopes(values, p, wanted, contact=contact), contact.partner.others.shape[1]
        work = tangent_work(self.space.dim, p.cells.shape[1], p.points.on.shape[1], p.targets.shape[1], others)
        return add_tangent(
            self.parameters, p.points, contact.partner, contact.motion, at, tractions, work, blocks
        )  # fmt: skip

    def slip(self, p, values):
        """Tangential slip (np, d) of the load step [length]. *Collective.*"""
        return self._slip(p, self._contact(p, values))

    def _slip(self, p, contact):
        # of the load step alone
        motion = contact.motion._replace(lag=np.zeros_like(self._carried))
        return self._placed(p, contact.partner, motion, True).slip

    # -- report ---------------------------------------------------------------------------------------------------

    def state(self, p, values, view):
        """State of the points, see `pcontact.contact.pair.ContactPair.state`. *Collective.*"""
        contact = self._contact(p, values)
        at = self._acting(p, values, view, contact, p.every)
        placed = contact.placed
        along = np.einsum("pd,pd->p", at.force, placed.normal)
        state = {
            "pressure": -along, "gap": self._gap(p, values, placed), "traction": at.force, "normal": placed.normal,
            "status": at.status, "normal_stress": np.einsum("pd,pd->p", at.traction, placed.normal),
            "paired": p.paired & placed.live,
        }  # fmt: skip
        if self.slides:
            state.update(own_traction=at.traction, slip=self._slip(p, contact))
        return state
