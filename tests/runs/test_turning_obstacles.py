"""Obstacles that turn: bodies that turn along, friction that drags them, moments, any number of ranks, restart."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.finite_contact import moved, turn
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


def scene(path, obstacle, *displacements, strain="finite", count=1, loads=(), end=1.0, **contact):
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(10.0, 0.3)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="floor", **contact)], displacements=list(displacements),
        loads=list(loads), steps=Steps(end=end, count=count), output=Output(fields=False, checkpoint=True),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-6"},
    )  # fmt: skip


@pytest.fixture
def mesh(shared_tmp):
    """Unit boxes by dimension."""
    paths = {dim: shared_tmp / f"block{dim}.msh" for dim in (2, 3)}
    if WORLD.rank == 0:
        for dim, path in paths.items():
            one_block(path, dim, 4 if dim == 2 else 2)
    WORLD.Barrier()
    return paths


class States(Observer):
    """The state of the pair after every load step."""

    def __init__(self):
        self.states, self.newton = [], []

    def step(self, step, u, record):
        self.states.append(self.pair.state(u))
        self.newton.append(step.newton)


def steps_of(scene, look=None, comm=SELF):
    simulation = Simulation(scene, comm)
    if look is not None:
        look.pair = simulation.problem.contacts[0].pairs[0]
    try:
        assert simulation.run(None, [] if look is None else [look], keep=True)
        return simulation.records.data()["steps"]
    finally:
        simulation.close()


@pytest.mark.parametrize(
    "law",
    [{}, {"friction": 0.2}, {"tresca": 0.3}, {"friction": 0.2, "formulation": "penalty"}],
)
def test_forces_turn_with_body_and_plane(mesh, law):
    """A block pressed and dragged on a plane, part of which sticks; both turn by a right angle meanwhile."""
    centre, ends = np.array([0.3, 0.2]), []
    for degrees in (0.0, 90.0):

        def place(x, time, degrees=degrees):
            return centre + (x + time * np.array([0.05, -0.1]) - centre) @ turn(degrees * time).T

        look = States()

        def begin(simulation, look=look):
            look.pair = simulation.problem.contacts[0].pairs[0]

        floor = Obstacle("plane", [0, 0], [0, 1], angle=degrees, pivot=centre)
        one = scene(mesh[2], floor, Displacement("top", [0, 0]), count=9, **law)
        moved(one, place, observers=[look], begin=begin, comm=SELF)
        assert len(look.states) == 9 and max(look.newton) <= 8
        ends.append(look.states)
    back, slipping = turn(90.0 / 9.0), 0
    for number, (still, turned) in enumerate(zip(*ends, strict=True), start=1):
        np.testing.assert_array_equal(turned["status"], still["status"])
        frame = np.linalg.matrix_power(back, number)
        np.testing.assert_allclose(turned["traction"] @ frame, still["traction"], atol=1e-9)
        slipping += np.unique(still["status"]).size
    assert slipping > 9 or "friction" not in law


@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_roll_drags_a_block(mesh, dim, strain):
    """Pressed on a roll that turns about its own axis until all slides: friction times pressure on its arm."""
    ramp = [(0, 0), (1, 0), (2, 1)]
    if dim == 2:
        roll = Obstacle("sphere", center=[0.5, -2.0], radius=2.0, angle=40.0, amplitude=ramp)
    else:
        roll = Obstacle("cylinder", point=[0.5, 5.0, -2.0], axis=[0, -1, 0], radius=2.0, angle=40.0, amplitude=ramp)
    look, press = States(), Displacement("top", [0] * (dim - 1) + [-0.05], [(0, 0), (1, 1), (2, 1)])
    end = steps_of(scene(mesh[dim], roll, press, strain=strain, count=2, end=2.0, friction=0.2), look)[-1]
    contact, state = end["contacts"]["floor"], look.states[-1]
    assert contact["stick"] == 0 and contact["slip"] > 0
    # counterclockwise seen from -y: the top of the roll goes towards negative x, and the block resists
    force = np.array(contact["force"])
    assert force[-1] < 0.0 < force[0]
    expected = -0.2 * np.sum(state["pressure"] * state["weight"] * (2.0 + state["gap"]))
    moment = contact["moment"] if dim == 2 else -contact["moment"][1]
    assert moment == pytest.approx(expected, rel=0.01 if strain == "small" else 1e-9)
    np.testing.assert_allclose(np.array(end["reactions"]["top"]) - force, 0.0, atol=1e-9)


def test_a_plane_that_turns_is_a_load_that_turns_back(mesh):
    """A block that lies on a plane by its weight and by friction, the plane turning; or the weight, the other way."""
    count, angle = 6, np.radians(12.0)
    times = np.arange(1, count + 1)
    factor = np.maximum(times - 1, 0) / (count - 1)
    ramp = [(0, 0), *zip(times.tolist(), factor.tolist(), strict=True)]
    down = [(0, 0), (1, 1)]
    tilted = scene(mesh[2], Obstacle("plane", [0, 0], [0, 1], angle=12.0, amplitude=ramp), loads=[
        Load("block", body_force=[0, -0.1], amplitude=down)], end=float(count), count=count, friction=0.5)  # fmt: skip
    parts = np.cos(angle * factor), np.sin(angle * factor)
    across, along = ([(0, 0), *zip(times.tolist(), part.tolist(), strict=True)] for part in parts)
    loads = [Load("block", body_force=[0, -0.1], amplitude=across),
             Load("block", body_force=[-0.1, 0], amplitude=along)]  # fmt: skip
    still = scene(mesh[2], Obstacle("plane", [0, 0], [0, 1]), loads=loads, end=float(count), count=count, friction=0.5)
    looks = States(), States()
    for one, look in zip((tilted, still), looks, strict=True):
        one.steps.min_step = 1e-3
        assert len(steps_of(one, look)) == count
    c, s = np.cos(angle), np.sin(angle)
    a, b = (look.states[-1] for look in looks)
    np.testing.assert_allclose(a["pressure"], b["pressure"], atol=1e-8)
    np.testing.assert_allclose(a["traction"], b["traction"] @ np.array([[c, s], [-s, c]]), atol=1e-8)
    assert np.abs(b["traction"][:, 0]).max() > 1e-3


def rolling(path, strain="finite"):
    """A block on a roll that turns to and fro about its own axis and sinks a little."""
    roll = Obstacle("cylinder", point=[0.5, 0.5, -2.0], axis=[0, -1, 0.1], radius=2.0, angle=30.0,
                    displacement=[0, 0, -0.01], amplitude=[(0, 0), (0.3, 0.4), (1, -0.4)])  # fmt: skip
    press = Displacement("top", [0, 0, -0.05], [(0, 0), (0.3, 1), (1, 1)])
    return scene(path, roll, press, strain=strain, count=6, friction=0.2)


def same(one, other):
    for key in ("moment", "force"):
        a, b = (np.array(step["contacts"]["floor"][key]) for step in (one, other))
        np.testing.assert_allclose(a, b, atol=1e-8 * np.abs(b).max())


@parallel(2, 3)
def test_ranks(mesh, shared_tmp):
    alone = run(rolling(mesh[3]), SELF, shared_tmp / f"alone{WORLD.rank}")
    same(run(rolling(mesh[3]), WORLD, shared_tmp / "together")[-1], alone[-1])


@parallel(1, 2)
@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_restart(mesh, shared_tmp, strain):
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(rolling(mesh[3], strain), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(rolling(mesh[3], strain), WORLD, rest, restart=cut)
    assert [step["time"] for step in after] == [step["time"] for step in steps[STOP:]]
    same(steps[-1], after[-1])


@pytest.mark.parametrize(
    "dim, obstacle, parts",
    [
        (2, Obstacle("plane", [0, 0], [0, 1], pivot=[0, 0]), ("obstacle.pivot", "without angle")),
        (2, Obstacle("plane", [0, 0], [0, 1], angle=3, turn_axis=[0, 0]), ("obstacle.turn_axis", "all zero")),
        (2, Obstacle("plane", [0, 0], [0, 1], angle=3, turn_axis=[0, 1]), ("obstacle.turn_axis", "2D")),
        (2, Obstacle("plane", [0, 0], [0, 1], angle=3, pivot=[0, 0, 1]), ("obstacle.pivot", "3 entries")),
        (2, Obstacle("plane", [0, 0], [0, 1], amplitude=[(0, 0), (1, 1)]), ("obstacle.amplitude", "angle")),
        (2, Obstacle("level_set", expression="y", angle=3.0), ("obstacle.pivot", "nothing")),
        (3, Obstacle("sphere", center=[0, 0, -1], radius=1, angle=3.0), ("obstacle.turn_axis", "nothing")),
    ],
)
def test_bad_turns(mesh, dim, obstacle, parts):
    with pytest.raises(InputError) as caught:
        Simulation(scene(mesh[dim], obstacle, Displacement("top", [0] * dim)), SELF)
    assert "contacts[0] (floor)" in str(caught.value) and all(part in str(caught.value) for part in parts)


def test_rings_do_not_turn(mesh):
    one = scene(mesh[2], Obstacle("plane", [0, 0], [0, 1], angle=3.0), Displacement("top", [0, 0]))
    one.mesh.kinematics = "axisymmetric"
    with pytest.raises(InputError, match="angle.*axisymmetric"):
        Simulation(one, SELF)
