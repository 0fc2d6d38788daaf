"""Which surface is the source where one body is much stiffer: pressures both ways round, and a warning."""

import numpy as np
import pytest

from meshes import cylinder_on_block, two_blocks
from pcontact.runtime import log
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD


class Last(Observer):
    """Observer: the record of the last load step."""

    def step(self, step, u, record):
        self.record = record


def run(scene):
    """Record, and warnings of the choice of a source. Collective."""
    log.forget_warnings()
    last, simulation = Last(), Simulation(scene)
    try:
        assert simulation.run(None, [last])
    finally:
        simulation.close()
    return last.record, [line for line in log.warnings() if "as stiff as the target" in line]


def cylinder(path, source, target, stiffness, alone=False, **more):
    """A cylinder of some stiffness on a block of stiffness 1, pressed as Hertz's; the traction that of the source
    alone, or of both."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"cylinder": Material(stiffness, 0.3), "block": Material(1.0, 0.3, **more)},
        bodies=[Body("cylinder", "cylinder"), Body("block", "block")],
        contacts=[Contact(source, target, name="pair", traction="source" if alone else "both")],
        displacements=[Displacement("symmetry_x", [0.0, "free"]), Displacement("block_bottom", [0.0, 0.0])],
        loads=[Load("cylinder_flat", pressure=0.004)],
        output=Output(fields=False),
    )


def hertz(stiffness):
    """Largest pressure under the cylinder of radius 8."""
    modulus = 1.0 / ((1.0 - 0.3**2) * (1.0 + 1.0 / stiffness))
    return np.sqrt(2 * 8.0 * 0.004 * modulus / (np.pi * 8.0))


def test_a_stiff_cylinder_on_a_soft_block(tmp_path):
    """Meets Hertz whichever is the source, where the block may yield, too; with the traction of the stiff side alone
    the pressure is far off, and the warning names both."""
    path = cylinder_on_block(tmp_path / "c.msh", 0.1, cell="quadrilateral", half=True, width=64.0)
    sides = "cylinder_skin", "block_top"
    wrong, (line,) = run(cylinder(path, *sides, 1e3, True))
    kinds = [(sides, {}), (sides, {"yield_stress": 1e3}), (sides[::-1], {}), (sides[::-1], {"alone": True})]
    for way, more in kinds:
        right, none = run(cylinder(path, *way, 1e3, **more))
        assert right["contacts"]["pair"]["max_pressure"] == pytest.approx(hertz(1e3), rel=0.05) and not none
    assert wrong["contacts"]["pair"]["max_pressure"] > 1.3 * hertz(1e3)
    assert "source = 'block_top', target = 'cylinder_skin'" in line
    assert not run(cylinder(path, *sides, 1.0, True))[1]


@pytest.mark.parallel
@pytest.mark.parametrize(("more", "count"), [({}, 1), ({"tied": True}, 1), ({"formulation": "penalty"}, 0), (None, 0)])
def test_a_stiff_source_is_warned_of(shared_tmp, more, count):
    """Where its stress alone enters, tied or not."""
    path = shared_tmp / "b.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 3, 2)
    WORLD.Barrier()
    more = {} if more is None else {"traction": "source", **more}
    for sides, expected in ((("upper_bottom", "lower_top"), count), (("lower_top", "upper_bottom"), 0)):
        scene = Scene(
            mesh=MeshSpec(path),
            materials={"soft": Material(1.0, 0.3), "stiff": Material(100.0, 0.3)},
            bodies=[Body("lower", "soft"), Body("upper", "stiff")],
            contacts=[Contact(*sides, name="pair", **more)],
            displacements=[Displacement("upper_top", [0.0, -0.01]), Displacement("lower_bottom", [0.0, 0.0])],
            output=Output(fields=False),
        )
        _, said = run(scene)
        assert WORLD.rank != 0 or len(said) == expected
