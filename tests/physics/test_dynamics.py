"""Bodies with inertia against known answers: bars that hit a wall, blocks that collide, a block that slides."""

import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Dynamics,
    Material,
    MeshSpec,
    Output,
    Periodic,
    Scene,
    Steps,
)
from pcontact.simulation import Simulation
from tests.support.dynamics import FALL, HEIGHT, LENGTH, bar, collision, make, pulled, slider, string
from tests.support.restarts import run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
START = 0.5 * LENGTH * FALL**2


def column(steps, *keys):
    """Numbers (n,) of load steps under some keys."""
    values = steps
    for key in keys:
        values = [one[key] for one in values]
    return np.array(values)


def mechanical(steps):
    return column(steps, "energy", "kinetic") + column(steps, "energy", "stored")


# of 50 cells at a Courant number of 0.5: energy after the impact, mean error of the contact force 300
@pytest.mark.parametrize(
    ("integrator", "theta", "energy", "error"),
    [("hht", 0.0, 0.9993, 0.6), ("trapezoidal", 0.0, 1.0201, 1.2), ("hht", 1.0, 0.9908, 5.0),
     ("trapezoidal", 1.0, 1.0003, 6.0)],
)  # fmt: skip
def test_a_bar_hits_a_wall(shared_tmp, integrator, theta, energy, error):
    steps = run(bar(shared_tmp, 50, 1.4, theta=theta, integrator=integrator), SELF, shared_tmp / "out")
    time, force = column(steps, "time"), -column(steps, "contacts", "wall", "force")[:, 1]
    after = mechanical(steps)[-1] / START
    assert after == pytest.approx(energy, abs=1e-3)
    inside = (time > 0.55) & (time < 1.1)
    assert np.mean(np.abs(force[inside] - 300.0)) < error
    touched = time[force > 0.0]
    assert touched[0] == pytest.approx(0.5, abs=0.005) and touched[-1] == pytest.approx(7 / 6, abs=0.015)
    # it leaves as a whole; with the sums of works by the trapezoidal rule, what is elastic adds up to rounding
    assert steps[-1]["inertia"]["momentum"][1] / LENGTH == pytest.approx(FALL * np.sqrt(after), rel=0.02)
    assert np.abs(column(steps, "energy", "defect")).max() < 1e-10
    assert steps[-1]["energy"]["initial"] == pytest.approx(START, rel=1e-12)
    if integrator == "trapezoidal":
        assert abs(steps[-1]["energy"]["numerical"]) < 1e-10 * START


@pytest.mark.slow
def test_a_bar_bounces(shared_tmp):
    """From rest under gravity, three times: how high it comes again, where its foot is, what gravity has done.

    At this Courant number waves of all lengths are nearly as fast; where they are not they come back from the ends of
    the bar one after the other, and the energy of the fall stays in them.
    """
    scene = bar(shared_tmp, 100, 9.0, courant=np.sqrt(0.5), gravity=10.0, velocity=0.0, theta=0.0)
    steps = run(scene, SELF, shared_tmp / "out")
    time, foot = column(steps, "time"), HEIGHT + column(steps, "probes", "bottom", "mean")[:, 1]
    for at, place in ((2.0, 1.6667), (2.5, 4.0278), (3.0, 4.4444)):
        assert np.interp(at, time, foot) == pytest.approx(place, rel=0.01)
    middle = HEIGHT + 0.5 * LENGTH - column(steps, "energy", "loads") / (10.0 * LENGTH)
    for begin, end, height in ((5 / 3, 11 / 3, 9.25926), (13 / 3, 19 / 3, 10.0), (7.0, 9.0, 9.25926)):
        assert middle[(time > begin) & (time < end)].max() == pytest.approx(height, rel=0.01)
    # what gravity does is in the balance from the first moment on
    assert np.abs(column(steps, "energy", "defect")).max() < 1e-9
    assert mechanical(steps)[-1] - steps[-1]["energy"]["loads"] == pytest.approx(0.0, abs=0.05 * START)


@pytest.mark.parametrize(("integrator", "left"), [("trapezoidal", 0.97), ("hht", 0.9)])
def test_a_bar_that_hits_the_wall_for_ever(shared_tmp, integrator, left):
    """E = rho = L = 1: contact from 1 to 2 of every period of 3, with the stress -1/2; energy 1/8."""
    steps = run(string(shared_tmp, 20, 4, integrator=integrator), SELF, shared_tmp / "out")
    time, force = column(steps, "time"), -column(steps, "contacts", "wall", "force")[:, 1]
    phase = time % 3.0
    assert np.mean(force[(phase > 1.1) & (phase < 1.9)]) == pytest.approx(0.5, abs=0.03)
    assert np.all(force[(phase < 0.9) | (phase > 2.1)] == 0.0)
    energy = mechanical(steps) / 0.125
    ends = np.searchsorted(time, 3.0 * np.arange(1, 5) - 0.01)
    # on 20 cells; what open points of the wall still pull at is some of it
    assert np.all(energy[ends] > left) and np.all(energy[ends] < 1.03)


@parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_a_free_collision_keeps_the_momentum(shared_tmp, dim):
    """Finite strain, friction, a body that turns: momentum to the tolerance of the solver, on any ranks."""
    scene = collision(shared_tmp, 0.02, 0.3, dim=dim)
    steps = run(scene, WORLD, shared_tmp / "out")
    momentum = column(steps, "inertia", "momentum")
    assert np.abs(momentum - momentum[0]).max() < 1e-8
    assert np.abs(column(steps, "contacts", "pair", "force")).max() > 1.0
    about = column(steps, "inertia", "moment_of_momentum").reshape(len(steps), -1)
    assert np.abs(about - about[0]).max() < 2e-3 * np.abs(about).max()
    assert np.abs(column(steps, "energy", "defect")).max() < 0.01
    lost = steps[-1]["energy"]["contacts"]["pair"]
    assert 0.0 < lost < 0.1 * steps[-1]["energy"]["initial"]
    if WORLD.size > 1:
        alone = run(scene, SELF, shared_tmp / f"alone{WORLD.rank}")
        here = [step["energy"]["kinetic"] for step in steps]
        assert here == pytest.approx([step["energy"]["kinetic"] for step in alone], rel=1e-7)


@pytest.mark.parametrize("point", [False, True])
def test_a_rigid_body_that_moves_freely_hits_a_bar(shared_tmp, point):
    """All of it a rigid group, its mass that of its cells or of its point: until the wave comes back it presses with
    rho c v exp(-rho c t / M)."""
    n, speed, mass = 40, 0.01, 1.0
    path = make(two_blocks, shared_tmp / "rod.msh", 2, (1, n), (1, 1), heights=(1.0, 0.2), gap=0.005)
    light = 1e-3 if point else 5.0 * mass
    scene = Scene(
        MeshSpec(path), {"bar": Material(1.0, 0.0, density=1.0), "rigid": Material(1.0, 0.0, density=light)},
        [Body("lower", "bar"), Body("upper", "rigid", initial_velocity=[0.0, -speed])],
        contacts=[Contact("lower_top", "upper_bottom", name="pair", search_radius=0.05)],
        couplings=[Coupling("upper", mass=mass - 0.2 * light)],
        displacements=[Displacement(side, [0.0, "free"]) for side in ("lower_left", "lower_right")]
        + [Displacement("lower_bottom", [0.0, 0.0])],
        steps=Steps(2.0, 4 * n), output=Output(fields=False), dynamics=Dynamics(),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    time = column(steps, "time") - 0.5
    place = column(steps, "couplings", "upper", "displacement")[:, 1]
    inside = time < 1.4
    way = np.where(time < 0.0, 0.5 + time, 0.5 + mass * (1.0 - np.exp(-np.maximum(time, 0.0) / mass)))
    assert place[inside] == pytest.approx(-speed * way[inside], rel=2e-3)
    assert np.abs(column(steps, "couplings", "upper", "displacement")[:, 0]).max() < 1e-9
    assert sum(step["cutbacks"] for step in steps) == 0 and abs(steps[-1]["energy"]["defect"]) < 1e-9
    assert steps[0]["energy"]["initial"] == pytest.approx(0.5 * mass * speed**2, rel=1e-9)


def test_a_collision_without_friction_keeps_the_moment_of_momentum(shared_tmp):
    """Up to an error that falls nearly fourfold when steps are halved."""
    errors = []
    for dt in (0.02, 0.01):
        scene = collision(shared_tmp, dt, 0.3, friction=0.0, integrator="trapezoidal")
        scene.contacts[0].theta, scene.petsc = 0.0, {"snes_rtol": "1e-11"}
        steps = run(scene, SELF, shared_tmp / f"{dt}")
        momentum, about = (column(steps, "inertia", key) for key in ("momentum", "moment_of_momentum"))
        assert np.abs(momentum - momentum[0]).max() < 1e-10
        assert np.abs(column(steps, "contacts", "pair", "force")).max() > 1.0
        errors.append(np.abs(about - about[0]).max())
    assert errors[0] > 3.5 * errors[1]


def test_a_body_that_turns_keeps_its_moment_of_momentum(shared_tmp):
    """No contact: the error falls fourfold when the step is halved."""
    errors = []
    for count in (10, 20, 40):
        path = make(one_block, shared_tmp / "block.msh", 2, 2)
        scene = Scene(
            MeshSpec(path, strain="finite"), {"m": Material(100.0, 0.3, density=1.0)},
            [Body("block", "m", initial_velocity=["-2*(y - 0.5)", "2*(x - 0.5)"])],
            steps=Steps(0.5, count), output=Output(fields=False), dynamics=Dynamics(integrator="trapezoidal"),
            petsc={"snes_rtol": "1e-12"},
        )  # fmt: skip
        steps = run(scene, SELF, shared_tmp / f"{count}")
        about = column(steps, "inertia", "moment_of_momentum")
        errors.append(np.abs(about - 1.0 / 3.0).max())
    assert errors[0] > 3.3 * errors[1] > 3.3**2 * errors[2]


def test_a_block_slides_until_friction_has_stopped_it(shared_tmp):
    """It rests on the plane first, in a phase without inertia, and then has a velocity."""
    velocity, friction, gravity = 1.0, 0.3, 10.0
    steps = run(slider(shared_tmp, velocity, friction, gravity, 1400, 0.36), SELF, shared_tmp / "out")
    assert "inertia" not in steps[0] and "kinetic" not in steps[0]["energy"] and steps[0]["phase"] == "rest"
    way = steps[-1]["probes"]["bottom"]["mean"][0]
    assert way == pytest.approx(velocity**2 / (2.0 * friction * gravity), rel=1e-3)
    energy = steps[-1]["energy"]
    assert energy["contacts"]["floor"] == pytest.approx(0.5 * velocity**2, rel=1e-3)
    assert abs(energy["defect"]) < 1e-6 and energy["initial"] == pytest.approx(0.5 * velocity**2, rel=1e-9)


@pytest.mark.parametrize(("key", "mode"), [("mass_damping", 0), ("stiffness_damping", 0)])
def test_damping_takes_what_rayleigh_says(shared_tmp, key, mode):
    """A free bar in its first mode: w = pi c / L; the amplitude falls by exp(-zeta w t)."""
    n, zeta, frequency = 40, 0.05, np.pi
    value = {"mass_damping": 2.0 * zeta * frequency, "stiffness_damping": 2.0 * zeta / frequency}[key]
    path = make(one_block, shared_tmp / "rod.msh", 2, (n, 1))
    supports = [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)},
        [Body("block", "m", initial_displacement=["0.01*cos(pi*x)", 0.0], **{key: value})],
        displacements=supports, steps=Steps(4.0, 400), output=Output(fields=False, probes=["left"]),
        dynamics=Dynamics(integrator="trapezoidal"),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    time, end = column(steps, "time"), column(steps, "probes", "left", "mean")[:, 0]
    damped = frequency * np.sqrt(1.0 - zeta**2)
    sine = zeta * frequency / damped * np.sin(damped * time)
    expected = np.exp(-zeta * frequency * time) * (np.cos(damped * time) + sine)
    assert np.abs(end / 0.01 - expected).max() < 0.01
    energy = steps[-1]["energy"]
    assert energy["damping"] == pytest.approx(energy["initial"] - energy["kinetic"] - energy["stored"], rel=1e-3)


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@pytest.mark.parametrize("order", [1, 2])
def test_a_rod_swings_with_its_frequency(shared_tmp, mass, order):
    """The first longitudinal mode of a free rod: consistent mass makes it too fast, lumped mass too slow."""
    path = make(one_block, shared_tmp / "rod.msh", 2, (10, 1), order=order)
    supports = [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    scene = Scene(
        MeshSpec(path, order=order), {"m": Material(1.0, 0.0, density=1.0)},
        [Body("block", "m", initial_displacement=["0.01*cos(pi*x)", 0.0])], displacements=supports,
        steps=Steps(1.5, 300), output=Output(fields=False, probes=["left"]),
        dynamics=Dynamics(integrator="trapezoidal", mass=mass),
    )  # fmt: skip
    steps = run(scene, SELF, shared_tmp / "out")
    time, end = column(steps, "time"), column(steps, "probes", "left", "mean")[:, 0]
    quarter = np.interp(0.0, -end[:200], time[:200])
    assert quarter == pytest.approx(0.5, rel=0.006 if order == 1 else 5e-4)
    if order == 1:
        assert (quarter < 0.5) == (mass == "consistent")


def end_velocity(scene):
    """Velocity (n, 2) of the nodes at the left end, after a run."""
    simulation = Simulation(scene, SELF)
    try:
        assert simulation.run()
        space, inertia = simulation.problem.space, simulation.problem.features.inertia
        return inertia.velocity[np.isin(space.owned_local, space.region("left"))]
    finally:
        simulation.free()


@parallel(1, 3)
@pytest.mark.parametrize("integrator", ["trapezoidal", "hht"])
@pytest.mark.parametrize(("begin", "end", "value", "table"), [
    (0.2, 0.5, 0.01, [(0, 0), (0.2, 0), (0.5, 1)]), (0.0, 2.0, 0.01, [(0, 0), (2, 1)]),
    (0.2, 0.5, "0.01*max(0, min((t - 0.2)/0.3, 1))", None),
])  # fmt: skip
def test_a_support_that_moves_at_once(shared_tmp, integrator, begin, end, value, table):
    """At a corner of its motion, or from the beginning: it exerts rho c v, nothing swings, no energy is missing."""
    way, scene = 0.01, pulled(shared_tmp, 40, value, table, integrator=integrator)
    steps = run(scene, WORLD, shared_tmp / "out")
    time, force = column(steps, "time"), column(steps, "reactions", "left")[:, 0]
    speed, momentum = way / (end - begin), column(steps, "inertia", "momentum")[:, 0]
    moves, apart = (time > begin) & (time <= end), np.minimum(np.abs(time - begin), np.abs(time - end)) > 0.1
    assert np.abs(force - np.where(moves, speed, 0.0))[apart].max() < 0.05 * speed
    assert momentum == pytest.approx(speed * (np.clip(time, begin, end) - begin), abs=0.003 * speed)
    assert np.abs(column(steps, "energy", "defect")).max() < 1e-13
    if WORLD.size > 1:
        alone = run(scene, SELF, shared_tmp / f"alone{WORLD.rank}")
        assert column(alone, "energy", "supports") == pytest.approx(column(steps, "energy", "supports"), rel=1e-9)


def test_an_expression_that_turns_is_an_amplitude(shared_tmp):
    """Load steps end where it does, and the motion is the same, though none would end there of its own."""
    same, turns = (
        run(pulled(shared_tmp, 20, value, table, 1.0, 37, integrator="trapezoidal"), SELF, shared_tmp / "out")
        for value, table in [(0.01, [(0, 0), (0.2, 0), (0.5, 1)]), ("0 if t < 0.2 else min((t - 0.2)/30, 0.01)", None)]
    )
    assert {0.2, 0.5} < set(column(same, "time"))
    for quantity in (("time",), ("reactions", "left"), ("inertia", "momentum"), ("energy", "kinetic")):
        wanted = column(same, *quantity)
        assert column(turns, *quantity) == pytest.approx(wanted, abs=1e-11 * np.abs(wanted).max())


@parallel(1, 2)
def test_what_follows_a_support(shared_tmp):
    """The right end of a rod goes where its left end does, whose velocity changes: load steps begin where velocities
    lead, and nobody else would bring the right end back from there."""
    scene = pulled(shared_tmp, 10, "0.01*sin(3*t)", None, 0.9, 18)
    scene.periodic, scene.output.probes = [Periodic("right", "left", [1.0, 0.0])], ["left", "right"]
    steps = run(scene, WORLD, shared_tmp / "out")
    left, right = (column(steps, "probes", end, "mean")[:, 0] for end in ("left", "right"))
    np.testing.assert_allclose(right, left, atol=1e-15)


def test_the_velocity_of_a_support(shared_tmp):
    """That of its amplitude on both sides of a corner; of a smooth motion up to an error of the second order."""
    for end, speed in ((0.4, 0.01 / 0.3), (0.6, 0.0)):
        scene = pulled(shared_tmp, 4, 0.01, [(0, 0), (0.2, 0), (0.5, 1)], end, 30, integrator="trapezoidal")
        assert end_velocity(scene)[:, 0] == pytest.approx(speed, abs=1e-12)
    errors = []
    for count in (20, 40):
        scene = pulled(shared_tmp, 4, "0.01*sin(3*t + 1)", None, 0.9, count, integrator="trapezoidal")
        errors.append(np.abs(end_velocity(scene)[:, 0] - 0.03 * np.cos(3 * 0.9 + 1.0)).max())
    assert 0.0 < errors[1] < errors[0] / 3.9 < 1e-4
