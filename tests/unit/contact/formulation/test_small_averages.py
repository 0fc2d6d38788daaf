"""Multipliers of both surfaces of an unbiased pair: their mean."""

import numpy as np
import pytest

from pcontact.contact.formulation.methods import acting as acting_of
from pcontact.contact.formulation.methods import update_multipliers
from pcontact.contact.formulation.small import local_means
from pcontact.simulation import Simulation
from tests.support.blocks import dragged
from tests.support.small import SELF, blocks_file


@pytest.fixture(params=[("quadrilateral", 1), ("tetrahedron", 2)], ids=lambda p: f"{p[0]} {p[1]}")
def halves(request, tmp_path):
    """Halves of an unbiased pair of blocks that do not match, at rest, some points without a partner."""
    cell, order = request.param
    dim = 2 if cell != "tetrahedron" else 3
    path = blocks_file(tmp_path / "b.msh", cell, 2, 3, offset=0.3)
    simulation = Simulation(dragged(path, dim, order), SELF)
    (contact,) = simulation.problem.contacts
    for pair in contact.pairs:
        pair.detect(simulation.problem.space.vector(), 1.0)
    yield contact.pairs
    simulation.close()


def test_means_are_those_of_numpy(halves):
    random = np.random.default_rng(1)
    u = halves[0].space.vector()
    acting = [acting_of(half, u)._replace(values=random.normal(size=half.source.x.shape)) for half in halves]
    acting = [one._replace(chosen=one.chosen & (random.uniform(size=len(one.chosen)) < 0.7)) for one in acting]
    assert all(0 < one.chosen.sum() < one.pairing.paired.sum() < len(one.chosen) for one in acting)
    d, sums, weights = u.getBlockSize(), {}, {}

    def around(one, p):
        """Node, share, sign of the nodes on both sides of a point."""
        pairing, source = one.pairing, one.source
        for nodes, shape, sign in ((pairing.cells[source.facet[p]], source.shape[p], 1.0),
                                   (pairing.targets[p], pairing.target_shape[p], -1.0)):  # fmt: skip
            for node, value in zip(pairing.exchange.nodes[nodes], np.abs(shape), strict=True):
                yield node, value, sign

    for one in acting:
        for p in np.flatnonzero(one.chosen):
            for node, share, sign in around(one, p):
                area = share * one.source.jxw[p]
                sums[node] = sums.get(node, np.zeros(d)) + sign * area * one.values[p]
                weights[node] = weights.get(node, 0.0) + area
    for one, found in zip(acting, local_means(halves[0].space, acting, both=True), strict=True):
        for p in np.flatnonzero(one.chosen):
            wanted, whole = np.zeros((2, d)), np.zeros(2)
            for node, share, sign in around(one, p):
                side = int(sign < 0.0)
                if share > 0.0:
                    wanted[side] += sign * share * sums[node] / weights[node]
                    whole[side] += share
            np.testing.assert_allclose(found[p], 0.5 * (wanted / whole[:, None]).sum(axis=0), atol=1e-13)


def test_what_is_uniform_stays_and_what_the_surfaces_differ_by_goes(halves):
    u = halves[0].space.vector()
    pull = np.arange(1.0, u.getBlockSize() + 1.0)
    for signs, kept in (((1.0, -1.0), True), ((1.0, 1.0), False)):
        acting = [acting_of(half, u) for half in halves]
        acting = [one._replace(values=sign * np.tile(pull, (len(one.values), 1))) for one, sign in
                  zip(acting, signs, strict=True)]  # fmt: skip
        found = local_means(halves[0].space, acting, both=True)
        for one, mean in zip(acting, found, strict=True):
            if kept:
                np.testing.assert_allclose(mean[one.chosen], one.values[one.chosen], rtol=1e-13)
            else:
                # of reaction and action as much: the weights of the two surfaces differ near the edges alone
                size = one.source.jxw[one.chosen] @ np.linalg.norm(mean[one.chosen], axis=1)
                assert size < 0.35 * one.source.jxw[one.chosen].sum() * np.linalg.norm(pull)


def test_rounding_errors_are_no_change(halves):
    """Surfaces that touch without a force: what is left of the gap grows with every update, and means nothing."""
    space = halves[0].space
    for depth, moves in ((1e-18, False), (1e-9, True)):
        u, values = space.vector(), np.zeros((space.n_owned, space.dim))
        values[space.component[space.owned_local] == halves[0].source.components[0], -1] = -depth
        u.setArray(values.ravel())
        change, size = update_multipliers(halves, u, 1e-4)
        assert size > 0.0 and (change > 1e-3) == moves and (moves or change == 0.0)
        assert any(half.method.multiplier.any() for half in halves) == moves
