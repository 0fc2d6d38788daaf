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


def pressed(path, source, target, strain="small"):
    """A small block that is pressed down by 1e-4 of its width upon a large one, frictionless, of the same stiffness."""
    return Scene(
        mesh=MeshSpec(path, strain=strain),
        materials={"same": Material(1.0, 0.3)},
        bodies=[Body("lower", "same"), Body("upper", "same")],
        contacts=[Contact(source, target, name="pair")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, -2e-5])],
        output=Output(fields=False),
    )


def unresolved_warnings():
    """Warnings of pressures that the stress of the cells does not have."""
    return [line for line in log.warnings() if "stress of the cells has" in line]


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_block_on_less_than_a_facet(tmp_path, strain):
    """Its force on a single cell is within a fifth of that on small ones, whichever is the source, and a warning says
    that the cell is too large; with the stiffness of the whole cell behind it the force was 0.66 times as large."""
    sides = "upper_bottom", "lower_top"
    fine = two_blocks(tmp_path / "fine.msh", 2, 40, 16, widths=(1.0, 0.2), heights=(1.0, 0.2), offset=0.4)
    single = two_blocks(tmp_path / "one.msh", 2, 1, 3, widths=(1.0, 0.2), heights=(1.0, 0.2), offset=0.4)
    known, _ = run(pressed(fine, *sides))
    known = known["contacts"]["pair"]
    assert known["unresolved"] < 0.1 and not unresolved_warnings()
    found = []
    for way in (sides, sides[::-1]):
        record, _ = run(pressed(single, *way, strain))
        assert record["contacts"]["pair"]["unresolved"] > 0.25 and len(unresolved_warnings()) == 1
        found.append(abs(record["contacts"]["pair"]["force"][1]))
    assert found == pytest.approx([abs(known["force"][1])] * 2, rel=0.2)
    assert found[0] == pytest.approx(found[1], rel=1e-6 if strain == "small" else 1e-4)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_contact_of_all_surfaces_between_stiff_and_soft(tmp_path, strain):
    """A block 1000 times as stiff makes a wave of load nearly even; the stress of each source alone, in two passes,
    oscillates by what it misses of the other side."""
    path = two_blocks(tmp_path / "b.msh", 2, 8, 16, heights=(1.0, 0.3))

    def error(traction):
        """Of the pressure in L2."""
        case = Scene(
            mesh=MeshSpec(path, strain=strain),
            materials={"lower": Material(1.0, 0.3), "upper": Material(1e3, 0.3)},
            bodies=[Body("lower", "lower"), Body("upper", "upper")],
            contacts=[Contact(all=True, name="all", traction=traction)],
            displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("left", [0.0, "free"]),
                           Displacement("right", [0.0, "free"])],
            loads=[Load("upper_top", traction=[0.0, "-1e-3*(1 + 0.5*cos(2*pi*x))"])],
            output=Output(fields=False),
        )  # fmt: skip
        simulation = Simulation(case)
        try:
            assert simulation.run()
            state = simulation.problem.contacts[0].state(simulation.stepper.u)
        finally:
            simulation.close()
        closed = state["pressure"] > 0.0
        wrong, weight = state["pressure"][closed] / 1e-3 - 1.0, state["weight"][closed]
        return np.sqrt(weight @ wrong**2 / weight.sum())

    assert error("both") < 5e-3
    assert error("source") > 0.05
