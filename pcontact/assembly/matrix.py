"""The global matrix: an AIJ matrix whose values are written in place from the items' blocks.

Patterns of owned rows, and the plan that sums the contributions of several ranks into them.

Linear systems are solved with it in the type that the user names. Multigrid, filters and coarse spaces work on AIJ, so
that a matrix of another type stands beside it: it multiplies, in Krylov's method and in the smoother of the finest
level.

The matrix of a problem some of whose components follow others: P^T K P, and a diagonal for those that follow.
"""

import weakref
from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import BlockRows, add_chosen_blocks, find, locate_rows, merge_rows
from pcontact.runtime.jit import njit
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI, PETSc, graph_of_long_rows, local_values, preallocate_sell

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
        if self._kind == "baij":
            # values are written in place from now on
            self._columns = None

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



def union(ptr_a, col_a, ptr_b, col_b):
    """Union of two block patterns with the same rows.

    Returns
    -------
    rowptr (n + 1,), columns (nnz,) : ndarray
    """
    rowptr = np.zeros_like(ptr_a)
    merge_rows(ptr_a, col_a, ptr_b, col_b, rowptr, np.zeros(0, dtype=np.int64), False)
    columns = np.empty(rowptr[-1], dtype=np.int64)
    merge_rows(ptr_a, col_a, ptr_b, col_b, rowptr, columns, True)
    return rowptr, columns


def positions(ptr_a, col_a, rowptr, columns):
    """Position (int64) in a pattern of every entry of a pattern that it contains."""
    position = np.empty(len(col_a), dtype=np.int64)
    locate_rows(ptr_a, col_a, rowptr, columns, position)
    return position


class JoinedPattern:
    """Union of block patterns with the same rows, and the sum of values on them.

    Parameters
    ----------
    patterns : list of (ndarray (n + 1,), ndarray (nnz,))
        Row pointers and columns.
    n : int
        Rows.

    Attributes
    ----------
    rowptr, columns : ndarray (n + 1,), (nnz,)
        The union.
    """

    def __init__(self, patterns, n):
        self.rowptr, self.columns = np.zeros(n + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
        for pattern in patterns:
            self.rowptr, self.columns = union(self.rowptr, self.columns, *pattern)
        self._places = [positions(*pattern, self.rowptr, self.columns) for pattern in patterns]

    def sum(self, values):
        """Sum (nnz, d, d) of values on the patterns, a list in their order."""
        if len(values) == 1:
            return values[0]
        total = np.zeros((len(self.columns), *values[0].shape[1:]))
        for place, value in zip(self._places, values, strict=True):
            total[place] += value
        return total



@njit
def _own_rows(local, pattern, more, out, places):
    """Columns of owned rows, sorted and each once, of local rows and of pairs that came from other ranks.

    Parameters
    ----------
    local : (ndarray (n_owned,), ndarray (n,))
        Local row of each owned one, -1 where there is none, and global numbers of the local columns.
    pattern, more : (rowptr, columns)
        Local rows with local columns, and what came, by owned rows, with global ones.
    out : (rowptr, columns)
        Written; room for all.
    places : (ndarray, ndarray)
        Written: places of the entries of both in the result.
    """
    (at, nodes), (ptr, cols), (more_ptr, more_cols), (rowptr, columns), (place, more_place) = (
        local, pattern, more, out, places,
    )  # fmt: skip
    none = np.zeros(0, np.int64)
    for row in range(len(at)):
        own = none if at[row] < 0 else nodes[cols[ptr[at[row]] : ptr[at[row] + 1]]]
        came, first = more_cols[more_ptr[row] : more_ptr[row + 1]], rowptr[row]
        every, end = np.sort(np.concatenate((own, came))), rowptr[row]
        for k in range(len(every)):
            if k == 0 or every[k] != every[k - 1]:
                columns[end] = every[k]
                end += 1
        rowptr[row + 1] = end
        for k in range(len(own)):
            place[ptr[at[row]] + k] = find(columns, first, end, own[k])
        for k in range(len(came)):
            more_place[more_ptr[row] + k] = find(columns, first, end, came[k])


def _split_as(parts, values):
    """Values (n,) in a dict, as many for each key as it has in another one."""
    ends = np.cumsum([len(part) for part in parts.values()])
    return dict(zip(parts, np.split(values, ends[:-1]), strict=True)) if parts else {}


class OwnedRows:
    """Block rows that this rank owns, summed from what all ranks contribute.

    Parameters
    ----------
    numbering : pcontact.space.space.Numbering
    exchanger : pcontact.runtime.parallel.Exchanger
    nodes : ndarray (n,)
        Global numbers of the local rows and columns.
    rowptr, columns : ndarray
        Local pattern over these nodes, see :func:`pcontact.assembly.graph.node_graph`.

    Attributes
    ----------
    rowptr (n_owned + 1,), columns (nnz,) : ndarray
        Pattern of the owned rows, global node numbers, sorted in each row.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, numbering, exchanger, nodes, rowptr, columns):
        self._exchanger, n_owned, owner = exchanger, numbering.n_owned, numbering.owner(nodes)
        mine, counts = np.flatnonzero(owner == numbering.rank), np.diff(rowptr)
        away = np.flatnonzero(np.repeat(owner != numbering.rank, counts))
        row = np.repeat(np.arange(len(nodes)), np.where(owner != numbering.rank, counts, 0))
        sends, order = split_by_rank(owner[row], np.column_stack([nodes[row], nodes[columns[away]]]))
        self._send_index = _split_as(sends, away[order])
        received = exchanger(sends, np.int64, 2)
        came = np.concatenate([np.zeros((0, 2), dtype=np.int64), *received.values()])
        at, order = np.full(n_owned, -1, dtype=np.int64), np.argsort(came[:, 0], kind="stable")
        at[nodes[mine] - numbering.start] = mine
        pointer = np.zeros(n_owned + 1, dtype=np.int64)
        np.cumsum(np.bincount(came[:, 0] - numbering.start, minlength=n_owned), out=pointer[1:])
        place, found = np.full(len(columns), -1, dtype=np.int64), np.empty(len(came), dtype=np.int64)
        self.rowptr, every = np.zeros(n_owned + 1, dtype=np.int64), np.empty(len(columns) + len(came), dtype=np.int64)
        _own_rows((at, nodes), (rowptr, columns), (pointer, came[order, 1]), (self.rowptr, every), (place, found))
        self.columns = every[: self.rowptr[-1]].copy()
        self._own_index = np.flatnonzero(place >= 0)
        self._own_position = place[self._own_index]
        position = np.empty_like(found)
        position[order] = found
        self._received_position = _split_as(received, position)

    def sum(self, values):
        """Sum local values into the owned rows. *Collective.*

        Parameters
        ----------
        values : ndarray (nnz_local, d, d)

        Returns
        -------
        ndarray (nnz, d, d)
        """
        d = values.shape[1]
        out = np.zeros((len(self.columns), d, d))
        add_chosen_blocks(values, self._own_index, self._own_position, out)
        sends = {rank: values[index].reshape(-1, d * d) for rank, index in self._send_index.items()}
        for rank, part in self._exchanger(sends, np.float64, d * d).items():
            add_chosen_blocks(part.reshape(-1, d, d), np.arange(len(part)), self._received_position[rank], out)
        return out


class MatrixRows(NamedTuple):
    """Owned block rows as PETSc keeps them: in one matrix of the owned columns, and one of all others.

    Attributes
    ----------
    rowptr : ndarray (n + 1,)
    columns : ndarray (nnz,)
        Global nodes, sorted within each row.
    start : int
        Global number of the first row; the owned columns are start to start + n - 1.
    own, other : ndarray (n + 1,)
        Blocks of owned columns, and of others, before each row.
    """

    rowptr: np.ndarray
    columns: np.ndarray
    start: int
    own: np.ndarray
    other: np.ndarray


class Prescribed(NamedTuple):
    """Components that supports prescribe, in block rows.

    Attributes
    ----------
    row : ndarray (n, d) of bool
    column : ndarray (nnz, d) of bool
        Of the columns of all blocks.
    diagonal : ndarray (n, d)
        What stands on the diagonal of such a row [force/length].
    """

    row: np.ndarray
    column: np.ndarray
    diagonal: np.ndarray


@njit
def _scalar_pattern(block_rows, d, i, j):
    """Scalar CSR (i, j) of block rows, whose counts of owned and other columns are written, too."""
    rowptr, columns, start = block_rows.rowptr, block_rows.columns, block_rows.start
    own, other, end = block_rows.own, block_rows.other, block_rows.start + len(block_rows.rowptr) - 1
    k = 0
    for row in range(len(rowptr) - 1):
        n_own = 0
        for b in range(rowptr[row], rowptr[row + 1]):
            if start <= columns[b] < end:
                n_own += 1
        own[row + 1] = own[row] + n_own
        other[row + 1] = other[row] + rowptr[row + 1] - rowptr[row] - n_own
        for a in range(d):
            i[row * d + a] = k
            for b in range(rowptr[row], rowptr[row + 1]):
                for c in range(d):
                    j[k] = columns[b] * d + c
                    k += 1
    i[(len(rowptr) - 1) * d] = k


@njit
def _write(rows, block_rows, first, second, extra, prescribed, da, oa):
    """Write the sum of two sets of blocks, in some rows, into the value arrays of the two local matrices.

    Rows and columns of prescribed components become a diagonal matrix; ``extra`` (n,) is added to the diagonal.
    """
    rowptr, columns, start = block_rows.rowptr, block_rows.columns, block_rows.start
    own, other, end = block_rows.own, block_rows.other, block_rows.start + len(block_rows.rowptr) - 1
    columns_a, a, columns_b, b = first.columns, first.values, second.columns, second.values
    fixed_row, fixed_column, diagonal = prescribed.row, prescribed.column, prescribed.diagonal
    d = fixed_row.shape[1]
    for row in rows:
        n_own = own[row + 1] - own[row]
        n_other = other[row + 1] - other[row]
        base_own, base_other = own[row] * d * d, other[row] * d * d
        k_own, k_other, pa, pb = 0, 0, first.rowptr[row], second.rowptr[row]
        end_a, end_b = first.rowptr[row + 1], second.rowptr[row + 1]
        for k in range(rowptr[row], rowptr[row + 1]):
            inside = start <= columns[k] < end
            on_diagonal = columns[k] == start + row
            in_a, in_b = pa < end_a and columns_a[pa] == columns[k], pb < end_b and columns_b[pb] == columns[k]
            for i in range(d):
                for j in range(d):
                    value = 0.0
                    if not fixed_row[row, i] and not fixed_column[k, j]:
                        if in_a:
                            value += a[pa, i, j]
                        if in_b:
                            value += b[pb, i, j]
                        if on_diagonal and i == j:
                            value += extra[row]
                    elif on_diagonal and i == j:
                        value = diagonal[row, i]
                    if inside:
                        da[base_own + i * d * n_own + k_own * d + j] = value
                    else:
                        oa[base_other + i * d * n_other + k_other * d + j] = value
            pa += in_a
            pb += in_b
            if inside:
                k_own += 1
            else:
                k_other += 1


def _nothing():
    """In place of a reference to values while none have been written."""


class ProblemMatrix:
    """The matrix of a problem, with an operator of another type beside it where the user wants one.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Attributes
    ----------
    matrix : PETSc.Mat
        AIJ, block size d. Its pattern may be renewed; the object stays.
    operator : PETSc.Mat
        What linear systems are solved with: the same, unless :meth:`choose` says otherwise.
    """

    def __init__(self, space):
        self._space, n = space, space.n_owned * space.dim
        self.matrix = PETSc.Mat().create(comm=space.comm)
        self.matrix.setSizes(((n, space.n_dofs),) * 2, bsize=space.dim)
        self.matrix.setType("aij")
        self.operator, self._beside = self.matrix, None

    def choose(self, kind):
        """Take a type for the operator, before there is a pattern.

        Parameters
        ----------
        kind : str
            One of `pcontact.assembly.matrix.AIJ`, which the matrix itself takes, or of those beside it.
        """
        if kind in AIJ:
            self.matrix.setType(kind)
        else:
            self._beside = Operator(self.matrix, kind)
            self.operator = self._beside.matrix

    def fill(self, pattern, values):
        """Take a pattern and values (nnz, d, d) on it, and nothing else. *Collective.*"""
        n, d = self._space.n_owned, self._space.dim
        self.renew(pattern, (np.zeros(n + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)))
        self.write(values, np.zeros((0, d, d)), np.zeros(n))

    def solved(self, forces, rtol, most):
        """Solution, a vector, by conjugate gradients with the diagonal alone for forces (n_owned, d), of a matrix that
        is near to it, or is seldom asked: a tolerance, and how many iterations there may be. *Collective.*"""
        right, solution = self._space.vector(forces), self._space.vector()
        ksp = PETSc.KSP().create(comm=self._space.comm)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=rtol, atol=0.0, max_it=most)
        ksp.setOperators(self.matrix)
        ksp.solve(right, solution)
        for one in (ksp, right):
            one.destroy()
        return solution


class GlobalMatrix(ProblemMatrix):
    """Sum of two sets of block values, with supports, as a PETSc matrix; attributes as of :class:`ProblemMatrix`.

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_local, d) of bool
        Prescribed components.
    """

    # what linear systems are solved with by default, beside AIJ: its products take half of the time
    default = "baij"

    def __init__(self, space, fixed):
        super().__init__(space)
        self._flags = space.vector(fixed[space.owned_local].astype(float))
        self._fixed_row = np.ascontiguousarray(fixed[space.owned_local])
        self._rows = None
        # the first set as it was written last: where it has not changed, only rows of the second are written
        self._written, self._extra = _nothing, None

    def renew(self, first, second):
        """Give the matrix the union of two patterns, unless it has it already. *Collective.*

        Parameters
        ----------
        first, second : (rowptr, columns)
            Owned block rows.

        Returns
        -------
        bool
            Whether the pattern of the matrix changed.
        """
        rowptr, columns = union(*first, *second)
        same = (
            self._rows is not None
            and len(columns) == len(self._rows.columns)
            and np.array_equal(rowptr, self._rows.rowptr)
            and np.array_equal(columns, self._rows.columns)
        )
        changed = not self._space.comm.allreduce(int(same), op=MPI.MIN)
        if changed:
            self._preallocate(rowptr, columns)
        self._patterns, self._written = (first, second), _nothing
        self._second_rows = np.flatnonzero(np.diff(second[0]))
        return changed

    def _preallocate(self, rowptr, columns):
        space, d = self._space, self._space.dim
        n = len(rowptr) - 1
        i = np.empty(n * d + 1, dtype=PETSc.IntType)
        j = np.empty(len(columns) * d * d, dtype=PETSc.IntType)
        own, other = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
        self._rows = MatrixRows(rowptr, columns, int(space.start), own, other)
        _scalar_pattern(self._rows, d, i, j)
        self.matrix.setPreallocationCSR((i, j, np.zeros(len(j))))
        if self._beside is not None:
            self._beside.preallocate(rowptr, columns, int(space.start))
        # many nodes of the source may face one facet of the target
        graph_of_long_rows(self.matrix, max(int(np.diff(part).max(initial=0)) for part in (own, other)))
        nodes, place = space.numbering.places(columns)
        flags = space.exchange(nodes).gather(self._flags) > 0.5
        self._fixed_column = np.ascontiguousarray(flags[place])

    def write(self, first, second, extra):
        """Write the values. *Collective.*

        Parameters
        ----------
        first, second : ndarray (nnz, d, d)
            On the patterns given to :meth:`renew`. The same object as before, as the first, has the same values.
        extra : ndarray (n_owned,)
            Added to the diagonal of free components; the same object as before has the same values.
        """
        space, d = self._space, self._space.dim
        parts = [BlockRows(*pattern, values) for pattern, values in zip(self._patterns, (first, second), strict=True)]
        rows = self._second_rows
        if self._written() is not first or self._extra is not extra:
            rows = np.arange(space.n_owned)
            self._diagonal = np.zeros((space.n_owned, d))
            _diagonal_of(parts[0], int(space.start), self._diagonal)
            self._written, self._extra = weakref.ref(first), extra
        prescribed = Prescribed(self._fixed_row, self._fixed_column, self._diagonal)
        sizes = (int(self._rows.own[-1]) * d * d, int(self._rows.other[-1]) * d * d)
        with local_values(self.matrix, sizes) as (da, oa):
            _write(rows, self._rows, *parts, extra, prescribed, da, oa)
            if self._beside is not None:
                self._beside.take(rows, (self._rows.own, self._rows.other), (da, oa))


@njit
def _diagonal_of(blocks, start, out):
    """Diagonal (n, d) of a set of blocks, whose first row has the global number ``start``."""
    rowptr, columns, values = blocks.rowptr, blocks.columns, blocks.values
    for row in range(len(rowptr) - 1):
        k = find(columns, rowptr[row], rowptr[row + 1], start + row)
        if k >= 0:
            for i in range(values.shape[1]):
                out[row, i] = values[k, i, i]


class ConstrainedMatrix(ProblemMatrix):
    """In the place of :class:`GlobalMatrix`, with rigid groups.

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_local, d) of bool
        Prescribed components.
    groups : list of pcontact.space.constraints.RigidGroup or pcontact.space.constraints.PretensionSection

    Attributes
    ----------
    follows : ndarray (n_owned, d) of bool
        Components that follow.

    Notes
    -----
    The constructor is *Collective*.
    """

    # a group has one entry in many blocks
    default = "aij"

    def __init__(self, space, fixed, groups):
        self._whole, self._renewed = GlobalMatrix(space, fixed), True
        super().__init__(space)
        d, n = space.dim, space.n_owned * space.dim
        rows = [(np.arange(n), space.start * d + np.arange(n), np.ones(n))]
        self._follows = np.zeros(n, dtype=bool)
        for group in groups:
            self._follows[group.followers()] = True
            rows.append(group.ways())
        row, column, value = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        # a follower has no column of its own; one that leads has the entry 1 in its own row, from its group
        kept = (np.arange(len(row)) >= n) | ~self._follows[row]
        row, column, value = row[kept], column[kept], value[kept]
        for group in groups:
            mine = group.leading[(group.leading >= space.start * d) & (group.leading < space.start * d + n)]
            self._follows[mine - space.start * d] = False
        self.follows, self._start = self._follows.reshape(-1, d), int(space.start) * d
        order = np.lexsort((column, row))
        pointer = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n))]).astype(PETSc.IntType)
        csr = pointer, column[order].astype(PETSc.IntType), value[order]
        self._ways = PETSc.Mat().createAIJ(self.matrix.getSizes(), csr=csr, comm=space.comm)

    def renew(self, first, second):
        """See :meth:`GlobalMatrix.renew`. *Collective.*"""
        changed = self._whole.renew(first, second)
        self._renewed = self._renewed or changed
        return changed

    def write(self, first, second, extra):
        """See :meth:`GlobalMatrix.write`. *Collective.*"""
        self._whole.write(first, second, extra)
        product = self._whole.matrix.ptap(self._ways)
        pointer, columns, values = product.getValuesCSR()
        product.destroy()
        diagonal = self._whole.matrix.getDiagonal().getArray()[self._follows]
        # rows of followers are empty: they get a diagonal
        at = np.flatnonzero(self._follows)
        columns = np.insert(columns, pointer[at], (self._start + at).astype(columns.dtype))
        values = np.insert(values, pointer[at], diagonal)
        pointer = pointer + np.concatenate([[0], np.cumsum(self._follows)]).astype(pointer.dtype)
        if self._renewed:
            self.matrix.setPreallocationCSR((pointer, columns, values))
        else:
            self.matrix.setValuesCSR(pointer, columns, values)
        self.matrix.assemble()
        if self._beside is not None:
            if self._renewed:
                self._beside.preallocate_entries(pointer, columns, self._start)
            self._beside.take_entries(pointer, columns, values)
        self._renewed = False
