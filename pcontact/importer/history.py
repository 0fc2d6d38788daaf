"""Values over the time of a run, from those of the steps of a deck."""

from dataclasses import dataclass, field

import numpy as np

# steps that begin where the last one has ended: part of a period in which a value jumps
JUMP = 1e-6


@dataclass
class Amplitude:
    """Factors over the time of a step, or of the run.

    Attributes
    ----------
    points : list of (float, float)
        Time and factor, times increasing.
    total : bool
        Times are those of the run.
    """

    points: list
    total: bool = False

    def at(self, time):
        """The factor at a time: linear between the points, constant beyond."""
        return float(np.interp(time, *zip(*self.points, strict=True)))


@dataclass
class History:
    """One number over the time of the run.

    Attributes
    ----------
    points : list of (float, float)
        Time and value, times increasing; linear between them.
    """

    points: list = field(default_factory=lambda: [(0.0, 0.0)])

    @property
    def last(self):
        """float : the value at the end."""
        return self.points[-1][1]

    @property
    def most(self):
        """float : the value of largest size."""
        return max((value for _, value in self.points), key=abs)

    def ramp(self, begin, end, value):
        """Go on to a value at the end of a step."""
        self._hold(begin)
        self._add(end, value)

    def jump(self, begin, end, value):
        """Have another value all through a step."""
        if begin == 0.0:
            self.points = [(0.0, value)]
        else:
            self._hold(begin)
            self._add(begin + JUMP * (end - begin), value)
        self._add(end, value)

    def follow(self, begin, end, value, amplitude):
        """Go as an amplitude says; where it jumps at the begin of a step, within a part of it."""
        shift = 0.0 if amplitude.total else begin
        inner = [t + shift for t, _ in amplitude.points if begin < t + shift < end]
        first = value * amplitude.at(begin - shift)
        if begin == 0.0:
            self.points = [(0.0, first)]
        else:
            self._hold(begin)
            if first != self.last:
                self._add(begin + JUMP * (end - begin), first)
        for time in [t for t in inner if t > self.points[-1][0]]:
            self._add(time, value * amplitude.at(time - shift))
        self._add(end, value * amplitude.at(end - shift))

    def _hold(self, time):
        if time > self.points[-1][0]:
            self._add(time, self.last)

    def _add(self, time, value):
        self.points.append((time, value))

    def key(self):
        """Key that tells it from others: its points without those that say nothing."""
        points = list(self.points)
        kept = [points[0]]
        for before, here, after in zip(points, points[1:], points[2:], strict=False):
            slope = (after[1] - before[1]) / (after[0] - before[0])
            if abs(before[1] + slope * (here[0] - before[0]) - here[1]) > 1e-14 * abs(self.most):
                kept.append(here)
        if len(points) > 1 and not all(value == points[0][1] for _, value in points):
            kept.append(points[-1])
        return tuple(kept)

    def amplitude(self, end):
        """Factors of `most` over the time, or None where it is the ramp of a run.

        Parameters
        ----------
        end : float
            Of the run [time].
        """
        return factors(self.key(), self.most, end)


def factors(points, most, end):
    """Factors of the largest value, or None where they are a ramp over the run, or nothing moves."""
    if most == 0.0:
        return None
    table = tuple((time, value / most) for time, value in points)
    return None if table == ((0.0, 0.0), (end, 1.0)) else table


def amplitude_key(table):
    """The key of a table of the scene that has such factors; none where they are a ramp."""
    return {} if table is None else {"amplitude": [list(row) for row in table]}
