"""Tables of shape functions that are kept."""

import numpy as np
import pytest

from pcontact.element import reference as module
from pcontact.element.reference import CELLS, shape, shape_gradient


@pytest.mark.parametrize("table", [shape, shape_gradient])
def test_tables_of_few_points_are_those_of_many(table):
    """Rows of points that are not kept, whatever cell and degree the last points were of."""
    for cell in ("triangle", "quadrilateral8", "tetrahedron", "wedge", "pyramid"):
        xi = np.random.default_rng(1).uniform(0.0, 0.3, (module.FEW + 1, CELLS[cell].dim))
        for degree in (1, 2, 1):
            many, few = table(cell, degree, xi), table(cell, degree, xi[:7])
            assert few is table(cell, degree, xi[:7].copy()) and few is not table(cell, degree, xi[1:8])
            assert few == pytest.approx(many[:7], abs=1e-14)


def test_wrong_points_are_told():
    with pytest.raises(ValueError, match="expected"):
        shape("triangle", 1, np.zeros((4, 3)))
    with pytest.raises(ValueError, match="degree"):
        shape("triangle", 3, np.zeros((4, 2)))
