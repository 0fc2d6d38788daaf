"""Numbers of nodes on several ranks, and what their neighbours hold."""

import numpy as np
import pytest

from pcontact.mesh.plex import owners
from pcontact.runtime.parallel import NodeExchange
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.space.space import Numbering

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


@parallel
def test_node_exchange_gathers_and_adds():
    """Any nodes in any order, none on the last rank."""
    n_owned, d = 3 + WORLD.rank, 2
    total = WORLD.allreduce(n_owned)
    start = WORLD.exscan(n_owned) or 0
    vector = PETSc.Vec().create(comm=WORLD)
    vector.setSizes((n_owned * d, total * d), bsize=d)
    vector.setType("mpi" if WORLD.size > 1 else "seq")
    own = np.arange(start, start + n_owned)
    vector.setArray((10.0 * own[:, None] + np.arange(d)).ravel())
    nodes = np.random.default_rng(WORLD.rank).permutation(total)[
        : 0 if WORLD.rank == WORLD.size - 1 > 0 else 4
    ]
    plan = NodeExchange(vector, nodes, d)
    got = plan.gather(vector)
    np.testing.assert_array_equal(got, 10.0 * nodes[:, None] + np.arange(d))
    got[:] = -1  # an array of its own
    assert np.all(plan.gather(vector) >= 0)
    asked = np.zeros(total)
    asked[nodes] = 1.0
    WORLD.Allreduce(MPI.IN_PLACE, asked, op=MPI.SUM)
    before = vector.getArray().copy().reshape(-1, d)
    plan.add(np.full((len(nodes), d), 0.25), vector)
    np.testing.assert_allclose(
        vector.getArray().reshape(-1, d) - before, 0.25 * asked[own][:, None] * np.ones(d)
    )


@parallel
def test_numbering_is_agreed_contiguous_and_even():
    """Keys that many ranks share, in any order; the last rank may have none."""
    n_keys = 6000
    rng = np.random.default_rng(3 + WORLD.rank)
    mine = np.zeros(0, dtype=np.int64) if WORLD.rank == 3 else rng.permutation(n_keys)[:4000]
    if WORLD.rank == 0:
        mine = rng.permutation(n_keys)
    numbering = Numbering(WORLD, len(mine), owners(WORLD, mine, n_keys))
    assert numbering.n_total == n_keys
    table = np.full(n_keys, -1)
    table[mine] = numbering.numbers
    for other in WORLD.allgather(table):
        known = (other >= 0) & (table >= 0)
        np.testing.assert_array_equal(other[known], table[known])
    everything = np.max(WORLD.allgather(table), axis=0)
    np.testing.assert_array_equal(np.sort(everything), np.arange(n_keys))
    owner = numbering.owner(numbering.numbers)
    assert np.sum(owner == WORLD.rank) == numbering.n_owned
    own = numbering.numbers[owner == WORLD.rank]
    # owned nodes keep the order in which they were given
    np.testing.assert_array_equal(own, numbering.start + np.arange(numbering.n_owned))
    nodes, place = numbering.places(numbering.numbers)
    np.testing.assert_array_equal(nodes[place], numbering.numbers)
    assert len(np.unique(nodes)) == len(nodes)
    if WORLD.size in (2, 3):
        counts = np.diff(numbering.ranges)
        assert counts.min() > 0.5 * n_keys / WORLD.size
