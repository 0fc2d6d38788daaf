"""What is kept of a mesh: from the second time on, as long as there is room."""

import numpy as np

from pcontact.space.kept import Kept


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
