"""Numbers of a contact pair for report and log, and what it does to the bodies."""

import numpy as np

from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.runtime.petsc import MPI
from pcontact.space.turn import moments


def summarise(state, flips, lost, comm):
    """Sums and extremes of the quadrature points of all ranks. *Collective.*

    Parameters
    ----------
    state : dict of str to ndarray
        See `pcontact.contact.pair.ContactPair.state`.
    flips : list of int
        Points of this rank whose status changed in each Newton iteration.
    lost : (int, int)
        Points of this rank that have passed into their partner, and that have left it.
    comm : MPI.Comm

    Returns
    -------
    dict
        ``force`` on the target (d,) [force], ``area`` of the closed points, ``max_pressure`` [stress],
        ``max_penetration`` [length] and ``deepest``, the reference position where it is, ``least_gap`` of the points
        with a partner [length] (None: there is none), ``open``, ``stick``, ``slip``
        (points), ``flipped`` (points that changed their status in the last Newton iteration), ``passed`` and ``left``
        (points that frozen partners have misled). The same on every rank.
    """
    status, weight, x = state["status"], state["weight"], state["x"]
    closed, d = status > OPEN, x.shape[1]
    sums = np.concatenate([
        -(state["traction"] * weight[:, None]).sum(axis=0),
        [weight[closed].sum(), np.sum(~closed), np.sum(status == STICK), np.sum(status == SLIP)],
        [flips[-1] if flips else 0, *lost],
    ])  # fmt: skip
    sums = comm.allreduce(sums, op=MPI.SUM)
    depth = np.where(closed, -state["gap"], 0.0)
    k = int(np.argmax(depth)) if len(depth) else -1
    deepest, where = 0.0, np.zeros(d)
    for value, at in comm.allgather((float(depth[k]), x[k]) if k >= 0 else (0.0, where)):
        if value > deepest:
            deepest, where = value, at
    top = comm.allreduce(float(np.max(state["pressure"], initial=0.0)), op=MPI.MAX)
    near = comm.allreduce(float(np.min(state["gap"][state["paired"]], initial=np.inf)), op=MPI.MIN)
    n_open, n_stick, n_slip, flipped, passed, left = (int(n) for n in sums[d + 1 :])
    return {
        "force": sums[:d].tolist(),
        "area": float(sums[d]),
        "max_pressure": top,
        "max_penetration": deepest,
        "deepest": where.tolist(),
        "least_gap": near if near < np.inf else None,
        "open": n_open,
        "stick": n_stick,
        "slip": n_slip,
        "flipped": flipped,
        "passed": passed,
        "left": left,
    }


def resultants(state, places, comm):
    """Forces of the quadrature points of all ranks together. *Collective.*

    Parameters
    ----------
    state : dict of str to ndarray
        See `pcontact.contact.pair.ContactPair.state`.
    places : ndarray (np, d)
        Of the points [length].
    comm : MPI.Comm

    Returns
    -------
    dict
        On the target: ``normal_force`` and ``friction_force`` (d,) [force], whose sum is the force, and ``moment``, a
        number in the plane, (3,) in space, about the origin [force * length]; ``centre`` (d,) of the normal force, NaN
        where there is none [length]. The same on every rank.
    """
    weight, normal, d = state["weight"], state["normal"], places.shape[1]
    total = -state["traction"] * weight[:, None]
    along = np.einsum("pd,pd->p", total, normal)
    pressing = along[:, None] * normal
    moment = np.atleast_1d(moments(places, total))
    sums = np.concatenate([
        pressing.sum(axis=0), (total - pressing).sum(axis=0), np.abs(along) @ places, [np.abs(along).sum()], moment
    ])  # fmt: skip
    sums = comm.allreduce(sums, op=MPI.SUM)
    centre = sums[2 * d : 3 * d] / sums[3 * d] if sums[3 * d] > 0.0 else np.full(d, np.nan)
    moment = sums[3 * d + 1 :].tolist()
    return {
        "normal_force": sums[:d].tolist(), "friction_force": sums[d : 2 * d].tolist(), "centre": centre.tolist(),
        "moment": moment if d == 3 else moment[0],
    }  # fmt: skip


def components_of(space, pairing, source):
    """Connected components of the points of a source and of their partners: (np,), (np,). *Collective.*

    Returns
    -------
    tuple of ndarray of int
        -1 for points without a partner that is a body.
    """
    numbers = np.zeros((space.n_owned, space.dim))
    numbers[:, 0] = space.component[space.owned_local]
    vector = space.vector()
    vector.setArray(numbers.ravel())
    of_node = np.rint(pairing.exchange.gather(vector)[:, 0]).astype(np.int64)
    vector.destroy()
    own = of_node[pairing.cells[source.facet, 0]]
    other = np.full(len(own), -1, dtype=np.int64)
    if pairing.targets.shape[1]:
        other[pairing.paired] = of_node[pairing.targets[pairing.paired, 0]]
    return own, other


def borne(space, pairing, source, traction):
    """What contact with others does to every connected component. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pairing : pcontact.contact.pair.Pairing
    source : pcontact.contact.surface.sides.SourceSurface
    traction : ndarray (np,)
        Magnitude of a traction at the points [stress].

    Returns
    -------
    ndarray (n_components,)
        Sum of the magnitudes of the forces at the points of this rank [force]: forces that balance count, too.
    """
    own, other = components_of(space, pairing, source)
    force = np.where(own == other, 0.0, traction * source.jxw)
    total = np.bincount(own, force, minlength=space.mesh.n_components)
    return total + np.bincount(other[other >= 0], force[other >= 0], minlength=space.mesh.n_components)
