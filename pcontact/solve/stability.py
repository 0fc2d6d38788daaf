"""Whether a solution is one that a slow motion comes to.

With friction, or with an operator beside theta that is not the traction's derivative, a large load step may have
several solutions. The signs of the determinants of their tangents add up to the one of the unloaded bodies, which is
positive: a solution with a negative one has others beside it, and an odd number of its modes grow of themselves.
Newton's method may come there where it follows the smallest residual, for which a solution is as good as another.
"""

import numpy as np

from pcontact.runtime.petsc import PETSc, has_package
from pcontact.solve.preconditioners.direct import MOST_UNKNOWNS, MUMPS_SPARE

PREFIX = "stability_"
# of a solve that ended in such a solution
UNSTABLE = "unstable solution"
# what MUMPS is told of its work space, and that it is to compute the determinant
SPARE, DETERMINANT = {"icntl": 14, "ival": MUMPS_SPARE}, {"icntl": 33, "ival": 1}


def determinant_sign(matrix):
    """Sign of the determinant of a matrix: 1, -1, or 0 where it is singular to rounding. *Collective.*

    It comes with the factors of MUMPS, mantissa and exponent apart.
    """
    pc = PETSc.PC().create(comm=matrix.getComm())
    pc.setOptionsPrefix(PREFIX)
    pc.setOperators(matrix, matrix)
    pc.setType("lu")
    pc.setFactorSolverType("mumps")
    pc.setFactorSetUpSolverType()
    factors = pc.getFactorMatrix()
    for control in (SPARE, DETERMINANT):
        factors.setMumpsIcntl(**control)
    pc.setUp()
    mantissa = pc.getFactorMatrix().getMumpsRinfog(12)
    pc.destroy()
    return int(np.sign(mantissa)) if np.isfinite(mantissa) else 0


def unstable(problem, u):
    """Whether a solution is one that no slow motion comes to; never where that takes too large factors. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Its matrix is that of ``u`` from here on.
    u : PETSc.Vec
    """
    space = problem.space
    if not has_package("mumps") or space.n_dofs > MOST_UNKNOWNS[space.dim]:
        return False
    problem.tangent(u)
    return determinant_sign(problem.matrix.matrix) < 0
