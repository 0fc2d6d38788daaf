"""Solutions that no slow motion comes to: found by the sign of a determinant, and not taken."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.runtime.petsc import MPI, PETSc, has_package
from pcontact.solve.newton import Newton
from pcontact.solve.result import NewtonResult
from pcontact.solve.stability import UNSTABLE, determinant_sign
from pcontact.stepping.schedule import Schedule

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
mumps = pytest.mark.skipif(not has_package("mumps"), reason="PETSc without MUMPS")


def matrix_of(dense):
    """On all ranks; every one enters its rows."""
    matrix = PETSc.Mat().createAIJ(dense.shape, nnz=len(dense), comm=WORLD)
    first, last = matrix.getOwnershipRange()
    for i in range(first, last):
        matrix.setValues(i, range(len(dense)), dense[i])
    matrix.assemble()
    return matrix


@mumps
@parallel
@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_sign_of_a_determinant(scale):
    """Whatever the units, of matrices without symmetry."""
    rng = np.random.default_rng(3)
    signs = []
    for _ in range(6):
        dense = rng.normal(size=(30, 30))
        signs.append(np.linalg.slogdet(dense)[0])
        assert determinant_sign(matrix_of(scale * dense)) == signs[-1]
    assert len(set(signs)) == 2


class Doubtful(Newton):
    """Goes in circles at first; from where closed points stick it converges."""

    def __init__(self, divisible):
        self.problem = SimpleNamespace(time=0.5, yields=False, sticking=tuple)
        self.divisible, self._without, self._holds, self._ends = divisible, (), True, [False, True, True]

    def _run(self, u, beginning, rules=None, goal=None):
        return self.end(self._ends.pop(0))

    def end(self, converged):
        """Four iterations."""
        return NewtonResult(converged, 4, 9, "", 1e-9, 1.0)


@pytest.mark.parametrize("stable", [True, False])
@pytest.mark.parametrize("divisible", [True, False])
def test_a_shorter_load_step_is_better_than_an_unstable_solution(monkeypatch, caplog, stable, divisible):
    """Where it may not be shorter, the solution is taken with a warning."""
    monkeypatch.setattr("pcontact.solve.newton.unstable", lambda problem, u: not stable)
    u = SimpleNamespace(copy=lambda other: None)
    outcome = Doubtful(divisible)._solve(u, u)
    assert outcome.newton == 12
    assert outcome.converged == (stable or not divisible)
    assert (outcome.reason == UNSTABLE) == (not outcome.converged)
    warned = any("time 0.5" in one.message for one in caplog.records if one.levelname == "WARNING")
    assert warned == (not stable and not divisible)


def test_steps_are_cut_in_doubt_to_a_tenth():
    """Of the planned ones, and not below the smallest."""
    schedule = Schedule(1.0, 2, 1e-6)
    assert [schedule.divisible(target) for target in (0.5, 0.25, 0.125, 0.0625)] == [True, True, True, False]
    assert [Schedule(1.0, 2, 0.2).divisible(target) for target in (0.5, 0.25)] == [True, False]
