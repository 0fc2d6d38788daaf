"""What a target would take."""

import numpy as np
import pytest

from pcontact.adapt.budget import Aims, Budgeted, forecast
from pcontact.adapt.effectivity import Range
from pcontact.adapt.passes import BYTES, Pass, memory_each
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Budget

COMM = MPI.COMM_WORLD


def done(unknowns, degree, mesh, **more):
    return Pass(unknowns, unknowns, degree, mesh, Range(1.0, 2.0, "", 2), {"mesh": mesh}, **more)


@pytest.mark.parallel
def test_uniform_cells_are_halved_until_the_error_is_small_enough():
    """Degree 1 in the plane: half the error takes four times the cells."""
    squares = np.ones(len(np.array_split(np.arange(100), COMM.size)[COMM.rank]))
    last = done(200, 1, 0.1, seconds=3.0, solve=0.5, trials=1.0, memory=1e6)
    ahead = forecast(COMM, [last], squares, 0.25 * 1.0001)
    followers = ahead.unknowns[-1] / (200 * 16)
    assert 1.0 <= followers < 2.0
    # the first pass loads what is needed, and an estimate takes as long as a solution
    expected = 1.0 + sum(1.0 + one / 200 for one in ahead.unknowns)
    assert ahead.seconds == pytest.approx(expected)
    assert ahead.memory == pytest.approx(1e6 * ahead.unknowns[-1] / 200)


def test_two_passes_tell_what_does_not_grow():
    """Seconds that both have are not multiplied."""
    passes = [done(100, 2, 0.2, seconds=1.0), done(400, 2, 0.05, seconds=1.0)]
    ahead = forecast(MPI.COMM_SELF, passes, np.ones(50), 0.1)
    assert ahead.seconds == pytest.approx(len(ahead.unknowns))


def test_what_the_second_mesh_has_shown_counts():
    """Unknowns over those expected; and a target is reached before the mesh that is made for less."""
    passes = [done(100, 1, 0.2, next={"unknowns": 320.0}), done(400, 1, 0.1)]
    ahead = forecast(MPI.COMM_SELF, passes, np.ones(50), Aims(0.5001, 0.4, 0.6))
    assert ahead.unknowns == [100.0, 400.0, pytest.approx(1.25 * 1600)]
    passes[0].next["unknowns"] = 500.0
    ahead = forecast(MPI.COMM_SELF, passes, np.ones(50), Aims(0.5001, 0.2501, 0.4))
    assert ahead.unknowns[2:] == [pytest.approx(1600), pytest.approx(6400)]


def test_memory_is_that_of_unknowns_until_it_has_been_measured():
    """The peak of a small pass is that of the program, and says nothing of larger ones."""
    small = [done(100, 2, 0.2, memory=2.8e8), done(300, 2, 0.1, memory=2.9e8)]
    assert memory_each(small) == BYTES[2]
    large = [small[0], done(100_000, 2, 0.01, memory=8.8e8)]
    assert memory_each(large) == pytest.approx(6e8 / 99_900)
    budget = Budgeted(Budget(memory=4e8), COMM)
    assert budget.most(small, 0.0) == pytest.approx(1.0 + 1.1e8 / (300 * BYTES[2]))
    assert Budgeted(Budget(memory=2e8), COMM).most(small, 0.0) < 1.0
