"""Laws of friction: the bound of the tangential traction, and the projection on what the law admits.

A law is one row of numbers ``(base, coefficient, limit)``. The bound follows the normal part of the augmented traction,

    rho(tau_n) = base - coefficient tau_n,   at least 0 and at most the limit

* Coulomb: (0, F, inf); with a cap s: (0, F, s).
* Coulomb with an adhesion c that no load asks for: (c, F, s), Mohr's straight line. It ends in tension, at
  tau_n = c / F, where a point has opened by a small part of its facet: a bound that ended with the pressure would make
  the traction jump when a point opens, and some problems would have no solution.
* Tresca: (s, 0, s). The bound holds on the whole surface, as in the literature.

A further law is a further form of :func:`bound`, with its derivative; nothing else knows of it.
"""

import numpy as np

from pcontact.runtime.jit import njit_inner

OPEN, STICK, SLIP = 0, 1, 2
# the law of tied surfaces: a bound that nothing reaches
TIED = np.array([np.inf, 0.0, np.inf])


def friction_law(contact):
    """The row of numbers (3,) of a contact's law; None where it is frictionless.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact

    Returns
    -------
    ndarray (3,) or None
        base [stress], coefficient [1], limit [stress].
    """
    if contact.tied:
        return TIED
    if contact.tresca:
        return np.array([contact.tresca, 0.0, contact.tresca])
    if contact.friction or contact.adhesion:
        limit = np.inf if contact.friction_limit is None else contact.friction_limit
        return np.array([contact.adhesion or 0.0, contact.friction, limit])
    return None


@njit_inner
def bound(law, tau_n):
    """The bound rho of the tangential traction, and its derivative with respect to tau_n."""
    rho = law[0] - law[1] * tau_n
    if rho < 0.0:
        return 0.0, 0.0
    if rho > law[2]:
        return law[2], 0.0
    return rho, -law[1]


@njit_inner
def project(law, bilateral, normal, tau, traction, derivative):
    """Traction that the law makes of an augmented traction, and its generalised derivative.

    Parameters
    ----------
    law : ndarray (3,)
    bilateral : bool
        No separation.
    normal, tau : ndarray (d,)
    traction : ndarray (d,)
        Out: P(tau).
    derivative : ndarray (d, d)
        Out: D = dP/dtau; an element of it at the kinks: closed where tau_n = 0, stick where |tau_T| = rho.

    Returns
    -------
    int
        OPEN, STICK or SLIP.
    """
    d = len(normal)
    tau_n = 0.0
    for i in range(d):
        tau_n += tau[i] * normal[i]
    closed = bilateral or tau_n <= 0.0
    length = 0.0
    for i in range(d):
        length += (tau[i] - tau_n * normal[i]) ** 2
    length = np.sqrt(length)
    rho, slope = bound(law, tau_n)
    tangential = closed or rho > 0.0
    stick = tangential and length <= rho
    push = tau_n if closed else 0.0
    along = closed * 1.0
    share = 1.0 if stick else (rho / length if tangential and length > 0.0 else 0.0)
    for i in range(d):
        across_i = tau[i] - tau_n * normal[i]
        traction[i] = push * normal[i] + share * across_i
        for j in range(d):
            nn = normal[i] * normal[j]
            unit = 1.0 if i == j else 0.0
            value = along * nn + share * (unit - nn)
            if tangential and not stick:
                s_i = across_i / length
                s_j = (tau[j] - tau_n * normal[j]) / length
                value += -share * s_i * s_j + slope * s_i * normal[j]
            derivative[i, j] = value
    if not tangential:
        return OPEN
    return STICK if stick else SLIP
