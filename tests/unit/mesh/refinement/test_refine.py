"""Refinement: conforming meshes, groups, shapes, curved boundaries, fields, coarser meshes, any number of ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import ball_on_block, rings
from meshes.blocks import two_blocks
from pcontact.mesh.read import read_mesh
from pcontact.mesh.refinement.gather import gathered, halved_where
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.mesh.remesh import write_refined
from pcontact.runtime.petsc import MPI
from tests.support.refined import area, chosen, conforms, load, quality, volume

COMM = MPI.COMM_WORLD


@pytest.mark.parallel
@pytest.mark.parametrize("cell, order", [("triangle", 1), ("triangle", 2), ("tetrahedron", 1), ("tetrahedron", 2)])
def test_cells_conform_and_keep_groups(shared_tmp, cell, order):
    """Marked cells are cut, volume and areas of groups stay, facets have their cells, fields of the degree are kept."""
    dim = 2 if cell == "triangle" else 3
    path = make_mesh(two_blocks, shared_tmp / "a.msh", dim, 3, 2, cell)
    mesh = load(path, order)
    old = gathered(mesh, path)
    values = np.column_stack([mesh.points @ np.arange(1.0, dim + 1), (mesh.points[:, 0] - mesh.points[:, 1]) ** order])
    n = mesh.n_cells_total
    for seed in range(3):
        more = chosen(mesh, seed, 0.1, dim)
        marked = COMM.allreduce(int((more > 0).sum()))
        before = mesh
        mesh, (values,) = refine(mesh, more, (values,), Balance([("upper_bottom", "lower_top", None)]))
        assert mesh.n_cells_total >= before.n_cells_total + (2**dim - 1) * marked
    new = gathered(mesh, path)
    x = mesh.points
    expected = np.column_stack([x @ np.arange(1.0, dim + 1), (x[:, 0] - x[:, 1]) ** order])
    assert values == pytest.approx(expected, abs=1e-14)
    assert mesh.n_cells_total > 2 * n and volume(mesh) == pytest.approx(volume(load(path, order)), rel=1e-13)
    assert mesh.n_nodes_total == COMM.allreduce(int(mesh.file_nodes.max(initial=0)), op=MPI.MAX) + 1
    if COMM.rank == 0:
        assert conforms(new) == pytest.approx(conforms(old), rel=1e-13)
        assert set(new.facet_groups) == set(old.facet_groups)
        for name in old.facet_groups:
            assert area(new, *new.facet_groups[name]) == pytest.approx(area(old, *old.facet_groups[name]), rel=1e-13)
        for name, nodes in old.node_groups.items():
            members = new.points[new.node_groups[name]]
            assert np.array_equal(np.sort(members, axis=0), np.sort(old.points[nodes], axis=0))
        assert sum(len(rows) for rows in new.cell_groups.values()) == mesh.n_cells_total


@pytest.mark.parallel
@pytest.mark.parametrize("cell, order", [("triangle", 2), ("tetrahedron", 1)])
def test_any_number_of_ranks(shared_tmp, cell, order):
    """The same nodes, cells, groups and values, bit by bit, as on one rank."""
    path = make_mesh(two_blocks, shared_tmp / "a.msh", 2 if cell == "triangle" else 3, 3, 2, cell)
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        mesh = load(path, order, comm)
        field = np.sin(mesh.points)
        for seed, value in ((0, 3), (1, 4), (2, -2), (3, 1)):
            mesh, (field,) = refine(mesh, chosen(mesh, seed, 0.15 if value > 0 else 0.9, value), (field,))
        fields = np.full((mesh.n_nodes_total, mesh.dim), -np.inf)
        fields[mesh.file_nodes] = field
        comm.Allreduce(MPI.IN_PLACE, fields, op=MPI.MAX)
        found.append((gathered(mesh, path), fields))
    if COMM.rank == 0:
        (one, a), (other, b) = found
        assert np.array_equal(one.points, other.points)
        assert all(np.array_equal(p.nodes, q.nodes) for p, q in zip(one.blocks, other.blocks, strict=True))
        for name, (cells, local) in one.facet_groups.items():
            assert np.array_equal(cells, other.facet_groups[name][0])
            assert np.array_equal(local, other.facet_groups[name][1])
        assert len(b) > 200 and np.array_equal(a, b)


@pytest.mark.parametrize("cell, least", [("triangle", 0.5), ("tetrahedron", 0.35)])
def test_shapes_stay(shared_tmp, cell, least):
    """Random refinements, again and again: the worst cell is not much worse than that of the file."""
    if cell == "triangle":
        mesh = load(make_mesh(two_blocks, shared_tmp / "a.msh", 2, 3, 2, cell), 1)
    else:
        path = make_mesh(ball_on_block, shared_tmp / "ball.msh", h=0.5, symmetry="quarter")
        mesh = load(path, 1, regions=("ball", "block"))
    first = quality(mesh)
    for seed in range(15):
        mesh, _ = refine(mesh, chosen(mesh, seed, 0.002 if cell == "tetrahedron" else 0.05, 1))
    assert quality(mesh) > least * first


@pytest.mark.parallel
def test_cells_come_back(shared_tmp):
    """What no wish needs fine is coarse again: the mesh of the file, with values of its nodes; and half of the way."""
    base = load(make_mesh(two_blocks, shared_tmp / "a.msh", 3, 3, 2, "tetrahedron"), 1)
    field = np.cos(base.points[:, :1])
    level = [base]
    for _ in range(3):
        mesh, (field,) = refine(level[-1], np.ones(sum(len(b.nodes) for b in level[-1].blocks), int), (field,))
        level.append(mesh)
    back, (values,) = refine(mesh, -mesh.origin.level, (field,))
    assert back.n_cells_total == base.n_cells_total and back.n_nodes_total == base.n_nodes_total
    assert np.array_equal(values[:, 0], np.cos(back.points[:, 0]))
    again, _ = refine(mesh, np.where(mesh.origin.level == 3, -1, 0))
    assert base.n_cells_total < again.n_cells_total < mesh.n_cells_total


@pytest.mark.parallel
def test_curved_cells_keep_their_shape(shared_tmp):
    """Rings of degree 2: the volume is that of the curved cells of the file, and new nodes lie on these."""
    path = make_mesh(rings, shared_tmp / "rings.msh", order=2, cell="triangle")
    mesh = load(path, 2, regions=("inner", "outer"))
    first = volume(mesh)
    new, _ = refine(mesh, chosen(mesh, 0, 0.3, 4))
    assert new.curved and volume(new) == pytest.approx(first, rel=1e-12)


@pytest.mark.parallel
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_regular_refinement(shared_tmp, cell, order):
    """Quadrilaterals and hexahedra: one that is to be smaller halves all, on any number of ranks alike, groups too."""
    dim = 2 if cell == "quadrilateral" else 3
    path, found = make_mesh(two_blocks, shared_tmp / "a.msh", dim, 3, 2, cell), []
    for comm in (COMM, MPI.COMM_SELF):
        mesh = first = load(path, order, comm)
        old, field = gathered(first, path), mesh.points ** order
        for _ in range(2):
            more = np.where(np.concatenate([block.ids for block in mesh.blocks]) == 3, 1, 0)
            mesh, (field,) = refine(mesh, more, (field,))
        assert mesh.n_cells_total == 4**dim * first.n_cells_total
        assert field == pytest.approx(mesh.points**order, abs=1e-14)
        assert volume(mesh) == pytest.approx(volume(first), rel=1e-13)
        found.append(gathered(mesh, path))
        same, _ = refine(mesh, np.zeros(sum(len(b.nodes) for b in mesh.blocks)), (field,))
        assert same is mesh
    if COMM.rank == 0:
        one, other = found
        assert np.array_equal(one.points, other.points)
        assert all(np.array_equal(p.nodes, q.nodes) for p, q in zip(one.blocks, other.blocks, strict=True))
        assert conforms(one) == pytest.approx(conforms(old), rel=1e-13)
        for name in old.facet_groups:
            assert len(one.facet_groups[name][0]) == 4 ** (dim - 1) * len(old.facet_groups[name][0])
            assert area(one, *one.facet_groups[name]) == pytest.approx(area(old, *old.facet_groups[name]), rel=1e-13)
            assert np.array_equal(one.facet_groups[name][0], other.facet_groups[name][0])
        assert {n: len(g) for n, g in one.node_groups.items()} == {n: len(g) for n, g in old.node_groups.items()}


@pytest.mark.parallel
def test_regular_refinement_of_curved_cells(shared_tmp):
    """Rings of quadrilaterals of degree 2 keep their area."""
    path = make_mesh(rings, shared_tmp / "rings.msh", order=2)
    mesh = load(path, 2, regions=("inner", "outer"))
    first = volume(mesh)
    new, _ = refine(mesh, np.ones(sum(len(block.nodes) for block in mesh.blocks)))
    assert new.curved and volume(new) == pytest.approx(first, rel=1e-12)


def test_files_of_marked_cells(tmp_path):
    """Groups of an unstructured mesh in space go through a file; marked facets are those of a contact surface."""
    raw = read_mesh(ball_on_block(tmp_path / "ball.msh", h=0.3, symmetry="quarter"))
    near = np.zeros(raw.offsets[-1], dtype=bool)
    near[raw.facet_groups["ball_skin"][0]] = True
    write_refined(tmp_path / "fine.msh", halved_where(MPI.COMM_SELF, raw, near, tmp_path))
    new = read_mesh(tmp_path / "fine.msh")
    for kind in ("cell_groups", "facet_groups", "node_groups"):
        assert set(getattr(new, kind)) == set(getattr(raw, kind))
    assert area(new, *new.facet_groups["ball_skin"]) == pytest.approx(area(raw, *raw.facet_groups["ball_skin"]))
    assert len(new.facet_groups["ball_skin"][0]) > 3 * len(raw.facet_groups["ball_skin"][0])
    assert new.offsets[-1] >= raw.offsets[-1] + 7 * near.sum()


def test_files_of_curved_cells(tmp_path):
    """New nodes lie on the parabolas of the old mesh, not on the circle: 4 cells in a quarter are 1e-4 off."""
    raw = read_mesh(rings(tmp_path / "rings.msh", n=4, cell="triangle", order=2))
    marked = np.arange(raw.offsets[-1]) % 3 == 0
    write_refined(tmp_path / "fine.msh", halved_where(MPI.COMM_SELF, raw, marked, tmp_path))
    new = read_mesh(tmp_path / "fine.msh")
    assert {block.degree for block in new.blocks} == {2} and set(new.facet_groups) == set(raw.facet_groups)
    cells, local = new.facet_groups["outer_skin"]
    assert len(cells) > len(raw.facet_groups["outer_skin"][0])
    nodes = np.unique(np.concatenate([new.blocks[0].nodes[cells[local == k]][:, [k, (k + 1) % 3, 3 + k]]
                                      for k in range(3)]))  # fmt: skip
    assert np.linalg.norm(new.points[nodes], axis=1) == pytest.approx(1.0, abs=5e-4)
