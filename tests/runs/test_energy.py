"""Works and energies in the report: closed forms, convergence with the load steps, ranks, restart."""

from dataclasses import replace

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Spring,
    Steps,
)
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
OUTPUT = Output(fields=False, energy=True)
YOUNG, HARDENING, BACK, YIELD = 1000.0, 50.0, 80.0, 2.0


@pytest.fixture
def meshes(shared_tmp):
    if WORLD.rank == 0:
        for dim in (2, 3):
            one_block(shared_tmp / f"block{dim}.msh", dim, 4 if dim == 2 else 2)
    WORLD.Barrier()
    return shared_tmp


def bar(folder, kinematics, end, count, material):
    """A block of size 1 that is drawn along its last direction and may become thinner."""
    dim = 3 if kinematics == "3D" else 2
    free = ["free"] * dim
    sides = ("left", "bottom") if dim == 2 else ("left", "front", "bottom")
    supports = [Displacement(side, [0.0 if k == axis else "free" for k in range(dim)])
                for axis, side in enumerate(sides)]  # fmt: skip
    pulled = Displacement("top", [*free[:-1], end])
    return Scene(
        MeshSpec(folder / f"block{dim}.msh", kinematics="plane_strain" if dim == 3 else kinematics), {"m": material},
        [Body("block", "m")], displacements=[*supports, pulled], steps=Steps(count=count), output=OUTPUT,
        petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


@pytest.mark.parametrize("load", ["traction", "support"])
def test_an_elastic_bar_stores_half_of_force_times_way(tmp_path, meshes, load):
    scene = bar(meshes, "plane_stress", 0.01, 3, Material(YOUNG, 0.3))
    if load == "traction":
        scene.displacements = scene.displacements[:-1]
        scene.loads = [Load("top", traction=[0.0, 10.0])]
    energy = run(scene, SELF, tmp_path / "out")[-1]["energy"]
    assert energy["stored"] == pytest.approx(0.5 * YOUNG * 0.01**2, rel=1e-9)
    assert energy["bodies"] == pytest.approx(energy["stored"], rel=1e-9)
    assert energy["loads" if load == "traction" else "supports"] == pytest.approx(energy["stored"], rel=1e-9)
    assert abs(energy["defect"]) < 1e-9 and "plastic" not in energy and "contacts" not in energy
    head = (tmp_path / "out" / "history.csv").read_text().splitlines()[0].split(",")
    assert {"energy.loads", "energy.supports", "energy.stored", "energy.defect"} <= set(head)


@pytest.mark.parametrize("kinematics", ["plane_stress", "3D"])
def test_a_plastic_bar(tmp_path, meshes, kinematics):
    """Stored and dissipated by the closed form of a tension test; what is missing falls with the load step."""
    material = Material(YOUNG, 0.3, yield_stress=YIELD, hardening=HARDENING, kinematic_hardening=BACK)
    end, defects = 0.02, []
    strain = (YOUNG * end - YIELD) / (YOUNG + HARDENING + BACK)
    stress = YIELD + (HARDENING + BACK) * strain
    for count in (5, 10, 20):
        scene = bar(meshes, kinematics, end, count, material)
        energy = run(scene, SELF, tmp_path / f"{count}")[-1]["energy"]
        stored = 0.5 * stress**2 / YOUNG + 0.5 * BACK * strain**2
        assert energy["stored"] == pytest.approx(stored, rel=1e-8)
        assert energy["plastic"] == pytest.approx(YIELD * strain + 0.5 * HARDENING * strain**2, rel=1e-8)
        assert energy["supports"] == pytest.approx(energy["bodies"], rel=1e-8)
        defects.append(abs(energy["defect"]))
    # the load step in which it begins to yield is at fault, and nothing else
    assert defects[-1] < 0.005 and defects[-1] < 0.3 * defects[0]


def dragged(folder, by_obstacle, count=20):
    """A block on a plane, pressed down and drawn along by its top, or on a plane that is drawn along."""
    along, way = [(0, 0), (0.2, 0), (1, 1)], 0.2
    push = [(0, 0), (0.2, 1), (1, 1)]
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0], displacement=[-way if by_obstacle else 0.0, 0.0],
                     amplitude=along)  # fmt: skip
    drawn = Displacement("top", [0.0 if by_obstacle else way, "free"], along)
    return Scene(
        MeshSpec(folder / "block2.msh"), {"m": Material(YOUNG, 0.3)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=floor, name="floor", friction=0.2)],
        displacements=[Displacement("top", ["free", -0.01], push), drawn], steps=Steps(count=count), output=OUTPUT,
        petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


@pytest.mark.parametrize("by_obstacle", [False, True])
def test_friction_takes_its_part(tmp_path, meshes, by_obstacle):
    """From where all points slip on: the tangential force times the way, whoever does the work."""
    steps = run(dragged(meshes, by_obstacle), SELF, tmp_path / "out")
    last, before = steps[-1], steps[-3]
    way = 0.2 / 0.8 * (last["time"] - before["time"])
    force = abs(last["contacts"]["floor"]["force"][0])
    assert last["contacts"]["floor"]["stick"] == 0
    lost = last["energy"]["contacts"]["floor"] - before["energy"]["contacts"]["floor"]
    assert lost == pytest.approx(force * way, rel=1e-6)
    giver = "obstacles" if by_obstacle else "supports"
    assert last["energy"][giver] - before["energy"][giver] == pytest.approx(lost, rel=1e-6)
    # the other one keeps the block where it is, and does nothing
    other = "supports" if by_obstacle else "obstacles"
    assert abs(last["energy"][other] - before["energy"][other]) < 1e-9 * lost
    assert abs(last["energy"]["defect"]) < 0.01


def test_an_obstacle_that_turns(tmp_path, meshes):
    """A plane that turns about an axis in it presses a block; all that it does is stored."""
    plane = Obstacle("plane", point=[0.0, 1.0], normal=[0.0, -1.0], angle=-0.5)
    scene = Scene(
        MeshSpec(meshes / "block2.msh"), {"m": Material(YOUNG, 0.3)}, [Body("block", "m")],
        contacts=[Contact("top", obstacle=plane, name="lid")], displacements=[Displacement("bottom", [0.0, 0.0])],
        steps=Steps(count=8), output=OUTPUT, petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    records = run(scene, SELF, tmp_path / "out")
    energy = records[-1]["energy"]
    assert energy["stored"] > 0.0 and energy["obstacles"] == pytest.approx(energy["stored"], rel=0.02)
    assert abs(energy["contacts"]["lid"]) < 0.02 * energy["stored"]


def test_springs_and_viscosity_take_theirs(tmp_path, meshes):
    scene = bar(meshes, "plane_strain", 0.01, 4, Material(YOUNG, 0.3))
    scene.springs = [Spring("top", [0.0, 30.0])]
    scene.steps = Steps(count=4, viscous_stabilisation=1.0)
    energy = run(scene, SELF, tmp_path / "out")[-1]["energy"]
    given = energy["supports"] + energy["loads"]
    assert energy["springs"] > 0.0 and energy["viscous"] > 0.0
    assert given == pytest.approx(energy["stored"] + energy["springs"] + energy["viscous"], rel=1e-9)


def test_finite_strain_has_the_works(tmp_path, meshes):
    """Not what is stored; the works of supports and stresses are the same."""
    scene = bar(meshes, "plane_strain", 0.3, 6, Material(YOUNG, 0.3, yield_stress=YIELD, hardening=HARDENING))
    scene.mesh = replace(scene.mesh, strain="finite")
    energy = run(scene, SELF, tmp_path / "out")[-1]["energy"]
    assert "stored" not in energy and "defect" not in energy
    assert energy["supports"] == pytest.approx(energy["bodies"], rel=1e-8) and energy["bodies"] > 0.0


KEYS = ("supports", "bodies", "stored", "plastic")


def plastic_drag(folder):
    scene = dragged(folder, False, 8)
    scene.materials = {"m": Material(YOUNG, 0.3, yield_stress=YIELD, hardening=HARDENING)}
    return replace(scene, output=replace(OUTPUT, checkpoint=True))


def works(steps):
    """Rows of numbers of load steps."""
    return [[step["energy"][key] for key in KEYS] + [step["energy"]["contacts"]["floor"]] for step in steps]


@parallel(2, 3)
def test_ranks(shared_tmp, meshes):
    scene = plastic_drag(meshes)
    alone = works(run(scene, SELF, shared_tmp / f"alone{WORLD.rank}"))
    assert min(alone[-1]) > 0.0
    np.testing.assert_allclose(works(run(scene, WORLD, shared_tmp / "together")), alone, rtol=1e-7, atol=1e-10)


@parallel(1, 2)
@pytest.mark.usefixtures("one_order")
def test_restart(shared_tmp, meshes):
    """The sums go on as if nothing had happened."""
    scene, (whole, cut, rest) = plastic_drag(meshes), (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(scene, WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(scene, WORLD, rest, restart=cut)
    np.testing.assert_allclose(works(after), works(steps[STOP:]), rtol=1e-8, atol=1e-12)
