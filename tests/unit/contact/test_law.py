"""Laws of friction: the projection and its derivative against plain numpy, what defines it, its kinks."""

import numpy as np
import pytest

from pcontact.contact.law import OPEN, SLIP, STICK, Frictionless, View, bound_of, contact_law, project
from pcontact.scene.model import Contact
from tests.support.laws import LAWS, law_of, limit_of, numpy_projection

# projections onto a fixed convex set
CONVEX = ["tresca"]


def compiled(name, bilateral, normal, tau):
    """P, D, status of the compiled kernel, which must write all of its results."""
    return projected(law_of(name), bilateral, normal, tau)


def projected(row, bilateral, normal, tau):
    """The same of a row of numbers."""
    p, d = np.full_like(tau, np.nan), np.full((len(tau), len(tau)), np.nan)
    rho, growth = bound_of(row, tau @ normal)
    status = project(float(rho), float(growth), bilateral, normal, tau, p, d)
    return p, d, status


def draws(d, n=300, seed=3):
    """Random unit normals and tractions (n, d), tangential parts from far below to far above the bounds."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, d))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    tau = rng.normal(size=(n, d))
    tau -= np.einsum("pd,pd->p", tau, normal)[:, None] * normal
    tau *= (np.exp(rng.uniform(-3.0, 2.0, n)) / np.linalg.norm(tau, axis=1))[:, None]
    return normal, tau + rng.normal(size=n)[:, None] * normal


def split(normal, tau):
    """Normal and tangential part."""
    return tau @ normal, tau - (tau @ normal) * normal


cases = pytest.mark.parametrize(
    "name, bilateral, d", [(name, b, d) for name in LAWS for b in (False, True) for d in (2, 3)]
)


def test_rows_of_the_laws():
    for said in ({}, {"friction": 0.0}, {"friction": 0.0, "friction_limit": 1.0}):
        assert type(contact_law(Contact("a", "b", **said))) is Frictionless
    for name, row in {
        "coulomb": [0.0, 0.3, np.inf],
        "limit": [0.0, 0.3, 0.4],
        "adhesion": [0.2, 0.3, np.inf],
        "all": [0.2, 0.3, 0.5],
        "tresca": [0.6, 0.0, 0.6],
    }.items():
        law = law_of(name)
        assert law.dtype == np.float64
        np.testing.assert_array_equal(law, row)
    sticky = contact_law(Contact("a", "b", friction=0.0, adhesion=0.2)).row
    np.testing.assert_array_equal(sticky, [0.2, 0.0, np.inf])


@cases
def test_projection_is_that_of_numpy(name, bilateral, d):
    seen = set()
    for normal, tau in zip(*draws(d), strict=True):
        p, derivative, status = compiled(name, bilateral, normal, tau)
        expected = numpy_projection(name, bilateral, normal, tau)
        np.testing.assert_allclose(p, expected[0], atol=1e-14)
        np.testing.assert_allclose(derivative, expected[1], atol=1e-13)
        assert status == expected[2]
        limited = np.linalg.norm(split(normal, p)[1]) > limit_of(name) * (1.0 - 1e-12)
        seen.add((status, bool(tau @ normal > 0.0), bool(limited)))
    always = bilateral or name == "tresca"
    assert {s for s, _, _ in seen} == ({STICK, SLIP} if always else {OPEN, STICK, SLIP})
    if name in ("limit", "all"):
        assert {(SLIP, False, False), (SLIP, False, True)} <= seen
    if name == "tresca":
        assert len({(s, tension) for s, tension, _ in seen}) == 4
    # without pressure nothing but adhesion holds
    assert ((STICK, True, False) in seen) == (name == "tresca" or "adhesion" in LAWS[name])


@cases
def test_derivative_is_that_of_differences(name, bilateral, d):
    """Away from the kinks: where the derivative changes little between the two ends of the difference."""
    h, n_compared = 1e-5, 0
    for normal, tau in zip(*draws(d), strict=True):
        derivative = compiled(name, bilateral, normal, tau)[1]
        ends = [[compiled(name, bilateral, normal, tau + s * h * e) for s in (1, -1)] for e in np.eye(d)]
        if max(np.abs(end[1] - derivative).max() for pair in ends for end in pair) > 1e-2:
            continue
        slope = np.column_stack([(plus[0] - minus[0]) / (2.0 * h) for plus, minus in ends])
        np.testing.assert_allclose(derivative, slope, atol=1e-6)
        n_compared += 1
    assert n_compared > 250


@cases
def test_projection_is_the_closest_admissible_traction(name, bilateral, d):
    """Bound respected; nothing admissible is closer; a projected traction stays where it is."""
    law = LAWS[name]
    rng = np.random.default_rng(8)
    for normal, tau in zip(*draws(d), strict=True):
        p, _, status = compiled(name, bilateral, normal, tau)
        p_n, p_t = split(normal, p)
        tau_n, tau_t = split(normal, tau)
        assert p_n == pytest.approx(tau_n if bilateral else min(tau_n, 0.0), abs=1e-14)
        if status == OPEN:
            assert np.all(p == 0.0)
            continue
        if "tresca" in law:
            rho = law["tresca"]
        else:
            rho = min(max(law.get("adhesion", 0.0) - law["friction"] * tau_n, 0.0), limit_of(name))
        assert np.linalg.norm(p_t) <= rho + 1e-14
        if status == STICK:
            np.testing.assert_allclose(p_t, tau_t, atol=1e-14)
        else:
            assert np.linalg.norm(p_t) == pytest.approx(rho, abs=1e-14)
            assert p_t @ tau_t == pytest.approx(np.linalg.norm(p_t) * np.linalg.norm(tau_t), abs=1e-13)
        for _ in range(5):
            other = split(normal, rng.normal(size=d))[1]
            other *= rho * rng.random() / np.linalg.norm(other)
            assert (tau_t - p_t) @ (other - p_t) <= 1e-14
        np.testing.assert_allclose(compiled(name, bilateral, normal, p)[0], p, atol=1e-15)


@cases
def test_projection_does_not_expand(name, bilateral, d):
    """|dP_T| <= |dtau_T| + F |dtau_n|; firmly non-expansive where the bound is fixed."""
    normals, tau = draws(d)
    rng = np.random.default_rng(9)
    factor = LAWS[name].get("friction", 0.0)
    for normal, a in zip(normals, tau, strict=True):
        b = a + rng.normal(size=d) * 10.0 ** rng.uniform(-3, 0)
        p, q = (compiled(name, bilateral, normal, tau)[0] for tau in (a, b))
        step, change = b - a, q - p
        if name in CONVEX:
            assert change @ step >= change @ change - 1e-13
        (step_n, step_t), (change_n, change_t) = split(normal, step), split(normal, change)
        assert abs(change_n) <= abs(step_n) + 1e-14
        assert np.linalg.norm(change_t) <= np.linalg.norm(step_t) + factor * abs(step_n) + 1e-14


@pytest.mark.parametrize("d", [2, 3])
def test_kinks(d):
    """tau_n = 0 is closed, |tau_T| = rho sticks; numbers without rounding."""
    normal, along, one = np.eye(d)[-1], np.eye(d)[0], np.eye(d)
    nn = np.outer(normal, normal)
    half = np.array([0.0, 0.5, np.inf])
    fixed = np.array([5.0, 0.0, 5.0])
    capped = np.array([0.0, 0.5, 5.0])
    sticky = np.array([1.0, 0.5, np.inf])
    p, derivative = np.empty(d), np.empty((d, d))

    def at(law, tau, bilateral=False):
        p[:], derivative[:], status = projected(law, bilateral, normal, np.ascontiguousarray(tau))
        assert np.all(np.isfinite(p)) and np.all(np.isfinite(derivative))
        return status

    for law in (half, fixed, capped):
        # nothing at all: tied, so that the first tangent holds bodies that just touch
        assert at(law, np.zeros(d)) == STICK
        np.testing.assert_array_equal(p, 0.0)
        np.testing.assert_array_equal(derivative, one)
        # on the cone
        tau = 5.0 * along - 10.0 * normal
        assert at(law, tau) == STICK
        np.testing.assert_array_equal(p, tau)
        np.testing.assert_array_equal(derivative, one)
        # no slip, under pressure
        assert at(law, -3.0 * normal) == STICK
        np.testing.assert_array_equal(derivative, one)
    # no pressure, but a tangential traction: closed, slips, and none of it is left
    for bilateral in (False, True):
        assert at(half, 2.0 * along, bilateral) == SLIP
        np.testing.assert_array_equal(p, 0.0)
        np.testing.assert_array_equal(derivative, nn - 0.5 * np.outer(along, normal))
    # at the limit: it counts as not yet limited
    assert at(capped, 8.0 * along - 10.0 * normal) == SLIP
    np.testing.assert_array_equal(p, 5.0 * along - 10.0 * normal)
    turn = 5.0 / 8.0 * (one - nn - np.outer(along, along))
    np.testing.assert_allclose(derivative, nn + turn - 0.5 * np.outer(along, normal), atol=1e-15)
    # a fixed bound holds where the point is open, too
    assert at(fixed, 3.0 * along + normal) == STICK
    np.testing.assert_array_equal(p, 3.0 * along)
    np.testing.assert_array_equal(derivative, one - nn)
    # an adhesion fades in tension
    assert at(sticky, 2.0 * along + normal) == SLIP
    np.testing.assert_array_equal(p, 0.5 * along)
    assert at(sticky, 2.0 * along + 2.5 * normal) == OPEN
    np.testing.assert_array_equal(p, 0.0)
    assert at(half, 1e-300 * normal) == OPEN
    np.testing.assert_array_equal(derivative, 0.0)


def test_nothing_is_undefined_for_numbers_near_zero():
    """Squares of tiny numbers vanish; lengths of zero divide nothing."""
    normal = np.array([0.6, 0.0, 0.8])
    values = [0.0, 1e-300, -1e-300, 1e-160, -1e-160, 1.0, -1.0]
    for name in LAWS:
        for a in values:
            for b in values:
                for bilateral in (False, True):
                    p, derivative, _ = compiled(name, bilateral, normal, np.array([a, b, a]))
                    assert np.all(np.isfinite(p)) and np.all(np.isfinite(derivative))


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_a_coefficient_at_each_point(d, bilateral, monkeypatch):
    """Traction and derivative are those of numpy with the coefficient of the point, and of differences."""
    said = {"friction": "0.2 + x**2", "kinetic_friction": 0.1, "friction_decay": 3.0, "friction_limit": 0.4}
    law, (normal, tau) = contact_law(Contact("a", "b", **said)), draws(d)
    rng = np.random.default_rng(5)
    x, slip = rng.random((len(tau), d)), rng.normal(size=(len(tau), d))
    assert law.begin(x, 0.0) == pytest.approx(0.2 + np.max(x[:, 0]) ** 2, rel=1e-14)
    law.slid(slip, np.full(len(tau), SLIP), 0.5)
    law.begin(x, 1.0)
    factors = 0.1 + (0.1 + x[:, 0] ** 2) * np.exp(-3.0 * np.linalg.norm(slip, axis=1) / 0.5)
    view, slope = View(np.ones(len(tau), dtype=bool), bilateral, False), np.zeros((len(tau), d, d))
    traction, status = law.project(view, normal, tau, slope)
    for k, factor in enumerate(factors):
        monkeypatch.setitem(LAWS, "limit", {"friction": factor, "friction_limit": 0.4})
        p, derivative, expected = numpy_projection("limit", bilateral, normal[k], tau[k])
        np.testing.assert_allclose(traction[k], p, atol=1e-14)
        np.testing.assert_allclose(slope[k], derivative, atol=1e-13)
        assert status[k] == expected
    h, difference, smooth = 1e-5, np.empty_like(slope), np.ones(len(tau), dtype=bool)
    for j, e in enumerate(np.eye(d)):
        slopes = np.zeros((2, *slope.shape))
        ahead = law.project(view, normal, tau + h * e, slopes[0])[0]
        back = law.project(view, normal, tau - h * e, slopes[1])[0]
        difference[:, :, j] = (ahead - back) / (2.0 * h)
        smooth &= np.abs(slopes - slope).max(axis=(0, 2, 3)) <= 1e-2
    np.testing.assert_allclose(difference[smooth], slope[smooth], atol=1e-6)
    assert np.sum(smooth) > 250
    # what sticks or is open is slow
    law.slid(slip, np.where(status == SLIP, STICK, OPEN), 0.5)
    assert not law.speed.any()
