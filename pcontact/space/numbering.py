"""Numbers for nodes that several ranks share: contiguous on each rank, agreed by rendezvous."""

import numpy as np

from pcontact.runtime.parallel import split_by_rank


class Numbering:
    """Global numbers of the nodes of one rank.

    Parameters
    ----------
    comm : MPI.Comm
    exchanger : pcontact.runtime.parallel.Exchanger
    keys : ndarray (n,)
        Unique keys that all ranks agree on (node numbers of the file), in the order wanted for owned nodes.
    n_keys : int
        Keys are below this number.

    Attributes
    ----------
    numbers : ndarray (n,)
        Global number of each node.
    n_owned, start, n_total : int
    ranges : ndarray (size + 1,)

    Notes ----- Each key has a home rank that hears of all ranks with the node and picks the owner, turn by turn, so
    that shared nodes are spread evenly. *Collective.*
    """

    def __init__(self, comm, exchanger, keys, n_keys):
        self.rank = comm.rank
        home = keys * comm.size // max(n_keys, 1)
        sends, order = split_by_rank(home, keys)
        asked = exchanger(sends, np.int64, 1)
        replies = self._choose(asked)
        answer = exchanger(replies, np.int64, 1)
        owner = np.empty(len(keys), dtype=np.int64)
        if len(keys):
            owner[order] = np.concatenate([answer[r].ravel() for r in sorted(sends)])
        mine = owner == comm.rank
        self.n_owned = int(mine.sum())
        counts = np.array(comm.allgather(self.n_owned), dtype=np.int64)
        self.ranges = np.concatenate([[0], np.cumsum(counts)])
        self.start, self.n_total = int(self.ranges[comm.rank]), int(self.ranges[-1])
        self.numbers = np.empty(len(keys), dtype=np.int64)
        self.numbers[mine] = self.start + np.arange(self.n_owned)
        self._tell(exchanger, keys, owner, mine)

    @staticmethod
    def _choose(asked):
        """Owner of every key, for each rank that asked."""
        if not asked:
            return {}
        ranks = np.concatenate([np.full(len(k), r) for r, k in asked.items()])
        keys = np.concatenate([k.ravel() for k in asked.values()])
        order = np.lexsort((ranks, keys))
        unique, first, counts = np.unique(keys[order], return_index=True, return_counts=True)
        owners = ranks[order][first + unique % counts]
        return {r: owners[np.searchsorted(unique, k.ravel())] for r, k in asked.items()}

    def _tell(self, exchanger, keys, owner, mine):
        """Ask the owners for the numbers of the nodes that are not owned here."""
        away = np.flatnonzero(~mine)
        sends, order = split_by_rank(owner[away], keys[away])
        asked = exchanger(sends, np.int64, 1)
        own_keys, own_numbers = keys[mine], self.numbers[mine]
        by_key = np.argsort(own_keys)
        replies = {
            r: own_numbers[by_key[np.searchsorted(own_keys, k.ravel(), sorter=by_key)]] for r, k in asked.items()
        }
        answer = exchanger(replies, np.int64, 1)
        if len(away):
            self.numbers[away[order]] = np.concatenate([answer[r].ravel() for r in sorted(sends)])

    def owner(self, numbers):
        """Rank that owns each global number."""
        return np.searchsorted(self.ranges, numbers, side="right") - 1
