"""Which other ranks have a node, and what ranks tell each other of the edges they cut."""

import numpy as np

from pcontact.runtime.parallel import split_by_rank

# bits of a node; further neighbours have the last one together
BITS = 64


class Neighbours:
    """The ranks that share nodes with this one. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    numbers : ndarray (n,)
        Of the nodes of this rank.
    n_total : int
        Numbers are below it.

    Attributes
    ----------
    ranks : ndarray
        Ascending.
    shared : ndarray (n,) uint64
        Bits of the neighbours that have a node.
    """

    def __init__(self, exchanger, numbers, n_total):
        self._exchanger = exchanger
        size = exchanger.comm.size
        self.shared = np.zeros(len(numbers), dtype=np.uint64)
        self.ranks = np.zeros(0, dtype=np.int64)
        if size == 1:
            return
        sends, _ = split_by_rank(numbers * size // max(n_total, 1), numbers)
        heard = exchanger(sends, np.int64, 1)
        told = exchanger(_several(heard), np.int64, 2)
        rows = np.concatenate([np.zeros((0, 2), dtype=np.int64), *told.values()])
        self.ranks = np.unique(rows[:, 1])
        bit = np.minimum(np.searchsorted(self.ranks, rows[:, 1]), BITS - 1).astype(np.uint64)
        order = np.argsort(numbers, kind="stable")
        at = order[np.searchsorted(numbers, rows[:, 0], sorter=order)]
        np.bitwise_or.at(self.shared, at, np.uint64(1) << bit)

    def tell(self, keys, shared):
        """Send keys (n,) uint64 to the neighbours whose bits are set; those that came, in one array. *Collective.*"""
        sends = {}
        for k, rank in enumerate(self.ranks):
            wanted = (shared >> np.uint64(min(k, BITS - 1))) & np.uint64(1) == 1
            if wanted.any():
                sends[int(rank)] = keys[wanted].view(np.int64)
        heard = self._exchanger(sends, np.int64, 1)
        return np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in heard.values())]).view(np.uint64)


def _several(heard):
    """Of numbers that several ranks have: number and other rank, for each of them."""
    if not heard:
        return {}
    numbers = np.concatenate([part.ravel() for part in heard.values()])
    ranks = np.concatenate([np.full(len(part), rank) for rank, part in heard.items()])
    order = np.lexsort((ranks, numbers))
    numbers, ranks = numbers[order], ranks[order]
    _, first, counts = np.unique(numbers, return_index=True, return_counts=True)
    rows = [np.zeros((0, 3), dtype=np.int64)]
    for count in np.unique(counts[counts > 1]):
        at = first[counts == count][:, None] + np.arange(count)
        for i in range(count):
            for j in range(count):
                if i != j:
                    rows.append(np.column_stack([ranks[at[:, i]], numbers[at[:, i]], ranks[at[:, j]]]))
    rows = np.concatenate(rows)
    return split_by_rank(rows[:, 0], rows[:, 1:])[0]
