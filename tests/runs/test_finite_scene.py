"""Finite strain at the edges of the program: scene, refusals, warnings, fields."""

import json

import numpy as np
import pytest

from meshes.beam import beam
from meshes.blocks import one_block, two_blocks
from pcontact import build
from pcontact.assembly.finite import FiniteSolid, MixedSolid
from pcontact.assembly.solid import Solid
from pcontact.contact.finite_pair import FinitePair
from pcontact.contact.pair import ContactPair
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from pcontact.view.quantity import available
from tests.support.bad_input import INNER

MOONEY = 'E = 2.6\nnu = 0.3\nlaw = "mooney_rivlin"\nmooney_rivlin = [0.4, 0.1]'
STEEL = "E = 200\nnu = 0.3\nyield_stress = 1"


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene of one body with keys of its material, of the body and of the mesh."""
    (tmp_path / "mesh.msh").write_text(INNER)

    def write(material, body='strain = "finite"', mesh="", more=""):
        path = tmp_path / "scene.toml"
        path.write_text(
            f'[mesh]\nfile = "mesh.msh"\n{mesh}\n[materials.m]\n{material}\n'
            f'[[bodies]]\nregion = "lower"\nmaterial = "m"\n{body}\n{more}'
        )
        return path

    return write


def test_keys_are_read(scene_file):
    scene = read_scene(scene_file(MOONEY))
    assert scene.finite(scene.bodies[0]) and scene.materials["m"].terms == [(0.8, 2.0), (-0.2, -2.0)]
    scene = read_scene(scene_file(STEEL, "", 'strain = "finite"'))
    assert scene.finite(scene.bodies[0]) and scene.materials["m"].multiplicative
    scene = read_scene(scene_file(f"{STEEL}\nkinematic_hardening = 3", 'strain = "small"', 'strain = "finite"'))
    assert not scene.finite(scene.bodies[0]) and not scene.materials["m"].multiplicative
    assert not read_scene(scene_file(f'{STEEL}\nsplit = "additive"')).materials["m"].multiplicative


@pytest.mark.parametrize(
    "said, parts",
    [
        ({"material": MOONEY, "body": ""}, ("materials.m.law", "mooney_rivlin", 'strain = "finite"')),
        ({"material": MOONEY, "mesh": 'kinematics = "plane_stress"'}, ("materials.m.law", "plane_stress", "hencky")),
        ({"material": MOONEY.replace("2.6", "2.5")}, ("materials.m.E", "2.5", "2.6")),
        ({"material": MOONEY + "\nyield_stress = 1"}, ("materials.m.law", "yield", "hencky")),
        ({"material": MOONEY.replace('law = "mooney_rivlin"', "")}, ("materials.m.mooney_rivlin", "without law")),
        ({"material": 'E = 1\nnu = 0.3\nlaw = "ogden"'}, ("materials.m.ogden", "nothing")),
        ({"material": 'E = 1\nnu = 0.3\nlaw = "ogden"\nogden = [[1, -2]]'}, ("materials.m.ogden", "not positive")),
        ({"material": 'E = 1\nnu = 0.3\nlaw = "ogden"\nogden = [[1, 0]]'}, ("materials.m.ogden", "no stiffness")),
        ({"material": 'E = 1\nnu = 0.3\nlaw = "gent"'}, ("materials.m.law", "gent", "neo_hooke")),
        ({"material": f'{STEEL}\nkinematic_hardening = 1\nsplit = "multiplicative"'}, ("m.split", "additive")),
        ({"material": STEEL, "body": 'strain = "large"'}, ("strain", "large", "finite")),
        ({"material": STEEL, "more": "[output]\nestimate = true"}, ("output.estimate", "finite strain", "false")),
    ],
)
def test_bad_scenes(scene_file, said, parts):
    with pytest.raises(InputError) as caught:
        read_scene(scene_file(**said))
    message = str(caught.value)
    assert "\n" not in message and all(part in message for part in parts)


def test_description(scene_file):
    active, left_out = describe(read_scene(scene_file(MOONEY)), 2)
    assert "finite strain elasticity: lower (mooney-rivlin)" in active and "finite strain" not in left_out
    active, left_out = describe(read_scene(scene_file(STEEL)), 2)
    assert "finite strain von Mises plasticity: lower (no hardening)" in active
    assert not any("small" in line for line in active)
    active, left_out = describe(read_scene(scene_file(STEEL, "")), 2)
    assert not any("finite" in line for line in active) and "finite strain" in left_out


def two(path, lower, upper, **more):
    materials = {"elastic": Material(200.0, 0.3), "metal": Material(200.0, 0.3, yield_stress=1.0)}
    return Scene(
        MeshSpec(path), materials, [Body("lower", *lower), Body("upper", *upper)],
        displacements=[Displacement("lower_bottom", [0, 0]), Displacement("upper_top", [0, 0.3]),
                       Displacement("lower_top", [0.2, 0.1]), Displacement("upper_bottom", [0, 0])],
        steps=Steps(count=2), **more,
    )  # fmt: skip


@pytest.mark.parametrize(
    "lower, upper, kind, yields",
    [
        (("elastic", "small"), ("elastic", "small"), Solid, False),
        (("elastic", "small"), ("metal", "small"), Solid, True),
        (("elastic", "finite"), ("metal", "finite"), FiniteSolid, True),
        (("elastic", "small"), ("metal", "finite"), MixedSolid, False),
        (("elastic", "finite"), ("metal", "small"), MixedSolid, True),
    ],
)
def test_items(tmp_path, lower, upper, kind, yields):
    """Scenes without finite strain have the items that they had; each body has one that knows its strain."""
    path = two_blocks(tmp_path / "blocks.msh", 2, 1, 1, "quadrilateral")
    simulation = Simulation(two(path, lower, upper), MPI.COMM_SELF)
    try:
        bulk = simulation.problem.bulk
        assert type(bulk) is kind and getattr(bulk, "small", bulk).yields == yields
        assert simulation.newton.solver["krylov"] == ("cg" if kind is Solid else "gmres")
    finally:
        simulation.close()


@pytest.mark.parametrize("strain, kind", [("small", ContactPair), ("finite", FinitePair)])
def test_pairs(tmp_path, strain, kind):
    """Pairs of bodies without finite strain are those that they were; one body with it is enough for the other kind."""
    path = two_blocks(tmp_path / "blocks.msh", 2, 1, 1, "quadrilateral")
    scene = two(path, ("elastic", "small"), ("elastic", strain))
    scene.displacements = scene.displacements[:2]
    for contact in (Contact("lower_top", "upper_bottom"), Contact(all=True)):
        scene.contacts = [contact]
        simulation = Simulation(scene, MPI.COMM_SELF)
        try:
            assert {type(pair) for report in simulation.problem.contacts for pair in report.pairs} == {kind}
            assert simulation.solve.items
            assert all(item.follows == (strain == "finite") for item in simulation.problem.others)
        finally:
            simulation.close()


@pytest.mark.parametrize("upper", ["small", "finite"])
def test_fields(tmp_path, upper):
    """Cauchy stress, logarithmic strain and plastic strain of every cell."""
    path = two_blocks(tmp_path / "blocks.msh", 2, 2, 1, "quadrilateral")
    scene = two(path, ("metal", "finite"), ("elastic", upper), output=Output(smooth=True))
    simulation = Simulation(scene, MPI.COMM_SELF)
    try:
        assert simulation.run(tmp_path / "out")
        blocks = [block.body for block in simulation.problem.space.mesh.blocks]
        plastic = simulation.problem.bulk.plastic_strain()
    finally:
        simulation.close()
    cells = load_result(tmp_path / "out").bodies.cell_data
    assert {"stress", "log_strain", "equivalent_plastic_strain"} <= set(cells)
    strain, body = np.concatenate(cells["log_strain"]), np.concatenate(cells["body"])
    np.testing.assert_allclose(np.concatenate(cells["equivalent_plastic_strain"]).sum(), np.concatenate(plastic).sum())
    assert set(blocks) == {0, 1}
    # elongations of 0.3 of the height 1, and shear; in the mean over the body they follow from its ends
    expected = np.log(1.3) if upper == "finite" else 0.3
    assert strain[body == 1][:, 1].mean() == pytest.approx(expected, rel=0.05)
    assert np.abs(strain[body == 0]).max() > 0.05
    stretch = [np.concatenate(cells[f"stretch_{k}"]) for k in (1, 2, 3)]
    assert np.all(stretch[0] >= stretch[1]) and np.all(stretch[1] >= stretch[2])
    np.testing.assert_allclose(np.log(stretch).sum(axis=0), strain[:, :3].sum(axis=1), atol=1e-12)
    rotation = np.concatenate(cells["rotation"])
    assert not rotation[:, :2].any() and np.abs(rotation[body == 0, 2]).max() > 1.0
    report = json.loads((tmp_path / "out" / "report.json").read_text())["steps"][-1]["finite_strain"]
    assert set(report) == ({"lower"} if upper == "small" else {"lower", "upper"})
    assert report["lower"]["largest_stretch"] == pytest.approx(stretch[0][body == 0].max(), rel=1e-6)
    assert report["lower"]["smallest_stretch"] == pytest.approx(stretch[2][body == 0].min(), rel=1e-6)
    assert report["lower"]["rotation"] == pytest.approx(np.abs(rotation[body == 0, 2]).max(), rel=1e-6)
    assert {"stretch_1", "rotation", "rotation_z"} <= set(available(load_result(tmp_path / "out")))


def test_additive_split_has_a_warning(tmp_path, caplog):
    path = one_block(tmp_path / "block.msh", 2, 1)
    for split, warned in (("additive", True), ("multiplicative", False)):
        scene = Scene(
            MeshSpec(path, strain="finite"), {"m": Material(200.0, 0.3, yield_stress=1.0, split=split)},
            [Body("block", "m")], displacements=[Displacement("bottom", [0, 0]), Displacement("top", [0, 0.6])],
            steps=Steps(count=4), output=Output(fields=False),
        )  # fmt: skip
        simulation = Simulation(scene, MPI.COMM_SELF)
        caplog.clear()
        try:
            assert simulation.run()
            assert build.yielding_volume(simulation.scene, simulation.problem.space) == pytest.approx(1.0)
        finally:
            simulation.close()
        told = [line for line in caplog.messages if "additive" in line]
        assert len(told) == warned and all("block" in line and "multiplicative" in line for line in told)


def test_one_side_may_find_other_facets(tmp_path):
    """Dragged so far in a load step that the points of one of two surfaces get other facets, and the others do not."""
    path = two_blocks(tmp_path / "blocks.msh", 2, 4, 3)
    scene = Scene(
        MeshSpec(path, strain="finite"), {"m": Material(10.0, 0.3, law="neo_hooke")},
        [Body("lower", "m"), Body("upper", "m")], contacts=[Contact("upper_bottom", "lower_top", unbiased=True)],
        displacements=[Displacement("lower_bottom", [0, 0]), Displacement("upper_top", [0.2, -0.1])],
        steps=Steps(count=2), output=Output(fields=False),
    )  # fmt: skip
    simulation = Simulation(scene, MPI.COMM_SELF)
    try:
        assert simulation.run(keep=True)
        first, last = simulation.records.data()["steps"]
        assert first["cutbacks"] == last["cutbacks"] == 0 and last["newton"] <= 5
    finally:
        simulation.close()


def test_steps_in_which_nothing_acts_any_more(tmp_path):
    """A beam that springs back: rounding errors of forces that are rounding errors do not keep a load step open."""
    beam(tmp_path / "beam.msh", (20, 2), length=10.0, height=1.0)
    scene = Scene(
        MeshSpec(tmp_path / "beam.msh", strain="finite"), {"m": Material(2600.0, 0.35)}, [Body("beam", "m")],
        displacements=[Displacement("left", [0, 0])],
        loads=[Load("top", pressure=1.0, amplitude=[(0, 0), (1, 1), (2, 0), (12, 0)])],
        steps=Steps(12.0, 24), output=Output(fields=False),
    )  # fmt: skip
    simulation = Simulation(scene, MPI.COMM_SELF)
    try:
        assert simulation.run(keep=True)
        assert all(step["cutbacks"] == 0 for step in simulation.records.data()["steps"])
    finally:
        simulation.close()
