"""Snap-fit: corners that pass each other with friction, and a root that yields."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import clip
from meshes import CLIP
from meshes import clip as clip_mesh
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
COUNT = 30


def history(path, comm=WORLD, friction=0.2, **said):
    """The observer of a run. Collective on `comm`."""
    observer = clip.History()
    simulation = Simulation(clip.scene(path, 2, friction, **{"count": COUNT, **said}), comm)
    try:
        assert simulation.run(None, [observer])
    finally:
        simulation.close()
    return observer


@pytest.fixture
def mesh(shared_tmp):
    return make_mesh(clip_mesh, shared_tmp / "clip.msh", 2, 0.2, 2, "quadrilateral")


def test_snaps_in(mesh):
    """Through the snap; the forces balance, and nothing is left of them."""
    observer = history(mesh)
    rows, result = observer.rows, clip.measure(observer.rows)
    assert result["cutbacks"] == len(observer.cuts) <= 2
    assert result["imbalance"] < 1e-5 and result["left"] < clip.NO_FORCE
    assert CLIP.passed - 0.2 < result["snap"] < CLIP.travel
    assert 0.6 < result["peak"] < 0.9 and 0.7 < result["peak_vertical"] < 1.1
    assert result["plastic_strain"] > 1e-3
    # before the bodies touch, the clip moves as it is: no row of cells yields on the way
    free = [row for row in rows if row["travel"] < CLIP.first_touch - 0.01]
    assert free and all(row["plastic_strain"] == 0.0 for row in free)


def test_work_comes_back(mesh):
    """Elastic and without friction the hook gives back behind the crest what it took before, but for the load steps.

    With partners of the beginning of a load step 69 % and 31 % would be lost.
    """
    lost = []
    for count in (30, 120):
        push = clip.sampled(history(mesh, friction=0.0, yield_stress=0.0, count=count).rows)
        lost.append(push.sum() / np.maximum(push, 0.0).sum())
    assert abs(lost[0]) < 0.2 and abs(lost[1]) < 0.025


@pytest.mark.parametrize("through", [None, "dynamic"])
def test_load_steps_too_long_for_the_snap(shared_tmp, through):
    """Finite strain, and load steps that are not to be halved: the run ends before the snap, or goes on through it with
    inertia, and the hook is free behind the catch, too."""
    path = make_mesh(clip_mesh, shared_tmp / "straight.msh", 2, 0.2, 1, "quadrilateral")
    scene, observer = clip.scene(path, 2, 0.2, count=8, strain="finite"), clip.History()
    scene.materials["plastic"].density, scene.steps.min_step, scene.steps.through_snaps = 1.0, 1.0 / 8.0, through
    simulation = Simulation(scene, SELF)
    try:
        assert simulation.run(None, [observer]) == (through is not None)
        taken = None if through is None else simulation.problem.features.snap.taken.carried
    finally:
        simulation.close()
    result = clip.measure(observer.rows)
    assert (result["left"] < clip.NO_FORCE) == (through is not None)
    assert through is None or (taken > 0.0 and len(observer.rows) == 8)


@pytest.mark.parallel(2, 3)
def test_ranks_do_not_matter(mesh):
    """Forces of every load step against those of one rank."""
    # points on edges keep partners that were found at iterates, which depend on the linear solves
    tight = {"snes_rtol": "1e-11", "contact_search_again": "0"}
    one = history(mesh, SELF, petsc=tight).rows
    WORLD.Barrier()
    all_ = history(mesh, WORLD, petsc=tight).rows
    for a, b in zip(one, all_, strict=True):
        assert [a[key] for key in ("open", "stick", "slip")] == [b[key] for key in ("open", "stick", "slip")]
        found, wanted = ([row["push"], row["vertical"]] for row in (b, a))
        assert np.allclose(found, wanted, rtol=0.0, atol=1e-7)


def row(travel, push, vertical):
    """A made-up load step."""
    nothing = dict.fromkeys(("cutbacks", "imbalance", "plastic_strain"), 0.0)
    return {"travel": travel, "push": push, "vertical": vertical, "newton": 3, **nothing}


def test_numbers_of_a_history():
    end = CLIP.travel
    rows = [row(0.25 * end, 0.0, 0.0), row(0.5 * end, 3.0, 4.0), row(0.75 * end, 2.0, 1.0), row(end, 0.0, 0.0)]
    result = clip.measure(rows)
    assert (result["peak"], result["peak_vertical"], result["snap"]) == (3.0, 4.0, 0.75 * end)
    assert result["peak_travel"] == 0.5 * end and result["left"] == 0.0 and np.isnan(result["retention"])
    assert list(clip.stages(rows).values()) == [1, 1, 2, 4]
    assert clip.distance(rows, rows) == 0.0
    twice = [{**r, "push": 2.0 * r["push"]} for r in rows]
    assert clip.distance(twice, rows) == pytest.approx(1.0)
    # pulled back out: not part of the way in
    pulled = [*rows, row(0.75 * end, -5.0, 1.0)]
    assert clip.measure(pulled)["retention"] == 5.0 and clip.measure(pulled)["peak"] == 3.0
    assert clip.distance(pulled, rows) == 0.0
