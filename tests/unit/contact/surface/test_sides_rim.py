"""Partners near the edges of facets do not depend on how a target surface is spread over ranks."""

import numpy as np
import pytest

from pcontact.contact.search.partners import PATIENCE, find_partners
from pcontact.contact.search.projection import QueryPoints
from pcontact.contact.surface.sides import target_surface
from pcontact.mesh import distribute
from pcontact.runtime import profile
from pcontact.runtime.petsc import MPI
from tests.support.small import DIMENSION, SELF, bend, block_file, make_space

WORLD = MPI.COMM_WORLD
POINTS = 4000


def partners(comm, path, x, normals):
    """Partners of points on the skin of a bent block, of which every rank asks for some; in the order of the points."""
    space = make_space(comm, path, ["block"], change=bend)
    target = target_surface(space, "top")
    mine = np.arange(comm.rank, len(x), comm.size)
    still = np.zeros((space.n_local, space.dim))
    found = find_partners(space, target, still, QueryPoints(x[mine], normals[mine], 0.6), "closest_point")
    rows = comm.allgather(np.column_stack([mine, found.ids, found.gap, found.normal]))
    table = np.concatenate(rows)
    return table[np.argsort(table[:, 0])]


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron", "hexahedron"])
def test_partners_do_not_depend_on_the_ranks(shared_tmp, cell):
    """Also of points beside the border, where a facet that may be no partner itself tells that another one is not."""
    path, d = shared_tmp / "b.msh", DIMENSION[cell]
    if WORLD.rank == 0:
        block_file(path, cell, 4)
    WORLD.Barrier()
    random = np.random.default_rng(1)
    x = random.uniform(-0.4, 1.4, (POINTS, d))
    x[:, -1] = random.uniform(0.7, 1.4, POINTS)
    normals = random.normal(size=(POINTS, d)) - 1.5 * np.eye(d)[-1]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    several, alone = (partners(comm, path, x, normals) for comm in (WORLD, SELF))
    paired = alone[:, 1] >= 0
    assert 0.2 * POINTS < paired.sum() < 0.9 * POINTS
    np.testing.assert_array_equal(several[:, 1], alone[:, 1])
    np.testing.assert_allclose(several[paired, 2:], alone[paired, 2:], rtol=0.0, atol=1e-12)


@pytest.mark.parallel
def test_partners_do_not_depend_on_the_partition(shared_tmp, monkeypatch):
    """Cells dealt out at random: the same partners, and no rank tries all facets for want of the partner."""
    path = shared_tmp / "b.msh"
    if WORLD.rank == 0:
        block_file(path, "tetrahedron", 12)
    WORLD.Barrier()
    random = np.random.default_rng(2)
    x = np.column_stack([random.uniform(0.1, 0.9, (POINTS, 2)), random.uniform(0.9, 1.3, POINTS)])
    normals = np.tile([0.0, 0.0, -1.0], (POINTS, 1))
    alone = partners(SELF, path, x, normals)
    monkeypatch.setattr(distribute, "partition", lambda piece, *_: piece.ids * 40503 % 65536 % WORLD.size)
    with profile.recording(profile.Profile()) as recorded:
        several = partners(WORLD, path, x, normals)
    assert np.all(alone[:, 1] >= 0)
    np.testing.assert_array_equal(several[:, 1], alone[:, 1])
    np.testing.assert_allclose(several[:, 2:], alone[:, 2:], rtol=0.0, atol=1e-12)
    counts = recorded.counts[profile.OTHER]
    asked, tried = (WORLD.allreduce(counts[name]) for name in ("asked", "candidates"))
    assert tried <= PATIENCE * asked
