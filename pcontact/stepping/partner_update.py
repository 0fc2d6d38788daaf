"""At finite motion partners have other facets where the bodies have gone: a load step ends when none has any more."""

import time as clock
from dataclasses import replace

from pcontact.runtime import profile
from pcontact.solve.result import combined

# [searches] After Newton's method has ended, in a load step at most. From: chosen; then the load step is cut.
RENEWALS = 8
# [searches] Between the iterations of Newton's method in a load step at most, where closed points leave their facets.
# From: chosen; points that go to and fro keep the facets of the last one.
WITHIN = 8
# [searches] After so many of them points that are hardly beyond their facets keep them. From: ball on block, 12,000
# unknowns: a point that is to end on the edge between two facets goes to and fro, with 4 four times.
FIRM = 1
# [-] Part of the largest residual of a run below which iterates are so near to the solution that facets are those of
# the solution: found again between the iterations, they need no run of their own. From: ball on block, 12,000 and
# 50,000 unknowns, 8 iterations without and 6 with it, whether 0.1 or 0.001.
NEAR_SOLUTION = 1e-3


class PartnerUpdate:
    """Solves a load step, and again with the facets that points have at the solution, until they have them already.

    Between two renewals facets are frozen, and go on beyond their edges; the points on them move. Closed points that an
    iteration of Newton's method takes beyond their facets get others at once: along a ray the place of the partner is
    the same on both sides of an edge, so that the residual does not jump. Points that end on an edge would change
    between its two facets for ever: in later searches they stay.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    newton : pcontact.solve.newton.Newton
    """

    def __init__(self, problem, newton):
        self.problem, self.newton = problem, newton
        # committed displacement and end of the load step
        self._step = None

    def __call__(self, u, before, search):
        """Solve a load step. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            As for :meth:`pcontact.solve.newton.Newton.solve`.
        before : PETSc.Vec
            The committed displacement.
        search : tuple (time, motion, ahead)
            What the items were told for the first search.

        Returns
        -------
        pcontact.solve.result.NewtonResult
            With the iterations of all runs. Not converged where facets still change after as many searches as are made.
        """
        left, self._step = [WITHIN], (before, search[0])

        def follow(x, part):
            if not left[0] or not (part < NEAR_SOLUTION or any([item.strays(x) for item in self.problem.others])):
                return False
            changed = self._renewed(x)
            left[0] -= changed
            return changed

        return self._settled(u, self.newton.solve(u, follow))

    def again(self, u):
        """Solve on from the solution ``u`` of the load step after multipliers have changed, see
        :meth:`pcontact.solve.newton.Newton.again`. *Collective.*"""
        return self._settled(u, self.newton.again(u))

    def _settled(self, u, result):
        """Go on from a solution until points have its facets. *Collective.*"""
        for searches in range(RENEWALS):
            if not result.converged or not self._renewed(u, searches >= FIRM):
                return result
            result = combined(result, self.newton.again(u, near=True))
        if result.converged and self._renewed(u, True):
            reason = f"points of contact still find other facets after {RENEWALS} searches"
            return replace(result, converged=False, reason=reason)
        return result

    def _renewed(self, u, firm=False):
        """Whether an item has changed its partners, see :meth:`pcontact.assembly.item.Item.renew`. *Collective.*"""
        start = clock.perf_counter()
        with profile.phase("search"):
            changed = [item.renew(u, *self._step, firm) for item in self.problem.others]
        self.newton.timing["search"] += clock.perf_counter() - start
        return any(changed)


def partner_update(problem, newton):
    """What renews facets within load steps; None where no item asks for it."""
    return PartnerUpdate(problem, newton) if any(item.renews for item in problem.others) else None
