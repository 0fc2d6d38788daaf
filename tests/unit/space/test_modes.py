"""Rigid modes, colours of bodies."""

import numpy as np
import pytest

from pcontact.space.modes import colour, rigid_modes


def test_colours():
    np.testing.assert_array_equal(colour(3, set()), [0, 0, 0])
    edges = {(0, 1), (2, 1), (3, 3), (0, 2)}
    colours = colour(4, edges)
    assert all(colours[a] != colours[b] for a, b in edges if a != b)
    assert colours.max() == 2 and colours[3] == 0
    # a chain needs two, whatever its length
    assert colour(20, {(k + 1, k) for k in range(19)}).max() == 1


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_modes(d):
    points = np.random.default_rng(0).normal(size=(9, d))
    modes = rigid_modes(points, points.mean(axis=0), 2.0)
    assert modes.shape == (3 if d == 2 else 6, 9, d)
    assert np.linalg.matrix_rank(modes.reshape(len(modes), -1)) == len(modes)
    # distances stay, to first order
    difference = points[:, None] - points[None]
    for mode in modes:
        np.testing.assert_allclose(np.sum(difference * (mode[:, None] - mode[None]), axis=2), 0.0, atol=1e-13)
