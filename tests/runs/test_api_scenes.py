"""Scenes made in Python, meshes from memory, results saved and loaded, parameter studies; and what a checker says."""

import json
import subprocess
import sys

import meshio
import numpy as np
import pytest

import pcontact as pc
from pcontact.mesh.distribute import load_mesh
from pcontact.runtime.petsc import MPI, PETSc
from tests.support.commands import ROOT
from tests.support.small import blocks_file

WORLD = MPI.COMM_WORLD


def block(cells, corner, size):
    """Points and quadrilaterals of a block, in rows from below."""
    (nx, ny), (x, y), (width, height) = cells, corner, size
    across, up = np.meshgrid(np.linspace(x, x + width, nx + 1), np.linspace(y, y + height, ny + 1))
    first = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)).ravel()
    return np.column_stack([across.ravel(), up.ravel()]), first[:, None] + [0, 1, nx + 2, nx + 1]


def two_blocks():
    """Points, cells, groups and facets of a block upon a wider one."""
    (low, below), (high, above) = block((8, 4), (0, 0), (2, 1)), block((5, 4), (0.5, 1), (1, 1))
    n, row = len(low), np.arange(5)[:, None] + [0, 1]
    ground = n - 9 + np.arange(8)[:, None] + [0, 1]
    facets = {"bottom": lambda x: x[:, 1] == 0, "top": lambda x: x[:, 1] == 2, "skin": n + row, "ground": ground}
    groups = {"lower": np.arange(len(below)), "upper": np.arange(len(below), len(below) + len(above))}
    return np.concatenate([low, high]), np.concatenate([below, above + n]), groups, facets


def scene(mesh=None):
    points, cells, groups, facets = two_blocks()
    return pc.Scene(
        mesh=pc.mesh_from((points, {"quad": cells}), groups, facets) if mesh is None else mesh,
        materials={"steel": {"E": 210e3, "nu": 0.3}},
        bodies={"lower": "steel", "upper": "steel"},
        contacts=[pc.Contact("skin", "ground", friction=0.3)],
        displacements={"bottom": [0, 0], "top": [0, -0.001]},
        steps=2,
    )


@pytest.fixture(scope="module")
def done():
    return pc.run(scene())


@pytest.mark.parallel
@pytest.mark.parametrize("faces", [True, False])
def test_a_scene_on_a_dmplex(shared_tmp, faces):
    """PETSc's mesh, distributed, with the groups of gmsh's file as labels; and the mesh of a run, which has no faces:
    the same numbers as those of the file."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, "quadrilateral", 5, 4)
    WORLD.Barrier()

    def force(mesh, top="upper_top", **tables):
        made = pc.Scene(mesh, {"steel": {"E": 210e3, "nu": 0.3}}, {"lower": "steel", "upper": "steel"},
                        [pc.Contact("upper_bottom", "lower_top", friction=0.3)],
                        {"lower_bottom": [0, 0], top: [1e-4, -0.001]},
                        petsc={"snes_rtol": 1e-12, "ksp_rtol": 1e-12}, **tables)  # fmt: skip
        done = pc.run(made, comm=WORLD)
        assert done.converged
        return done.contact["upper_bottom-lower_top"].force

    wanted, options, there = force(path), PETSc.Options(), {}
    if faces:
        options.setValue("dm_plex_gmsh_use_regions", True)
        dm = PETSc.DMPlex().createFromFile(str(path), interpolate=True, comm=WORLD)
        options.delValue("dm_plex_gmsh_use_regions")
        dm.distribute()
        # groups by place are those of all ranks together
        there = {"regions": [{"name": "lid", "kind": "facets", "where": "y == 2"}], "top": "lid"}
    else:
        dm = load_mesh(WORLD, path, 1, ["lower", "upper"], [], lambda raw: None).dm
    np.testing.assert_allclose(force(dm, **there), wanted, rtol=1e-8)


def test_a_scene_from_arrays_is_that_of_a_file(done, tmp_path):
    """The same mesh as meshio's and pyvista's, and the same scene in TOML, give the same numbers."""
    assert done.converged and len(done.steps) == 2
    contact = done.contact["skin-ground"]
    assert contact.force[1] == pytest.approx(-np.sum(contact.pressure * contact.weight), rel=1e-3)
    assert contact.force[1] == done.history["contacts.skin-ground.force_y"][-1]
    assert set(np.unique(contact.status)) <= {0, 1, 2} and contact.gap.shape == contact.pressure.shape
    points, cells, groups, facets = two_blocks()
    other = meshio.Mesh(points, [("quad", cells)], cell_sets={name: [rows] for name, rows in groups.items()})
    again = pc.run(scene(pc.mesh_from(other, facets=facets)))
    np.testing.assert_allclose(again.displacement, done.displacement, atol=1e-15)
    path = pc.mesh_from(other, facets=facets).file
    (tmp_path / "scene.toml").write_text(f"""
        [mesh]
        file = "{path}"
        [materials.steel]
        E = 210e3
        nu = 0.3
        [[bodies]]
        region = "lower"
        material = "steel"
        [[bodies]]
        region = "upper"
        material = "steel"
        [[contacts]]
        source = "skin"
        target = "ground"
        friction = 0.3
        [[displacements]]
        region = "bottom"
        value = [0, 0]
        [[displacements]]
        region = "top"
        value = [0, -0.001]
        [steps]
        count = 2
    """)
    read = pc.run(tmp_path / "scene.toml")
    np.testing.assert_allclose(read.displacement, done.displacement, atol=1e-15)
    assert isinstance(pc.read(tmp_path / "scene.toml"), pc.Scene)


@pytest.mark.parametrize("name", ["m.med", "m.vtu", "m.msh"])
def test_a_file_of_any_format_with_further_groups(done, tmp_path, name):
    """Groups of the file stay where its format has some; others are added by numbers and places."""
    points, cells, groups, facets = two_blocks()
    own = name == "m.msh"
    tags = {"gmsh:physical": [np.where(np.arange(len(cells)) < len(groups["lower"]), 1, 2)]} if own else {}
    tags |= {"gmsh:geometrical": tags["gmsh:physical"]} if own else {}
    names = {"lower": np.array([1, 2]), "upper": np.array([2, 2])} if own else {}
    mesh = meshio.Mesh(points, [("quad", cells)], cell_data=tags, field_data=names)
    meshio.write(tmp_path / name, mesh, **({"file_format": "gmsh22", "binary": True} if own else {}))
    again = pc.run(scene(pc.mesh_from(tmp_path / name, {} if own else groups, facets)))
    np.testing.assert_allclose(again.displacement, done.displacement, atol=1e-15)


def test_a_mesh_of_pyvista_and_the_model_of_gmsh(done):
    pyvista, gmsh = pytest.importorskip("pyvista"), pytest.importorskip("gmsh")
    points, cells, groups, facets = two_blocks()
    rows = np.column_stack([np.full(len(cells), 4), cells]).ravel()
    grid = pyvista.UnstructuredGrid(rows, np.full(len(cells), 9), np.pad(points, ((0, 0), (0, 1))))
    again = pc.run(scene(pc.mesh_from(grid, groups, facets)))
    np.testing.assert_allclose(again.displacement, done.displacement, atol=1e-9)  # pyvista may have single precision
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [1], name="body")
        gmsh.model.mesh.generate(2)
        spec = pc.mesh_from(gmsh, order=1)
    finally:
        gmsh.finalize()
    assert spec.order == 1 and meshio.read(spec.file).cells_dict["triangle"].shape[1] == 3


def test_what_is_saved_is_loaded(done, tmp_path):
    done.save(tmp_path)
    loaded = pc.load(tmp_path)
    assert loaded.report == json.loads(json.dumps(done.report)) and loaded.converged
    assert loaded.report["format"] == 2
    np.testing.assert_array_equal(loaded.history["time"], done.history["time"])
    whole = done.gather()
    np.testing.assert_array_equal(loaded.displacement, whole.displacement)
    one, other = (run.contact["skin-ground"] for run in (loaded, done))
    np.testing.assert_array_equal(np.sort(one.pressure), np.sort(other.pressure))
    np.testing.assert_array_equal(one.force, other.force)
    assert (tmp_path / "history.csv").read_text().startswith("time,newton")
    with pytest.raises(pc.InputError, match="found no report.json"):
        pc.load(tmp_path / "nowhere")


def test_pictures_and_grids(done, tmp_path):
    pytest.importorskip("pyvista")
    grid = done.to_pyvista()
    assert grid.n_cells == 52 and grid["displacement"].shape == (75, 3) and "equivalent_stress" in grid.cell_data
    assert done.plot("equivalent_stress", size=(300, 200))._repr_png_()[:4] == b"\x89PNG"
    assert done.plot(output=tmp_path / "a.png", size=(300, 200)) == tmp_path / "a.png"


def test_a_study_goes_on_where_a_case_fails():
    rows = pc.study(scene(), {"contacts[0].friction": [0.0, -0.1, 0.3], "steps.count": [1]})
    assert rows["converged"].tolist() == [True, False, True]
    assert "friction: found a number -0.1" in rows.rows[1]["error"]
    assert np.isnan(rows["contacts.skin-ground.force_y"][1]) and rows["contacts.skin-ground.force_y"][2] < -100
    named = pc.study(scene(), {"materials.steel.E": [210e3, 420e3]})
    force = named["contacts.skin-ground.force_y"]
    assert force[1] == pytest.approx(2 * force[0], rel=1e-6)
    with pytest.raises(pc.InputError, match=r"no 'contacts\[0\].fricton'"):
        pc.study(scene(), {"contacts[0].fricton": [0]})
    with pytest.raises(pc.InputError, match=r"contacts\[0\].friction: found 0.1; allowed: a list of values"):
        pc.study(scene(), {"contacts[0].friction": 0.1})
    with pytest.raises(KeyError, match="there are steps.count"):
        rows = pc.study(scene(), {"steps.count": []})
        pc.Study([{"steps.count": 1}])["force"]


@pytest.mark.slow
def test_cases_in_processes_of_their_own_are_the_same():
    values = {"contacts[0].friction": [0.0, 0.3]}
    here, apart = pc.study(scene(), values), pc.study(scene(), values, jobs=2)
    assert apart["converged"].all()
    np.testing.assert_allclose(apart["contacts.skin-ground.force_y"], here["contacts.skin-ground.force_y"], rtol=1e-9)
    ranks = pc.study(scene(), {"contacts[0].friction": [0.3]}, ranks=2)
    assert ranks["error"].tolist() == [""]
    assert ranks["contacts.skin-ground.force_y"][0] == pytest.approx(here["contacts.skin-ground.force_y"][1], rel=1e-9)


def test_what_is_no_scene_is_told_in_one_line():
    with pytest.raises(pc.InputError, match=r"contacts\.frction: found an unknown key, the nearest known key is"):
        pc.Scene(mesh="a.msh", materials={}, bodies={}, contacts=[{"source": "a", "frction": 1}])
    with pytest.raises(pc.InputError, match="unknown table 'contact'"):
        pc.Scene(mesh="a.msh", materials={}, bodies={}, contact=[])
    with pytest.raises(pc.InputError, match="mesh: found int; allowed: a file, meshio.Mesh"):
        pc.mesh_from(3, {"a": "all"})
    points, cells, _, _ = two_blocks()
    with pytest.raises(pc.InputError, match="facets 'far': found no facet"):
        pc.mesh_from((points, {"quad": cells}), facets={"far": lambda x: x[:, 1] > 9})
    wrong = scene()
    wrong.bodies[0].region = "no"
    with pytest.raises(pc.InputError, match="found 'no', no such group in the mesh in memory, "):
        pc.run(wrong)


@pytest.mark.parallel
def test_saved_on_several_ranks(shared_tmp):
    """Each rank makes the scene; rank 0 reads its mesh."""
    run = pc.run(scene())
    run.save(shared_tmp)
    loaded = pc.load(shared_tmp)
    whole = run.gather(everywhere=True)
    np.testing.assert_array_equal(loaded.displacement, whole.displacement)
    assert loaded.contact["skin-ground"].force[1] == pytest.approx(-142.0, rel=0.05)


@pytest.mark.slow
def test_the_api_is_typed(tmp_path):
    """The API itself, and a program of a user who gets a type wrong."""
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    program.write_text(
        "import pcontact as pc\n"
        "pc.Contact('a', 'b', friction=0.3)\n"
        "run: pc.Run = pc.run('scene.toml')\n"
        "run.displacement.max()\n"
        "run.converged + 'x'\n"
    )
    command = [sys.executable, "-m", "mypy", "--no-incremental", "pcontact/api", str(program)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.count("error:") == 1 and "program.py:5: error" in done.stdout, done.stdout
