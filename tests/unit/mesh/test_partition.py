"""Which rank gets which cell."""

import numpy as np
import pytest

from meshes.blocks import two_blocks
from meshes.spring import spring
from pcontact.mesh.bisection import UNIT, Cells, bisect, directions
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.partition import by_bisection, contact_facets, partition
from pcontact.mesh.read import read_mesh
from pcontact.mesh.slices import Corners, whole
from pcontact.mesh.topology import components
from pcontact.runtime.petsc import MPI
from tests.support.small import blocks_file, make_space

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
PAIRS = [("upper_bottom", "lower_top", None)]


def grid(*counts):
    """Centres of the cells of a grid with unit cells."""
    return np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in counts], indexing="ij"), axis=-1).reshape(-1, len(counts))


def boxes(centres):
    """Vertices (n, 2^d, d) of unit cells."""
    d = centres.shape[1]
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * d, indexing="ij"), axis=-1).reshape(-1, d)
    return centres[:, None] + corners


def cells_of(points, weights=None, contact=None, comm=SELF, ids=None, heavy=0.0):
    """What is known of unit cells with weights, and contact work (n,) that weighs ``heavy``."""
    weights = np.ones(len(points)) if weights is None else weights
    contact = np.zeros(len(points), dtype=np.int64) if contact is None else contact
    ids = np.arange(len(points)) if ids is None else ids
    work = np.round(UNIT * (weights + heavy * contact)).astype(np.int64)
    return Cells(comm, points, ids, work, contact, lambda rows: boxes(points[rows]), UNIT * heavy)


@pytest.mark.parametrize("dim, count", [(2, 4), (3, 13)])
def test_directions(dim, count):
    """Axes first, then diagonals; none twice."""
    found = directions(dim)
    assert found.shape == (count, dim)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_array_equal(np.sort(found[:dim], axis=0)[-1], 1.0)
    cosines = np.abs(found @ found.T) - np.eye(count)
    assert cosines.max() < 0.9


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 16])
@pytest.mark.parametrize("counts", [(12, 8), (6, 5, 4), (30, 20, 20)])
def test_balance_of_equal_weights(counts, count):
    """A few parts per hundred off at most, or a cell for each cut."""
    points = grid(*counts)
    sizes = np.bincount(bisect(cells_of(points), count), minlength=count)
    assert len(sizes) == count and sizes.sum() == len(points)
    fair = len(points) / count
    assert np.abs(sizes - fair).max() <= max(np.ceil(np.log2(max(count, 2))), 0.05 * fair) + 1


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_balance_of_weights(count):
    """Weights, not cells: heavy cells in one corner get more ranks."""
    points = grid(20, 20)
    weights = np.where((points < 5).all(axis=1), 16.0, 1.0)
    part = bisect(cells_of(points, weights), count)
    work = np.bincount(part, weights, minlength=count)
    assert np.abs(work - weights.sum() / count).max() <= 16.0 * np.ceil(np.log2(count))
    assert np.bincount(part).max() > 1.5 * np.bincount(part).min()


def test_cuts_are_small():
    """Two halves of the longer side, and planes between layers, whose centres are in the same place."""
    points = grid(8, 4)
    np.testing.assert_array_equal(bisect(cells_of(points), 2), (points[:, 0] > 4).astype(int))
    points = grid(24, 16, 16)
    part = bisect(cells_of(points), 4)
    for plane in (points[:, 0] > 12, points[:, 1] > 8, points[:, 2] > 8):
        sides = [set(part[plane]), set(part[~plane])]
        if not sides[0] & sides[1]:
            break
    else:
        pytest.fail("no part ends at a plane of the grid")


@pytest.mark.parametrize("count, uneven", [(2, 1.1), (3, 1.3), (4, 1.1), (5, 1.5), (8, 1.3), (16, 1.5)])
def test_contact_is_spread(count, uneven):
    """Contact on a spot in the middle of one side: every part has its share, and its share of the cells.

    A plane through the middle halves both; others are a compromise.
    """
    points = grid(24, 24, 12)
    contact = (np.hypot(points[:, 0] - 12, points[:, 1] - 12) < 7) & (points[:, 2] < 1)
    part = bisect(cells_of(points, contact=contact.astype(np.int64), heavy=4.0), count)
    for values, most in ((np.ones(len(points)), 1.1), (contact, uneven)):
        share = np.bincount(part, values, minlength=count)
        assert share.max() * count / share.sum() < most


def test_contact_between_two_bodies_is_not_one_rank_s():
    """A plane between the bodies meets no cell, but all sources are on one side of it."""
    points = grid(20, 20, 20)
    contact = ((points[:, 2] > 10) & (points[:, 2] < 11)).astype(np.int64)
    halves = [np.bincount(bisect(cells_of(points, contact=contact, heavy=h), 2), contact) for h in (0.0, 4.0)]
    assert halves[1].max() < 1.05 * halves[1].mean()


@pytest.mark.parallel
@pytest.mark.parametrize("count", [2, 3, 7, 8])
def test_the_spread_over_ranks_does_not_matter(count):
    """All cells on one rank, or some on each, in any order: the same parts."""
    points = grid(14, 12, 10) + 0.0
    rng = np.random.default_rng(3)
    points += 0.1 * rng.standard_normal(points.shape)
    points[:300] = np.round(points[:300])  # some in the same place
    weights, contact = 1.0 + rng.integers(0, 3, len(points)), rng.integers(0, 2, len(points)) * (points[:, 2] < 1)
    expected = bisect(cells_of(points, weights, contact, heavy=2.0), count)
    for owner in (np.zeros(len(points)), rng.integers(0, WORLD.size, len(points)), np.arange(len(points)) % WORLD.size):
        mine = rng.permutation(len(points))
        mine = mine[owner[mine] == WORLD.rank]
        part = bisect(cells_of(points[mine], weights[mine], contact[mine], WORLD, mine, heavy=2.0), count)
        np.testing.assert_array_equal(part, expected[mine])


@pytest.mark.parametrize("n", [0, 1, 3])
def test_more_parts_than_points(n):
    part = bisect(cells_of(grid(n, 1) if n else np.zeros((0, 2))), 7)
    assert len(part) == n and np.all((part >= 0) & (part < 7))
    # nobody gets two where somebody gets none
    assert np.bincount(part, minlength=7).max(initial=0) <= 1


def test_points_in_one_place():
    part = bisect(cells_of(np.ones((1000, 3))), 4)
    np.testing.assert_array_equal(np.bincount(part), [250] * 4)


def test_a_single_very_heavy_cell():
    points = grid(10, 1)
    weights = np.where(points[:, 0] > 9, 1e6, 1.0)
    work = np.bincount(bisect(cells_of(points, weights), 2), weights, minlength=2)
    assert work.min() > 0


def slice_of(path):
    """The slices of a mesh that rank 0 reads. *Collective.*"""
    raw = read_mesh(path) if WORLD.rank == 0 else None
    return whole(WORLD, raw, False, None if raw is None else components(raw))


@pytest.mark.parallel
@pytest.mark.parametrize("method", ["bisection", "graph"])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_every_cell_has_one_rank(shared_tmp, cell, method):
    """Also by the graph; again and again the same, whatever was partitioned before in this process."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, cell, 6, 5)
    piece = slice_of(path)
    ranks = partition(piece, PAIRS, method=method)
    assert len(ranks) == len(piece.ids)
    if WORLD.rank == 0:
        n = len(ranks)
        sizes = np.bincount(ranks, minlength=WORLD.size)
        assert len(sizes) == WORLD.size
        assert sizes.min() > 0.7 * n / WORLD.size and sizes.max() < 1.3 * n / WORLD.size
    for _ in range(2):
        again = partition(piece, PAIRS, method=method)
        if method == "bisection":
            np.testing.assert_array_equal(again, ranks)


@pytest.mark.parallel
def test_contact_facets(shared_tmp):
    """Those of the source within reach of the target; all where there is an obstacle, or self contact."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 8, 10, heights=(1.0, 1.0))
    piece = slice_of(path)
    corners = Corners(piece)

    def count(*pair):
        return WORLD.allreduce(int(contact_facets(piece, corners, [pair]).sum()))

    assert count("upper_bottom", "lower_top", None) == 10
    assert count("upper_top", "lower_top", None) == 0
    assert count("upper_top", "lower_top", 1.01) == 10
    assert 0 < count("upper_left", "lower_top", 0.3) < 10
    assert count("upper_top", None, None) == count("upper_top", "upper_top", None) == 10


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_contact_of_two_blocks_is_spread(shared_tmp, dim):
    """The sources are all on one body; every rank gets some of it."""
    path, n = shared_tmp / "blocks.msh", 12 if dim == 2 else 8
    if WORLD.rank == 0:
        two_blocks(path, dim, n, n, heights=(1.0, 1.0))
    WORLD.Barrier()
    mesh = load_mesh(WORLD, path, 1, ["lower", "upper"], PAIRS, lambda raw: None)
    cells = np.array(WORLD.allgather(sum(len(b.nodes) for b in mesh.blocks)))
    facets = np.array(WORLD.allgather(sum(len(f.cells) for f in mesh.facet_groups["upper_bottom"])))
    assert cells.sum() == 2 * n**dim and facets.sum() == n ** (dim - 1)
    assert cells.max() * WORLD.size <= 1.1 * cells.sum()
    assert facets.max() <= max(1.1 * facets.mean(), facets.mean() + 2)


@pytest.mark.parallel
def test_weight_zero_leaves_contact_alone(shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 12, 12, heights=(1.0, 1.0))
    piece = slice_of(path)
    np.testing.assert_array_equal(partition(piece, PAIRS, 0.0), partition(piece, ()))


@pytest.mark.parallel
def test_more_ranks_than_cells(shared_tmp):
    """Two cells on up to four ranks: ranks without cells get empty tables and the right node total."""
    path = shared_tmp / "two.msh"
    if WORLD.rank == 0:
        blocks_file(path, "quadrilateral", 1, 1)
    WORLD.Barrier()
    space = make_space(WORLD, path, ["lower", "upper"], 1)
    assert space.numbering.n_total == 8
    assert WORLD.allreduce(sum(len(c) for c in space.cells)) == 2
    assert len(space.cells) == 2
    owned = WORLD.allgather(space.n_owned)
    assert sum(owned) == 8


@pytest.mark.parallel
@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_coil_is_cut_across(shared_tmp, count):
    """A plane meets the wire of a spring several times, or lengthwise; the distance from its end does not."""
    path = shared_tmp / "spring.msh"
    if WORLD.rank == 0:
        spring(path)
    piece = slice_of(path)
    part = by_bisection(piece, (), 0.0, count)
    if WORLD.rank == 0:
        sizes = np.bincount(part, minlength=count)
        assert sizes.max() < 1.1 * sizes.mean()
        cells = piece.blocks[0].nodes
        copies = np.unique(np.column_stack([cells.ravel(), np.repeat(part, cells.shape[1])]), axis=0)
        # a section of the wire has 28 nodes
        assert len(copies) - len(piece.points) == 28 * (count - 1)
