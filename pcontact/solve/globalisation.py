"""How far a Newton step goes, and which points stay open in the iteration after it.

How far to go along a Newton step: to where the residual no longer points along it.
"""

import numpy as np

from pcontact.runtime.petsc import MPI

# [-] Part of the residual's first component along the step that may be left. Row: line_search.
ENOUGH = 0.1
# [-] Part of it that is left behind a full step for which it is worth to go beyond the step. Row: line_search.
BEYOND = 0.03
# [full steps] How far one goes at most. Row: line_search.
FARTHEST = 2.0
# [residuals] Per step. From: seven points, each of which takes INNER of the bracket at least, leave a fifth of it.
RESIDUALS = 8
# [-] Distance from the ends of the bracket that a new point keeps, in parts of the bracket. Row: line_search.
INNER = 0.2


def zero_of(component, first, most=1.0, farthest=FARTHEST):
    """The zero in (0, 2] of a function that is positive at 0, or 1 if it is not negative there.

    Newton's method for a non-smooth equation F(u) = 0 that comes from a monotone operator should go along its step -s y
    until F(u - s y) . y changes its sign; |F| may have to rise on the way. This function of s has nearly straight
    pieces with corners where points open, close, stick or slip, and may turn much steeper at one. The secant method
    then stays before the corner, or jumps to and fro across it; here the zero stays in a bracket (regula falsi with
    halving, M. Dowell and P. Jarratt, BIT 11, 1971, 168-174), which shrinks by a part each time.

    Behind a full step the function is followed by one secant: where a contact loses points from its rim, iteration by
    iteration, it remains positive there.

    Parameters
    ----------
    component : callable
        The function.
    first : float
        Its value at 0.
    most : float
        Where to go at most if a full step goes too far.
    farthest : float
        Where to go at most if it does not.

    Returns
    -------
    float
        Where its magnitude is at most ``ENOUGH`` of ``first``, or smallest among the points that were tried.
    """
    value = component(1.0)
    if not first > 0.0:
        return 1.0
    if value >= -ENOUGH * first:
        left = value / first
        return min(1.0 / (1.0 - left), farthest) if BEYOND < left < 1.0 else 1.0
    if most < 1.0:
        value = component(most)
        if value >= -ENOUGH * first:
            return most
    a, fa, b, fb = 0.0, first, most, value
    best, smallest = most, abs(value)
    side = 0
    for _ in range(RESIDUALS - 1):
        slope = fa - fb
        at = a + (b - a) * (fa / slope if np.isfinite(slope) else 0.5)
        at = min(max(at, a + INNER * (b - a)), b - INNER * (b - a))
        value = component(at)
        if abs(value) < smallest or not np.isfinite(smallest):
            best, smallest = at, abs(value)
        if abs(value) <= ENOUGH * first:
            break
        if value > 0.0:
            a, fa = at, value
            if side > 0:
                fb *= 0.5
            side = 1
        else:
            b, fb = at, value
            if side < 0:
                fa *= 0.5
            side = -1
    return best


def decrease_of(norm, first):
    """The largest of 1, 1/2, 1/4, ... of a step at which the norm of the residual is at most what it was.

    For bodies whose tangent may not be positive, so that the residual along a step says nothing, and that may be turned
    inside out on the way.

    Parameters
    ----------
    norm : callable
        The norm at a part of the step; not finite where the residual has no value.
    first : float
        At 0.

    Returns
    -------
    float
        Where the norm is smallest among the parts that were tried if it nowhere is as small as that.
    """
    best, least, part = 1.0, np.inf, 1.0
    for _ in range(RESIDUALS):
        value = norm(part)
        if value <= first:
            return part
        if value < least:
            best, least = part, value
        part *= 0.5
    return best


# [-] Part of the first Newton step of a load step that is taken where all of it goes too far. From: Hertz, approach
# a^2 / R, overlap a^2 / (2 R): bodies that touch along curved surfaces, moved by half their approach, overlap on the
# area on which they will be in contact. There the statuses of nearly all points are right; moved all the way, twice as
# many close. Row: half_step.
APPROACH = 0.5
# [-] Part of a Newton step that the next one may be as long as where the residual has risen. From: LESS of
# convergence.py. Row: correction.
CONTRACTS = 0.5
# [iterations] In which the residual may stay above the least one of a run where bodies bend. From: the watchdog of R.
# Chamberlain, M. Powell, C. Lemarechal and H. Pedersen, Math. Prog. Study 16 (1982), 1-17; bending scenes of the study
# of robustness take 198 to 212 iterations with 5 to 10, and 223 without. Row: correction.
WATCHED = 8
# [force] Bound of a residual that may be as large as it likes if it has a value. From: the largest double.
ANY = np.finfo(float).max


class Globalisation:
    """Brings Newton's method to where it converges by itself; the solution is never another one.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    balance : pcontact.solve.convergence.Balance or None
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
        self._trial, self._full, self._partly, self._before, self._step = (problem.space.vector() for _ in range(5))
        # where bodies bend: the iterate where the residual was least, and the step from there
        self._lowest = (None, None)
        if problem.bulk.extrapolates and "correction" not in without:
            self._lowest = (problem.space.vector(), problem.space.vector())
        self.begin(False)

    def begin(self, beginning):
        """A run of Newton's method begins; `beginning`: where the last load step has ended."""
        self._begins = beginning
        # rules of an iteration in which points stay open
        self._rules = None
        # those of the next iteration where the contact recedes, once in a run, and the area closed before it did
        self._receding, self._has_receded, self._area = None, False, 0.0
        # part that was taken of a step in which the residual has risen, and its norm at the beginning of that step
        self._risen = None
        # least norm of the residual, and iterations since then
        self._least, self._since = np.inf, 0
        # the residual at the end of a full step, when that has been tried and will be asked for again
        self._known = None

    def end(self):
        """The run has ended, perhaps in the middle of an iteration."""
        self._rules = self._receding = None

    @property
    def rules(self):
        """By which points are open, stick or slip in the next tangent: a tuple of
        `pcontact.assembly.item.StatusRule`, or None where all go by their laws."""
        return self._rules

    def forget(self):
        """Partners have been looked for again: what is known of the last step says nothing any more."""
        self._known = self._receding = self._risen = None
        self._least = np.inf

    def prepare(self, x, f):
        """Before an iteration: where the contact recedes, the residual ``f`` at ``x`` becomes that with some points
        open. *Collective.*"""
        if self._receding is not None:
            self._rules = self._receding
            self._problem.residual(x, f, self._rules)

    def limit(self, x, y, f):
        """Scale the Newton step ``-y`` from ``x``, where the residual is ``f``. *Collective.*"""
        self._rules = None
        if self._goes_back(x, y) or self._starts_again(x, y, f):
            return
        part = 1.0
        if "step_limit" not in self._without:
            falls = None if self._balance is None else self._balance.falls(x, y, f)
            part = self._problem.active.step_limit(x, y, falls)
        if part != 1.0:
            y.scale(part)
        if self._searches and not self._recedes(x, y, part == 1.0):
            if self._bends(x, y):
                y.scale(self._bend(1.0, f.norm()))
            else:
                self._least = np.inf
                self._follow(x, y, f, 1.0 if part != 1.0 else FARTHEST)

    def _bends(self, x, y):
        """Whether bodies that may turn bend in a full step, and no point opens or closes. *Collective.*

        Slender bodies stretch by the square of a step in which they bend, and are much stiffer along than across: the
        norm of the residual rises a thousandfold in steps that go the right way, and the next step takes it away. There
        the residual is no measure of a step; the length of the next one is.
        """
        if not self._problem.bulk.extrapolates or "correction" in self._without:
            return False
        self._go(x, y, 1.0)
        if self._problem.active.turned(self._trial)[1:3].any():
            return False
        x.copy(self._before)
        y.copy(self._step)
        self._begins = False
        return True

    def _bend(self, most, first):
        """The largest of ``most``, half of it, ... of the kept step after which the residual has a value. Where its
        norm is more than ``first`` the next step will be the judge. *Collective.*"""

        part = most * self._part(self._before, self._step, ANY, most)
        self._risen, self._known = (part, first) if self._full.norm() > first else None, self._full
        return part

    def _goes_back(self, x, y):
        """Whether the kept step is taken back, since the residual has risen in it and the Newton step after it, ``-y``
        from ``x``, is hardly shorter: then ``-y`` becomes the way to half of it. *Collective.*"""
        risen, self._risen = self._risen, None
        if risen is None or y.norm() <= CONTRACTS * self._step.norm():
            return False
        self._go(self._before, self._step, self._bend(0.5 * risen[0], risen[1]))
        y.waxpy(-1.0, self._trial, x)
        return True

    def _starts_again(self, x, y, f):
        """Whether full steps of bodies that bend have come to nothing: then ``-y`` becomes the way to where the
        residual is less than it ever was, on the step from where it was least. *Collective.*"""
        if not self._problem.bulk.extrapolates or "correction" in self._without:
            return False
        lowest, step = self._lowest
        if f.norm() < self._least:
            self._least, self._since = f.norm(), 0
            x.copy(lowest)
            y.copy(step)
        self._since += 1
        if self._since <= WATCHED:
            return False
        least, self._least, self._risen, self._known = self._least, np.inf, None, self._full
        step.scale(self._part(lowest, step, least))
        y.waxpy(1.0, step, x)
        y.axpy(-1.0, lowest)
        return True

    def _part(self, x, y, bound, most=1.0):
        """The largest of 1, 1/2, ... of ``most`` of a step after which the norm of the residual is at most ``bound``.
        *Collective.*"""

        def norm(part):
            self._go(x, y, most * part)
            self._problem.residual(self._trial, self._full)
            return self._full.norm()

        return decrease_of(norm, bound)

    def _recedes(self, x, y, full):
        """Whether the step, if it is a full one, is taken since the contact recedes in it. *Collective.*

        See :meth:`pcontact.solve.active_sets.ActiveSets.recede`. The residual has no say about such a step: each
        iteration leaves fewer points closed than the one before, and so they come to an end.
        """
        going, self._receding = self._receding is not None, None
        if not full or self._has_receded or "opening" in self._without:
            return False
        self._go(x, y, 1.0)
        self._receding = self._problem.active.recede(self._trial, self._area if going else None)
        if not going:
            if self._receding is None:
                return False
            self._area = self._problem.active.closed_area()
        # where it ends, the step still goes to the solution under the rules, and the law says what closes there
        self._has_receded = self._receding is None
        self._begins = False
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

        along, turns = f.dot(y), self._problem.bulk.extrapolates
        if turns and (not self._problem.others or not along > 0.0):
            part = decrease_of(norm, f.norm())
        else:
            # what bends, and not what recedes, leaves a residual behind a full step where bodies turn
            beyond = 1.0 if turns else farthest
            approach = self._approach if self._begins else 1.0
            part = zero_of(component, along, approach, beyond)
            if approach == 1.0 and part < 1.0:
                most = min(f.norm(), norm(part)) if turns else ENOUGH * f.norm()
                part = 1.0 if norm(1.0) <= most else part
        # a step that has been cut says nothing of where it would have ended
        self._begins = False
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
