"""Growth of prescribed values with time."""

from dataclasses import dataclass

import numpy as np

from pcontact.runtime.errors import InputError
from pcontact.scene.functions import expressions, names
from pcontact.scene.model import Coupling, Displacement, Load, Obstacle, Pretension, Temperature

# what an amplitude multiplies
MULTIPLIED = {
    Displacement: ("value", "angle"),
    Load: ("pressure", "traction", "body_force", "acceleration", "angular_speed", "force", "moment"),
    Temperature: ("value",),
    Coupling: ("displacement", "rotation"),
    Pretension: ("force", "shortening"),
    Obstacle: ("displacement", "angle"),
}
# [parts of the run] Times at which the size of what has expressions of the time is looked at. From: chosen.
LOOKS = 32


@dataclass(frozen=True)
class Amplitude:
    """Piecewise linear factor of time, constant before the first and after the last row.

    Parameters
    ----------
    times : numpy.ndarray
        (n,) strictly increasing times, in the user's unit of time.
    factors : numpy.ndarray
        (n,) factors, without dimension.
    """

    times: np.ndarray
    factors: np.ndarray

    def factor(self, time):
        """Factor at a time, or at an array of times.

        Parameters
        ----------
        time : float or array_like
            Any shape.

        Returns
        -------
        float or numpy.ndarray
            Same shape as `time`.
        """
        return np.interp(time, self.times, self.factors)


def amplitude(table, end):
    """Amplitude of a validated table; without one, a ramp from 0 to 1 over the run.

    Parameters
    ----------
    table : sequence of (time, factor) or None
        As `Displacement.amplitude`, `Load.amplitude` and `Obstacle.amplitude` hold it.
    end : float
        End of the run, `Steps.end`.

    Returns
    -------
    Amplitude
    """
    rows = np.array(((0.0, 0.0), (end, 1.0)) if table is None else table, dtype=np.float64)
    return Amplitude(rows[:, 0].copy(), rows[:, 1].copy())


def timed(one):
    """Return whether a table has expressions of the time."""
    return any("t" in names(getattr(one, key)) for key in MULTIPLIED[type(one)])


def amplitude_of(one, end):
    """Amplitude of a table: without one a ramp, or 1 where an expression has the time; see :func:`amplitude`."""
    return amplitude(((0.0, 1.0), (end, 1.0)) if one.amplitude is None and timed(one) else one.amplitude, end)


class Squared(Amplitude):
    """The square of an amplitude."""

    def factor(self, time):
        """See :meth:`Amplitude.factor`."""
        return super().factor(time) ** 2


def corners(scene, held=False):
    """Times (a list, unsorted) of the corners of amplitudes and expressions of a scene, or of those alone that
    prescribe displacements of nodes (`held`): load steps end there."""
    moved = [*scene.displacements, *scene.couplings, *scene.pretensions]
    others = [] if held else scene.contacts
    obstacles = [contact.obstacle for contact in others if contact.obstacle is not None]
    moved += [] if held else [*scene.loads, *scene.temperatures, *obstacles]
    tables = [one.amplitude for one in moved] + [contact.interference_amplitude for contact in others]
    values = [getattr(one, key) for one in moved for key in MULTIPLIED[type(one)]]
    values += [one.expression for one in obstacles]
    turning = [one for value in values for one in expressions(value).values()]
    found = [time for one in turning for time in one.corners(scene.steps.end).tolist()]
    return found + [time for table in tables for time, _ in (table or [])]


def drive(scene, places):
    """Return what moves or loads the bodies of a scene.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    places : ndarray (n, d)
        Where expressions are looked at [length].

    Returns
    -------
    callable
        Factors (n,) at a time, of all displacements, loads and obstacles that are not zero. A level set of the user's
        may move with time.
    """
    end, moved = scene.steps.end, [*scene.displacements, *scene.loads, *scene.temperatures]
    acting = [one for one in scene.displacements if one.turns or any(v != "free" and v for v in one.value)]
    acting += [*scene.loads, *scene.temperatures, *scene.couplings, *scene.pretensions]
    factors = [amplitude_of(one, end).factor for one in acting if not timed(one)]
    growing = [pair.interference_amplitude for pair in scene.contacts if pair.interference_amplitude is not None]
    factors += [amplitude(table, end).factor for table in growing]
    obstacles = [pair.obstacle for pair in scene.contacts if pair.obstacle is not None]
    factors += [amplitude(one.amplitude, end).factor for one in obstacles if one.moves]
    factors += [amplitude(None, end).factor for one in obstacles if one.shape == "level_set"]
    varying = [size for one in moved if timed(one) for size in _sizes(one, end, places)]

    def at(time):
        return np.concatenate([[one(time) for one in factors], *(one(time) for one in varying)])

    return at


def _sizes(one, end, places):
    """Functions of time: what the expressions of a table are at places, in parts of their largest value."""
    factor = amplitude_of(one, end).factor
    for key in MULTIPLIED[type(one)]:
        for expression in expressions(getattr(one, key)).values():

            def size(time, expression=expression):
                try:
                    values = expression(places, time)
                except InputError:
                    # a function of the user's may know the bodies alone
                    values = np.zeros(len(places))
                return factor(time) * np.nan_to_num(values, posinf=0.0, neginf=0.0)

            largest = max(float(np.abs(size(time)).max()) for time in np.linspace(0.0, end, LOOKS))
            if largest > 0.0:
                yield lambda time, size=size, largest=largest: size(time) / largest
