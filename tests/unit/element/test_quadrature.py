"""Quadrature of reference cells."""

import itertools
from math import factorial, prod

import numpy as np
import pytest

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS

SOLID = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
ALL = ["segment", *SOLID]


@pytest.mark.parametrize("cell", ALL)
@pytest.mark.parametrize("degree", range(21))
def test_quadrature(cell, degree):
    points, weights = quadrature(cell, degree)
    dim, tensor = CELLS[cell].dim, CELLS[cell].is_tensor
    assert (weights > 0).all()
    if tensor:
        assert (np.abs(points) < 1).all() and len(weights) == (degree // 2 + 1) ** dim
    else:
        assert (points > 0).all() and (points.sum(axis=1) < 1).all()
    powers = np.array(list(itertools.product(range(degree + 1), repeat=dim)))
    powers = powers if tensor else powers[powers.sum(axis=1) <= degree]
    powers = powers[:: max(1, len(powers) // 400)]
    computed = weights @ (points[:, None, :] ** powers).prod(axis=2)
    if tensor:
        expected = [prod((1 + (-1) ** int(k)) / (k + 1) for k in p) for p in powers]
    else:
        expected = [prod(factorial(int(k)) for k in p) / factorial(int(p.sum()) + dim) for p in powers]
    np.testing.assert_allclose(computed, expected, rtol=1e-12, atol=1e-15)


def test_quadrature_counts():
    counts = [len(quadrature("triangle", d)[1]) for d in range(1, 10)]
    assert counts == [1, 3, 6, 6, 7, 12, 15, 16, 19]
    assert [len(quadrature("tetrahedron", d)[1]) for d in range(1, 7)] == [1, 4, 8, 14, 14, 24]


@pytest.mark.parametrize("degree", range(1, 21))
def test_rules_of_triangles_are_symmetric(degree):
    """However the vertices are numbered, the points and their weights are the same."""
    points, weights = quadrature("triangle", degree)
    rule = np.column_stack([1.0 - points.sum(axis=1), points, weights])
    for order in itertools.permutations(range(3)):
        away = np.abs(rule[:, None] - rule[:, [*order, 3]]).max(axis=2)
        assert np.all(np.sum(away < 1e-13, axis=1) == 1)
