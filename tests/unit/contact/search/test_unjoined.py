"""Boundary facets that lie on each other inside a body: hanging nodes, and nodes that are there twice."""

import re
from itertools import product

import numpy as np
import pytest

from pcontact.contact.search.unjoined import unjoined
from pcontact.mesh.raw import Block, RawMesh, complete, facets_of_nodes
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components, orient
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import Exchanger
from pcontact.runtime.petsc import MPI
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from tests.support.bad_input import SCENE, mesh_text
from tests.support.dealt import distribute
from tests.support.small import DIMENSION, blocks_file

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
TETRAHEDRA = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]


def grid(cell, n, low, high):
    """Points and cells of a box, n cells along all axes but the last, along which there is one."""
    dim = DIMENSION[cell]
    counts = [n] * (dim - 1) + [1]
    axes = [np.linspace(0.0, 1.0, n + 1)] * (dim - 1) + [np.array([low, high])]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    number = np.arange(len(points)).reshape([k + 1 for k in counts])
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corners = corners if dim == 2 else [(*c, z) for z in (0, 1) for c in corners]
    boxes = [[number[tuple(np.add(at, c))] for c in corners] for at in product(*map(range, counts))]
    if cell == "triangle":
        boxes = [[box[k] for k in part] for box in boxes for part in ((0, 1, 2), (0, 2, 3))]
    if cell == "tetrahedron":
        boxes = [[box[k] for k in part] for box in boxes for part in TETRAHEDRA]
    return points, np.array(boxes)


def stack(cell, n_lower, n_upper, merged):
    """Two boxes on each other as one mesh; nodes of the upper one are those of the lower one where `merged` says so."""
    x, lower = grid(cell, n_lower, 0.0, 1.0)
    y, upper = grid(cell, n_upper, 1.0, 2.0)
    number = np.arange(len(y)) + len(x)
    for k, point in enumerate(y):
        same = np.flatnonzero(np.linalg.norm(x - point, axis=1) < 1e-9)
        if len(same) and merged(point):
            number[k] = same[0]
    used, new = np.unique(number[number >= len(x)], return_inverse=True)
    number[number >= len(x)] = len(x) + new
    points = np.vstack([x, y[used - len(x)]])
    blocks = [Block(cell, 1, np.vstack([lower, number[upper]]))]
    orient("m", points, blocks, np.arange(len(lower) + len(upper)))
    middle = np.flatnonzero(np.abs(points[:, -1] - 1.0) < 1e-9)
    raw = RawMesh("m", DIMENSION[cell], points, blocks)
    raw.facet_groups["middle"] = facets_of_nodes(raw, middle)
    raw.facet_groups["nothing"] = (np.zeros(0, np.int64), np.zeros(0, np.int64))
    return raw


def search(raw, used=(), named=True, degree=1):
    """What is found in a mesh that rank 0 has. *Collective.*"""
    arguments = (None,) * 4
    if WORLD.rank == 0:
        if not named:
            raw.facet_groups.clear()
        raw = complete(raw, degree)
        arguments = (raw, False, np.zeros(raw.offsets[-1], dtype=np.int64), components(raw))
    found = unjoined(distribute(WORLD, *arguments), Exchanger(WORLD), used, True)
    assert set(map(repr, WORLD.allgather(found))) == {repr(found)}
    return found


def made(*arguments):
    """A mesh on rank 0."""
    return stack(*arguments) if WORLD.rank == 0 else None


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
@pytest.mark.parametrize("degree", [1, 2])
def test_hanging_nodes(cell, degree):
    """A box with four cells along its edge on one with two, joined where they have a node in the same place."""
    found = search(made(cell, 2, 4, lambda x: True), named=False, degree=degree)
    flat, pieces = DIMENSION[cell] == 2, 2 if cell == "tetrahedron" else 1
    # the fine facets, and those coarse ones whose centres are on fine ones: all
    assert found.hanging == (4 + 2 if flat else pieces * (16 + 4)) and found.doubled == 0
    assert len(found.places) == 3 and not found.bodies and not found.named
    assert all(place.endswith(", 1)") for place in found.places)


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
def test_doubled_nodes(cell):
    """Nodes along a part of the middle are there twice."""
    found = search(made(cell, 4, 4, lambda x: x[0] < 0.3), named=False)
    flat, pieces = DIMENSION[cell] == 2, 2 if cell == "tetrahedron" else 1
    # both sides of all facets but those whose nodes are all merged
    assert found.doubled == (2 * 3 if flat else 2 * pieces * 12) and found.hanging == 0
    assert not found.bodies and not found.named


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
def test_nothing_is_found_where_cells_meet(cell):
    assert search(made(cell, 3, 3, lambda x: True), named=False) == (0, 0, [], [], 0)


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
def test_what_scene_and_mesh_name(cell):
    """Facets that the scene uses are meant to be boundary, those of other groups may be; bodies may touch."""

    def cut(x):
        return x[0] < 0.3

    assert search(made(cell, 4, 4, cut), used={"middle"}) == (0, 0, [], [], 0)
    found = search(made(cell, 4, 4, cut), used={"nothing"})
    assert found.named > 0 and not found.doubled and not found.hanging
    found = search(made(cell, 3, 4, lambda x: False), named=False)
    assert found == (0, 0, [], [(0, 1)], 0)


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
@pytest.mark.parametrize("scale, shift", [(1e-9, 0.0), (1e6, 0.0), (1.0, 1e5)])
def test_units_and_place_do_not_matter(cell, scale, shift):
    raw = made(cell, 2, 4, lambda x: True)
    if WORLD.rank == 0:
        raw.points = scale * raw.points + shift
    assert search(raw, named=False).hanging > 0


@parallel
def test_thin_cells_have_two_sides():
    """Top and bottom of a sheet are not on each other."""
    raw = made("hexahedron", 3, 3, lambda x: True)
    if WORLD.rank == 0:
        raw.points[:, 2] *= 1e-5
    assert search(raw, named=False) == (0, 0, [], [], 0)


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
@pytest.mark.parametrize("inward", [True, False])
def test_hanging_nodes_on_a_curved_surface(cell, inward):
    """Straight facets of fine cells beside those of coarse ones leave gaps, or overlap."""
    raw = made(cell, 2, 4, lambda x: True)
    if WORLD.rank == 0:
        angle, radius = 0.6 * raw.points[:, 0], 3.0 + (-1.0 if inward else 1.0) * raw.points[:, -1]
        raw.points[:, 0], raw.points[:, -1] = radius * np.sin(angle), radius * np.cos(angle)
        orient("m", raw.points, raw.blocks, np.arange(raw.offsets[-1]))
    found = search(raw, named=False)
    # the coarse facets; of fine ones those that happen to lie on them
    assert found.hanging >= (2 if DIMENSION[cell] == 2 else 4) and not found.doubled and not found.bodies


@pytest.mark.parametrize("points, cells", [
    ([(0, 0), (1, 0), (0.5, 0.02)], [(0, 1, 2)]),
    ([(0, 0), (1, 0), (0.5, 0.02), (0.5, -0.02)], [(0, 1, 2), (0, 3, 1)]),
    ([(0, 0, 0), (1, 0, 0), (0.3, 1, 0), (0.4, 0.4, 0.02)], [(0, 1, 2, 3)]),
])  # fmt: skip
def test_flat_bodies(points, cells):
    """The facets of a flat cell end at each other's vertices and are near, but look away from each other."""
    kind = "triangle" if len(points[0]) == 2 else "tetrahedron"
    raw = RawMesh("m", len(points[0]), np.array(points, dtype=float), [Block(kind, 1, np.array(cells))])
    assert search(raw, named=False) == (0, 0, [], [], 0)


def test_a_slit_that_is_open():
    """Both sides end at its tips."""
    points = [(0, 0), (1, 0.01), (1, -0.01), (2, 0), (1, 1), (1, -1)]
    cells = [(0, 1, 4), (1, 3, 4), (0, 5, 2), (2, 5, 3)]
    raw = RawMesh("m", 2, np.array(points, dtype=float), [Block("triangle", 1, np.array(cells))])
    assert search(raw, named=False) == (0, 0, [], [], 0)


def test_slots_and_notches(tmp_path):
    """A narrow slot, and a notch of two degrees, have two sides that do not touch."""
    for cell in DIMENSION:
        raw = stack(cell, 4, 4, lambda x: x[0] < 0.3)
        upper = np.zeros(len(raw.points), dtype=bool)
        upper[raw.blocks[0].nodes[raw.offsets[-1] // 2 :]] = True
        moved = upper & (np.abs(raw.points[:, -1] - 1.0) < 1e-9) & (raw.points[:, 0] > 0.3)
        for shift in (0.01, 0.035 * (raw.points[moved, 0] - 0.25)):
            raw.points[moved, -1] = 1.0 + shift
            assert search(raw, named=False) == (0, 0, [], [], 0)


# -- runs -------------------------------

# two cells on one, with a node in the middle of its edge
HANGING = mesh_text(
    [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 1), (0, 2), (0.5, 2), (1, 2)],
    [(3, 1, (1, 2, 3, 4)), (3, 2, (4, 5, 7, 6)), (3, 2, (5, 3, 8, 7)),
     (1, 3, (1, 2)), (1, 6, (6, 7)), (1, 6, (7, 8)), (1, 4, (3, 4))],
)  # fmt: skip
NO_CONTACT = SCENE[: SCENE.index("[[contacts]]")] + SCENE[SCENE.index("[[displacements]]") :]
CRACK = '[[contacts]]\nsource = "lower_top"\ntarget = "lower_top"\nself_contact = true\n'


def simulate(folder, mesh, scene, path="mesh.msh"):
    """Set a scene up, and return its warnings. *Collective.*"""
    if WORLD.rank == 0:
        (folder / path).write_text(mesh)
        (folder / "scene.toml").write_text(scene)
    WORLD.barrier()
    Simulation(read_scene(folder / "scene.toml")).close()
    return log.warnings()


@parallel
def test_a_cut_is_refused_unless_it_is_meant(shared_tmp):
    """By default; with the word, a group or a contact it runs."""
    unnamed = HANGING.replace('1 4 "lower_top"\n', "").replace("$PhysicalNames\n7", "$PhysicalNames\n6")
    unnamed = unnamed.replace("$Elements\n7", "$Elements\n6").replace("7 1 2 4 4 3 4\n", "")
    with pytest.raises(InputError) as caught:
        simulate(shared_tmp, unnamed, NO_CONTACT)
    message = str(caught.value)
    assert "mesh.file: found mesh.msh" in message and "\n" not in message
    assert re.search(r"3 .*hanging.*\(0\.25, 1\), \(0\.5, 1\), \(0\.75, 1\)", message)
    assert "tied" in message and "-allow_unsafe mesh" in message
    assert set(WORLD.allgather(message)) == {message}
    said = simulate(shared_tmp, unnamed, "allow_unsafe = ['mesh']\n" + NO_CONTACT)
    assert re.search("3 .*hanging.*safe: ", said[0])
    said = simulate(shared_tmp, HANGING, NO_CONTACT)
    assert len(said) == 1 and "3 facets" in said[0]
    assert simulate(shared_tmp, HANGING, NO_CONTACT + CRACK) == []


@parallel
def test_bodies_that_touch(shared_tmp):
    """Without contact between them a warning says so; contact of the pair, or of all surfaces, is contact."""
    assert simulate(shared_tmp, mesh_text(), SCENE) == []
    said = simulate(shared_tmp, mesh_text(), NO_CONTACT)
    words = "bodies touch and no contact is between their facets: lower - upper; they may pass through each other"
    assert said == [words]
    assert simulate(shared_tmp, mesh_text(), NO_CONTACT + "[[contacts]]\nall = true\n") == []


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
def test_nested_meshes_in_contact(shared_tmp, cell):
    """Nodes of one body on the facets of the other are what contact is for."""
    if WORLD.rank == 0:
        blocks_file(shared_tmp / "blocks.msh", cell, 2, 4)
    WORLD.barrier()
    raw = read_mesh(shared_tmp / "blocks.msh") if WORLD.rank == 0 else None
    assert search(raw, used={"upper_bottom", "lower_top"}) == (0, 0, [], [], 0)
