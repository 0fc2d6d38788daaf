"""Loads and supports as expressions of place and time: an exact solution, pressure that follows, ranks, restart."""

import re

import numpy as np
import pytest

import pcontact as pc
from meshes import one_block
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
    Temperature,
)
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E = 10.0


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "block.msh"
    if WORLD.rank == 0:
        one_block(path, 2, 3, order=2)
    WORLD.Barrier()
    return path


def exact(x, t):
    """Displacement that quadrilaterals of degree 2 have: its forces follow with nu = 0 in plane strain."""
    return t**2 * np.column_stack([x[:, 0] ** 2 * x[:, 1], 0.0 * x[:, 0]])


def scene(path, count=1, **more):
    """Body force, traction and pressure that hold the displacement of :func:`exact`; half of it is prescribed."""
    return Scene(
        MeshSpec(path, order=2), {"m": Material(E, 0.0)}, [Body("block", "m")],
        displacements=[Displacement("left", ["0", 0.0]), Displacement("bottom", [0.0, 0.0]),
                       Displacement("top", ["t**2 * x**2", 0.0])],
        loads=[Load("block", body_force=["-20*y*t**2", "-10*x*t**2"]),
               Load("right", pressure="-20*y", amplitude=[(k / 16, (k / 16) ** 2) for k in range(17)]),
               Load("right", traction=[0, "5*t**2"])],
        steps=Steps(count=count), petsc={"ksp_rtol": "1e-13", "snes_rtol": "1e-12"},
        output=Output(fields=False, checkpoint=True, probes=["right"]), **more,
    )  # fmt: skip


def error(simulation, t=1.0):
    space = simulation.problem.space
    u = simulation.stepper.u.getArray(readonly=True).reshape(-1, space.dim)
    return np.abs(u - exact(space.points[space.owned_local], t)).max(initial=0.0)


@parallel(1, 2, 3)
def test_exact_solution(mesh):
    """At the nodes, and with no error to estimate; at half the time with a quarter of the displacement."""
    case = scene(mesh, count=2)
    case.output.estimate = True
    simulation = Simulation(case, WORLD)
    try:
        assert simulation.run(keep=True)
        steps = simulation.records.data()["steps"]
        assert error(simulation) < 1e-11
        mean = [step["probes"]["right"]["mean"][0] for step in steps]
        assert mean[0] == pytest.approx(0.25 * mean[1], rel=1e-9)
        assert steps[-1]["imbalance"] < 1e-9 and steps[-1]["estimate"]["relative"] < 1e-9
    finally:
        simulation.close()


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(scene(mesh, 6), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(scene(mesh, 6), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        np.testing.assert_allclose(one["probes"]["right"]["mean"], other["probes"]["right"]["mean"], rtol=1e-9)
    changed = scene(mesh, 6)
    changed.loads[0].body_force = ["-21*y*t**2", 0]
    with pytest.raises(InputError, match=r"loads\[0\] \(block\).body_force.*-20"):
        run(changed, WORLD, rest, restart=cut)


# -- functions of a Python program ------------------------------------------------------------------------------------


def called(path, count=1, scale=-20.0):
    """The same scene with functions in the place of expressions."""
    case = scene(path, count)
    case.displacements[2].value = [lambda x, t: t**2 * x[:, 0] ** 2, 0.0]
    case.loads = [Load("block", body_force=[lambda x, t: scale * x[:, 1] * t**2, lambda x, t: -10.0 * x[:, 0] * t**2]),
                  Load("right", pressure=lambda x, t: -20.0 * x[:, 1] * t**2),
                  Load("right", traction=[0, lambda x, t: np.full(len(x), 5.0 * t**2)])]  # fmt: skip
    return case


@parallel(1, 2)
def test_functions_are_as_expressions(mesh, shared_tmp):
    """The exact solution; and a restart brings the same functions, by their text, or is refused."""
    simulation = Simulation(called(mesh), WORLD)
    try:
        assert simulation.run()
        assert error(simulation) < 1e-11
    finally:
        simulation.close()
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(called(mesh, 6), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(called(mesh, 6), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        np.testing.assert_allclose(one["probes"]["right"]["mean"], other["probes"]["right"]["mean"], rtol=1e-9)
    changed = called(mesh, 6)
    changed.loads[1].pressure = lambda x, t: -21.0 * x[:, 1] * t**2
    with pytest.raises(InputError, match=r"loads\[1\] \(right\).pressure: found .*lambda.*text .*; allowed: .*text"):
        run(changed, WORLD, rest, restart=cut)


def pushed(path, temperature, friction):
    """A block that is heated, pressed on a floor and pushed along; the forces on the floor."""
    floor = Contact("bottom", obstacle=Obstacle("plane", [0.0, 0.0], [0.0, 1.0]), name="floor", friction=friction)
    case = Scene(
        MeshSpec(path), {"m": Material(E, 0.3, expansion=0.01)}, [Body("block", "m")], [floor],
        [Displacement("top", [0.02, -0.05])], temperatures=[Temperature(temperature)], steps=Steps(count=2),
        petsc={"ksp_rtol": "1e-13", "snes_rtol": "1e-12"},
    )  # fmt: skip
    simulation = Simulation(case, WORLD)
    try:
        assert simulation.run(keep=True)
        return [step["contacts"]["floor"]["force"] for step in simulation.records.data()["steps"]]
    finally:
        simulation.close()


@parallel(1, 2)
def test_temperatures_and_friction_of_functions(mesh):
    expected = pushed(mesh, "2*x*t", "0.1 + 0.2*x")
    found = pushed(mesh, lambda x, t: 2.0 * x[:, 0] * t, lambda x, t: 0.1 + 0.2 * x[:, 0])
    assert abs(expected[-1][0]) > 0.01
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def stops(x, t):
    """What a program may do."""
    raise KeyError("no such place")


@pytest.mark.parametrize("function, message", [
    (lambda x, t: np.ones((len(x), 2)), r"found .*an array of shape \(\d+, 2\) at time [01]; allowed: one number per"),
    (lambda x, t: 1.0, r"found .*an array of shape \(\) at time [01]; allowed: one number per point"),
    (lambda x, t: np.where(x[:, 1] > 0.5, np.nan, 0.0), r"the value nan at the point \(.*\) at time"),
    (lambda x, t: 1j * x[:, 0], "values of type complex128 at time [01]"),
    (stops, r"stops, text .*KeyError: 'no such place' in line \d+ of test_functions_of_place.py"),
    (lambda x: x[:, 0], r"TypeError: .*argument"),
])  # fmt: skip
def test_functions_that_are_wrong(mesh, function, message):
    """One line that names the key, what was found, and what is allowed."""
    load, support = called(mesh), called(mesh)
    load.loads[1].pressure, support.displacements[2].value = function, [function, 0.0]
    message = message.removeprefix("found .*")
    for case, key in ((load, r"loads\[1\] \(right\).pressure"), (support, r"displacements\[2\] \(top\).value")):
        with pytest.raises(InputError, match=f"{key}: found .*{message}"):
            pc.run(case, comm=SELF)


@pytest.mark.parametrize("ring", [False, True])
def test_pressure_that_follows_begins_as_one_that_does_not(mesh, ring):
    """Under a pressure that grows with the depth and with the time."""
    forces = []
    for follower in (True, False):
        case = scene(mesh)
        case.mesh.kinematics = "axisymmetric" if ring else "plane_strain"
        case.displacements = [Displacement("top", [0, 0])]
        case.loads = [Load("right", pressure="1e-7*t*(1 - y)", follower=follower)]
        simulation = Simulation(case, SELF)
        try:
            assert simulation.run(keep=True)
            forces.append(simulation.records.data()["steps"][-1]["reactions"]["top"])
        finally:
            simulation.close()
    assert abs(forces[0][0]) > 1e-9
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-6 * abs(forces[0][0]))


def test_rings_stay_on_their_axis(mesh):
    """On the axis of symmetry an expression that is zero there does."""
    case = scene(mesh)
    case.mesh.kinematics, case.loads = "axisymmetric", []
    case.displacements = [Displacement(side, ["0.01*x*t", 0]) for side in ("top", "bottom")]
    case.displacements.append(Displacement("right", ["0.01*t", "free"]))
    simulation = Simulation(case, SELF)
    try:
        assert simulation.run(keep=True)
        mean = simulation.records.data()["steps"][-1]["probes"]["right"]["mean"]
        np.testing.assert_allclose(mean, [0.01, 0.0], atol=1e-12)
    finally:
        simulation.close()
    case.displacements = [Displacement("top", ["0.01*(x + t)", 0])]
    with pytest.raises(InputError, match=r"displacements\[0\] \(top\).value.*axis of symmetry"):
        Simulation(case, SELF)


@pytest.mark.parametrize(
    "change, parts",
    [
        (lambda s: setattr(s.loads[1], "pressure", "2*z"), (r"loads\[1\] \(right\).pressure", "z with a 2D mesh")),
        (lambda s: setattr(s.loads[2], "traction", [0, "w"]), (r"loads\[2\] \(right\).traction", "the name 'w'")),
        (lambda s: setattr(s.loads[1], "pressure", "log(y - 0.5)"), (r"loads\[1\] \(right\).pressure", "nan", "point")),
        (lambda s: setattr(s.loads[0], "body_force", ["1/t", 0]), (r"loads\[0\] \(block\).body_force", "inf")),
        (lambda s: setattr(s.displacements[2], "value", ["x", "fre"]), (r"displacements\[2\] \(top\).value", "fre")),
        (lambda s: setattr(s.displacements[2], "value", ["t*(x + 1)", 0]), (r"t\*\(x \+ 1\)", "left", "'0'")),
        (lambda s: s.displacements.__setitem__(2, Displacement("top", ["x", 0], angle=1.0, point=[0, 0])),
         (r"displacements\[2\] \(top\).value", "together with angle")),
    ],
)  # fmt: skip
def test_bad_expressions(mesh, change, parts):
    case = scene(mesh)
    change(case)
    with pytest.raises(InputError) as caught:
        simulation = Simulation(case, SELF)
        try:
            simulation.problem.forces.external(0.0)
        finally:
            simulation.close()
    for part in parts:
        assert re.search(part, str(caught.value)), str(caught.value)
