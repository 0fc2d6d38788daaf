"""What is kept of a mesh: from the second time on, as long as there is room."""

import numpy as np

from pcontact.space.space import Kept


def test_kept_from_the_second_time_on_while_there_is_room():
    kept, made = Kept(room=100), []

    def make(size):
        made.append(size)
        return np.zeros(size, dtype=np.uint8), None

    for _ in range(4):
        kept("small", lambda: make(60))
        kept("large", lambda: make(50))
    # the first one is kept when it is asked for again; then there is no room for the other one
    assert made.count(60) == 2 and made.count(50) == 4 and kept.room == 40
    assert kept.get("small")[0].size == 60 and kept.get("large") is None


def test_kept_at_once_where_it_is_asked_for_again():
    kept, made = Kept(room=100, at_once=True), []
    for _ in range(3):
        kept("small", lambda: (made.append("small"), np.zeros(60, dtype=np.uint8)))
        kept("large", lambda: (made.append("large"), np.zeros(50, dtype=np.uint8)))
    assert made.count("small") == 1 and made.count("large") == 3
