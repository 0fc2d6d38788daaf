"""Scenes of the drivers with finite strain: any number of ranks, and a restart in the middle, leave the numbers alone.

Some of them; ``python tests/fuzz/kills.py --only driver`` goes on with the others.
"""

import shutil

import pytest

from pcontact.io.checkpoint import NAME
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.simulation import Simulation
from tests.support.driver_scenes import SCENES
from tests.support.restart_kinds import COUNTED, worst

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


class Watch(Observer):
    """Observer: records, and a copy of the checkpoint of a load step."""

    def __init__(self, comm, directory, stop):
        self.comm, self.directory, self.stop, self.records = comm, directory, stop, []

    def step(self, step, u, record):
        self.records.append(record)
        if step.number == self.stop and self.comm.rank == 0:
            kept = self.directory.parent / "kept"
            kept.mkdir(exist_ok=True)
            shutil.copy(self.directory / NAME, kept / NAME)


def run(scene, comm, directory, stop=None, restart=None):
    """Records of the load steps. Collective on `comm`."""
    watch = Watch(comm, directory, stop)
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run(directory, [watch])
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return watch.records


def test_restart_in_the_middle(shared_tmp):
    """A billet that flows, and whose side folds onto the dies."""
    scene = SCENES["driver, upsetting"]
    full = run(scene(shared_tmp), WORLD, shared_tmp / "full", 2)
    again = run(scene(shared_tmp), WORLD, shared_tmp / "again", restart=shared_tmp / "kept")
    difference, where = worst(full[2:], again)
    assert len(full) > 2 and difference <= 1e-12, where


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["driver, turning", "driver, ironing"])
def test_ranks_agree(shared_tmp, kind):
    """With one rank, and on the way after a restart on one rank from what all of them left in the middle."""
    scene = SCENES[kind](shared_tmp)
    full = run(scene, WORLD, shared_tmp / "full", 2)
    if WORLD.rank == 0:
        alone = run(scene, SELF, shared_tmp / "alone")
        difference, where = worst(alone, full, COUNTED)
        assert difference <= 1e-8, where
        again = run(scene, SELF, shared_tmp / "again", restart=shared_tmp / "kept")
        difference, where = worst(alone[2:], again, COUNTED)
        assert difference <= 1e-8, where
    WORLD.Barrier()
