"""A pinned joint with play on a coarse mesh: statics, where the lug goes, and ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.pinned_joint import FORCE, PLAY, balance, scene
from meshes import pin
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation
from tests.support.small import SELF

WORLD = MPI.COMM_WORLD
pytestmark = pytest.mark.slow


def last(path, comm):
    """The record of the last load step, from a scene in which nothing is said of solvers."""
    simulation = Simulation(scene(path, order=1), comm)
    try:
        assert simulation.run(None, keep=True)
        return simulation.records.data()["steps"][-1]
    finally:
        simulation.close()


@pytest.mark.parallel(2)
def test_lug_and_fork(shared_tmp):
    path = make_mesh(pin, shared_tmp / "pin.msh", 12.0, 1)
    record = last(path, WORLD)
    forces, way = balance(record), record["probes"]["lug_end"]["mean"]
    assert forces["residual"] < 1e-6
    assert forces["lug"] == pytest.approx(-FORCE, rel=1e-6) and forces["fork"] == pytest.approx(FORCE, rel=1e-6)
    # through the play on both sides of the pin, and by what the parts give way, a little beside it
    assert -2.0 * PLAY - 0.1 < way[0] < -2.0 * PLAY and abs(way[1]) < 1e-2
    if WORLD.size > 1:
        alone = last(path, SELF)
        np.testing.assert_allclose(way, alone["probes"]["lug_end"]["mean"], rtol=1e-6, atol=1e-8)
