"""Points of a pair that open and close, for Newton's method and the stepper.

Where a contact recedes what opens are the points in tension, and the edge of what is left, by its pressures alone.
"""

from dataclasses import replace

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.contact import motion
from pcontact.contact.law import OPEN
from pcontact.contact.motion import borne
from pcontact.runtime.petsc import MPI

# [-] Area that opens, in parts of that which a full Newton step finds in tension. Row: opening. From: where the contact
# is taken too wide by d, the pressure near its edge is that of the edge sought plus that of a rigid punch, proportional
# to sqrt(x) - d / 2 / sqrt(x) at the distance x: it is a tension up to d / 2 only.
AGAIN = 2.0
# [-] Part of the force of the points without tension that those may bear which open nevertheless. Row: opening.
BORNE = 0.1
# [bins] Of equal ratio, by which pressures are told apart. From: chosen; a bin is 3 % of a pressure.
BINS = 1000
# [decades] Of the bins below the largest pressure. From: chosen; smaller pressures open together.
DECADES = 12.0


def weakest(pressure, area, opened, comm):
    """Points with the smallest pressures, as large an area as (AGAIN - 1) times one that opens. *Collective.*

    Parameters
    ----------
    pressure : ndarray (n,)
        Of the points of this rank that remain closed [stress].
    area : ndarray (n,)
        [length^(d - 1)]
    opened : float
        Area, on all ranks, of the points in tension [length^(d - 1)].
    comm : MPI.Comm

    Returns
    -------
    ndarray (n,) of bool
        Points whose pressures lie in the lowest bins; they bear at most `BORNE` of the force.
    """
    largest = comm.allreduce(float(pressure.max(initial=0.0)), op=MPI.MAX)
    if largest <= 0.0:
        return np.zeros(len(pressure), dtype=bool)
    ratio = np.maximum(pressure / largest, 10.0**-DECADES)
    place = np.minimum(BINS * (1.0 + np.log10(ratio) / DECADES), BINS - 1).astype(np.int64)
    sums = [np.bincount(place, area * values, minlength=BINS) for values in (np.ones(len(area)), pressure)]
    areas, forces = np.cumsum(comm.allreduce(np.stack(sums), op=MPI.SUM), axis=1)
    opens = (areas <= (AGAIN - 1.0) * opened) & (forces <= BORNE * forces[-1])
    return place < np.count_nonzero(opens)


def turned(closed, paired, tau, area):
    """What :meth:`PairActiveSet.turned` says, of points with augmented tractions tau (n,) [stress]."""
    opens, closes = closed & (tau > 0.0), paired & ~closed & (tau <= 0.0)
    return np.array([area[closed].sum(), area[opens].sum(), area[closes].sum(), np.count_nonzero(opens)])


def still_closed(closed, tau, area, comm):
    """Points (n,) that remain closed of those that are: without the ones in tension, and the `weakest`. *Collective.*

    Parameters
    ----------
    closed : ndarray (n,) of bool
    tau : ndarray (n,)
        Augmented normal traction [stress].
    area : ndarray (n,)
        [length^(d - 1)]
    comm : MPI.Comm
    """
    opened = comm.allreduce(float(area[closed & (tau > 0.0)].sum()), op=MPI.SUM)
    left = closed & (tau <= 0.0)
    rows = np.flatnonzero(left)
    left[rows[weakest(-tau[rows], area[rows], opened, comm)]] = False
    return left


class PairActiveSet(ActiveSet):
    """The active set of a pair (`pcontact.contact.pair.ContactPair`)."""

    def __init__(self, pair):
        self._pair = pair

    def closed_area(self):
        """Area of the points of this rank that were closed in the last tangent [length^(d - 1)]."""
        pair = self._pair
        return float(np.sum(pair.source.jxw[pair.status > OPEN])) if pair.status is not None else 0.0

    def active_nodes(self):
        """Owned nodes, global numbers, of the pair at points that were closed in the last tangent. *Collective.*"""
        pair = self._pair
        closed = pair.status > OPEN if pair.status is not None else np.zeros(len(pair.source.facet), dtype=bool)
        return pair.pairing.touched(pair.space, pair.pairing.paired & closed)

    def closed_count(self):
        """Points of this rank that were closed at the end of the last load step."""
        pair = self._pair
        return 0 if pair.law.tied else int(np.sum(pair.history.closed))

    def closed_areas(self):
        """Closed area (n_components,) at the end of the last load step, of this rank. *Collective.*"""
        pair = self._pair
        return borne(pair.space, pair.pairing, pair.source, pair.history.closed.astype(float))

    def bonds(self):
        """Forces (n_components,) that adhesion may exert without pressure, of this rank; any where contact bears
        tension. *Collective.*"""
        pair = self._pair
        bond = np.inf if pair.bilateral else pair.law.bond
        return borne(pair.space, pair.pairing, pair.source, np.where(pair.pairing.paired, bond, 0.0))

    def area_changed_by_supports(self, before, u):
        """Area of the points of this rank that ``u``, in which only supports have moved, opens or closes. *Collective.*

        Obstacles have moved already: against them the comparison is with the last load step, else with the
        displacement ``before``.
        """
        pair = self._pair
        now = pair.pressed(u)
        then = np.where(pair.history.closed, -1.0, 1.0) if pair.rigid else pair.pressed(before)
        # surfaces that just touch are closed, and remain so
        return float(np.sum(pair.source.jxw[(now * then < 0.0) & pair.pairing.paired]))

    @property
    def _recedes(self):
        """Whether the pressure says what is open, and a tangent has been asked for."""
        pair = self._pair
        return not pair.bilateral and pair.law.follows_pressure and pair.status is not None

    def turned(self, u):
        """See :meth:`pcontact.assembly.item.ActiveSet.turned`. *Collective.*"""
        pair = self._pair
        if not pair.law.follows_pressure:
            return np.full(4, np.inf)
        if not self._recedes:
            return np.zeros(4)
        p = pair.pairing
        return turned(pair.status > OPEN, p.paired, pair.pressed(u, p.acts), pair.source.jxw)

    def recede(self, u, rule):
        """Keep open what is open in the last tangent or in tension in ``u``, and the edge of the rest, see
        :func:`still_closed`. *Collective.*
        """
        pair = self._pair
        if not self._recedes:
            return rule
        comm, closed = pair.space.comm, pair.status > OPEN
        left = still_closed(closed, pair.pressed(u, pair.pairing.acts), pair.source.jxw, comm)
        before, after = comm.allreduce(np.array([closed.sum(), left.sum()]), op=MPI.SUM)
        return None if after == 0 < before else replace(rule, opened=~left)

    def step_limit(self, u, y, falls=None):
        """See :func:`pcontact.contact.motion.step_limit`. *Collective.*"""
        pair = self._pair
        return motion.step_limit(pair, u, y, falls) if pair.floats and not pair.law.tied else None

    def clearance(self, u, fields, beyond=False):
        """See :func:`pcontact.contact.motion.clearance`. *Collective.*"""
        return motion.clearance(self._pair, u, fields, beyond)

    def force_magnitudes(self, u):
        """Magnitudes of the forces on every component, see :func:`pcontact.contact.motion.borne`. *Collective.*"""
        pair = self._pair
        return borne(pair.space, pair.pairing, pair.source, np.linalg.norm(pair.state(u)["traction"], axis=1))
