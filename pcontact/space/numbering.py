"""Numbers of nodes that several ranks share: contiguous on each rank, those of a PetscSection on a DMPlex."""

import numpy as np

from pcontact.mesh.plex import leaves, told


class Numbering:
    """Global numbers of the nodes of one rank. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    n : int
        Nodes of this rank, in the order wanted for owned nodes.
    sf : PETSc.SF or None
        From points to their owners, see :func:`pcontact.mesh.plex.owners`.
    first : int
        Points of `sf` that come before the nodes, all of them of this rank alone.

    Attributes
    ----------
    numbers : ndarray (n,)
        Global number of each node.
    n_owned, start, n_total : int
    ranges : ndarray (size + 1,)
    """

    def __init__(self, comm, n, sf, first=0):
        self.rank = comm.rank
        mine = np.ones(first + n, dtype=bool)
        mine[:first] = mine[leaves(sf)] = False
        self.n_owned = int(mine.sum())
        counts = np.array(comm.allgather(self.n_owned), dtype=np.int64)
        self.ranges = np.concatenate([[0], np.cumsum(counts)])
        self.start, self.n_total = int(self.ranges[comm.rank]), int(self.ranges[-1])
        numbers = np.zeros(first + n, dtype=np.int64)
        numbers[mine] = self.start + np.arange(self.n_owned)
        self.numbers = told(sf, numbers)[first:]

    def owner(self, numbers):
        """Rank that owns each global number."""
        return np.searchsorted(self.ranges, numbers, side="right") - 1
