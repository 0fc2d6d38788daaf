"""Partners looked for again within a load step."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.ironing import Forces, scene
from meshes import ironing
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.simulation import Simulation
from pcontact.solve.outcome import Outcome
from pcontact.stepping.renewal import Renewal

WORLD = MPI.COMM_WORLD


def ironed(path, count, again, comm=WORLD, change=None):
    """Rows of the load steps, and the searches per load step. Collective."""
    PETSc.Options().setValue("contact_search_again", again)
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
        PETSc.Options().delValue("contact_search_again")
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
    assert once[-1]["tangential"] != rows[-1]["tangential"]


@pytest.mark.parallel
def test_ranks_agree(path):
    """Forces of all load steps, to the tolerance of Newton's method."""
    (one, _), (all_, _) = (ironed(path, 4, 2, comm) for comm in (MPI.COMM_SELF, WORLD))
    for a, b in zip(one, all_, strict=True):
        assert a["normal"] == pytest.approx(b["normal"], rel=1e-6)
        assert a["tangential"] == pytest.approx(b["tangential"], rel=1e-6, abs=1e-9)


def test_a_run_that_fails_leaves_what_was_there(path):
    """The load step keeps the solution and the partners of the search before."""

    def fail(simulation):
        simulation.newton.again = lambda u, near: (u.set(1e3), Outcome(False, 2, 2, "made up", 1.0, 1.0))[1]

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
        items = []

    class Flipping:
        runs = 0

        def again(self, u, near):
            self.runs += 1
            return Outcome(True, 5, 5, "", 0.0, 1.0)

    newton = Flipping()
    outcome = Renewal(Problem, newton, 6)(Vector(), None, (1.0, 0.0, None), Outcome(True, 4, 4, "", 0.0, 1.0))
    assert newton.runs == 6 and outcome.newton == 34 and outcome.converged
