"""Decision on another pass, what its mesh is made for, and why the last one is the last."""

import time as clock
from functools import partial
from typing import NamedTuple

import numpy as np

from pcontact.adapt.mark import FOLLOWERS, LEAP, MEASURED, SLOW_GROWTH
from pcontact.adapt.passes import PATIENCE, cost_of, memory_each, said_of
from pcontact.adapt.settings import AIM, FULL, NOTICED, SHARE, THIRD
from pcontact.runtime import log, profile
from pcontact.runtime.petsc import MPI

REACHED, FAILED, SPENT = 0, 1, 4
# [-] Error that is aimed at over the parts that no mesh takes away, where these are more than the target. From: chosen;
# a mesh with half of that error takes several times the cells and brings it down by a quarter.
REACH = 2.0
# [-] Power of the error with which meshes have brought it down, in that of smooth solutions, from which on the rate is
# taken to be known; the same of the second mesh, before there is one. From: Hertz's cylinder and ball, receding
# contact: 0.81 to 0.85; where it is less there are singular points.
TRUST = 0.8


class Decision:
    """Decides after each pass.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
        They follow what a pass says.
    passes : list of pcontact.adapt.passes.Pass
        Those that have run, the last one among them.
    refining : pcontact.adapt.mark.Refining
    comm : MPI.Comm

    Attributes
    ----------
    why : str
        Why the last pass is the last one.
    aim : float
        The error that meshes are made for: the target, or what can be reached where no mesh reaches the target.
    most : float
        Growth of the unknowns that the budget allows the next mesh.
    """

    def __init__(self, target, settings, passes, refining, comm):
        self._target, self._settings, self._passes, self._refining = target, settings, passes, refining
        self._start, self._budget, self.why = clock.perf_counter(), Budgeted(target.budget, comm), ""
        self.aim, self._reached = settings.goal, False

    def next(self, simulation, watch, done):
        """Exit status and None, or None and how to cut the cells of the mesh. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
        watch : pcontact.adapt.passes.Watch
        done : pcontact.adapt.passes.Pass

        Returns
        -------
        status : int or None
            `REACHED` or `SPENT`.
        step : tuple or None
            ``plan(most)``, how cells are cut with a growth of their number at most, and how they are with the one that
            the budget is expected to allow: :class:`pcontact.adapt.mark.Cuts`.
        """
        self._settings.follow(done)
        goal = self._settings.goal
        self.aim = goal if self._target.best else self.aim
        self._reached = done.error <= goal
        if self._reached and done.confirmed:
            return self._spent("")
        space, whole = simulation.problem.space, self._refining.whole
        corner = "; toward corners the square of a pressure need not have an integral: name the error of a force"
        largest = max(done.parts, key=done.parts.get)
        more = corner if largest == "mesh" and done.of.startswith("pressure") else ""
        if self._stalls():
            return self._spent(f"finer meshes do not bring it down, the largest part is {said_of(largest)}{more}")
        stays = self._look_at_what_stays(done)
        if stays and done.error <= self.aim:
            return self._spent(stays)
        self.most = self._budget.most(self._passes, clock.perf_counter() - self._start)
        far = cost_of(self._passes, self.aim)["unknowns"]
        if not self._budget.given and self._alike() > PATIENCE and far > self.most * done.unknowns:
            return self._spent(f"at the rate seen it would take {far:.2g} unknowns, for which there is no memory{more}")
        if FULL * self.most < 1.0:
            return self.spent(), None
        self._asked = most = self._budget.of_cells(self.most)
        pace = LEAP if self._alike() < 2 else np.inf if whole or self._trust(done) > TRUST else SLOW_GROWTH

        def plan(most, divides=False):
            # simplices with the same nodes have another error
            wanted = self.wanted(done, *((TRUST, MEASURED[done.known.dim, done.degree][0]) if divides else ()))
            return self._refining.step(space, watch.squares, wanted, min(most, LEAP if divides else pace), divides)

        step = plan(most)
        if whole and self._divides(simulation, watch, done, step):
            plan = partial(plan, divides=True)
            step = plan(most)
        # a mesh of fewer cells may be the better one: where these are finer than needed they become larger
        if step.part >= 1.0:
            return self.spent(), None
        self._settings.balance(done, self.aim)
        done.next = self.expected(done, step)
        return None, (plan, step)

    def _look_at_what_stays(self, done):
        """Return why the target cannot be reached, where no mesh takes away what it takes; else empty: meshes are made
        for what can be reached."""
        stays, goal = sum(done.parts.get(name, 0.0) for name in self._settings.staying), self._settings.goal
        # no mesh is made for less than this share
        if stays < goal * (1.0 - AIM * SHARE):
            self.aim = goal
            return ""
        largest = max(self._settings.staying, key=lambda name: done.parts.get(name, 0.0))
        said, known = f"{said_of(largest)} alone make {100.0 * stays:.2g} %, which no mesh takes away", self.aim > goal
        self.aim = max(REACH * stays, goal)
        if not known and done.error > self.aim:
            log.warning("%s: on to the %.3g %% that can be reached", said, 100.0 * self.aim)
        return said

    def _divides(self, simulation, watch, done, step):
        """Return True if the cells of a mesh are divided into simplices. *Collective.*"""
        choice, space, growth = self._refining.choice, simulation.problem.space, step.growth
        if 1.0 < growth <= 2.0**space.dim and step.part <= self.wanted(done):
            return choice.once(space.mesh)
        return choice.divides(simulation.scene, space, done, watch.squares, growth > 1.0)

    def _spent(self, why):
        if self._reached:
            self.why = "reached"
            return REACHED, None
        # the least error that the budget allows is there
        self.why = why if self._target.best else f"not reached: {why}"
        return REACHED if self._target.best else SPENT, None

    def expected(self, done, step):
        """Expectation of the pass after a pass whose cells are cut: its `next`."""
        more = MEASURED[done.known.dim, done.degree][0] if step.divided else 1.0
        return {"unknowns": step.growth * done.unknowns,
                "mesh": (more * step.part) ** done.power * done.parts["mesh"],
                "load_steps": self._settings.steps, "degree": done.degree,
                **({"divided": True} if step.divided else {})}  # fmt: skip

    def spent(self):
        """The exit status of a budget that is spent."""
        return self._spent(f"the budget is spent ({self._budget.by})")[0]

    def fits(self, unknowns, done, step):
        """Return True if a mesh with so many unknowns after a pass, which a step has made, is within the budget, and
        the growth of cells to try in its place or None."""
        grown, most = unknowns / done.unknowns, self.most
        self._budget.learn(grown, step.growth)
        fits, limited = grown <= most, step.growth > FULL * self._asked and step.part > self.wanted(done)
        if fits and not (limited and grown < FULL * most):
            return True, None
        self._asked = FULL**0.5 * self._budget.of_cells(most)
        return fits, self._asked

    def wanted(self, done, trust=None, more=1.0):
        """The part of the error of a pass in the energy norm that the next mesh is made for.

        `trust` is that of :meth:`_trust` (absent: as the last meshes show it), `more` the error in the energy norm of
        the mesh that is cut over that of the pass.
        """
        goal, share = self.aim, SHARE * self.aim
        stays = sum(done.parts.get(name, 0.0) for name in self._settings.staying)
        # solved roughly: what is left of it depends on how many ranks there are
        stays += min(done.parts["algebraic"], share) if done.parts["algebraic"] > NOTICED * goal else 0.0
        # what is more than a third is refined
        stays += min(done.parts.get("load_steps", 0.0), THIRD * goal)
        falls, loads = sum(done.parts.get(name, 0.0) for name in self._settings.falling), done.parts.get("loads", 0.0)
        falls -= loads if loads <= NOTICED * self._settings.goal else 0.0
        falls += (more**done.power - 1.0) * done.parts["mesh"]
        part = min(AIM * max(goal - stays, share) / falls, 1.0)
        part = part ** (1.0 / (trust or self._trust(done)))
        # errors of quantities are products of two errors of the energy norm
        return part ** (1.0 / done.power)

    def _trust(self, done):
        """The power of the error in the one that was expected of the last mesh: below 1 where solutions are
        singular."""
        old = self._passes[-2] if len(self._passes) > 1 else None
        if not self._goes_on(old, done):
            return TRUST
        # what estimates are taken for changes when meshes have been compared, and is no rate, either
        same = done.part / old.part
        expected, seen = old.next["mesh"] / old.parts["mesh"], same * done.parts["mesh"] / old.parts["mesh"]
        if not 0.0 < expected < 1.0:
            return 1.0
        return float(np.clip(np.log(seen) / np.log(expected), TRUST, 1.0))

    def _goes_on(self, old, done):
        """Return True if what a pass, or None, was expected to bring says how meshes bring the error down."""
        if old is None or not old.alike(done) or old.next is None or old.next["degree"] != done.degree:
            return False
        # what simplices have more than the cells they were made of is no rate
        return not (old.next.get("divided") or self.tells_nothing(old))

    def tells_nothing(self, done):
        """Return True if the error that a pass names is as large as that of no displacement at all."""
        return done.of == "energy" and done.parts["mesh"] >= 1.0

    def _alike(self):
        """Number of passes with the degree of the last one."""
        return sum(one.degree == self._passes[-1].degree for one in self._passes)

    def _stalls(self):
        """Return True if the last meshes, with `LEAP` times the unknowns, have brought nothing."""
        if self._alike() < PATIENCE:
            return False
        new = self._passes[-1]
        less = [one for one in self._passes if one.alike(new) and one.steps == new.steps
                and LEAP * one.unknowns < new.unknowns]  # fmt: skip
        return bool(less) and new.error >= less[-1].error


def costs(passes):
    """Seconds of a pass that do not grow, and those of the last one that grow with the unknowns, in proportion."""
    last = passes[-1]
    spent = [one.seconds - one.trials for one in passes]
    if len(passes) < 2 or last.unknowns <= passes[0].unknowns:
        # the first one loads what is needed; estimates take about as long as the load steps
        rest = min(2.0 * last.solve, spent[-1])
        return spent[-1] - rest, rest
    first = passes[0].unknowns / last.unknowns
    rest = min(max((spent[-1] - spent[0]) / (1.0 - first), 2.0 * last.solve, 0.0), spent[-1])
    return spent[-1] - rest, rest


class Budgeted:
    """Keeps the passes within a budget.

    Parameters
    ----------
    budget : pcontact.scene.target.Budget
    comm : MPI.Comm

    Attributes
    ----------
    by : str
        Which part of it has been the limit.
    given : bool
        Whether the user names unknowns or a time, which are there to be spent.
    """

    def __init__(self, budget, comm):
        self._unknowns, self._time, self._comm = budget.unknowns, budget.time, comm
        free = profile.free_memory() if budget.memory is None else None
        free = FULL * comm.allreduce(free if free is not None else np.inf, op=MPI.MIN)
        # what is free is free beside what the ranks have by now
        base = comm.allreduce(float(profile.memory()[0]))
        self._memory = budget.memory if budget.memory is not None else base + free
        self._followers, self.by = FOLLOWERS, ""
        self.given = budget.unknowns is not None or budget.time is not None

    def most(self, passes, elapsed):
        """Growth of the unknowns of the last pass that the next one may have at most, so many seconds after the
        beginning."""
        done = passes[-1]
        limits = {"unknowns": np.inf, "memory": np.inf, "time": np.inf}
        if self._unknowns is not None:
            limits["unknowns"] = self._unknowns / done.unknowns
        limits["memory"] = 1.0 + (self._memory - done.memory) / (memory_each(passes) * done.unknowns)
        if self._time is not None:
            # the clock of one rank is not that of the others
            fixed, rest = costs(passes)
            limits["time"] = self._comm.bcast(max(self._time - elapsed - fixed, 0.0) / max(rest, 1e-6))
        self.by = min(limits, key=limits.get)
        return limits[self.by]

    def of_cells(self, growth):
        """Growth of the cells with which the unknowns grow so much, as others follow those that are cut."""
        return growth / self._followers

    def learn(self, growth, expected):
        """Take notice of how many cells have followed those that were cut."""
        self._followers = max(growth / expected, 1.0)


class Forecast(NamedTuple):
    """Expected passes.

    Attributes
    ----------
    unknowns : list of float
        Of the passes, those that have been run among them.
    seconds : float
        Of all passes together.
    memory : float
        Peak of all ranks together [bytes].
    degree : int
    """

    unknowns: list
    seconds: float
    memory: float
    degree: int

    def lines(self, target):
        """For the terminal."""
        meshes = ", ".join(f"{one:.3g}" for one in self.unknowns)
        return [
            f"an error of {100.0 * target.error:.3g} % of {target.of}: about {len(self.unknowns)} passes of degree "
            f"{self.degree} with {meshes} unknowns, {self.seconds:.2g} s, {self.memory / 2.0**20:.3g} MB",
        ]


def forecast(passes, error):
    """The passes (of one degree, at least one) that bring an error, which falls on all meshes to come as it is planned
    for the next one: a :class:`Forecast`."""
    last, unknowns = passes[-1], [float(one.unknowns) for one in passes]
    # neighbours of cells that are cut follow
    growth, part = FOLLOWERS * last.next["unknowns"] / last.unknowns, last.next["mesh"] / last.parts["mesh"]
    far = last.unknowns * growth ** max(np.log(error / last.error) / np.log(part), 1.0)
    while unknowns[-1] < far:
        unknowns.append(min(max(growth, LEAP) * unknowns[-1], far))
    fixed, rest = costs(passes)
    seconds = sum(fixed + rest * one / last.unknowns for one in unknowns) + sum(one.trials for one in passes)
    memory = last.memory + memory_each(passes) * (unknowns[-1] - last.unknowns)
    return Forecast(unknowns, float(seconds), float(memory), last.degree)
