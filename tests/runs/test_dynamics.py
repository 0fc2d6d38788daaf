"""Runs with inertia: restart, ranks, phases, fields; and nothing of it without."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from meshes import one_block
from pcontact.assembly import matrix
from pcontact.io.checkpoint import NAME
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Dynamics,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Scene,
    Steps,
)
from pcontact.simulation import Simulation
from tests.support.dynamics import FALL, HEIGHT, bar, collision, make, pulled
from tests.support.restarts import STOP, Keep, KeepAll, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


def energies(steps):
    return np.array([[step["energy"][key] for key in ("kinetic", "stored", "numerical", "defect")] for step in steps])


@parallel
@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("integrator", ["hht", "bossak"])
def test_a_restart_goes_on_as_the_run_would(shared_tmp, integrator):
    """Interrupted in flight, and hit after that: finite strain, friction; the same digits on the same ranks."""
    scene = collision(shared_tmp, 0.02, 0.24, integrator=integrator)
    scene.output = Output(fields=False, checkpoint=True)
    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run(scene, WORLD, out, [Keep(out, dead, WORLD)])
    again = run(scene, WORLD, shared_tmp / "again", restart=dead)
    assert len(again) == len(full) - STOP and full[-1]["contacts"]["pair"]["force"][1] != 0.0
    for a, b in zip(full[STOP:], again, strict=True):
        assert a["newton"] == b["newton"]
        for name in ("inertia", "energy"):
            for key, value in a[name].items():
                assert b[name][key] == pytest.approx(value, rel=1e-12, abs=1e-13)
    if WORLD.size > 1:
        alone = run(scene, SELF, shared_tmp / f"alone{WORLD.rank}", restart=dead)
        assert energies(alone) == pytest.approx(energies(full[STOP:]), abs=1e-8)


@parallel(1, 3)
@pytest.mark.usefixtures("one_order")
def test_a_restart_at_and_beside_a_corner(shared_tmp):
    """The motion of a support has one at the end of the fourth load step: the impulse comes after the checkpoint."""
    scene = pulled(shared_tmp, 8, 0.01, [(0, 0), (0.2, 0), (0.5, 1)], 0.5, 10)
    scene.output = Output(fields=False, checkpoint=True)
    out = shared_tmp / "out"
    full = run(scene, WORLD, out, [KeepAll(out, shared_tmp, WORLD)])
    assert full[3]["time"] == 0.2 and full[3]["energy"]["supports"] == 0.0 < full[4]["energy"]["supports"]
    for done in (3, 4, 5):
        again = run(scene, WORLD, shared_tmp / f"again{done}", restart=shared_tmp / str(done))
        for a, b in zip(full[done:], again, strict=True):
            assert a["energy"] == b["energy"] and a["inertia"] == b["inertia"] and a["reactions"] == b["reactions"]


def test_a_corner_of_another_amplitude_is_none_of_a_support(shared_tmp):
    """A support that moves smoothly keeps the velocity that the integrator gives it where a load or an overlap has a
    corner."""

    def moved(corner):
        scene = pulled(shared_tmp, 8, 0.01, None, 0.5, 10)
        scene.displacements[-1] = Displacement("right", ["0.01*sin(9*t)", "free"])
        straight = [(0.0, 1.0), (0.2, 1.0), (0.5, 1.0)] if corner else [(0.0, 1.0), (0.5, 1.0)]
        scene.loads = [Load("block", body_force=[0.001, 0.0], amplitude=straight)]
        return run(scene, SELF, shared_tmp / f"out{corner}")

    for one, other in zip(moved(False), moved(True), strict=True):
        assert one["inertia"] == other["inertia"] and one["reactions"] == other["reactions"]


def test_a_support_goes_on_in_the_next_phase(shared_tmp):
    """It stretches a rod that has no inertia yet, and moves on when it has; then it stands still."""
    scene = pulled(shared_tmp, 20, 0.02, [(0, 0), (1, 0.5), (1.4, 1)], integrator="trapezoidal")
    scene.dynamics.phases = ["pull", "after"]
    scene.displacements += [Displacement("right", [0.0, "free"])]
    scene.phases = [Phase("stretch", 1.0, 2), Phase("pull", 0.4, 32), Phase("after", 0.4, 32)]
    scene.steps = Steps()
    steps = run(scene, SELF, shared_tmp / "out")
    time, force = (np.array(column) for column in zip(*((one["time"], one["reactions"]["left"][0]) for one in steps),
                                                      strict=True))  # fmt: skip
    speed = 0.01 / 0.4
    assert force[(time > 1.1) & (time < 1.4)] == pytest.approx(0.01 + speed, rel=0.05)
    assert force[(time > 1.5) & (time < 1.8)] == pytest.approx(0.02 - 0.01, abs=0.05 * speed)
    assert max(abs(step["energy"]["defect"]) for step in steps) < 1e-12


def test_a_stiff_block_that_a_belt_drags(shared_tmp):
    """Its waves are too fast for the load steps, and points slide to and fro: steps of Newton's method do not."""
    path, belt = make(one_block, shared_tmp / "b.msh", 2, (6, 3), size=[2.0, 1.0]), [[0, 0], [0.2, 1]]
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0], displacement=[0.2, 0.0], amplitude=belt)
    scene = Scene(
        MeshSpec(path), {"m": Material(1e6, 0.3, density=1.0)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=floor, name="belt", friction=0.5)],
        loads=[Load("top", pressure=100.0, amplitude=[[0, 1], [1, 1]])],
        steps=Steps(0.2, 20), output=Output(fields=False), dynamics=Dynamics(),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    assert len(steps) == 20 and not any(step["cutbacks"] for step in steps)
    assert sum(step["newton"] for step in steps) < 150
    # it goes with the belt as soon as friction has given it that speed, and vibrates
    assert steps[-1]["inertia"]["momentum"][0] == pytest.approx(2.0, rel=5e-3)


def test_a_checkpoint_is_of_its_integrator(shared_tmp):
    scene = collision(shared_tmp, 0.02, 0.1)
    scene.output = Output(fields=False, checkpoint=True)
    run(scene, SELF, shared_tmp / "out")
    assert (shared_tmp / "out" / NAME).exists()
    scene.dynamics = Dynamics(integrator="trapezoidal")
    with pytest.raises(InputError, match=r"dynamics\.integrator: found trapezoidal; allowed: .*default"):
        run(scene, SELF, shared_tmp / "again", restart=shared_tmp / "out")


def test_phases_of_statics_and_of_motion(shared_tmp):
    """A bar is stretched, let go, and swings about where it would rest; then it stands still."""
    path = make(one_block, shared_tmp / "rod.msh", 2, (20, 1))
    supports = [Displacement("left", [0.0, "free"])] + [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)}, [Body("block", "m")],
        displacements=[*supports, Displacement("right", [0.01, "free"], phases=["stretch"])],
        phases=[Phase("stretch"), Phase("let go", 0.02, 1), Phase("swing", 4.0, 80), Phase("rest")],
        output=Output(fields=False, probes=["right"]),
        dynamics=Dynamics(integrator="trapezoidal", phases=["let go", "swing"]),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    end = np.array([step["probes"]["right"]["mean"][0] for step in steps])
    phase = [step["phase"] for step in steps]
    swing = end[[name == "swing" for name in phase]]
    # a quarter of a period is L / c = 1: it goes from 0.01 to -0.01 and back
    assert swing.min() == pytest.approx(-0.01, rel=0.08) and swing[-1] == pytest.approx(0.01, rel=0.08)
    assert end[-1] == pytest.approx(0.0, abs=1e-12) and steps[-1]["energy"]["kinetic"] == 0.0
    stretched = steps[0]["energy"]["stored"]
    moving = [step for step, name in zip(steps, phase, strict=True) if name == "swing"]
    for step in moving:
        assert step["energy"]["kinetic"] + step["energy"]["stored"] == pytest.approx(stretched, rel=0.02)
        assert abs(step["energy"]["defect"]) < 1e-10


def test_a_rigid_group_has_the_mass_of_its_cells(shared_tmp):
    """A block that is one rigid group: a force moves it, and turns it, as a rigid body."""
    path = make(one_block, shared_tmp / "block.msh", 2, 3)
    scene = Scene(
        MeshSpec(path), {"m": Material(100.0, 0.3, density=3.0)}, [Body("block", "m")], couplings=[Coupling("block")],
        loads=[Load("block", force=[0.06, 0.0], moment=0.02, amplitude=[(0, 1), (1, 1)])], steps=Steps(0.5, 10),
        output=Output(fields=False), dynamics=Dynamics(integrator="trapezoidal"),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    motion = steps[-1]["couplings"]["block"]
    assert motion["displacement"] == pytest.approx([0.5 * 0.02 * 0.25, 0.0], rel=1e-8, abs=1e-12)
    assert motion["rotation"] == pytest.approx(0.5 * 0.02 / (3.0 / 6.0) * 0.25, rel=1e-8)
    assert steps[-1]["inertia"]["momentum"] == pytest.approx([0.03, 0.0], rel=1e-8, abs=1e-12)


@parallel(1, 2)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_reference_point_has_a_mass_of_its_own(shared_tmp, dim):
    """A light block with a heavy point: translation by the mass, rotation by the inertia, of both."""
    path = make(one_block, shared_tmp / f"block{dim}.msh", dim, 2)
    mass, inertia = 5.0, 0.25
    forces = {"force": [0.06, *[0.0] * (dim - 1)], "moment": 0.02 if dim == 2 else [0.0, 0.0, 0.02]}
    point = Coupling("block", mass=mass, inertia=inertia if dim == 2 else (9.0, 9.0, inertia))
    scene = Scene(
        MeshSpec(path), {"m": Material(100.0, 0.3, density=3.0)},
        [Body("block", "m", initial_velocity=[0.0, 0.1, 0.0][:dim])], couplings=[point],
        loads=[Load("block", amplitude=[(0, 1), (1, 1)], **forces)], steps=Steps(0.5, 10),
        output=Output(fields=False), dynamics=Dynamics(integrator="trapezoidal"),
    )  # fmt: skip
    steps = run(scene, WORLD, shared_tmp / "out")
    motion, energy = steps[-1]["couplings"]["block"], steps[-1]["energy"]
    assert motion["displacement"][:2] == pytest.approx([0.5 * 0.06 / 8.0 * 0.25, 0.05], rel=1e-7, abs=1e-12)
    turn = np.atleast_1d(motion["rotation"])[-1]
    assert turn == pytest.approx(0.5 * 0.02 / (3.0 / 6.0 + inertia) * 0.25, rel=1e-7)
    assert energy["kinetic"] - energy["initial"] == pytest.approx(energy["loads"], rel=1e-7)
    assert energy["initial"] == pytest.approx(0.5 * 8.0 * 0.1**2, rel=1e-9) and abs(energy["defect"]) < 1e-9


def test_fields_of_nodes(shared_tmp):
    scene = collision(shared_tmp, 0.02, 0.04, strain="small")
    scene.output = Output(fields=True, format="vtu")
    run(scene, SELF, shared_tmp / "out")
    data = meshio.read(next((shared_tmp / "out").rglob("*bodies*2*.vtu"))).point_data
    y = meshio.read(shared_tmp / "two2.msh").points[:, 1]
    assert data["velocity"].shape == data["acceleration"].shape
    assert np.abs(data["velocity"][:, 1]).max() == pytest.approx(1.0 + 0.4 * 0.5, rel=1e-6) and len(y)


@pytest.mark.parametrize("said", [True, False])
def test_supports_that_move_are_in_the_balance(shared_tmp, said):
    """The end of a free rod is drawn with constant velocity from the first moment on: half of the work is stored."""
    path = make(one_block, shared_tmp / "rod.msh", 2, (20, 1))
    supports = [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)}, [Body("block", "m")],
        displacements=[*supports, Displacement("left", [0.01, "free"], [(0, 0), (1, 1)] if said else None)],
        steps=Steps(1.0, 60), output=Output(fields=False), dynamics=Dynamics(),
    )  # fmt: skip
    energy = run(scene, SELF, shared_tmp / "out")[-1]["energy"]
    # the wave has just reached the other end: all moves, with 1/2 rho v^2, and is strained by v / c
    assert energy["kinetic"] == pytest.approx(0.5e-4, rel=0.05) and energy["stored"] == pytest.approx(0.5e-4, rel=0.05)
    assert energy["supports"] == pytest.approx(1e-4, rel=0.05) and abs(energy["defect"]) < 1e-9


def test_steps_follow_the_local_error(shared_tmp):
    """Long in flight, cut where the bar hits, and longer again; a smaller error takes more of them."""
    counts = []
    for allowed in (1e-2, 4e-3):
        scene = bar(shared_tmp, 20, 0.9, courant=4.0, step_error=allowed)
        scene.steps.control = "auto"
        steps = run(scene, SELF, shared_tmp / f"{allowed}")
        time = np.array([step["time"] for step in steps])
        size, hit = np.diff(time, prepend=0.0), int(np.searchsorted(time, 0.5))
        assert max(step["cutbacks"] for step in steps[hit - 1 : hit + 2]) > 0
        assert size[hit : hit + 10].min() < 0.3 * size[: hit - 1].max()
        counts.append(len(steps))
    assert counts[1] > 1.3 * counts[0]


def test_a_run_without_has_nothing_of_it(shared_tmp):
    """Neither an item, nor a key of the report."""
    scene = replace(bar(shared_tmp, 4, 0.1), dynamics=None)
    scene.bodies = [Body("block", "m")]
    scene.displacements.append(Displacement("top", ["free", -HEIGHT]))
    simulation = Simulation(scene, SELF)
    try:
        assert simulation.problem.features.inertia is None and simulation.energy is None
        assert all(item.name != "inertia" for item in simulation.problem.items)
        assert scene.output.energy is False and simulation.scene.contacts[0].theta == 0.0
    finally:
        simulation.free()


@pytest.mark.parallel(1, 3)
def test_a_velocity_that_a_mean_motion_does_not_admit(shared_tmp):
    """It becomes the nearest one that it does, the same on any ranks."""
    path = make(one_block, shared_tmp / "mean.msh", 2, 4)
    scene = Scene(
        MeshSpec(path), {"m": Material(100.0, 0.3, density=1.0)},
        [Body("block", "m", initial_velocity=[0.3, 1.0])],
        couplings=[Coupling("top", average=True, displacement=[0.02, "free"])], steps=Steps(0.1, 5),
        output=Output(fields=False), dynamics=Dynamics(),
    )  # fmt: skip
    energy = run(scene, WORLD, shared_tmp / "out")[-1]["energy"]
    assert 0.5 < energy["initial"] < 0.5 * (0.3**2 + 1.0) and abs(energy["defect"]) < 1e-9
    alone = run(scene, SELF, shared_tmp / f"alone{WORLD.rank}")[-1]["energy"]
    for key, value in energy.items():
        assert alone[key] == pytest.approx(value, rel=1e-7, abs=1e-9)


def test_rows_of_the_bodies_are_written_once_a_step(tmp_path, monkeypatch):
    """Inertia is linear: after that, those of contact alone are, as without inertia."""
    rows, write = [], matrix._write
    monkeypatch.setattr(matrix, "_write", lambda *arguments: rows.append(len(arguments[0])) or write(*arguments))
    simulation = Simulation(bar(tmp_path, 20, HEIGHT / FALL + 0.1))
    try:
        assert simulation.run(None, [])
        problem, u, rows[:] = simulation.problem, simulation.stepper.u, []
        for time in (1.0, 1.1):
            for item in problem.items:
                item.detect(u, time)
            problem.tangent(u)
            problem.tangent(u)
        nodes = problem.space.n_owned
    finally:
        simulation.close()
    assert rows[0] == rows[2] == nodes and 0 < rows[1] == rows[3] < nodes // 2


def test_an_overlap_is_pushed_out_over_the_first_step(shared_tmp):
    """Not at once: that sets free an energy in proportion to gamma0."""
    found = []
    for gamma0 in (100.0, 1000.0):
        scene = bar(shared_tmp, 20, 0.1, velocity=0.0)
        sunk = Obstacle("plane", point=[0.0, HEIGHT + 0.1], normal=[0.0, 1.0])
        scene.contacts = [replace(scene.contacts[0], obstacle=sunk, gamma0=gamma0)]
        found.append(energies(run(scene, WORLD, shared_tmp / "sunk"))[:, :2].sum(axis=1))
    np.testing.assert_allclose(*found, rtol=0.1)
