"""Meshes of any cells divided into triangles and tetrahedra: volume, conformity, groups, fields, shapes, ranks."""

from functools import partial

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import rings
from meshes.blocks import two_blocks
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.mesh.refinement.gather import gathered
from pcontact.mesh.refinement.refine import refine
from pcontact.mesh.refinement.split import divisions, split
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from tests.support.refined import COMM, area, chosen, conforms, load, quality, volume
from tests.support.wedges import cut_mesh

MIXED = ("wedge", "hexahedron", "pyramid")


def mesh_of(folder, kinds, bend=None):
    if kinds == "quadrilateral":
        return make_mesh(two_blocks, folder / "quadrilaterals.msh", 2, 3, 2, kinds)
    path = make_mesh(two_blocks, folder / "hexahedra.msh", 3, 3, 2, "hexahedron")
    return on_root(COMM, partial(cut_mesh, path, folder / "mixed.msh", kinds, bend=bend)) or folder / "mixed.msh"


def bend(x):
    y = x.copy()
    y[:, 0] += 0.1 * np.sin(7.0 * x[:, 1] + 3.0 * x[:, 2])
    y[:, 2] += 0.08 * np.sin(5.0 * x[:, 0] + 2.0 * x[:, 1])
    return y


def same(one, other):
    assert np.array_equal(one.points, other.points)
    assert all(np.array_equal(p.nodes, q.nodes) for p, q in zip(one.blocks, other.blocks, strict=True))
    for name, (cells, local) in one.facet_groups.items():
        assert np.array_equal(cells, other.facet_groups[name][0])
        assert np.array_equal(local, other.facet_groups[name][1])
    assert all(np.array_equal(nodes, other.node_groups[name]) for name, nodes in one.node_groups.items())


@pytest.mark.parametrize("cell, count", [("hexahedron", 74), ("wedge", 6), ("pyramid", 2)])
def test_divisions(cell, count):
    """As many as a cube has without a new vertex; each fills the cell, and its facets once."""
    faces = sum(len(facet) == 4 for facet in CELLS[cell].facets)
    points, found = reference_nodes(cell, 1), set()
    whole = {"hexahedron": 48.0, "wedge": 6.0, "pyramid": 8.0}[cell]
    points = np.vstack([points, points.mean(axis=0)])
    for choice in range(2**faces):
        for one in divisions(cell, choice):
            x = points[one.vertices]
            volumes = np.linalg.det(x[:, 1:] - x[:, :1])
            assert volumes.min() > 0.1 and volumes.sum() == pytest.approx(whole)
            assert [len(rows) for rows in one.facets] == [len(facet) - 2 for facet in CELLS[cell].facets]
            if one.vertices.max() < CELLS[cell].n_vertices:
                found.add(frozenset(frozenset(row) for row in one.vertices.tolist()))
    assert len(found) == count


def cells_of(mesh):
    """Kinds of the cells of a mesh on all ranks."""
    return set().union(*mesh.comm.allgather({block.cell for block in mesh.blocks if len(block.nodes)}))


@pytest.mark.parallel
@pytest.mark.parametrize(
    "kinds, order, more",
    [("quadrilateral", 1, {}), ("quadrilateral", 2, {}), (MIXED, 1, {"degree": 2}), (MIXED, 2, {}),
     (MIXED, 2, {"serendipity": True})],
)  # fmt: skip
def test_cells_are_divided(shared_tmp, kinds, order, more):
    """Cells meet, volume and groups stay, fields of the degree of the cells are kept; ranks make no difference."""
    path, found, simplices = mesh_of(shared_tmp, kinds), [], {"triangle", "tetrahedron"}
    serendipity = more.get("serendipity", False)
    for comm in (COMM, MPI.COMM_SELF):
        mesh = load(path, order, comm, serendipity=serendipity)
        assert cells_of(mesh) - simplices
        field = mesh.points**mesh.degree
        old = gathered(mesh, path) if not serendipity else None
        numbers = np.concatenate([block.ids for block in mesh.blocks])
        new, (values,), parents = split(mesh, (field,), degree=more.get("degree"), cells=numbers)
        ids = np.concatenate([block.ids for block in new.blocks])
        assert (np.diff(parents[np.argsort(ids)]) >= 0).all()
        assert not cells_of(new) - simplices and new.degree == max(order, more.get("degree", 1))
        assert values == pytest.approx(new.points**mesh.degree, abs=1e-14)
        assert volume(new) == pytest.approx(volume(mesh), rel=1e-13)
        assert quality(new) > (0.75 if new.dim == 3 else 0.86)
        assert new.n_nodes_total == comm.allreduce(int(new.file_nodes.max(initial=0)), op=MPI.MAX) + 1
        assert [new.n_components, new.component_names] == [mesh.n_components, mesh.component_names]
        finer = refine(new, chosen(new, 0, 0.1, 1)).mesh
        found.append((gathered(new, path), gathered(finer, path)))
    if COMM.rank == 0:
        for one, other in zip(*found, strict=True):
            same(one, other)
        new = found[0][0]
        if old is not None:
            assert sum(len(cells) for cells in new.cell_groups.values()) == new.offsets[-1]
            for name, group in old.facet_groups.items():
                assert area(new, *new.facet_groups[name]) == pytest.approx(area(old, *group), rel=1e-13)
            for name, nodes in old.node_groups.items():
                members = new.points[new.node_groups[name]]
                assert np.array_equal(np.sort(members, axis=0), np.sort(old.points[nodes], axis=0))
        assert conforms(new) == pytest.approx(8.0 if new.dim == 2 else 12.0)
        assert conforms(found[0][1]) == pytest.approx(conforms(new))


@pytest.mark.parallel
def test_skew_cells(shared_tmp):
    """Faces are cut along their shorter diagonals; some cells get a vertex in the middle, and no cell is folded."""
    path = mesh_of(shared_tmp, MIXED, bend)
    mesh = load(path, 1)
    new, *_ = split(mesh)
    assert new.n_nodes_total > mesh.n_nodes_total
    assert volume(new) == pytest.approx(volume(mesh), rel=1e-3) and quality(new) > 0.3


@pytest.mark.parallel
@pytest.mark.parametrize("kinds", ["quadrilateral", MIXED])
def test_linear_fields_stay_linear_on_skew_cells(shared_tmp, kinds):
    """Nodes in the middles of straight cells come into the middles of diagonals, and the fields with them."""
    if kinds == "quadrilateral":
        # straight cells in four sides that are no parallelogram
        mesh = load(mesh_of(shared_tmp, kinds), 2)
        mesh.points[:, 0] += 0.2 * mesh.points[:, 0] * mesh.points[:, 1]
    else:
        mesh = load(mesh_of(shared_tmp, kinds, bend), 2)
    slope = np.arange(1.0, 1.0 + 2 * mesh.dim).reshape(mesh.dim, 2)
    new, (field,), _ = split(mesh, [mesh.points @ slope])
    assert not mesh.curved and new.n_nodes_total >= mesh.n_nodes_total
    assert np.allclose(field, new.points @ slope, rtol=0.0, atol=1e-9)


@pytest.mark.parallel
def test_curved_cells_keep_their_shape(shared_tmp):
    """Rings of degree 2: the area is that of the curved cells, and all nodes are those of the file."""
    path = make_mesh(rings, shared_tmp / "rings.msh", order=2)
    mesh = load(path, 2, regions=("inner", "outer"))
    new, *_ = split(mesh)
    assert new.curved and new.n_nodes_total == mesh.n_nodes_total
    assert volume(new) == pytest.approx(volume(mesh), rel=1e-12)


def test_curved_cells_that_would_fold(tmp_path):
    """A triangle whose curved side goes through the diagonal is refused."""
    mesh = load(make_mesh(two_blocks, tmp_path / "a.msh", 2, 1, 1, "quadrilateral", order=2), 2)
    block = mesh.blocks[0]
    mesh.points[block.nodes[0, 4]] = 0.45 * mesh.points[block.nodes[0, :2]].sum(axis=0) + 0.1 * mesh.points[
        block.nodes[0, 8]]  # fmt: skip
    mesh.points[block.nodes[0, 8]] = mesh.points[block.nodes[0, :2]].mean(axis=0)
    with pytest.raises(InputError, match="1 curved cells whose triangles would fold"):
        split(mesh)


def test_groups_of_edges(tmp_path):
    """The new nodes in the middles of their edges belong to them, those of others do not."""
    mesh = load(mesh_of(tmp_path, MIXED), 1)
    x = mesh.points
    edge = np.flatnonzero((x[:, 0] == 0.0) & (x[:, 1] == 0.0) & (x[:, 2] <= 1.0))
    edge = edge[np.argsort(x[edge, 2])][:4]
    mesh.node_groups["edge"] = np.sort(edge)
    mesh.edge_groups["edge"] = np.column_stack([mesh.file_nodes[edge[:-1]], mesh.file_nodes[edge[1:]]])
    new, *_ = split(mesh, degree=2)
    members = new.points[new.node_groups["edge"]]
    expected = np.concatenate([x[edge], 0.5 * (x[edge[:-1]] + x[edge[1:]])])
    assert np.array_equal(members[np.argsort(members[:, 2])], expected[np.argsort(expected[:, 2])])
    place = np.argsort(new.file_nodes)[new.edge_groups["edge"]]
    assert sorted(new.points[place][:, :, 2].mean(axis=1)) == pytest.approx(expected[4:, 2])
