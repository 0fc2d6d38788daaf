"""What a target would take."""

import pytest

from pcontact.adapt.decide import Budgeted, forecast
from pcontact.adapt.effectivity import Range
from pcontact.adapt.mark import FOLLOWERS
from pcontact.adapt.passes import BYTES, Pass, memory_each
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Budget

COMM = MPI.COMM_WORLD


def done(unknowns, degree, mesh, **more):
    return Pass(unknowns, unknowns, degree, mesh, Range(1.0, 2.0, "", 2), {"mesh": mesh}, **more)


def test_meshes_grow_until_the_error_is_small_enough():
    """Degree 1 in the plane: half of the error takes four times the unknowns, and eight times more come in a pass."""
    planned = {"unknowns": 800.0 / FOLLOWERS, "mesh": 0.05}
    last = done(200, 1, 0.1, seconds=3.0, solve=0.5, trials=1.0, memory=1e6, error=0.1, next=planned)
    ahead = forecast([last], 0.1 / 16)
    assert ahead.unknowns == pytest.approx([200, 1600, 12800, 51200])
    # the first pass loads what is needed, and an estimate takes as long as a solution
    assert ahead.seconds == pytest.approx(1.0 + sum(1.0 + one / 200 for one in ahead.unknowns))
    assert ahead.memory == pytest.approx(1e6 + BYTES[2] * 51000)


def test_two_passes_tell_what_does_not_grow():
    """Seconds that both have are not multiplied."""
    planned = {"unknowns": 800.0 / FOLLOWERS, "mesh": 0.05}
    passes = [done(100, 2, 0.2, seconds=1.0), done(400, 2, 0.1, seconds=1.0, error=0.1, next=planned)]
    assert forecast(passes, 0.04).seconds == pytest.approx(3)


def test_the_mesh_that_is_planned_is_made():
    """Also where it is larger than the error alone asks for."""
    ahead = forecast([done(100, 2, 0.2, error=0.2, next={"unknowns": 300.0, "mesh": 0.05})], 0.19)
    assert ahead.unknowns == pytest.approx([100, FOLLOWERS * 300])


def test_memory_is_that_of_unknowns_until_it_has_been_measured():
    """The peak of a small pass is that of the program, and says nothing of larger ones."""
    small = [done(100, 2, 0.2, memory=2.8e8), done(300, 2, 0.1, memory=2.9e8)]
    assert memory_each(small) == BYTES[2]
    large = [small[0], done(100_000, 2, 0.01, memory=8.8e8)]
    assert memory_each(large) == pytest.approx(6e8 / 99_900)
    budget = Budgeted(Budget(memory=4e8), COMM)
    assert budget.most(small, 0.0) == pytest.approx(1.0 + 1.1e8 / (300 * BYTES[2]))
    assert Budgeted(Budget(memory=2e8), COMM).most(small, 0.0) < 1.0


def test_memory_that_is_free_beside_what_the_ranks_have(monkeypatch):
    """A run that has a gigabyte of a machine where another four are free may have 4.4 in all."""
    monkeypatch.setattr("pcontact.runtime.profile.memory", lambda: (10**9, 10**9))
    monkeypatch.setattr("pcontact.runtime.profile.free_memory", lambda: 4e9)
    most = Budgeted(Budget(), MPI.COMM_SELF).most([done(100_000, 2, 0.1, memory=1e9)], 0.0)
    assert most == pytest.approx(1.0 + 0.85 * 4e9 / (BYTES[2] * 100_000))
