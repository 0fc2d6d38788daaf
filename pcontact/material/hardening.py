"""Isotropic hardening: the yield stress over the plastic strain, and how far a point flows until it meets it.

A curve is an array (k, 3) with one row ``(p_i, sigma_i, slope_i)`` for each straight segment, in the terms of a
uniaxial test: accumulated equivalent plastic strain p [1] where the segment begins, yield stress there [stress], slope
d(yield stress) / dp [stress] at least 0. The first p is 0; the last segment goes on for ever.

The return mapping works with Frobenius norms, and this is the only place where the two conventions meet:

    radius of the yield surface     R = sqrt(2/3) sigma_y
    length of the plastic strain    x = sqrt(3/2) dp,  hence  dR/dx = 2/3 slope
    back stress                     beta = 2/3 Hk eps_p,  Hk = d(uniaxial back stress) / dp
"""

import numpy as np

from pcontact.runtime.jit import njit_inline, njit_inner_exact

RADIUS = np.sqrt(2.0 / 3.0)
LENGTH = np.sqrt(1.5)
# Newton's error is squared once more after it has become so small
CLOSE = 1e-8
MOST_ITERATIONS = 40


def hardening_curve(yield_stress, hardening=0.0):
    """Curve (1, 3) of linear hardening; perfect plasticity where ``hardening`` is 0.

    Parameters
    ----------
    yield_stress : float
        Uniaxial, positive [stress].
    hardening : float
        Isotropic: d(yield stress) / d(equivalent plastic strain) [stress].
    """
    return np.array([[0.0, yield_stress, hardening]], dtype=np.float64)


def hardening_table(table):
    """Curve (k, 3) of a table; beyond its last row the yield stress is constant.

    Parameters
    ----------
    table : array_like (k, 2)
        Equivalent plastic strain [1], increasing from 0, and uniaxial yield stress [stress], positive.
    """
    table = np.asarray(table, dtype=np.float64)
    slopes = np.zeros(len(table))
    slopes[:-1] = np.diff(table[:, 1]) / np.diff(table[:, 0])
    return np.column_stack([table, slopes])


def curve_of(material):
    """Curve of a material of a scene, of length 0 where it does not yield."""
    if not material.plastic:
        return np.zeros((0, 3))
    if material.hardening_curve is not None:
        return hardening_table(material.hardening_curve)
    return hardening_curve(material.yield_stress, material.hardening)


@njit_inline
def segment_of(curve, p):
    """Number of the segment of ``curve`` (k, 3) that begins at ``p`` or contains it."""
    j = 0
    while j + 1 < curve.shape[0] and p >= curve[j + 1, 0]:
        j += 1
    return j


@njit_inline
def yield_radius(curve, p):
    """Frobenius norm of the deviator on the yield surface [stress] at the equivalent plastic strain ``p``."""
    j = segment_of(curve, p)
    return RADIUS * (curve[j, 1] + curve[j, 2] * (p - curve[j, 0]))


@njit_inner_exact
def flow_length(curve, p, square_a, square_b, stiff_a, stiff_b):
    """Length x of the plastic strain increment that brings a trial state back to the yield surface.

    The relative stress has two parts, of which each shrinks by R / (R + stiffness x) while the point flows. So x is
    the root of

        square_a / (R(x) + stiff_a x)^2 + square_b / (R(x) + stiff_b x)^2 = 1.

    At the knots of the curve the left side is explicit: the segment is found without solving anything. On a segment the
    denominators are linear in x, hence (left side)^(-1/2) is concave: Newton's method on it rises to the root from the
    segment's beginning and never beyond, and with one part alone it is exact in one step.

    Parameters
    ----------
    curve : ndarray (k, 3)
    p : float
        Equivalent plastic strain before.
    square_a, square_b : float
        Squared norms of the two parts of the trial state [stress^2]. Only plane stress has a part a, the mean stress in
        the plane; elsewhere all of the deviator is part b.
    stiff_a, stiff_b : float
        How fast the parts shrink [stress].

    Returns
    -------
    x : float
        Frobenius norm of the plastic strain increment; NaN where a number given is not finite.
    radius : float
        R at the end [stress].
    slope : float
        dR/dx at the end [stress].
    iterations : int
    """
    j = segment_of(curve, p)
    x = 0.0
    radius = RADIUS * (curve[j, 1] + curve[j, 2] * (p - curve[j, 0]))
    while j + 1 < curve.shape[0]:
        knot, at_knot = LENGTH * (curve[j + 1, 0] - p), RADIUS * curve[j + 1, 1]
        left = square_a / (at_knot + stiff_a * knot) ** 2 + square_b / (at_knot + stiff_b * knot) ** 2
        # written so that NaN leaves the loop
        if not left > 1.0:
            break
        j, x, radius = j + 1, knot, at_knot
    slope = 2.0 / 3.0 * curve[j, 2]
    if square_a == 0.0:
        step = (np.sqrt(square_b) - radius - stiff_b * x) / (slope + stiff_b)
        return x + step, radius + slope * step, slope, 1
    begin, at_begin = x, radius
    for count in range(1, MOST_ITERATIONS + 1):
        a, b = radius + stiff_a * x, radius + stiff_b * x
        left_a, left_b = square_a / a**2, square_b / b**2
        left = left_a + left_b
        root = np.sqrt(left)
        x += left * (root - 1.0) / (left_a * (slope + stiff_a) / a + left_b * (slope + stiff_b) / b)
        radius = at_begin + slope * (x - begin)
        if not root - 1.0 > CLOSE:
            return x, radius, slope, count
    return np.nan, np.nan, slope, MOST_ITERATIONS


def yield_work(curve, p):
    """Integral of the yield stress over the equivalent plastic strain, from 0 on [stress].

    Parameters
    ----------
    curve : ndarray (k, 3)
    p : ndarray
        Equivalent plastic strain.

    Returns
    -------
    ndarray
        Of the shape of ``p``.
    """
    work = np.zeros_like(p)
    for (start, stress, slope), end in zip(curve, [*curve[1:, 0], np.inf], strict=True):
        part = np.clip(p, start, end) - start
        work += part * (stress + 0.5 * slope * part)
    return work
