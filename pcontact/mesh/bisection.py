"""Weighted recursive bisection of cells that are spread over the ranks in any way.

Each part is cut by a plane at the exact weighted median, until there are as many parts as wanted. The result does not
depend on the spread: positions are computed cell by cell, sums are of integers, and cells at the same position are
told apart by their numbers.

Which way to cut a part of the mesh in two: the direction and the share, from a sample of its cells.

All sums are of integers, and extremes are exact: what comes out does not depend on which rank holds which cell.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.mesh.mesh import bounding_box
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.petsc import MPI

BINS = 256
# sampled cells per part, at least; parts that have fewer are looked at as a whole
SAMPLE = 4000
# a deviation of the contact work from its share by this part makes a cut as bad as one of twice its size
UNEVEN = 0.05
# contact that is less than this part of the work need not be balanced as well
SMALL = 0.02
# allowed deviation of the work of a part from its share after all cuts
SLACK = 0.06
# directions of a cut are tilted a little: cells of a regular mesh have their centres in planes
TILT = 1e-4 * np.array([0.7548776662466927, 0.5698402909980532, 0.4301597090019468])
# coordinates are sums of integers of so many bits where axes of inertia are made of them
MOMENT_BITS = 13
# the work of a cell of weight 1
UNIT = 1024
# positions within a part are whole numbers of so many bits, found DIGIT bits at a time
BITS, DIGIT = 50, 10
# so many cells are sorted instead
FEW = 256


def directions(dim):
    """Axes and diagonals (n, dim) of unit length: 4 in the plane, 13 in space."""
    every = np.stack(np.meshgrid(*[[-1, 0, 1]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    half = every[len(every) // 2 + 1 :].astype(float)
    half = half[np.lexsort((*half.T[::-1] * -1, np.abs(half).sum(axis=1)))]
    return half / np.linalg.norm(half, axis=1)[:, None]


def sampled(ids, n_total, wanted):
    """Rows of the cells that are in the sample, which depends on their numbers only."""
    if n_total <= wanted:
        return np.arange(len(ids))
    mixed = ids.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return np.flatnonzero((mixed >> np.uint64(32)) < np.uint64(wanted * 2**32 // n_total))


def reduced(comm, array, op):
    """An array with the sums (or extremes) over all ranks. *Collective.*"""
    out = np.empty_like(array)
    comm.Allreduce(array, out, op=op)
    return out


@njit_exact
def moments(slot, q, out):
    """Add coordinates (n, d) int64 and their products to the sums (n_parts, 1 + d + d * d) of their parts."""
    d = q.shape[1]
    for c in range(slot.shape[0]):
        if slot[c] >= 0:
            row = out[slot[c]]
            row[0] += 1
            for i in range(d):
                row[1 + i] += q[c, i]
                for j in range(d):
                    row[1 + d + d * i + j] += q[c, i] * q[c, j]


def _axes(sums, dim):
    """Axes of inertia (n_parts, dim, dim) of points, from their moments; coordinate axes where there are none."""
    out = np.broadcast_to(np.eye(dim), (len(sums), dim, dim)).copy()
    for k, row in enumerate(sums):
        if row[0] > dim:
            mean = row[1 : 1 + dim] / row[0]
            spread = row[1 + dim :].reshape(dim, dim) / row[0] - np.outer(mean, mean)
            vectors = np.linalg.eigh(spread)[1].T
            # rounded, so that symmetric bodies have symmetric axes
            out[k] = np.round(vectors, 6)
            out[k] /= np.linalg.norm(out[k], axis=1)[:, None]
    return out


def _wide(normals, width):
    """Directions (..., d) with zeros for further coordinates."""
    more = [(0, 0)] * (normals.ndim - 1) + [(0, width - normals.shape[-1])]
    return np.pad(normals, more)


def _candidates(comm, box, dim, n_parts, *clouds):
    """Directions (n_parts, n, width) to try. *Collective.*

    Axes, diagonals, and axes of inertia of the clouds; further coordinates and their differences.
    """
    low, high = box
    span, width = float(np.max((high - low)[:dim])) or 1.0, len(low)
    single = np.eye(width)[dim:]
    pairs = [a - b for k, a in enumerate(single) for b in single[k + 1 :]]
    fixed = np.concatenate([_wide(directions(dim), width), single, np.reshape(pairs, (-1, width))])
    parts = [np.broadcast_to(fixed, (n_parts, *fixed.shape))]
    for slot, points in clouds:
        sums = np.zeros((n_parts, 1 + dim + dim * dim), dtype=np.int64)
        moments(slot, ((points - low)[:, :dim] * (2**MOMENT_BITS / span)).astype(np.int64), sums)
        parts.append(_wide(_axes(reduced(comm, sums, MPI.SUM), dim), width))
    # roots of matrices may differ between machines in their last digits
    return comm.bcast(np.concatenate(parts, axis=1), root=0)


@njit_exact
def _extents(slot, corners, normals, low, high):
    """Least and largest position of cells along all directions of their part."""
    for c in range(slot.shape[0]):
        a = slot[c]
        if a < 0:
            continue
        for k in range(normals.shape[1]):
            for v in range(corners.shape[1]):
                s = 0.0
                for i in range(corners.shape[2]):
                    s += corners[c, v, i] * normals[a, k, i]
                low[a, k], high[a, k] = min(low[a, k], s), max(high[a, k], s)


class Bins(NamedTuple):
    """Bins along the directions of n_parts parts.

    Attributes
    ----------
    normals : ndarray (n_parts, n, d)
    low : ndarray (n_parts, n)
        Where the first bin begins.
    scale : ndarray (n_parts, n)
        Bins per length.
    """

    normals: np.ndarray
    low: np.ndarray
    scale: np.ndarray


@njit_exact
def _histograms(slot, centres, corners, work, along, cells, cut):
    """Work of cells by bins along all directions, and at both ends of every cell, doubled: how many a plane meets.

    A plane between the centres of two layers of cells should count the same wherever it is between them.
    """
    normals, low, scale = along.normals, along.low, along.scale
    bins = cells.shape[2]
    for c in range(slot.shape[0]):
        a = slot[c]
        if a < 0:
            continue
        for k in range(normals.shape[1]):
            at, first, last = 0.0, np.inf, -np.inf
            for i in range(centres.shape[1]):
                at += centres[c, i] * normals[a, k, i]
            for v in range(corners.shape[1]):
                s = 0.0
                for i in range(centres.shape[1]):
                    s += corners[c, v, i] * normals[a, k, i]
                first, last = min(first, s), max(last, s)
            half = last - first
            b = min(max(int((at - low[a, k]) * scale[a, k]), 0), bins - 1)
            left = min(max(int((at - half - low[a, k]) * scale[a, k]), 0), bins - 1)
            right = min(max(int((at + half - low[a, k]) * scale[a, k]), 0), bins - 1)
            cells[a, k, b] += work[c]
            cut[a, k, left] += 1
            cut[a, k, right] -= 1


@njit_exact
def _contact(slot, centres, contact, along, out):
    """Contact work of cells by bins along all directions."""
    normals, low, scale = along.normals, along.low, along.scale
    bins = out.shape[2]
    for c in range(slot.shape[0]):
        a = slot[c]
        if a < 0:
            continue
        for k in range(normals.shape[1]):
            at = 0.0
            for i in range(centres.shape[1]):
                at += centres[c, i] * normals[a, k, i]
            out[a, k, min(max(int((at - low[a, k]) * scale[a, k]), 0), bins - 1)] += contact[c]


def _best(shares, cells, contact, cut, least, slack, weight):
    """Direction and share of the best cut of every part: (n_parts,) int, (n_parts,) float.

    shares, least (n_parts,): wanted on the left; cells of the smallest cut that counts. cells, contact, cut
    (n_parts, n_directions, bins): up to the end of each bin. weight: work of the sample per contact.
    """
    total = np.maximum(cells[:, :, -1:], 1)
    share = shares[:, None, None]
    smaller = np.minimum(share, 1.0 - share)
    reached = cells[:, :, :-1] / total
    off = np.abs(reached - share) / smaller
    allowed = off <= np.maximum(slack, off.min(axis=2, keepdims=True))
    sum_contact = contact[:, :, -1:]
    uneven = np.abs(contact[:, :, :-1] / np.maximum(sum_contact, 1) - share) / smaller
    matters = np.minimum(weight * sum_contact / total / SMALL, 1.0)
    score = (0.5 * cut[:, :, :-1] + least[:, None, None]) * (1.0 + matters * (uneven / UNEVEN) ** 2)
    score = np.where(allowed, score * (1.0 + off), np.inf)
    flat = score.reshape(len(shares), -1).argmin(axis=1)
    k, b = np.divmod(flat, score.shape[2])
    # a plane between layers of cells may be the only one far and wide; the cut itself can go through a layer
    reached, most = reached[np.arange(len(shares)), k, b], slack * smaller.ravel()
    return k, np.where(np.abs(reached - shares) > most, shares, reached)


class Chooser:
    """Chooses planes for parts of a cloud of cells.

    Parameters
    ----------
    cells : pcontact.mesh.bisection.Cells
    n_parts : int
        Of the whole partition, 2 or more.
    """

    def __init__(self, cells, n_parts):
        self.comm, self.cells = cells.comm, cells
        rows = sampled(cells.ids, cells.n_total, SAMPLE * n_parts)
        self.rows, self.touching = rows, np.flatnonzero(cells.contact > 0)
        self.centres, self.corners = cells.centres[rows], np.ascontiguousarray(cells.corners(rows))
        self.slack = SLACK / np.ceil(np.log2(n_parts))
        d = cells.centres.shape[1]
        self.box = bounding_box(self.comm, cells.centres)
        if not np.all(np.isfinite(self.box)):
            self.box = np.zeros(d), np.ones(d)
        # the sample stands for all cells, but cells with contact are all there
        n_sampled = cells.comm.allreduce(len(rows))
        self.weight = cells.contact_weight * n_sampled / max(cells.n_total, 1)

    def __call__(self, slot, shares):
        """Planes that cut parts so that the left side has its share of the work. *Collective.*

        Parameters
        ----------
        slot : ndarray (n,) int64
            Part of every cell of this rank; -1: of none.
        shares : ndarray (n_parts,)

        Returns
        -------
        normals : ndarray (n_parts, d)
        shares : ndarray (n_parts,)
            Shares of the work, near those wanted, at which the cuts are best.
        """
        cells, n_parts = self.cells, len(shares)
        own, near = slot[self.rows], slot[self.touching]
        touching = cells.centres[self.touching]
        normals = _candidates(self.comm, self.box, cells.dim, n_parts, (own, self.centres), (near, touching))
        low, high = np.full((2, n_parts, normals.shape[1]), np.inf)
        high *= -1.0
        _extents(own, self.corners, normals, low, high)
        low, high = reduced(self.comm, low, MPI.MIN), reduced(self.comm, high, MPI.MAX)
        low, high = np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 1.0)
        along = Bins(normals, low, BINS / np.where(high > low, high - low, 1.0))
        sums = np.zeros((3, n_parts, normals.shape[1], BINS), dtype=np.int64)
        _histograms(own, self.centres, self.corners, cells.work[self.rows], along, sums[0], sums[2])
        _contact(near, touching, cells.contact[self.touching], along, sums[1])
        counts = np.bincount(own[own >= 0], minlength=n_parts)
        sums, counts = reduced(self.comm, sums, MPI.SUM), reduced(self.comm, counts, MPI.SUM)
        chosen = None
        if self.comm.rank == 0:
            # a plane between bodies meets no cell, and is not for nothing
            least = 0.1 * np.maximum(counts, 1) ** (1.0 - 1.0 / cells.dim)
            k, reached = _best(shares, *np.cumsum(sums, axis=3), least, self.slack, self.weight)
            chosen = normals[np.arange(n_parts), k] + _wide(TILT[: cells.dim], normals.shape[2]), reached
        return self.comm.bcast(chosen, root=0)


@dataclass
class Cells:
    """Cells of one rank as far as a partition has to know them.

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
    """Return whether cells begin with the prefix of their part."""
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
    """Find the cut of every part, down to a few cells. *Collective.*

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
