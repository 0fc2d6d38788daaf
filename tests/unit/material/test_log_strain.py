"""Logarithmic strain: divided differences against many digits, eigenpairs, derivatives against differences."""

from decimal import Decimal, getcontext

import numpy as np
import pytest

from pcontact.material.log_strain import (
    add_curvature,
    axes_operator,
    compose,
    eigenpairs,
    log_difference,
    log_difference_2,
    slopes,
    twice_green,
    volume_change,
)
from tests.support.plastic import mandel, tensor

getcontext().prec = 70
GAPS = [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.03, 0.15, 1.0]


def first(a, b):
    a, b = Decimal(a), Decimal(b)
    return 1 / (1 + a) if a == b else ((1 + a).ln() - (1 + b).ln()) / (a - b)


def second(a, b, c):
    a, b, c = sorted((a, b, c))
    return -1 / (2 * (1 + Decimal(a)) ** 2) if a == c else (first(b, c) - first(a, b)) / (Decimal(c) - Decimal(a))


@pytest.mark.parametrize("base", [0.0, 1e-12, 1e-3, 0.3, -0.6, 5.0, 60.0])
def test_divided_differences(base):
    """To all digits, from equal numbers to those that are far apart."""
    rng = np.random.default_rng(3)
    for gap in GAPS:
        a, b, c = base, base + gap * rng.random(), base + gap * rng.random()
        assert abs(Decimal(log_difference(a, b)) / first(a, b) - 1) < 1e-15
        for triple in ((a, b, c), (c, a, b), (a, a, b), (b, a, b), (a, a, a)):
            assert abs(Decimal(log_difference_2(*triple)) / second(*triple) - 1) < 2e-14


def random_gradient(rng, size, m):
    h = size * rng.standard_normal((3, 3))
    if m == 4:
        h[2, :2] = h[:2, 2] = 0.0
    return h


@pytest.mark.parametrize("m", [6, 4])
@pytest.mark.parametrize("size", [1e-12, 1e-3, 1.0])
def test_eigenpairs(m, size):
    rng = np.random.default_rng(7)
    for _ in range(20):
        h = random_gradient(rng, size, m)
        a, values, vectors, back, axes = h + h.T, np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((m, m))
        eigenpairs(a.copy(), m, values, vectors)
        compose(values, vectors, back)
        np.testing.assert_allclose(back, a, rtol=0.0, atol=1e-14 * size)
        np.testing.assert_allclose(vectors.T @ vectors, np.eye(3), atol=1e-14)
        axes_operator(vectors, axes)
        np.testing.assert_allclose(axes @ axes.T, np.eye(m), atol=1e-14)
        x = random_gradient(rng, 1.0, m)
        x = x + x.T
        np.testing.assert_allclose(axes @ mandel(x, m), mandel(vectors.T @ x @ vectors, m), atol=1e-13)


def test_eigenpairs_of_equal_eigenvalues():
    for a in (np.zeros((3, 3)), 0.3 * np.eye(3), np.diag([0.2, 0.2, -0.1])):
        for m in (4, 6):
            values, vectors, back = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
            eigenpairs(a.copy(), m, values, vectors)
            compose(values, vectors, back)
            np.testing.assert_array_equal(back, a)


def test_volume_change_and_strain_of_small_gradients():
    """Of a gradient of 1e-9 all digits are there: C - I, and det F - 1, would have seven."""
    h = 1e-9 * np.arange(1.0, 10.0).reshape(3, 3) ** 1.5
    exact = [[Decimal(float(x)) for x in row] for row in h]
    f = [[x + (i == j) for j, x in enumerate(row)] for i, row in enumerate(exact)]
    det = sum(
        f[0][i] * (f[1][(i + 1) % 3] * f[2][(i + 2) % 3] - f[1][(i + 2) % 3] * f[2][(i + 1) % 3]) for i in range(3)
    )
    assert abs(Decimal(volume_change(h)) / (det - 1) - 1) < 1e-15
    green = np.zeros((3, 3))
    twice_green(h, green)
    c01 = sum(f[k][0] * f[k][1] for k in range(3))
    assert abs(Decimal(green[0, 1]) / c01 - 1) < 1e-15


def strain(g, m):
    """Mandel components of 1/2 log(I + 2 G)."""
    values, vectors = np.linalg.eigh(np.eye(3) + 2.0 * g)
    return mandel((vectors * (0.5 * np.log(values))) @ vectors.T, m)


@pytest.mark.parametrize("m", [6, 4])
def test_derivatives(m):
    """dE/dG and T : d2E/dG2 along any axes are those of differences of numpy's logarithm."""
    rng, size = np.random.default_rng(11), 1e-3
    for _ in range(5):
        h = random_gradient(rng, 0.25, m)
        g, t = 0.5 * (h + h.T + h.T @ h), rng.standard_normal(m)
        values, vectors, axes, f = np.zeros(3), np.zeros((3, 3)), np.zeros((m, m)), np.zeros(m)
        eigenpairs(2.0 * g, m, values, vectors)
        axes_operator(vectors, axes)
        slopes(values, f)
        first = axes.T @ np.diag(f) @ axes
        curvature = np.zeros((m, m))
        add_curvature(values, axes @ t, curvature)
        second = axes.T @ curvature @ axes
        np.testing.assert_allclose(second, second.T, atol=1e-13)
        for k in range(m):
            way = size * tensor(np.eye(m)[k])
            ends = [strain(g + s * way, m) for s in (-2, -1, 0, 1, 2)]
            slope = (ends[0] - 8 * ends[1] + 8 * ends[3] - ends[4]) / (12 * size)
            np.testing.assert_allclose(first[:, k], slope, atol=1e-8)
            bend = t @ (-ends[0] + 16 * ends[1] - 30 * ends[2] + 16 * ends[3] - ends[4]) / (12 * size**2)
            assert abs(second[k, k] - bend) < 1e-6 * max(1.0, abs(bend))
