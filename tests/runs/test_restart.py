"""Checkpoint and restart: the numbers of the uninterrupted run, on any number of ranks."""


import h5py
import numpy as np
import pytest

from meshes import one_block
from pcontact.io.checkpoint import NAME
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, block, counts, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


def difference(a, b):
    """Largest difference of the numbers of two records, relative to the largest number of its kind."""
    worst = 0.0
    for key in ("force", "max_pressure", "max_penetration"):
        x, y = (np.atleast_1d(record["contacts"]["floor"][key]) for record in (a, b))
        worst = max(worst, float(np.max(np.abs(x - y)) / np.max(np.abs(x))))
    x, y = np.array(a["reactions"]["top"]), np.array(b["reactions"]["top"])
    return max(worst, float(np.max(np.abs(x - y)) / 10.0))


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "block.msh"
    if WORLD.rank == 0:
        one_block(path, 2, 6)
    WORLD.Barrier()
    return path


@parallel
@pytest.mark.parametrize(("interference", "height"), [("resolve", 0.0), ("adjust", 0.01)])
@pytest.mark.usefixtures("one_order")
def test_restart_gives_the_same_numbers(mesh, shared_tmp, interference, height):
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(block(mesh, interference, height), WORLD, out, [Keep(out, dead, WORLD)])
    again = run(block(mesh, interference, height), WORLD, shared_tmp / "again", restart=dead)
    assert len(again) == len(full) - STOP
    # the run sticks, slips, sticks and slips again after the restart
    assert {bool(counts(r)[1]) for r in full[STOP:]} | {bool(counts(r)[2]) for r in full[STOP:]} == {True, False}
    for a, b in zip(full[STOP:], again, strict=True):
        assert a["time"] == b["time"] and a["newton"] == b["newton"] and counts(a) == counts(b)
        assert difference(a, b) < 1e-12


@parallel
def test_restart_on_other_ranks(mesh, shared_tmp):
    """Written by all ranks and read by one, and the other way round."""
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(block(mesh), WORLD, out, [Keep(out, dead, WORLD)])
    alone = run(block(mesh), SELF, shared_tmp / f"alone{WORLD.rank}", restart=dead)
    mine, copy = shared_tmp / f"single{WORLD.rank}", shared_tmp / f"copy{WORLD.rank}"
    single = run(block(mesh), SELF, mine, [Keep(mine, copy, SELF)])
    WORLD.Barrier()
    together = run(block(mesh), WORLD, shared_tmp / "together", restart=shared_tmp / "copy0")
    for a, b, c, d in zip(full[STOP:], alone, single[STOP:], together, strict=True):
        assert counts(a) == counts(b) == counts(c) == counts(d)
        for other in (b, c, d):
            assert difference(a, other) < 1e-7


@parallel
def test_every_other_step_and_the_last(mesh, shared_tmp):
    seen = []

    class Look(Keep):
        def step(self, step, u, record):
            with h5py.File(self.source / NAME, "r") as file:
                seen.append(int(file.attrs["number"]))

    out = shared_tmp / "out"
    scene = block(mesh, checkpoint_every=3)
    simulation = Simulation(scene)

    class Late(Look):
        def step(self, step, u, record):
            if step.number >= 3:
                super().step(step, u, record)

    assert simulation.run(out, [Late(out, None, WORLD)])
    simulation.close()
    last = simulation.stepper.schedule
    assert last.done and seen[0] == 3 and seen[1] == 3 and 6 in seen and seen[-1] == len(seen) + 2


@parallel
def test_what_cannot_be_continued(mesh, shared_tmp):
    out = shared_tmp / "out"
    run(block(mesh), WORLD, out)
    other = shared_tmp / "other.msh"
    if WORLD.rank == 0:
        one_block(other, 2, 5)
        (shared_tmp / "broken").mkdir()
        (shared_tmp / "broken" / NAME).write_bytes(b"no such thing")
    WORLD.Barrier()
    for path, place, said in (
        (other, out, "nodes: found 49; allowed: 36"),
        (mesh, shared_tmp / "nowhere", "found no checkpoint.h5 there"),
        (mesh, shared_tmp / "broken", "found no readable checkpoint"),
    ):
        with pytest.raises(InputError, match=said):
            run(block(path), WORLD, shared_tmp / "again", restart=place)
