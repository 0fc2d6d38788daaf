"""Numbers of a contact pair for report and log."""

import numpy as np

from pcontact.contact.laws import OPEN, SLIP, STICK
from pcontact.runtime.petsc import MPI


def summarise(state, flips, comm):
    """Sums and extremes of the quadrature points of all ranks. *Collective.*

    Parameters
    ----------
    state : dict of str to ndarray
        See `pcontact.contact.item.ContactItem.state`.
    flips : list of int
        Points of this rank whose status changed in each Newton iteration.
    comm : MPI.Comm

    Returns
    -------
    dict
        ``force`` on the target (d,) [force], ``area`` of the closed points, ``max_pressure`` [stress],
        ``max_penetration`` [length] and ``deepest``, the reference position where it is, ``open``, ``stick``, ``slip``
        (points), ``flipped`` (points that changed their status in the last Newton iteration). The same on every rank.
    """
    status, weight, x = state["status"], state["weight"], state["x"]
    closed, d = status > OPEN, x.shape[1]
    sums = np.concatenate([
        -(state["traction"] * weight[:, None]).sum(axis=0),
        [weight[closed].sum(), np.sum(~closed), np.sum(status == STICK), np.sum(status == SLIP)],
        [flips[-1] if flips else 0],
    ])  # fmt: skip
    sums = comm.allreduce(sums, op=MPI.SUM)
    depth = np.where(closed, -state["gap"], 0.0)
    k = int(np.argmax(depth)) if len(depth) else -1
    deepest, where = 0.0, np.zeros(d)
    for value, at in comm.allgather((float(depth[k]), x[k]) if k >= 0 else (0.0, where)):
        if value > deepest:
            deepest, where = value, at
    top = comm.allreduce(float(np.max(state["pressure"], initial=0.0)), op=MPI.MAX)
    n_open, n_stick, n_slip, flipped = (int(n) for n in sums[d + 1 :])
    return {
        "force": sums[:d].tolist(),
        "area": float(sums[d]),
        "max_pressure": top,
        "max_penetration": deepest,
        "deepest": where.tolist(),
        "open": n_open,
        "stick": n_stick,
        "slip": n_slip,
        "flipped": flipped,
    }
