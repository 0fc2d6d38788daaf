"""Times of the load steps: equal at first, halved when a step fails, grown back when steps are easy; as long as the
iterations of the last one say where the user leaves it to them."""

from typing import NamedTuple

import numpy as np

# [-] Part of a load step that a remainder before a stop has at least: a shorter one is joined to it. From: rounding.
REMAINDER = 1e-6
# [-] Of numbers of load steps. From: doubles have 16 digits.
ROUNDING = 1e-12


def taken(end, count, stops=()):
    """Load steps between stops, and at most as long as `count` equal ones would be.

    Parameters
    ----------
    end : float
        Of a run that begins at 0 [time].
    count : int
        Load steps that are planned.
    stops : sequence of float
        Times that must be met.

    Returns
    -------
    ndarray (n,)
        How many lie between one stop and the next.
    """
    return np.ceil(_spans(end, stops) * count / end - REMAINDER).astype(int).clip(1)


def filled(end, count, stops=()):
    """The most load steps that can be planned for the number of those that `count` planned ones become between stops:
    without short remainders before these. Parameters as for :func:`taken`."""
    most = taken(end, count, stops) * end / _spans(end, stops)
    return max(int(np.floor(most.min() * (1.0 + ROUNDING))), count)


def _spans(end, stops):
    """Times (n,) between one stop and the next."""
    return np.diff(np.unique([0.0, *(t for t in stops if 0.0 < t < end), end]))


class Control(NamedTuple):
    """Longest load steps, where Newton's method decides, and largest rotation of bodies in one.

    Attributes
    ----------
    longest : float or None
        Load steps follow the iterations, up to this one [time]; None: they are those that were planned.
    turn : callable, optional
        Largest angle by which supports or obstacles turn between two times, linear between corners [radian].
    """

    longest: float | None = None
    turn: object = None


class Schedule:
    """Step sizes of a run, or of a phase of it, to ``end``.

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
    control : Control, optional
    begin : float
        [time]
    turns : sequence of float
        Those of the stops at which what prescribes displacements has a corner.
    """

    # [iterations] Of Newton's method up to which a load step may grow again. From: chosen.
    EASY = 8
    # [iterations] Of a load step of the right length; another one changes its length with their square root.
    # From: Crisfield for the root; the number as EASY.
    WANTED = 8
    # [-] Part of its length that a load step becomes at least. From: a cut does the same.
    SHORTER = 0.5
    # [-] Multiple of its length that a load step becomes at most. From: the inverse of SHORTER.
    LONGER = 2.0
    # [-] Multiple of the local error that is allowed from which on a step is taken again.
    # From: a step half as long has a quarter of it.
    WRONG = 4.0
    # [radian] Farthest that supports and obstacles turn in a load step. From: straight ways of nodes shorten a body by
    # 1 - cos of the half of it, 0.4 %.
    TURN = np.radians(10.0)

    def __init__(self, end, count, smallest, stops=(), control=None, begin=0.0, turns=()):
        self.end, self.smallest, self._control = end, smallest, control or Control()
        self._planned = (end - begin) / count
        self._largest = self._control.longest or self._planned
        self._step = min(self._planned, self._largest)
        self._stops = np.unique([t for t in [begin, *stops, end] if begin <= t <= end])
        self._turns = {begin, *turns}
        self.time = begin

    def next(self):
        """Time at which the coming step ends."""
        eps = 1e-9 * self._planned
        stop = self._stops[np.searchsorted(self._stops, self.time + eps)]
        target = self.time + self._step
        # a remainder much shorter than a step is joined to it
        target = float(stop) if target > stop - REMAINDER * self._step else float(target)
        return target if self._control.turn is None else self._turned(target)

    def _turned(self, target):
        """The first of as few equal parts of a load step as those need that turn."""
        # the last of equal parts is not to be parted for the sake of a rounding error
        parts = int(np.ceil(self._control.turn(self.time, target) / self.TURN * (1.0 - 1e-9)))
        return target if parts <= 1 else self.time + (target - self.time) / parts

    @property
    def done(self):
        """Return True if the run has ended."""
        return self.ends(self.time)

    def ends(self, time):
        """Return True if a run has ended at a time."""
        return time >= self.end * (1.0 - 1e-12)

    @property
    def at_turn(self):
        """Return True if the coming step begins at a turn, or the run does, or the phase."""
        return self.time in self._turns

    @property
    def size(self):
        """Load step that is tried next [time]."""
        return self._step

    def wish(self, size):
        """Take a load step of another size next: longer than planned, too, to the end or the next stop at most.

        Raises
        ------
        ValueError
            It is no number, or smaller than the smallest load step.
        """
        if not np.isfinite(size) or size < self.smallest:
            raise ValueError(f"next load step: found {size!r}; allowed: a number >= {self.smallest:g} [time]")
        self._step = float(size)

    def resume(self, time, size):
        """Go on from a time with a load step that an earlier run had reached."""
        self.time, self._step = time, min(size, self._largest)

    def accept(self, target, iterations, error=0.0):
        """The step to ``target`` converged in some Newton iterations, with a local error over the allowed one; 0 where
        nobody asks."""
        taken, self.time = target - self.time, target
        if self._control.longest is not None:
            self._follow(taken, iterations, error)
        elif iterations <= self.EASY:
            self._step = min(2.0 * self._step, self._largest)

    def refuses(self, target, error):
        """Return True if the step to ``target`` is too long for its local error, and can be made shorter."""
        return error > self.WRONG and self.divides(target)

    def divides(self, target):
        """Return True if the step to ``target`` can be halved."""
        return 0.5 * (target - self.time) >= self.smallest

    def _follow(self, taken, iterations, error):
        """The next load step is as long as the iterations of one of some length say, and its local error."""
        factor = np.sqrt(min(self.WANTED / max(iterations, 1), 1.0 / error if error > 0.0 else np.inf))
        factor = min(max(factor, self.SHORTER), self.LONGER)
        step = factor * taken
        # a load step that a stop has cut short says little of longer ones unless it was hard
        self._step = max(step, self.smallest) if factor < 1.0 else min(max(step, self._step), self._largest)

    def cut(self, target):
        """The step to ``target`` failed.

        Returns
        -------
        bool
            False when the step cannot be made smaller.
        """
        self._step = 0.5 * (target - self.time)
        return self._step >= self.smallest
