"""Places that turn about an axis as a rigid body, and moments of forces."""

import numpy as np


class Turn:
    """Turns about an axis through a point; in the plane about the point.

    Parameters
    ----------
    point : sequence of float (d,)
        [length]
    axis : sequence of float (3,) or None
        Of any length; None in the plane.
    angle : float
        At factor 1 [radian].

    Attributes
    ----------
    point : ndarray (d,)
    """

    def __init__(self, point, axis, angle):
        self.point, self._angle = np.asarray(point, dtype=float), angle
        if axis is None:
            self._across = np.array([[0.0, -1.0], [1.0, 0.0]])
        else:
            x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
            self._across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

    def displacement(self, points, factor):
        """(Q - I) (x - point) of points (n, d) [length], small angles without lost digits (Rodrigues)."""
        angle = factor * self._angle
        moved = np.sin(angle) * self._across + 2.0 * np.sin(0.5 * angle) ** 2 * self._across @ self._across
        return (points - self.point) @ moved.T

    def angle(self, factor):
        """Angle [radian] at a factor, or at an array of them."""
        return factor * self._angle


def moments(arms, forces):
    """Sum of the moments of forces (n, d) at the ends of arms (n, d): a number in the plane, (3,) in space."""
    products = np.cross(arms, forces) if arms.shape[1] == 3 else arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]
    return products.sum(axis=0)
