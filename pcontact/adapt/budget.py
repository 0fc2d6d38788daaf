"""Cost of the next mesh, and what a target would take."""

from typing import NamedTuple

import numpy as np

from pcontact.adapt.mark import FOLLOWERS, LEAP
from pcontact.adapt.passes import free_memory, memory_each
from pcontact.runtime import profile
from pcontact.runtime.petsc import MPI


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
        free = free_memory() if budget.memory is None else None
        free = comm.allreduce(free if free is not None else np.inf, op=MPI.MIN)
        # what is free is free beside what the ranks have by now
        base = comm.allreduce(profile.memory()[0] * 1024.0)
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
