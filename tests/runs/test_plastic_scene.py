"""Plasticity at the edges of the program: scene, warnings, terminal, report, fields and their means at the nodes."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from pcontact import build
from pcontact.assembly.solid import Solid
from pcontact.io.observers import Terminal
from pcontact.io.result import load_result
from pcontact.io.snapshot import NodeMeans
from pcontact.mesh.raw import complete
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Output, Scene
from pcontact.scene.reader import read_scene
from pcontact.scene.validate import validate
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from pcontact.view.quantity import available, find
from pcontact.view.show import show
from tests.support.bad_input import INNER
from tests.support.dealt import distribute
from tests.support.small import DIMENSION, block_file, keys

WORLD = MPI.COMM_WORLD
CURVE = [[0, 250], [0.01, 300.0], [0.05, 300.0], [0.1, 320.0]]


# -- scene ----------------------------------------


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene of one body with more keys of its material."""
    (tmp_path / "mesh.msh").write_text(INNER)

    def write(material):
        path = tmp_path / "scene.toml"
        path.write_text(
            f'[mesh]\nfile = "mesh.msh"\n[materials.m]\nE = 1000.0\nnu = 0.3\n{material}\n'
            '[[bodies]]\nregion = "lower"\nmaterial = "m"\n'
        )
        return path

    return write


def test_hardening_curve_is_read(scene_file):
    scene = read_scene(scene_file(f"hardening_curve = {CURVE}\nkinematic_hardening = 10"))
    material = scene.materials["m"]
    assert material.hardening_curve == tuple((float(p), float(s)) for p, s in CURVE)
    assert material.plastic and material.yield_stress is None
    assert scene.yields(scene.bodies[0]) and scene.averages(scene.bodies[0])
    # whoever wrote the scene
    material.hardening_curve = np.array(CURVE)
    validate(scene)
    assert material.hardening_curve[1] == (0.01, 300.0)


def test_perfect_plasticity_as_a_curve(scene_file):
    assert read_scene(scene_file("hardening_curve = [[0.0, 5.0]]")).materials["m"].hardening_curve == ((0.0, 5.0),)


PAIRS = "allowed: a list of [equivalent plastic strain, yield stress] pairs, the first strain 0, strains increasing"


@pytest.mark.parametrize(
    ("material", "key", "found", "allowed"),
    [
        ("hardening_curve = 250", "hardening_curve", "an integer 250", PAIRS),
        ("hardening_curve = []", "hardening_curve", "a list []", PAIRS),
        ("hardening_curve = [0, 250]", "hardening_curve", "entry 0 is an integer 0", PAIRS),
        ("hardening_curve = [[0, 250, 1]]", "hardening_curve", "entry 0 is a list [0, 250, 1]", PAIRS),
        ("hardening_curve = [[0, 250], [0.1, nan]]", "hardening_curve", "entry 1 is a list [0.1, nan]", PAIRS),
        ("hardening_curve = [[0, '250']]", "hardening_curve", "entry 0 is a list [0, '250']", PAIRS),
        ("hardening_curve = [[0.01, 250]]", "hardening_curve", "whose first strain is 0.01", PAIRS),
        ("hardening_curve = [[0, 0], [1, 2]]", "hardening_curve", "whose first stress is 0", PAIRS),
        ("hardening_curve = [[0, -1], [1, 2]]", "hardening_curve", "whose first stress is -1", PAIRS),
        ("hardening_curve = [[0, 1], [0.1, 2], [0.1, 3]]", "hardening_curve",
         "whose strains do not increase in entry 2", PAIRS),
        ("hardening_curve = [[0, 2], [0.1, 1]]", "hardening_curve", "whose stresses decrease in entry 1", PAIRS),
        ("hardening_curve = [[0, 2]]\nyield_stress = 2", "yield_stress", "2.0 together with hardening_curve",
         "at most one of yield_stress, hardening_curve"),
        ("hardening_curve = [[0, 2]]\nhardening = 3", "hardening", "3.0 together with hardening_curve",
         "at most one of hardening, hardening_curve"),
        ("hardening = 3", "hardening", "3.0 without yield_stress or", "yield_stress or hardening_curve as well"),
        ("kinematic_hardening = 3", "kinematic_hardening", "3.0 without yield_stress or hardening_curve",
         "yield_stress or hardening_curve as well"),
        ("hardening_curves = [[0, 2]]", "hardening_curves", "an unknown key, the nearest known key is "
         "'hardening_curve'", "yield_stress"),
    ],
)  # fmt: skip
def test_bad_materials(scene_file, material, key, found, allowed):
    with pytest.raises(InputError) as caught:
        read_scene(scene_file(material))
    message = str(caught.value)
    assert "\n" not in message
    for part in (f"scene.toml: materials.m.{key}: found ", found, allowed):
        assert part in message


@pytest.mark.parametrize(
    ("material", "hardening"),
    [
        ("yield_stress = 2", "no hardening"),
        ("yield_stress = 2\nhardening = 1", "isotropic hardening"),
        ("yield_stress = 2\nkinematic_hardening = 1", "kinematic hardening"),
        ("yield_stress = 2\nhardening = 1\nkinematic_hardening = 1", "isotropic and kinematic hardening"),
        ("hardening_curve = [[0, 2]]", "tabulated hardening"),
        ("hardening_curve = [[0, 2]]\nkinematic_hardening = 1", "tabulated and kinematic hardening"),
    ],
)
def test_description(scene_file, material, hardening):
    active, left_out = describe(read_scene(scene_file(material)), 2)
    assert f"small strain von Mises plasticity: lower ({hardening})" in active and "plasticity" not in left_out
    # a material that no body is made of
    scene = read_scene(scene_file(f"[materials.other]\nE = 1\nnu = 0.3\n{material}"))
    active, left_out = describe(scene, 2)
    assert not any("Mises" in line for line in active) and "plasticity" in left_out


# -- a block, and a bulk that says it yields ----------------------------------------


def block(folder, cell, order=1, name="block.msh", **more):
    """A scene of one block, pressed unless said otherwise."""
    path, d = folder / name, DIMENSION[cell]
    on_root(WORLD, block_file, path, cell, 3)
    press = [Displacement("bottom", [0.0] * d), Displacement("top", [0.0] * (d - 1) + [-0.02])]
    said = {"mesh": MeshSpec(path, order=order), "displacements": press, **more}
    return Scene(
        materials={"m": Material(10.0, 0.3)},
        bodies=[Body("block", "m")],
        **said,
    )


@pytest.mark.parametrize("cell, order, kinematics, nu, warned", [
    ("triangle", 1, "plane_strain", 0.3, ["plastic flow"]),
    ("tetrahedron", 1, "plane_strain", 0.3, ["plastic flow"]),
    ("triangle", 1, "axisymmetric", 0.3, ["plastic flow"]),
    ("triangle", 1, "plane_strain", 0.46, ["found 0.46"]),
    ("triangle", 1, "plane_stress", 0.3, []),
    ("triangle", 2, "plane_strain", 0.3, []),
    ("quadrilateral", 1, "plane_strain", 0.3, []),
])  # fmt: skip
@pytest.mark.parametrize("material", [{"yield_stress": 1.0}, {"hardening_curve": [[0.0, 1.0]]}])
def test_warning_of_locking(tmp_path, monkeypatch, cell, order, kinematics, nu, warned, material):
    said = []
    monkeypatch.setattr("pcontact.build.log.warning", lambda text, *args: said.append(text % args))
    scene = block(tmp_path, cell, order)
    scene.mesh.kinematics, scene.materials["m"] = kinematics, Material(10.0, nu, **material)
    scene.allow_unsafe = ["locking"]
    Simulation(scene).close()
    assert len(said) == len(warned)
    for text, cause in zip(said, warned, strict=True):
        assert cause in text and "locking" in text and "order = 2" in text


@pytest.mark.parametrize("kinematics, volume", [("plane_strain", 1.0), ("axisymmetric", np.pi)])
def test_volume_that_may_yield(tmp_path, kinematics, volume):
    scene = block(tmp_path, "quadrilateral")
    scene.mesh.kinematics = kinematics
    simulation = Simulation(scene)
    space = simulation.problem.space
    assert build.yielding_volume(scene, space) == 0.0
    scene.materials["m"].yield_stress = 1.0
    assert build.yielding_volume(scene, space) == pytest.approx(volume)
    simulation.close()


@pytest.mark.parametrize("volume", [0.0, 4.0])
def test_line_of_a_step(monkeypatch, volume):
    said = []
    monkeypatch.setattr("pcontact.io.observers.log.info", lambda text, *args: said.append(text % args))
    step = SimpleNamespace(number=1, time=0.5, newton=3, krylov=9, residual=1e-9)
    record = {"imbalance": 0.0, "contacts": {}, "plastic": {"max_equivalent_strain": 0.0123, "yielded_volume": 0.492}}
    Terminal(1.0, volume).step(step, None, record)
    assert ("| yielded 12.3 % (max strain 0.0123)" in said[0]) == (volume > 0.0)


def stub_of(monkeypatch):
    """The elastic bulk with what one that may yield has more."""

    def plastic_strain(bulk):
        return [1e-3 * np.asarray(block.ids, dtype=float) for block in bulk.space.mesh.blocks]

    monkeypatch.setattr(Solid, "plasticity", lambda bulk: (0.0123, 0.25), raising=False)
    monkeypatch.setattr(Solid, "plastic_strain", plastic_strain, raising=False)


@pytest.mark.parallel
def test_report_and_fields(shared_tmp, monkeypatch):
    stub_of(monkeypatch)
    simulation = Simulation(block(shared_tmp, "quadrilateral", output=Output(smooth=True)))
    assert simulation.run(shared_tmp / "out")
    simulation.close()
    WORLD.Barrier()
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    assert report["steps"][0]["plastic"] == {"max_equivalent_strain": 0.0123, "yielded_volume": 0.25}
    with open(shared_tmp / "out" / "history.csv", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["plastic.max_equivalent_strain"]) == 0.0123 and float(row["plastic.yielded_volume"]) == 0.25
    result = load_result(shared_tmp / "out")
    strain = find(result, "equivalent_plastic_strain")
    assert (strain.place, strain.at) == ("bodies", "cell")
    np.testing.assert_allclose(np.sort(strain.values[""]), 1e-3 * np.arange(9), atol=1e-15)
    smooth = find(result, "equivalent_plastic_strain_smooth")
    assert (smooth.place, smooth.at) == ("bodies", "point") and len(smooth.values[""]) == 16
    assert result.bodies.point_data["stress_smooth"].shape == (16, 6)
    assert {"stress_smooth_yy", "equivalent_stress_smooth"} <= set(available(result))
    # one cell alone has each corner of the block
    stress, points = result.bodies.cell_data["stress"], result.bodies.points
    corner = np.flatnonzero((points == points.min(axis=0)).all(axis=1))
    cell = np.flatnonzero((result.bodies.cells[0][1] == corner).any(axis=1))
    np.testing.assert_allclose(result.bodies.point_data["stress_smooth"][corner], stress[0][cell], rtol=1e-12)


@pytest.mark.parametrize("field", ["equivalent_plastic_strain", "equivalent_plastic_strain_smooth", "stress_smooth_yy"])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_pictures(tmp_path, monkeypatch, cell, field):
    pytest.importorskip("pyvista")
    stub_of(monkeypatch)
    simulation = Simulation(block(tmp_path, cell, output=Output(smooth=True)))
    simulation.run(tmp_path / "out")
    simulation.close()
    target = show(str(tmp_path / "out"), {"field": field, "size": "320x240", "o": str(tmp_path / "picture.png")})
    assert target.stat().st_size > 1000


def test_no_such_fields_without_plasticity(tmp_path):
    simulation = Simulation(block(tmp_path, "quadrilateral"))
    simulation.run(tmp_path / "out")
    simulation.close()
    assert not any("plastic" in name or "smooth" in name for name in available(load_result(tmp_path / "out")))


@pytest.mark.parallel
@pytest.mark.parametrize("material, strain, stress", [
    ({"hardening_curve": [[0.0, 1.0], [0.01, 1.5]]}, 0.015, 1.5),
    ({"hardening_curve": [[0.0, 1.0], [0.01, 1.5]], "kinematic_hardening": 20.0}, 0.0125, 1.75),
    ({"yield_stress": 1.0, "hardening": 50.0}, 0.04 / 3.0, 5.0 / 3.0),
])  # fmt: skip
def test_a_strip_that_yields(shared_tmp, monkeypatch, material, strain, stress):
    """A strip pulled by 3 %: stress and plastic strain of the tension test in everything that comes out."""
    said = []
    monkeypatch.setattr("pcontact.io.observers.log.info", lambda text, *args: said.append(text % args))
    scene = block(
        shared_tmp, "quadrilateral",
        displacements=[Displacement("left", [0.0, "free"]), Displacement("bottom", ["free", 0.0]),
                       Displacement("right", [0.03, "free"])],
        output=Output(smooth=True), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    scene.mesh.kinematics, scene.materials["m"] = "plane_stress", Material(100.0, 0.3, **material)
    simulation = Simulation(scene)
    assert simulation.run(shared_tmp / "out")
    simulation.close()
    WORLD.Barrier()
    report = json.loads((shared_tmp / "out" / "report.json").read_text())
    assert any("von Mises plasticity: block" in line for line in report["model"]["active"])
    (step,) = report["steps"]
    assert step["plastic"] == pytest.approx({"max_equivalent_strain": strain, "yielded_volume": 1.0})
    assert step["reactions"]["right"][0] == pytest.approx(stress)
    result = load_result(shared_tmp / "out")
    for name, value in {"equivalent_plastic_strain": strain, "equivalent_stress": stress, "stress_xx": stress}.items():
        smooth = name.replace("_xx", "") + "_smooth" + ("_xx" if name.endswith("_xx") else "")
        for field in (name, smooth):
            np.testing.assert_allclose(find(result, field).values[""], value, rtol=1e-8)
    assert any(f"yielded 100.0 % (max strain {strain:.4g})" in line for line in said)


# -- means at the nodes ----------------------------------------


def glued(path, cell, degree, bodies):
    """Space on a block whose cells belong to bodies that share nodes. Collective."""
    on_root(WORLD, block_file, path, cell, 3)
    arguments = (None,) * 4
    if WORLD.rank == 0:
        raw = read_mesh(path)
        raw = complete(raw, 2) if degree == 2 else raw
        centres = np.concatenate([raw.points[b.nodes].mean(axis=1) for b in raw.blocks])
        arguments = (raw, False, np.digitize(centres[:, 0], np.arange(1, bodies) / bodies), components(raw))
    return Space(distribute(WORLD, *arguments), degree)


@pytest.mark.parallel
@pytest.mark.parametrize("bodies", [1, 3])
@pytest.mark.parametrize("cell, degree", [("triangle", 1), ("quadrilateral", 2), ("tetrahedron", 2), ("hexahedron", 1)])
def test_means_at_nodes(shared_tmp, cell, degree, bodies):
    """Every rank finds the mean over the cells of one body around each node, wherever those cells are."""
    space = glued(shared_tmp / "block.msh", cell, degree, bodies)
    blocks, means = space.mesh.blocks, NodeMeans(space)
    scalar = [np.sin(1.0 + block.ids) for block in blocks]
    tensor = [np.cos(np.outer(1.0 + block.ids, np.arange(1.0, 7.0))) for block in blocks]
    volume = [1.0 + block.ids % 5 for block in blocks]
    found = means({"a": scalar, "b": tensor}, volume)
    assert found["a"].shape == (len(means.nodes),) and found["b"].shape == (len(means.nodes), 6)
    if bodies == 1:
        np.testing.assert_array_equal(means.nodes, np.arange(space.n_local))
    table = {}
    names = keys(space)
    for own in zip(blocks, space.cells, volume, scalar, tensor, strict=True):
        for entry in zip(*[own[0].ids * 0 + own[0].body, names[own[1]], *own[2:]], strict=True):
            for node in entry[1]:
                table.setdefault((int(entry[0]), int(node)), []).append((entry[2], entry[3], *entry[4]))
    whole = {}
    for part in WORLD.allgather(table):
        for key, rows in part.items():
            whole.setdefault(key, []).extend(rows)
    for block, cells, nodes in zip(blocks, means.cells, space.cells, strict=True):
        np.testing.assert_array_equal(means.nodes[cells], nodes)
        for point, node in zip(cells.ravel(), names[nodes].ravel(), strict=True):
            rows = np.array(whole[block.body, int(node)])
            mean = rows[:, 0] @ rows[:, 1:] / rows[:, 0].sum()
            np.testing.assert_allclose([found["a"][point], *found["b"][point]], mean, rtol=0, atol=1e-13)


def test_bodies_that_share_nodes_keep_their_stress(tmp_path):
    """A stiff and a soft half, stretched by different amounts: two values at the nodes between them."""
    (tmp_path / "mesh.msh").write_text(INNER)
    scene = Scene(
        mesh=MeshSpec(tmp_path / "mesh.msh"),
        materials={"soft": Material(1.0, 0.0), "hard": Material(10.0, 0.0)},
        bodies=[Body("lower", "hard"), Body("upper", "soft")],
        displacements=[
            Displacement("lower_bottom", [0.0, 0.0]),
            Displacement("lower_top", [0.0, 0.01]),
            Displacement("upper_top", [0.0, 0.03]),
        ],
        output=Output(smooth=True),
    )
    simulation = Simulation(scene)
    assert simulation.run(tmp_path / "out")
    simulation.close()
    bodies = load_result(tmp_path / "out").bodies
    stress, moved = bodies.point_data["stress_smooth"][:, 1], bodies.point_data["displacement"][:, 1]
    body = np.empty(len(bodies.points), dtype=int)
    assert len(stress) == 8
    for (_, nodes), numbers in zip(bodies.cells, bodies.cell_data["body"], strict=True):
        body[nodes] = numbers[:, None]
    np.testing.assert_allclose(stress, np.array([0.1, 0.02])[body], rtol=1e-8)
    np.testing.assert_allclose(moved, np.interp(bodies.points[:, 1], [0, 1, 2], [0, 0.01, 0.03]))


# -- solve ----------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("cell, degree", [("quadrilateral", 1), ("triangle", 2), ("hexahedron", 1)])
def test_a_body_that_is_only_moved(shared_tmp, cell, degree):
    """The first row of cells does not yield on the way, however far its nodes are moved in a load step."""
    path = shared_tmp / "block.msh"
    on_root(WORLD, block_file, path, cell, 4)
    way = [10.0, *[0.0] * (DIMENSION[cell] - 1)]
    simulation = Simulation(
        Scene(
            mesh=MeshSpec(path, order=degree),
            materials={"m": Material(1000.0, 0.3, yield_stress=1.0)},
            bodies=[Body("block", "m")],
            displacements=[Displacement("left", way)],
            petsc={"ksp_rtol": "1e-10", "snes_ksp_ew": "false"},
        )
    )
    records = []
    watch = Observer()
    watch.step = lambda step, u, record: records.append(record)
    assert simulation.run(None, [watch])
    moved = simulation.stepper.u.getArray().reshape(-1, DIMENSION[cell])
    simulation.close()
    # one to get there, and one more to leave no forces, as none are at work
    assert [record["newton"] for record in records] in ([1], [2])
    assert records[0]["plastic"]["max_equivalent_strain"] == 0.0
    np.testing.assert_allclose(moved, np.tile(way, (len(moved), 1)), atol=1e-6)
