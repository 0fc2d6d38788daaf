"""Semi-smooth Newton by SNES: how far a step goes, which points stay open in the iteration after it, and the solves.

A step goes to where the residual no longer points along it.
"""

import time as clock
from contextlib import contextmanager

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.declared import FORMER_HEURISTICS
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import (
    MPI,
    PETSc,
    forget_pattern,
    free_garbage,
    keep_preconditioner,
    newton_reasons,
)
from pcontact.solve.convergence import LESS, Balance, ConvergenceTest, NewtonResult, combined
from pcontact.solve.diagnosis import diagnose
from pcontact.solve.preconditioners import (
    BY_OPERATOR,
    DIFFERENCES,
    MULTIGRID,
    OF_MULTIGRID,
    PIVOTS,
    Deflation,
    DirectFallback,
    Reuse,
    check_tolerances,
    choose_operator,
    contact_preconditioner,
    deflation,
    factors,
    has_lower_degree,
    lower_degree,
    new_preconditioner,
    newton_defaults,
    preconditioner,
    refresh_smoother,
    solver_defaults,
    solver_vectors,
    warn_of_krylov,
)

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
# [iterations] In which the residual may stay above the least one of a run where bodies bend. From: the watchdog of
# R. Chamberlain, M. Powell, C. Lemarechal and H. Pedersen, Math. Prog. Study 16 (1982), 1-17;
# bending scenes of the study of robustness take 198 to 212 iterations with 5 to 10, and 223 without. Row: correction.
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
        if self._searches and not self._nears(x, y, f.norm()) and not self._recedes(x, y, part == 1.0):
            if self._bends(x, y):
                y.scale(self._bend(1.0, f.norm()))
            else:
                self._least = np.inf
                self._follow(x, y, f, 1.0 if part != 1.0 else FARTHEST)

    def _nears(self, x, y, first):
        """Return True if a full step is taken since something resists every motion of the bodies, as inertia does: such
        a load step begins near where it ends, and no contact travels through bodies. The first step may close too much,
        which the second one undoes; after that a step leaves less than `LESS` of the norm of the residual, `first` at
        ``x``: points that slide forth and back leave as much of it, time after time. *Collective.*"""
        if self._problem.bulk.extrapolates or not any(item.holds for item in self._problem.others):
            return False
        self._go(x, y, 1.0)
        self._problem.residual(self._trial, self._full)
        norm = self._full.norm()
        if not (np.isfinite(norm) and (self._begins or norm <= LESS * first)):
            return False
        self._begins, self._known = False, self._full
        return True

    def _bends(self, x, y):
        """Return whether bodies that may turn bend in a full step, and no point opens or closes. *Collective.*

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
        """Return whether the kept step is taken back, since the residual has risen in it and the Newton step after it,
        ``-y`` from ``x``, is hardly shorter: then ``-y`` becomes the way to half of it. *Collective.*"""
        risen, self._risen = self._risen, None
        if risen is None or y.norm() <= CONTRACTS * self._step.norm():
            return False
        self._go(self._before, self._step, self._bend(0.5 * risen[0], risen[1]))
        y.waxpy(-1.0, self._trial, x)
        return True

    def _starts_again(self, x, y, f):
        """Return whether full steps of bodies that bend have come to nothing: then ``-y`` becomes the way to where the
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
        """Return whether the step, if it is a full one, is taken since the contact recedes in it. *Collective.*

        See :meth:`pcontact.solve.problem.ActiveSets.recede`. The residual has no say about such a step: each
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
        """End of a part of the step."""
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
        """Return whether the residual at ``x`` is known already; then it is copied to ``f``. *Collective.*"""
        known, self._known = self._known, None
        if known is None:
            return False
        same = np.array_equal(x.getArray(readonly=True), self._trial.getArray(readonly=True))
        same = self._problem.space.comm.allreduce(same, op=MPI.LAND)
        if same:
            known.copy(f)
        return same


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
        # yield, or have inertia, take as many iterations with it, and stiff contact makes linear solves long
        holds = self._held = any(item.holds for item in problem.others)
        hard = plastic or holds or any(item.stiff for item in problem.others)
        inexact = 1e-3 if problem.space.dim == 2 or hard else 1e-4
        defaults = newton_defaults(problem.linear, direct, inexact, holds)
        krylov = options.get("ksp_type")
        warn_of_krylov(symmetric, krylov)
        two = has_lower_degree(problem) and options.get("pc_type", "mg") == "mg"
        lower = options.beginning(OF_MULTIGRID) if two else None
        defaults |= solver_defaults(symmetric, problem.space.comm.size, krylov, lower, holds)
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
            resists = self.problem.matrix.matrix.getRowSum().sum() if self.lasting and self._held else 0.0
            keep = self._reuse.keep(snes.getKSP(), self.problem.active.closed_area(), resists)
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
        if not any(name.startswith("ksp_view") for name in PETSc.Options(prefix).getAll()):
            # PETSc 3.18 forgets its viewers, too
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
            if not result.converged and self._reuse is not None:
                self._reuse.forget()
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

    def answer(self, forces, rtol, most):
        """The displacement that the tangent of the last load step answers to forces. *Collective.*

        Parameters
        ----------
        forces : ndarray (n_owned, d)
            [force]
        rtol, most : float, int
            Tolerance of the linear solve, and iterations at most.

        Returns
        -------
        answer : PETSc.Vec or None
            None where there are no forces.
        converged : bool
        """
        problem = self.problem
        residual, step = problem.space.vector(), problem.space.vector()
        problem.as_residual(forces.copy(), residual)
        if residual.norm() == 0.0:
            return None, True
        # a solver of its own: that of Newton's iteration is not left alone; its preconditioner is good enough
        ksp, matrix = PETSc.KSP().create(comm=problem.space.comm), problem.matrix.matrix
        ksp.setType("gmres")
        ksp.setPC(self.last_preconditioner())
        ksp.setOperators(matrix, matrix)
        ksp.setTolerances(rtol=rtol, max_it=most)
        ksp.solve(residual, step)
        converged = ksp.getConvergedReason() > 0
        ksp.destroy()
        problem.conditions.follow(step)
        return step, converged

    @property
    def carried(self):
        """Return whether the run has turned to a direct solver (1), which a restarted run goes on with, or not (0)."""
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
            # what was raised in a callback, above all an interrupt: from 3.26 on it comes as the cause
            if error.__cause__ is not None:
                raise error.__cause__ from None
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
        """Hints for the user: what to look at. *Collective.*"""
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
