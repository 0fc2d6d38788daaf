"""Finite rigid shapes: signed distances of profiles, turned around an axis or drawn along one, and of a torus.

A profile lies in the half plane of a distance r >= 0 from an axis and a height h along a direction, which looks into
free space. It is a convex set C grown by a radius e, so that its edges are round: the distance is that from C less e,
exact outside of the shape and down to the depth e. Deeper it is the distance to the nearest side.

* Punch of half width w: C = {r <= w - e, h <= -e}.
* Wedge of half angle a, or cone: C = {r cos a + (h + e) sin a <= 0}, the tip of the grown set is at r = h = 0.
"""

import numpy as np


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


def torus(ring, radius, axis):
    """The same of a torus: all places within a radius of a ring around a unit vector, relative to its centre."""

    def distance(x, time):
        height = x @ axis
        _, outward = _away(x - height[:, None] * axis)
        length, away = _away(x - ring * outward)
        return length - radius, away

    return distance
