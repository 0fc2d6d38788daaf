"""Rigid motions of many loose bodies as a coarse space of their own, around multigrid.

Bodies that contact alone holds move against each other at little cost. Each has three rigid modes (six in space) that
a multigrid cycle hardly sees unless the modes of all bodies are among its near-null vectors. Bodies that touch need
vectors of their own then; the size of the coarse matrices grows with the number of vectors, and the set-up with its
square. Here the near-null space stays that of one body. With Z the rigid modes of the loose bodies,
Q = Z (Z^T A Z)^-1 Z^T and B one cycle of multigrid,

    I - M A = (I - Q A)(I - B A)(I - Q A),

symmetric where A and B are: balancing by the motions of the bodies (J. Mandel, Comm. Numer. Meth. Engng. 9, 1993,
233-241). Z^T A Z has one small block for each pair of bodies that touch, and is factorised.
"""

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.petsc import PETSc, has_package
from pcontact.solve.preconditioners.contact import MULTIGRID, ContactPreconditioner
from pcontact.space.modes import component_frames, rigid_modes

PREFIX = "rigid_bodies_"
# [colours] Of the near-null space, beyond which bodies get the coarse space instead. From: chosen; a colour is six
# more columns in each coarse level of multigrid.
MOST_COLOURS = 2


def rigid_motions(space, fixed, bodies):
    """Rigid modes of some bodies as the columns of a matrix. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_owned, d)
        Prescribed components, which do not move.
    bodies : sequence of int
        Connected components.

    Returns
    -------
    PETSc.Mat
    """
    d, own = space.dim, space.owned_local
    centre, scale = component_frames(space)
    component = space.component[own]
    modes = rigid_modes(space.points[own], centre[component], 1.0)
    modes[d:] /= scale[component][None, :, None]
    if space.axisymmetric:
        modes = modes[1:2]
    place = np.full(space.mesh.n_components, -1, dtype=np.int64)
    place[list(bodies)] = np.arange(len(bodies))
    loose = place[component] >= 0
    n_modes, rows = len(modes), np.repeat(loose, d)
    columns = place[component[loose]][:, None, None] * n_modes + np.arange(n_modes)
    columns = np.broadcast_to(columns, (int(loose.sum()), d, n_modes))
    values = (modes * ~fixed)[:, loose].transpose(1, 2, 0)
    first = np.concatenate([[0], np.cumsum(np.where(rows, n_modes, 0))])
    csr = (first.astype(PETSc.IntType), columns.astype(PETSc.IntType).ravel(), values.ravel())
    sizes = ((space.n_owned * d, space.n_dofs), (None, len(bodies) * n_modes))
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=space.comm)


class Deflation(ContactPreconditioner):
    """Context of a preconditioner of type python: the one that the user's options choose between two coarse solves.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    bodies : sequence of int
        Connected components that no support holds.
    """

    def __init__(self, problem, bodies):
        self._basis = rigid_motions(problem.space, problem.conditions.fixed, bodies)
        self.inner, self.size, self._solver = None, self._basis.getSize()[1], None
        log.info("coarse space of %d rigid motions of %d loose bodies around multigrid", self.size, len(bodies))

    def detach(self, ksp):
        """Leave the inner preconditioner with the Krylov method. *Collective.*"""
        ksp.setPC(self.inner)
        self._release()

    def free(self):
        """Give the coarse solver back. *Collective.*"""
        self._release()

    def _release(self):
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None

    def setUp(self, pc):  # noqa: N802
        """Called by PETSc when the matrix has changed. *Collective.*"""
        matrix, other = pc.getOperators()
        self.inner.setOperators(matrix, other)
        self.inner.setUp()
        self._release()
        self._matrix = matrix
        moved = other.matMult(self._basis)
        coarse = self._basis.transposeMatMult(moved)
        moved.destroy()
        solver = PETSc.PC().create(comm=other.getComm())
        solver.setOptionsPrefix(PREFIX)
        solver.setOperators(coarse, coarse)
        mumps = has_package("mumps")
        solver.setType("lu" if mumps or other.getComm().size == 1 else "redundant")
        if mumps:
            solver.setFactorSolverType("mumps")
        solver.setFromOptions()
        solver.setUp()
        self._solver, self._b, self._x = solver, coarse.createVecLeft(), coarse.createVecRight()
        self._rest, self._step = other.createVecLeft(), other.createVecRight()

    def apply(self, pc, residual, solution):
        """Solution = M residual. *Collective.*"""
        self._balance(residual, solution)
        self._remain(residual, solution)
        self.inner.apply(self._rest, self._step)
        solution.axpy(1.0, self._step)
        self._remain(residual, solution)
        self._balance(self._rest, self._step)
        solution.axpy(1.0, self._step)

    def _balance(self, residual, motion):
        """Motion = Q residual."""
        self._basis.multTranspose(residual, self._b)
        self._solver.apply(self._b, self._x)
        self._basis.mult(self._x, motion)

    def view(self, pc, viewer):
        """Called by PETSc for -ksp_view."""
        viewer.printfASCII(f"  the preconditioner below between two solves for {self.size} rigid motions\n")
        self.inner.view(viewer)


def deflation(problem, options):
    """The coarse space of the loose bodies of a problem; None where they have vectors of their own, or no multigrid.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    options : pcontact.runtime.options.Options
    """
    if not problem.features.loose or options.get("pc_type", "gamg") not in MULTIGRID:
        return None
    return Deflation(problem, problem.features.loose)
