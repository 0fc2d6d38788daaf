"""Semi-smooth Newton by SNES."""

import time as clock
from dataclasses import replace

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import (
    MPI,
    PETSc,
    diverged_nan,
    forget_pattern,
    free_garbage,
    keep_preconditioner,
    newton_reasons,
)
from pcontact.solve.balance import Balance
from pcontact.solve.diagnosis import diagnose
from pcontact.solve.line_search import FARTHEST, zero_of
from pcontact.solve.linear import Reuse, check_tolerances, newton_defaults, refresh_smoother, solver_defaults
from pcontact.solve.preconditioners.contact import contact_preconditioner, new_preconditioner
from pcontact.solve.preconditioners.deflation import Deflation, deflation
from pcontact.solve.preconditioners.direct import PIVOTS, DirectFallback
from pcontact.solve.result import NewtonResult, combined, cycles, repeats
from pcontact.solve.stability import UNSTABLE, unstable

# part of the first Newton step of a load step that is taken where all of it goes too far. Bodies that touch along
# curved surfaces, moved by half their approach, overlap on the area on which they will be in contact: Hertz, approach
# a^2 / R, overlap a^2 / (2 R). From there the statuses of nearly all points are right; moved all the way, twice as
# many close.
APPROACH = 0.5
# the forces of a solution are known to this part of the first residual at best; so many times the expected rounding
# errors end a method that no longer gets on; they may hide this part of the forces at work at most or, where no force
# is applied, this part of the displacements
ROUNDED, NEARLY, BALANCED, MOVED = 1e-10, 100.0, 1e-3, 1e-9
# a residual of this part of the forces at work is small enough, unless the tolerance is looser
SMALL = 1e-6
# part of the first residual to which a load step is solved as if nothing could slip; the same where bodies may yield
HELD_GOAL, HELD_GOAL_PLASTIC = 0.1, 0.02


def _hear(ksp, iteration, norm):
    """Nothing: signals that have come are dealt with here."""


class Newton:
    """SNES on a :class:`pcontact.solve.problem.Problem`.

    Parameters
    ----------
    problem : Problem
    options : pcontact.runtime.options.Options
    symmetric : bool
        Whether the tangent is symmetric positive definite.
    near_null_space : PETSc.NullSpace
    timing : dict of str to float
        ``assembly`` and ``linear`` seconds are added, and by searches in its iterations ``search``.
    motions : dict of int to ndarray, optional
        What supports leave free, see :func:`pcontact.space.modes.free_motions`: what holds such bodies changes with
        every iteration, and so must the preconditioner.

    Attributes
    ----------
    solver : dict
        What solves the linear systems: ``krylov``, ``preconditioner``, ``rigid_modes`` (near-null space),
        ``symmetric`` (tangent), ``filter`` (none, contact, bodies), ``reused`` (set-up kept between iterations).
    applied, kept_out : dict
        Defaults that were entered into the options database, and those that the user's options kept out.
    norms : list of float
        Of the residual [force] at all iterations of the last load step; each new attempt begins with its first one.
    divisible : bool
        Whether the load step may be made shorter where a solution is in doubt; whoever makes load steps says so.
    """

    def __init__(self, problem, options, symmetric, near_null_space, timing, motions=None):
        self.problem, self.timing = problem, timing
        self._balance = Balance(problem, motions) if motions and not problem.linear else None
        self._options = options
        plastic = problem.yields
        self._without = frozenset(options.get("newton_without") or ())
        self._holds = any(item.can_slip for item in problem.others)
        chosen = not options.given("snes_linesearch_type")
        lags = options.given("snes_lag_preconditioner")
        direct = options.get("pc_type", "gamg") in ("lu", "cholesky")
        # on large surfaces in space, where many points change their status, directions are poor at 1e-3; bodies that
        # yield take as many iterations with it, and stiff contact makes linear solves long
        hard = plastic or any(item.stiff for item in problem.others)
        inexact = 1e-3 if problem.space.dim == 2 or hard else 1e-4
        defaults = newton_defaults(problem.linear, direct, inexact)
        defaults |= solver_defaults(symmetric, problem.space.comm.size) | (PIVOTS if direct else {})
        self.applied, self.kept_out = options.propose(defaults)
        self._fallback = DirectFallback(options, problem.space, "pc_type" in self.kept_out or lags)
        self.snes = PETSc.SNES().create(comm=problem.space.comm)
        self._f, self._trial, self._full, self._partly, self._before = (problem.space.vector() for _ in range(5))
        # the residual at the end of a full step, when that has been tried and will be asked for again
        self._known, self._stretches = None, chosen and not problem.linear and "line_search" not in self._without
        self.snes.setFunction(self._residual, self._f)
        self.snes.setJacobian(self._tangent, problem.matrix.matrix)
        self.snes.setConvergenceTest(self._test)
        self.snes.setLineSearchPreCheck(self._limit)
        self.snes.setUpdate(self._update)
        problem.matrix.matrix.setNearNullSpace(near_null_space)
        self._take_options()
        # Python hears signals only where it runs; a Krylov iteration is long beside the microsecond that this takes
        self.snes.getKSP().setMonitor(_hear)
        patience = options.get("pc_patience")
        self._reuse = None if lags or direct or motions or patience < 0 else Reuse(patience)
        self._filter = deflation(problem, options) or contact_preconditioner(problem, options)
        self.solver = self._solver(symmetric, len(near_null_space.getVecs()))
        self._floor, self._least, self._goal, self._first = 0.0, 0.0, None, None
        self._near, self._follow, self._start = False, None, None
        problem.stabilised = "stabilisation" not in self._without
        self._predicting, self._begins, self._true_first, self._circles = False, False, np.nan, False
        self._approach = 1.0 if "half_step" in self._without else APPROACH
        # status rules of a run, and those of an iteration in which points wait
        self._rules, self._waiting = None, None
        # rules of the next iteration where the contact recedes, once in a run, and the area closed before it did
        self._receding, self._has_receded, self._area = None, False, 0.0
        self.norms, self._norms, self._solved, self._was_full = [], [], [], False
        self.divisible = False

    def _take_options(self):
        """Set up SNES as the options say. *Collective.*"""
        try:
            self.snes.setFromOptions()
            check_tolerances(self.snes, self._options)
        except (PETSc.Error, InputError) as error:
            self.snes.destroy()
            raise (error if isinstance(error, InputError) else self._options.fault(error)) or error from None

    def _solver(self, symmetric, modes):
        return {
            "krylov": self.snes.getKSP().getType(),
            "preconditioner": self._options.get("pc_type", "gamg"),
            "rigid_modes": modes,
            "symmetric": symmetric,
            "filter": {type(None): "none", Deflation: "bodies"}.get(type(self._filter), "contact"),
            "reused": self._reuse is not None,
        }

    def _residual(self, snes, x, f):
        start = clock.perf_counter()
        if not self._recall(x, f):
            self.problem.residual(x, f, self._rules)
        if self._predicting:
            self._true_first = f.norm()
            self.problem.predicted(x, f, self._rules)
        self.timing["assembly"] += clock.perf_counter() - start

    def _update(self, snes, iteration):
        """Before an iteration: where partners have been looked for again, the residual is that among the new ones, and
        where too many points have closed in a full step, that without some of them."""
        x, full = snes.getSolution(), self._was_full
        self._was_full = False
        # a rough solution under another law than the scene's is no place to look from
        if iteration > 0 and self._follow is not None and not self._goal and self._follow(x):
            self._known, full, self._receding = None, False, None
            self.problem.residual(x, self._f, self._rules)
        start = clock.perf_counter()
        if self._receding is not None:
            self._waiting = self._receding
            self.problem.residual(x, self._f, self._waiting)
        if full and "waiting" not in self._without:
            self._waiting = self.problem.defer(self._before, x, self._rules)
            if self._waiting is not None:
                self.problem.residual(x, self._f, self._waiting)
        self.timing["assembly"] += clock.perf_counter() - start

    def _tangent(self, snes, x, matrix, preconditioner):
        start = clock.perf_counter()
        changes = self.problem.pattern_changes
        self.problem.tangent(x, self._waiting or self._rules, self._predicting)
        self._predicting = False
        if self.problem.pattern_changes != changes:
            forget_pattern(snes.getKSP())
            if self._filter is not None:
                self._filter.forget_pattern()
        self.timing["assembly"] += clock.perf_counter() - start
        if self._reuse is not None:
            keep = self._reuse.keep(snes.getKSP(), self.problem.closed_area())
            if self._filter is None:
                keep_preconditioner(snes, keep)
            else:
                self._filter.keep(keep)
            if keep:
                refresh_smoother(snes.getKSP(), matrix)

    def _limit(self, x, y):
        """Prescribed components stay where they are, whatever an inexact linear solve says; loose bodies stay near."""
        self._waiting = None
        array = y.getArray().reshape(self.problem.fixed.shape)
        array[self.problem.fixed] = 0.0
        y.assemble()
        part = 1.0
        if "step_limit" not in self._without:
            falls = None if self._balance is None else self._balance.falls(x, y, self._f)
            part = self.problem.step_limit(x, y, falls)
        if part != 1.0:
            y.scale(part)
        if self._stretches:
            start = clock.perf_counter()
            if not self._recedes(x, y, part == 1.0):
                self._stretch(x, y, 1.0 if part != 1.0 else FARTHEST)
                self._was_full = self._was_full and part == 1.0
            self.timing["assembly"] += clock.perf_counter() - start

    def _recedes(self, x, y, full):
        """Whether the step, if it is a full one, is taken since the contact recedes in it. *Collective.*

        See :meth:`pcontact.solve.problem.Problem.recede`. The residual has no say about such a step: each iteration
        leaves fewer points closed than the one before, and so they come to an end.
        """
        going, self._receding = self._receding is not None, None
        if not full or self._has_receded or "opening" in self._without:
            return False
        x.copy(self._trial)
        self._trial.axpy(-1.0, y)
        self._receding = self.problem.recede(self._trial, self._rules, self._area if going else None)
        if not going:
            if self._receding is None:
                return False
            self._area = self.problem.closed_area()
        # where it ends, the step still goes to the solution under the rules, and the law says what closes there
        self._has_receded = self._receding is None
        x.copy(self._before)
        self._begins, self._was_full = False, self._has_receded
        return True

    def _stretch(self, x, y, farthest):
        """Go to where the residual no longer points along the step; in the first one, not too far, see `APPROACH`."""
        full, partly = self._full, self._partly

        def component(part):
            f = full if part == 1.0 else partly
            x.copy(self._trial)
            self._trial.axpy(-part, y)
            self.problem.residual(self._trial, f, self._rules)
            return f.dot(y)

        part = zero_of(component, self._f.dot(y), self._approach if self._begins else 1.0, farthest)
        # a step that has been cut says nothing of where it would have ended
        self._begins, self._was_full = False, part >= 1.0
        x.copy(self._before)
        if part != 1.0:
            y.scale(part)
            return
        x.copy(self._trial)
        self._trial.axpy(-1.0, y)
        self._known = full

    def _recall(self, x, f):
        """Whether the residual at ``x`` is known already; then it is copied to ``f``. *Collective.*"""
        known, self._known = self._known, None
        if known is None:
            return False
        same = np.array_equal(x.getArray(readonly=True), self._trial.getArray(readonly=True))
        same = self.problem.space.comm.allreduce(same, op=MPI.LAND)
        if same:
            known.copy(f)
        return same

    def _test(self, snes, iteration, norms):
        """Residual against the first one, the forces at work and its rounding errors; the step says nothing here."""
        norm = norms[2]
        reasons = PETSc.SNES.ConvergedReason
        if not np.isfinite(norm):
            return diverged_nan
        if iteration == 0:
            self._norms, self._solved, self._floor = [], [], self._least
        self._solved.append(snes.getLinearSolveIterations())
        if self._first is None:
            # the predicted one may be much larger, and means no more
            self._first = float(np.fmin(norm, self._true_first))
        self._norms.append(norm)
        rtol, atol, _, _ = snes.getTolerances()
        if iteration > 0 and norm > 0.5 * self._norms[-2]:
            self._floor = 8.0 * self.problem.roundoff(snes.getSolution())
        reason = self._ends(snes, iteration, norm, rtol, atol)
        if reason != reasons.ITERATING:
            rests = self._goal or self._balance is None or self._balance.rests(snes.getSolution(), self._f)
            return reason if rests else reasons.ITERATING
        circles = (self._circles and cycles(self._norms)) or repeats(self._norms)
        if circles and "cycles" not in self._without:
            return reasons.DIVERGED_LOCAL_MIN
        return reasons.ITERATING

    def _ends(self, snes, iteration, norm, rtol, atol):
        """Why an iteration ends with this norm of the residual, or that it does not. *Collective.*"""
        reasons = PETSc.SNES.ConvergedReason
        if norm <= atol or (norm <= max(self._floor, self._least) and self._balanced(snes.getSolution(), norm)):
            return reasons.CONVERGED_FNORM_ABS
        if (iteration > 0 or self._near) and norm <= (self._goal or rtol) * self._first:
            if self._goal or self._small(snes.getSolution(), norm, max(rtol, SMALL)):
                return reasons.CONVERGED_FNORM_RELATIVE
            stuck = iteration > 0 and norm <= NEARLY * self._floor and norm > 0.5 * self._norms[-2]
            if stuck and self._balanced(snes.getSolution(), norm):
                return reasons.CONVERGED_FNORM_ABS
        return reasons.ITERATING

    def _balanced(self, u, norm):
        """Whether a residual that rounding errors hide is small against the forces: those of a body that flows without
        bound exceed any load, those of a gap times a huge gamma any stress. Bodies that nothing loads may move without
        any force: there a residual is enough that hardly changes their displacements. *Collective.*"""
        if norm <= BALANCED * self.problem.acting(u):
            return True
        if self.problem.loaded() > 0.0:
            return False
        # bodies that spring back to where they were have no displacements left to compare with
        return norm <= MOVED * max(self.problem.stiffness_scale(x) for x in (u, self._start))

    def _small(self, u, norm, part):
        """Whether a residual is small against the forces at work. The first residual, of bodies whose supports alone
        have moved, is many orders of magnitude larger where one is stiff, or gamma large: its rounding errors may be
        what is left. *Collective.*"""
        if norm <= part * self.problem.acting(u):
            return True
        return norm <= part * ROUNDED * self._first and self._balanced(u, norm)

    def _renew_preconditioner(self):
        """A load step is solved alike whatever came before it, as in a restarted run; a reset GAMG remembers."""
        ksp, prefix = self.snes.getKSP(), self.snes.getOptionsPrefix()
        ksp.reset()
        if self._filter is not None:
            self._filter.attach(ksp, prefix)
        else:
            ksp.setPC(new_preconditioner(ksp.getComm(), prefix))

    def solve(self, u, follow=None):
        """Solve for the displacement at the problem's time, from ``u``. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            With the prescribed displacements entered; overwritten by the solution.
        follow : callable, optional
            Called with every iterate but the first; returns whether it changed the partners of points. *Collective.*

        Returns
        -------
        NewtonResult
        """
        # eight rounding errors per sum of some eighty terms: what an exact solution would leave
        self._least = 8.0 * self.problem.roundoff(u)
        self._renew_preconditioner()
        free_garbage(self.problem.space.comm)
        if self._reuse is not None:
            self._reuse.forget()
        self._first, self._true_first, self.norms = None, np.nan, []
        before, self._follow = u.copy(), follow
        self._start = before
        try:
            outcome = self._solve(u, before)
            if self._fallback.takes_over(outcome):
                self._turn_direct()
                before.copy(u)
                outcome = combined(outcome, self._solve(u, before))
            return outcome
        finally:
            self._follow = None
            if self._filter is not None:
                self._filter.detach(self.snes.getKSP())

    def _solve(self, u, before):
        """Solve by the law and, where that does not converge and there is friction, from where closed points stick.
        *Collective.*

        Where the law has not converged, the load step may be so large that it has several solutions: one that is not
        stable is taken only where the load step is not to be shorter.
        """
        self._circles = self._holds or self.problem.yields
        outcome = self._run(u, True)
        if outcome.converged or not self._holds or "stick_first" in self._without:
            return outcome
        before.copy(u)
        outcome = combined(outcome, self._stick_first(u))
        if not (outcome.converged and unstable(self.problem, u)):
            return outcome
        if self.divisible:
            log.info("time %g: a solution that is not stable is not taken", self.problem.time)
            return replace(outcome, converged=False, reason=UNSTABLE)
        log.warning(
            "time %g: this solution is not stable, and the load step has others, to which shorter ones have not led",
            self.problem.time,
        )  # fmt: skip
        return outcome

    def _stick_first(self, u):
        """Solve roughly as if no closed point could slip, then by the law. *Collective.*

        Newton's method can alternate between two directions in which points may slip; from a state in which they stick
        each goes in that in which its traction exceeds the bound.
        """
        self._goal, self._rules = HELD_GOAL_PLASTIC if self.problem.yields else HELD_GOAL, self.problem.sticking()
        try:
            held = self._run(u, True)
        finally:
            self._goal, self._rules = None, None
        if not held.converged:
            # the law alone did no better
            return held
        self._circles = False
        return combined(held, self._run(u, False))

    @property
    def carried(self):
        """Whether the run has turned to a direct solver (1), which a restarted run goes on with, or not (0)."""
        return float(self._fallback.active)

    @carried.setter
    def carried(self, value):
        if value and self._fallback.choose():
            self._turn_direct()

    def _turn_direct(self):
        """Take the direct solver that the options hold by now. *Collective.*"""
        if self._filter is not None:
            self._filter.detach(self.snes.getKSP())
        self._filter = self._reuse = None
        keep_preconditioner(self.snes, False)
        self.snes.setFromOptions()
        self._renew_preconditioner()

    def free(self):
        """Give the solver back to PETSc, which would keep it and all that it calls. *Collective.*"""
        if self._filter is not None:
            self._filter.free()
        self.snes.destroy()

    def again(self, u, near=False):
        """Solve on from the solution ``u`` of :meth:`solve`, after multipliers or partners have changed. *Collective.*

        Tolerances remain those of the load step; with `near`, a ``u`` that meets them already is left as it is. Returns
        an :class:`NewtonResult`.
        """
        self._near = near
        try:
            return self._run(u, False)
        finally:
            self._near = False

    @property
    def _apart(self):
        """Seconds of what SNES calls back, and that are not those of the linear solves."""
        return self.timing["assembly"] + self.timing["search"]

    def _run(self, u, beginning):
        """One SNES solve, from the beginning of the load step or from elsewhere. *Collective.*"""
        start, before = clock.perf_counter(), self._apart
        self._predicting = beginning and self.problem.predicts and "prediction" not in self._without
        self._begins = beginning
        if beginning and self._balance is not None:
            self._balance.begin(u)
        self._norms, self._solved, self._was_full, self._has_receded = [], [0], False, False
        try:
            self.snes.solve(None, u)
        except PETSc.Error as error:
            # solvers inside solvers read their options when they are first used
            raise self._options.fault(error) or error from None
        finally:
            # a linear solve that fails ends an iteration early
            self._waiting = self._receding = None
        self.timing["linear"] += clock.perf_counter() - start - (self._apart - before)
        reason = self.snes.getConvergedReason()
        if len(self._norms) < 2:
            # a linear solve alone (ksponly) asks for no norm
            self.problem.residual(u, self._f, self._rules)
            self._norms = [*self._norms, self._f.norm()]
        self.norms += self._norms
        return NewtonResult(
            converged=reason > 0,
            newton=self.snes.getIterationNumber(),
            krylov=self.snes.getLinearSolveIterations(),
            reason=newton_reasons.get(reason, str(reason)),
            residual=self._norms[-1] if self._norms else float("nan"),
            initial=self._norms[0] if self._norms else float("nan"),
            detail="" if reason > 0 else self._detail(newton_reasons.get(reason, "")),
            hardest=int(np.diff([*self._solved, self.snes.getLinearSolveIterations()]).max(initial=0)),
        )

    def _detail(self, reason):
        """What a user should look at. *Collective.*"""
        value, point, body = self.problem.worst(self._f)
        parts = diagnose(self.problem, self.snes.getSolution(), reason, self._norms[-1] if self._norms else np.inf)
        parts.append(f"largest residual {value:.3e} at {np.array2string(point, precision=4)} in body {body}")
        for contact in self.problem.contacts:
            last = contact.space.comm.allreduce(np.array(([0, 0, 0] + contact.flips)[-3:]))
            if last.any():
                counts = ", ".join(map(str, last))
                parts.append(f"contact {contact.name}: {counts} points changed in the last iterations")
        return "; ".join(parts)
