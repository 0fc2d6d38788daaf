"""Nonlinear problems of a few unknowns, without a mesh, for Newton's method: what it asks of a problem, and no more."""

from types import SimpleNamespace

import numpy as np

from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, PETSc, own_options
from pcontact.solve.newton import Newton
from pcontact.solve.problem import Features

SELF = MPI.COMM_SELF


class FewUnknowns:
    """r(u) = 0 for u of n numbers.

    Parameters
    ----------
    n : int
    residual, tangent : callable
        Of u (n,): (n,) and (n, n).
    load : float
        Norm of the forces at work.
    terms : callable, optional
        Of u (n,): sums of the absolute terms of r (n,); the load if absent.
    linear, slips : bool
        Whether the tangent is constant; whether there are points that may slip.
    """

    committed, goes_on = None, False
    contacts, pattern_changes, time = (), 0, 1.0
    features = Features()

    def __init__(self, n, residual, tangent, load=1.0, terms=None, linear=False, slips=False):
        self._residual, self._tangent, self._load, self.linear = residual, tangent, load, linear
        self._terms = terms or (lambda u: np.full(1, load))
        mesh = SimpleNamespace(points=np.array([[0.0], [1e3]]), comm=SELF)
        self.space = SimpleNamespace(comm=SELF, dim=2, degree=1, n_dofs=n, mesh=mesh, vector=self._vector)
        self.fixed = np.zeros((n, 1), dtype=bool)
        self.others = [SimpleNamespace(can_slip=slips, stiff=False, holds=False, name="pair")]
        self.bulk = SimpleNamespace(flowing=lambda u: 0.0, yields=False, extrapolates=False)
        self.conditions = self.forces = self.active = self.prediction = self
        matrix = PETSc.Mat().createAIJ((n, n), nnz=n, comm=SELF)
        self.matrix = SimpleNamespace(matrix=matrix, operator=matrix, default="aij", choose=lambda kind: None)
        self.evaluations = 0

    def _vector(self):
        return PETSc.Vec().createSeq(len(self.fixed), comm=SELF)

    def residual(self, u, f, rules=None):
        self.evaluations += 1
        f.setArray(self._residual(u.getArray(readonly=True)))

    def tangent(self, u, rules=None, predicted=False):
        matrix, n = self.matrix.matrix, len(self.fixed)
        matrix.setValues(range(n), range(n), self._tangent(u.getArray(readonly=True)))
        matrix.assemble()

    def sticking(self):
        return ("stick",)

    def recede(self, u, rules=None, since=None):
        return None

    def turned(self, u):
        return np.array([1.0, 0.0, self.closes(u), 0.0])

    def closes(self, u):
        """Area that closes in ``u``."""
        return 0.0

    def integrable(self, u):
        return True

    def closed_area(self):
        return 1.0

    def follow(self, y, x=None, start=None):
        """Nothing is prescribed, and nothing follows."""

    def step_limit(self, u, y, falls=None):
        return 1.0

    def roundoff(self, u):
        return np.finfo(float).eps * np.linalg.norm(self._terms(u.getArray(readonly=True)))

    def acting(self, u):
        return self._load

    def loaded(self, u, springs=True):
        return self._load

    def stiffness_scale(self, u):
        return self._load

    def worst(self, f):
        values = np.abs(f.getArray(readonly=True))
        return float(np.nanmax(values, initial=0.0)), np.zeros(2), "body"


def solved(problem, start, **options):
    """The result of Newton's method with a direct solver and its last iterate, from a start (n,)."""
    with own_options():
        for name, value in {"pc_type": "lu", "snes_rtol": 1e-12, **options}.items():
            PETSc.Options().setValue(name, value)
        modes = PETSc.NullSpace().create(constant=False, vectors=(), comm=SELF)
        newton = Newton(problem, Options(), False, modes, {"assembly": 0.0, "linear": 0.0, "search": 0.0})
        u = problem.space.vector()
        u.setArray(np.array(start, dtype=float))
        try:
            result = newton.solve(u)
            return result, u.getArray().copy()
        finally:
            newton.free()
