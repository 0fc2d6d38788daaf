"""The item of bodies of both kinds: each block is that of the item of its kind."""

import numpy as np
import pytest

from pcontact.assembly.finite import FiniteSolid, MixedSolid
from pcontact.assembly.solid import Solid
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import Plastic
from tests.support.finite import LAM, MU, SLOPE, YIELD, deformed, finite_material, forces_of
from tests.support.small import SELF, bend, blocks_file, dense_item, magnitude_of, make_space, vector_of

SMALL = Plastic(LAM, MU, hardening_curve(YIELD, SLOPE), dim=2)


@pytest.fixture
def space(tmp_path):
    return make_space(SELF, blocks_file(tmp_path / "blocks.msh", "quadrilateral"), ["lower", "upper"], 1, bend)


def mixed(space):
    """The lower body with small strain, the upper one with finite strain; both may yield."""
    return MixedSolid(space, [SMALL] * 2, [None, finite_material("multiplicative")])


def body_of(space):
    """Body of every owned node."""
    body = np.zeros(space.n_local, dtype=int)
    for cells, block in zip(space.cells, space.mesh.blocks, strict=True):
        body[cells] = block.body
    return body[space.owned_local]


def test_each_body_is_that_of_its_kind(space):
    rng, bulk = np.random.default_rng(2), mixed(space)
    small = Solid(space, [SMALL, SMALL])
    finite = FiniteSolid(space, bulk.constants, [finite_material("multiplicative")] * 2)
    for item in (bulk, small, finite):
        item.commit(vector_of(space, deformed(space, np.random.default_rng(1))[space.owned_local]), 0.0)
    u = deformed(space, rng)[space.owned_local]
    x, body = vector_of(space, u), body_of(space)
    for number, other in enumerate((small, finite)):
        own = body == number
        np.testing.assert_allclose(forces_of(bulk, u)[own], forces_of(other, u)[own], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(magnitude_of(bulk, x)[own], magnitude_of(other, x)[own], rtol=1e-12)
        for block, (values, expected) in enumerate(zip(bulk.stress(x), other.stress(x), strict=True)):
            if space.mesh.blocks[block].body == number:
                np.testing.assert_allclose(values[0], expected[0], rtol=1e-11, atol=1e-11)
                np.testing.assert_allclose(values[1], expected[1], rtol=1e-12)
                np.testing.assert_allclose(bulk.plastic_strain()[block], other.plastic_strain()[block], rtol=1e-12)
    assert 0.0 < bulk.plasticity()[1] <= 1.001 * small.plasticity()[1] and bulk.yields and not bulk.symmetric
    assert bulk.counters()["points"] == small.counters()["points"]
    # small strain of small cells, in a displacement that is a linear function of the place
    gradient = 1e-3 * np.array([[1.0, 2.0], [-0.5, 0.4]])
    strain = bulk.fields(vector_of(space, space.points[space.owned_local] @ gradient.T))["log_strain"]
    for block, values in enumerate(strain):
        if space.mesh.blocks[block].body == 0:
            expected = np.tile([1e-3, 4e-4, 0.0, 7.5e-4, 0.0, 0.0], (len(values), 1))
            np.testing.assert_allclose(values, expected, atol=1e-15)


def test_tangent_and_prediction(space):
    rng, bulk, h = np.random.default_rng(3), mixed(space), 1e-5
    u, way = deformed(space, rng)[space.owned_local], rng.standard_normal((space.n_owned, space.dim))
    tangent = dense_item(bulk, vector_of(space, u))
    ends = [forces_of(bulk, u + k * h * way) for k in (-2, -1, 1, 2)]
    change = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
    np.testing.assert_allclose(tangent @ way.ravel(), change.ravel(), rtol=0.0, atol=1e-7 * np.abs(change).max())
    out, upper = np.zeros_like(u), body_of(space) == 1
    bulk.predict(vector_of(space, u + way), vector_of(space, u), out)
    expected = forces_of(bulk, u) + (tangent @ way.ravel()).reshape(u.shape)
    np.testing.assert_allclose(out[upper], expected[upper], rtol=0.0, atol=1e-10 * np.abs(expected).max())


def test_memory(space):
    rng, bulk, other = np.random.default_rng(4), mixed(space), mixed(space)
    bulk.commit(vector_of(space, deformed(space, rng)[space.owned_local]), 0.0)
    tables = bulk.memory()
    assert len(tables) == len(space.mesh.blocks) and all(len(rows[0]) for rows in tables.values())
    for name, rows in tables.items():
        assert other.recall(name, [rows]) == len(rows[0])
    u = deformed(space, rng)[space.owned_local]
    np.testing.assert_array_equal(forces_of(other, u), forces_of(bulk, u))
    assert len(bulk.memory_keys()) == sum(len(block.nodes) for block in space.mesh.blocks)
    assert bulk.flowing(vector_of(space, 1.5 * u)) > 0.5
