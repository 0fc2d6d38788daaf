"""A few of the kills that kills.py goes on with."""

import pytest
from kills import Life, chain

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", ["Coulomb", "impact"])
def test_killed_at_any_moment(tmp_path, kind):
    """kill -9 in a load step, in flight, and while a checkpoint is written; each life goes on where the last checkpoint
    was."""
    lives = [Life(1, 1, True, 0.0), Life(1, 1, False, 0.5), Life(1, 1, True, 0.1)]
    kills, within, difference, allowed, where = chain(kind, lives, 1, tmp_path / "chain")
    assert kills == 3 and within > 0 and difference <= allowed, where
