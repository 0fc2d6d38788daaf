"""Viscous stabilisation: the speed of a body that nothing holds, its work, ranks, restart."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.assembly.viscous import ViscousStabilisation
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, run
from tests.support.small import dense, vector_of

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
ETA, FORCE = 5.0, 0.2


def scene(path, bottom, eta=ETA, strain="small", count=4):
    """A block of volume 1 that a force draws aside."""
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(1000.0, 0.0, yield_stress=1e3)}, [Body("block", "m")],
        displacements=[Displacement("bottom", bottom)],
        loads=[Load("block", body_force=[FORCE, 0], amplitude=[(0, 1), (1, 1)])],
        steps=Steps(end=2.0, count=count, viscous_stabilisation=eta),
        output=Output(fields=False, checkpoint=True, probes=["top"]), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "block.msh"
    if WORLD.rank == 0:
        one_block(path, 2, 4)
    WORLD.Barrier()
    return path


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_speed_of_a_body_that_nothing_holds(tmp_path, mesh, strain, caplog):
    """Force over viscosity times volume; all work goes into the dashpots."""
    caplog.set_level("WARNING")
    steps = run(scene(mesh, ["free", 0], strain=strain), SELF, tmp_path / "out")
    for step in steps:
        way = FORCE / ETA * step["time"]
        assert step["probes"]["top"]["mean"][0] == pytest.approx(way, rel=1e-9)
        assert step["viscous"]["work"] == pytest.approx(FORCE * way, rel=1e-9)
        assert step["imbalance"] < 1e-9
    assert caplog.text.count("viscous stabilisation has taken up") == 1
    head = (tmp_path / "out" / "history.csv").read_text().splitlines()[0].split(",")
    assert {"viscous.work", "viscous.ratio"} <= set(head)


def test_bodies_that_hold_still_feel_nothing(tmp_path, mesh, caplog):
    caplog.set_level("WARNING")
    still = run(scene(mesh, [0, 0], eta=None), SELF, tmp_path / "without")
    steps = run(scene(mesh, [0, 0], eta=1e-2), SELF, tmp_path / "with")
    assert "viscous" not in still[-1] and "taken up" not in caplog.text
    assert 0.0 < steps[-1]["viscous"]["ratio"] < 1e-3
    np.testing.assert_allclose(
        steps[-1]["probes"]["top"]["mean"][0], still[-1]["probes"]["top"]["mean"][0], rtol=1e-10
    )


def test_tangent_is_the_derivative(mesh):
    simulation = Simulation(scene(mesh, ["free", 0]), SELF)
    try:
        item, space = simulation.problem.features.viscous, simulation.problem.space
        assert isinstance(item, ViscousStabilisation) and item is simulation.problem.others[-1]
        rng = np.random.default_rng(0)
        begin, u, way = rng.normal(size=(3, space.n_owned, space.dim))
        item.commit(None, 0.5)
        item.detect(vector_of(space, begin), 0.75)
        before, after, outside = (np.zeros(u.shape) for _ in range(3))
        item.residual(vector_of(space, u), before)
        item.residual(vector_of(space, u + way), after)
        item.drag(vector_of(space, u), outside)
        matrix = dense(*item.pattern(), item.tangent(vector_of(space, u)), space.n_owned)
        np.testing.assert_allclose(matrix @ way.ravel(), (after - before).ravel(), atol=1e-12)
        np.testing.assert_array_equal(outside, -before)
        # the volume is 1
        np.testing.assert_allclose(np.sum(before * 1.0 / (u - begin), axis=0), ETA / 0.25)
    finally:
        simulation.close()


def same(one, other):
    np.testing.assert_allclose(one["probes"]["top"]["mean"], other["probes"]["top"]["mean"], rtol=1e-9, atol=1e-12)
    for key in ("work", "ratio"):
        assert one["viscous"][key] == pytest.approx(other["viscous"][key], rel=1e-6)


@parallel(2, 3)
def test_ranks(mesh, shared_tmp):
    alone = run(scene(mesh, [0, 0], 1.0), SELF, shared_tmp / f"alone{WORLD.rank}")
    same(run(scene(mesh, [0, 0], 1.0), WORLD, shared_tmp / "together")[-1], alone[-1])


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(scene(mesh, [0, 0], 1.0, count=7), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(scene(mesh, [0, 0], 1.0, count=7), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        same(one, other)
