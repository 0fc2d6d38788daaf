"""The zero along a Newton step, for functions with corners."""

import numpy as np
import pytest

from pcontact.solve.newton import BEYOND, ENOUGH, FARTHEST, RESIDUALS, decrease_of, zero_of


def pieces(*points):
    """A function of straight pieces through points, with a list of where it was asked for."""
    s, values = np.array(points, dtype=float).T
    asked = []

    def function(at):
        asked.append(at)
        return float(np.interp(at, s, values))

    return function, asked


def test_a_good_full_step_is_taken():
    """One residual, no more: the step ends where it should."""
    for end in (0.0, BEYOND, -ENOUGH / 2):
        function, asked = pieces((0, 1), (1, end))
        assert zero_of(function, 1.0) == 1.0 and asked == [1.0]


def test_a_step_that_ends_too_early_is_prolonged():
    """To where the secant says, no farther than twice the step, or than is allowed; one residual, no more."""
    for end, part in ((0.2, 1.25), (0.5, 2.0), (0.7, FARTHEST)):
        function, asked = pieces((0, 1), (1, end))
        assert zero_of(function, 1.0) == pytest.approx(part) and asked == [1.0]
        assert zero_of(function, 1.0, farthest=1.0) == 1.0
    assert zero_of(lambda at: 1.0 + at, 1.0) == 1.0, "a function that rises has no zero ahead"


def test_at_most_a_part_of_a_step_that_goes_too_far():
    """What is allowed is taken; if that is too much, the zero before it; a full step that is good remains."""
    function, asked = pieces((0, 1), (0.7, 0.3), (1, -5))
    assert zero_of(function, 1.0, most=0.5) == 0.5 and asked == [1.0, 0.5]
    function, _ = pieces((0, 1), (0.2, 0.8), (1, -100))
    assert abs(zero_of(function, 1.0, most=0.5) - 0.2) < 0.05
    assert zero_of(lambda at: 1.0 - at, 1.0, most=0.5) == 1.0


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
    assert len(asked) <= RESIDUALS
    # a stiff corner near the end of the step is approached from before it: most of the step is made
    assert abs(function(part)) <= ENOUGH or abs(part - zero) < 0.1 * zero or (part > 0.75 and function(part) < 0.25)


def test_nothing_is_known():
    """A residual that does not point along the step, and one that is not a number at its end."""
    assert zero_of(lambda at: -1.0, 0.0) == 1.0
    assert zero_of(lambda at: 1.0, -1.0) == 1.0
    part = zero_of(lambda at: 1.0 - 4.0 * at if at < 0.6 else np.nan, 1.0)
    assert abs(part - 0.25) < 0.05


def test_a_step_after_which_the_norm_is_smaller_is_taken():
    function, asked = pieces((0, 1), (1, 0.9))
    assert decrease_of(function, 1.0) == 1.0 and asked == [1.0]


def test_a_step_is_halved_until_the_norm_is_smaller():
    """Also where there is none at its end: bodies that are turned inside out."""
    function, asked = pieces((0, 1), (0.3, 0.5), (1, 9))
    assert decrease_of(function, 1.0) == 0.25 and asked == [1.0, 0.5, 0.25]
    for nothing in (np.nan, np.inf):
        assert decrease_of(lambda at, nothing=nothing: 0.5 if at < 0.2 else nothing, 1.0) == 0.125


def test_the_smallest_norm_of_a_step_that_only_rises():
    asked = []
    assert decrease_of(lambda at: asked.append(at) or 2.0 - 8.0 * (at == 0.25) / 16.0, 1.0) == 0.25
    assert len(asked) == RESIDUALS
    assert decrease_of(lambda at: np.nan, 1.0) == 1.0
