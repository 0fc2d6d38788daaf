"""How often each cell is to be cut: the fewest cells that bring the error down to a part of what it is."""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.petsc import MPI

# [bisections per dimension] Of a cell at once: three make it an eighth as long. From: estimates of a coarse mesh know
# only so much.
AT_ONCE = 3
# [-] Growth of the number of cells that is enough for one pass, where the error cannot be had at once. From: all passes
# together then cost a third more than the last one.
PASS = 4.0
# [-] Bisections of the scale until it is known. From: the ratio of two neighbouring doubles is never needed.
HALVINGS = 50


class Cuts(NamedTuple):
    """What is to become of the cells.

    Attributes
    ----------
    more : ndarray (n,) of int
        Bisections of the cells of this rank.
    part : float
        Of the error that is expected to be left.
    growth : float
        Cells that are expected over those of now.
    """

    more: np.ndarray
    part: float
    growth: float


def cuts(comm, squares, degree, dim, part, most=np.inf, count=None):
    """Cuts that leave a part of the error. *Collective.*

    A cell's part of the squared error falls with 2^(-2 p / d) per bisection, the cells double: the fewest have sizes in
    proportion to estimate^(-2 / (2 p + d)).

    Parameters
    ----------
    comm : MPI.Comm
    squares : ndarray (n,)
        Squared contributions of the cells of this rank to the error.
    degree, dim : int
    part : float
        Of the error, to be left.
    most : float
        Growth of the number of cells at most.
    count : ndarray (n,), optional
        Of cells that have these squares each.

    Returns
    -------
    Cuts
    """
    number = np.ones(len(squares)) if count is None else count
    total, count, low, high = _sums(comm, squares, number)
    if total == 0.0:
        return Cuts(np.zeros(len(squares), dtype=np.int64), 1.0, 1.0)

    def tried(scale):
        with np.errstate(divide="ignore"):
            wanted = dim / (2.0 * degree + dim) * np.log2(squares / scale)
        more = np.clip(np.rint(wanted), 0, AT_ONCE * dim).astype(np.int64)
        own = [(number * squares) @ 0.25 ** (degree * more / dim), number @ 2.0**more]
        left, cells = comm.allreduce(np.array(own), op=MPI.SUM)
        return Cuts(more, float(np.sqrt(left / total)), float(cells / count))

    # cells as large as this become as small as may be; below, those with smaller contributions catch up
    cut_most = high / 2.0 ** ((2.0 * degree + dim) * AT_ONCE)
    low, high = low / 4.0 ** ((degree + dim) * AT_ONCE), 2.0 * high
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        found = tried(middle)
        enough = found.part < part or found.growth > most or (middle < cut_most and found.growth > PASS)
        low, high = (middle, high) if enough else (low, middle)
    found = tried(low)
    return tried(high) if found.growth > most else found


def _sums(comm, squares, number):
    """Sum, count, least positive and largest of the squares of all ranks. *Collective.*"""
    total, count = comm.allreduce(np.array([number @ squares, number.sum()]), op=MPI.SUM)
    least = comm.allreduce(float(np.min(squares[squares > 0.0], initial=np.inf)), op=MPI.MIN)
    return float(total), float(count), least, comm.allreduce(float(np.max(squares, initial=0.0)), op=MPI.MAX)
