"""The matrix that linear systems are solved with, in the type that the user names: AIJ, or another one of its values.

Multigrid, filters and coarse spaces work on AIJ, so that a matrix of another type stands beside it: it multiplies, in
Krylov's method and in the smoother of the finest level.
"""

import numpy as np

from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import PETSc, local_values, preallocate_sell

# types that are AIJ: values are written in place on the host, and PETSc moves them to where they are used
AIJ = ("aij", "aijcusparse", "aijhipsparse", "aijkokkos")
# rows whose blocks are handed to PETSc at a time
ROWS = 4096
# types of a matrix beside AIJ
BESIDE = ("baij", "sbaij", "sell")


class Operator:
    """A matrix of the values of an AIJ matrix, in another type.

    Parameters
    ----------
    base : PETSc.Mat
        AIJ, with sizes and block size.
    kind : str
        One of `BESIDE`; sbaij keeps the upper triangle alone.

    Attributes
    ----------
    matrix : PETSc.Mat
        Its pattern may be renewed; the object stays.
    """

    def __init__(self, base, kind):
        self._kind, self.matrix = kind, PETSc.Mat().create(comm=base.getComm())
        self.matrix.setSizes(base.getSizes(), bsize=base.getBlockSize())
        self.matrix.setType(kind)

    def preallocate(self, rowptr, columns, start):
        """Take a pattern of owned block rows. *Collective.*

        Parameters
        ----------
        rowptr, columns : ndarray (n + 1,), (nnz,)
            Global nodes, sorted within each row.
        start : int
            Global number of the first row.
        """
        n, matrix = len(rowptr) - 1, self.matrix
        row = np.repeat(np.arange(n), np.diff(rowptr))
        inside = (columns >= start) & (columns < start + n)
        # a matrix that has been assembled is preallocated again only as one of another type
        matrix.setType("aij")
        matrix.setType(self._kind)
        kept = columns >= row + start if self._kind == "sbaij" else np.ones(len(columns), dtype=bool)
        counts = [np.bincount(row[part & kept], minlength=n) for part in (inside, ~inside)]
        if self._kind == "sell":
            preallocate_sell(matrix, *(np.repeat(count * matrix.getBlockSize(), matrix.getBlockSize())
                                       for count in counts))  # fmt: skip
        else:
            matrix.setPreallocationNNZ([count.astype(PETSc.IntType) for count in counts])
        # petsc4py preallocates nothing on a rank without rows, which would then wait for others that do not
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        if self._kind == "sbaij":
            matrix.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
        self._start = start
        self._columns = [columns[part].astype(PETSc.IntType) for part in (inside, ~inside)]
        self._new = True

    def take(self, rows, pointers, values):
        """Take the values of dense blocks as they are in the two local parts of the AIJ matrix. *Collective.*

        Parameters
        ----------
        rows : ndarray
            Local block rows whose values have changed.
        pointers : (ndarray (n + 1,), ndarray (n + 1,))
            Blocks before each row: of owned columns, and of others.
        values : (ndarray, ndarray)
        """
        size = self.matrix.getBlockSize()
        if self._kind == "baij" and not self._new:
            with local_values(self.matrix, [part.size for part in values]) as places:
                for pointer, part, place in zip(pointers, values, places, strict=True):
                    _copy_blocks(rows, pointer, part, (size, 1, size), place)
            return
        for pointer, columns, part in zip(pointers, self._columns, values, strict=True):
            self._insert(pointer, columns, part, size)
        self.matrix.assemble()
        self._new = False

    def _insert(self, pointer, columns, values, size):
        """Blocks of a local part, some rows at a time: all of them would be as much memory as the matrix."""
        for low in range(0, len(pointer) - 1, ROWS):
            high = min(low + ROWS, len(pointer) - 1)
            first, last = pointer[low], pointer[high]
            own, blocks = pointer[low : high + 1] - first, np.empty((last - first) * size**2)
            _copy_blocks(np.arange(high - low), own, values[first * size**2 : last * size**2], (size, size, 1), blocks)
            rows = np.arange(self._start + low, self._start + high, dtype=PETSc.IntType)
            self.matrix.setValuesBlockedIJV(own.astype(PETSc.IntType), columns[first:last], blocks, rowmap=rows)

    def preallocate_entries(self, pointer, columns, start):
        """Take a pattern of owned scalar rows, of which the first has the global number `start`. *Collective.*"""
        size = self.matrix.getBlockSize()
        row = np.repeat(np.arange(len(pointer) - 1), np.diff(pointer)) // size
        blocks = np.unique(np.column_stack([row, columns // size]), axis=0)
        counts = np.bincount(blocks[:, 0], minlength=(len(pointer) - 1) // size)
        self.preallocate(np.concatenate([[0], np.cumsum(counts)]), blocks[:, 1], start // size)

    def take_entries(self, pointer, columns, values):
        """Take the values of scalar rows. *Collective.*"""
        self.matrix.setValuesCSR(pointer, columns, values)
        self.matrix.assemble()


@njit
def _copy_blocks(rows, pointer, values, strides, out):
    """Copy the blocks of some rows from scalar rows (AIJ) to blocks whose entries have the strides (rows, columns)."""
    d, by_row, by_column = strides
    for row in rows:
        first, n = pointer[row] * d * d, pointer[row + 1] - pointer[row]
        for k in range(n):
            for i in range(d):
                for j in range(d):
                    out[first + k * d * d + i * by_row + j * by_column] = values[first + i * d * n + k * d + j]
