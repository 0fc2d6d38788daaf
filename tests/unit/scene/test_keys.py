"""Every key of a scene belongs to any run, or to a feature that a run without it does not pay for."""

import pytest

from pcontact.scene.keys import keys
from pcontact.scene.model import HEADERS
from tests.support.lean import ANY, FEATURES, KEYS, PIECES


@pytest.mark.parametrize("cls", HEADERS, ids=lambda cls: cls.__name__)
def test_every_key_has_a_place(cls):
    """What a run without a feature does not call is in `tests/runs/test_lean_keys.py`."""
    groups = KEYS.get(cls.__name__, {})
    said = [key for words in groups.values() for key in words.split()]
    assert sorted(said) == sorted(keys(cls)), "each key once: a new one needs a feature, and what is its alone"
    assert groups.keys() <= {ANY, *PIECES, *FEATURES}
