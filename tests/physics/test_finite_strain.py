"""Bodies with finite strain against closed forms and other programs; restart, ranks, bodies of both kinds."""

import shutil

import numpy as np
import pytest

from meshes.blocks import one_block, two_blocks
from meshes.cook import cook
from meshes.thick_cylinder import cylinder_strip
from pcontact.io.checkpoint import NAME
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.kinematics import mesh

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
P = 2.0 * np.linspace(0.0, 1.0, 200) ** 2.0
CURVE = np.column_stack([P, 0.45 + 0.265 * (1.0 - np.exp(-16.93 * P)) + 0.12924 * P]).tolist()
METAL = Material(206.9, 0.29, hardening_curve=CURVE)


class Rows(Observer):
    """Records of all steps, and the checkpoint of one of them, as a run that died after it would leave it."""

    def __init__(self, folder=None, at=0):
        self.rows, self.cuts, self._folder, self._at = [], 0, folder, at

    def step(self, step, u, record):
        self.rows.append(record)
        if step.number == self._at and WORLD.rank == 0:
            (self._folder / "dead").mkdir()
            shutil.copy(self._folder / NAME, self._folder / "dead" / NAME)

    def cut(self, target, outcome):
        self.cuts += 1


def run(scene, comm=WORLD, directory=None, at=0, restart=None):
    """Rows of a run that converges. Collective on `comm`."""
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    look, simulation = Rows(directory, at), Simulation(scene, comm)
    try:
        assert simulation.run(directory, [look])
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return look


def panel(path, steps=10, **output):
    """Cook's membrane."""
    return Scene(
        MeshSpec(path, strain="finite"), {"m": METAL}, [Body("panel", "m")],
        displacements=[Displacement("left", [0, 0])], loads=[Load("right", traction=[0, 0.3125])],
        steps=Steps(count=steps), output=Output(fields=False, probes=["corner"], **output),
        petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


def corner(row):
    return row["probes"]["corner"]["mean"][1]


@pytest.mark.parallel(2, 3)
def test_cook(shared_tmp):
    """6.284 with 8 x 8 cells is what an independent program finds. Ranks do not matter."""
    path = mesh(cook, shared_tmp / "cook.msh", 8)
    look = run(panel(path), WORLD)
    assert corner(look.rows[-1]) == pytest.approx(6.284, abs=1e-3)
    assert look.cuts == 0 and sum(row["newton"] for row in look.rows) < 60
    if WORLD.size > 1:
        alone = run(panel(path), SELF)
        for row, other in zip(look.rows, alone.rows, strict=True):
            assert corner(row) == pytest.approx(corner(other), rel=1e-8)
            assert row["plastic"]["max_equivalent_strain"] == pytest.approx(
                other["plastic"]["max_equivalent_strain"], rel=1e-8
            )


@pytest.mark.parallel
def test_restart(shared_tmp):
    """A run that goes on from its middle takes the same iterations to the same numbers."""
    path, out = mesh(cook, shared_tmp / "cook.msh", 4), shared_tmp / "out"
    full = run(panel(path, checkpoint=True), WORLD, out, at=7).rows
    again = run(panel(path, checkpoint=True), WORLD, shared_tmp / "again", restart=out / "dead").rows
    assert [row["newton"] for row in again] == [row["newton"] for row in full[7:]]
    for row, other in zip(again, full[7:], strict=True):
        assert corner(row) == pytest.approx(corner(other), rel=1e-11)


def strip(path, material, radius, n, turns):
    """A long tube (no axial strain) of which the inner surface moves out, through some radii in turn."""
    times = np.linspace(0.0, 1.0, len(turns) + 1)
    factors = [(0.0, 0.0), *zip(times[1:], np.array(turns) - radius, strict=True)]
    return Scene(
        MeshSpec(mesh(cylinder_strip, path, (n, 1), inner=radius, outer=2 * radius, height=1.0), strain="finite",
                 kinematics="axisymmetric"),
        {"m": material}, [Body("body", "m")],
        displacements=[Displacement("inner", [1.0, "free"], factors), Displacement("bottom", ["free", 0]),
                       Displacement("top", ["free", 0])],
        steps=Steps(count=10 * len(turns)), output=Output(fields=False),
    )  # fmt: skip


def pressures(rows, turns):
    """Pressure on the moved inner surface at the radii of :func:`strip`."""
    found = []
    for number, radius in enumerate(turns):
        row = next(row for row in rows if abs(row["time"] - (number + 1) / len(turns)) < 1e-9)
        found.append(row["reactions"]["inner"][0] / (2.0 * np.pi * radius))
    return found


@pytest.mark.parametrize("law", ["neo_hooke", "mooney_rivlin", "ogden"])
def test_rubber_tube(tmp_path, law):
    """ln(la / lb) + (1 / lb^2 - 1 / la^2) / 2 for mu = 1 and no change of volume, of Mooney and Rivlin's law too."""
    turns, bulk = [1.1, 1.5, 2.0, 3.0], 1e4
    nu = (3.0 * bulk - 2.0) / (2.0 * (3.0 * bulk + 1.0))
    constants = {"mooney_rivlin": {"mooney_rivlin": [0.35, 0.15]}, "ogden": {"ogden": [[0.6, 2.0], [-0.4, -2.0]]}}
    material = Material(2.0 * (1.0 + nu), nu, law=law, **constants.get(law, {}))
    rows = run(strip(tmp_path / "tube.msh", material, 1.0, 16, turns)).rows
    for la, found, said in zip(turns, pressures(rows, turns), (0.131562, 0.428228, 0.574054, 0.660417), strict=True):
        lb = np.sqrt((3.0 + la**2) / 4.0)
        expected = np.log(la / lb) + 0.5 * (lb**-2 - la**-2)
        assert expected == pytest.approx(said, abs=6e-7)
        assert found == pytest.approx(expected, rel=1.5e-3)


def test_plastic_tube(tmp_path):
    """sy / sqrt 3 ln((300 + a^2) / a^2) for an incompressible rigid plastic tube."""
    bulk, shear, turns = 40000.0, 3800.0, [25.0, 40.0, 55.0, 70.0, 85.0]
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    material = Material(young, young / (2.0 * shear) - 1.0, yield_stress=0.5)
    look = run(strip(tmp_path / "tube.msh", material, 10.0, 10, turns))
    for a, found in zip(turns, pressures(look.rows, turns), strict=True):
        assert found == pytest.approx(0.5 / np.sqrt(3.0) * np.log((300.0 + a**2) / a**2), rel=5e-4)
    assert look.cuts == 0


@pytest.mark.parallel(2)
def test_bodies_of_both_kinds(shared_tmp):
    """Each does what it does alone; a bar of perfect plasticity turns with its supports without bearing anything."""
    path = mesh(two_blocks, shared_tmp / "blocks.msh", 2, 2, 3, "quadrilateral")
    def blocks(lower, upper):
        return Scene(
            MeshSpec(path), {"m": METAL}, [Body("lower", "m", lower), Body("upper", "m", upper)],
            displacements=[Displacement("lower_bottom", [0, 0]), Displacement("lower_top", [0.3, 0.2]),
                           Displacement("upper_bottom", [0, 0]), Displacement("upper_top", [-0.2, 0.3])],
            steps=Steps(count=4), output=Output(fields=False), petsc={"snes_rtol": "1e-12"},
        )  # fmt: skip

    reactions = {}
    for lower in ("small", "finite"):
        for upper in ("small", "finite"):
            rows = run(blocks(lower, upper)).rows
            reactions[lower, upper] = {name: rows[-1]["reactions"][name] for name in ("lower_top", "upper_top")}
    for name, number in (("lower_top", 0), ("upper_top", 1)):
        for strain in ("small", "finite"):
            alone = [values[name] for kinds, values in reactions.items() if kinds[number] == strain]
            np.testing.assert_allclose(alone[0], alone[1], rtol=1e-9)
        kinds = [reactions[strain, strain][name] for strain in ("small", "finite")]
        assert np.abs(np.subtract(*kinds)).max() > 0.05 * np.abs(kinds).max()


@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress", "axisymmetric", "space"])
def test_bar(tmp_path, kinematics):
    """Nominal stress ln(l) / l of Hencky's law, E = 1, to rounding errors; in plane strain E / (1 - nu^2)."""
    dim = 3 if kinematics == "space" else 2
    path = mesh(one_block, tmp_path / "bar.msh", dim, 2)
    sides = {"left": 0, "bottom": dim - 1} | ({"front": 1} if dim == 3 else {})
    fixed = [Displacement(name, [0 if i == k else "free" for i in range(dim)]) for name, k in sides.items()]
    pull = Displacement("top", ["free"] * (dim - 1) + [1.0])
    scene = Scene(
        MeshSpec(path, kinematics="plane_strain" if dim == 3 else kinematics, strain="finite"),
        {"m": Material(1.0, 0.3)}, [Body("block", "m")], displacements=[*fixed, pull], steps=Steps(count=4),
        output=Output(fields=False), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    rows = run(scene).rows
    area = np.pi if kinematics == "axisymmetric" else 1.0
    modulus = 1.0 / 0.91 if kinematics == "plane_strain" else 1.0
    for row in rows:
        stretch = 1.0 + row["time"]
        assert row["reactions"]["top"][-1] / area == pytest.approx(modulus * np.log(stretch) / stretch, rel=1e-9)
