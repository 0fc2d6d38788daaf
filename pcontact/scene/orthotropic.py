"""Conditions on the constants of orthotropic materials, and their axes.

With nu_ij = -eps_jj / eps_ii under a stress along i, the energy is positive where

    nu_ij^2 < E_i / E_j,    1 - nu12^2 E2/E1 - nu13^2 E3/E1 - nu23^2 E3/E2 - 2 nu12 nu23 nu13 E3/E1 > 0
"""

import math
from collections.abc import Sequence

# of the determinant above: smaller ones are rounding errors of the constants
LEAST = 1e-12
# sine of the angle between two vectors that are to span a plane
PARALLEL = 1e-6
PAIRS = ((0, 1), (0, 2), (1, 2))


def normal_stiffness(young: Sequence[float], poisson: Sequence[float]) -> tuple[float, list[list[float]]]:
    """Determinant of the compliance of normal stresses, over that without contraction, and its inverse (3, 3)."""
    a, b, c = (nu * math.sqrt(young[j] / young[i]) for nu, (i, j) in zip(poisson, PAIRS, strict=True))
    det = 1.0 - a * a - b * b - c * c - 2.0 * a * b * c
    x, y, z = a + b * c, b + a * c, c + a * b
    parts = [[1.0 - c * c, x, y], [x, 1.0 - b * b, z], [y, z, 1.0 - a * a]]
    if det <= 0.0:
        return det, []
    return det, [[parts[i][j] / det * math.sqrt(young[i] * young[j]) for j in range(3)] for i in range(3)]


def indefinite(young: Sequence[float], poisson: Sequence[float]) -> tuple[str, str] | None:
    """Return what was found and is allowed where the energy of some strain is not positive; None where it always is."""
    for nu, (i, j) in zip(poisson, PAIRS, strict=True):
        most = math.sqrt(young[i] / young[j])
        if abs(nu) >= most:
            name = f"nu{i + 1}{j + 1}"
            found = f"{name} = {nu:g}, with which some strain has no positive energy"
            return found, f"|{name}| < sqrt(E{i + 1} / E{j + 1}) = {most:.6g}"
    det, _ = normal_stiffness(young, poisson)
    if det <= LEAST:
        found = f"{list(poisson)}, with which some strain has no positive energy"
        return found, ("1 - nu12^2 E2/E1 - nu13^2 E3/E1 - nu23^2 E3/E2 - 2 nu12 nu13 nu23 E3/E1 > 0, here it is "
                       f"{det:.3g}")  # fmt: skip
    return None


def equivalent_poisson(young: Sequence[float], poisson: Sequence[float], shear: Sequence[float]) -> float:
    """Poisson's ratio of the isotropic stiffness that is nearest, see `pcontact.material.orthotropic`."""
    _, normal = normal_stiffness(young, poisson)
    triple_bulk = sum(map(sum, normal)) / 3.0
    twice = (normal[0][0] + normal[1][1] + normal[2][2] + 2.0 * sum(shear) - triple_bulk) / 5.0
    return (triple_bulk - twice) / (2.0 * triple_bulk + twice)


def parallel(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether two vectors span no plane."""
    (a, b, c), (x, y, z) = first, second
    across = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    return across <= PARALLEL * math.hypot(a, b, c) * math.hypot(x, y, z)


def across_plane(first: Sequence[float], second: Sequence[float]) -> bool:
    """Tell whether of axes along one vector, in the plane of both, and square to both, one is the third direction."""
    length = math.hypot(*first)
    one = [value / length for value in first]
    along = sum(x * y for x, y in zip(one, second, strict=True))
    two = [y - along * x for x, y in zip(one, second, strict=True)]
    length = math.hypot(*two)
    heights = [one[2], two[2] / length]
    heights.append(math.sqrt(max(1.0 - heights[0] ** 2 - heights[1] ** 2, 0.0)))
    return max(map(abs, heights)) > 1.0 - PARALLEL**2
