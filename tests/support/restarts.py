"""A dragged block whose run is interrupted and goes on."""

import json
import shutil

from pcontact.io.checkpoint import NAME
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import PETSc
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation

STOP = 4  # load step after which a run is interrupted


def block(path, interference="resolve", height=0.0, **output):
    """A block pressed on a plane by a force, dragged and dragged back: stick, slip, stick, slip."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[
            Contact("bottom", obstacle=Obstacle("plane", point=[0, height], normal=[0, 1]), name="floor", friction=0.3,
                    interference=interference)
        ],
        displacements=[Displacement("top", [0.1, "free"], [(0, 0), (0.25, 0), (0.625, 1), (1, -1)])],
        loads=[Load("top", pressure=10.0, amplitude=[(0, 0), (0.25, 1), (1, 1)])],
        steps=Steps(1.0, 8),
        output=Output(fields=False, checkpoint=True, **output),
        petsc={"snes_rtol": "1e-10"},
    )  # fmt: skip


class Keep(Observer):
    """Copies the checkpoint of a step aside, as a run that died after it would leave it."""

    def __init__(self, source, target, comm):
        self.source, self.target, self.comm = source, target, comm

    def step(self, step, u, record):
        if step.number == STOP and self.comm.rank == 0:
            self.target.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, self.target / NAME)


class KeepAll(Keep):
    """Copies the checkpoints of all steps aside, each into a folder of its own."""

    def step(self, step, u, record):
        if self.comm.rank == 0:
            folder = self.target / str(step.number)
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, folder / NAME)


def run(scene, comm, directory, observers=(), restart=None):
    """Records of the report. Collective on `comm`."""
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    if comm.size == 1:
        # products on one rank have one order, and not the kinds of those on several, see `one_order`
        PETSc.Options().delValue("matptap_via")
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run(directory, observers)
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return json.loads((directory / "report.json").read_text())["steps"]


def counts(record):
    return [record["contacts"]["floor"][key] for key in ("open", "stick", "slip")]
