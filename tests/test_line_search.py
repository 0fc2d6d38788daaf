"""The zero along a Newton step, for functions with corners."""

import numpy as np
import pytest

from pcontact.solve.line_search import ENOUGH, MOST, zero_of


def pieces(*points):
    """A function of straight pieces through points, with a list of where it was asked for."""
    s, values = np.array(points, dtype=float).T
    asked = []

    def function(at):
        asked.append(at)
        return float(np.interp(at, s, values))

    return function, asked


def test_a_good_full_step_is_taken():
    """One residual, no more: the step ends where it should, or before."""
    for end in (0.0, 0.05, -0.05, 0.7):
        function, asked = pieces((0, 1), (1, end))
        assert zero_of(function, 1.0) == 1.0 and asked == [1.0]


@pytest.mark.parametrize("corner", [0.05, 0.32, 0.5, 0.95])
@pytest.mark.parametrize("slope", [2.0, 50.0, 1e3])
def test_a_corner_behind_which_all_is_stiff(corner, slope):
    """What is left along the step is small, wherever the corner, however stiff."""
    left = 1.0 - corner
    function, asked = pieces((0, 1), (corner, left), (1.2, left - slope * (1.2 - corner)))
    part = zero_of(function, 1.0)
    zero = corner + left / slope
    if zero >= 1.0 - 2.0 * ENOUGH / slope:
        assert part > 0.9
        return
    assert len(asked) <= MOST
    # a stiff corner near the end of the step is approached from before it: most of the step is made
    assert abs(function(part)) <= ENOUGH or abs(part - zero) < 0.1 * zero or (part > 0.75 and function(part) < 0.25)


def test_nothing_is_known():
    """A residual that does not point along the step, and one that is not a number at its end."""
    assert zero_of(lambda at: -1.0, 0.0) == 1.0
    assert zero_of(lambda at: 1.0, -1.0) == 1.0
    part = zero_of(lambda at: 1.0 - 4.0 * at if at < 0.6 else np.nan, 1.0)
    assert abs(part - 0.25) < 0.05
