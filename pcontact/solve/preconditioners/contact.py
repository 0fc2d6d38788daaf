"""Multigrid with a filter: what contact makes stiff is solved for directly, between two multigrid cycles.

With B one cycle of the inner preconditioner, P the injection of the unknowns near closed points and S = (P^T A P)^-1,

    M = B + P S P^T (I - A B) + B (I - A P S P^T)(I - A B),    I - M A = (I - B A)(I - P S P^T A)(I - B A),

symmetric where A and B are. Source: Petrides, Hartland, Kolev, Lee, Puso, Solberg, Chin, Wang, Petra (2025),
"AMG with filtering: an efficient preconditioner for interior point methods in large-scale contact mechanics
optimization", arXiv 2505.18576.
"""

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.runtime import log
from pcontact.runtime.petsc import PETSc, has_package
from pcontact.solve.preconditioners.direct import MUMPS_SPARE

MULTIGRID = ("gamg", "hypre", "ml", "mg")
PREFIX = "contact_filter_"


class DirectSolve:
    """LU factors of the rows and columns of a matrix that some ranks name, on those ranks alone.

    MUMPS where PETSc has it; otherwise each of the ranks factorises the whole of it.
    """

    def __init__(self):
        self._ranks, self._comm, self._parts = None, None, []

    def factorise(self, matrix, rows):
        """Take new rows and values. *Collective.*

        Parameters
        ----------
        matrix : PETSc.Mat
        rows : ndarray (n,)
            Global rows that this rank owns, sorted.

        Returns
        -------
        int
            Rows of all ranks.
        """
        comm = matrix.getComm().tompi4py()
        counts = np.array(comm.allgather(len(rows)))
        self.release()
        self._rows = rows - matrix.getOwnershipRange()[0]
        if not counts.any():
            return 0
        where = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=comm)
        part = matrix.createSubMatrix(where, where)
        self._share(comm, counts > 0)
        if len(rows):
            if not self._ranks.all():
                part = _on_some_ranks(part, self._comm)
            self._set_up(part)
        return int(counts.sum())

    def _share(self, comm, chosen):
        """The communicator of the ranks that have rows."""
        if self._ranks is not None and np.array_equal(self._ranks, chosen):
            return
        self._free()
        self._ranks, self._comm = chosen, comm
        if not chosen.all():
            self._comm = comm.Split(0 if chosen[comm.rank] else 1, comm.rank)

    def _set_up(self, part):
        pc = PETSc.PC().create(comm=self._comm)
        pc.setOptionsPrefix(PREFIX)
        pc.setOperators(part, part)
        mumps = has_package("mumps")
        pc.setType("lu" if mumps or self._comm.size == 1 else "redundant")
        if mumps:
            pc.setFactorSolverType("mumps")
            pc.setFactorSetUpSolverType()
            pc.getFactorMatrix().setMumpsIcntl(14, MUMPS_SPARE)
        pc.setFromOptions()
        pc.setUp()
        self._parts = [pc, part, part.createVecRight(), part.createVecLeft()]

    def correct(self, residual, solution):
        """Add P S P^T times a residual to a solution, both vectors of the whole matrix."""
        if not len(self._rows):
            return
        pc, _, x, b = self._parts
        b.setArray(residual.getArray(readonly=True)[self._rows])
        pc.apply(b, x)
        with solution as array:
            array[self._rows] += x.getArray(readonly=True)

    def release(self):
        """Give the factors up. *Collective* on the ranks that have some."""
        for part in self._parts:
            part.destroy()
        self._parts = []

    def free(self):
        """Give factors and communicator up. *Collective.*"""
        self.release()
        self._free()

    def _free(self):
        if self._ranks is not None and not self._ranks.all():
            self._comm.Free()
        self._ranks, self._comm = None, None


def _on_some_ranks(matrix, comm):
    """A matrix whose other ranks have no rows, on a communicator without them."""
    n, total = matrix.getLocalSize()[0], matrix.getSize()[0]
    return PETSc.Mat().createAIJ(((n, total), (n, total)), csr=matrix.getValuesCSR(), comm=comm)


class ContactPreconditioner:
    """Context of a preconditioner of type python around the one that the user's options choose.

    Parameters
    ----------
    rows : callable
        Gives the global rows (n,) of this rank that the direct solve takes, sorted; none on all ranks: the inner
        preconditioner works alone. *Collective.*

    Attributes
    ----------
    inner : PETSc.PC
    size : int
        Unknowns of the direct solve.
    """

    def __init__(self, rows):
        self._choose, self._direct = rows, DirectSolve()
        self.inner, self.size = None, 0

    def attach(self, ksp, prefix):
        """Give a Krylov method a new preconditioner with a new inner one. *Collective.*

        Parameters
        ----------
        ksp : PETSc.KSP
        prefix : str or None
            Of the options of the inner preconditioner. The outer one has its own prefix: it has no type to choose.
        """
        self.inner = new_preconditioner(ksp.getComm(), prefix)
        outer = PETSc.PC().create(comm=ksp.getComm())
        outer.setOptionsPrefix(PREFIX + "outer_")
        outer.setType("python")
        outer.setPythonContext(self)
        ksp.setPC(outer)

    def detach(self, ksp):
        """Leave the inner preconditioner with the Krylov method. *Collective.*

        What is still alive when the program ends is destroyed by PETSc after Python: this one would be called.
        """
        ksp.setPC(self.inner)
        self._direct.release()

    def free(self):
        """Give factors and communicators back. *Collective.*"""
        self._direct.free()

    def keep(self, keep):
        """Have the next set-up renew the direct solve alone, or both."""
        self.inner.setReusePreconditioner(keep)

    def forget_pattern(self):
        """See :func:`pcontact.runtime.petsc.forget_pattern`."""
        self.inner.setOperators(None, None)

    def setUp(self, pc):  # noqa: N802
        """Called by PETSc when the matrix has changed. *Collective.*"""
        matrix, other = pc.getOperators()
        self.inner.setOperators(matrix, other)
        self.inner.setUp()
        self.size = self._direct.factorise(other, self._choose())
        self._matrix = matrix
        self._rest, self._step = other.createVecLeft(), other.createVecRight()

    def apply(self, pc, residual, solution):
        """Solution = M residual. *Collective.*"""
        self.inner.apply(residual, solution)
        if not self.size:
            return
        self._remain(residual, solution)
        self._direct.correct(self._rest, solution)
        self._remain(residual, solution)
        self.inner.apply(self._rest, self._step)
        solution.axpy(1.0, self._step)

    def _remain(self, residual, solution):
        self._matrix.mult(solution, self._rest)
        self._rest.aypx(-1.0, residual)

    def view(self, pc, viewer):
        """Called by PETSc for -ksp_view."""
        viewer.printfASCII(f"  two cycles of the preconditioner below around a direct solve of {self.size} unknowns\n")
        self.inner.view(viewer)


class ContactRows:
    """Chooses the unknowns of the direct solve: those of source cells and target facets at closed points.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    """

    def __init__(self, problem):
        self._problem, self._said = problem, False

    def __call__(self):
        """Global rows (n,) of this rank, sorted. *Collective.*"""
        space = self._problem.space
        nodes = [ActiveSet().active_nodes(), *(one.active_nodes() for _, one in self._problem.active.sets)]
        nodes = np.unique(np.concatenate(nodes))
        count = space.comm.allreduce(len(nodes)) * space.dim
        if count and not self._said:
            log.info("contact filter: direct solve of %d unknowns at closed points between two multigrid cycles", count)
            self._said = True
        return (nodes[:, None] * space.dim + np.arange(space.dim)).ravel()


def contact_preconditioner(problem, options):
    """The filter of a problem, as the user's options want it; None without.

    It doubles the price of an iteration and adds a factorisation to every Newton iteration, so that by itself it is
    only put around multigrid, and where a pair is stiff.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    options : pcontact.runtime.options.Options
    """
    mode = options.get("pc_contact_filter")
    pairs = problem.others
    stiff = options.get("pc_type", "gamg") in MULTIGRID and any(item.stiff for item in pairs)
    if not pairs or mode == "false" or (mode == "auto" and not stiff):
        return None
    return ContactPreconditioner(ContactRows(problem))


def new_preconditioner(comm, prefix):
    """A preconditioner of the type that the user's options choose.

    Parameters
    ----------
    comm : MPI.Comm or PETSc.Comm
    prefix : str or None
        Of the options.
    """
    pc = PETSc.PC().create(comm=comm)
    pc.setOptionsPrefix(prefix)
    pc.setFromOptions()
    return pc


def preconditioner(ksp):
    """The preconditioner that the user's options choose, whether or not there is a filter around it."""
    pc = ksp.getPC()
    context = pc.getPythonContext() if pc.getType() == "python" else None
    return context.inner if isinstance(context, ContactPreconditioner) else pc
