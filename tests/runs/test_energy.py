"""Works and energies in the report: closed forms, convergence with the load steps, ranks, restart."""

from dataclasses import replace

import numpy as np
import pytest

from meshes import cylinder_strip, one_block, two_blocks
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
    Temperature,
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


def order_of(defects):
    """With which power of the load step defects fall, from numbers of load steps that double each time."""
    return np.log2(np.abs(defects[:-1]) / np.abs(defects[1:]))


def finite_bar(folder, end, count, material, kinematics="plane_stress"):
    """The bar of small strain, drawn with finite strain."""
    scene = bar(folder, kinematics, end, count, material)
    return replace(scene, mesh=replace(scene.mesh, strain="finite"))


@pytest.mark.parametrize("kinematics", ["plane_stress", "3D"])
def test_an_elastic_bar_of_twice_its_length(tmp_path, meshes, kinematics):
    """1/2 E ln(2)^2; the trapezoidal rule misses a part that falls with the square of the load step."""
    defects = []
    for count in (8, 16, 32):
        energy = run(finite_bar(meshes, 1.0, count, Material(YOUNG, 0.3), kinematics), SELF, tmp_path / f"{count}")[-1]
        energy = energy["energy"]
        assert energy["stored"] == pytest.approx(0.5 * YOUNG * np.log(2.0) ** 2, rel=1e-9)
        assert energy["supports"] == pytest.approx(energy["bodies"], rel=1e-9) and "plastic" not in energy
        defects.append(energy["defect"])
    assert np.all(np.abs(order_of(defects) - 2.0) < 0.1) and abs(defects[-1]) < 1e-3


@pytest.mark.parametrize("split", ["multiplicative", "additive"])
def test_a_plastic_bar_at_large_strain(tmp_path, meshes, split):
    """Elongated by half; the closed form in true stress, which does its work on the logarithmic strain."""
    limit, total = 0.1 * YOUNG, np.log(1.5)
    back = BACK if split == "additive" else 0.0
    material = Material(YOUNG, 0.3, yield_stress=limit, hardening=HARDENING, kinematic_hardening=back, split=split)
    strain, defects = (YOUNG * total - limit) / (YOUNG + HARDENING + back), []
    stress = limit + (HARDENING + back) * strain
    for count in (10, 20, 40):
        scene = finite_bar(meshes, 0.5, count, material)
        # a load step ends where it begins to yield: the corner of the curve does not fall within one
        scene.displacements[-1].amplitude = [(0.0, 0.0), (0.4, np.expm1(0.1) / 0.5), (1.0, 1.0)]
        energy = run(scene, SELF, tmp_path / f"{count}")[-1]["energy"]
        assert energy["stored"] == pytest.approx(0.5 * stress**2 / YOUNG + 0.5 * back * strain**2, rel=1e-9)
        assert energy["plastic"] == pytest.approx(limit * strain + 0.5 * HARDENING * strain**2, rel=1e-9)
        defects.append(energy["defect"])
    assert np.all(np.abs(order_of(defects) - 2.0) < 0.1) and abs(defects[-1]) < 1e-3


@pytest.mark.parametrize("law", ["hencky", "neo_hooke"])
def test_simple_shear(tmp_path, meshes, law):
    """Sheared by 1: mu asinh(1/2)^2 * 2 and 1/2 mu."""
    sides = [Displacement(side, ["y", 0.0]) for side in ("left", "right", "bottom", "top")]
    scene = Scene(
        MeshSpec(meshes / "block2.msh", strain="finite"), {"m": Material(YOUNG, 0.3, law=law)}, [Body("block", "m")],
        displacements=sides, steps=Steps(count=4), output=OUTPUT, petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    energy, shear = run(scene, SELF, tmp_path / "out")[-1]["energy"], YOUNG / 2.6
    expected = 2.0 * shear * np.arcsinh(0.5) ** 2 if law == "hencky" else 0.5 * shear
    assert energy["stored"] == pytest.approx(expected, rel=1e-9)


def test_a_tube_of_rubber(tmp_path):
    """Widened to twice its inner radius: the integral of neo-Hooke's energy over the wall, incompressible."""
    cylinder_strip(tmp_path / "tube.msh", (24, 1), inner=1.0, outer=2.0, height=1.0)
    radii, defects = np.sqrt(np.linspace(1.0, 4.0, 4001)), []
    squares = 1.0 + 3.0 / radii**2
    density = 0.5 * (squares + 1.0 / squares - 2.0)
    expected = np.sum((density * radii)[1:] * np.diff(radii) + (density * radii)[:-1] * np.diff(radii)) * np.pi
    young = 9.0 * 1e4 / (3.0 * 1e4 + 1.0)
    for count in (8, 16):
        scene = Scene(
            MeshSpec(tmp_path / "tube.msh", kinematics="axisymmetric", strain="finite", mean_dilatation=True),
            {"m": Material(young, 0.5 * young - 1.0, law="neo_hooke")}, [Body("body", "m")],
            displacements=[Displacement("inner", [1.0, "free"]), Displacement("bottom", ["free", 0.0]),
                           Displacement("top", ["free", 0.0])],
            steps=Steps(count=count), output=OUTPUT, petsc={"snes_rtol": "1e-12"},
        )  # fmt: skip
        energy = run(scene, SELF, tmp_path / f"{count}")[-1]["energy"]
        assert energy["stored"] == pytest.approx(expected, rel=2e-3)
        defects.append(energy["defect"])
    assert abs(order_of(defects)[0] - 2.0) < 0.2 and abs(defects[-1]) < 5e-3


@pytest.mark.parametrize("kinematics", ["plane_stress", "plane_strain", "3D"])
def test_heat_is_supplied(tmp_path, meshes, kinematics):
    """A bar that is warmed, drawn and cooled again: the balance is exact, a bar that may expand stores nothing."""
    scene = bar(meshes, kinematics, 0.01, 5, Material(YOUNG, 0.3, expansion=1e-3))
    scene.temperatures = [Temperature(8.0, amplitude=[(0, 0), (0.6, 1), (1, 0.3)])]
    energy = run(scene, SELF, tmp_path / "held")[-1]["energy"]
    assert abs(energy["defect"]) < 1e-9 and abs(energy["heat"]) > 0.01 * energy["stored"]
    scene.displacements = scene.displacements[:-1]
    energy = run(scene, SELF, tmp_path / "free")[-1]["energy"]
    if kinematics == "plane_strain":
        # what keeps it from expanding across the plane is no support
        assert energy["stored"] == pytest.approx(0.5 * YOUNG * (2.4e-3) ** 2, rel=1e-9)
    else:
        assert abs(energy["stored"]) < 1e-12 * YOUNG
    assert energy["heat"] == pytest.approx(energy["stored"], rel=1e-9, abs=1e-12 * YOUNG)


@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress"])
def test_heat_of_a_bar_that_yields(tmp_path, meshes, kinematics):
    """What is missing falls with the load steps, as without heat; plastic strain changes areas of plane stress."""
    defects = []
    for count in (10, 20, 40):
        material = Material(YOUNG, 0.3, yield_stress=YIELD, hardening=HARDENING, expansion=1e-3)
        scene = bar(meshes, kinematics, 0.01, count, material)
        scene.temperatures = [Temperature("8 * (1 + y)")]
        defects.append(run(scene, SELF, tmp_path / f"{count}")[-1]["energy"]["defect"])
    assert abs(defects[-1]) < 2e-3 and abs(defects[-1]) < 0.3 * abs(defects[0])


def test_bodies_of_both_kinds(tmp_path):
    """One stores by the law of small strain, the other by that of finite strain: tied blocks in a tension test."""
    two_blocks(tmp_path / "two.msh", 2, 2, 2)
    scene = Scene(
        MeshSpec(tmp_path / "two.msh"), {"m": Material(YOUNG, 0.0)},
        [Body("lower", "m"), Body("upper", "m", strain="finite")],
        contacts=[Contact("upper_bottom", "lower_top", name="seam", tied=True)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, 0.2])],
        steps=Steps(count=16), output=OUTPUT, petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    last = run(scene, SELF, tmp_path / "out")[-1]
    force = last["reactions"]["upper_top"][1]
    # nominal stress of the upper block ln(l) / l, of the lower one E e
    stretch = 1.0
    for _ in range(60):
        stretch = np.exp(force / YOUNG * stretch)
    expected = 0.5 * YOUNG * (np.log(stretch) ** 2 + (force / YOUNG) ** 2)
    assert last["energy"]["stored"] == pytest.approx(expected, rel=1e-6) and abs(last["energy"]["defect"]) < 2e-4
    assert set(last["finite_strain"]) == {"upper"} and set(last["small_strain"]) == {"lower"}
    assert last["finite_strain"]["upper"]["largest_stretch"] == pytest.approx(stretch, rel=1e-6)


KEYS = ("supports", "bodies", "stored", "plastic")


def plastic_drag(folder, strain):
    scene = dragged(folder, False, 8)
    scene.materials = {"m": Material(YOUNG, 0.3, yield_stress=YIELD, hardening=HARDENING)}
    scene.mesh = replace(scene.mesh, strain=strain)
    return replace(scene, output=replace(OUTPUT, checkpoint=True))


def works(steps):
    """Rows of numbers of load steps."""
    rows = [[step["energy"][key] for key in KEYS] + [step["energy"]["contacts"]["floor"]] for step in steps]
    stretched = [step.get("finite_strain", {}).get("block", {}) for step in steps]
    return [[*row, *(one[key] for key in ("largest_stretch", "smallest_stretch", "rotation") if one)]
            for row, one in zip(rows, stretched, strict=True)]  # fmt: skip


@parallel(2, 3)
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_ranks(shared_tmp, meshes, strain):
    scene = plastic_drag(meshes, strain)
    alone = works(run(scene, SELF, shared_tmp / f"alone{WORLD.rank}"))
    assert min(alone[-1]) > 0.0
    np.testing.assert_allclose(works(run(scene, WORLD, shared_tmp / "together")), alone, rtol=1e-7, atol=1e-10)


@parallel(1, 2)
@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_restart(shared_tmp, meshes, strain):
    """The sums go on as if nothing had happened."""
    scene, (whole, cut, rest) = plastic_drag(meshes, strain), (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(scene, WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(scene, WORLD, rest, restart=cut)
    np.testing.assert_allclose(works(after), works(steps[STOP:]), rtol=1e-8, atol=1e-12)
