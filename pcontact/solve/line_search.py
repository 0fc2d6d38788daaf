"""How far to go along a Newton step: to where the residual no longer points along it."""

import numpy as np

# [-] Part of the residual's first component along the step that may be left. Row: line_search.
ENOUGH = 0.1
# [-] Part of it that is left behind a full step for which it is worth to go beyond the step. Row: line_search.
BEYOND = 0.03
# [full steps] How far one goes at most. Row: line_search.
FARTHEST = 2.0
# [residuals] Per step. From: seven points, each of which takes INNER of the bracket at least, leave a fifth of it.
RESIDUALS = 8
# [-] Distance from the ends of the bracket that a new point keeps, in parts of the bracket. Row: line_search.
INNER = 0.2


def zero_of(component, first, most=1.0, farthest=FARTHEST):
    """The zero in (0, 2] of a function that is positive at 0, or 1 if it is not negative there.

    Newton's method for a non-smooth equation F(u) = 0 that comes from a monotone operator should go along its step -s y
    until F(u - s y) . y changes its sign; |F| may have to rise on the way. This function of s has nearly straight
    pieces with corners where points open, close, stick or slip, and may turn much steeper at one. The secant method
    then stays before the corner, or jumps to and fro across it; here the zero stays in a bracket (regula falsi with
    halving, M. Dowell and P. Jarratt, BIT 11, 1971, 168-174), which shrinks by a part each time.

    Behind a full step the function is followed by one secant: where a contact loses points from its rim, iteration by
    iteration, it remains positive there.

    Parameters
    ----------
    component : callable
        The function.
    first : float
        Its value at 0.
    most : float
        Where to go at most if a full step goes too far.
    farthest : float
        Where to go at most if it does not.

    Returns
    -------
    float
        Where its magnitude is at most ``ENOUGH`` of ``first``, or smallest among the points that were tried.
    """
    value = component(1.0)
    if not first > 0.0:
        return 1.0
    if value >= -ENOUGH * first:
        left = value / first
        return min(1.0 / (1.0 - left), farthest) if BEYOND < left < 1.0 else 1.0
    if most < 1.0:
        value = component(most)
        if value >= -ENOUGH * first:
            return most
    a, fa, b, fb = 0.0, first, most, value
    best, smallest = most, abs(value)
    side = 0
    for _ in range(RESIDUALS - 1):
        slope = fa - fb
        at = a + (b - a) * (fa / slope if np.isfinite(slope) else 0.5)
        at = min(max(at, a + INNER * (b - a)), b - INNER * (b - a))
        value = component(at)
        if abs(value) < smallest or not np.isfinite(smallest):
            best, smallest = at, abs(value)
        if abs(value) <= ENOUGH * first:
            break
        if value > 0.0:
            a, fa = at, value
            if side > 0:
                fb *= 0.5
            side = 1
        else:
            b, fb = at, value
            if side < 0:
                fa *= 0.5
            side = -1
    return best


def decrease_of(norm, first):
    """The largest of 1, 1/2, 1/4, ... of a step at which the norm of the residual is at most what it was.

    For bodies whose tangent may not be positive, so that the residual along a step says nothing, and that may be turned
    inside out on the way.

    Parameters
    ----------
    norm : callable
        The norm at a part of the step; not finite where the residual has no value.
    first : float
        At 0.

    Returns
    -------
    float
        Where the norm is smallest among the parts that were tried if it nowhere is as small as that.
    """
    best, least, part = 1.0, np.inf, 1.0
    for _ in range(RESIDUALS):
        value = norm(part)
        if value <= first:
            return part
        if value < least:
            best, least = part, value
        part *= 0.5
    return best
