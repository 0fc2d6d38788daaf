"""What opens where a contact recedes: points in tension, and the edge of what is left, by its pressures alone."""

import numpy as np

from pcontact.runtime.petsc import MPI

# [points] So many, and such a part of the closed area, have to open, or to close, for a rule that takes a contact to
# grow or to recede all along its edge. Row: opening.
MANY = 12
# [-] See MANY. Row: opening.
WIDE = 0.02
# [-] Part of that area which may change the other way at the same time. Row: opening.
MIXED = 0.1
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
    """What :meth:`pcontact.assembly.item.Item.turned` says, from statuses and augmented tractions tau (n,) [stress]."""
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
