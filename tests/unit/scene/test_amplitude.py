"""Factors over time."""

import numpy as np

from pcontact.scene.amplitude import amplitude


def test_amplitude_table():
    table = amplitude(((0.0, 0.0), (1.0, 2.0), (3.0, -2.0)), end=10.0)
    times = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0])
    np.testing.assert_allclose(table.factor(times), [0, 0, 1, 2, 0, -2, -2], atol=1e-15)
    assert table.factor(0.25) == 0.5
    assert amplitude([[5, 3]], end=1.0).factor(0.0) == 3.0


def test_default_ramp():
    ramp = amplitude(None, end=4.0)
    np.testing.assert_allclose(ramp.factor(np.array([0.0, 1.0, 4.0, 5.0])), [0, 0.25, 1, 1])
