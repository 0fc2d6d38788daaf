"""Restart of every kind of contact and body: the run goes on as if nothing had happened, on any number of ranks."""

import shutil

import h5py
import pytest

from pcontact.io.checkpoint import NAME
from pcontact.runtime.files import append_checksums
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.simulation import Simulation
from tests.support.restart_kinds import COUNTED, KINDS, STOP, lips, stacked, worst

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


class Watch(Observer):
    """Observer: keeps the records, and the checkpoint of a step as a run that died after it would leave it."""

    def __init__(self, source=None, target=None, comm=WORLD):
        self.source, self.target, self.comm, self.records = source, target, comm, []

    def step(self, step, u, record):
        self.records.append(record)
        if step.number == STOP and self.target is not None and self.comm.rank == 0:
            self.target.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, self.target / NAME)


def run(case, comm, directory, kept=None, restart=None):
    """Records of the load steps. Collective on `comm`."""
    watch = Watch(directory, kept, comm)
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    simulation = Simulation(case, comm)
    try:
        assert simulation.run(directory, [watch])
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return watch.records


PARALLEL = ["tied", "unbiased", "self contact", "finite strain, unbiased, hardening"]
SERIAL = [
    "tied, multipliers", "multipliers, small gamma", "moving plane", "kinematic hardening", "space, tied",
    "friction that slows", "finite strain, friction that slows", "layer", "finite strain, layer",
    "layer, phases", "layer that is tied, phases", "friction that slows, phases",
    "clearance by an amplitude", "adjusted within",
    "finite strain, tied", "finite strain, rubber, theta -1", "finite strain, multipliers", "finite strain, roll",
    "impact",
]  # fmt: skip


@pytest.mark.parametrize("kind", [*SERIAL, *(pytest.param(kind, marks=pytest.mark.parallel) for kind in PARALLEL)])
def test_same_numbers_on_the_same_ranks(shared_tmp, kind):
    """All of them, on one rank those of the solver too. Two runs on three ranks differ in the last bits, and a Krylov
    method makes 1e-11 of that, whether a restart is between them or not."""
    case = KINDS[kind]
    full = run(case(shared_tmp), WORLD, shared_tmp / "full", shared_tmp / "kept")
    again = run(case(shared_tmp), WORLD, shared_tmp / "again", restart=shared_tmp / "kept")
    difference, where = worst(full[STOP:], again, COUNTED if WORLD.size > 1 else ())
    assert difference <= (1e-12 if WORLD.size == 1 else 1e-9), where


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["tied", "Tresca"])
def test_same_numbers_on_other_ranks(shared_tmp, kind):
    """Written by all ranks and read by one. What friction remembers differs by the tolerance of linear solves, and
    partners by as much as the check of partners allows."""

    def case():
        scene = KINDS[kind](shared_tmp)
        tight = {"contact_partner_rtol": "1e-9", "snes_ksp_ew_rtol0": "1e-10", "snes_ksp_ew_rtolmax": "1e-10"}
        scene.petsc.update(tight)
        return scene

    full = run(case(), WORLD, shared_tmp / "full", shared_tmp / "kept")
    alone = run(case(), SELF, shared_tmp / f"alone{WORLD.rank}", restart=shared_tmp / "kept")
    WORLD.Barrier()
    difference, where = worst(full[STOP:], alone, COUNTED)
    assert difference <= 1e-10, where


def with_estimate(folder):
    case = lips(folder)
    case.output.estimate = True
    return case


def with_weak_solver(folder):
    """A Krylov method that fails: the run turns to a direct solver."""
    case = stacked(folder, friction=0.3)
    case.petsc["ksp_max_it"] = "3"
    return case


@pytest.mark.parametrize("case, carried", [(with_estimate, "largest_energy"), (with_weak_solver, "direct")])
def test_what_a_run_carries_on(tmp_path, case, carried):
    """Largest force and energy so far, which errors are relative to, and the solver that it has turned to."""
    full = run(case(tmp_path), WORLD, tmp_path / "full", tmp_path / "kept")
    again = run(case(tmp_path), WORLD, tmp_path / "again", restart=tmp_path / "kept")
    assert worst(full[STOP:], again)[0] <= 1e-12
    with h5py.File(tmp_path / "kept" / NAME, "r+") as file:
        assert file["carried"].attrs[carried] > 0.0 and file["carried"].attrs["largest_force"] > 0.0
        file["carried"].attrs[carried] = 0.0
    append_checksums(tmp_path / "kept" / NAME)
    without = run(case(tmp_path), WORLD, tmp_path / "without", restart=tmp_path / "kept")
    assert worst(full[STOP:], without)[0] > 0.0
