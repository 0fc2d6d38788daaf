"""A flange with eight bolts on a coarse mesh: statics of both phases, and ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.flange import BOLTS, END, TENSION, balance, scene
from meshes import flange
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation
from tests.support.small import SELF

WORLD = MPI.COMM_WORLD
pytestmark = pytest.mark.slow


def ends(path, comm):
    """Records of the ends of both phases, from a scene in which nothing is said of solvers."""
    simulation = Simulation(scene(path, order=1), comm)
    try:
        assert simulation.run(None, keep=True)
        return {one["phase"]: one for one in simulation.records.data()["steps"]}
    finally:
        simulation.close()


@pytest.mark.parallel(2)
def test_bolts_and_gasket(shared_tmp):
    path = make_mesh(flange, shared_tmp / "flange.msh", 24.0)
    records = ends(path, WORLD)
    tightened, pressed = (balance(records[name], name == "pressure") for name in ("tighten", "pressure"))
    assert tightened["bolts"] == pytest.approx(BOLTS * TENSION, rel=1e-7)
    assert max(abs(tightened["residual"]), abs(pressed["residual"])) < 1e-6
    # the bolts take a part of the end force, the gasket gives way for the rest, and no bolt bears much more than others
    share = (pressed["bolts"] - tightened["bolts"]) / END
    assert 0.0 < share < 1.0 and pressed["gasket"] < tightened["gasket"]
    assert pressed["most"] - pressed["least"] < 0.02 * pressed["most"]
    if WORLD.size > 1:
        alone = ends(path, SELF)
        for name, record in records.items():
            bolts, others = ([one[f"bolt_{k}"]["force"] for k in range(1, BOLTS + 1)]
                             for one in (record["pretensions"], alone[name]["pretensions"]))  # fmt: skip
            np.testing.assert_allclose(bolts, others, rtol=1e-6)
