"""Partners looked for again within a load step."""

import time as clock

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.ironing import Forces, scene
from meshes import ironing
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.simulation import Simulation
from pcontact.solve.result import NewtonResult
from pcontact.stepping.search_update import SearchUpdate

WORLD = MPI.COMM_WORLD


def ironed(path, count, again, comm=WORLD, change=None, every="step", **more):
    """Rows of the load steps, and the searches per load step. Collective."""
    options = {"contact_search_again": again, "contact_search_every": every, **more}
    for name, value in options.items():
        PETSc.Options().setValue(name, value)
    forces, simulation = Forces(), None
    try:
        case = scene(path, mu=0.3, depth=0.05, way=0.5, count=count, petsc={"snes_rtol": "1e-11"})
        simulation = Simulation(case, comm)
        (item,) = simulation.problem.items[1:]
        searches, detect = [], item.detect

        def spy(u, time, motion=0.0, ahead=None):
            searches.append(time)
            detect(u, time, motion, ahead)

        item.detect = spy
        if change is not None:
            change(simulation)
        assert simulation.run(None, [forces])
    finally:
        for name in options:
            PETSc.Options().delValue(name)
        if simulation is not None:
            simulation.close()
    return forces.rows, np.unique(searches, return_counts=True)[1]


@pytest.fixture
def path(shared_tmp):
    return make_mesh(ironing, shared_tmp / "ironing.msh", 2, 0.2)


@pytest.mark.parallel
def test_searches_end(path):
    """At most as many as were asked for, and fewer where they change nothing; none without the option."""
    rows, counts = ironed(path, 5, 3)
    assert np.all(counts <= 4) and np.all(counts >= 2)
    assert all(row["cutbacks"] == 0 for row in rows)
    once, counts = ironed(path, 5, 0)
    assert np.all(counts == 1)
    assert once[-1]["tangential"] != pytest.approx(rows[-1]["tangential"], rel=1e-3)


@pytest.mark.parallel
@pytest.mark.parametrize("every", ["step", "newton"])
def test_ranks_agree(path, every):
    """Forces of all load steps, to the tolerance of Newton's method."""
    # iterates, where partners are looked for then, are the same on all ranks if linear systems are solved exactly
    said = {"pc_type": "lu"} if every == "newton" else {}
    (one, _), (all_, _) = (ironed(path, 4, 2, comm, every=every, **said) for comm in (MPI.COMM_SELF, WORLD))
    for a, b in zip(one, all_, strict=True):
        assert a["normal"] == pytest.approx(b["normal"], rel=1e-6)
        assert a["tangential"] == pytest.approx(b["tangential"], rel=1e-6, abs=1e-9)


@pytest.mark.parallel
def test_newton_follows_the_bodies(path):
    """With searches at its iterations, forces in few load steps are nearly those in many."""
    many, _ = ironed(path, 40, 4)
    once, one_each = ironed(path, 5, 0)
    rows, counts = ironed(path, 5, 0, every="newton")
    assert np.all(one_each == 1) and np.any(counts > 2)
    known = many[-1]["tangential"]
    assert abs(rows[-1]["tangential"] - known) < 0.1 * abs(once[-1]["tangential"] - known)


@pytest.mark.parallel
def test_newton_that_follows_has_the_derivative_of_what_is_frozen(path):
    """Central differences of the residual among the partners of every iteration, and the residual it starts from."""
    errors, seeds = [], iter(range(1000))

    def watch(simulation):
        problem, newton = simulation.problem, simulation.newton
        tangent, space = problem.tangent, problem.space

        def check(u, rules=None, predicted=False):
            tangent(u, rules, predicted)
            if predicted:
                return
            here, there, product = (space.vector() for _ in range(3))
            problem.residual(u, here, rules)
            stale = (here - newton._f).norm() / max(newton._f.norm(), 1e-12)
            # the same direction whatever the ranks
            way = np.sin(space.points[space.owned_local] * (3.0 + next(seeds)) + 1.0)
            way[problem.fixed] = 0.0
            v, eps = space.vector(), 1e-9
            v.setArray(way.ravel())
            both = []
            for sign in (1.0, -1.0):
                moved = u.copy()
                moved.axpy(sign * eps, v)
                problem.residual(moved, there, rules)
                both.append(there.copy())
            difference = (both[0] - both[1]) * (0.5 / eps)
            problem.matrix.matrix.mult(v, product)
            array = product.getArray().reshape(way.shape)
            array[problem.fixed] = 0.0
            errors.append((stale, (difference - product).norm() / product.norm()))

        problem.tangent = check

    _, counts = ironed(path, 5, 0, change=watch, every="newton")
    stale, taylor = np.array(errors).T
    assert np.any(counts > 2) and len(errors) > 10
    assert stale.max() < 1e-9
    assert taylor.max() < 1e-6


def test_newton_that_fails_to_follow_starts_again(path):
    """With the partners of the beginning of the load step."""

    def fail(simulation):
        solve = simulation.newton.solve

        def solved(u, follow=None):
            outcome = solve(u, follow)
            if follow is None:
                return outcome
            u.set(1e3)
            return NewtonResult(False, 2, 2, "made up", 1.0, 1.0)

        simulation.newton.solve = solved

    rows, _ = ironed(path, 4, 0, change=fail, every="newton")
    once, _ = ironed(path, 4, 0)
    for a, b in zip(rows, once, strict=True):
        assert a["newton"] == b["newton"] + 2
        assert a["normal"] == pytest.approx(b["normal"], rel=1e-8)


def test_a_run_that_fails_leaves_what_was_there(path):
    """The load step keeps the solution and the partners of the search before."""

    def fail(simulation):
        simulation.newton.again = lambda u, near: (u.set(1e3), NewtonResult(False, 2, 2, "made up", 1.0, 1.0))[1]

    rows, counts = ironed(path, 4, 3, change=fail)
    once, _ = ironed(path, 4, 0)
    # a search that fails, and the one that takes it back
    assert np.all(counts % 3 == 0)
    for a, b in zip(rows, once, strict=True):
        assert a["newton"] == b["newton"] + 2
        assert a["normal"] == pytest.approx(b["normal"], rel=1e-8)
        assert a["tangential"] == pytest.approx(b["tangential"], rel=1e-6, abs=1e-9)


def test_a_flip_between_two_sets_ends():
    """Two sets of partners that call each other: the last one stays."""

    class Vector:
        def copy(self, other=None):
            return Vector()

    class Problem:
        items = others = []

    class Flipping:
        def __init__(self):
            self.runs, self.timing = 0, {"search": 0.0}

        def solve(self, u):
            return NewtonResult(True, 4, 4, "", 0.0, 1.0)

        def again(self, u, near):
            self.runs += 1
            return NewtonResult(True, 5, 5, "", 0.0, 1.0)

    newton = Flipping()
    outcome = SearchUpdate(Problem, newton, 6)(Vector(), None, (1.0, 0.0, None))
    assert newton.runs == 6 and outcome.newton == 34 and outcome.converged


def test_searches_of_all_kinds_are_one_entry_of_the_timing(path, monkeypatch):
    """Searches take an hour each: those of the load steps, within Newton's method, and after it."""
    hours = []

    def spy(simulation):
        (item,) = simulation.problem.items[1:]
        detect, now = item.detect, clock.perf_counter

        def late(*arguments):
            hours.append(3600.0)
            detect(*arguments)

        monkeypatch.setattr(clock, "perf_counter", lambda: now() + sum(hours))
        item.detect = late
        timings.append(simulation.timing)

    timings = []
    ironed(path, 2, 1, change=spy, every="newton")
    (timing,) = timings
    assert len(hours) > 4
    assert timing["search"] == pytest.approx(sum(hours), abs=600.0)
    assert timing["solve"] < 600.0 and timing["linear"] < 600.0
