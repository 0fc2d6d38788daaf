"""What a process does with memory between runs."""

import numpy as np

from pcontact.runtime import profile
from pcontact.runtime.petsc import MAPPED


def test_freed_memory_is_held_for_runs_to_come(monkeypatch):
    """Unless it is much."""
    given = []
    monkeypatch.setattr(profile, "give_back", lambda: given.append(len(given)))
    monkeypatch.setattr(profile, "HELD", 2**60)
    with profile.holding():
        profile.forget_peak()
        assert not given
        monkeypatch.setattr(profile, "HELD", 0)
        profile.forget_peak()
        assert given == [0]
    monkeypatch.setattr(profile, "HELD", 2**60)
    profile.forget_peak()
    assert given == [0, 1]


def test_freed_memory_goes_back():
    """Libraries that PETSc loads have the C library keep it."""
    large = np.ones(MAPPED // 2)
    before = profile.memory()[1]
    del large
    assert profile.memory()[1] < before - 2 * MAPPED
