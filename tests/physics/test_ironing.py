"""Ironing: two deformable bodies whose meshes move over each other, with friction."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import ironing
from meshes import ironing as ironing_mesh
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
MU, WAY, COUNT = 0.3, 0.8, 40


def forces(path, comm=WORLD, mu=MU, way=WAY, **said):
    """Rows of a run. Collective on `comm`."""
    observer = ironing.Forces()
    simulation = Simulation(ironing.scene(path, 2, mu, way=way, **{"count": COUNT, **said}), comm)
    try:
        assert simulation.run(None, [observer])
    finally:
        simulation.close()
    return observer.rows


def near_friction(result):
    """Normals are those of where the foot will be: no load step behind, which would add 0.06 in 20 load steps."""
    return abs(result["ratio"] - MU) < 0.006


@pytest.fixture
def mesh(shared_tmp):
    return make_mesh(ironing_mesh, shared_tmp / "ironing.msh", 2, 0.1)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_forces_of_the_pair(mesh, theta):
    """They balance the supports, the friction is mu times the pressure, and no load step is cut."""
    rows = forces(mesh, theta=theta, petsc={"snes_rtol": "1e-10"})
    result = ironing.measure(rows)
    assert result["imbalance"] < 5e-8
    assert result["cutbacks"] == 0
    moving = [row for row in rows if row["time"] > ironing.PRESSED + 0.1]
    assert all(row["stick"] == 0 and row["slip"] > 0 for row in moving)
    assert near_friction(result)
    assert result["ripple_n"] < 0.015 and result["ripple_t"] < 0.06


def test_few_load_steps_do(mesh):
    for count in (20, 80):
        assert near_friction(ironing.measure(forces(mesh, count=count)))


@pytest.mark.parallel(2, 3)
def test_ranks_do_not_matter(mesh):
    """Forces of every load step against those of one rank."""
    tight = {"snes_rtol": "1e-11", "snes_ksp_ew": "false", "ksp_rtol": "1e-10"}
    one = forces(mesh, SELF, count=20, petsc=tight)
    WORLD.Barrier()
    all_ = forces(mesh, WORLD, count=20, petsc=tight)
    for a, b in zip(one, all_, strict=True):
        assert [a[key] for key in ("open", "stick", "slip")] == [b[key] for key in ("open", "stick", "slip")]
        found, wanted = ([row["normal"], row["tangential"]] for row in (b, a))
        assert np.allclose(found, wanted, rtol=0.0, atol=1e-9 * one[-1]["normal"])
