"""What is made once of a mesh and used in every iteration, as long as there is room for it."""

import numpy as np

# [bytes] That a rank keeps at most. From: of a cell that yields, in space and of degree 2, 1.2 kB are kept, a tenth of
# what its rows of the tangent take; so meshes of half a million unknowns are kept.
ROOM = 2**27


class Kept:
    """Arrays by keys.

    Parameters
    ----------
    room : int
        [bytes]
    at_once : bool
        Whether what is made will be asked for again.

    Attributes
    ----------
    room : int
        That is left.
    """

    def __init__(self, room=ROOM, at_once=False):
        self.room, self._made, self._asked, self._at_once = room, {}, set(), at_once

    def get(self, key):
        """What is kept under a key, or None."""
        return self._made.get(key)

    def __call__(self, key, make):
        """What ``make()`` gives, a tuple of arrays and of what is no array. It is kept when it is asked for again, or
        at once, and made anew where there is no room for it."""
        found = self._made.get(key)
        if found is not None:
            return found
        found, again = make(), self._at_once or key in self._asked
        self._asked.add(key)
        return self.keep(key, found) if again else found

    def keep(self, key, found):
        """Keep a tuple under a key, where there is room; returns it."""
        size = sum(part.nbytes for part in found if isinstance(part, np.ndarray))
        if size <= self.room:
            self._made[key], self.room = found, self.room - size
        return found
