"""The matrix of a problem some of whose components follow others: P^T K P, and a diagonal for those that follow."""

import numpy as np

from pcontact.assembly.matrix import GlobalMatrix
from pcontact.assembly.operator import AIJ, Operator
from pcontact.runtime.petsc import PETSc


class ConstrainedMatrix:
    """In the place of :class:`GlobalMatrix`, with rigid groups.

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_local, d) of bool
        Prescribed components.
    groups : list of pcontact.space.constraints.RigidGroup or pcontact.space.constraints.PretensionSection

    Attributes
    ----------
    matrix, operator : PETSc.Mat
        As those of a :class:`GlobalMatrix`.
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
        d, n, total = space.dim, space.n_owned * space.dim, space.n_dofs
        sizes = ((n, total), (n, total))
        self.matrix = PETSc.Mat().create(comm=space.comm)
        self.matrix.setSizes(sizes, bsize=d)
        self.matrix.setType("aij")
        self.operator, self._beside = self.matrix, None
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
        self._ways = PETSc.Mat().createAIJ(
            (sizes[0], sizes[1]), csr=(pointer, column[order].astype(PETSc.IntType), value[order]), comm=space.comm
        )

    def choose(self, kind):
        """See :meth:`GlobalMatrix.choose`."""
        if kind in AIJ:
            self.matrix.setType(kind)
        else:
            self._beside = Operator(self.matrix, kind)
            self.operator = self._beside.matrix

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
