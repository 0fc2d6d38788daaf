"""How a load step begins: where the bodies are expected, and what stands in the place of its first residual."""

from pcontact.runtime import profile


class Prediction:
    """Beginning of the load steps of a problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem

    Attributes
    ----------
    committed : PETSc.Vec or None
        Displacement of which the stresses are those of the prediction; None where the load step begins without one.
    goes_on : bool
        Whether the load step begins where the bodies are if they go on as they did.
    imposing : float
        Norm of the residual [force] where it would begin else, of small strain: what is prescribed alone has moved.
    """

    def __init__(self, problem):
        self._problem, self.committed, self._changed = problem, None, frozenset()
        self.goes_on, self.imposing = False, 0.0

    @property
    def continues(self):
        """Whether load steps begin where the bodies are if they go on as they did, once they have moved: bodies with
        finite strain, and elastic ones that nothing but supports, loads and contact moves."""
        problem, bulk = self._problem, self._problem.bulk
        if bulk.extrapolates:
            return True
        floats = any(item.floats for item in problem.others)
        return not (problem.linear or bulk.yields or problem.features.inertia or floats)

    def begin(self, u, time, ahead=None):
        """Enter the prescribed displacements of a time into ``u``, the committed displacement so far. *Collective.*

        Decides whether the load step begins with a prediction: where bodies may yield, where supports that move alone
        open or close points, and where bodies have finite strain. These, and elastic ones, begin where they are if they
        go on as they did (`ahead`), unless they cannot be there: from a committed state they would have to turn by a
        whole load step.
        """
        problem, bulk, conditions = self._problem, self._problem.bulk, self._problem.conditions
        moves = not problem.linear and conditions.imposed(u, time) > 0.0
        before = u.copy() if bulk.yields or moves or bulk.extrapolates else None
        self.goes_on = self.continues and ahead is not None and (not bulk.extrapolates or problem.integrable(ahead))
        self.imposing = 0.0
        if self.goes_on:
            if not bulk.extrapolates:
                # what is prescribed alone says how large forces are that are to be balanced
                conditions.enter(u, time)
                forces = u.duplicate()
                problem.residual(u, forces)
                self.imposing = forces.norm()
            if before is not None:
                ahead.copy(before)
            ahead.copy(u)
        conditions.enter(u, time)
        self._changed = problem.active.changed_by_supports(before, u) if moves else frozenset()
        self.committed = before if bulk.yields or self._changed or bulk.extrapolates else None

    def expect(self, u, expected):
        """Begin the load step where the bodies are expected, but for what is prescribed. *Collective.*

        Parameters
        ----------
        u, expected : PETSc.Vec
            ``u`` after :meth:`begin`; overwritten.
        """
        free = ~self._problem.conditions.fixed
        u.getArray().reshape(free.shape)[free] = expected.getArray(readonly=True).reshape(free.shape)[free]
        u.assemble()
        # nothing is left to predict, and the first residual says nothing of the forces
        self.committed, self.goes_on = None, True

    @property
    def rules(self):
        """Status rules: bodies that go on as they did bring their points along; else see :meth:`residual`.
        *Collective.*"""
        active = self._problem.active
        return active.by_law if self.goes_on else active.frozen(self._changed)

    def residual(self, u, f):
        """Residual vector at the beginning of a load step, for bodies that do not yield on the way, and points that
        stay open or closed. *Collective.*

        The prescribed nodes have moved there and their neighbours have not. Taken at its word, that strains a row of
        cells far beyond the yield stress and makes their tangent soft; elastic cells pass the motion on to the bodies.
        Points at or near those nodes would open or close, which the bodies' motion undoes at once. Obstacles have
        moved, too: where one goes back, all points would open, and the bodies spring back and hit again.
        """
        problem = self._problem
        out = -problem.forces.external()
        with profile.phase("bulk_assembly"):
            problem.bulk.predict(u, self.committed, out)
        problem.add_others(u, out, self.rules)
        problem.as_residual(out, f)
