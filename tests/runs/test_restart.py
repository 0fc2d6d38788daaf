"""Checkpoint and restart: the numbers of the uninterrupted run, on any number of ranks."""

import json
import shutil

import h5py
import numpy as np
import pytest

from meshes import one_block
from pcontact.io.checkpoint import NAME
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
)
from pcontact.simulation import Simulation

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
STOP = 4  # load step after which a run is interrupted

def block(path, interference="resolve", height=0.0, **output):
    """A block pressed on a plane by a force, dragged and dragged back: stick, slip, stick, slip."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[
            Contact("bottom", obstacle=Obstacle("plane", point=[0, height], normal=[0, 1]), name="floor", friction=0.3,
                    interference=interference)
        ],
        displacements=[Displacement("top", [0.1, "free"], [(0, 0), (0.25, 0), (0.625, 1), (1, -1)])],
        loads=[Load("top", pressure=10.0, amplitude=[(0, 0), (0.25, 1), (1, 1)])],
        steps=Steps(1.0, 8),
        output=Output(fields=False, checkpoint=True, **output),
        petsc={"snes_rtol": "1e-10"},
    )  # fmt: skip


class Keep:
    """Copies the checkpoint of a step aside, as a run that died after it would leave it."""

    def __init__(self, source, target, comm):
        self.source, self.target, self.comm = source, target, comm

    def step(self, step, u, record):
        if step.number == STOP and self.comm.rank == 0:
            self.target.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, self.target / NAME)

    def cut(self, target, outcome):
        pass

    def end(self, converged):
        pass


def run(scene, comm, directory, observers=(), restart=None):
    """Records of the report. Collective on `comm`."""
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run(directory, observers)
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return json.loads((directory / "report.json").read_text())["steps"]


def difference(a, b):
    """Largest difference of the numbers of two records, relative to the largest number of its kind."""
    worst = 0.0
    for key in ("force", "max_pressure", "max_penetration"):
        x, y = (np.atleast_1d(record["contacts"]["floor"][key]) for record in (a, b))
        worst = max(worst, float(np.max(np.abs(x - y)) / np.max(np.abs(x))))
    x, y = np.array(a["reactions"]["top"]), np.array(b["reactions"]["top"])
    return max(worst, float(np.max(np.abs(x - y)) / 10.0))


def counts(record):
    return [record["contacts"]["floor"][key] for key in ("open", "stick", "slip")]


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
