"""Rigid obstacles: signed distance and contact normal, from formulas or from a level set of the user's.

Finite rigid shapes: signed distances of profiles, turned around an axis or drawn along one, and of a torus.

A profile lies in the half plane of a distance r >= 0 from an axis and a height h along a direction, which looks into
free space. It is a convex set C grown by a radius e, so that its edges are round: the distance is that from C less e,
exact outside of the shape and down to the depth e. Deeper it is the distance to the nearest side.

* Punch of half width w: C = {r <= w - e, h <= -e}.
* Wedge of half angle a, or cone: C = {r cos a + (h + e) sin a <= 0}, the tip of the grown set is at r = h = 0.

Distance from a rigid surface of facets, all of which every rank has.

It is the closest point of the search between bodies (`pcontact.contact.search.projection`), of any direction and
however far: normals at edges and corners tell the sides of the surface apart.
"""

import numpy as np

from pcontact.contact.search.projection import QueryPoints, TargetFacets, closest_points, surface_tree
from pcontact.contact.surface.facet_maps import KIND
from pcontact.space.supports import Turn

# [cosine] Smallest one between the normal of a point and that of its partner: any.
ANY = -2.0


class RigidSurface:
    """A surface of facets as a function: signed distance and its gradient.

    Parameters
    ----------
    surface : pcontact.mesh.read.FacetSurface
    inside : bool
        The free space is on the other side than that where normals look to.

    Attributes
    ----------
    place : ndarray (d,)
        Mean of the nodes, to which the places of points are relative [length].
    """

    def __init__(self, surface, inside):
        self.place, self._sign = surface.points.mean(axis=0), -1.0 if inside else 1.0
        x = np.ascontiguousarray((surface.points - self.place)[surface.nodes])
        kinds = np.array([KIND[one] for one in surface.kinds], dtype=np.int64)
        self._facets = TargetFacets(surface_tree(x, kinds), x, kinds, np.arange(len(kinds)))

    def __call__(self, x, time):
        """Distance (n,) [length] and gradient (n, d) at places x (n, d) relative to `place`; it stands still."""
        # their own normals do not matter
        normal = np.zeros_like(x)
        normal[:, 0] = 1.0
        found = closest_points(self._facets, QueryPoints(x, normal, np.inf), ANY)
        return self._sign * found.gap, -self._sign * found.normal


def punch(width, edge):
    """Distance (n,) and its slopes (n,) along r and h, of the profile of a punch, as a function of r, h (n,)."""

    def profile(r, h):
        across, along = r - (width - edge), h + edge
        corner = (across > 0.0) & (along > 0.0)
        length = np.where(corner, np.hypot(across, along), 1.0)
        side = across > along
        distance = np.where(corner, length, np.maximum(across, along))
        slope_r = np.where(corner, across / length, np.where(side, 1.0, 0.0))
        return distance - edge, slope_r, np.where(corner, along / length, np.where(side, 0.0, 1.0))

    return profile


def wedge(angle, edge):
    """The same of a wedge or a cone with half an angle [radian] at its tip."""
    sine, cosine = np.sin(angle), np.cos(angle)

    def profile(r, h):
        along = h + edge
        # where the flank begins: before it the tip is nearest
        tip = r * sine < along * cosine
        length = np.hypot(r, along)
        safe = np.where(length > 0.0, length, 1.0)
        distance = np.where(tip, length, r * cosine + along * sine)
        slope_r = np.where(tip, r / safe, cosine)
        return distance - edge, slope_r, np.where(tip, np.where(length > 0.0, along / safe, 1.0), sine)

    return profile


def _away(vectors):
    """Lengths (n,) and unit vectors (n, d), some direction where a length is zero."""
    length = np.linalg.norm(vectors, axis=1)
    safe = np.where(length > 0.0, length, 1.0)
    return length, np.where((length > 0.0)[:, None], vectors / safe[:, None], np.eye(vectors.shape[1])[0])


def turned_around(profile, direction):
    """Distance (n,) and gradient (n, d) at places x (n, d) relative to the tip, of a profile around a unit vector."""

    def distance(x, time):
        height = x @ direction
        r, outward = _away(x - height[:, None] * direction)
        gap, slope_r, slope_h = profile(r, height)
        return gap, slope_r[:, None] * outward + slope_h[:, None] * direction

    return distance


def drawn_along(profile, direction, axis):
    """The same of a profile that is drawn along an axis, a unit vector square to the direction; None in the plane."""
    if axis is None:
        across = np.array([-direction[1], direction[0]])
    else:
        across = np.cross(axis, direction)

    def distance(x, time):
        r = x @ across
        gap, slope_r, slope_h = profile(np.abs(r), x @ direction)
        outward = np.where(r < 0.0, -1.0, 1.0)[:, None] * across
        return gap, slope_r[:, None] * outward + slope_h[:, None] * direction

    return distance


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
        length, away = _away(r)
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
    """All places within a radius of a ring around an axis."""
    axis = _unit(np.asarray(obstacle.axis, dtype=float))

    def distance(x, time):
        height = x @ axis
        _, outward = _away(x - height[:, None] * axis)
        length, away = _away(x - obstacle.ring_radius * outward)
        return length - obstacle.radius, away

    return distance


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
        Level set and gradient, see :func:`pcontact.scene.functions.obstacle_functions`.
    surface : pcontact.contact.surface.obstacle.RigidSurface, optional
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
        self._shift = np.asarray(0.0 if obstacle.displacement is None else obstacle.displacement, dtype=float)
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
        """Motion of the obstacle between two times [length]; what a level set does by itself is not known.

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
        factor = self._amplitude.factor(end) - self._amplitude.factor(start)
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
        return self._pivot + self._shift * self._amplitude.factor(time)

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
        factor = self._amplitude.factor(time)
        x = x + (origin - self._place - self._shift * factor)
        if not len(x):
            return np.zeros(0), np.zeros_like(x)
        if self._turn is None:
            gap, slope = self._distance(x, time)
            return gap, -slope
        gap, slope = self._distance(x + self._turn.displacement(x + (self._place - self._pivot), -factor), time)
        return gap, -(slope + self._turn.displacement(slope, factor))
