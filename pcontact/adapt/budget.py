"""What the next mesh may cost."""

import numpy as np

from pcontact.adapt.passes import memory_each
from pcontact.adapt.target import free_memory
from pcontact.runtime import profile
from pcontact.runtime.petsc import MPI

# [-] The neighbours of the cells that are cut follow: unknowns over those expected, before it has been seen.
# From: named_error.py.
FOLLOWERS = 1.4
# [-] Power of the unknowns that the seconds of a pass grow with. From: multigrid, and searches that take a little more.
POWER = 1.1


def costs(passes):
    """Seconds of a pass that do not grow, and those of the last one that grow with the unknowns."""
    last = passes[-1]
    spent = [one.seconds - one.trials for one in passes]
    if len(passes) < 2 or last.unknowns <= passes[0].unknowns:
        # the first one loads what is needed; estimates take about as long as the load steps
        rest = min(2.0 * last.solve, spent[-1])
        return spent[-1] - rest, rest
    first = (passes[0].unknowns / last.unknowns) ** POWER
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
        """Growth of the unknowns of the last pass that the next one may have at most.

        Parameters
        ----------
        passes : list of pcontact.adapt.passes.Pass
        elapsed : float
            Since the beginning [s].
        """
        done = passes[-1]
        limits = {"unknowns": np.inf, "memory": np.inf, "time": np.inf}
        if self._unknowns is not None:
            limits["unknowns"] = self._unknowns / done.unknowns
        limits["memory"] = 1.0 + (self._memory - done.memory) / (memory_each(passes) * done.unknowns)
        if self._time is not None:
            # the clock of one rank is not that of the others
            fixed, rest = costs(passes)
            left = self._comm.bcast(max(self._time - elapsed - fixed, 0.0) / max(rest, 1e-6))
            limits["time"] = left ** (1.0 / POWER)
        self.by = min(limits, key=limits.get)
        return limits[self.by]

    def of_cells(self, growth):
        """Growth of the cells with which the unknowns grow so much, as others follow those that are cut."""
        return growth / self._followers

    def learn(self, growth, expected):
        """Take notice of how many cells have followed those that were cut."""
        self._followers = max(growth / expected, 1.0)
