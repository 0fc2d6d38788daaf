"""What the change of the solution says of the estimate."""

import numpy as np
import pytest

from pcontact.adapt.seen import LEAST, left_of, part_of


@pytest.mark.parametrize("part", [0.4, 0.9])
def test_estimates_that_are_the_same_part(part):
    """Errors e and e / 4, whose solutions differ by what Pythagoras says."""
    error = 0.03
    change = error * np.sqrt(1.0 - 1.0 / 16.0)
    assert part_of(part * error, 0.25 * part * error, change) == pytest.approx(part)


def test_what_says_nothing():
    """Estimates are not made smaller, nor larger without end; without a change there is nothing to see."""
    assert part_of(0.05, 0.02, 0.03) == 1.0
    assert part_of(0.05, 0.05, 1.0) == LEAST
    assert part_of(0.05, 0.02, 0.0) == part_of(0.0, 0.0, 0.1) == 1.0


def test_what_is_left_of_a_quantity():
    """An estimate that falls where the quantity does not change is not believed."""
    assert left_of(0.001, 0.01, 0.0003) == pytest.approx(0.0096)
    assert left_of(0.004, 0.01, 0.009) == 0.004
