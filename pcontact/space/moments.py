"""Moments of forces."""

import numpy as np


def moments(arms, forces):
    """Sum of the moments of forces (n, d) at the ends of arms (n, d): a number in the plane, (3,) in space."""
    products = np.cross(arms, forces) if arms.shape[1] == 3 else arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]
    return products.sum(axis=0)
