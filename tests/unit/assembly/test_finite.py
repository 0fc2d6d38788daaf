"""The item of bodies with finite strain: tangents, frames, small strain, internal variables."""

import numpy as np
import pytest

from tests.support.finite import (
    LAM,
    LAWS,
    MU,
    YOUNG,
    deformed,
    finite_bulk,
    finite_grid,
    finite_space,
    forces_of,
    history,
)
from tests.support.small import dense_item, elastic_solid, magnitude_of, vector_of

GRIDS = [
    ("triangle", 2), ("quadrilateral", 1), ("quadrilateral", 2), ("hexahedron", 1), ("tetrahedron", 2),
    ("tetrahedron", 1), ("triangle", 1),
]  # fmt: skip
CASES = [
    (cell, degree, kinematics, averaged)
    for cell, degree in GRIDS
    for kinematics in ("plane_strain", "plane_stress", "axisymmetric")
    if kinematics == "plane_strain" or cell in ("triangle", "quadrilateral")
    for averaged in (False, True)
    if not averaged or (kinematics != "plane_stress" and (degree == 2 or cell in ("quadrilateral", "hexahedron")))
]
RUBBER = LAWS[4:]


@pytest.mark.parametrize("cell, degree, kinematics, averaged", CASES)
def test_tangent_is_the_derivative_of_the_forces(tmp_path, cell, degree, kinematics, averaged):
    """Of all laws, from states with a history that is not coaxial; it is symmetric."""
    rng, h = np.random.default_rng(8), 1e-5
    space = finite_space(finite_grid(tmp_path, cell, degree), degree, kinematics, averaged)
    for law in LAWS:
        if law in RUBBER and kinematics == "plane_stress":
            continue
        bulk = history(finite_bulk(space, law), rng)
        u, way = deformed(space, rng)[space.owned_local], rng.standard_normal((space.n_owned, space.dim))
        tangent = dense_item(bulk, vector_of(space, u))
        ends = [forces_of(bulk, u + k * h * way) for k in (-2, -1, 1, 2)]
        change = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        error = np.abs(tangent @ way.ravel() - change.ravel()).max() / np.abs(change).max()
        assert error < 1e-7, law
        np.testing.assert_array_equal(tangent, tangent.T)
        assert not bulk.yields or bulk.plasticity()[0] > 0.05


@pytest.mark.parametrize("cell, degree, kinematics, averaged", CASES)
def test_small_strain_is_the_limit(tmp_path, cell, degree, kinematics, averaged):
    """|R(s u) - s K u| / |s K u| = O(s), down to 1e-12, where K is that of linear elasticity."""
    rng = np.random.default_rng(6)
    space = finite_space(finite_grid(tmp_path, cell, degree), degree, kinematics, averaged)
    u = deformed(space, rng)[space.owned_local]
    for law in ("hencky", "multiplicative", "neo_hooke"):
        if law in RUBBER and kinematics == "plane_stress":
            continue
        bulk = finite_bulk(space, law)
        elastic = elastic_solid(space, bulk.constants)
        for s in (1e-3, 1e-6, 1e-9, 1e-12):
            linear = forces_of(elastic, s * u)
            error = np.abs(forces_of(bulk, s * u) - linear).max() / np.abs(linear).max()
            assert error < 3.0 * s + 1e-13, (law, s)
        difference = dense_item(bulk, vector_of(space, 0.0 * u)) - dense_item(elastic, vector_of(space, u))
        assert np.abs(difference).max() < 1e-12 * YOUNG


def rotation(d, rng):
    q, _ = np.linalg.qr(rng.standard_normal((d, d)))
    q[:, 0] *= np.sign(np.linalg.det(q))
    return q


@pytest.mark.parametrize("cell, degree", [grid for grid in GRIDS[1:5]])
@pytest.mark.parametrize("law", LAWS)
def test_forces_turn_with_the_body(tmp_path, cell, degree, law):
    """R(Q x) = Q R(x), with yielding; and a body that is turned alone bears nothing."""
    rng = np.random.default_rng(12)
    space = finite_space(finite_grid(tmp_path, cell, degree), degree, "plane_strain", degree == 1)
    bulk = history(finite_bulk(space, law), rng)
    x, u, q = space.points[space.owned_local], deformed(space, rng)[space.owned_local], rotation(space.dim, rng)
    forces = forces_of(bulk, u)
    turned = forces_of(bulk, (x + u) @ q.T - x)
    np.testing.assert_allclose(turned, forces @ q.T, rtol=0.0, atol=1e-12 * np.abs(forces).max())
    fresh = finite_bulk(space, law)
    still = np.abs(forces_of(fresh, x @ q.T - x))
    assert np.all(still <= 8.0 * np.finfo(float).eps * magnitude_of(fresh, vector_of(space, x @ q.T - x)))


def test_state_after_a_turn_is_the_same(tmp_path):
    """Plastic strain belongs to the undeformed body: a turned path leaves the same one."""
    rng = np.random.default_rng(3)
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", True)
    x, u, q = space.points[space.owned_local], deformed(space, rng)[space.owned_local], rotation(3, rng)
    for law in ("multiplicative", "additive"):
        one, other = finite_bulk(space, law), finite_bulk(space, law)
        one.commit(vector_of(space, u), 0.0)
        other.commit(vector_of(space, (x + u) @ q.T - x), 0.0)
        for number, state in one.parts.items():
            assert state.p.max() > 0.05
            np.testing.assert_allclose(other.parts[number].values, state.values, atol=1e-13)


def test_a_committed_state_does_not_yield_again(tmp_path):
    rng = np.random.default_rng(9)
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", True)
    for law in ("multiplicative", "prager", "additive"):
        bulk = history(finite_bulk(space, law), rng)
        u = deformed(space, rng)[space.owned_local]
        assert bulk.flowing(vector_of(space, u)) > 0.5
        before = forces_of(bulk, u)
        bulk.commit(vector_of(space, u), 0.0)
        p = bulk.plasticity()[0]
        np.testing.assert_allclose(forces_of(bulk, u), before, rtol=0.0, atol=1e-11 * np.abs(before).max())
        bulk.commit(vector_of(space, u), 0.0)
        assert bulk.plasticity()[0] == pytest.approx(p, rel=1e-13)


def test_memory(tmp_path):
    """What is remembered is all that another item needs to go on alike."""
    rng = np.random.default_rng(5)
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "axisymmetric", True)
    bulk, other = history(finite_bulk(space, "multiplicative"), rng), finite_bulk(space, "multiplicative")
    for name, rows in bulk.memory().items():
        assert other.recall(name, [rows]) == len(rows[0])
    u = deformed(space, rng)[space.owned_local]
    np.testing.assert_array_equal(forces_of(other, u), forces_of(bulk, u))
    assert len(bulk.memory_keys()) == sum(len(state.p) for state in bulk.parts.values())
    assert bulk.counters()["points"] == sum(state.p.size for state in bulk.parts.values())
    elastic = finite_bulk(space, "hencky")
    assert elastic.memory() == {} and elastic.counters()["points"] == 0 and elastic.plastic_strain() is None


def test_stress_and_strain_of_a_stretched_and_turned_block(tmp_path):
    """Cauchy stress and ln V turn with the body; volumes are those of the undeformed cells."""
    rng = np.random.default_rng(14)
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", False)
    bulk, x, q = finite_bulk(space, "hencky"), space.points[space.owned_local], rotation(3, rng)
    stretch = np.diag([1.3, 0.9, 1.1])
    v = q @ np.diag(np.log(np.diag(stretch))) @ q.T
    tau = LAM * np.trace(v) * np.eye(3) + 2.0 * MU * v
    u = vector_of(space, x @ (q @ stretch).T - x)
    order = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])
    ((stress, volume),) = bulk.stress(u)
    np.testing.assert_allclose(stress, np.tile((tau / np.linalg.det(stretch))[order], (len(stress), 1)), rtol=1e-11)
    (strain,) = bulk.fields(u)["log_strain"]
    np.testing.assert_allclose(strain, np.tile(v[order], (len(strain), 1)), rtol=1e-11)
    (elastic,) = elastic_solid(space, bulk.constants).stress(u)
    np.testing.assert_allclose(volume, elastic[1], rtol=1e-13)


def test_prediction_is_the_tangent_at_the_base(tmp_path):
    rng = np.random.default_rng(21)
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    bulk = history(finite_bulk(space, "multiplicative"), rng)
    base, way = (deformed(space, rng)[space.owned_local] for _ in range(2))
    out = np.zeros_like(base)
    bulk.predict(vector_of(space, base + 50.0 * way), vector_of(space, base), out)
    expected = forces_of(bulk, base).ravel() + 50.0 * dense_item(bulk, vector_of(space, base)) @ way.ravel()
    np.testing.assert_allclose(out.ravel(), expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_inside_out_leaves_nan(tmp_path):
    """So that no step of Newton's method ends there."""
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", True)
    x = space.points[space.owned_local]
    assert np.isnan(forces_of(finite_bulk(space, "neo_hooke"), -2.0 * x * [1.0, 0.0, 0.0])).all()
