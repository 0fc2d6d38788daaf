"""The mesh as a DMPlex: PETSc's own checks, its groups, who owns what, the same numbers as ours."""

import ctypes

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.plex import FACETS, MEMBERS, POLYTOPES, least_told, leaves, owners, told
from pcontact.mesh.refinement.refine import refine
from pcontact.mesh.topology import without
from pcontact.runtime.petsc import MPI, PETSc, call, handle
from pcontact.space.space import Space
from tests.support.small import blocks_file
from tests.support.wedges import cut_mesh

WORLD = MPI.COMM_WORLD
BODIES, PAIRS = ["lower", "upper"], [("upper_bottom", "lower_top", None)]
parallel = pytest.mark.parallel


def mesh_of(folder, cell, order=1, method="bisection"):
    """Two blocks; "mixed": of hexahedra, wedges, pyramids, tetrahedra."""
    path = folder / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, "hexahedron" if cell == "mixed" else cell, 4, 3)
        if cell == "mixed":
            cut_mesh(path, path, ("hexahedron", "wedge", "pyramid"), split="upper_top")
    WORLD.Barrier()
    return load_mesh(WORLD, path, order, BODIES, PAIRS, lambda raw: None, (4.0, method))


def with_faces(dm):
    """A clone with faces and edges that has passed PETSc's checks."""
    faces = dm.clone()
    faces.interpolate()
    call("DMPlexCheckSymmetry", handle(faces))
    call("DMPlexCheckSkeleton", handle(faces), 0)
    call("DMPlexCheckFaces", handle(faces), 0)
    call("DMPlexCheckGeometry", handle(faces))
    if WORLD.size > 1:
        call("DMPlexCheckPointSF", handle(faces), None, ctypes.c_int(0))
    return faces


def volume(dm):
    """Of all cells of all ranks."""
    return WORLD.allreduce(sum(dm.computeCellGeometryFVM(cell)[0] for cell in range(*dm.getHeightStratum(0))))


def stratum(dm, name, value):
    rows = dm.getLabel(name).getStratumIS(value)
    return np.zeros(0, dtype=int) if rows is None or not rows.handle else rows.getIndices()


@parallel
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron", "mixed"])
@pytest.mark.parametrize("order", [1, 2])
def test_cells_vertices_and_groups(shared_tmp, cell, order):
    """PETSc finds the mesh sound; cells and vertices are those of the blocks in their order, labels their groups."""
    mesh = mesh_of(shared_tmp, cell, order)
    dm, first = mesh.dm, np.cumsum([0, *(len(block.nodes) for block in mesh.blocks)])
    assert dm.getHeightStratum(0) == (0, first[-1])
    start, end = dm.getDepthStratum(0)
    x = dm.getCoordinatesLocal().getArray(readonly=True).reshape(-1, mesh.dim)
    for block, at in zip(mesh.blocks, first, strict=False):
        kind, vtk = POLYTOPES[mesh.dim, CELLS[block.cell].n_vertices]
        for row in range(0, len(block.nodes), 7):
            cone = dm.getCone(at + row)
            assert dm.getCellType(at + row) == kind
            np.testing.assert_array_equal(x[cone - start], mesh.points[block.nodes[row, vtk]])
    assert volume(with_faces(dm)) == pytest.approx(volume_of(mesh), rel=1e-12)
    for name, rows in mesh.cell_groups.items():
        wanted = np.concatenate([at + part for at, part in zip(first, rows, strict=False)])
        np.testing.assert_array_equal(stratum(dm, name, MEMBERS), np.sort(wanted))
    for name, parts in mesh.facet_groups.items():
        pairs = {(int(first[part.block] + c), int(k))
                 for part in parts for c, k in zip(part.cells, part.local, strict=True)}  # fmt: skip
        found = {(int(c), k) for k in range(6) for c in stratum(dm, name, FACETS + k)}
        assert found == pairs
    for name in mesh.node_groups:
        places = x[stratum(dm, name, MEMBERS) - start]
        assert {tuple(p) for p in places} <= {tuple(p) for p in mesh.points[mesh.node_groups[name]]}
    assert (end - start == len(mesh.points)) == (order == 1)


def volume_of(mesh):
    """Both blocks are boxes."""
    total = 0.0
    for body in range(2):
        own = [mesh.points[block.nodes].reshape(-1, mesh.dim) for block in mesh.blocks if block.body == body]
        low, high = bounding_box(WORLD, np.concatenate([np.zeros((0, mesh.dim)), *own]))
        total += np.prod(high - low)
    return total


@parallel
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "mixed"])
def test_a_section_of_the_plex_has_the_numbers_of_the_space(shared_tmp, cell):
    """Vectors and matrices that PETSc makes of the DM are numbered as ours."""
    space = Space(mesh_of(shared_tmp, cell), 1)
    dm, d = space.dm, space.dim
    assert dm.createGlobalVec().getSizes() == space.vector().getSizes()
    lgmap = dm.getLGMap()
    assert lgmap.getBlockSize() == d
    np.testing.assert_array_equal(lgmap.getBlockIndices(), space.nodes)
    local = dm.createLocalVec()
    values = space.vector()
    values.setArray((d * np.arange(space.start, space.start + space.n_owned)[:, None] + np.arange(d)).ravel())
    dm.globalToLocal(values, local)
    np.testing.assert_array_equal(local.getArray().reshape(-1, d)[:, 0], d * space.nodes)


@parallel
def test_vertices_of_a_mesh_with_middles_keep_their_owners(shared_tmp):
    """Displacement of degree 1 on cells of degree 2: the numbers are again those of the Plex; of degree 2 there is
    no section of it."""
    mesh = mesh_of(shared_tmp, "triangle", 2)
    space = Space(mesh, 1)
    np.testing.assert_array_equal(space.dm.getLGMap().getBlockIndices(), space.nodes)
    whole = Space(mesh, 2)
    owner = whole.numbering.owner(whole.nodes[space.mesh_nodes])
    np.testing.assert_array_equal(owner, space.numbering.owner(space.nodes))
    with pytest.raises(ValueError, match="degree 1"):
        _ = whole.dm


@parallel
def test_refined_meshes_and_those_without_a_body(shared_tmp):
    """They have a Plex of their own."""
    mesh = mesh_of(shared_tmp, "tetrahedron")
    cells = WORLD.allreduce(mesh.dm.getHeightStratum(0)[1])
    n = sum(len(block.nodes) for block in mesh.blocks)
    finer = refine(mesh, np.full(n, 3)).mesh
    assert WORLD.allreduce(finer.dm.getHeightStratum(0)[1]) == finer.n_cells_total > cells
    assert volume(with_faces(finer.dm)) == pytest.approx(volume_of(mesh), rel=1e-12)
    np.testing.assert_array_equal(Space(finer, 1).dm.getLGMap().getBlockIndices(), Space(finer, 1).nodes)
    part = without(mesh, {1}, BODIES)
    own = sum(len(block.nodes) for block in mesh.blocks if block.body == 0)
    assert part.dm.getHeightStratum(0)[1] == own and with_faces(part.dm)
    np.testing.assert_array_equal(Space(part, 1).dm.getLGMap().getBlockIndices(), Space(part, 1).nodes)


@parallel
@pytest.mark.parametrize("cell", ["triangle", "mixed"])
def test_the_user_s_partitioner(shared_tmp, cell):
    """PETSc's partitioners, whatever the cells; every cell is somewhere once."""
    options = PETSc.Options()
    options.setValue("petscpartitioner_type", "simple")
    try:
        mesh = mesh_of(shared_tmp, cell, method="graph")
    finally:
        options.delValue("petscpartitioner_type")
    ids = np.concatenate(WORLD.allgather(np.concatenate([block.ids for block in mesh.blocks])))
    np.testing.assert_array_equal(np.sort(ids), np.arange(mesh.n_cells_total))
    counts = np.array(WORLD.allgather(sum(len(block.ids) for block in mesh.blocks)))
    assert counts.max() <= counts.min() + 1


@parallel
def test_told_and_leaves():
    """What two ranks have is told by the one that owns it; the last rank may have nothing."""
    n = 50
    mine = np.arange(0 if WORLD.rank == WORLD.size - 1 > 0 else n)[::-1].copy()
    sf = owners(WORLD, mine, n)
    owned = np.ones(len(mine), dtype=bool)
    owned[leaves(sf)] = False
    assert WORLD.allreduce(int(owned.sum())) == n
    values = told(sf, np.column_stack([mine, np.full(len(mine), WORLD.rank)]).astype(float))
    np.testing.assert_array_equal(values[:, 0], mine)
    assert np.all(values[owned, 1] == WORLD.rank) and np.all(values[~owned, 1] != WORLD.rank)
    # of what every rank but the last one has, rank 0 has the least
    np.testing.assert_array_equal(least_told(sf, mine + WORLD.rank), mine)


@parallel
def test_facets_of_labels_are_where_their_group_is(shared_tmp):
    """Facet k of a labelled cell, in the order of VTK, lies on the surface."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 3, 3, 3, heights=(1.0, 1.0))
    WORLD.Barrier()
    mesh = load_mesh(WORLD, path, 1, BODIES, PAIRS, lambda raw: None)
    dm, n = mesh.dm, mesh.dm.getHeightStratum(0)[1]
    x, count = dm.getCoordinatesLocal().getArray(readonly=True).reshape(-1, 3), 0
    cell = mesh.blocks[0].cell
    order = POLYTOPES[3, CELLS[cell].n_vertices][1]
    for k, nodes in enumerate(facet_nodes(cell, 1)):
        for c in stratum(dm, "lower_top", FACETS + k):
            vtk = dm.getCone(int(c))[order] - n
            np.testing.assert_allclose(x[vtk[nodes]][:, 2], x[vtk[nodes]][0, 2], atol=1e-12)
            count += 1
    assert WORLD.allreduce(count) == 9
