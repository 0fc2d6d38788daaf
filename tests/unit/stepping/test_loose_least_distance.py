"""The nearest point of a convex set of half spaces."""

import numpy as np
import pytest

from pcontact.stepping.loose import least_squares_of_positive, nearest_point


def test_nearest_point():
    """A half space, a corner, bounds that are met already, and bounds that contradict each other by little."""
    np.testing.assert_allclose(nearest_point(np.array([[3.0, 4.0]]), np.array([10.0])), [1.2, 1.6], rtol=1e-9)
    np.testing.assert_allclose(nearest_point(np.eye(2), np.array([1.0, 2.0])), [1.0, 2.0], rtol=1e-9)
    np.testing.assert_allclose(nearest_point(np.eye(2), np.array([1.0, -5.0])), [1.0, 0.0], atol=1e-9)
    assert not nearest_point(np.eye(2), np.array([-1.0, 0.0])).any()
    squeezed = nearest_point(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]), np.array([1.0, -1.0 + 1e-9, 2.0]))
    np.testing.assert_allclose(squeezed, [1.0, 2.0], rtol=2e-9)


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_the_nearest_point_does_not_depend_on_units(unit):
    """A motion of a body may be a number of any size, as may the distances that it changes."""
    rng = np.random.default_rng(8)
    rows, bounds = rng.normal(size=(9, 4)) + 0.5, rng.normal(size=9) + 1.0
    one = nearest_point(rows, bounds)
    assert np.min(rows @ one - bounds) > -1e-9
    np.testing.assert_allclose(nearest_point(unit * rows, bounds) * unit, one, rtol=1e-9)
    np.testing.assert_allclose(nearest_point(rows, unit * bounds) / unit, one, rtol=1e-9)


def test_nearest_point_of_many_half_spaces():
    """First-order conditions: a combination of the bounds that are met as equalities, with factors that push."""
    rng = np.random.default_rng(5)
    rows, bounds = rng.standard_normal((40, 6)) + [2.0, 0, 0, 0, 0, 0], rng.uniform(-1.0, 1.0, 40)
    x = nearest_point(rows, bounds)
    left = rows @ x - bounds
    assert left.min() > -1e-9
    tight = left < 1e-8
    factors = least_squares_of_positive(rows[tight].T, x)
    np.testing.assert_allclose(rows[tight].T @ factors, x, atol=1e-8)
