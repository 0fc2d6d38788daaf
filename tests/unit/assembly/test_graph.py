"""Graphs of nodes, joined patterns, products."""

import numpy as np
import pytest

from pcontact.assembly.graph import find, multiply, multiply_magnitudes, node_graph
from pcontact.assembly.matrix import positions, union
from tests.support.small import dense


def test_node_graph_and_find():
    rng = np.random.default_rng(0)
    tables = [np.array([rng.permutation(12)[:4] for _ in range(5)]), np.array([rng.permutation(12)[:3]])]
    rowptr, columns = node_graph(tables, 14)
    expected = np.zeros((14, 14), dtype=bool)
    for table in tables:
        expected[table[:, :, None], table[:, None, :]] = True
    found = np.zeros_like(expected)
    found[np.repeat(np.arange(14), np.diff(rowptr)), columns] = True
    np.testing.assert_array_equal(found, expected)
    assert len(columns) == expected.sum()
    for row in range(14):
        part = columns[rowptr[row] : rowptr[row + 1]]
        assert np.all(np.diff(part) > 0)
        for value in range(14):
            k = find(columns, rowptr[row], rowptr[row + 1], value)
            assert (k >= 0) == expected[row, value] and (k < 0 or columns[k] == value)


@pytest.mark.parametrize("tables", [[], [np.zeros((0, 4), dtype=np.int64)]])
def test_node_graph_of_nothing(tables):
    rowptr, columns = node_graph(tables, 3)
    np.testing.assert_array_equal(rowptr, [0, 0, 0, 0])
    assert len(columns) == 0
    rowptr, columns = node_graph(tables, 0)
    np.testing.assert_array_equal(rowptr, [0])


def test_union_and_positions():
    rng = np.random.default_rng(1)
    masks = [rng.random((6, 9)) < 0.3, rng.random((6, 9)) < 0.2]
    masks[0][2], masks[1][2] = False, False
    patterns = [(np.concatenate([[0], np.cumsum(m.sum(axis=1))]), np.nonzero(m)[1]) for m in masks]
    rowptr, columns = union(*patterns[0], *patterns[1])
    either = masks[0] | masks[1]
    np.testing.assert_array_equal(columns, np.nonzero(either)[1])
    np.testing.assert_array_equal(np.diff(rowptr), either.sum(axis=1))
    for ptr, cols in patterns:
        at = positions(ptr, cols, rowptr, columns)
        np.testing.assert_array_equal(columns[at], cols)
        rows = np.repeat(np.arange(6), np.diff(ptr))
        assert np.all((at >= rowptr[rows]) & (at < rowptr[rows + 1]))
    # an entry that the larger pattern lacks
    assert np.any(positions(rowptr, columns, *patterns[0]) == -1)


@pytest.mark.parametrize("d", [2, 3])
def test_multiply(d):
    rng = np.random.default_rng(2)
    rowptr, columns = node_graph([np.array([rng.permutation(7)[:4] for _ in range(3)])], 8)
    values, x = rng.normal(size=(len(columns), d, d)), rng.normal(size=(8, d))
    y = np.full((8, d), np.nan)
    multiply(rowptr, columns, values, x, y)
    np.testing.assert_allclose(y.ravel(), dense(rowptr, columns, values, 8) @ x.ravel(), atol=1e-13)
    multiply_magnitudes(rowptr, columns, values, x, y)
    np.testing.assert_allclose(y.ravel(), np.abs(dense(rowptr, columns, values, 8)) @ np.abs(x.ravel()), rtol=1e-13)
