"""How far the points of a contact have slipped, and what has pressed them meanwhile: what wears them."""

import numpy as np

from pcontact.contact.law import SLIP
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# of the table in a checkpoint
NAME = "path"


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
        rows = np.flatnonzero(self.table.any(axis=1))
        return {NAME: (keys[rows], self.table[rows])}

    def recall(self, keys, chunks):
        """Take it back, see `pcontact.assembly.item.Item.recall`."""
        self.table = np.zeros_like(self.table)
        return take_rows(keys, chunks, self.table)
