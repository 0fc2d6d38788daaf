"""Partners are found again within a load step until they hardly change its answer."""

import time as clock
from types import SimpleNamespace

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.ironing import WAY, Forces, scene
from drivers.studies._extreme_shapes import pointed
from drivers.studies._harness import solved
from meshes import ironing
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.simulation import Simulation
from pcontact.solve.convergence import NewtonResult
from pcontact.stepping.load_step import PartnerUpdate

WORLD = MPI.COMM_WORLD


class Partners(Forces):
    """Also what the last search of every load step has said."""

    def step(self, step, u, record):
        super().step(step, u, record)
        self.rows[-1]["partners"] = record["partners"]


def ironed(path, count, comm=WORLD, change=None, keys=(), **options):
    """Rows of the load steps. Collective."""
    for name, value in options.items():
        PETSc.Options().setValue(name, value)
    forces, simulation = Partners(), None
    try:
        keys = {"depth": 0.05, "way": 0.5, **dict(keys)}
        case = scene(path, mu=0.3, count=count, petsc={"snes_rtol": "1e-11"}, **keys)
        simulation = Simulation(case, comm)
        if change is not None:
            change(simulation)
        assert simulation.run(None, [forces])
    finally:
        for name in options:
            PETSc.Options().delValue(name)
        if simulation is not None:
            simulation.close()
    return forces.rows


@pytest.fixture
def path(shared_tmp):
    return make_mesh(ironing, shared_tmp / "ironing.msh", 2, 0.2)


@pytest.mark.parallel
@pytest.mark.parametrize("part", [2e-3, 1e-5])
def test_a_load_step_ends_with_partners_that_hardly_change_it(path, part):
    rows = ironed(path, 5, contact_partner_rtol=part)
    assert all(row["partners"]["change"] <= part and row["partners"]["searches"] >= 1 for row in rows)
    assert not any(row["partners"]["unsettled"] for row in rows)
    assert max(row["partners"]["searches"] for row in rows) > 1


def test_without_the_check_the_report_says_so(path):
    rows = ironed(path, 5, contact_search_again=0)
    assert all(row["partners"] == {"searches": 0} for row in rows)


@pytest.mark.parallel
def test_few_load_steps_have_nearly_the_forces_of_many(path):
    """Where partners that stay from the beginning of a load step give others."""
    many, once = ironed(path, 40)[-1]["normal"], ironed(path, 5, contact_search_again=0)[-1]["normal"]
    assert abs(ironed(path, 5)[-1]["normal"] - many) < 0.1 * abs(once - many)


@pytest.mark.parallel
def test_ranks_agree(path):
    """Forces of all load steps: what the last search may change is the same on any ranks."""
    said = {"pc_type": "lu"}
    one, several = (ironed(path, 4, comm, **said) for comm in (MPI.COMM_SELF, WORLD))
    for a, b in zip(one, several, strict=True):
        assert a["normal"] == pytest.approx(b["normal"], rel=1e-6)
        assert a["tangential"] == pytest.approx(b["tangential"], rel=1e-6, abs=1e-9)


@pytest.mark.parallel
def test_newton_has_the_derivative_of_what_is_frozen(path):
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
            way[problem.conditions.fixed] = 0.0
            v, eps = space.vector(), 1e-9
            v.setArray(way.ravel())
            both, status = [], []
            for sign in (1.0, -1.0):
                moved = u.copy()
                moved.axpy(sign * eps, v)
                problem.residual(moved, there, rules)
                both.append(there.copy())
                status.append(np.concatenate([pair.forces(moved)[1] for c in problem.contacts for pair in c.pairs]))
            turns = WORLD.allreduce(int(np.sum(status[0] != status[1])))
            difference = (both[0] - both[1]) * (0.5 / eps)
            problem.matrix.matrix.mult(v, product)
            array = product.getArray().reshape(way.shape)
            array[problem.conditions.fixed] = 0.0
            errors.append((stale, (difference - product).norm() / product.norm(), turns))

        problem.tangent = check

    ironed(path, 5, change=watch)
    stale, taylor, turns = np.array(errors).T
    assert len(errors) > 10
    assert stale.max() < 1e-9
    # there is no derivative where a point is about to slip
    assert taylor[turns == 0].max() < 1e-6 and np.count_nonzero(turns) < 0.1 * len(turns)


def test_normals_that_turn_decide(tmp_path):
    """Those of an edge on an edge, as their facets deform: the gaps hardly change."""
    case, _ = pointed(tmp_path, kind="edge on edge", dim=3, cell="hexahedron", n=3)
    with solved(case, comm=MPI.COMM_SELF) as (_, record):
        assert record["partners"]["change"] < 2e-3 and record["partners"]["searches"] > 2


@pytest.mark.parallel
def test_a_step_whose_partners_change_more_says_so(path, caplog):
    """Points at edges between facets find either by turns: here they turn the forces by more than is asked."""
    rows = ironed(path, 20, keys={"theta": -1.0, "depth": 0.04, "way": WAY})
    above = [row for row in rows if row["partners"]["change"] > 2e-3]
    assert above and all(row["partners"]["unsettled"] == ["sole"] for row in above)
    assert not any(row["partners"]["unsettled"] for row in rows if row not in above)
    assert WORLD.rank != 0 or sum("-contact_partner_rtol" in line for line in caplog.messages) == 1


class Flipping:
    """Newton's method and an item that finds other partners a number of times, and has other forces each time."""

    name, lasts = "c", 0.0

    def __init__(self, times, change=0.0):
        self.left, self.runs, self.timing, self.tolerances = times, 0, {"search": 0.0}, []
        self.follows, self.verifies, self.stale, self.change = False, True, 0.5, change
        self.source = SimpleNamespace(jxw=np.array([0.5]))
        self.snes = SimpleNamespace(getTolerances=lambda: (1e-8, 0.0, 0.0, 50))

    def forces(self, u):
        return np.array([[0.0, 2.0 * (1.0 - self.change) ** self.runs]]), np.array([1])

    def solve(self, u, follow):
        return NewtonResult(True, 4, 4, "", 0.0, 1.0)

    def again(self, u, near):
        self.runs += 1
        return NewtonResult(True, 5, 5, "", 0.0, 1.0)

    def renew(self, u, before, time, firm, tolerance):
        self.left -= 1
        self.tolerances.append(tolerance)
        self.stale = 0.5 if self.left >= 0 else 0.5 * tolerance
        return self.left >= 0


def flipped(times, most, change=0.0):
    both = Flipping(times, change)
    bulk, space = SimpleNamespace(yields=False), SimpleNamespace(comm=MPI.COMM_SELF)
    problem = SimpleNamespace(bulk=bulk, others=[both], space=space)
    update = PartnerUpdate(problem, both, most, 1e-3, [both])
    return both, update, update(None, None, 1.0)


class Iterating(Flipping):
    """With two iterates before the solution, far from it and near it."""

    def solve(self, u, follow):
        self.found = [follow(u, part) for part in (0.1, 1e-4)]
        return super().solve(u, follow)

    def strays(self, u):
        return False


@pytest.mark.parametrize("yields", [False, True])
def test_bodies_that_yield_find_partners_near_the_solution(yields):
    """And need no run of their own for them: others look for them where Newton's method has ended."""
    both = Iterating(1)
    problem = SimpleNamespace(
        bulk=SimpleNamespace(yields=yields), others=[both], space=SimpleNamespace(comm=MPI.COMM_SELF)
    )
    update = PartnerUpdate(problem, both, 6, 1e-3, [both])
    outcome = update(None, None, 1.0)
    assert both.found == [False, yields] and both.runs == (not yields)
    assert outcome.converged and outcome.partners == {"change": 5e-4, "searches": 2, "unsettled": []}


def test_what_may_stay_and_changes_more_is_named():
    """Of an item that keeps its partners all the same."""
    item, update, outcome = flipped(0, 6)
    assert outcome.converged and outcome.partners["unsettled"] == []
    item.renew = lambda *arguments: False
    item.stale = 2e-3
    outcome = update(None, None, 2.0)
    assert outcome.converged and outcome.partners["change"] == 2e-3 and outcome.partners["unsettled"] == ["c"]


def test_what_settles_is_accepted():
    newton, update, outcome = flipped(2, 6)
    assert newton.runs == 2 and outcome.newton == 14 and outcome.converged
    assert outcome.partners == {"change": 5e-4, "searches": 3, "unsettled": []}
    assert update.carried == 1.0


def test_what_partners_have_changed_says_what_a_change_is_worth():
    """A part of 0.5 was expected to change, and 0.9 has: from then on parts count for 1.8 times as much."""
    item, update, outcome = flipped(2, 6, change=0.9)
    assert item.tolerances == pytest.approx([1e-3, 1e-3 / 1.8, 1e-3 / 1.8])
    assert outcome.partners["change"] == pytest.approx(0.5 * 1e-3) and update.carried == pytest.approx(1.8)
    update(None, None, 2.0)
    assert item.tolerances[-1] == pytest.approx(1e-3 / 1.8)
    # a search that changes nothing leaves no trace
    assert update.carried == 0.0


@pytest.mark.parametrize(
    ("expected", "after", "gain"),
    [
        ([1e-17, 0.2], [1.5, 1.5], 0.5 / 1.5 / 0.2),  # partners of the second change the forces of both
        ([1e-12, 0.0], [1.0 + 1e-9, 1.0], 1.0),  # Newton's tolerance
        ([0.0, 0.0], [1.0, 1.5], 7.0),  # nothing was expected: what is known stays
    ],
)
def test_what_one_contact_changes_in_all_of_them_counts(expected, after, gain):
    """Not what a contact changes whose partners stay, over what rounding errors have let it expect."""
    _, update, _ = flipped(0, 6)
    update._gain = 7.0
    forces = [np.array([[1.0, 0.0]])] * 2
    update._compare(forces, [np.array([[part, 0.0]]) for part in after], np.array(expected))
    assert update._gain == pytest.approx(gain)


def test_what_does_not_settle_has_not_converged():
    newton, _, outcome = flipped(100, 6)
    assert newton.runs == 6 and not outcome.converged
    assert "after 6 searches" in outcome.reason


def test_searches_of_all_kinds_are_one_entry_of_the_timing(path, monkeypatch):
    """Searches take an hour each: those of the load steps, within Newton's method, and after it."""
    hours = []

    def spy(simulation):
        (item,) = simulation.problem.items[1:]
        find, now = item.search.among.find, clock.perf_counter

        def late(*arguments):
            hours.append(3600.0)
            return find(*arguments)

        monkeypatch.setattr(clock, "perf_counter", lambda: now() + sum(hours))
        item.search.among.find = late
        timings.append(simulation.timing)

    timings = []
    ironed(path, 2, change=spy)
    (timing,) = timings
    assert len(hours) > 4
    assert timing["search"] == pytest.approx(sum(hours), abs=600.0)
    assert timing["solve"] < 600.0 and timing["linear"] < 600.0
