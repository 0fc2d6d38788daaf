"""Rigid obstacles: signed distance and contact normal, from formulas or from a level set of the user's."""

import numpy as np

from pcontact.contact.surface.shapes import drawn_along, punch, torus, turned_around, wedge
from pcontact.space.turn import Turn


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _plane(obstacle):
    normal = _unit(np.asarray(obstacle.normal, dtype=float))

    def distance(x, time):
        return x @ normal, np.broadcast_to(normal, x.shape)

    return distance


def _round(obstacle, axis):
    """Sphere (axis None) or cylinder."""
    sign = -1.0 if obstacle.inside else 1.0

    def distance(r, time):
        if axis is not None:
            r = r - np.outer(r @ axis, axis)
        length = np.linalg.norm(r, axis=1)
        safe = np.where(length > 0.0, length, 1.0)
        fallback = np.eye(r.shape[1])[0]
        away = np.where((length > 0.0)[:, None], r / safe[:, None], fallback)
        return sign * (length - obstacle.radius), sign * away

    return distance


def _profiled(obstacle):
    """Punch, wedge or cone."""
    normal, edge = _unit(np.asarray(obstacle.normal, dtype=float)), obstacle.edge_radius or 0.0
    if obstacle.shape == "punch":
        profile = punch(obstacle.radius if obstacle.width is None else 0.5 * obstacle.width, edge)
    else:
        profile = wedge(np.radians(obstacle.half_angle), edge)
    round_one = obstacle.shape == "cone" or obstacle.radius is not None
    if round_one:
        return turned_around(profile, normal)
    axis = None if obstacle.axis is None else _unit(np.asarray(obstacle.axis, dtype=float))
    return drawn_along(profile, normal, axis)


def _torus(obstacle):
    return torus(obstacle.ring_radius, obstacle.radius, _unit(np.asarray(obstacle.axis, dtype=float)))


# what makes the distance of a shape, as a function of places relative to the shape's own and of the time
SHAPES = {
    "plane": _plane,
    "sphere": lambda obstacle: _round(obstacle, None),
    "cylinder": lambda obstacle: _round(obstacle, _unit(np.asarray(obstacle.axis, dtype=float))),
    "punch": _profiled,
    "wedge": _profiled,
    "cone": _profiled,
    "torus": _torus,
}


# [model sizes] Step of the differences of a level set, of fourth order. From: rounding errors over it are 2e-12, which
# bodies of finite strain, whose contact normals follow their points, can iterate down to; smooth level sets have no
# larger errors, and a kink is rounded over as little as that.
STEP = 1e-4


def _slope(function, x, time, step):
    """Gradient (n, d) of a level set by differences of fourth order."""
    slope = np.empty_like(x)
    for axis, shift in enumerate(step * np.eye(x.shape[1])):
        near = function(x + shift, time) - function(x - shift, time)
        far = function(x + 2.0 * shift, time) - function(x - 2.0 * shift, time)
        slope[:, axis] = (8.0 * near - far) / (12.0 * step)
    return slope


def _level_set(function, gradient, size):
    step = STEP * size

    def distance(x, time):
        value = function(x, time)
        slope = gradient(x, time) if gradient is not None else _slope(function, x, time, step)
        length = np.linalg.norm(slope, axis=1)
        return value / np.where(length > 0.0, length, 1.0), _unit(np.where(length[:, None] > 0.0, slope, 1.0))

    return distance


class RigidObstacle:
    """A rigid obstacle, fixed or moving.

    Parameters
    ----------
    obstacle : pcontact.scene.model.Obstacle
    amplitude : pcontact.scene.amplitude.Amplitude
        Factor of its displacement and its turn.
    size : float
        Size of the model [length], for difference quotients of a level set without gradient.
    functions : (callable, callable or None), optional
        Level set and gradient, see :func:`pcontact.scene.function.obstacle_functions`.
    surface : pcontact.contact.surface.rigid_surface.RigidSurface, optional
        Of a mesh.

    Attributes
    ----------
    turns : bool
    has_moment : bool
        Whether the report has the moment about the pivot.

    Notes
    -----
    With a factor f of the amplitude a place X of it is at c + f shift + Q(f angle) (X - c), c the pivot. What turns is
    asked in its own frame, where it is at f = 0.
    """

    def __init__(self, obstacle, amplitude, size, functions=None, surface=None):
        self._amplitude = amplitude
        shift = obstacle.displacement
        self._shift = None if shift is None else np.asarray(shift, dtype=float)
        # distances are taken from it
        self._place = np.zeros(1)
        if surface is not None:
            self._place = surface.place
        elif obstacle.shape != "level_set":
            self._place = np.asarray(obstacle.point if obstacle.center is None else obstacle.center, dtype=float)
        self.turns, self._turn = obstacle.turns, None
        self.has_moment = self.turns or surface is not None
        self._pivot = self._place if obstacle.pivot is None else np.asarray(obstacle.pivot, dtype=float)
        if self.turns:
            axis = obstacle.axis if obstacle.turn_axis is None else obstacle.turn_axis
            self._turn = Turn(np.zeros(len(self._pivot)), axis, np.radians(obstacle.angle))
        if obstacle.shape == "level_set":
            self._distance = _level_set(*functions, size)
        else:
            self._distance = surface or SHAPES[obstacle.shape](obstacle)

    def moved(self, x, start, end, origin=0.0):
        """What the obstacle moves between two times [length]; what a level set does by itself is not known.

        Parameters
        ----------
        x : ndarray (n, d)
            Places that it has at the first one, relative to the origin [length].
        start, end : float
        origin : ndarray (d,), optional

        Returns
        -------
        ndarray (n, d), or (d,) or zero where it does not turn
        """
        first = self._amplitude.factor(start)
        factor, way = self._amplitude.factor(end) - first, 0.0
        if self._shift is not None:
            way = self._shift * factor
        return way if self._turn is None else way + self._turn.displacement(x + (origin - self.pivot(start)), factor)

    def turned(self, vectors, start, end):
        """Vectors (n, d) that turn with the obstacle between two times."""
        if self._turn is None:
            return vectors
        return vectors + self._turn.displacement(vectors, self._amplitude.factor(end) - self._amplitude.factor(start))

    def angle(self, start, end):
        """Angle between two times, linear between the corners of the amplitude [radian]."""
        if self._turn is None:
            return 0.0
        return float(self._turn.angle(self._amplitude.factor(end) - self._amplitude.factor(start)))

    def pivot(self, time):
        """The point (d,) that it turns about, where that is at a time [length]."""
        return self._pivot + (0.0 if self._shift is None else self._shift * self._amplitude.factor(time))

    def gap(self, x, time, origin=0.0):
        """Signed distance and contact normal.

        Parameters
        ----------
        x : ndarray (n, d)
            Points, relative to the origin [length].
        time : float
        origin : ndarray (d,), optional
            Near them: far from it the sum of a position and a displacement loses the digits of the displacement.

        Returns
        -------
        gap : ndarray (n,)
            Positive in free space [length].
        normal : ndarray (n, d)
            Towards the obstacle, minus the gradient of the distance.
        """
        origin, factor = origin - self._place, self._amplitude.factor(time)
        if self._shift is not None:
            origin = origin - self._shift * factor
        x = x + origin
        if not len(x):
            return np.zeros(0), np.zeros_like(x)
        if self._turn is None:
            gap, slope = self._distance(x, time)
            return gap, -slope
        gap, slope = self._distance(x + self._turn.displacement(x + (self._place - self._pivot), -factor), time)
        return gap, -(slope + self._turn.displacement(slope, factor))
