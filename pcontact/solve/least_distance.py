"""The point of a polyhedron that is nearest to the origin.

Least distance programming, by non-negative least squares (C. L. Lawson, R. J. Hanson, Solving Least Squares Problems,
1974, chapter 23). The matrices are small and dense.
"""

import numpy as np

# [-] Part of the columns' size below which a gradient is a rounding error. From: 500 rounding errors of a double.
TINY = 1e-13
# [-] What bounds that are not met cost, in squares of distances. From: chosen, below the inverse of TINY.
UNMET = 1e12


def least_squares_of_positive(a, b):
    """The x >= 0 (n,) with the least |a x - b|, for a (m, n), b (m,)."""
    n = a.shape[1]
    x, passive = np.zeros(n), np.zeros(n, dtype=bool)
    least = TINY * np.linalg.norm(a, axis=0) * np.linalg.norm(b)
    for _ in range(3 * n):
        rise = np.where(passive, -np.inf, a.T @ (b - a @ x) - least)
        if n == 0 or rise.max() <= 0.0:
            break
        passive[np.argmax(rise)] = True
        while passive.any():
            best = np.zeros(n)
            best[passive] = np.linalg.lstsq(a[:, passive], b, rcond=None)[0]
            down = passive & (best <= 0.0)
            if not down.any():
                x = best
                break
            x += np.min(x[down] / np.maximum(x[down] - best[down], 1e-300)) * (best - x)
            passive &= ~(down & (x <= TINY * x.max(initial=0.0)))
            x[~passive] = 0.0
    return x


def nearest_point(rows, bounds):
    """The x with the least norm for which rows @ x >= bounds.

    Bounds that contradict each other, if only by rounding errors, are met as well as all of them can be: what is left
    costs `UNMET` times its square.

    Parameters
    ----------
    rows : ndarray (m, n)
    bounds : ndarray (m,)

    Returns
    -------
    ndarray (n,)
    """
    m, n = rows.shape
    size = np.linalg.norm(rows, axis=1)
    # distances of the bounds from the origin; nothing helps one that no x changes
    size = np.where(size > 0.0, size, np.inf)
    distance = bounds / size
    scale = np.max(distance, initial=0.0)
    if not scale > 0.0:
        return np.zeros(n)
    columns = np.vstack([(rows / size[:, None]).T, np.eye(m) / np.sqrt(UNMET), distance / scale])
    last = np.zeros(len(columns))
    last[-1] = 1.0
    rest = columns @ least_squares_of_positive(columns, last) - last
    return -scale * rest[:n] / rest[-1]
