"""Semi-smooth Newton by SNES."""

import time as clock
from contextlib import contextmanager

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.declared import FORMER_HEURISTICS
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import (
    PETSc,
    forget_pattern,
    free_garbage,
    keep_preconditioner,
    newton_reasons,
)
from pcontact.solve.convergence import Balance, ConvergenceTest
from pcontact.solve.diagnosis import diagnose
from pcontact.solve.globalisation import Globalisation
from pcontact.solve.linear import (
    BY_OPERATOR,
    DIFFERENCES,
    OF_MULTIGRID,
    Reuse,
    check_tolerances,
    choose_operator,
    newton_defaults,
    refresh_smoother,
    solver_defaults,
    solver_vectors,
    warn_of_krylov,
)
from pcontact.solve.lower_degree import has_lower_degree, lower_degree
from pcontact.solve.preconditioners import (
    MULTIGRID,
    PIVOTS,
    Deflation,
    DirectFallback,
    contact_preconditioner,
    deflation,
    factors,
    new_preconditioner,
    preconditioner,
)
from pcontact.solve.result import NewtonResult, combined

# what PETSc keeps with a matrix for differences on its pattern
COLOURING = "SNESMatFDColoring"


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
    modes_at : callable, optional
        Near-null space at a displacement, for bodies that turn: renewed with every load step.
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
    lasting : bool
        Whether a preconditioner may serve several load steps, as it does several iterations: for runs that nothing
        restarts, since then load steps are not solved alike whatever came before them.
    """

    def __init__(self, problem, options, symmetric, near_null_space, timing, motions=None, modes_at=None):
        self.problem, self.timing, self._modes_at = problem, timing, modes_at
        self._loose = sorted(motions or ())
        self._balance = Balance(problem, motions) if motions and not problem.linear else None
        self._options = options
        plastic = problem.bulk.yields
        self._without = frozenset(options.get("newton_without") or ())
        for name in sorted(self._without & set(FORMER_HEURISTICS)):
            log.warning("-newton_without %s: there is no such rule any more", name)
        chosen = not options.given("snes_linesearch_type")
        lags = options.given("snes_lag_preconditioner")
        small = factors(options, problem.space)
        direct = bool(small) or options.get("pc_type", "gamg") in ("lu", "cholesky")
        # on large surfaces in space, where many points change their status, directions are poor at 1e-3; bodies that
        # yield take as many iterations with it, and stiff contact makes linear solves long
        hard = plastic or any(item.stiff for item in problem.others)
        inexact = 1e-3 if problem.space.dim == 2 or hard else 1e-4
        defaults = newton_defaults(problem.linear, direct, inexact)
        krylov = options.get("ksp_type")
        warn_of_krylov(symmetric, krylov)
        two = has_lower_degree(problem) and options.get("pc_type", "mg") == "mg"
        lower = options.beginning(OF_MULTIGRID) if two else None
        defaults |= solver_defaults(symmetric, problem.space.comm.size, krylov, lower)
        defaults |= (PIVOTS if direct else {}) | small
        self.applied, self.kept_out = options.propose(defaults)
        stays = direct or "pc_type" in self.kept_out or lags or "direct" in self._without
        self._fallback = DirectFallback(options, problem.space, stays)
        self._filter = deflation(problem, options) or contact_preconditioner(problem, options)
        self._lower = lower_degree(problem, options)
        base = choose_operator(problem.matrix, options, symmetric, direct, self._filter)
        if base is not problem.matrix.operator and options.get("pc_type") in MULTIGRID:
            self.applied |= options.propose(BY_OPERATOR)[0]
        self.snes = PETSc.SNES().create(comm=problem.space.comm)
        # where the vectors of the linear solves live elsewhere, those that the program computes with are copied there
        self._f, self._u = solver_vectors(problem.space, problem.matrix.operator, options)
        self._globalisation = Globalisation(problem, self._balance, self._without, chosen)
        self._converges = ConvergenceTest(problem, self._balance, self._f)
        self.snes.setFunction(self._residual, self._f)
        self._operators = problem.matrix.operator, base
        self.snes.setJacobian(self._tangent, *self._operators)
        self.snes.setConvergenceTest(self._converges)
        self.snes.setLineSearchPreCheck(self._limit)
        self.snes.setUpdate(self._update)
        base.setNearNullSpace(near_null_space)
        self._take_options()
        # Python hears signals only where it runs; a Krylov iteration is long beside the microsecond that this takes
        self.snes.getKSP().setMonitor(_hear)
        self._reuse = None if lags or direct or motions or "reuse" in self._without else Reuse()
        self.solver = self._solver(symmetric, len(near_null_space.getVecs()))
        # whether a run begins with a prediction; what looks for partners at iterates, while there is such a thing
        self._predicting, self._search = False, None
        # where the load step has begun, and whether the matrix holds a tangent of the last one
        self._start, self._linearised, self.norms, self.lasting = None, False, [], False
        self._differs = any(options.given(name) for name in DIFFERENCES)
        # of the last tangent, where differences of the residual are taken
        self._diagonal = None

    def _take_options(self):
        """Set up SNES as the options say. *Collective.*"""
        try:
            check_tolerances(self._options)
            self.snes.setFromOptions()
        except (PETSc.Error, InputError) as error:
            self.snes.destroy()
            raise (error if isinstance(error, InputError) else self._options.fault(error)) or error from None

    def _solver(self, symmetric, modes):
        return {
            "krylov": self.snes.getKSP().getType(),
            "preconditioner": self._options.get("pc_type"),
            "rigid_modes": modes,
            "symmetric": symmetric,
            "filter": {type(None): "none", Deflation: "bodies"}.get(type(self._filter), "contact"),
            "reused": self._reuse is not None,
        }

    @contextmanager
    def _timed(self):
        """Seconds that count as assembly."""
        start = clock.perf_counter()
        yield
        self.timing["assembly"] += clock.perf_counter() - start

    def _residual(self, snes, x, f):
        with self._timed():
            predicts_alone = self._predicting and self.problem.prediction.goes_on
            if not (predicts_alone or self._globalisation.recall(x, f)):
                self._evaluate(x, f)
            if self._predicting:
                self._predict(x, f, predicts_alone)

    def _evaluate(self, x, f):
        """Residual ``f`` at ``x``, also off the supports where differences are taken: there it is the diagonal of the
        matrix times the distance from what is prescribed, and all others do not hear of it. Its derivative is the
        matrix. *Collective.*"""
        if self._diagonal is None:
            self.problem.residual(x, f)
            return
        away, on = x.copy(), x.copy()
        self.problem.conditions.enter(on, self.problem.time)
        self.problem.residual(on, f)
        away.axpy(-1.0, on)
        away.pointwiseMult(away, self._diagonal)
        f.axpy(1.0, away)

    def _predict(self, x, f, alone):
        """Put the prediction of a load step in the place of its residual ``f`` at ``x``, unless it asks for nothing: it
        says where to begin, and nothing of where to end. With `alone`, ``f`` has no value yet. *Collective.*"""
        # where bodies go on as they did, the prediction is as good as the residual
        first = np.nan if alone else f.norm()
        self.problem.prediction.residual(x, f)
        if self._converges.negligible(f.norm(), first, self.snes.getTolerances()[0]):
            self._predicting, first = False, np.nan
            self.problem.residual(x, f)
        self._converges.predicted, self._converges.predicted_from = self._predicting, first

    def _update(self, snes, iteration):
        """Before an iteration: where partners have been looked for again, the residual is that among the new ones."""
        x = snes.getSolution()
        if iteration > 0 and self._search is not None and self._search(x, self._converges.part):
            self._globalisation.forget()
            self.problem.residual(x, self._f)
        with self._timed():
            self._globalisation.prepare(x, self._f)

    def _tangent(self, snes, x, matrix, base):
        with self._timed():
            changes = self.problem.pattern_changes
            self.problem.tangent(x, self._globalisation.rules, self._predicting)
            self._predicting, self._linearised = False, True
            if self._diagonal is not None:
                self._diagonal = self.problem.matrix.matrix.getDiagonal()
                # products by differences begin at x
                matrix.assemble()
            if self.problem.pattern_changes != changes:
                forget_pattern(snes.getKSP())
                for part in (self._filter, self._lower):
                    if part is not None:
                        part.forget_pattern()
        keep = False
        if self._reuse is not None:
            keep = self._reuse.keep(snes.getKSP(), self.problem.active.closed_area())
            if self._filter is None:
                keep_preconditioner(snes, keep)
            else:
                self._filter.keep(keep)
            if keep:
                refresh_smoother(snes.getKSP(), matrix, base)
        if self._lower is not None and not keep:
            self._lower.renew(preconditioner(snes.getKSP()), base)

    def _limit(self, x, y):
        """Prescribed components stay where they are, whatever an inexact linear solve says, and followers follow."""
        self.problem.conditions.follow(y, x, self._start)
        with self._timed():
            self._globalisation.limit(x, y, self._f)

    def _renew_preconditioner(self):
        """A load step is solved alike whatever came before it, as in a restarted run; a reset GAMG remembers."""
        ksp, prefix = self.snes.getKSP(), self.snes.getOptionsPrefix()
        ksp.reset()
        if self._filter is not None:
            self._filter.attach(ksp, prefix)
        else:
            ksp.setPC(new_preconditioner(ksp.getComm(), prefix))
        if self._lower is not None:
            self._lower.attach(preconditioner(ksp))

    def solve(self, u, follow=None):
        """Solve for the displacement at the problem's time, from ``u``. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            With the prescribed displacements entered; overwritten by the solution.
        follow : callable, optional
            Called with every iterate but the first, and with the part of the largest residual of the run that is left
            at it; returns whether it changed the partners of points. *Collective.*

        Returns
        -------
        NewtonResult
        """
        if self._modes_at is not None:
            self._operators[1].setNearNullSpace(self._modes_at(u))
        if not (self.lasting and self._reuse is not None and self._reuse.begun and self._filter is None):
            self._renew_preconditioner()
            if self._reuse is not None:
                self._reuse.forget()
        if self._differs:
            self._linearise(u)
        free_garbage(self.problem.space.comm)
        before, self._search, self.norms, self._linearised = u.copy(), follow, [], False
        self._start = before
        self._converges.begin_step(before)
        try:
            result = self._run(u, True)
            if self._fallback.takes_over(result):
                self._turn_direct()
                before.copy(u)
                result = combined(result, self._run(u, True))
            return result
        finally:
            self._search = None
            if self._filter is not None:
                self._filter.detach(self.snes.getKSP())

    def stand_alone(self):
        """Have the SNES do what :meth:`solve` does, for a caller who asks it alone. *Collective.*"""
        self._differs = True
        self._renew_preconditioner()
        self.snes.setInitialGuess(lambda snes, x: self._enter(x))

    def begin_alone(self, u):
        """A load step of a caller who asks the SNES alone begins at ``u``. *Collective.*"""
        self._linearise(u)
        self._converges.begin_step(u.copy())

    def _enter(self, x):
        """A run of the SNES begins at ``x``. *Collective.*"""
        self.problem.conditions.enter(x, self.problem.time)
        self._globalisation.begin(True)
        self._converges.begin(near=True)
        if self._reuse is not None:
            self._reuse.forget()
        if self._balance is not None:
            self._balance.begin(x)

    def _linearise(self, u):
        """The pattern, and the diagonal with which the residual is extended, are those of the load step at ``u``, and
        PETSc keeps what it has found of another pattern. *Collective.*"""
        self.problem.tangent(u)
        self._diagonal = self.problem.matrix.matrix.getDiagonal()
        self._operators[1].compose(COLOURING, None)

    def last_preconditioner(self):
        """The preconditioner of the last linear solve, without its filter and as it is, for another Krylov method.
        After a load step that took no iteration the tangent at its solution is written first. *Collective.*

        The next load step begins with one of its own.
        """
        if not self._linearised:
            self.problem.tangent(self.snes.getSolution())
            self._linearised = True
            if self._lower is not None:
                self._lower.renew(preconditioner(self.snes.getKSP()), self._operators[1])
        pc = preconditioner(self.snes.getKSP())
        pc.setReusePreconditioner(True)
        return pc

    @property
    def carried(self):
        """Whether the run has turned to a direct solver (1), which a restarted run goes on with, or not (0)."""
        return float(self._fallback.active)

    @carried.setter
    def carried(self, value):
        if value and self._fallback.choose():
            self._turn_direct()

    @property
    def convergence(self):
        """The :class:`pcontact.solve.convergence.ConvergenceTest`."""
        return self._converges

    def _turn_direct(self):
        """Take the direct solver that the options hold by now. *Collective.*"""
        if self._filter is not None:
            self._filter.detach(self.snes.getKSP())
        self._filter = self._reuse = self._lower = None
        keep_preconditioner(self.snes, False)
        self.snes.setFromOptions()
        self._renew_preconditioner()

    def tell(self, function):
        """Have a function called with the norms of the residual at every iterate."""
        self._converges.told = function

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
        return self._run(u, False, near=near)

    @property
    def _called_back(self):
        """Seconds of what SNES calls back, and that are not those of the linear solves."""
        return self.timing["assembly"] + self.timing["search"]

    def _run(self, u, beginning, near=False):
        """One SNES solve, from the beginning of the load step or from elsewhere; with `near`, it may end where it
        begins. *Collective.*
        """
        start, before = clock.perf_counter(), self._called_back
        predicts = "prediction" not in self._without and not self._differs
        self._predicting = beginning and self.problem.prediction.committed is not None and predicts
        self._globalisation.begin(beginning)
        self._converges.begin(near)
        if beginning and self._balance is not None:
            self._balance.begin(u)
        x = u
        if self._u is not None:
            x = self._u
            u.copy(x)
        try:
            self.snes.solve(None, x)
        except PETSc.Error as error:
            # solvers inside solvers read their options when they are first used
            raise self._options.fault(error) or self._options.unsolved(error, self.problem.space.comm) from error
        finally:
            # a linear solve that fails ends an iteration early
            self._globalisation.end()
            if x is not u:
                x.copy(u)
        self.timing["linear"] += clock.perf_counter() - start - (self._called_back - before)
        reason, norms = self.snes.getConvergedReason(), self._converges.norms
        if len(norms) < 2:
            # a linear solve alone (ksponly) asks for no norm
            self.problem.residual(u, self._f)
            norms = [*norms, self._f.norm()]
        self.norms += norms
        return NewtonResult(
            converged=reason > 0,
            newton=self.snes.getIterationNumber(),
            krylov=self.snes.getLinearSolveIterations(),
            reason=newton_reasons.get(reason, str(reason)),
            residual=norms[-1],
            initial=norms[0],
            detail="" if reason > 0 else self._detail(newton_reasons.get(reason, ""), norms[-1]),
            hardest=int(np.diff([*self._converges.krylov, self.snes.getLinearSolveIterations()]).max(initial=0)),
        )

    def _detail(self, reason, norm):
        """What a user should look at. *Collective.*"""
        value, point, body = self.problem.forces.worst(self._f)
        direct = preconditioner(self.snes.getKSP()).getType() in ("lu", "cholesky")
        parts = diagnose(self.problem, self.snes.getSolution(), reason, norm, self._loose, direct)
        parts.append(f"largest residual {value:.3e} at {np.array2string(point, precision=4)} in body {body}")
        for contact in self.problem.contacts:
            last = contact.space.comm.allreduce(np.array(([0, 0, 0] + contact.flips)[-3:]))
            if last.any():
                counts = ", ".join(map(str, last))
                parts.append(f"contact {contact.name}: {counts} points changed in the last iterations")
        return "; ".join(parts)
