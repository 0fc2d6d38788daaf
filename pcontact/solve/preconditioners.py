"""Multigrid with a filter: what contact makes stiff is solved for directly, between two multigrid cycles.

With B one cycle of the inner preconditioner, P the injection of the unknowns near closed points and S = (P^T A P)^-1,

    M = B + P S P^T (I - A B) + B (I - A P S P^T)(I - A B),    I - M A = (I - B A)(I - P S P^T A)(I - B A),

symmetric where A and B are. Source: Petrides, Hartland, Kolev, Lee, Puso, Solberg, Chin, Wang, Petra (2025),
"AMG with filtering: an efficient preconditioner for interior point methods in large-scale contact mechanics
optimization", arXiv 2505.18576.

Rigid motions of many loose bodies as a coarse space of their own, around multigrid.

Bodies that contact alone holds move against each other at little cost. Each has three rigid modes (six in space) that
a multigrid cycle hardly sees unless the modes of all bodies are among its near-null vectors. Bodies that touch need
vectors of their own then; the size of the coarse matrices grows with the number of vectors, and the set-up with its
square. Here the near-null space stays that of one body. With Z the rigid modes of the loose bodies,
Q = Z (Z^T A Z)^-1 Z^T and B one cycle of multigrid,

    I - M A = (I - Q A)(I - B A)(I - Q A),

symmetric where A and B are: balancing by the motions of the bodies (J. Mandel, Comm. Numer. Meth. Engng. 9, 1993,
233-241). Z^T A Z has one small block for each pair of bodies that touch, and is factorised.

Direct solves in the place of multigrid, where that fails: nearly incompressible bodies, cells of extreme aspect.

Multigrid with point smoothers has no answer to 1 / (1 - 2 nu) = 5e4, or to cells that are ten thousand times as long as
high. The factors of a matrix have; they cost memory that grows faster than the number of unknowns, so that only
problems of moderate size take them unasked.
"""

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.runtime import log
from pcontact.runtime.petsc import LEAST_PIVOT, PETSc, can_factorise, has_package
from pcontact.space.modes import component_frames, rigid_modes

# [%] Of the work space, that MUMPS adds to its estimate. From: chosen.
MUMPS_SPARE = 60
# [unknowns] In space, below which one rank factorises at most where few unknowns are to be: multigrid takes twice as
# long for some hundred. From: chosen; factors of cells in space fill faster than those of the plane.
MOST_IN_SPACE = 500
# what SNES calls a linear solve that failed, and Newton's method that gets nowhere: on badly scaled tangents residuals
# of the Krylov method are small where corrections are still wrong
FAILED = "diverged linear solve"
HOPEFUL = (FAILED, "diverged max it")
PIVOTS = {"pc_factor_zeropivot": LEAST_PIVOT}


def factors(options, space):
    """Defaults with which the linear systems of a problem are factorised from the beginning, as the user wants it of
    few unknowns; empty: they are not.

    Bodies that nothing but contact holds have pivots of the size of their stabilisation where they touch nothing yet,
    a millionth of their stiffness: the Krylov method, which has factors to precondition it, mends what these lose.

    Parameters
    ----------
    options : pcontact.runtime.options.Options
    space : pcontact.space.space.Space

    Returns
    -------
    dict of str to object
    """
    ranks, unknowns = space.comm.size, space.n_dofs
    few = unknowns < options.get("pc_direct_below")
    if not few or options.given("pc_type") or options.given("snes_lag_preconditioner"):
        return {}
    if space.dim == 2:
        return direct_options(has_package("mumps")) if can_factorise(ranks, space.dim, unknowns) else {}
    return {"pc_type": "lu"} | PIVOTS if ranks == 1 and unknowns < MOST_IN_SPACE else {}


class DirectFallback:
    """Turns a run to a direct solver when its Krylov method has failed, once and for all.

    Parameters
    ----------
    options : pcontact.runtime.options.Options
        That have proposed the present solver.
    space : pcontact.space.space.Space
    chosen : bool
        Whether the user chose the preconditioner, or does without this: it then stays.
    """

    def __init__(self, options, space, chosen):
        self._options, self._space = options, space
        self._serial = space.comm.size == 1
        able = can_factorise(space.comm.size, space.dim, space.n_dofs)
        self.possible = bool(able and not chosen)
        self.active = False

    def takes_over(self, result):
        """Whether a solve that ended so should be tried again with the direct solver; if so, it is chosen from here on.

        Parameters
        ----------
        result : pcontact.solve.result.NewtonResult
        """
        if result.converged or result.reason not in HOPEFUL or self.active or not self.possible:
            return False
        what = "the Krylov method failed" if result.reason == FAILED else "Newton's method did not converge"
        log.info("%s with multigrid: direct solver from here on (-newton_without direct: never)", what)
        self.choose()
        return True

    def choose(self):
        """Take the direct solver from here on, if that is possible.

        Returns
        -------
        bool
            Whether the options hold it now and did not before.
        """
        if self.active or not self.possible:
            return False
        self.active = True
        self._options.replace(direct_options(has_package("mumps")))
        return True


def direct_options(mumps):
    """Options of a direct solver with iterative refinement by GMRES.

    Parameters
    ----------
    mumps : bool
        Whether PETSc has MUMPS.
    """
    options = {"pc_type": "lu", "ksp_type": "gmres", "ksp_pc_side": "right", "ksp_norm_type": "unpreconditioned"}
    options |= PIVOTS
    if mumps:
        options["pc_factor_mat_solver_type"] = "mumps"
        # pivots may fill the factors more than foreseen
        options["mat_mumps_icntl_14"] = 100
    return options


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


BODIES_PREFIX = "rigid_bodies_"
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
        solver.setOptionsPrefix(BODIES_PREFIX)
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
