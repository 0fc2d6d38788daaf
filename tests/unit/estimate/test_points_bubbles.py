"""Test functions of the local problems."""

import numpy as np
import pytest

from pcontact.element.reference import CELLS, reference_nodes
from pcontact.estimate.points import bubbles, supports

SOLIDS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", SOLIDS)
def test_bubbles(cell, degree):
    """They vanish at the nodes, their gradients are those of their values, they are independent."""
    dim = CELLS[cell].dim
    assert np.abs(bubbles(cell, degree, reference_nodes(cell, degree))[0]).max() < 1e-14
    xi = np.random.default_rng(1).uniform(0.05, 0.3, (60, dim))
    values, gradients = bubbles(cell, degree, xi)
    assert np.linalg.matrix_rank(values) == values.shape[1]
    for axis in range(dim):
        step = 1e-6 * np.eye(dim)[axis]
        slope = (bubbles(cell, degree, xi + step)[0] - bubbles(cell, degree, xi - step)[0]) / 2e-6
        assert np.abs(slope - gradients[:, :, axis]).max() < 1e-8
    on = supports(cell, degree)
    # one on the middle of an edge lives on the facets around the edge, and nowhere else
    assert on.shape == (values.shape[1], len(CELLS[cell].facets))
    assert on.any(axis=0).all() and not on.all(axis=1).any()
