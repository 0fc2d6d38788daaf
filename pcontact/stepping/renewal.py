"""Partners of a load step are looked for again where the bodies have gone, and Newton's method goes on from there."""

from dataclasses import replace

import numpy as np

from pcontact.runtime import profile
from pcontact.solve.outcome import together

# way of closed points since the last search, in sizes of their facets, up to which their partners are good enough: the
# part of it by which a normal turns on its way to the next facet is of second order
NEAR = 0.1
# Newton iterations after which a new search has changed nothing worth another one
SETTLED = 1


class Renewal:
    """Searches after the one that a load step begins with.

    Newton's method always has the exact derivative of what is frozen: partners and normals change between its runs, not
    within. Bodies that flip between two sets of partners do so a given number of times at most, after which the set of
    the last search stays.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    newton : pcontact.solve.newton.Newton
    most : int
        Searches of a load step after the first.
    """

    def __init__(self, problem, newton, most):
        self.problem, self.newton, self.most = problem, newton, most

    def __call__(self, u, before, search, outcome):
        """Go on from the solution among the partners of the first search. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            Overwritten. Where a run among new partners fails, it keeps the solution of the last one that did not.
        before : PETSc.Vec
            The committed displacement.
        search : tuple (time, motion, ahead)
            What the items were told for the first search.
        outcome : pcontact.solve.outcome.Outcome
            Of that solution, which converged.

        Returns
        -------
        Outcome
            With the iterations of all runs.
        """
        time, motion, ahead = search
        since = before if ahead is None else ahead
        for _ in range(self.most):
            if self._strayed(u, since) <= NEAR:
                break
            solved = u.copy()
            self._search(before, time, motion, solved)
            then = self.newton.again(u, near=True)
            both = together(outcome, then)
            if not then.converged:
                solved.copy(u)
                self._search(before, time, motion, ahead)
                return replace(outcome, newton=both.newton, krylov=both.krylov, hardest=both.hardest)
            outcome, ahead, since = both, solved, solved
            if then.newton <= SETTLED:
                break
        return outcome

    def _strayed(self, u, since):
        """Farthest way of a closed point since the displacement with which partners were found, in facets."""
        return max([item.strayed(u, since) for item in self.problem.items[1:]], default=np.inf)

    def _search(self, before, time, motion, ahead):
        with profile.phase("search"):
            for item in self.problem.items:
                item.detect(before, time, motion, ahead)


def renewal(problem, newton, options):
    """The searches that the user asks for, None for none but the first of a load step."""
    text = "searches for partners within a load step, after the first: each time Newton's method has converged"
    most = options.get("contact_search_again", 0, int, text=text)
    return Renewal(problem, newton, most) if most > 0 and not problem.linear else None
