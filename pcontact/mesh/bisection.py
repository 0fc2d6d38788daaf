"""Weighted recursive bisection of cells that are spread over the ranks in any way.

Each part is cut by a plane at the exact weighted median, until there are as many parts as wanted. The result does not
depend on the spread: positions are computed cell by cell, sums are of integers, and cells at the same position are
told apart by their numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcontact.mesh.planes import Chooser, reduced
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.petsc import MPI

# the work of a cell of weight 1
UNIT = 1024
# positions within a part are whole numbers of so many bits, found DIGIT bits at a time
BITS, DIGIT = 50, 10
# so many cells are sorted instead
FEW = 256


@dataclass
class Cells:
    """What a partition has to know of the cells of one rank.

    Attributes
    ----------
    comm : MPI.Comm
    centres : ndarray (n, d + k)
        Positions [length], and k further coordinates, which are cut along, too.
    ids : ndarray (n,) int64
        Numbers, each once on all ranks together.
    work : ndarray (n,) int64
        In `UNIT`, above zero.
    contact : ndarray (n,) int64
        Contact work, to be spread evenly, too.
    corners : callable
        Vertices (m, k, d) of cells given by their rows (m,).
    contact_weight : float
        Work of contact 1, which is part of ``work``.
    dim : int, optional
        d, if there are further coordinates.
    """

    comm: object
    centres: np.ndarray
    ids: np.ndarray
    work: np.ndarray
    contact: np.ndarray
    corners: Callable
    contact_weight: float = 0.0
    dim: int | None = None

    def __post_init__(self):
        self.dim = self.centres.shape[1] if self.dim is None else self.dim
        self.n_total = self.comm.allreduce(len(self.ids))


@njit_exact
def _ends(slot, centres, normals, position, low, high):
    """Position of every cell along the normal of its part, and the extremes of the parts."""
    for c in range(slot.shape[0]):
        a = slot[c]
        if a >= 0:
            s = 0.0
            for i in range(centres.shape[1]):
                s += centres[c, i] * normals[a, i]
            position[c] = s
            low[a], high[a] = min(low[a], s), max(high[a], s)


@njit_exact
def _keys(slot, position, low, scale, top, out):
    """Whole numbers from 0 to top in the order of the positions."""
    for c in range(slot.shape[0]):
        a = slot[c]
        if a >= 0:
            out[c] = min(max(np.int64((position[c] - low[a]) * scale[a]), 0), top)


@njit_exact
def _count(slot, keys, work, shift, prefix, digit, out):
    """Work and number of the cells of parts that begin with a prefix, by their next digit (shift < 0: not wanted)."""
    for c in range(slot.shape[0]):
        a = slot[c]
        if a >= 0 and shift[a] >= 0 and keys[c] >> (shift[a] + digit) == prefix[a]:
            b = (keys[c] >> shift[a]) & ((1 << digit) - 1)
            out[0, a, b] += work[c]
            out[1, a, b] += 1


@njit_exact
def _within(slot, keys, shift, prefix, out):
    """Whether cells begin with the prefix of their part."""
    for c in range(slot.shape[0]):
        a = slot[c]
        out[c] = a >= 0 and keys[c] >> shift[a] == prefix[a]


@njit_exact
def _divide(slot, keys, ids, last_key, last_id, right, out):
    """New slots: a cell stays in that of its part up to (last_key, last_id), and goes to the right one beyond."""
    for c in range(slot.shape[0]):
        a = slot[c]
        if a >= 0:
            beyond = keys[c] > last_key[a] or (keys[c] == last_key[a] and ids[c] > last_id[a])
            out[c] = right[a] if beyond else out[c]


def _narrow(cells, slot, keys, shares, sizes):
    """Where the cut of every part is, down to a few cells. *Collective.*

    Returns
    -------
    shift, prefix : ndarray (n_parts,) int64
        Cells whose keys begin with the prefix have to be looked at.
    wanted : ndarray (n_parts,) int64
        Work that is to be left of the cut, without that of the cells before.
    """
    n_parts = len(shares)
    prefix, wanted = np.zeros((2, n_parts), dtype=np.int64)
    shift = np.full(n_parts, BITS, dtype=np.int64)
    fixed = np.zeros(n_parts, dtype=bool)
    for step in range(BITS // DIGIT):
        looked = np.where(fixed, -1, BITS - DIGIT * (step + 1))
        table = np.zeros((2, n_parts, 1 << DIGIT), dtype=np.int64)
        _count(slot, keys, cells.work, looked, prefix, DIGIT, table)
        work, count = reduced(cells.comm, table, MPI.SUM)
        if step == 0:
            wanted = np.round(work.sum(axis=1) * shares).astype(np.int64)
            # few cells are dealt out one by one
            fixed = count.sum(axis=1) <= np.maximum(FEW, 4 * sizes)
        upto = np.cumsum(work, axis=1)
        digit = np.minimum((upto < wanted[:, None]).sum(axis=1), (1 << DIGIT) - 1)
        rows = np.arange(n_parts)
        open_ = ~fixed
        wanted[open_] -= (upto - work)[rows, digit][open_]
        prefix[open_] = (prefix[open_] << DIGIT) | digit[open_]
        shift[open_] = BITS - DIGIT * (step + 1)
        fixed |= count[rows, digit] <= FEW
        if fixed.all():
            break
    return shift, prefix, wanted


def _last(cells, slot, keys, left, sizes, shift, prefix, wanted):
    """Key and number of the last cell that goes left, for every part. *Collective.*"""
    within = np.empty(len(slot), dtype=bool)
    _within(slot, keys, shift, prefix, within)
    rows = np.flatnonzero(within)
    own = np.column_stack([slot[rows], keys[rows], cells.ids[rows], cells.work[rows]])
    # a few cells per part
    every = np.concatenate(cells.comm.allgather(own))
    every = every[np.lexsort(every.T[2::-1])]
    starts = np.searchsorted(every[:, 0], np.arange(len(left) + 1))
    last_key, last_id = np.full((2, len(left)), -1, dtype=np.int64)
    for a, (first, end) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        mine = every[first:end]
        # the cut nearest to the wanted share
        cut = int(np.searchsorted(np.cumsum(mine[:, 3]) - 0.5 * mine[:, 3], wanted[a]))
        if shift[a] == BITS:
            # all cells of the part: no side goes without one while the other has two
            spare = len(mine) - (sizes[a] - left[a])
            cut = min(max(int(np.clip(cut, *sorted((left[a], spare)))), 0), len(mine))
        last_key[a], last_id[a] = mine[cut - 1, 1:3] if cut else ((prefix[a] << shift[a]) - 1, 0)
    return last_key, last_id


def _cut(cells, choose, slot, left, sizes):
    """Cut all parts: slots (n,) in which part a becomes 2 a and 2 a + 1. *Collective.*"""
    shares = left / sizes
    normals, shares = choose(slot, shares)
    n_parts = len(sizes)
    position, keys = np.empty(len(slot)), np.zeros(len(slot), dtype=np.int64)
    low, high = np.full((2, n_parts), np.inf)
    high *= -1.0
    _ends(slot, cells.centres, np.ascontiguousarray(normals), position, low, high)
    low, high = reduced(cells.comm, low, MPI.MIN), reduced(cells.comm, high, MPI.MAX)
    scale = 2.0**BITS / np.where(high > low, high - low, 1.0)
    _keys(slot, position, low, scale, 2**BITS - 1, keys)
    del position
    found = _narrow(cells, slot, keys, shares, sizes)
    last_key, last_id = _last(cells, slot, keys, left, sizes, *found)
    new = np.where(slot >= 0, 2 * slot, -1)
    _divide(slot, keys, cells.ids, last_key, last_id, 2 * np.arange(n_parts, dtype=np.int64) + 1, new)
    return new


def bisect(cells, count):
    """Part, 0 to ``count`` - 1, of every cell (n,) of this rank. *Collective.*

    Parameters
    ----------
    cells : Cells
    count : int

    Returns
    -------
    ndarray (n,) of int64
    """
    part = np.zeros(len(cells.ids), dtype=np.int64)
    if count == 1 or cells.n_total == 0:
        return part
    choose = Chooser(cells, count)
    slot = np.zeros(len(part), dtype=np.int64)
    first, sizes = np.array([0]), np.array([count])
    while True:
        left = sizes // 2
        slot = _cut(cells, choose, slot, left, sizes)
        first = np.column_stack([first, first + left]).ravel()
        sizes = np.column_stack([left, sizes - left]).ravel()
        inside = slot >= 0
        part[inside] = first[slot[inside]]
        # parts that are whole leave
        going = np.flatnonzero(sizes > 1)
        if not len(going):
            return part
        number = np.full(len(sizes) + 1, -1, dtype=np.int64)
        number[going] = np.arange(len(going))
        slot = number[slot]
        first, sizes = first[going], sizes[going]
