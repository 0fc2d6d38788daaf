"""What a process does with memory between runs."""

from pcontact.runtime import profile


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
