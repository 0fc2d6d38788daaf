"""What the change of the solution says of the estimate."""

import numpy as np
import pytest

from pcontact.adapt.seen import ALIKE, LEAST, State, fallen, left_after, part_of


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
    """Values whose errors are those of the squared estimates tell them; what was left does not go faster than that."""
    error, coarse = 0.08, State(100, 2, 2, 0.3, 1.0)
    fine = State(200, 2, 2, 0.15, 1.0 + 0.75 * error)
    assert left_after(coarse, fine) == pytest.approx(0.25 * error)
    by_chance = fine._replace(value=1.0)
    assert left_after(coarse._replace(left=-error), by_chance) == pytest.approx(-0.25 * error)


def test_errors_of_quantities_that_fall():
    """They fall with the squares, but not faster than with the best meshes, and as far as two meshes can tell."""
    coarse, fine = State(100, 2, 2, 0.3, 1.0), State(200, 2, 2, 0.01, 1.0)
    assert fallen(coarse, fine) == pytest.approx(0.25)
    assert fallen(coarse, fine._replace(estimate=0.3)) == fallen(coarse._replace(estimate=0.0), coarse) == ALIKE**2
