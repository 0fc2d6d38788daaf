"""Which degree the passes have."""

import numpy as np
import pytest

from pcontact.adapt.effectivity import Range
from pcontact.adapt.passes import Pass
from pcontact.adapt.settings import ENTRIES, FEW, Degree


def done(error, dim=2, **more):
    return Pass(100, 50, 1, error, Range(1.0, 2.0, "", dim), {"mesh": error}, expected=error, **more)


@pytest.mark.parametrize("dim", [2, 3])
def test_degree_1_stays_where_it_takes_fewer_entries(dim):
    """Its error falls with the unknowns to the power 1 / d: a target that is nearly reached is that of degree 1."""
    near = ENTRIES[dim] ** (1.0 / dim)
    for ratio, degree in ((0.99 * near, 1), (1.01 * near, 2)):
        choice = Degree(None)
        assert choice.is_open and choice.choose(done(0.01 * ratio, dim), 0.01, 1e3) == degree == choice.now
        assert choice.chosen["degree"] == degree and not choice.is_open
    # the error of a force is the square of that
    force = done(0.01 * near**2 * 0.99, dim, quantity={"extrapolated": 1.0})
    assert Degree(None).choose(force, 0.01, 1e3) == 1


def test_a_budget_that_does_not_hold_degree_2():
    choice = Degree(None)
    assert choice.choose(done(0.5), 0.01, 3.9) == 1 and "budget" in choice.chosen["why"]


@pytest.mark.parametrize("nodes, dim, most, few", [
    (FEW // 2, 2, np.inf, True), (FEW // 2 + 1, 2, np.inf, False), (FEW // 3, 3, np.inf, True),
    (FEW // 3 + 1, 3, np.inf, False), (400, 2, 799.0, False),
])  # fmt: skip
def test_few_unknowns_have_degree_2_at_once(nodes, dim, most, few):
    """A budget may not hold them."""
    assert bool(Degree(None, most).few(dim, nodes)) == few


def test_a_degree_that_is_given_stays():
    assert not Degree(1).is_open and Degree(2).now == 2 and Degree(1).chosen is None
