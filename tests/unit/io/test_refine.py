"""Refinement: conforming meshes with their groups, sizes, and the command from a run's estimate to a mesh."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes.blocks import one_block
from pcontact.io.refine import at_vertices, largest_contributions, new_sizes, read_estimate, refine_run
from pcontact.mesh.raw import facet_vertices
from pcontact.mesh.read import read_mesh
from pcontact.mesh.remesh import write_refined
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from pcontact.usage import parse


def test_marks():
    estimates = np.array([1.0, 4.0, 2.0, 0.0])
    assert largest_contributions(estimates, 0.5).tolist() == [False, True, False, False]
    assert largest_contributions(estimates, 0.8).tolist() == [False, True, True, False]
    assert largest_contributions(estimates, 1.0).tolist() == [True, True, True, False]
    assert not largest_contributions(np.zeros(3), 0.5).any()


def test_sizes():
    """Equal estimates: all cells shrink alike, with the rate of the degree; else the larger one shrinks more."""
    sizes, predicted = new_sizes(np.ones(10), np.full(10, 0.1), 2, 2, 0.25)
    assert sizes == pytest.approx(0.05, rel=1e-6) and predicted == pytest.approx(0.25, rel=1e-6)
    estimates = np.array([1.0, 0.5])
    sizes, predicted = new_sizes(estimates, np.ones(2), 1, 2, 0.6)
    assert sizes[0] / sizes[1] == pytest.approx(4.0 ** (-1.0 / 4.0), rel=1e-6)
    assert predicted == pytest.approx(0.6, rel=1e-6)
    corners = at_vertices(3, [np.array([[0, 1], [1, 2]])], [np.array([1.0, 4.0])])
    assert corners == pytest.approx([1.0, 2.0, 4.0])


def plate(path, order=1, **output):
    """A plate that is pulled on half of its top: singular where the load ends."""
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": Material(10.0, 0.3)},
        bodies=[Body("block", "m")],
        displacements=[Displacement("bottom", [0.0, 0.0])],
        loads=[Load("right", traction=[0.0, 0.1])],
        output=Output(estimate=True, **output),
    )


def solve(scene, directory):
    simulation = Simulation(scene)
    try:
        assert simulation.run(directory)
        return simulation.error_estimate.last
    finally:
        simulation.close()


@pytest.mark.parallel
def test_command(shared_tmp):
    """Refined after its estimate, a mesh has a smaller error."""
    path = make_mesh(one_block, shared_tmp / "plate.msh", 2, 6, "triangle")
    first = solve(plate(path), shared_tmp / "first")
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        raw, estimates, degree = read_estimate(shared_tmp / "first")
        assert degree == 1
        assert np.sqrt(np.sum(estimates**2)) == pytest.approx(first["absolute"], rel=1e-6)
    said = refine_run(shared_tmp / "first", {"part": "0.6"}, comm)
    assert comm.rank or "refined.msh" in said
    comm.barrier()
    new = shared_tmp / "first" / "refined.msh"
    second = solve(plate(new), shared_tmp / "second")
    assert second["absolute"] < 0.75 * first["absolute"]


def test_quadrilaterals_are_divided(tmp_path, monkeypatch):
    """Triangles where the estimate is large, and the groups of the file; without the option all cells are halved. gmsh
    is not needed."""
    first = solve(plate(one_block(tmp_path / "plate.msh", 2, 6, "quadrilateral"), 2), tmp_path / "first")
    monkeypatch.setattr("pcontact.mesh.remesh.gmsh", None)
    refine_run(tmp_path / "first", {"part": "0.6", "divide": "true"})
    raw = read_mesh(tmp_path / "first" / "refined.msh")
    assert [block.cell for block in raw.blocks] == ["triangle"] and 72 < raw.offsets[-1] < 144
    second = solve(plate(tmp_path / "first" / "refined.msh", 2), tmp_path / "second")
    assert second["absolute"] < 0.97 * first["absolute"]
    refine_run(tmp_path / "first", {"part": "0.6"})
    assert read_mesh(tmp_path / "first" / "refined.msh").offsets[-1] == 144


@pytest.mark.parametrize("cell, order", [("triangle", 2), ("hexahedron", 1), ("tetrahedron", 2), ("quadrilateral", 2)])
def test_what_is_written_is_read_again(tmp_path, cell, order):
    """Cells, facets, edges and nodes of groups, by their places."""
    dim = 3 if cell in ("hexahedron", "tetrahedron") else 2
    raw = read_mesh(one_block(tmp_path / "box.msh", dim, 2, cell, order=order))
    corner = np.flatnonzero((raw.points == raw.points.min(axis=0)).all(axis=1))
    ends = raw.blocks[0].vertices[:1, :2]
    edges = {"edge": ends} if dim == 3 else {}
    raw = replace(raw, node_groups={"corner": corner, **{name: np.unique(ends) for name in edges}}, edge_groups=edges)
    write_refined(tmp_path / "again.msh", raw)
    again = read_mesh(tmp_path / "again.msh")

    def placed(one):
        facets = {name: [one.points[nodes].mean(axis=1) for _, nodes in facet_vertices(one, *rows)]
                  for name, rows in one.facet_groups.items()}  # fmt: skip
        middles = np.concatenate([one.points[block.nodes].mean(axis=1) for block in one.blocks])
        cells = {name: [middles[rows]] for name, rows in one.cell_groups.items()}
        nodes = {name: [one.points[rows]] for name, rows in one.node_groups.items()}
        return {(kind, name): np.array(sorted(np.round(np.concatenate(x), 9).tolist()))
                for kind, some in (("f", facets), ("c", cells), ("n", nodes)) for name, x in some.items()}  # fmt: skip

    there, here = placed(raw), placed(again)
    assert there.keys() == here.keys() and ("n", "corner") in here
    for key in there.keys() - {("n", "edge")}:
        np.testing.assert_allclose(here[key], there[key], atol=1e-12)
    # with the node in its middle
    assert dim == 2 or len(here["n", "edge"]) == order + 1


def test_geometry(tmp_path):
    """gmsh meshes a geometry after the sizes; the groups are those of the file."""
    script = """SetFactory("OpenCASCADE"); Rectangle(1) = {0, 0, 0, 1, 1};
    Physical Surface("block") = {1}; Physical Curve("bottom") = {1}; Physical Curve("right") = {2};
    Physical Curve("top") = {3}; Physical Curve("left") = {4}; Mesh.MeshSizeMax = 0.25;\n"""
    (tmp_path / "plate.geo").write_text(script)
    code = f"""import gmsh; gmsh.initialize(); gmsh.option.setNumber("General.Terminal", 0)
gmsh.open({str(tmp_path / "plate.geo")!r}); gmsh.model.mesh.generate(2); gmsh.write({str(tmp_path / "plate.msh")!r})"""
    subprocess.run([sys.executable, "-c", code], check=True)
    first = solve(plate(tmp_path / "plate.msh"), tmp_path / "first")
    said = refine_run(tmp_path / "first", {"geometry": str(tmp_path / "plate.geo"), "error": "0.5"})
    assert (tmp_path / "first" / "refined_size.pos").exists() and "error expected 0.5 " in said
    second = solve(plate(tmp_path / "first" / "refined.msh"), tmp_path / "second")
    assert second["absolute"] == pytest.approx(0.5 * first["absolute"], rel=0.2)
    raw = read_mesh(tmp_path / "first" / "refined.msh")
    assert set(raw.facet_groups) == {"bottom", "right", "top", "left"}
    (tmp_path / "other.geo").write_text(script.replace('Physical Curve("right") = {2};', ""))
    with pytest.raises(InputError, match="groups right"):
        refine_run(tmp_path / "first", {"geometry": str(tmp_path / "other.geo")})


def test_messages(tmp_path):
    path = one_block(tmp_path / "plate.msh", 2, 2, "triangle")
    solve(plate(path), tmp_path / "run")
    scene = plate(path)
    scene.output.estimate = False
    simulation = Simulation(scene)
    simulation.run(tmp_path / "plain")
    simulation.close()
    with pytest.raises(InputError, match="estimate = true"):
        refine_run(tmp_path / "plain", {})
    for options, words in (
        ({"part": "2"}, "-part: found '2'"),
        ({"prt": "1"}, "-prt: no such option.*nearest is -part"),
        ({"o": "a.vtk"}, "-o: found 'a.vtk'"),
        ({"error": "0.5"}, "-error without -geometry"),
        ({"part": "0.5", "geometry": "x.geo"}, "-part with -geometry"),
        ({"geometry": "x.geo"}, "-geometry: found no file"),
        ({"geometry": str(path)}, "-geometry: found .*plate.msh"),
        ({"step": "7"}, "no step 7"),
    ):
        with pytest.raises(InputError, match=words):
            refine_run(tmp_path / "run", options)
    one_block(path, 2, 3, "triangle")
    with pytest.raises(InputError, match="another mesh"):
        refine_run(tmp_path / "run", {})
    assert parse(["refine", "DIR", "-part", "0.3"]) == ("refine", "DIR", {"part": "0.3"})
