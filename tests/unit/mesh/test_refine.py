"""Refinement: conforming meshes with their groups, sizes, and the command from a run's estimate to a mesh."""

import subprocess
import sys

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import ball_on_block, rings
from meshes.blocks import one_block, two_blocks
from pcontact.cli import parse
from pcontact.estimate.size import at_vertices, largest_contributions, new_sizes
from pcontact.io.refine import read_estimate, refine_run
from pcontact.mesh.groups import facet_multiplicity, facet_vertices
from pcontact.mesh.reader import read_mesh
from pcontact.mesh.refine import as_raw, refine
from pcontact.mesh.remesh import write_refined
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation


def volumes(raw):
    """Of the straight cells, (n,)."""
    parts = []
    for block in raw.blocks:
        x = raw.points[block.vertices]
        parts.append(np.linalg.det(x[:, 1:] - x[:, :1]))
    return np.concatenate(parts)


def areas(raw, name):
    """Sum of the areas of a group's straight facets."""
    total = 0.0
    for _, vertices in facet_vertices(raw, *raw.facet_groups[name]):
        x = raw.points[vertices]
        edges = x[:, 1:] - x[:, :1]
        gram = np.einsum("fij,fkj->fik", edges, edges)
        total += float(np.sqrt(np.linalg.det(gram)).sum())
    return total


def all_facets(raw):
    """Number of facets that one cell has alone, counted over all cells; none may have more than two."""
    n_facets = raw.dim + 1
    cells = np.repeat(np.arange(raw.offsets[-1]), n_facets)
    count = facet_multiplicity(raw, cells, np.tile(np.arange(n_facets), raw.offsets[-1]))
    assert count.max() <= 2
    return int((count == 1).sum())


@pytest.mark.parametrize("dim, cell", [(2, "triangle"), (3, "tetrahedron")])
@pytest.mark.parametrize("part", [0.05, 0.4, 1.0])
def test_refine(tmp_path, dim, cell, part):
    """Volume, areas and names of groups stay, cells conform, marked ones are cut, angles do not degenerate."""
    raw = read_mesh(two_blocks(tmp_path / "a.msh", dim, 3, 2, cell))
    rng = np.random.default_rng(3)
    for _ in range(1 if part == 1.0 else 2 if dim == 3 else 4):
        n = raw.offsets[-1]
        marked = rng.uniform(size=n) < part
        fine = refine(raw, marked)
        write_refined(tmp_path / "b.msh", as_raw(fine, tmp_path))
        new = read_mesh(tmp_path / "b.msh")
        assert volumes(new).min() > 0.0
        assert volumes(new).sum() == pytest.approx(volumes(raw).sum(), rel=1e-12)
        assert set(new.cell_groups) == set(raw.cell_groups) and set(new.node_groups) == set(raw.node_groups)
        assert set(new.facet_groups) == set(raw.facet_groups)
        for name in raw.facet_groups:
            assert areas(new, name) == pytest.approx(areas(raw, name), rel=1e-12)
        children = np.bincount(fine.parent, minlength=n)
        assert children[marked].min(initial=99) >= 2**dim and children.min() >= 1
        assert fine.place.sum(axis=2) == pytest.approx(1.0)
        # hanging nodes would leave facets that one cell has alone inside the bodies
        outer = all_facets(new)
        x = fine.points[fine.nodes[:, : dim + 1]]
        corners = raw.points[np.concatenate([b.vertices for b in raw.blocks])][fine.parent]
        assert np.abs(np.einsum("cva,cad->cvd", fine.place, corners) - x).max() < 1e-14
        box = np.concatenate([b.vertices for b in new.blocks])
        longest = np.max([np.linalg.norm(new.points[box[:, i]] - new.points[box[:, j]], axis=1)
                          for i in range(dim + 1) for j in range(i)], axis=0)  # fmt: skip
        assert (volumes(new) / longest**dim).min() > 0.3 * (0.35 if dim == 2 else 0.06)
        assert outer == outside(new)
        raw = new


def outside(raw):
    """Facets whose middles lie on the faces of the two boxes: those that one cell has alone, if the mesh conforms."""
    cells = np.concatenate([b.vertices for b in raw.blocks])
    local = [list(f) for f in {2: [(0, 1), (1, 2), (2, 0)], 3: [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]}[raw.dim]]
    body = np.concatenate([np.full(len(b.nodes), 0) for b in raw.blocks])
    body[raw.cell_groups["upper"]] = 1
    count = 0
    for number in (0, 1):
        x = raw.points[cells[body == number]]
        low, high = x.min(axis=(0, 1)), x.max(axis=(0, 1))
        for facet in local:
            y = x[:, facet]
            for side in (low, high):
                count += int((np.abs(y - side).max(axis=1) < 1e-9).any(axis=1).sum())
    return count


def test_curved(tmp_path):
    """Cells of degree 2 are parts of those they come from: area and circles stay."""
    raw = read_mesh(rings(tmp_path / "rings.msh", n=4, cell="triangle", order=2))
    fine = refine(raw, np.arange(raw.offsets[-1]) % 3 == 0)
    write_refined(tmp_path / "fine.msh", as_raw(fine, tmp_path))
    new = read_mesh(tmp_path / "fine.msh")
    assert {b.degree for b in new.blocks} == {2} and set(new.facet_groups) == set(raw.facet_groups)
    cells, local = new.facet_groups["outer_skin"]
    assert len(cells) > len(raw.facet_groups["outer_skin"][0])
    nodes = np.unique(fine.groups[1][0][fine.groups[1][1]["outer_skin"]])
    # on the parabolas of the old mesh, not on the circle: 4 cells in a quarter are 1e-4 off
    assert np.linalg.norm(fine.points[nodes], axis=1) == pytest.approx(1.0, abs=5e-4)


def test_no_simplices(tmp_path):
    raw = read_mesh(one_block(tmp_path / "a.msh", 2, 2, "quadrilateral"))
    with pytest.raises(InputError, match="quadrilateral.*-geometry"):
        refine(raw, np.ones(4, dtype=bool))


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


def test_tetrahedra_of_a_ball(tmp_path):
    """Groups of an unstructured mesh in space; the surfaces of contact stay those of their bodies."""
    raw = read_mesh(ball_on_block(tmp_path / "ball.msh", h=0.15, symmetry="quarter"))
    n = raw.offsets[-1]
    near = np.zeros(n, dtype=bool)
    near[raw.facet_groups["ball_skin"][0]] = True
    write_refined(tmp_path / "fine.msh", as_raw(refine(raw, near), tmp_path))
    new = read_mesh(tmp_path / "fine.msh")
    assert set(new.facet_groups) == set(raw.facet_groups) and set(new.node_groups) == set(raw.node_groups)
    assert volumes(new).sum() == pytest.approx(volumes(raw).sum(), rel=1e-12)
    assert len(new.facet_groups["ball_skin"][0]) >= 4 * len(raw.facet_groups["ball_skin"][0])
    assert set(new.cell_groups) == set(raw.cell_groups)
