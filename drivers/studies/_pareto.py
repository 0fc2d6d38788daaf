"""Pairs of least cost for an error: the Pareto front of pairs (cost, error)."""

from collections.abc import Sequence

import numpy as np


def front(costs: Sequence[float], errors: Sequence[float], gain: float = 0.0) -> list[int]:
    """Positions of the pairs that no other pair beats in both, by growing cost.

    Parameters
    ----------
    costs, errors : sequence of float (n,)
        Pairs that are not finite are left out. Of equal pairs the first one counts.
    gain : float
        Part by which the error has to fall from one to the next: less is not worth a place.

    Returns
    -------
    list of int
        Costs grow and errors fall strictly along it.
    """
    cost, error = np.asarray(costs, dtype=float), np.asarray(errors, dtype=float)
    found, best = [], np.inf
    for k in np.lexsort((error, cost)):
        if np.isfinite(cost[k]) and error[k] < best and error[k] <= (1.0 - gain) * best:
            found.append(int(k))
            best = error[k]
    return found


def cheapest(costs: Sequence[float], errors: Sequence[float], bound: float) -> int | None:
    """Position of the least cost among the pairs whose error is at most `bound`; None where there is none."""
    cost = np.where(np.asarray(errors, dtype=float) <= bound, np.asarray(costs, dtype=float), np.nan)
    return None if np.all(np.isnan(cost)) else int(np.nanargmin(cost))


def rounded_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 5, 7, 10 times a power of ten: what a promise is written with."""
    if not (np.isfinite(value) and value > 0.0):
        return float(value)
    power = 10.0 ** np.floor(np.log10(value))
    steps = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0])
    # a value that is on a step stays there, whatever its last digit
    return float(f"{steps[np.argmax(steps >= value / power * (1.0 - 1e-9))] * power:.3g}")
