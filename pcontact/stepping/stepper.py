"""The loop over load steps: detect, solve, commit, or cut back."""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pcontact.runtime import profile
from pcontact.runtime.errors import StepFailure

# [-] Bodies are expected to move on by so many times their last motion at most. From: a load step is at most twice as
# long as the one before, see Schedule.accept.
ONWARD = 2.0
# [-] And back by so many times at most. From: where loads turn, the way back is the way that is known.
BACK = 1.0
# [search radii] Motion from which on bodies jump, and are not expected to go on so. From: chosen; half of that at which
# the load step is refused.
JUMP = 0.5


@dataclass
class Step:
    """A converged load step.

    Attributes
    ----------
    number : int
    time : float
    newton, krylov : int
        Iterations of the solve that converged.
    cutbacks : int
        Attempts that failed before it.
    residual : float
    norms : list of float
        Of the residual at all iterations.
    begin : float
        Time at its beginning.
    before : PETSc.Vec
        Displacement at its beginning.
    uzawa : dict or None
        Updates of multipliers, see `pcontact.stepping.load_step`.
    hardest : int
        Krylov iterations of the linear solve that took most.
    free : list of int or None
        Loose bodies on which no contact acts, see `pcontact.stepping.loose`.
    partners : dict or None
        What the last search for partners has said, see :class:`pcontact.stepping.load_step.PartnerUpdate`.
    unbalanced : ndarray (n_owned, d) or None
        Internal plus contact minus external forces before the state was committed [force]: where cells have just
        yielded, the consistent adjoint of a committed state is another one.
    """

    number: int
    time: float
    newton: int
    krylov: int
    cutbacks: int
    residual: float
    norms: list = field(default_factory=list)
    begin: float = 0.0
    before: object = None
    uzawa: dict | None = None
    hardest: int = 0
    free: list | None = None
    partners: dict | None = None
    unbalanced: object = None


class Stages(NamedTuple):
    """Parts of solving a load step beside Newton's method; None: nothing.

    Attributes
    ----------
    start : callable, optional
        From the time at which a load step ends to the displacement (n_owned, d) that is expected then, or to None.
    solve : callable, optional
        Solves the load step, see :class:`pcontact.stepping.load_step.PartnerUpdate`; None: Newton's method alone.
    rest : callable, optional
        After that, says where bodies are that nothing holds, see :class:`pcontact.stepping.loose.LooseBodies`.
    energy : pcontact.stepping.energy.EnergyBalance, optional
        Sums up the works of the load step.
    through : pcontact.stepping.snaps.Snaps, optional
        Leads bodies on that find no equilibrium.
    """

    start: Callable | None = None
    solve: Callable | None = None
    rest: Callable | None = None
    energy: object = None
    through: Callable | None = None


class Stepper:
    """Load steps of a problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    newton : pcontact.solve.newton.Newton
    schedule : pcontact.stepping.schedule.Schedule
    observers : list of pcontact.runtime.observer.Observer
    recorder : callable
        Makes the record of a step, see :class:`pcontact.stepping.record.Recorder`.
    timing : dict of str to float
        ``search`` and ``solve`` seconds are added.
    drive : callable, optional
        Factors (n,) of all that moves or loads the bodies, at a time. It tells how far the bodies will move on.
    stages : Stages, optional

    Attributes
    ----------
    u : PETSc.Vec
        The committed displacement.
    number : int
        Load steps that are done.
    first : float or None
        Time at which the first load step of the run has ended.
    every : bool
        Whether observers are told of every load step; else of the last one alone, unless records sum up works.
    """

    def __init__(self, problem, newton, schedule, observers, recorder, timing, drive=None, stages=None):
        self.problem, self.newton, self.schedule = problem, newton, schedule
        self.observers, self.recorder, self.timing = observers, recorder, timing
        self.u = problem.space.vector()
        self.number, self.first, self.every = 0, None, True
        self._drive, self._last, self._stages = drive, None, Stages() if stages is None else stages

    def resume(self, number, time, first, size, values, last=None):
        """Go on from the committed state of an earlier run. *Collective.*

        Parameters
        ----------
        number : int
            Load steps that are done.
        time, first, size : float
            Time of the state, end of the very first load step, next load step [time].
        values : ndarray (n_owned, d)
            Displacement of the owned nodes [length].
        last : (float, ndarray (n_owned, d)), optional
            Time and displacement at the beginning of the last load step.
        """
        for item in self.problem.items:
            # an initial overlap is that of the first search
            start = self.problem.undeformed(item)
            item.detect(start, first)
            item.commit(start, time)
        self.u.setArray(values.ravel())
        if last is not None:
            self._last = last[0], self._as_vector(last[1])
        self.schedule.resume(time, size)
        self.number, self.first = number, first

    def _set_off(self):
        """Bodies with inertia begin to move, and forces act from the first moment on; or what moves them has a corner.
        *Collective.*"""
        inertia, energy = self.problem.features.inertia, self._stages.energy
        if inertia is None:
            return
        fresh, kinetic = not inertia.begun, inertia.kinetic()
        if not inertia.start(self.problem, self.u, self.schedule.time, self.schedule.next()) or energy is None:
            return
        if fresh:
            energy.set_off(self.u, self.number == 0)
        else:
            energy.take_impulse(self.u, kinetic)

    def run(self):
        """All load steps. *Collective.*

        Raises
        ------
        StepFailure
            When a step does not converge at the smallest size, or at one of which no part would converge either.
        """
        cutbacks = 0
        while not self.schedule.done:
            if not cutbacks and self.schedule.at_turn:
                self._set_off()
            target, begin = self.schedule.next(), self.schedule.time
            committed = self.u.copy()
            result = self._attempt(target, committed)
            stuck = not (result.converged or result.final or self.schedule.divides(target))
            if stuck and self._stages.through is not None:
                for observer in self.observers:
                    observer.cut(target, result)
                self._last = None
                committed.copy(self.u)
                result, committed = self._stages.through(self.u, begin, target, result, self._attempt)
                # works are summed up to the last step of the motion
                begin, cutbacks = target, cutbacks + 1
            error = max((item.error(self.u) for item in self.problem.others), default=0.0) if result.converged else 0.0
            if self.schedule.refuses(target, error):
                result = replace(result, converged=False, reason=f"a local error of {error:.2g} times the allowed one")
            if result.converged:
                told = self._tells(target)
                with profile.phase("output"):
                    unbalanced = self._unbalanced(committed, begin, target) if told else None
                for item in self.problem.items:
                    item.commit(self.u, target)
                self._last = self.schedule.time, committed
                solves = 1 + result.uzawa["updates"] if result.uzawa else 1
                self.schedule.accept(target, result.newton // solves, error)
                self.number += 1
                self.first = target if self.first is None else self.first
                cutbacks, before = 0, cutbacks
                if not told:
                    continue
                step = Step(
                    self.number, target, result.newton, result.krylov, before, result.residual,
                    list(self.newton.norms), *self._last, result.uzawa, result.hardest, result.free,
                    result.partners, unbalanced,
                )  # fmt: skip
                with profile.phase("output"):
                    record = self.recorder(step, self.u)
                    for observer in self.observers:
                        observer.step(step, self.u, record)
                continue
            committed.copy(self.u)
            cutbacks += 1
            if not result.final:
                for observer in self.observers:
                    observer.cut(target, result)
            if result.final or not self.schedule.cut(target):
                raise StepFailure(
                    f"the step from time {self.schedule.time:.6g} to {target:.6g} did not converge ({result.reason}, "
                    f"residual {result.residual:.3e} after {result.newton} iterations, first {result.initial:.3e}"
                    f"{'; ' if result.detail else ''}{result.detail})"
                )

    def _tells(self, target):
        """Return True if observers are told of the load step that ends at a time."""
        if self.every or self.schedule.ends(target):
            return True
        return self._stages.energy is not None or self.problem.features.viscous is not None

    def iterate(self, norms):
        """Tell the observers of an iterate of Newton's method."""
        for observer in self.observers:
            observer.iterate(self.number + 1, self.problem.time, norms)

    def _attempt(self, target, before):
        start, (begin, solve, rest, *_) = clock.perf_counter(), self._stages
        moves = self.problem.features.snap is not None and self.problem.features.snap.moves
        expected = self._expected(target) if begin is None else self._as_vector(begin(target))
        self.problem.time = target
        with profile.phase("search"):
            motion, ahead = self.problem.conditions.imposed(self.u, target), self._ahead(target, expected)
            for item in self.problem.items:
                item.detect(self.u, target, motion, ahead)
        middle, searched = clock.perf_counter(), self.timing["search"]
        with profile.phase("solve"):
            onward = self._continued(target, motion) if self.problem.prediction.continues else None
            self.problem.prediction.begin(self.u, target, onward)
            if expected is not None:
                self.problem.prediction.expect(self.u, expected)
            if rest is not None and self._last is not None:
                rest.begin(self.u)
            result = self.newton.solve(self.u) if solve is None else solve(self.u, before, target)
            if rest is not None and result.converged and not moves:
                result = rest(self.u, before, result)
            self._check_motion(result, before)
        # searches within the solve are counted as such
        again = self.timing["search"] - searched
        self.timing["search"] += middle - start
        self.timing["solve"] += clock.perf_counter() - middle - again
        return result

    def _unbalanced(self, before, begin, target):
        """See :attr:`Step.unbalanced`; works are summed up on the way. *Collective.*"""
        energy = self._stages.energy
        if energy is None:
            return self.problem.unbalanced(self.u)
        return energy.account(self.u, before, begin, target)

    def _way(self, target):
        """Distance that the bodies move if they go on as what drives them does."""
        begin, before = self._last
        past, now, then = (self._drive(time) for time in (begin, self.schedule.time, target))
        last = now - past
        part = float((then - now) @ last) / max(float(last @ last), 1e-300)
        part = min(max(part, -BACK), ONWARD)
        return part * (self.u - before)

    def _continued(self, target, imposed):
        """Displacement if the bodies go on as what drives them does; None before the second load step, and where they
        have jumped beside what is `imposed` on them [length]. *Collective.*"""
        if self._last is None:
            return None
        way = self._way(target)
        if self._jumps(way, imposed):
            return None
        way.axpy(1.0, self.u)
        return way

    def _expected(self, target):
        """Displacement that an item expects at the end of the load step, a vector; None. *Collective.*"""
        found = (item.expected(self.u, target) for item in self.problem.others)
        return self._as_vector(next((one for one in found if one is not None), None))

    def _as_vector(self, values):
        """A displacement (n_owned, d) as a vector; None for None. *Collective.*"""
        return None if values is None else self.problem.space.vector(values)

    def _ahead(self, target, expected=None):
        """Displacement that is expected, or if the bodies move on as what drives them does; None where that tells
        nothing. *Collective.*

        Normals and partners are frozen during a load step. Those of its beginning make forces wrong by an amount of the
        order of the step, those of its expected end by one of its square.
        """
        # where bodies float it is only known where another run has told it
        pairs, known = self.problem.others, self._stages.start is not None and expected is not None
        if not pairs or not known and (any(item.floats for item in pairs) or self._last is None and expected is None):
            return None
        way = self._way(target) if expected is None else expected - self.u
        if self._jumps(way):
            return None
        way.axpy(1.0, self.u)
        return way

    def _jumps(self, way, imposed=0.0):
        """Return True if a motion, beside what is imposed [length], is that of bodies that jump and do not go on so.
        *Collective.*"""
        space = self.problem.space
        longest = space.longest(space.of_owned(way))
        return longest - imposed > JUMP * min((item.radius for item in self.problem.others), default=np.inf)

    def _check_motion(self, result, before):
        """Bodies that moved farther than partners were looked for may have passed through each other."""
        if not result.converged:
            return
        for item in self.problem.others:
            deep = self.problem.space.comm.allreduce(item.too_deep)
            if deep:
                result.converged = False
                result.reason = (
                    f"contact {item.name}: {deep} points are deeper in the obstacle than the search radius "
                    f"{item.radius:.4g}"
                )
            if item.normal_motion(self.u, before) > item.radius:
                result.converged = False
                result.reason = f"contact {item.name}: bodies moved farther than the search radius {item.radius:.4g}"
