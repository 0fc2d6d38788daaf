"""Pressure on the deformed surface in a scene: a tube of rubber, ranks, restart, refusals."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


def file(folder, name, *arguments, **more):
    path = folder / f"{name}.msh"
    if WORLD.rank == 0:
        one_block(path, *arguments, **more)
    WORLD.Barrier()
    return path


def tube(path, factors, bulk=1e4):
    """Radii 1 and 2, shear modulus 1, between plates without friction."""
    nu = (3.0 * bulk - 2.0) / (2.0 * (3.0 * bulk + 1.0))
    return Scene(
        MeshSpec(path, kinematics="axisymmetric", strain="finite", mean_dilatation=True),
        {"m": Material(2.0 * (1.0 + nu), nu, law="neo_hooke")}, [Body("block", "m")],
        displacements=[Displacement("bottom", ["free", 0]), Displacement("top", ["free", 0])],
        loads=[Load("left", pressure=1.0, amplitude=[(k, f) for k, f in enumerate(factors)], follower=True)],
        steps=Steps(end=len(factors) - 1.0, count=len(factors) - 1),
        output=Output(fields=False, probes=["left"]), petsc={"snes_rtol": "1e-12", "pc_type": "lu"},
    )  # fmt: skip


def test_tube_of_rubber(tmp_path):
    """Pressure over inner stretch, in closed form; more than 0.69 no tube bears."""
    path = file(tmp_path, "tube", 2, [32, 1], size=[1, 0.1], lower=[1, 0])
    pressures = [0.131562, 0.2, 0.3, 0.36, 0.428228, 0.48, 0.53, 0.574054]
    simulation = Simulation(tube(path, [0, *pressures]), SELF)
    try:
        assert simulation.problem.others[0].symmetric
        assert simulation.run(keep=True)
        rows = simulation.records.data()["steps"]
        norms = simulation.newton.norms
    finally:
        simulation.close()
    found = [1.0 + rows[k]["probes"]["left"]["mean"][0] for k in (0, 4, 7)]
    np.testing.assert_allclose(found, [1.1, 1.5, 2.0], rtol=3e-4)
    assert max(row["newton"] for row in rows) <= 9 and max(row["imbalance"] for row in rows) < 1e-8
    # the tail is quadratic, down to rounding errors
    assert min(after / before for before, after in zip(norms, norms[1:], strict=False)) < 1e-4


def blown(path):
    """A block of rubber that a pressure on its end bends aside: dead, it would only shear."""
    return Scene(
        MeshSpec(path, strain="finite"), {"m": Material(10.0, 0.3, law="neo_hooke")}, [Body("block", "m")],
        displacements=[Displacement("bottom", [0, 0, 0])],
        loads=[Load("right", pressure=1.2, follower=True), Load("top", pressure=0.2)],
        steps=Steps(count=6), output=Output(fields=False, checkpoint=True, probes=["top"]),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-6"},
    )  # fmt: skip


def same(one, other):
    np.testing.assert_allclose(one["probes"]["top"]["mean"], other["probes"]["top"]["mean"], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(one["reactions"]["bottom"], other["reactions"]["bottom"], rtol=1e-8, atol=1e-10)


@parallel(1, 2, 3)
def test_ranks(shared_tmp):
    path = file(shared_tmp, "block", 3, [2, 2, 4], size=[0.5, 0.5, 1])
    alone = run(blown(path), SELF, shared_tmp / f"alone{WORLD.rank}")
    steps = run(blown(path), WORLD, shared_tmp / "together")
    for one, other in zip(steps, alone, strict=True):
        same(one, other)
    assert max(step["imbalance"] for step in steps) < 1e-8
    # the pressure turns with the side that it acts on: a part of it draws the block along
    assert steps[-1]["probes"]["top"]["mean"][0] < -0.2
    assert abs(steps[-1]["reactions"]["bottom"][2] - 0.2 * 0.25) > 0.1 * 1.2 * 0.5


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(shared_tmp):
    path = file(shared_tmp, "block", 3, [2, 2, 4], size=[0.5, 0.5, 1])
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(blown(path), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(blown(path), WORLD, rest, restart=cut)
    assert len(after) == len(steps) - STOP
    for one, other in zip(steps[STOP:], after, strict=True):
        same(one, other)


def test_refusals(tmp_path):
    path = file(tmp_path, "block", 2, 2)
    scene = tube(path, [0, 1])
    assert "pressure on the deformed surface: left" in describe(scene, 2)[0]
    scene.mesh.kinematics, scene.materials["m"].law = "plane_stress", "hencky"
    scene.mesh.mean_dilatation = None
    with pytest.raises(InputError, match=r"loads\[0\].*follower.*plane_stress"):
        Simulation(scene, SELF)
    scene = tube(path, [0, 1])
    scene.loads = [Load("left", traction=[1, 0], follower=True)]
    with pytest.raises(InputError, match=r"loads\[0\].*follower.*pressure"):
        Simulation(scene, SELF)
