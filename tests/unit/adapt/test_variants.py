"""What runs with other settings say."""

import pytest

from pcontact.adapt.settings import STEPS_RATE
from pcontact.adapt.variants import followed


@pytest.mark.parametrize("other", [20, 80])
def test_load_steps_that_are_followed(other):
    """Solutions 1 + c n^-r with 40, 20 or 80, and 101 load steps."""
    c = -0.3
    u = {n: 1.0 + c * n**-STEPS_RATE for n in (40, other, 101)}
    part, left = followed(40, other, 101)
    assert u[40] + part * (u[40] - u[other]) == pytest.approx(u[101], rel=1e-12)
    assert left * abs(u[40] - u[other]) == pytest.approx(abs(u[40] - 1.0), rel=1e-12)
