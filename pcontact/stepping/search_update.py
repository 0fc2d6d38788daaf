"""Partners of a load step are looked for again where the bodies have gone, and Newton's method goes on from there."""

import time as clock
from dataclasses import replace

import numpy as np

from pcontact.runtime import profile
from pcontact.solve.result import combined

# [facet sizes] Motion of closed points since the last search up to which their partners are good enough. From: what a
# normal turns on its way to the next facet is of second order in it. Table: updates.
NEAR = 0.1
# [iterations] Of Newton's method after a new search that has changed nothing worth another one. Table: updates.
SETTLED = 1
# [searches] At iterations of a load step at most. Table: updates.
FOLLOWED = 10
# [searches] Where Newton's method that searched at its iterations has ended, at most. Table: updates.
AT_THE_END = 4


class SearchUpdate:
    """Searches after the one that a load step begins with.

    Newton's method always has the exact derivative of what is frozen: partners and normals change between its runs or,
    where it is to follow the bodies, between its iterations, and then residual and tangent are both those among the new
    partners. Bodies that flip between two sets of partners do so a given number of times at most, after which the set
    of the last search stays.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    newton : pcontact.solve.newton.Newton
    most : int
        Searches of a load step where Newton's method has ended.
    follows : bool
        Whether iterations of Newton's method search, too.
    """

    def __init__(self, problem, newton, most, follows=False):
        self.problem, self.newton, self.most, self.follows = problem, newton, most, follows

    def __call__(self, u, before, search):
        """Solve a load step. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            As for :meth:`pcontact.solve.newton.Newton.solve`. Where a run among new partners fails, it gets the
            solution of the last one that did not.
        before : PETSc.Vec
            The committed displacement.
        search : tuple (time, motion, ahead)
            What the items were told for the first search.

        Returns
        -------
        pcontact.solve.result.NewtonResult
            With the iterations of all runs.
        """
        result, since = self._first(u, before, search)
        return self._again(u, before, search, result, since) if result.converged else result

    def _first(self, u, before, search):
        """NewtonResult of the first run, and the displacement among whose partners it ended."""
        time, motion, ahead = search
        since = before if ahead is None else ahead
        if not self.follows:
            return self.newton.solve(u), since
        begin, searched = u.copy(), [since]

        def follow(x, part):
            if len(searched) > FOLLOWED or self._strayed(x, searched[-1]) <= NEAR:
                return False
            searched.append(x.copy())
            self._search(before, time, motion, searched[-1])
            return True

        result = self.newton.solve(u, follow)
        if result.converged or len(searched) == 1:
            return result, searched[-1]
        # partners that come and go: those of the beginning, once
        begin.copy(u)
        self._search(before, time, motion, ahead)
        return combined(result, self.newton.solve(u)), since

    def _again(self, u, before, search, result, since):
        time, motion, _ = search
        for _ in range(self.most):
            if self._strayed(u, since) <= NEAR:
                break
            solved = u.copy()
            self._search(before, time, motion, solved)
            then = self.newton.again(u, near=True)
            both = combined(result, then)
            if not then.converged:
                solved.copy(u)
                self._search(before, time, motion, since)
                return replace(result, newton=both.newton, krylov=both.krylov, hardest=both.hardest)
            result, since = both, solved
            if then.newton <= SETTLED:
                break
        return result

    def _strayed(self, u, since):
        """Farthest way of a closed point since the displacement with which partners were found, in facets."""
        return max([item.relative_motion(u, since) for item in self.problem.others], default=np.inf)

    def _search(self, before, time, motion, ahead):
        start = clock.perf_counter()
        with profile.phase("search"):
            for item in self.problem.items:
                item.detect(before, time, motion, ahead)
        self.newton.timing["search"] += clock.perf_counter() - start


def search_update(problem, newton, options):
    """What searches within load steps as the user asks for, None for no search but the first of a load step."""
    follows = options.get("contact_search_every") == "newton"
    most = options.get("contact_search_again", AT_THE_END if follows else 0)
    looks = (most > 0 or follows) and problem.others and not problem.linear
    return SearchUpdate(problem, newton, most, follows) if looks else None
