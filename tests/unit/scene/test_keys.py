"""Every key of a scene belongs to any run, or to a feature that a run without it does not pay for."""

import pytest

from pcontact.scene.keys import keys
from pcontact.scene.model import HEADERS, Contact, MeshSpec, Scene
from tests.support.lean import ANY, FEATURES, KEYS, PIECES


@pytest.mark.parametrize("cls", HEADERS, ids=lambda cls: cls.__name__)
def test_every_key_has_a_place(cls):
    """What a run without a feature does not call is in `tests/runs/test_lean_keys.py`."""
    groups = KEYS.get(cls.__name__, {})
    said = [key for words in groups.values() for key in words.split()]
    assert sorted(said) == sorted(keys(cls)), "each key once: a new one needs a feature, and what is its alone"
    assert groups.keys() <= {ANY, *PIECES, *FEATURES}


@pytest.mark.parametrize("table", ["contacts", "mesh", "scene"])
def test_an_attribute_that_is_no_key_is_refused(table):
    """As a key of a file would be, with the nearest that there is; what is a key, or belongs to it, is taken."""
    scene = Scene(MeshSpec("a.msh"), {}, [], contacts=[Contact("upper", "lower")])
    places = {"contacts": (scene.contacts[0], "fricton", "friction"), "mesh": (scene.mesh, "ordr", "order"),
              "scene": (scene, "titel", "title")}  # fmt: skip
    place, wrong, right = places[table]
    words = f"found {wrong!r}, no such key, the nearest is {right!r}; allowed: .*{right}"
    with pytest.raises(AttributeError, match=words):
        setattr(place, wrong, 1)
    setattr(place, right, 1)
    assert getattr(place, right) == 1
