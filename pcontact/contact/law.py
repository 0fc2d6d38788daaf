"""Laws of contact: what tractions an augmented traction tau is projected on.

Between two kernels of a formulation (`pcontact.contact.formulation`), a law makes of tau (np, d) the traction P(tau)
(np, d), its generalised derivative D (np, d, d), and the status of the points. A law of friction of one's own is a
subclass of :class:`FrictionLaw` with a method :meth:`~FrictionLaw.bound`, which :func:`add_law` gives a name.

The laws here are one row of numbers ``(base, coefficient, limit)``. The bound follows the normal part of tau,

    rho(tau_n) = base - coefficient tau_n,   at least 0 and at most the limit

* Coulomb: (0, F, inf); with a cap s: (0, F, s).
* Coulomb with an adhesion c that no load asks for: (c, F, s), Mohr's straight line. It ends in tension, at
  tau_n = c / F, where a point has opened by a small part of its facet: a bound that ended with the pressure would make
  the traction jump when a point opens, and some problems would have no solution.
* Coulomb with a coefficient that varies: a row (0, F, s) for each point, see :class:`VaryingCoulomb`.
* Tresca: (s, 0, s). The bound holds on the whole surface, as in the literature.
* Tied: (inf, 0, inf), and no separation. Held: the same for the points that are closed.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.errors import coordinates, input_error
from pcontact.runtime.jit import njit, njit_inner
from pcontact.scene.functions import Prescribed

OPEN, STICK, SLIP = 0, 1, 2


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
    varies, slows : bool
        Whether it is asked for the numbers of its points in each load step; told how fast they slip.
    """

    bond = reach = 0.0
    varies = slows = False
    tangential = can_slip = tied = held = False
    follows_pressure = symmetric = True

    def closed(self, view, tau):
        """Points (np,) at which P_n = tau_n, from normal augmented tractions (np,)."""
        return view.paired & ((tau <= 0.0) | view.bilateral)


class FrictionLaw(Frictionless):
    """A law with a bound of the tangential traction: a subclass writes :meth:`bound`, all else has defaults.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        Whose keys may be numbers of the law.
    """

    tangential = can_slip = True
    symmetric = False

    def __init__(self, contact=None):
        self.contact = contact

    def bound(self, pressure):
        """The largest tangential traction of points under a pressure.

        Parameters
        ----------
        pressure : ndarray (np,)
            At least 0 [stress].

        Returns
        -------
        bound : ndarray (np,)
            At least 0 [stress].
        slope : ndarray (np,)
            Its derivative with respect to the pressure.
        """
        raise NotImplementedError(f"{type(self).__name__} has no method bound(pressure)")

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
        (STICKING if view.stick else self).bounded(view, normal, tau, traction, slope, status)
        return traction, status

    def bounded(self, view, normal, tau, traction, slope, status):
        """Write traction, status and, unless it has the length 0, ``slope`` of the paired points; the others are 0."""
        bound = self.bound_at(np.einsum("pd,pd->p", tau, normal), view.bilateral)
        project_all(bound, view.bilateral, view.paired, normal, tau, traction, slope, status)

    def bound_at(self, tau, bilateral):
        """The bound (np,) at normal augmented tractions (np,) of points, 0 where there is no pressure and they may
        part, and its derivative with respect to these."""
        rho, growth = self.bound(np.maximum(-tau, 0.0))
        return np.where((tau <= 0.0) | bilateral, rho, 0.0), np.where(tau < 0.0, -growth, 0.0)


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

    def bound_at(self, tau, bilateral):
        """See :meth:`FrictionLaw.bound_at`: the row says it, under tension, too."""
        return bound_of(self.row, tau)


def bound_of(row, tau):
    """The bound (np,) of a row of numbers, or of rows (3, np), and its derivative, at normal augmented tractions (np,).
    """
    base, coefficient, limit = row
    rho = base - coefficient * tau
    follows = (rho >= 0.0) & (rho <= limit)
    return np.clip(rho, 0.0, limit), np.where(follows, -coefficient, 0.0)


# a bound that no traction reaches where there is a pressure
STICKING = RowLaw([0.0, 1e8, np.inf])


class VaryingCoulomb(FrictionLaw):
    """Coulomb's law with a coefficient that is a function of place and time, and of the speed of slip.

    With a static coefficient F_s and a kinetic one F_k it is F = F_k + (F_s - F_k) exp(-c v), where v is the mean speed
    of slip in the last load step [length/time], zero where a point was open or stuck: what a load step does to the
    coefficient, the next one sees. Under a speed that stays the traction is that of the speed from the second load
    step on. A law that saw the speed of its own load step would have no unique traction: as F falls with v, so does
    what slip asks for, without bound as load steps get short.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact

    Attributes
    ----------
    rows : ndarray (np, 3)
        Of the load step.
    speed : ndarray (np,) or None
        Of slip in the last load step [length/time].
    """

    varies = True

    def __init__(self, contact):
        self._contact, self.rows = contact, np.zeros((0, 3))
        self._limit = np.inf if contact.friction_limit is None else contact.friction_limit
        self.slows, self.speed = contact.kinetic_friction is not None, None
        self.named("scene", f"contacts ({contact.name})")

    def named(self, file, where):
        """Say what messages call the scene and the contact."""
        said = {"friction": self._contact.friction, "kinetic_friction": self._contact.kinetic_friction}
        self._file, self._where = file, where
        self._values = {key: Prescribed(one, file, f"{where}.{key}") for key, one in said.items() if one is not None}

    def begin(self, x, time):
        """Take the coefficients of a load step.

        Parameters
        ----------
        x : ndarray (np, d)
            Undeformed places of the points [length].
        time : float
            At its end.

        Returns
        -------
        float
            The largest of them.

        Raises
        ------
        InputError
            On this rank: a coefficient is negative or not finite.
        """
        first, *others = (self._positive(key, x, time) for key in self._values)
        if self.slows:
            self.speed = np.zeros(len(x)) if self.speed is None else self.speed
            first = others[0] + (first - others[0]) * np.exp(-self._contact.friction_decay * self.speed)
        self.rows = np.column_stack([np.zeros(len(x)), first, np.full(len(x), self._limit)])
        return float(np.max(first, initial=0.0))

    def _positive(self, key, x, time):
        values = self._values[key](x, time)[:, 0]
        if np.any(values < 0.0):
            at = int(np.argmin(values))
            value = f"the value {values[at]:g} at the point {coordinates(x[at])} at time {time:g}"
            found = f"{getattr(self._contact, key)!r}, {value}"
            raise input_error(self._file, f"{self._where}.{key}", found, "numbers >= 0")
        return values

    def slid(self, slip, status, duration):
        """Take the slip (np, d) [length] of a load step of a duration, and the status (np,) of the points."""
        self.speed = np.where(status == SLIP, np.linalg.norm(slip, axis=1) / duration, 0.0)

    def bound_at(self, tau, bilateral):
        """See :meth:`FrictionLaw.bound_at`."""
        return bound_of(self.rows.T, tau)


class Tied(RowLaw):
    """Points are tied to their partners: P = tau."""

    can_slip, tied = False, True

    def __init__(self):
        super().__init__([np.inf, 0.0, np.inf])


class Held(Tied):
    """Points that are closed stay so, and stick, in tension too; all others stay open."""

    tied, held = False, True


def _tresca(contact):
    return RowLaw([contact.tresca, 0.0, contact.tresca]) if contact.tresca else None


def _coulomb(contact):
    if contact.kinetic_friction is not None or isinstance(contact.friction, str):
        return VaryingCoulomb(contact)
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
        From a :class:`pcontact.scene.model.Contact` to a law: a subclass of :class:`FrictionLaw`, or a function.
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


def sticks_by_shear(contact):
    """Return True if points stick by what the bodies on both sides say, see `pcontact.contact.formulation.methods`."""
    said = contact.alpha is not None or contact.stick_stiffness is not None
    # the adjoint term weighs tangential misfits with 1 / alpha, which cells that yield do not bear
    return contact_law(contact).tangential and not said and contact.theta == 0.0


@njit_inner
def project(rho, slope, bilateral, normal, tau, traction, derivative):
    """Traction that the law makes of an augmented traction, and its generalised derivative.

    Parameters
    ----------
    rho, slope : float
        Bound of the tangential traction, and its derivative with respect to tau_n.
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


@njit
def project_all(bound, bilateral, paired, normal, tau, traction, slope, status):
    """Write traction (np, d), status (np,) and, unless it has the length 0, derivative (np, d, d) of paired points.
    The bound has values (np,) and derivatives (np,)."""
    rho, growth = bound
    d = normal.shape[1]
    # one that all points overwrite, where nobody asks
    slope = slope if len(slope) > 0 else np.zeros((1, d, d))
    last = len(slope) - 1
    for p in range(len(paired)):
        if paired[p]:
            at = slope[min(p, last)]
            status[p] = project(rho[p], growth[p], bilateral, normal[p], tau[p], traction[p], at)
