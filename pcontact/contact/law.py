"""Laws of contact: what tractions an augmented traction tau is projected on.

Between two kernels of a formulation (`pcontact.contact.formulation`), a law makes of tau (np, d) the traction P(tau)
(np, d), its generalised derivative D (np, d, d), and the status of the points. A law of friction of one's own is a
subclass of :class:`FrictionLaw` with a method :meth:`~FrictionLaw.bounded`, which :func:`add_law` gives a name.

The laws here are one row of numbers ``(base, coefficient, limit)``. The bound follows the normal part of tau,

    rho(tau_n) = base - coefficient tau_n,   at least 0 and at most the limit

* Coulomb: (0, F, inf); with a cap s: (0, F, s).
* Coulomb with an adhesion c that no load asks for: (c, F, s), Mohr's straight line. It ends in tension, at
  tau_n = c / F, where a point has opened by a small part of its facet: a bound that ended with the pressure would make
  the traction jump when a point opens, and some problems would have no solution.
* Tresca: (s, 0, s). The bound holds on the whole surface, as in the literature.
* Tied: (inf, 0, inf), and no separation. Held: the same for the points that are closed.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit, njit_inner

OPEN, STICK, SLIP = 0, 1, 2
# a bound that no traction reaches where there is a pressure
STICKING = np.array([0.0, 1e8, np.inf])


class View(NamedTuple):
    """The points of a pair under a status rule, see `pcontact.assembly.item.StatusRule`.

    Attributes
    ----------
    paired : ndarray (np,) of bool
        Points that may close.
    bilateral : bool
        They are closed, whatever their traction.
    stick : bool
        Those that are closed stick.
    """

    paired: np.ndarray
    bilateral: bool
    stick: bool


class Frictionless:
    """Pressure alone: P_n = min(tau_n, 0).

    Attributes
    ----------
    tangential : bool
        Whether tractions have a tangential part.
    can_slip : bool
        Whether a bound decides between stick and slip.
    tied : bool
        Whether points are tied to the partners that they have in the undeformed bodies.
    held : bool
        Whether points that are closed stay as they are, and all others open.
    follows_pressure : bool
        Whether the bound is that of the pressure, so that open points bear nothing.
    symmetric : bool
        Whether the tangent of theta = 1 is symmetric.
    reach : float
        Tension tau_n from which points bear nothing [stress]; 0 also where there is no such tension.
    bond : float
        The bound where the normal traction is zero, if tension ends it [stress].
    """

    bond = reach = 0.0
    tangential = can_slip = tied = held = False
    follows_pressure = symmetric = True

    def closed(self, view, tau):
        """Points (np,) at which P_n = tau_n, from normal augmented tractions (np,)."""
        return view.paired & ((tau <= 0.0) | view.bilateral)


class FrictionLaw(Frictionless):
    """A law with a bound of the tangential traction."""

    tangential = can_slip = True

    def project(self, view, normal, tau, slope=None):
        """Traction and status of the points.

        Parameters
        ----------
        view : View
        normal, tau : ndarray (np, d)
            Contact normals and augmented tractions [stress].
        slope : ndarray (np, d, d), optional
            Out: D = dP/dtau; an element of it at the kinks: closed where tau_n = 0, stick where |tau_T| = rho.

        Returns
        -------
        traction : ndarray (np, d)
            P(tau) [stress].
        status : ndarray (np,)
            OPEN, STICK or SLIP.
        """
        traction, status = np.zeros_like(tau), np.zeros(len(tau), dtype=np.int64)
        slope = np.zeros((0, 0, 0)) if slope is None else slope
        if view.stick:
            project_rows(STICKING, view.bilateral, view.paired, normal, tau, traction, slope, status)
        else:
            self.bounded(view, normal, tau, traction, slope, status)
        return traction, status

    def bounded(self, view, normal, tau, traction, slope, status):
        """Write traction, status and, unless it has the length 0, ``slope`` of the paired points; the others are 0."""
        raise NotImplementedError


class RowLaw(FrictionLaw):
    """A law that is a row of numbers.

    Parameters
    ----------
    row : ndarray (3,)
        base [stress], coefficient [1], limit [stress].
    """

    def __init__(self, row):
        self.row = np.asarray(row, dtype=float)
        self.follows_pressure = bool(self.row[1] != 0.0)
        self.symmetric = not self.follows_pressure
        if self.follows_pressure:
            self.bond, self.reach = float(min(self.row[0], self.row[2])), float(self.row[0] / self.row[1])

    def bounded(self, view, normal, tau, traction, slope, status):
        """See :meth:`FrictionLaw.bounded`."""
        project_rows(self.row, view.bilateral, view.paired, normal, tau, traction, slope, status)


class Tied(RowLaw):
    """Points are tied to their partners: P = tau."""

    can_slip, tied = False, True

    def __init__(self):
        super().__init__([np.inf, 0.0, np.inf])
        self.symmetric = True


class Held(Tied):
    """Points that are closed stay so, and stick, in tension too; all others stay open."""

    tied, held = False, True


def _tresca(contact):
    return RowLaw([contact.tresca, 0.0, contact.tresca]) if contact.tresca else None


def _coulomb(contact):
    if not (contact.friction or contact.adhesion):
        return None
    limit = np.inf if contact.friction_limit is None else contact.friction_limit
    return RowLaw([contact.adhesion or 0.0, contact.friction, limit])


# what makes a law of a contact of the scene, or None where the contact does not ask for it; the first one counts
LAWS = {
    "held": lambda contact: Held() if contact.held else None,
    "tied": lambda contact: Tied() if contact.tied else None,
    "tresca": _tresca,
    "coulomb": _coulomb,
    "frictionless": lambda contact: Frictionless(),
}


# laws that programs have added, by the name that a contact says with `law`
ADDED = {}


def add_law(name, make):
    """Add a law of friction: scenes of this process choose it with ``law = "NAME"``.

    Parameters
    ----------
    name : str
    make : callable
        From a :class:`pcontact.scene.model.Contact` to a law, a :class:`FrictionLaw`.
    """
    ADDED[name] = make


def contact_law(contact):
    """The law of a contact.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
    """
    if contact.law is not None and not contact.held:
        return ADDED[contact.law](contact)
    return next(law for law in (make(contact) for make in LAWS.values()) if law is not None)


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


@njit_inner
def _project_all(law, bilateral, paired, normal, tau, traction, slope, status):
    last = len(slope) - 1
    for p in range(len(paired)):
        if paired[p]:
            status[p] = project(law, bilateral, normal[p], tau[p], traction[p], slope[min(p, last)])


@njit
def project_rows(law, bilateral, paired, normal, tau, traction, slope, status):
    """Write traction (np, d), status (np,) and, unless it has the length 0, derivative (np, d, d) of paired points."""
    d = normal.shape[1]
    # one that all points overwrite, where nobody asks
    slope = slope if len(slope) > 0 else np.zeros((1, d, d))
    _project_all(law, bilateral, paired, normal, tau, traction, slope, status)
