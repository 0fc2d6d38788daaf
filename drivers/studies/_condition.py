"""Condition of a tangent: largest over smallest singular value."""

import numpy as np

from pcontact.runtime.petsc import PETSc, has_package

STEPS = 30


def condition(matrix: PETSc.Mat, steps: int = STEPS) -> float:
    """Estimate of the condition number in the 2-norm, from below. *Collective.*

    Power iterations on A^T A, and on its inverse by the factors of A: after 30 of them within a few percent, as the
    largest and the smallest singular values of a tangent stand apart from the next ones, or are as large as these.

    Parameters
    ----------
    matrix : PETSc.Mat
        AIJ, square.
    steps : int

    Returns
    -------
    float
        Not a number where the factorisation fails.
    """
    solver = PETSc.KSP().create(comm=matrix.getComm())
    solver.setOptionsPrefix("condition_")
    solver.setOperators(matrix)
    solver.setType("preonly")
    pc = solver.getPC()
    pc.setType("lu" if has_package("mumps") or matrix.getComm().size == 1 else "redundant")
    if has_package("mumps"):
        pc.setFactorSolverType("mumps")
    solver.setErrorIfNotConverged(True)
    try:
        return _growth(matrix, matrix.mult, matrix.multTranspose, steps) * _growth(
            matrix, solver.solve, solver.solveTranspose, steps
        )
    except PETSc.Error:
        return float("nan")
    finally:
        solver.destroy()


def _growth(matrix, forth, back, steps):
    """Largest singular value of a linear map and its transpose."""
    x, y = matrix.createVecs()
    begin, end = x.getOwnershipRange()
    # the same vector on any number of ranks
    x.setArray(np.random.default_rng(0).standard_normal(x.getSize())[begin:end])
    value = 0.0
    for _ in range(steps):
        x.scale(1.0 / x.norm())
        forth(x, y)
        value = y.norm()
        back(y, x)
    return value
