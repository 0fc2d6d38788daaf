"""Times of the load steps: equal at first, halved when a step fails, grown back when steps are easy."""

import numpy as np


class Schedule:
    """Step sizes of a run from 0 to ``end``.

    Parameters
    ----------
    end : float
        [time]
    count : int
        Equal steps to start with.
    smallest : float
        Smallest step [time].
    stops : sequence of float
        Times that must be met: the corners of the amplitudes.
    """

    EASY = 8  # Newton iterations up to which a step may grow again
    DOUBTED = 0.1  # part of the planned steps to which they are cut for the sake of a better solution

    def __init__(self, end, count, smallest, stops=()):
        self.end, self.smallest = end, smallest
        self._largest = end / count
        self._step = self._largest
        self._stops = np.unique([t for t in [*stops, end] if 0.0 < t <= end])
        self.time = 0.0

    def next(self):
        """Time at which the coming step ends."""
        eps = 1e-9 * self._largest
        stop = self._stops[np.searchsorted(self._stops, self.time + eps)]
        target = self.time + self._step
        # a remainder much shorter than a step is joined to it
        return float(stop) if target > stop - 1e-6 * self._step else float(target)

    @property
    def done(self):
        """Whether the run has ended."""
        return self.time >= self.end * (1.0 - 1e-12)

    @property
    def size(self):
        """Load step that is tried next [time]."""
        return self._step

    def resume(self, time, size):
        """Go on from a time with a load step that an earlier run had reached."""
        self.time, self._step = time, min(size, self._largest)

    def accept(self, target, iterations):
        """The step to ``target`` converged in some Newton iterations."""
        self.time = target
        if iterations <= self.EASY:
            self._step = min(2.0 * self._step, self._largest)

    def divisible(self, target):
        """Whether the step to ``target`` may be made smaller because its solution is in doubt."""
        return 0.5 * (target - self.time) >= max(self.smallest, self.DOUBTED * self._largest)

    def cut(self, target):
        """The step to ``target`` failed.

        Returns
        -------
        bool
            False when the step cannot be made smaller.
        """
        self._step = 0.5 * (target - self.time)
        return self._step >= self.smallest
