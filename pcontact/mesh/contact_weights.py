"""Which facets of source surfaces may have a partner: they are the work of contact, which the partition spreads."""

import numpy as np

from pcontact.mesh.planes import reduced
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI

# boxes of the lattice along the longest side of a target, at most
LATTICE = 64
# part of the extent of the smaller surface that a partner is looked for in, unless the user says how far
REACH = 0.15


def _box(comm, low, high):
    """The box (2, d) around boxes of all ranks. *Collective.*"""
    d = low.shape[1]
    low = low.min(axis=0) if len(low) else np.full(d, np.inf)
    high = high.max(axis=0) if len(high) else np.full(d, -np.inf)
    return reduced(comm, low, MPI.MIN), reduced(comm, high, MPI.MAX)


@njit
def _occupy(first, last, shape, out):
    """Mark boxes (flat, `out`) of a lattice from first (n, d) to last (n, d); the third direction may be missing."""
    for k in range(first.shape[0]):
        for i in range(first[k, 0], last[k, 0] + 1):
            for j in range(first[k, 1], last[k, 1] + 1):
                for m in range(first[k, 2], last[k, 2] + 1):
                    out[(i * shape[1] + j) * shape[2] + m] = 1


@njit
def _widen(shape, occupied, radius, out):
    """Mark all boxes whose centres are within a radius (in boxes) of that of an occupied one."""
    reach = int(np.ceil(radius))
    for i in range(shape[0]):
        for j in range(shape[1]):
            for m in range(shape[2]):
                if occupied[(i * shape[1] + j) * shape[2] + m] == 0:
                    continue
                for a in range(max(i - reach, 0), min(i + reach, shape[0] - 1) + 1):
                    for b in range(max(j - reach, 0), min(j + reach, shape[1] - 1) + 1):
                        for c in range(max(m - reach, 0), min(m + reach, shape[2] - 1) + 1):
                            if (a - i) ** 2 + (b - j) ** 2 + (c - m) ** 2 <= radius * radius:
                                out[(a * shape[1] + b) * shape[2] + c] = 1


def _close(comm, source, target, radius):
    """Whether the means of source facets are near a target facet, on a lattice of boxes. *Collective.*

    source, target : low, high, mean (n, d) of facets. radius [length], or None.
    """
    low, high = _box(comm, *target[:2])
    if not np.all(np.isfinite(low)):
        return np.zeros(len(source[2]), dtype=bool)
    if radius is None:
        around = _box(comm, *source[:2])
        if not np.all(np.isfinite(around[0])):
            return np.zeros(0, dtype=bool)
        radius = REACH * min(np.linalg.norm(high - low), np.linalg.norm(around[1] - around[0]))
    d = len(low)
    low, span = low - radius, high - low + 2.0 * radius
    size = max(float(span.max()) / LATTICE, np.finfo(float).tiny)
    shape = np.ones(3, dtype=np.int64)
    shape[:d] = np.minimum(np.floor(span / size), LATTICE - 1).astype(np.int64) + 1

    def place(x):
        out = np.zeros((len(x), 3), dtype=np.int64)
        out[:, :d] = np.floor((x - low) / size)
        return out

    occupied, near = np.zeros((2, int(shape.prod())), dtype=np.uint8)
    top = shape - 1
    _occupy(np.clip(place(target[0]), 0, top), np.clip(place(target[1]), 0, top), shape, occupied)
    # half the diagonals of two boxes
    _widen(shape, reduced(comm, occupied, MPI.MAX), radius / size + np.sqrt(d), near)
    at = place(source[2])
    inside = np.all((at >= 0) & (at <= top), axis=1)
    at = np.clip(at, 0, top)
    return inside & (near[(at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]] > 0)


def contact_facets(piece, corners, pairs):
    """Facets of every cell of a slice that may have a partner. *Collective.*

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
    corners : pcontact.mesh.slices.Corners
    pairs : list of (str, str or None, float or None)
        Source, target (None: an obstacle, which all facets may meet; the source itself: all facets, too), and search
        radius [length] (None: a part of the extent of the smaller surface).

    Returns
    -------
    ndarray (n,) of int64
    """
    count = np.zeros(len(piece.ids), dtype=np.int64)
    for source, target, radius in pairs:
        rows, local = piece.facet_groups[source]
        if target is not None and target != source:
            boxes = [corners.boxes(*piece.facet_groups[name]) for name in (source, target)]
            rows = rows[_close(piece.comm, *boxes, radius)]
        np.add.at(count, rows, 1)
    return count
