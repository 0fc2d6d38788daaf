"""When a preconditioner is set up again."""

from types import SimpleNamespace

import pytest

from pcontact.solve.preconditioners import GROWN, Reuse, solver_defaults


def solve(iterations, rtol=1e-3):
    """What is asked of a Krylov method after a solve."""
    return SimpleNamespace(getTolerances=lambda: (rtol, 0.0, 0.0, 500), getIterationNumber=lambda: iterations)


def test_kept_while_it_takes_few_iterations_more(monkeypatch):
    """The first solve sets up; what a fresh one takes for a decade is the measure."""
    monkeypatch.setattr("pcontact.solve.preconditioners.LOST_ITERATIONS", 5)
    reuse = Reuse()
    assert not reuse.keep(solve(0), 1.0)
    assert reuse.keep(solve(9), 1.0), "a fresh one took 3 for a decade"
    assert reuse.keep(solve(14), 1.0), "5 more are allowed"
    assert reuse.keep(solve(23, 1e-6), 1.0), "18 would be expected of 6 decades"
    assert not reuse.keep(solve(15), 1.0)
    assert reuse.keep(solve(12), 1.0), "a fresh one took 4 for a decade"
    assert reuse.keep(solve(17), 1.0)


def test_contact_that_grows_renews_it():
    reuse = Reuse()
    reuse.keep(solve(0), 1.0)
    assert reuse.keep(solve(9), 0.99 * GROWN)
    assert not reuse.keep(solve(9), 1.01 * GROWN)
    assert reuse.keep(solve(9), 1.02 * GROWN)


def test_forgotten_at_a_load_step():
    reuse = Reuse()
    reuse.keep(solve(0), 1.0)
    assert reuse.keep(solve(9), 1.0)
    reuse.forget()
    assert not reuse.keep(solve(9), 1.0)


@pytest.mark.parametrize("symmetric", [True, False])
def test_defaults_of_a_chosen_krylov_method(symmetric):
    """Each has the side and the norm that it supports, whatever the tangent is."""
    assert solver_defaults(symmetric, 1)["ksp_type"] == ("cg" if symmetric else "gmres")
    for krylov, side in (("cg", None), ("gmres", "right"), ("bcgs", "right"), ("minres", None)):
        found = solver_defaults(symmetric, 1, krylov)
        assert found["ksp_type"] == krylov and found.get("ksp_pc_side") == side
