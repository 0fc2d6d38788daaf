"""Meshes as `pcontact convert` writes them, read by all ranks together."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.build import read
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.hdf5 import ConvertedMesh, convert
from pcontact.mesh.read import read_mesh
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from tests.support.bad_input import CELLS, FACETS, INNER, NAMES, NODES, SCENE, Case, mesh_text, swapped
from tests.support.blocks import scene_of
from tests.support.commands import check_line, execute, in_turn, lay_out
from tests.support.small import DIMENSION, blocks_file

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
PAIRS = [("upper_bottom", "lower_top", None)]
LU = {"snes_rtol": "1e-12", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def files(folder, cell, degree=1, order=1):
    """A mesh, and the same converted. *Collective.*"""
    path = folder / "blocks.msh"

    def make():
        blocks_file(path, cell, 2, 3, order=degree)
        convert(path, order=order)

    on_root(WORLD, make)
    return path, path.with_suffix(".h5")


def same_parts(one, other):
    """Whether two parts of a mesh are the same, array by array."""
    for a, b in zip(one.blocks, other.blocks, strict=True):
        assert (a.cell, a.body) == (b.cell, b.body)
        for name in ("ids", "nodes", "components"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("points", "file_nodes"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert set(one.facet_groups) == set(other.facet_groups)
    for name, facets in one.facet_groups.items():
        for a, b in zip(facets, other.facet_groups[name], strict=True):
            assert a.block == b.block
            np.testing.assert_array_equal(a.cells, b.cells)
            np.testing.assert_array_equal(a.local, b.local)
    assert set(one.cell_groups) == set(other.cell_groups) and set(one.node_groups) == set(other.node_groups)
    for name, rows in one.cell_groups.items():
        for a, b in zip(rows, other.cell_groups[name], strict=True):
            np.testing.assert_array_equal(a, b)
    for name, nodes in one.node_groups.items():
        np.testing.assert_array_equal(nodes, other.node_groups[name])


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
@pytest.mark.parametrize("degree, order, asked", [(1, 1, 1), (1, 2, 2), (2, 1, 1), (2, 2, 2)])
def test_the_same_mesh_on_every_rank(shared_tmp, cell, degree, order, asked):
    """Cells, nodes, groups, components and their names, and the partition."""
    meshes = [
        load_mesh(WORLD, path, asked, ["lower", "upper"], PAIRS, lambda mesh: None)
        for path in files(shared_tmp, cell, degree, order)
    ]
    same_parts(*meshes)
    for name in ("dim", "degree", "curved", "n_nodes_total", "n_cells_total", "n_components", "component_names"):
        assert getattr(meshes[0], name) == getattr(meshes[1], name), name
    assert meshes[0].component_names == ["lower", "upper"]


@parallel
def test_degree_1_of_cells_completed_to_degree_2(shared_tmp):
    """The middle nodes are left in the file."""
    path, stored = files(shared_tmp, "hexahedron", 1, 2)
    meshes = [load_mesh(WORLD, p, 1, ["lower", "upper"], PAIRS, lambda mesh: None) for p in (path, stored)]
    same_parts(*meshes)
    assert meshes[1].degree == 1 and meshes[1].n_nodes_total > meshes[0].n_nodes_total


@parallel
@pytest.mark.parametrize("order", [1, 2])
def test_cells_of_two_types(shared_tmp, order):
    """A quadrilateral and two triangles, and their groups."""
    path = shared_tmp / "mesh.msh"

    def make():
        cells = [CELLS[0], (2, 2, (5, 6, 7)), (2, 2, (5, 7, 8))]
        path.write_text(mesh_text(elements=cells + FACETS))
        convert(path, order=order)

    on_root(WORLD, make)
    meshes = [
        load_mesh(WORLD, p, order, ["lower", "upper"], PAIRS, lambda mesh: None)
        for p in (path, path.with_suffix(".h5"))
    ]
    same_parts(*meshes)
    assert [WORLD.allreduce(len(b.nodes)) for b in meshes[0].blocks] == [1, 2]


@parallel
def test_no_rank_has_it_all(shared_tmp):
    """Every rank reads its share of cells and nodes."""
    _, path = files(shared_tmp, "hexahedron")
    piece = ConvertedMesh(WORLD, path, 1).piece
    for n, total in ((len(piece.ids), piece.n_cells_total), (len(piece.points), piece.n_nodes_total)):
        assert abs(n - total / WORLD.size) < 1 and WORLD.allreduce(n) == total
    numbers = np.concatenate(WORLD.allgather(piece.ids))
    np.testing.assert_array_equal(np.sort(numbers), np.arange(piece.n_cells_total))


def test_ranges_are_near_in_space(tmp_path):
    """Cells of a part of the file are together, and so are their nodes."""
    raw = read_mesh(two_blocks(tmp_path / "blocks.msh", 3, 6, 6))
    target, _ = convert(raw.path)
    with h5py.File(target) as file:
        points, cells = file["points"][:], file["blocks/0"][:]
    chosen = points[cells[: len(cells) // 8]].reshape(-1, 3)
    assert np.prod(np.ptp(chosen, axis=0)) < 0.5 * np.prod(np.ptp(points, axis=0))
    assert np.median(np.ptp(cells, axis=1)) < 0.3 * len(points)


@parallel
@pytest.mark.parametrize("cell, order", [("tetrahedron", 1), ("quadrilateral", 2)])
def test_runs_are_the_same(shared_tmp, cell, order):
    """Displacements of a contact problem, solved directly."""
    found = []
    for path in files(shared_tmp, cell, 1, order):
        scene = scene_of(path, cell, petsc=LU)
        scene.mesh.order = order
        simulation = Simulation(scene)
        assert simulation.run(None)
        space = simulation.problem.space
        u = np.zeros((space.numbering.n_total, space.dim))
        u[space.mesh.file_nodes[space.mesh_nodes]] = space.local.gather(simulation.stepper.u)
        found.append(WORLD.allreduce(u, op=MPI.SUM) / WORLD.allreduce(np.abs(u) > 0.0, op=MPI.SUM).clip(1))
        simulation.close()
    assert np.abs(found[0]).max() > 0.01
    np.testing.assert_allclose(found[1], found[0], atol=1e-10 * np.abs(found[0]).max(), rtol=0.0)


# -- what is wrong -------------------------------


def refused(path, order=1):
    """The message about a mesh, the same on all ranks. *Collective.*"""
    with pytest.raises(InputError) as caught:
        load_mesh(WORLD, path, order, ["lower", "upper"], PAIRS, lambda mesh: None)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{path}: found ") and "; allowed: " in message
    assert set(WORLD.allgather(message)) == {message}
    return message


def spoil(path, how):
    """Damage a converted mesh in some way."""
    if how in ("text", "half", "empty"):
        data = path.read_bytes()
        path.write_bytes({"text": b"solid ball\n", "half": data[: len(data) // 2], "empty": b""}[how])
        return
    with h5py.File(path, "r+") as file:
        if how == "other":
            del file.attrs["format"]
        elif how == "newer":
            file.attrs["version"] = 7
        elif how == "unfinished":
            del file.attrs["complete"]
        elif how == "lacking":
            # as files of earlier versions of the program have none
            del file.attrs["checksums"]
            del file["cells/components"]
        else:
            file["points"][0, 0] += 1e-3


@parallel
@pytest.mark.parametrize(
    "how, found",
    [
        ("text", "not HDF5"),
        ("half", "cut short"),
        ("empty", "not HDF5"),
        ("other", "another kind"),
        ("newer", "version 7 of the format; allowed: version 1"),
        ("unfinished", "cut short"),
        ("lacking", "damaged"),
        ("other points", "without its checksums"),
    ],
)
def test_damaged_files(shared_tmp, how, found):
    _, path = files(shared_tmp, "quadrilateral")
    on_root(WORLD, spoil, path, how)
    assert found in refused(path)


@parallel
def test_flipped_bits(shared_tmp):
    """Any bit of the file, in its numbers, in the tables of HDF5 and in the checksums."""
    _, path = files(shared_tmp, "triangle")
    whole = path.read_bytes()
    WORLD.Barrier()
    for place in [*np.random.default_rng(3).integers(0, len(whole), 50), *range(len(whole) - 44, len(whole), 4)]:
        changed = bytearray(whole)
        changed[place] ^= 1 << (place % 8)
        on_root(WORLD, path.write_bytes, changed)
        assert "damaged" in refused(path)
        WORLD.Barrier()


@parallel
def test_a_file_without_checksums(shared_tmp):
    """Earlier versions of the program wrote none."""
    _, path = files(shared_tmp, "quadrilateral")

    def strip():
        with h5py.File(path, "r+") as file:
            del file.attrs["checksums"]

    on_root(WORLD, strip)
    mesh = load_mesh(WORLD, path, 1, ["lower", "upper"], PAIRS, lambda mesh: None)
    assert WORLD.allreduce(sum(len(block.nodes) for block in mesh.blocks)) == mesh.n_cells_total


@parallel
def test_degree_2_of_a_file_of_degree_1(shared_tmp):
    _, path = files(shared_tmp, "triangle")
    assert "cells of degree 1" in (message := refused(path, 2)) and "convert --order 2" in message


def test_no_file(tmp_path):
    assert "no such file" in refused(tmp_path / "nothing.h5")


# a group of a node that belongs to no cell
LOST = mesh_text([*NODES, (3, 3)], CELLS + FACETS + [(15, 8, (9,))], {**NAMES, (0, 8): "tip"})
WRONG = {
    "lost": {"mesh": LOST, "scene": SCENE + '[output]\nprobes = ["tip"]\n'},
    "no body": {"scene": swapped('[[bodies]]\nregion = "upper"\nmaterial = "m"\n', "")},
    "two bodies": {"mesh": mesh_text(elements=[*CELLS, (3, 2, (1, 2, 3, 4), 1), *FACETS])},
    "inside": {"mesh": INNER},
    "common": {"mesh": mesh_text(elements=[*CELLS, *FACETS, (1, 4, (5, 6), 5)])},
    "unknown": {"scene": swapped('"upper_bottom"', '"upper_botom"')},
    "kind": {"scene": swapped('"lower_top"', '"lower"')},
    "empty": {"mesh": mesh_text(elements=CELLS + [f for f in FACETS if f[1] != 4])},
    "dimension": {"scene": swapped("[0.0, 0.0]", "[0.0, 0.0, 0.0]")},
    "axis": {
        "scene": swapped('file = "mesh.msh"', 'file = "mesh.msh"\nkinematics = "axisymmetric"'),
        "mesh": mesh_text([(x - 0.5, y) for x, y in NODES]),
    },
}


@parallel
@pytest.mark.parametrize("name", WRONG)
def test_scenes_that_do_not_fit(shared_tmp, name):
    """The same words as about the mesh that was converted, which alone takes groups by place."""
    scene, mesh = WRONG[name].get("scene", SCENE), WRONG[name].get("mesh", mesh_text())

    def lay():
        (shared_tmp / "mesh.msh").write_text(mesh)
        (shared_tmp / "scene.toml").write_text(scene)
        convert(shared_tmp / "mesh.msh")

    on_root(WORLD, lay)
    said = []
    for file in ("mesh.msh", "mesh.h5"):
        one = read_scene(shared_tmp / "scene.toml")
        one.mesh.file = Path(shared_tmp / file)
        with pytest.raises(InputError) as caught:
            read(one, WORLD, Options())
        said.append(str(caught.value).replace(file, "mesh"))
    assert said[0].partition("; or one of a table [[regions]]")[0] == said[1]


@parallel
def test_a_group_of_no_cell_that_no_scene_names(shared_tmp):
    """It is left out, with the same warning for both files."""

    def lay():
        (shared_tmp / "mesh.msh").write_text(LOST)
        (shared_tmp / "scene.toml").write_text(SCENE)
        convert(shared_tmp / "mesh.msh")

    on_root(WORLD, lay)
    for file in ("mesh.msh", "mesh.h5"):
        one = read_scene(shared_tmp / "scene.toml")
        one.mesh.file = Path(shared_tmp / file)
        log.forget_warnings()
        assert read(one, WORLD, Options()).n_nodes_total == 8
        said = f'{file}: left out: group "tip": node 9 at (3, 3, 0) belongs to no cell'
        assert WORLD.rank or said in log.warnings()[0]


# -- the command -------------------------------


@pytest.mark.slow
def test_command(tmp_path):
    """Convert beside the mesh, run from it; what is wrong with the command line."""
    folder = tmp_path / "case"
    lay_out(folder, Case([], scene=SCENE.replace("mesh.msh", "mesh.h5")))
    done = execute(folder, ["convert", "mesh.msh"])
    assert done.returncode == 0 and re.search(r"mesh\.h5.* 8 nodes.* 2 cells.*quadrilateral.*degree 1", done.stdout)
    assert (folder / "mesh.h5").is_file() and not list(folder.glob("*.part"))
    done = execute(folder, ["check", "scene.toml"], 2)
    assert done.returncode == 0 and "contact pair: 1 source facets" in done.stdout
    wrong = {
        ("convert",): ["no operand; allowed: a mesh file"],
        ("convert", "mesh.msh", "-o", "mesh.xdmf"): ["'mesh.xdmf'; allowed: a name that ends with .h5"],
        ("convert", "mesh.h5"): ["ends with .h5; allowed: the mesh that it was made from"],
        ("convert", "mesh.msh", "-o", "no/mesh.h5"): ["-o no/mesh.h5: found no such file or directory"],
        ("convert", "mesh.msh", "--order", "3"): [r"-order: found '3'; allowed: 1 \| 2"],
        ("convert", "nothing.msh"): ["nothing.msh: found no such file"],
    }
    answers = in_turn(tmp_path, [(str(folder), words) for words in wrong])
    for parts, (line, status) in zip(wrong.values(), answers, strict=True):
        assert status == [2]
        check_line(line, parts)
