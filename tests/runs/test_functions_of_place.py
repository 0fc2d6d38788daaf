"""Loads and supports as expressions of place and time: an exact solution, pressure that follows, ranks, restart."""

import re

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
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
            simulation.problem.external(0.0)
        finally:
            simulation.close()
    for part in parts:
        assert re.search(part, str(caught.value)), str(caught.value)
