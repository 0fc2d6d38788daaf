"""How a prescribed value grows with time."""

from dataclasses import dataclass

import numpy as np


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


def drive(scene):
    """What moves or loads the bodies of a scene.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene

    Returns
    -------
    callable
        Factors (n,) at a time, of all displacements, loads and obstacles that are not zero. A level set of the user's
        may move with time.
    """
    acting = [one.amplitude for one in scene.displacements if one.turns or any(v != "free" and v for v in one.value)]
    acting += [one.amplitude for one in scene.loads]
    obstacles = [pair.obstacle for pair in scene.contacts if pair.obstacle is not None]
    acting += [one.amplitude for one in obstacles if one.displacement is not None and any(one.displacement)]
    acting += [None for one in obstacles if one.shape == "level_set"]
    amplitudes = [amplitude(table, scene.steps.end) for table in acting]

    def factors(time):
        return np.array([one.factor(time) for one in amplitudes])

    return factors
