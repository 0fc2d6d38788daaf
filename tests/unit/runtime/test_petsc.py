"""What differs between versions of PETSc."""

import numpy as np
import pytest

from pcontact.runtime.petsc import MPI, PETSc, diverged_nan, forget_pattern

COMM = MPI.COMM_WORLD
ROWS = 40


def fill(matrix, width):
    """Diagonally dominant, each row with `width` entries from the diagonal on; as `assembly.matrix` preallocates."""
    total = ROWS * COMM.size
    first = np.arange(ROWS)[:, None] + ROWS * COMM.rank
    columns = np.sort((first + np.arange(width)) % total, axis=1)
    values = np.where(columns == first, 2.0 * width, -1.0)
    rowptr = np.arange(0, columns.size + 1, width, dtype=PETSc.IntType)
    matrix.setPreallocationCSR((rowptr, columns.ravel().astype(PETSc.IntType), values.ravel()))


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["asm", "gamg"])
def test_a_preconditioner_follows_a_new_pattern(kind):
    total = ROWS * COMM.size
    matrix = PETSc.Mat().create(comm=COMM)
    matrix.setSizes(((ROWS, total), (ROWS, total)))
    matrix.setType("mpiaij" if COMM.size > 1 else "seqaij")
    ksp = PETSc.KSP().create(comm=COMM)
    ksp.setType("gmres")
    ksp.setTolerances(rtol=1e-10, max_it=100)
    ksp.getPC().setType(kind)
    for width in (2, 5, 9, 3, 20):
        fill(matrix, width)
        forget_pattern(ksp)
        ksp.setOperators(matrix, matrix)
        b, x = matrix.createVecLeft(), matrix.createVecRight()
        b.setArray(1.0 + np.arange(ROWS) % 3)
        ksp.solve(b, x)
        norm = b.norm()
        b.axpy(-1.0, matrix * x)
        assert ksp.getConvergedReason() > 0
        assert b.norm() < 1e-8 * norm


def test_the_reason_for_what_is_not_finite():
    assert isinstance(diverged_nan, int) and diverged_nan < 0
