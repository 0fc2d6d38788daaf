"""Disk on block: theta = -1 does not care about gamma0, theta = 1 and 0 do below the bound of coercivity."""

import numpy as np
import pytest

from drivers.cases.disk_on_block import FORCE, scene, solve_reference, sweep
from meshes import disk_on_block
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD = MPI.COMM_WORLD
GAMMAS = np.logspace(-3, 3, 7).tolist()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("disk")) if WORLD.rank == 0 else None
    return WORLD.bcast(path)


@pytest.fixture(scope="module")
def reference(folder):
    return solve_reference(folder, 0.02)


@pytest.mark.parallel(2, 3)
def test_error_of_the_skew_variant_is_flat_in_gamma0(folder, reference):
    rows = sweep(folder, 0.05, reference, [-1.0], GAMMAS)
    assert all(row["converged"] for row in rows)
    errors = [row["error"] for row in rows]
    assert max(errors) < 1.3 * min(errors)


@pytest.mark.parametrize(("theta", "bound"), [(1.0, 1.0), (0.0, 0.25)])
def test_other_variants_degrade_below_the_bound_of_coercivity(folder, reference, theta, bound):
    rows = sweep(folder, 0.05, reference, [theta], [g for g in GAMMAS if g > bound])
    assert all(row["converged"] for row in rows)
    safe = [row["error"] for row in rows]
    assert max(safe) < 1.1 * min(safe)
    # not coercive: no solution is found, or one of several, the worst with twice the error
    rows = sweep(folder, 0.05, reference, [theta], [g for g in GAMMAS if g < bound])
    assert max(row["error"] if row["converged"] else np.inf for row in rows) > 1.9 * min(safe)


def test_error_falls_with_the_mesh(folder, reference):
    errors = [sweep(folder, h, reference, [-1.0], [1.0])[0]["error"] for h in (0.1, 0.05, 0.025)]
    rates = -np.diff(np.log2(errors))
    # towards 1: on these meshes the contact is a few facets wide
    assert np.all(rates > 0.6) and rates[1] > rates[0]


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_contact_carries_the_weight(shared_tmp, theta):
    path = shared_tmp / "disk.msh"
    on_root(WORLD, disk_on_block, path, 0.05)
    simulation = Simulation(scene(path, theta))
    try:
        assert simulation.run()
        weight = WORLD.allreduce(simulation.problem.forces.external(1.0).sum(axis=0))
        assert weight[1] == pytest.approx(-FORCE * np.pi * 0.25**2, rel=1e-2)  # a polygon instead of a disk
        force = simulation.problem.contacts[0].summary(simulation.stepper.u)["force"]
        assert force[1] == pytest.approx(weight[1], rel=1e-8)
    finally:
        simulation.close()
