"""Ways to solve a load step, tried one after the other while Newton's method goes in circles."""

from dataclasses import replace

from pcontact.runtime import log
from pcontact.runtime.petsc import PETSc, full_steps
from pcontact.solve.outcome import together
from pcontact.solve.stability import UNSTABLE, unstable

# part of the first residual to which a load step is solved as if nothing could slip; the same where bodies may yield
HELD_GOAL, HELD_GOAL_PLASTIC = 0.1, 0.02
# part of the closed area that would open: the bodies are being taken apart, and to keep them together leads nowhere
PULLED = 0.1


class Ways:
    """Part of :class:`pcontact.solve.newton.Newton`: with the law from the beginning, or from where a simpler one ends.

    It uses ``problem``, ``snes`` and ``_run`` of that class, sets its ``_goal`` (part of the first residual that is
    enough), ``_circles`` (whether iterates that repeat end a run) and ``_stretches`` (whether the program shortens
    steps), and is told by it whether it ``_holds`` (friction) and ``_hold_first``, and whether the load step is
    ``divisible``.
    """

    def _try_ways(self, u, before):
        """One way after the other until one converges. *Collective.*

        Where the first has not, the load step may be so large that it has several solutions: one that is not stable is
        taken only where the load step is not to be shorter.
        """
        if self._hold_first:
            return self._stick_first(u, before)
        ways = self._ways
        if self._holds and self.problem.yields and self.problem.sticks():
            ways = [way for way in ways if way != self._law] or ways
        outcome = ways[0](u, before)
        for way in ways[1:]:
            if outcome.converged:
                break
            before.copy(u)
            outcome = together(outcome, way(u, before))
            if outcome.converged and unstable(self.problem, u):
                outcome = self._doubted(outcome)
        return outcome

    def _doubted(self, outcome):
        """What becomes of a solution that is not stable."""
        if self.divisible:
            log.info("time %g: a solution that is not stable is not taken", self.problem.time)
            return replace(outcome, converged=False, reason=UNSTABLE)
        log.warning(
            "time %g: this solution is not stable, and the load step has others, to which shorter ones have not led",
            self.problem.time,
        )  # fmt: skip
        return outcome

    def _law(self, u, before):
        """Solve with the law from the beginning."""
        self._circles = self._holds or self.problem.yields
        return self._run(u, True)

    def _glued_first(self, u, before):
        """Solve roughly as if no point could open, close or slip, then as if none could slip, then with the law.

        What cycles where bodies yield is often a point at the border of the contact that closes in one iteration, far
        from where it was, and opens in the next; and points that begin to slip one beside the other, where in the end
        they stick. Where points slip already, or the bodies are being taken apart, this is of no use.
        """
        self._goal, self._circles = HELD_GOAL, True
        outcome = self._run_by(self.problem.frozen(), u, True)
        near = outcome.converged
        if near and self._holds:
            near = self.problem.opening(u) <= PULLED
            if near:
                self._goal = HELD_GOAL_PLASTIC
                outcome = together(outcome, self._run_by(self.problem.sticking(), u, False))
                near = outcome.converged
        self._goal = None
        if not near:
            before.copy(u)
        return together(outcome, self._run(u, not near))

    def _run_by(self, rules, u, beginning):
        """A run under status rules other than the laws. *Collective.*"""
        self._rules = rules
        try:
            return self._run(u, beginning)
        finally:
            self._rules = None

    def _shortest(self, u, before):
        """Solve with the line search l2, to where the residual is smallest along a step."""
        self._line_search("l2")
        self._circles = self._stretches = False
        outcome = self._run(u, True)
        self._line_search(full_steps)
        self._stretches = True
        return outcome

    def _line_search(self, name):
        options = PETSc.Options(self.snes.getOptionsPrefix())
        options["snes_linesearch_type"] = name
        self.snes.setFromOptions()

    def _stick_first(self, u, before):
        """Solve as if no closed point could slip, roughly, then with the law.

        Newton can cycle between the two ways in which all points of a body may slip; from a state in which they stick,
        each goes the way in which its traction exceeds the bound.
        """
        self._goal = HELD_GOAL_PLASTIC if self.problem.yields else HELD_GOAL
        self._circles = True
        held = self._run_by(self.problem.sticking(), u, True)
        self._goal, self._circles = None, False
        if not held.converged:
            if not self._hold_first:
                # the law alone did no better
                return held
            before.copy(u)
        return together(held, self._run(u, not held.converged))
