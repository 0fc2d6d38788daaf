"""Von Mises plasticity: kernels against plain tensors, tangents against differences, and what has a closed form."""

import itertools

import numpy as np
import pytest

from pcontact.material.elastic import add_elastic_tangent, lame
from pcontact.material.hardening import flow_length, hardening_curve, hardening_table, yield_radius
from pcontact.material.plastic import plastic_constants, return_map, second_derivative, thickness_strain
from pcontact.runtime.jit import njit
from tests.support.plastic import (
    LAME,
    MATERIALS,
    POISSON,
    ROOT,
    TABLE,
    YIELD,
    YIELD_STRAIN,
    YOUNG,
    Point,
    mandel,
    tensor,
)

MODES = ["3D", "plane strain", "axisymmetric", "plane stress"]

every_mode = pytest.mark.parametrize("mode", MODES)
every_material = pytest.mark.parametrize("material", list(MATERIALS))


# -- plain tensors, in engineering terms ------------------


def yield_stress(curve, p):
    row = curve[curve[:, 0] <= p][-1]
    return row[1] + row[2] * (p - row[0])


def bisect(f, low, high):
    """Root of an increasing function."""
    while low < (middle := 0.5 * (low + high)) < high and high - low > 1e-18:
        low, high = (low, middle) if f(middle) > 0.0 else (middle, high)
    return middle


def solid(constants, curve, strain, plastic, p):
    """Stress, plastic strain (3, 3) and p by the equivalent stress and bisection, in three dimensions."""
    lam, mu, back = constants
    elastic = strain - plastic
    stress = lam * np.trace(elastic) * np.eye(3) + 2.0 * mu * elastic
    relative = stress - np.trace(stress) / 3.0 * np.eye(3) - 2.0 / 3.0 * back * plastic
    equivalent = np.sqrt(1.5 * (relative**2).sum())
    if equivalent <= yield_stress(curve, p):
        return stress, plastic, p
    increment = bisect(
        lambda d: yield_stress(curve, p + d) + (3.0 * mu + back) * d - equivalent, 0.0, equivalent / (3.0 * mu)
    )
    flow = increment * 1.5 * relative / equivalent
    return stress - 2.0 * mu * flow, plastic + flow, p + increment


def twin(constants, curve, mode, strain, plastic, p):
    """Mandel stress, plastic strain, p and strain 33; in plane stress the latter is found by bisection."""
    m = len(strain)
    t, plastic = tensor(strain), tensor(plastic)
    if mode == "plane stress":

        def stress_33(e):
            t[2, 2] = e
            return solid(constants, curve, t, plastic, p)[0][2, 2]

        size = 10.0 * (abs(t).max() + abs(plastic).max())
        t[2, 2] = bisect(stress_33, -size, size)
    stress, plastic, p = solid(constants, curve, t, plastic, p)
    return mandel(stress, m), mandel(plastic, m), p, t[2, 2]


# -- kernels ----------------------------------------------


def random_strain(rng, mode, size):
    """Strain of about ``size`` yield strains."""
    strain = size * YIELD_STRAIN * rng.normal(size=6 if mode == "3D" else 4)
    if mode in ("plane strain", "plane stress"):
        strain[2] = 0.0
    return strain


def yielded(material, mode, seed=0, size=3.0):
    """A point that has yielded before, and a strain at which it yields again."""
    rng = np.random.default_rng(seed)
    point = Point(material, mode)
    while not point.move(random_strain(rng, mode, size))[1]:
        pass
    while True:
        strain = random_strain(rng, mode, size)
        if point.flows(strain):
            return point, strain


@every_mode
@every_material
def test_against_tensors(material, mode):
    rng = np.random.default_rng(1)
    point, crossed, seen = Point(material, mode), 0, set()
    for size in [0.1, 0.1, 0.8, 8, 0.5, 5, 1, 10, 3, 0.3, 30]:
        strain = random_strain(rng, mode, size)
        before = point.p
        stress, plastic, p, across = twin(*point.material[:2], mode, strain, point.plastic, point.p)
        found, yields = point.move(strain)
        scale = abs(stress).max()
        np.testing.assert_allclose(found, stress, rtol=0, atol=1e-11 * scale)
        np.testing.assert_allclose(point.plastic, plastic, rtol=0, atol=1e-12 * size * YIELD_STRAIN)
        np.testing.assert_allclose(point.p, p, rtol=1e-10, atol=1e-17)
        assert yields == (p > before)
        seen.add(yields)
        crossed = max(crossed, np.sum((point.material.curve[:, 0] > before) & (point.material.curve[:, 0] < p)))
        if mode == "plane stress":
            assert found[2] == 0.0
            found_across = thickness_strain(point.material.constants, strain, point.plastic)
            np.testing.assert_allclose(found_across, across, rtol=1e-9, atol=1e-16)
    assert seen == {False, True}
    assert crossed >= 2 or "table" not in material


@every_mode
def test_no_excess_before_yield(mode):
    point = Point("linear+kinematic", mode)
    strain = random_strain(np.random.default_rng(2), mode, 0.1)
    excess, plastic, p, yields, tangent = point.raw(strain)
    assert not yields and p == 0.0
    assert not excess.any() and not plastic.any() and not tangent.any()


@every_mode
@every_material
@pytest.mark.parametrize("state", ["virgin", "yielded", "elastic", "surface"])
def test_tangent(material, mode, state):
    rng = np.random.default_rng(3)
    point, strain = yielded(material, mode)
    if state == "virgin":
        point = Point(material, mode)
    elif state == "elastic":
        point.move(strain)
        strain = strain - 0.2 * YIELD_STRAIN * (strain - point.plastic) / np.linalg.norm(strain - point.plastic)
    elif state == "surface":
        point.move(strain)
    assert point.flows(strain) == (state in ("virgin", "yielded"))
    direction = random_strain(rng, mode, 1.0)
    if state == "surface":
        # on the side where it stays elastic
        relative = point.relative(point.stress(strain))
        direction = 0.5 * direction - 5.0 * YIELD_STRAIN * mandel(relative, point.m) / np.linalg.norm(relative)
        elastic = np.zeros((point.m, point.m))
        add_elastic_tangent(point.material.constants, point.material.plane_stress, elastic)
        np.testing.assert_array_equal(point.tangent(strain), elastic)
    tangent = point.tangent(strain)
    np.testing.assert_allclose(tangent, tangent.T, rtol=0, atol=1e-14 * abs(tangent).max())
    stress, steps = point.stress(strain), np.array([4e-3, 2e-3])
    remainder = [np.linalg.norm(point.stress(strain + h * direction) - stress - h * tangent @ direction) for h in steps]
    noise = 1e-13 * np.linalg.norm(stress)
    if point.flows(strain):
        assert remainder[0] > noise
        assert 3.6 < remainder[0] / remainder[1] < 4.4
    else:
        assert max(remainder) < noise


@every_mode
@every_material
def test_second_derivative(material, mode):
    point, strain = yielded(material, mode, seed=4)
    m = point.m
    rng = np.random.default_rng(5)
    weight, work, second = rng.normal(size=m), np.empty((2, m)), np.full((m, m), np.inf)
    assert second_derivative(point.material, strain, point.plastic, point.p, weight, work, second)
    expected, h = np.empty((m, m)), 1e-4 * YIELD_STRAIN
    for i, e in enumerate(np.eye(m)):
        difference = point.raw(strain + h * e)[4] - point.raw(strain - h * e)[4]
        expected[i] = weight @ difference / (2.0 * h)
    np.testing.assert_allclose(second, expected, rtol=0, atol=1e-6 * abs(expected).max())
    kept = second.copy()
    assert not second_derivative(point.material, 0.0 * strain, np.zeros(m), point.p, weight, work, second)
    np.testing.assert_array_equal(second, kept)


@pytest.mark.parametrize("mode", ["3D", "axisymmetric", "plane stress"])
@pytest.mark.parametrize("hardening, kinematic", [(0.0, 0.0), (20.0, 0.0), (0.0, 30.0), (20.0, 30.0)])
def test_uniaxial(mode, hardening, kinematic):
    """Pulled, unloaded, pressed beyond yield: a bar's closed form, where the kinematic part lowers the second yield."""
    point = Point((plastic_constants(*LAME, kinematic), hardening_curve(YIELD, hardening)), mode)

    def strain_of(stress, plastic):
        axial, lateral = stress / YOUNG + plastic, -POISSON * stress / YOUNG - plastic / 2.0
        return np.array([axial, lateral, lateral] + [0.0] * (point.m - 3))

    def expect(stress, plastic, p, yields):
        found, found_yields = point.move(strain_of(stress, plastic))
        np.testing.assert_allclose(found[0], stress, rtol=0, atol=1e-13)
        np.testing.assert_allclose(found[1:], 0.0, rtol=0, atol=1e-13)
        np.testing.assert_allclose([point.plastic[0], point.p], [plastic, p], rtol=0, atol=1e-15)
        assert found_yields == yields

    expect(0.999 * YIELD, 0.0, 0.0, False)
    for e in (0.002, 0.01):
        expect(YIELD + (hardening + kinematic) * e, e, e, True)
    top = YIELD + (hardening + kinematic) * e
    expect(0.0, e, e, False)
    second = top - 2.0 * (YIELD + hardening * e)
    assert kinematic == 0.0 or abs(second) < top
    expect(second + 1e-6, e, e, False)
    expect(top - 1e-6, e, e, False)
    back = 0.004
    expect(second - (hardening + kinematic) * back, e - back, e + back, True)


@every_mode
def test_uniaxial_table(mode):
    """Points of the table are met wherever the steps end, in pure shear."""
    for steps in ([0.0035, 0.0151, 0.03], [0.03]):
        point = Point("table", mode)
        for p in steps:
            stress = np.interp(p, *np.transpose(TABLE))
            strain = np.zeros(point.m)
            strain[3] = ROOT * (stress / np.sqrt(3.0) / (2.0 * LAME[1]) + np.sqrt(0.75) * p)
            found, _ = point.move(strain)
            np.testing.assert_allclose(found, np.eye(point.m)[3] * ROOT * stress / np.sqrt(3.0), rtol=1e-13, atol=1e-15)
            np.testing.assert_allclose(point.p, p, rtol=1e-13)


@every_mode
@every_material
def test_on_the_yield_surface(material, mode):
    """After every step, deviatoric plastic strain, a stress on the surface, and a state that counts as elastic."""
    rng, point = np.random.default_rng(6), Point(material, mode)
    strain = np.zeros(point.m)
    for size in np.tile([0.1, 0.5, 2.0, 10.0], 30):
        strain = strain + random_strain(rng, mode, size)
        stress, yields = point.move(strain)
        assert abs(point.plastic[:3].sum()) <= 1e-15 * abs(point.plastic).max()
        radius = yield_radius(point.material.curve, point.p)
        kinematic = point.material.constants[2]
        size = 2.0 * LAME[1] * abs(strain).max() + (2.0 * LAME[1] + kinematic) * abs(point.plastic).max()
        if yields:
            assert abs(np.linalg.norm(point.relative(stress)) - radius) < 4e-15 * (radius + size)
        assert not point.flows(strain)
        again, yields = point.move(strain)
        assert not yields
        np.testing.assert_array_equal(again, stress)


@every_mode
def test_perfect_plasticity(mode):
    rng, point = np.random.default_rng(7), Point("perfect", mode)
    for _ in range(200):
        stress, yields = point.move(random_strain(rng, mode, 3.0))
        if yields:
            assert abs(np.linalg.norm(point.relative(stress)) / yield_radius(point.material.curve, 0.0) - 1.0) < 1e-14


@every_mode
def test_exactly_on_the_surface(mode):
    """Numbers without rounding: the shear that reaches the yield surface is elastic, the next larger flows."""
    point = Point((np.array([1.0, 0.5, 0.0]), hardening_curve(1.0)), mode)
    strain = np.zeros(point.m)
    strain[3] = yield_radius(point.material.curve, 0.0)
    assert not point.flows(strain)
    strain[3] *= 1.0 + 1e-13
    assert point.flows(strain)


def test_no_deviator():
    """Pressure alone never yields, even where the yield surface is a point."""
    for yield_limit in (YIELD, 0.0):
        point = Point((plastic_constants(*LAME), hardening_curve(yield_limit)), "3D")
        stress, yields = point.move(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        assert not yields
        np.testing.assert_allclose(stress[:3], 3.0 * LAME[0] + 2.0 * LAME[1])


@every_mode
@every_material
@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_units(material, mode, unit):
    point, strain = yielded(material, mode, seed=8)
    constants, curve = point.material.constants * unit, point.material.curve * [1.0, unit, unit]
    other = Point((constants, curve), mode, point.plastic, point.p)
    excess, plastic, p, yields, tangent = point.raw(strain)
    for found, expected in zip(other.raw(strain), (excess * unit, plastic, p, yields, tangent * unit), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * np.max(np.abs(expected)))


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.499])
@pytest.mark.parametrize("material", list(MATERIALS))
def test_plane_stress_iterations(material, poisson):
    """Newton's method takes few steps however far the strain, and the result solves the equation to rounding."""
    constants, curve = MATERIALS[material]
    lam, mu = lame(YOUNG, poisson)
    back, mean = 2.0 / 3.0 * constants[2], YOUNG / (1.0 - poisson)
    stiff_a, stiff_b = mean / 3.0 + back, 2.0 * mu + back
    for size, angle in itertools.product([1.0001, 1.5, 10.0, 100.0, 1e6], np.linspace(0.0, np.pi / 2, 13)):
        trial = size * yield_radius(curve, 0.0)
        square_a, square_b = (trial * np.cos(angle)) ** 2, (trial * np.sin(angle)) ** 2
        x, radius, slope, count = flow_length(curve, 0.0, square_a, square_b, stiff_a, stiff_b)
        assert count <= 6
        left = square_a / (radius + stiff_a * x) ** 2 + square_b / (radius + stiff_b * x) ** 2
        assert abs(left - 1.0) < 1e-14
        np.testing.assert_allclose(radius, yield_radius(curve, np.sqrt(2.0 / 3.0) * x), rtol=1e-12)


@pytest.mark.parametrize("value", [1e300, np.nan])
def test_plane_stress_does_not_read_33(value):
    point, strain = yielded("table+kinematic", "plane stress")
    expected, stress = point.raw(strain), point.stress(strain)
    strain[2] = value
    for found, before in zip(point.raw(strain), expected, strict=True):
        np.testing.assert_array_equal(found, before)
    np.testing.assert_array_equal(point.stress(strain), stress)


@every_mode
@pytest.mark.parametrize("material", ["perfect", "table+kinematic"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_not_a_number(material, mode, value):
    for k in range(4):
        point, strain = yielded(material, mode)
        if k == 2 and mode == "plane stress":
            continue
        strain[k] = value
        excess, _, p, yields, _ = point.raw(strain)
        assert yields and not np.isfinite(p) and np.isnan(excess).any()
    point, strain = yielded(material, mode)
    excess, _, p, _, _ = Point(material, mode, point.plastic, np.nan).raw(strain)
    assert np.isnan(p) and np.isnan(excess).any()


def test_one_curve_many_ways():
    """A table of collinear points is a line; a line is a table as far as it goes."""
    np.testing.assert_array_equal(hardening_curve(0.5, 20.0), [[0.0, 0.5, 20.0]])
    np.testing.assert_allclose(hardening_table(TABLE)[:, 2], [50.0, 50.0 / 3.0, 90.0, 5.0, 0.0])
    line = hardening_table([[p, 0.5 + 20.0 * p] for p in (0.0, 0.001, 0.004, 0.3, 1.0)])
    constants = plastic_constants(*LAME, 15.0)
    for mode in MODES:
        for seed in range(5):
            point, strain = yielded("linear+kinematic", mode, seed, 10.0)
            other = Point((constants, line), mode, point.plastic, point.p)
            for found, expected in zip(other.raw(strain), point.raw(strain), strict=True):
                np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * np.max(np.abs(expected)))


@njit
def _many(material, strain, plastic, p, excess):
    """Commits all points in place; number of those that yielded."""
    tangent, count = np.empty((strain.shape[1], strain.shape[1])), 0
    for i in range(strain.shape[0]):
        p[i], yields = return_map(material, strain[i], plastic[i], p[i], False, plastic[i], excess[i], tangent)
        count += yields
    return count


@every_mode
def test_in_a_loop_and_in_place(mode):
    """Called from a compiled kernel, the new state written over the old one; its trace does not drift."""
    rng = np.random.default_rng(9)
    point = Point("table+kinematic", mode)
    plastic, p, excess = np.zeros((2, point.m)), np.zeros(2), np.empty((2, point.m))
    yields = 0
    for _ in range(300):
        strain = random_strain(rng, mode, 3.0)
        yields += _many(point.material, np.stack([strain, strain]), plastic, p, excess)
        point.move(strain)
    assert yields > 300
    np.testing.assert_array_equal(plastic, [point.plastic, point.plastic])
    np.testing.assert_array_equal(p, [point.p, point.p])
    assert abs(plastic[:, :3].sum(axis=1)).max() <= 1e-15 * abs(plastic).max()


@pytest.mark.parametrize("mode", MODES[:3])
def test_one_step_from_a_virgin_state_is_a_projection(mode):
    """Stress from the total strain, the yield function in the Frobenius norm: sqrt(3/2) and 3/2 of its constants."""
    radius, xi, (lam, mu) = 0.4, 30.0, LAME
    point = Point((plastic_constants(lam, mu), hardening_curve(np.sqrt(1.5) * radius, 1.5 * xi)), mode)
    strain = mandel(YIELD_STRAIN * np.array([[2.0, 0.7, 0.0], [0.7, -1.0, 0.0], [0.0, 0.0, 0.3]]), point.m)
    trial = lam * np.trace(tensor(strain)) * np.eye(3) + 2.0 * mu * tensor(strain)
    deviator = trial - np.trace(trial) / 3.0 * np.eye(3)
    size = np.linalg.norm(deviator)
    assert size > radius
    known = trial - 2.0 * mu / (2.0 * mu + xi) * (size - radius) * deviator / size
    assert tensor(point.stress(strain)) == pytest.approx(known, abs=1e-13)
