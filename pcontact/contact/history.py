"""Memory of the points of a pair from load step to load step: status, speed, slip and wear."""

import numpy as np

from pcontact.contact.law import OPEN, SLIP
from pcontact.runtime.parallel import kept_rows, take_rows
from pcontact.runtime.petsc import MPI

# of the table of slip and wear in a checkpoint
PATH = "path"


class PointHistory:
    """State of the points of a pair at the end of the last load step.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface
    law : pcontact.contact.law.Frictionless
    terms : pcontact.contact.formulation.small.SmallTerms
        Remember what they need themselves.
    wears : bool
        Whether slip and wear are summed up.

    Attributes
    ----------
    committed : ndarray (np,) of int
        Status of the points, see `pcontact.contact.law`.
    time : float
        At its end.
    begun : bool
        Whether there has been one.
    path : SlipPath or None
        Slip and wear so far, where they are asked for and points can slip.
    """

    def __init__(self, source, law, terms, wears=False):
        self._source, self._law, self._terms = source, law, terms
        self.committed = np.full(len(source.facet), OPEN, dtype=np.int64)
        self.time, self.begun = 0.0, False
        slips = (law.tangential or law.held) and not law.tied
        self.path = SlipPath(len(source.facet)) if wears and slips else None

    @property
    def closed(self):
        """Points (np,) that were closed at the end of the last load step."""
        return self.committed > OPEN

    def commit(self, pairing, values, view, time):
        """Take status, speed of slip and what the terms remember to the end of a load step. *Collective.*"""
        duration, self.time, self.begun = time - self.time, time, True
        slip = self._terms.slip(pairing, values) if self._law.slows else None
        self.committed = self._terms.commit(pairing, values, view)
        if slip is not None:
            self._law.slid(slip, self.committed, duration)

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have."""
        return self._source.point_keys()

    def memory(self):
        """Tables for a checkpoint, see :meth:`pcontact.assembly.item.Item.memory`."""
        keys, rows, law = self.memory_keys(), np.flatnonzero(self.closed), self._law
        status = {} if law.tied else {"status": (keys[rows], self.committed[rows, None].astype(float))}
        if law.slows and law.speed is not None:
            status["speed"] = kept_rows(keys, law.speed[:, None])
        path = {} if self.path is None else self.path.memory(keys)
        return {**status, **path, **self._terms.memory(keys)}

    def recall(self, name, chunks):
        """Take a table back, see :meth:`pcontact.assembly.item.Item.recall`."""
        keys, law = self.memory_keys(), self._law
        if name == PATH:
            return None if self.path is None else self.path.recall(keys, chunks)
        speeds = name == "speed" and law.slows
        if not speeds and (name != "status" or law.tied):
            return self._terms.recall(name, keys, chunks)
        values = np.zeros((len(keys), 1))
        count = take_rows(keys, chunks, values)
        if speeds:
            law.speed = values[:, 0]
        else:
            self.committed = values[:, 0].astype(np.int64)
        return count


class SlipPath:
    """Sums of a pair over the load steps, at its points.

    Parameters
    ----------
    n : int
        Points of this rank.

    Attributes
    ----------
    slip : ndarray (n,)
        Slip of the last load step at points that slide at its end [length].
    table : ndarray (n, 3)
        Slip of all load steps [length], the integral of the pressure over it [stress * length], and the pressure at
        the end of the last load step [stress].
    """

    def __init__(self, n):
        self.slip, self.table = np.zeros(n), np.zeros((n, 3))

    def add(self, state):
        """Add a load step that ends in a state, see `pcontact.contact.pair.ContactPair.state`. Over the slip the
        pressure is linear; points that stick at the end have moved by what the formulation lets them."""
        pressure = np.maximum(state["pressure"], 0.0)
        # what a phase ties does not slip
        slip = np.linalg.norm(state["slip"], axis=1) if "slip" in state else np.zeros_like(pressure)
        self.slip = np.where((state["status"] == SLIP) & (pressure > 0.0), slip, 0.0)
        self.table[:, 0] += self.slip
        self.table[:, 1] += 0.5 * (self.table[:, 2] + pressure) * self.slip
        self.table[:, 2] = pressure

    def fields(self):
        """Fields (n,) of the points, by the names of `pcontact.io.names`."""
        return {"slip": self.slip, "slip_total": self.table[:, 0], "wear_per_coefficient": self.table[:, 1]}

    def summary(self, areas, comm):
        """Numbers for the report, the same on every rank. *Collective.*

        Parameters
        ----------
        areas : ndarray (n,)
            Of the points.
        comm : MPI.Comm

        Returns
        -------
        dict
            Largest slip of the load step and of all [length], largest depth of wear over its coefficient
            [stress * length], and its volume over it [force * length].
        """
        top = [float(np.max(values, initial=0.0)) for values in self.fields().values()]
        slip, total, wear = np.max(comm.allgather(top), axis=0)
        volume = comm.allreduce(float(self.table[:, 1] @ areas), op=MPI.SUM)
        return {"max_slip": float(slip), "max_slip_total": float(total), "max_wear_per_coefficient": float(wear),
                "wear_volume_per_coefficient": volume}  # fmt: skip

    def memory(self, keys):
        """The table for a checkpoint, see `pcontact.assembly.item.Item.memory`."""
        return {PATH: kept_rows(keys, self.table)}

    def recall(self, keys, chunks):
        """Take it back, see `pcontact.assembly.item.Item.recall`."""
        self.table = np.zeros_like(self.table)
        return take_rows(keys, chunks, self.table)
