"""Bodies that find no equilibrium near by go on with inertia until they rest: an arch whose load has a limit point."""

import logging

import numpy as np
import pytest

from meshes.grid import name_boundary, near
from meshes.patches import patches, sector
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
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
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
LOAD = 0.3


def scene(path, density=1.0, load=LOAD, way=None, floor=None, **steps):
    """Half of a clamped arch of radius 10, 1.34 high, under a load on its back, or whose middle is moved."""
    middle = Displacement("middle", [0.0, "free" if way is None else -way])
    floors = [] if floor is None else [Contact(
        "inner", obstacle=Obstacle("plane", point=[0.0, floor], normal=[0.0, 1.0]), name="floor", friction=0.2,
        search_radius=3.0)]  # fmt: skip
    return Scene(
        MeshSpec(path, strain="finite", mean_dilatation=True), {"m": Material(1000.0, 0.3, density=density)},
        [Body("arch", "m")], contacts=floors, displacements=[Displacement("foot", [0.0, 0.0]), middle],
        loads=[] if load is None else [Load("outer", traction=[0.0, -load])],
        steps=Steps(count=10, min_step=5e-3, **({"through_snaps": "dynamic"} | steps)),
        output=Output(fields=False, energy=True, probes=["middle"], checkpoint=True), petsc={"snes_max_it": "20"},
    )  # fmt: skip


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "arch.msh"
    if WORLD.rank == 0:
        with patches(path) as bodies:
            grid = sector(np.linspace(9.85, 10.15, 3), np.linspace(60.0, 90.0, 21), 1)

            def radius(x):
                return np.hypot(x[..., 0], x[..., 1])

            bodies["arch"] = name_boundary(
                grid, "foot", outer=lambda x: radius(x).min(axis=1) > 10.149,
                inner=lambda x: radius(x).max(axis=1) < 9.851, middle=near(0, 0.0),
            )  # fmt: skip
    WORLD.Barrier()
    return path


def crown(step):
    return step["probes"]["middle"]["mean"][1]


def test_an_arch_snaps_through(shared_tmp, mesh, caplog):
    """It rests where it would with the load at once, and the balance of energy has what the snap has set free."""
    caplog.set_level(logging.INFO)
    steps = run(scene(mesh), SELF, shared_tmp / "out")
    way = np.array([crown(step) for step in steps])
    snap = int(np.argmax(-np.diff(way))) + 1
    assert way[snap - 1] > -0.7 and way[snap] < -2.3 and steps[-1]["time"] == 1.0
    assert steps[snap]["imbalance"] < 1e-6 and steps[snap]["cutbacks"] > 0
    assert "no equilibrium near by" in caplog.text and "bodies rest after" in caplog.text
    energy, before = steps[-1]["energy"], steps[snap - 1]
    assert before["snaps"]["energy"] == 0.0 and steps[-1]["snaps"]["energy"] == steps[snap]["snaps"]["energy"]
    assert energy["snaps"] == steps[-1]["snaps"]["energy"]
    # what loads have done and is not stored is gone with the snap; the rest is that of sums over load steps
    assert energy["snaps"] == pytest.approx(energy["loads"] - energy["stored"], rel=5e-3)
    assert abs(energy["defect"]) < 2e-3 and energy["snaps"] > 0.2 * energy["loads"]
    # the same place on the way of a prescribed motion of the middle, which keeps it straight, and bears nothing there
    held = scene(mesh, way=-way[-1], through_snaps=None)
    there = run(held, SELF, shared_tmp / "held")[-1]
    assert abs(there["reactions"]["middle"][1]) < 5e-3 * abs(there["reactions"]["foot"][1])


def test_without_the_run_ends_there(mesh):
    simulation = Simulation(scene(mesh, density=None, through_snaps=None), SELF)
    try:
        assert simulation.problem.features.snap is None and not simulation.run()
    finally:
        simulation.close()
    assert "from time 0.7" in str(simulation.failure)


@pytest.mark.parametrize(("change", "message"), [
    ({"density": None}, r"materials\.m\.density: found nothing, with through_snaps \(body arch\); allowed: a number"),
    ({"through_snaps": "static"}, r'through_snaps: found .*static.*; allowed: "dynamic"'),
])  # fmt: skip
def test_what_it_needs(mesh, change, message):
    with pytest.raises(InputError, match=message):
        Simulation(scene(mesh, **change), SELF)


@parallel(1, 2, 3)
def test_it_comes_to_rest_on_an_obstacle(shared_tmp, mesh):
    """With contact and friction, on any ranks; the same digits after a restart behind the snap."""
    case = scene(mesh, floor=8.3)
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    steps = run(case, WORLD, out, [Keep(out, dead, WORLD)])
    last = steps[-1]
    assert last["contacts"]["floor"]["force"][1] < -0.1 and last["contacts"]["floor"]["max_penetration"] < 0.01
    assert last["snaps"]["energy"] > 0.1 and abs(last["energy"]["defect"]) < 5e-3
    again = run(case, WORLD, shared_tmp / "again", restart=dead)
    assert len(again) == len(steps) - STOP
    assert crown(again[-1]) == pytest.approx(crown(last), rel=1e-9)
    assert again[-1]["snaps"]["energy"] == pytest.approx(last["snaps"]["energy"], rel=1e-6)
    if WORLD.size > 1:
        alone = run(case, SELF, shared_tmp / f"alone{WORLD.rank}")
        assert crown(alone[-1]) == pytest.approx(crown(last), rel=1e-6)
        assert alone[-1]["snaps"]["energy"] == pytest.approx(last["snaps"]["energy"], rel=1e-3)
