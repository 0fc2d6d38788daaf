"""Finite strain at a point: against plain tensors, differences, and what has a closed form."""

import numpy as np
import pytest

from pcontact.material.finite import (
    CONSISTENT,
    ELASTIC,
    STRESS,
    new_plastic_strain,
    point_work,
    stress_at,
    thickness,
)
from pcontact.material.log_strain import add_curvature, axes_operator, eigenpairs, slopes
from pcontact.runtime.jit import njit
from tests.support.finite import HENCKY, LAM, LAWS, MU, POISSON, SLOPE, YIELD, YOUNG, finite_material, function_of, twin
from tests.support.plastic import mandel, tensor


@njit
def evaluate(material, h, plastic, p, pressure, mode, work):
    return stress_at(material, h, plastic, p, pressure, mode, work)


@njit
def go(material, h, plastic, p, work):
    """Commit a point."""
    good, _, new, yields = stress_at(material, h, plastic, p, 0.0, STRESS, work)
    if good and yields:
        new_plastic_strain(material, plastic, work)
    return new


@njit
def across(material, h, plastic, p, work):
    _, multiplied, _, _ = stress_at(material, h, plastic, p, 0.0, STRESS, work)
    return thickness(material, plastic, multiplied, work)


def random_gradient(rng, size, m, plane_stress=False):
    h = size * rng.standard_normal((3, 3))
    if m == 4:
        h[2, :2] = h[:2, 2] = 0.0
    if plane_stress:
        h[2, 2] = 0.0
    return h


def states(law, m, plane_stress=False, count=6):
    """Random states of points with a history that is not coaxial, and gradients to go to."""
    rng, material = np.random.default_rng(5), finite_material(law, plane_stress)
    work = point_work(m)
    for _ in range(count):
        plastic, p = np.zeros(m), 0.0
        for _ in range(2):
            p = go(material, random_gradient(rng, 0.1, m, plane_stress), plastic, p, work)
        yield material, plastic, p, random_gradient(rng, 0.15, m, plane_stress), work, rng


MODES = [(law, 6, False) for law in LAWS] + [(law, 4, False) for law in LAWS] + [(law, 4, True) for law in LAWS[:4]]


@pytest.mark.parametrize("law, m, plane_stress", MODES)
def test_stress_and_state_are_those_of_plain_tensors(law, m, plane_stress):
    for material, plastic, p, h, work, _ in states(law, m, plane_stress):
        s, ui, new, then = twin(material, np.eye(3) + h, tensor(plastic), p, m)
        good, multiplied, _, _ = evaluate(material, h, plastic, p, 0.0, STRESS, work)
        assert good
        scale = np.abs(s).max()
        np.testing.assert_allclose(work.stress, mandel(s, m), rtol=0.0, atol=1e-11 * scale)
        if multiplied:
            np.testing.assert_allclose(work.unplastic, ui, atol=1e-13)
        assert multiplied == (material.multiplicative and p > 0.0)
        own = plastic.copy()
        assert go(material, h, own, p, work) == pytest.approx(then, abs=1e-12)
        np.testing.assert_allclose(own, mandel(new, m), atol=1e-12)
        assert own[:3].sum() == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("law, m, plane_stress", MODES)
def test_tangent_is_the_derivative_of_the_stress(law, m, plane_stress):
    """Of S with respect to Green's strain of Fb; with a pressure that the mean dilatation adds."""
    yielded = 0
    for material, plastic, p, h, work, rng in states(law, m, plane_stress):
        _, multiplied, _, yields = evaluate(material, h, plastic, p, 1.3, CONSISTENT, work)
        yielded += yields
        tangent, ui = work.tangent.copy(), work.unplastic.copy() if multiplied else np.eye(3)
        way, size, ends = random_gradient(rng, 1.0, m, plane_stress), 1e-4, []
        for part in (-2, -1, 1, 2):
            evaluate(material, h + part * size * way, plastic, p, 1.3, STRESS, work)
            ends.append(work.stress.copy())
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * size)
        turned = ((np.eye(3) + h) @ ui).T @ way @ ui
        change = mandel(0.5 * (turned + turned.T), m)
        np.testing.assert_allclose(tangent @ change, slope, rtol=0.0, atol=1e-7 * np.abs(slope).max())
        np.testing.assert_array_equal(tangent, tangent.T)
    assert yielded == (6 if material.yields else 0)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("m", [6, 4])
def test_small_strain_has_all_its_digits(law, m):
    """At a gradient of 1e-12 the stress is that of linear elasticity, to the rounding errors of that."""
    rng, work, material = np.random.default_rng(2), point_work(m), finite_material(law)
    h = random_gradient(rng, 1e-12, m)
    eps = 0.5 * (h + h.T)
    evaluate(material, h, np.zeros(m), 0.0, 0.0, CONSISTENT, work)
    elastic = material.small.constants[0] * np.trace(eps) * np.eye(3) + 2.0 * MU * eps
    np.testing.assert_allclose(work.stress, mandel(elastic, m), rtol=0.0, atol=2e-11 * np.abs(elastic).max())
    expected = np.diag([2.0 * MU] * m)
    expected[:3, :3] += material.small.constants[0]
    np.testing.assert_allclose(work.tangent, expected, rtol=0.0, atol=2e-11 * YOUNG)


@pytest.mark.parametrize("size", [1e-9, 2e-3, 1e-2, 3e-2, 0.2])
def test_small_strains_without_axes(size):
    """Of bodies that have turned, stress and tangent are those along the axes, whatever rule is taken."""
    rng, work, material, lam, mu = np.random.default_rng(8), point_work(6), finite_material("hencky"), LAM, MU
    for _ in range(5):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        turn *= np.linalg.det(turn)
        stretch = size * rng.standard_normal((3, 3))
        stretch = 0.5 * (stretch + stretch.T)
        twice = stretch + stretch.T + stretch.T @ stretch
        assert evaluate(material, turn @ (np.eye(3) + stretch) - np.eye(3), np.zeros(6), 0.0, 0.7, CONSISTENT, work)[0]
        values, vectors, axes, f = np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6)), np.zeros(6)
        eigenpairs(twice.copy(), 6, values, vectors)
        axes_operator(vectors, axes)
        slopes(values, f)
        logs, curvature = 0.5 * np.log1p(values), np.zeros((6, 6))
        along = np.append(2.0 * mu * logs + lam * logs.sum() + 0.7, np.zeros(3))
        add_curvature(values, along, curvature)
        moduli = np.diag([2.0 * mu] * 6)
        moduli[:3, :3] += lam
        tangent = axes.T @ (f[:, None] * moduli * f + curvature) @ axes
        stress = axes.T @ (f * along)
        bound = 1e-13 + 1e-15 / size
        np.testing.assert_allclose(work.stress, stress, rtol=0.0, atol=bound * np.abs(stress).max())
        np.testing.assert_allclose(work.tangent, tangent, rtol=0.0, atol=1e-13 * np.abs(tangent).max() + bound)


@pytest.mark.parametrize("size, flows", [(1e-4, False), (2e-3, False), (0.04, True)])
def test_small_strains_after_flow(size, flows):
    """On a plastic strain, near to where nothing has stress and beyond the yield stress."""
    rng, work, material = np.random.default_rng(8), point_work(6), finite_material("multiplicative")
    for _ in range(5):
        plastic = tensor(mandel(0.2 * rng.standard_normal((3, 3)), 6))
        plastic -= np.trace(plastic) / 3.0 * np.eye(3)
        stretch = size * rng.standard_normal((3, 3))
        f = (np.eye(3) + stretch + stretch.T) @ function_of(plastic, np.exp)
        s, _, _, then = twin(material, f, plastic, 0.01, 6)
        good, multiplied, p, yields = evaluate(material, f - np.eye(3), mandel(plastic, 6), 0.01, 0.0, CONSISTENT, work)
        assert good and multiplied and yields == flows and p == pytest.approx(then, abs=1e-12)
        np.testing.assert_allclose(work.stress, mandel(s, 6), rtol=0.0, atol=1e-11 * YOUNG * size)


def test_plastic_strain_of_small_size_has_its_digits():
    """1/2 log C_p would have 4e-7 of a plastic strain of 1e-9."""
    material, work = finite_material("perfect"), point_work(6)
    tiny = 1e-9 * tensor(np.array([1.0, -0.4, -0.6, 0.3, 0.2, 0.1]))
    plastic, p = mandel(tiny, 6), 1e-9
    h = 1e-9 * tensor(np.array([1.0, 0.4, -0.6, -0.3, 0.2, 0.5]))
    material = material._replace(small=material.small._replace(curve=np.array([[0.0, 1e-8, 0.0]])))
    own = plastic.copy()
    go(material, h, own, p, work)
    small = finite_material("additive")
    small = small._replace(small=material.small)
    other = plastic.copy()
    go(small, h, other, p, work)
    assert np.abs(other - plastic).max() > 1e-10
    np.testing.assert_allclose(own, other, rtol=0.0, atol=1e-8 * np.abs(other).max())


def uniaxial(material, stretch, plastic, p, work):
    """Nominal stress and lateral stretch of a bar (3D) that is stretched, by bisection."""
    def nominal(lateral):
        h = np.diag([stretch, lateral, lateral]) - np.eye(3)
        _, multiplied, _, _ = evaluate(material, h, plastic, p, 0.0, STRESS, work)
        shrunk = work.unplastic[0, 0] if multiplied else 1.0
        return work.stress[1], stretch * shrunk**2 * work.stress[0], h

    low, high = 0.3, 2.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if nominal(middle)[0] > 0.0 else (middle, high)
    return nominal(low)[1], low, nominal(low)[2]


def unit(law, nu=0.3):
    """The material with E = 1."""
    material = finite_material(law)
    lam, mu = nu / ((1 + nu) * (1 - 2 * nu)), 0.5 / (1 + nu)
    terms = np.array([[mu, 2.0]]) if law == "neo_hooke" else HENCKY
    small = material.small._replace(constants=np.array([lam, mu, 0.0]))
    return material._replace(small=small, terms=terms, own=lam + 2 / 3 * mu if len(terms) else lam)


NEO_HOOKE = {
    0.5: (-1.151749, 1.211916), 0.8: (-0.256605, 1.068998), 1.25: (0.198857, 0.935916), 2.0: (0.521916, 0.822996),
    3.0: (0.764452, 0.749145),
}  # fmt: skip


@pytest.mark.parametrize("stretch", list(NEO_HOOKE))
def test_bar_of_elastic_material(stretch):
    work, none = point_work(6), np.zeros(6)
    force, lateral, _ = uniaxial(unit("hencky"), stretch, none, 0.0, work)
    assert force == pytest.approx(np.log(stretch) / stretch, rel=1e-12)
    assert lateral == pytest.approx(stretch**-0.3, rel=1e-12)
    force, lateral, _ = uniaxial(unit("neo_hooke"), stretch, none, 0.0, work)
    assert (force, lateral) == pytest.approx(NEO_HOOKE[stretch], abs=6e-7)


@pytest.mark.parametrize("split", ["multiplicative", "additive"])
def test_plastic_bar(split):
    """tau = sy + H p, p = (E ln l - sy) / (E + H), J = exp(.4 tau / E), whatever the split."""
    material, work, plastic, p = finite_material(split), point_work(6), np.zeros(6), 0.0
    constants = np.array([0.3 / (1.3 * 0.4) * 210e3, 210e3 / 2.6, 0.0])
    small = material.small._replace(constants=constants, curve=np.array([[0.0, 250.0, 1000.0]]))
    material = material._replace(small=small, own=constants[0])
    for stretch, expected in ((1.2, 358.5605), (1.5, 434.9058), (2.0, 469.3386)):
        force, lateral, h = uniaxial(material, stretch, plastic, p, work)
        p = go(material, h, plastic, p, work)
        tau = 250.0 + 1000.0 * p
        assert force == pytest.approx(expected, abs=6e-5)
        assert p == pytest.approx((210e3 * np.log(stretch) - 250.0) / 211e3, rel=1e-11)
        assert stretch * lateral**2 == pytest.approx(np.exp(0.4 * tau / 210e3), rel=1e-12)


@pytest.mark.parametrize("gamma, shear", [(0.2, 0.198677), (1.0, 0.860818), (2.0, 1.246450), (5.0, 1.223533)])
def test_simple_shear(gamma, shear):
    """tau12 = 2 asinh(g / 2) / sqrt(1 + g^2 / 4), tau11 = -tau22 = g / 2 tau12, for mu = 1."""
    material, work = finite_material("hencky"), point_work(6)
    material = material._replace(small=material.small._replace(constants=np.array([1.5, 1.0, 0.0])), own=1.5)
    h = np.zeros((3, 3))
    h[0, 1] = gamma
    evaluate(material, h, np.zeros(6), 0.0, 0.0, STRESS, work)
    f = np.eye(3) + h
    tau = f @ tensor(work.stress) @ f.T
    assert tau[0, 1] == pytest.approx(2 * np.arcsinh(gamma / 2) / np.sqrt(1 + gamma**2 / 4), rel=1e-13)
    assert tau[0, 1] == pytest.approx(shear, abs=6e-7)
    assert tau[0, 0] == pytest.approx(0.5 * gamma * tau[0, 1], rel=1e-12)
    assert tau[1, 1] == pytest.approx(-tau[0, 0], rel=1e-12)


IN_SHEAR = {
    "multiplicative": {0.5: 1.0, 1.0: 1.0, 2.0: 1.0, 4.0: 1.0},
    "additive": {0.5: 0.998, 1.0: 0.974, 2.0: 0.833, 4.0: 0.532},
}


@pytest.mark.parametrize("split, expected", list(IN_SHEAR.items()))
def test_perfect_plasticity_in_simple_shear(split, expected):
    """The shear stress stays at the yield stress with the multiplicative split alone."""
    material, work, plastic, p, steps = finite_material(split), point_work(6), np.zeros(6), 0.0, 400
    small = material.small._replace(curve=np.array([[0.0, 0.1, 0.0]]))
    material, h = material._replace(small=small), np.zeros((3, 3))
    for k in range(1, steps + 1):
        h[0, 1] = gamma = 4.0 * k / steps
        evaluate(material, h, plastic, p, 0.0, STRESS, work)
        fb = (np.eye(3) + h) @ (work.unplastic if p > 0.0 and material.multiplicative else np.eye(3))
        tau = fb @ tensor(work.stress) @ fb.T
        p = go(material, h, plastic, p, work)
        if round(gamma, 9) in expected:
            assert tau[0, 1] * np.sqrt(3.0) / 0.1 == pytest.approx(expected[round(gamma, 9)], abs=2e-3)


def test_elastic_moduli_on_request():
    """Of a point that yields, those of a law that does not."""
    for material, plastic, p, h, work, _ in states("multiplicative", 6, count=2):
        evaluate(material, h, plastic, p, 0.0, ELASTIC, work)
        stress, elastic = work.stress.copy(), work.tangent.copy()
        evaluate(material, h, plastic, p, 0.0, CONSISTENT, work)
        np.testing.assert_array_equal(work.stress, stress)
        difference = np.linalg.eigvalsh(elastic - work.tangent)
        assert difference[-1] > 0.1 * MU and difference[0] > -1e-9 * MU


def test_a_point_turned_inside_out_is_told():
    """C, and with it the strain, does not notice."""
    for law in LAWS:
        material, work = finite_material(law), point_work(6)
        for h in (np.diag([-2.0, 0.0, 0.0]), np.diag([-1.0, 0.0, 0.0]), np.full((3, 3), np.nan)):
            assert not evaluate(material, h, np.zeros(6), 0.0, 0.0, CONSISTENT, work)[0]


def test_thickness_in_plane_stress():
    """A bar in plane stress is as thin as one in space, with plastic strain and without."""
    work, solid = point_work(4), point_work(6)
    for law in ("hencky", "multiplicative", "additive"):
        flat, plastic, p = finite_material(law, True), np.zeros(4), 0.0
        full, whole, q = finite_material(law), np.zeros(6), 0.0
        for stretch in (1.05, 1.2, 1.4):
            _, lateral, h = uniaxial(full, stretch, whole, q, solid)
            h[2, 2] = 0.0
            assert across(flat, h, plastic, p, work) == pytest.approx(np.log(lateral), rel=1e-10)
            h[2, 2] = lateral - 1.0
            q = go(full, h, whole, q, solid)
            h[2, 2] = 0.0
            p = go(flat, h, plastic, p, work)
            assert p == pytest.approx(q, rel=1e-10, abs=1e-15)
    assert q > 0.1 and (YIELD, SLOPE, POISSON) == (5.0, 20.0, 0.3)
