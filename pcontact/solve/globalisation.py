"""How far a Newton step goes, and which points wait in the iteration after it."""

import numpy as np

from pcontact.runtime.petsc import MPI
from pcontact.solve.line_search import FARTHEST, decrease_of, zero_of

# [-] Part of the first Newton step of a load step that is taken where all of it goes too far. From: Hertz, approach
# a^2 / R, overlap a^2 / (2 R): bodies that touch along curved surfaces, moved by half their approach, overlap on the
# area on which they will be in contact. There the statuses of nearly all points are right; moved all the way, twice as
# many close. Row: half_step.
APPROACH = 0.5


class Globalisation:
    """Brings Newton's method to where it converges by itself; the solution is never another one.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    balance : pcontact.solve.balance.Balance or None
        Of loose bodies, if there are some.
    without : set of str
        Heuristics that are left out, see `pcontact.runtime.declared.HEURISTICS`.
    searches : bool
        Whether steps are followed to where the residual has no component along them.
    """

    def __init__(self, problem, balance, without, searches):
        self._problem, self._balance, self._without = problem, balance, without
        self._searches = searches and not problem.linear and "line_search" not in without
        self._approach = 1.0 if "half_step" in without else APPROACH
        self._trial, self._full, self._partly, self._before = (problem.space.vector() for _ in range(4))
        self.begin(False)

    def begin(self, beginning):
        """A run of Newton's method begins; `beginning`: where the last load step has ended."""
        self._begins = beginning
        # rules of an iteration in which points wait
        self._waiting = None
        # those of the next iteration where the contact recedes, once in a run, and the area closed before it did
        self._receding, self._has_receded, self._area = None, False, 0.0
        # the residual at the end of a full step, when that has been tried and will be asked for again
        self._known, self._was_full = None, False

    def end(self):
        """The run has ended, perhaps in the middle of an iteration."""
        self._waiting = self._receding = None

    @property
    def rules(self):
        """By which points are open, stick or slip in the next tangent: a tuple of
        `pcontact.assembly.item.StatusRule`, or None where all go by their laws."""
        return self._waiting

    def forget(self):
        """Partners have been looked for again: what is known of the last step says nothing any more."""
        self._known, self._receding = None, None

    def prepare(self, x, f):
        """Before an iteration: where the contact recedes, or too many points have closed in a full step, the residual
        ``f`` at ``x`` becomes that with some of them open. *Collective.*"""
        full, self._was_full = self._was_full, False
        if self._receding is not None:
            self._waiting = self._receding
            self._problem.residual(x, f, self._waiting)
        if full and "waiting" not in self._without:
            self._waiting = self._problem.defer(self._before, x)
            if self._waiting is not None:
                self._problem.residual(x, f, self._waiting)

    def limit(self, x, y, f):
        """Scale the Newton step ``-y`` from ``x``, where the residual is ``f``. *Collective.*"""
        self._waiting = None
        part = 1.0
        if "step_limit" not in self._without:
            falls = None if self._balance is None else self._balance.falls(x, y, f)
            part = self._problem.step_limit(x, y, falls)
        if part != 1.0:
            y.scale(part)
        if self._searches and not self._recedes(x, y, part == 1.0):
            self._follow(x, y, f, 1.0 if part != 1.0 else FARTHEST)
            self._was_full = self._was_full and part == 1.0

    def _recedes(self, x, y, full):
        """Whether the step, if it is a full one, is taken since the contact recedes in it. *Collective.*

        See :meth:`pcontact.solve.problem.Problem.recede`. The residual has no say about such a step: each iteration
        leaves fewer points closed than the one before, and so they come to an end.
        """
        going, self._receding = self._receding is not None, None
        if not full or self._has_receded or "opening" in self._without:
            return False
        self._go(x, y, 1.0)
        self._receding = self._problem.recede(self._trial, self._area if going else None)
        if not going:
            if self._receding is None:
                return False
            self._area = self._problem.closed_area()
        # where it ends, the step still goes to the solution under the rules, and the law says what closes there
        self._has_receded = self._receding is None
        x.copy(self._before)
        self._begins, self._was_full = False, self._has_receded
        return True

    def _go(self, x, y, part):
        """Where a part of the step ends."""
        x.copy(self._trial)
        self._trial.axpy(-part, y)

    def _follow(self, x, y, f, farthest):
        """Go to where the residual no longer points along the step; in the first one, not too far, see `APPROACH`.

        Where the tangent may not be positive the step may lead away from there: then its norm is to fall. Where bodies
        turn and slide, the residual is curved along the step and hardly points along it: a full step that takes more of
        it away than going there does is taken.
        """
        full, partly, ends = self._full, self._partly, []

        def at(part, out):
            self._go(x, y, part)
            self._problem.residual(self._trial, out)
            return out.dot(y)

        def component(part):
            if part != 1.0:
                return at(part, partly)
            if not ends:
                ends.append(at(part, full))
            return ends[0]

        def norm(part):
            component(part)
            return (full if part == 1.0 else partly).norm()

        along, turns = f.dot(y), self._problem.extrapolates
        if turns and (not self._problem.others or not along > 0.0):
            part = decrease_of(norm, f.norm())
        else:
            # what bends, and not what recedes, leaves a residual behind a full step where bodies turn
            beyond = 1.0 if turns else farthest
            approach = self._approach if self._begins else 1.0
            part = zero_of(component, along, approach, beyond)
            if turns and approach == 1.0 and part < 1.0 and norm(1.0) <= min(f.norm(), norm(part)):
                part = 1.0
        # a step that has been cut says nothing of where it would have ended
        self._begins, self._was_full = False, part >= 1.0
        x.copy(self._before)
        if part != 1.0:
            y.scale(part)
            return
        self._go(x, y, 1.0)
        self._known = full

    def recall(self, x, f):
        """Whether the residual at ``x`` is known already; then it is copied to ``f``. *Collective.*"""
        known, self._known = self._known, None
        if known is None:
            return False
        same = np.array_equal(x.getArray(readonly=True), self._trial.getArray(readonly=True))
        same = self._problem.space.comm.allreduce(same, op=MPI.LAND)
        if same:
            known.copy(f)
        return same
