"""Which rank gets which cell."""

import numpy as np
import pytest
from small import blocks_file, make_space

from meshes.blocks import two_blocks
from pcontact.mesh.load import load_mesh
from pcontact.mesh.partition import bisect, centroids, partition
from pcontact.mesh.reader import read_mesh
from pcontact.runtime.petsc import MPI

WORLD = MPI.COMM_WORLD


def grid(*counts):
    """Centres of the cells of a grid with unit cells."""
    return np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in counts], indexing="ij"), axis=-1).reshape(
        -1, len(counts)
    )


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 16])
@pytest.mark.parametrize("counts", [(12, 8), (6, 5, 4)])
def test_bisect_balances_equal_weights(counts, count):
    """No part differs from its fair share by more than one cell for each cut."""
    points = grid(*counts)
    part = bisect(points, np.ones(len(points)), count)
    sizes = np.bincount(part, minlength=count)
    assert len(sizes) == count and sizes.sum() == len(points)
    assert np.abs(sizes - len(points) / count).max() <= np.ceil(np.log2(max(count, 2)))


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_bisect_balances_weights(count):
    """Weights, not cells: heavy cells in one corner get more ranks."""
    points = grid(20, 20)
    heavy = (points < 5).all(axis=1)
    weights = np.where(heavy, 16.0, 1.0)
    part = bisect(points, weights, count)
    work = np.bincount(part, weights, minlength=count)
    assert np.abs(work - weights.sum() / count).max() <= 16.0 * np.ceil(np.log2(count))
    assert np.bincount(part).max() > 1.5 * np.bincount(part).min()


def test_bisect_depends_on_nothing_but_the_points():
    points, rng = grid(9, 7), np.random.default_rng(0)
    weights = 1.0 + rng.integers(0, 3, len(points))
    np.testing.assert_array_equal(bisect(points, weights, 5), bisect(points.copy(), 2.0 * weights, 5))
    # parts are boxes in a grid of cells: two halves of the longer side
    part = bisect(grid(8, 4), np.ones(32), 2)
    np.testing.assert_array_equal(part, (grid(8, 4)[:, 0] > 4).astype(int))


@pytest.mark.parametrize("n", [0, 1, 3])
def test_more_parts_than_points(n):
    part = bisect(grid(n, 1) if n else np.zeros((0, 2)), np.ones(n), 7)
    assert len(part) == n and np.all((part >= 0) & (part < 7))
    # nobody gets two where somebody gets none
    assert np.bincount(part, minlength=7).max(initial=0) <= 1


def test_a_single_very_heavy_cell():
    points = grid(10, 1)
    weights = np.where(points[:, 0] > 9, 1e6, 1.0)
    part = bisect(points, weights, 2)
    work = np.bincount(part, weights, minlength=2)
    assert work.min() > 0


@pytest.mark.parallel
def test_every_cell_has_one_rank(shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 6, 5)
        raw = read_mesh(path)
        n = sum(len(b.nodes) for b in raw.blocks)
        assert centroids(raw).shape == (n, 2)
    else:
        raw = None
    for extra in (None, "weights"):
        given = np.ones(n) if extra and WORLD.rank == 0 else None
        ranks = partition(WORLD, raw, given)
        assert (ranks is None) == (WORLD.rank != 0)
        if WORLD.rank == 0:
            sizes = np.bincount(ranks, minlength=WORLD.size)
            assert len(ranks) == n and len(sizes) == WORLD.size
            assert sizes.min() > 0.7 * n / WORLD.size and sizes.max() < 1.3 * n / WORLD.size


@pytest.mark.parallel
def test_the_same_mesh_is_cut_the_same_way(shared_tmp):
    """Whatever was partitioned before in this process."""
    raw = None
    if WORLD.rank == 0:
        raw = read_mesh(two_blocks(shared_tmp / "blocks.msh", 2, 6, 5))
    first, second, third = (partition(WORLD, raw, None) for _ in range(3))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, third)


@pytest.mark.parallel
def test_partition_weight_spreads_the_contact(shared_tmp):
    """With the weight of contact facets, the work (cells plus weight times facets) is even; cells are not."""
    path, weight = shared_tmp / "blocks.msh", 20.0
    if WORLD.rank == 0:
        two_blocks(path, 2, 12, 12, heights=(1.0, 1.0))
    WORLD.Barrier()
    surfaces = ["upper_bottom", "lower_top"]

    def work(value):
        mesh = load_mesh(WORLD, path, 1, ["lower", "upper"], surfaces, lambda raw: None, value)
        cells = sum(len(b.nodes) for b in mesh.blocks)
        facets = sum(len(f.cells) for name in surfaces for f in mesh.facet_groups.get(name, []))
        assert WORLD.allreduce(cells) == 288 and WORLD.allreduce(facets) == 24
        return np.array(WORLD.allgather(cells + weight * facets))

    plain, weighted = work(0.0), work(weight)
    assert weighted.sum() == plain.sum()
    share = plain.sum() / WORLD.size
    # one contact cell is 21 units and cannot be cut; a cut misses by at most one cell
    assert weighted.max() <= share + 21.0 * np.ceil(np.log2(max(WORLD.size, 2)))
    assert weighted.max() <= plain.max()


@pytest.mark.parallel
def test_more_ranks_than_cells(shared_tmp):
    """Two cells on up to four ranks: ranks without cells get empty tables and the right node total."""
    path = shared_tmp / "two.msh"
    if WORLD.rank == 0:
        blocks_file(path, "quadrilateral", 1, 1)
    WORLD.Barrier()
    for weight in (None, lambda raw: np.ones(2)):
        space = make_space(WORLD, path, ["lower", "upper"], 1, weight=weight)
        assert space.numbering.n_total == 8
        assert WORLD.allreduce(sum(len(c) for c in space.cells)) == 2
        assert len(space.cells) == 2
        owned = WORLD.allgather(space.n_owned)
        assert sum(owned) == 8
