"""Newton's method on problems of a few unknowns."""

import numpy as np
import pytest

from tests.support.few_unknowns import FewUnknowns, solved


def chain(n, stops=None, stiffness=1e3, loads=1.0):
    """Springs in a row, held at one end, whose nodes are pushed against stops with gaps (n,) and a stiffness."""
    matrix = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    matrix[-1, -1] = 1.0
    forces, gaps = np.full(n, loads), np.full(n, np.inf) if stops is None else np.asarray(stops)

    def residual(u):
        return matrix @ u - forces + stiffness * np.maximum(u - gaps, 0.0)

    def tangent(u):
        return matrix + stiffness * np.diag((u > gaps).astype(float))

    def terms(u):
        return np.abs(matrix) @ np.abs(u) + forces + stiffness * np.where(u > gaps, np.abs(u) + gaps, 0.0)

    return FewUnknowns(n, residual, tangent, np.linalg.norm(forces), terms, linear=stops is None), residual


def test_a_linear_problem_takes_one_iteration():
    problem, residual = chain(6)
    result, u = solved(problem, np.zeros(6))
    assert result.converged and result.newton == 1
    assert np.abs(residual(u)).max() < 1e-12


@pytest.mark.parametrize("stiffness", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("seed", range(4))
def test_stops(seed, stiffness):
    """Pieces of a linear function: the last iteration is exact, whatever was closed on the way."""
    gaps = np.random.default_rng(seed).uniform(0.0, 20.0, 12)
    problem, residual = chain(12, gaps, stiffness)
    result, u = solved(problem, np.zeros(12))
    assert result.converged and 0 < (u > gaps).sum() < 12
    np.testing.assert_allclose(u, np.where(u > gaps, gaps, u), atol=12.0 / stiffness)
    assert np.linalg.norm(residual(u)) < 1e-14 * stiffness * np.linalg.norm(gaps) + 1e-11


def test_the_line_search_holds_what_full_steps_throw_away():
    """The arc tangent, whose Newton steps grow without bound from 1.4 on."""

    def problem():
        return FewUnknowns(1, np.arctan, lambda u: np.diag(1.0 / np.hypot(1.0, u) / np.hypot(1.0, u)))

    result, u = solved(problem(), [20.0])
    assert result.converged and abs(u[0]) < 1e-9
    without, _ = solved(problem(), [20.0], newton_without="line_search,half_step")
    assert not without.converged


def test_what_is_held_takes_full_steps_unless_they_lead_away():
    """As by inertia: fewer iterations, and an arc tangent does not run away."""
    counts = []
    for holds in (False, True):
        problem, residual = chain(12, np.random.default_rng(2).uniform(0.0, 20.0, 12), 1e3)
        problem.others[0].holds = holds
        result, u = solved(problem, np.zeros(12))
        assert result.converged and np.linalg.norm(residual(u)) < 1e-9
        counts.append(result.newton)
    assert counts[1] <= counts[0]
    problem = FewUnknowns(1, np.arctan, lambda u: np.diag(1.0 / np.hypot(1.0, u) / np.hypot(1.0, u)))
    problem.others[0].holds = True
    result, u = solved(problem, [20.0])
    assert result.converged and abs(u[0]) < 1e-9


def test_a_rule_of_earlier_versions_warns(caplog):
    problem = FewUnknowns(1, np.arctan, lambda u: np.diag(1.0 / np.hypot(1.0, u) / np.hypot(1.0, u)))
    assert solved(problem, [0.5], newton_without="waiting")[0].converged
    assert "-newton_without waiting: there is no such rule any more" in caplog.text


def test_a_residual_that_hardly_points_along_the_step():
    """Curved along the step, and nearly across it, as where a normal turns: a full step takes most of it away."""

    def residual(u):
        return np.array([0.2 * (u[1] + 0.5 * u[0] ** 2) - 1e-4 * (1.0 - u[0]), u[0] - 1.0])

    def tangent(u):
        return np.array([[0.2 * u[0] + 1e-4, 0.2], [1.0, 0.0]])

    for turns in (True, False):
        problem = FewUnknowns(2, residual, tangent)
        problem.bulk.extrapolates = turns
        # the first step of a load step is another matter, see `APPROACH`
        result, u = solved(problem, np.zeros(2), newton_without="half_step")
        assert result.converged and result.newton == 2
        np.testing.assert_allclose(u, [1.0, -0.5], atol=1e-9)


def bent(stiffness=1e6, force=1.0):
    """A bar that shortens along itself, u[0], by half the square of its turn, u[1], and that is stiff along itself."""

    def residual(u):
        along = stiffness * (u[0] + 0.5 * u[1] ** 2)
        return np.array([along, along * u[1] + u[1] - force])

    def tangent(u):
        along = stiffness * (u[0] + 0.5 * u[1] ** 2)
        return np.array([[stiffness, stiffness * u[1]], [stiffness * u[1], along + stiffness * u[1] ** 2 + 1.0]])

    problem = FewUnknowns(2, residual, tangent)
    problem.bulk.extrapolates = True
    return problem


def test_a_residual_that_rises_where_a_bar_bends():
    """Full steps, though the first one raises the residual by half the stiffness: the next one is shorter."""
    result, u = solved(bent(), np.zeros(2))
    assert result.converged
    np.testing.assert_allclose(u, [-0.5, 1.0], atol=1e-9)
    along, _ = solved(bent(), np.zeros(2), newton_without="correction")
    assert along.newton > 3 * result.newton
    # where points close on the way the step is that of contact
    problem = bent()
    problem.closes = lambda u: 1.0
    contact, _ = solved(problem, np.zeros(2))
    assert contact.newton > result.newton


def test_a_step_is_taken_back_where_the_next_one_is_no_shorter():
    """The arc tangent beside a linear function, whose full steps grow without bound."""

    def residual(u):
        return np.array([np.arctan(u[0]), 0.1 * (u[1] - 1.0)])

    def tangent(u):
        return np.diag([1.0 / np.hypot(1.0, u[0]) / np.hypot(1.0, u[0]), 0.1])

    problem = FewUnknowns(2, residual, tangent)
    assert not solved(problem, [20.0, 0.0], newton_without="line_search,half_step", snes_max_it=9)[0].converged
    problem.bulk.extrapolates = True
    result, u = solved(problem, [20.0, 0.0])
    assert result.converged
    np.testing.assert_allclose(u, [0.0, 1.0], atol=1e-9)


def test_a_step_is_halved_until_the_residual_has_a_value():
    """Cells that a full step turns inside out."""

    def residual(u):
        return -2.0 - np.log(np.where(u < 1.0, 1.0 - u, np.nan))

    problem = FewUnknowns(1, residual, lambda u: np.diag(1.0 / (1.0 - u)))
    problem.bulk.extrapolates = True
    result, u = solved(problem, [-3.0])
    assert result.converged and u[0] == pytest.approx(1.0 - np.exp(-2.0))


def test_a_residual_that_is_not_finite_ends_the_attempt():
    """So says a material point that cannot be integrated; the load step is then cut."""
    problem = FewUnknowns(1, lambda u: np.where(u < 0.5, u - 1.0, np.nan), lambda u: np.eye(1))
    result, _ = solved(problem, [0.0])
    assert not result.converged and result.newton <= 1


def test_nothing_holds_it():
    """A singular tangent: no success, and a word on what may be the cause."""
    free = np.array([[1.0, -1.0], [-1.0, 1.0]])
    result, _ = solved(FewUnknowns(2, lambda u: free @ u - 1.0, lambda u: free), np.zeros(2))
    assert not result.converged and "holds" in result.detail


def test_two_states_in_turn():
    """With a residual of one norm in both: ends with the largest number of iterations."""
    problem = FewUnknowns(1, lambda u: np.where(u < 0.0, -1.0, 1.0), lambda u: np.eye(1) * 0.5)
    result, _ = solved(problem, [-1.0], newton_without="line_search,half_step", snes_max_it=50)
    assert not result.converged and result.newton == 50


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_units_do_not_matter(unit):
    """Of force: as many iterations, and the same displacement."""
    gaps = np.linspace(1.0, 15.0, 8)
    problem, residual = chain(8, gaps)
    first, u = solved(problem, np.zeros(8))
    scaled = FewUnknowns(8, lambda x: unit * residual(x), lambda x: unit * problem._tangent(x), unit * problem._load,
                         lambda x: unit * problem._terms(x))  # fmt: skip
    second, v = solved(scaled, np.zeros(8))
    assert first.newton == second.newton and second.converged
    np.testing.assert_allclose(u, v, rtol=1e-12)


def test_what_is_soft_converges_though_rounding_errors_of_what_is_stiff_hide_it():
    """The residual of a stiff spring that moves may be larger than what a soft one has left."""

    def residual(u):
        return np.array([1e12 * (u[0] - 1.0), u[1] + u[1] ** 3 - 1.0])

    def tangent(u):
        return np.diag([1e12, 1.0 + 3.0 * u[1] ** 2])

    problem = FewUnknowns(2, residual, tangent, 1.0, lambda u: np.array([1e12 * (abs(u[0]) + 1.0), 1.0]))
    result, u = solved(problem, np.zeros(2))
    assert result.converged and abs(residual(u)[1]) < 1e-6


@pytest.mark.parametrize("chosen", ["lu", "cholesky", "jacobi"])
def test_a_linear_solve_that_fails_is_told_of_what_may_help(chosen):
    """Neither of the solver that it has, nor of a gamma0 where nothing has one."""
    problem = FewUnknowns(1, lambda u: u - 1.0, lambda u: np.zeros((1, 1)))
    options = {"ksp_type": "gmres", "ksp_max_it": 3} if chosen == "jacobi" else {}
    result, _ = solved(problem, [0.0], pc_type=chosen, **options)
    assert not result.converged and "singular" in result.detail and "gamma0" not in result.detail
    assert ("-pc_type lu" in result.detail) == (chosen == "jacobi")
