"""Preconditioners of the linear solves, and defaults of all solvers per situation; the user's own options win.

Multigrid with a filter: what contact makes stiff is solved for directly, between two multigrid cycles.

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

Multigrid for displacements of degree 2: those of degree 1 on the vertices are its next level.

The rows of a matrix of degree 2 have 80 to 190 entries of either sign, and aggregates made of them are poor and dear.
The functions of degree 1 are among those of degree 2: with P their values at all nodes, P^T A P is the matrix of degree
1, of an eighth of the unknowns, which algebraic multigrid is made for. PETSc's PCMG has the two levels; what solves on
the lower one is a preconditioner of its own, gamg by default.
"""

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.assembly.matrix import AIJ, BESIDE
from pcontact.element.reference import CELLS, reference_nodes, shape
from pcontact.runtime import log
from pcontact.runtime.petsc import (
    LEAST_PIVOT,
    PETSc,
    can_factorise,
    forget_pattern,
    full_steps,
    has_package,
    known_types,
    line_search_limit,
)
from pcontact.space.modes import body_modes, strain_free

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
        """Return whether a solve that ended so should be tried again with the direct solver; if so, it is chosen from
        here on.

        Parameters
        ----------
        result : pcontact.solve.convergence.NewtonResult
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


def factorised(matrix, prefix, spare=None):
    """The factors of a matrix: MUMPS' where PETSc has it, else each rank's own of the whole. *Collective.*

    Parameters
    ----------
    matrix : PETSc.Mat
    prefix : str
        Of the options.
    spare : int, optional
        [%] Of the work space, that MUMPS adds to its estimate; absent: its own.

    Returns
    -------
    PETSc.PC
    """
    pc, mumps = PETSc.PC().create(comm=matrix.getComm()), has_package("mumps")
    pc.setOptionsPrefix(prefix)
    pc.setOperators(matrix, matrix)
    pc.setType("lu" if mumps or matrix.getComm().size == 1 else "redundant")
    if mumps:
        pc.setFactorSolverType("mumps")
    if mumps and spare is not None:
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, spare)
    pc.setFromOptions()
    pc.setUp()
    return pc


class DirectSolve:
    """LU factors of the rows and columns of a matrix that some ranks name, on those ranks alone."""

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
                # the other ranks have no rows
                part = PETSc.Mat().createAIJ(part.getSizes(), csr=part.getValuesCSR(), comm=self._comm)
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
        pc = factorised(part, PREFIX, MUMPS_SPARE)
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
        self.size = self._direct.factorise(self._renew(pc), self._choose())

    def _renew(self, pc):
        """Set the inner preconditioner up with the matrices of another one, and return the one that it is made of.
        *Collective.*"""
        self._matrix, other = pc.getOperators()
        self.inner.setOperators(self._matrix, other)
        self.inner.setUp()
        self._rest, self._step = other.createVecLeft(), other.createVecRight()
        return other

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
    component, modes = space.component[own], body_modes(space, own)[strain_free(space)]
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
        self.free()

    def free(self):
        """Give the coarse solver back. *Collective.*"""
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None

    def setUp(self, pc):  # noqa: N802
        """Called by PETSc when the matrix has changed. *Collective.*"""
        other = self._renew(pc)
        self.free()
        moved = other.matMult(self._basis)
        coarse = self._basis.transposeMatMult(moved)
        moved.destroy()
        self._solver = factorised(coarse, BODIES_PREFIX)
        self._b, self._x = coarse.createVecLeft(), coarse.createVecRight()

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


# [-] The area in contact may grow by this factor before the preconditioner is set up again, and what resists the motion
# of all bodies together, mass over the square of a step of time, grow or fall by it. Row: reuse.
GROWN = 2.0
# [iterations] Of the Krylov method, that a preconditioner may lose before it is set up again. Row: reuse. From: 30,
# and a set-up for every tangent, take as long.
LOST_ITERATIONS = 10
# [ranks] So many at most take W cycles of multigrid: on many, coarse levels wait for messages, and W cycles visit them
# often. From: chosen; more ranks than that were not measured.
FEW = 64
# [-] A relative tolerance is below it. From: its meaning, the residual at first.
RELATIVE = 1.0
# options of SNES and KSP that say when an iteration ends
TOLERANCES = (
    "snes_rtol", "snes_atol", "snes_stol", "snes_max_it", "ksp_rtol", "ksp_atol", "ksp_max_it", "snes_ksp_ew_rtol0",
    "snes_ksp_ew_rtolmax",
)  # fmt: skip

# Krylov methods for symmetric matrices, and those that have their preconditioner on the right by default
SYMMETRIC = ("cg", "fcg", "pipecg", "groppcg", "minres", "symmlq", "cr", "pipecr")
RIGHT = ("gmres", "fgmres", "lgmres", "pgmres", "dgmres", "bcgs", "fbcgs", "tfqmr", "gcr")
# what the user says of multigrid begins so, and of its coarse level so
OF_MULTIGRID, COARSE = ("pc_gamg_", "pc_mg_", "mg_levels_"), "mg_coarse_"
# types of vectors: on the host, and on accelerators
VECTORS = ("standard", "cuda", "hip", "kokkos")


class Reuse:
    """Decides when the preconditioner is set up again: when Krylov needs more iterations than a fresh one would.

    A set-up costs as much as some twenty Krylov iterations, and a few points that open or close hardly change what a
    preconditioner is worth; many that close do. Counts decide, not clocks: a run repeats itself.
    """

    def __init__(self):
        self.forget()

    @property
    def begun(self):
        """Return whether there has been a solve since it has forgotten."""
        return self._rate is not None

    def forget(self):
        """Have the next solve set up its preconditioner."""
        self._rate, self._fresh, self._area, self._resists = None, True, 0.0, 0.0

    def keep(self, ksp, area, resists=0.0):
        """Return whether the next solve keeps the preconditioner. To be asked once before each solve.

        Parameters
        ----------
        ksp : PETSc.KSP
            With the iterations of the last solve.
        area : float
            That is in contact.
        resists : float, optional
            Sum of all entries of the tangent, where load steps have one set-up.
        """
        other = max(resists, self._resists) > GROWN * min(resists, self._resists)
        if self._rate is None or area > GROWN * self._area or other:
            self._rate, self._fresh, self._area, self._resists = np.inf, True, area, resists
            return False
        decades = max(-np.log10(ksp.getTolerances()[0]), 0.1)
        iterations = ksp.getIterationNumber()
        if self._fresh:
            self._rate = iterations / decades
        self._fresh = iterations > self._rate * decades + LOST_ITERATIONS
        if self._fresh:
            self._area = area
        return not self._fresh


def refresh_smoother(ksp, operator, matrix):
    """Let the finest smoother of a kept multigrid hierarchy follow the matrices of Newton's method: their diagonal and
    their largest eigenvalue.

    Chebyshev amplifies modes beyond an outdated largest eigenvalue, and the preconditioner is then indefinite.
    """
    pc = preconditioner(ksp)
    if pc.getType() in ("gamg", "ml", "mg"):
        smoother = pc.getMGSmoother(pc.getMGLevels() - 1)
        forget_pattern(smoother)
        smoother.setOperators(operator, matrix)


def solver_defaults(symmetric, ranks, krylov=None, lower=None, holds=False):
    """Options proposed for the Krylov method and the preconditioner.

    Parameters
    ----------
    symmetric : bool
        Whether the tangent is symmetric positive definite: theta = 1 (or no contact) without friction.
    ranks : int
    krylov : str, optional
        The Krylov method that the user chose.
    lower : dict of str to object, optional
        Where a level of degree 1 is below that of degree 2: what the user says of multigrid, which is said of that.
    holds : bool
        Whether something resists every motion of the bodies, as inertia does: coarse levels have little to do.

    Returns
    -------
    dict of str to object
        Option names and values; a value of None is a flag.

    Notes
    -----
    The near-null space attached to the matrix holds the rigid modes of every body, so that aggregates
    that straddle a contact represent the bodies' relative motion. Chebyshev/Jacobi smoothing tolerates the empty
    coarse degrees of freedom that this makes; a threshold of 0 drops explicit zeros from the graph.
    """
    options = {
        "pc_type": "gamg",
        "pc_gamg_agg_nsmooths": 1,
        "pc_gamg_threshold": 0.0,
        # coarse matrices otherwise fill up as meshes grow: a third level with 1,600 entries a row at 3 million unknowns
        "pc_gamg_aggressive_coarsening": 2,
        # the estimate made for smoothed aggregation can be older than the contact; Chebyshev then amplifies its modes
        "pc_gamg_use_sa_esteig": False,
        "pc_gamg_reuse_interpolation": True,
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_pc_type": "jacobi",
        "mg_levels_ksp_max_it": 2,
        "ksp_max_it": 500,
    }
    if ranks <= FEW and not holds:
        # iterations that hardly grow with the mesh; each costs a little more, the more the longer coarse levels take
        options["pc_mg_cycle_type"] = "w"
    if lower is not None:
        options = {COARSE + name: value for name, value in (options | lower).items() if name != "ksp_max_it"}
        # diagonal blocks of nodes: up to 12 % fewer iterations than with diagonals, never more, at the same price
        options |= {"pc_type": "mg", COARSE + "ksp_type": "preonly", "ksp_max_it": 500} | {
            f"mg_levels_{name}": value
            for name, value in (("ksp_type", "chebyshev"), ("ksp_max_it", 2), ("pc_type", "pbjacobi"))
        }
    if ranks == 1:
        # Galerkin products in half the time; the default of several ranks is as fast
        options["matptap_via"] = "rap"
    krylov = krylov or ("cg" if symmetric else "gmres")
    options["ksp_type"] = krylov
    if krylov == "cg":
        options["ksp_norm_type"] = "unpreconditioned"
    if krylov in RIGHT:
        # residuals are then those of the system itself
        options |= {"ksp_gmres_restart": 60, "ksp_pc_side": "right"}
    return options


def warn_of_krylov(symmetric, krylov):
    """Say that a Krylov method which the user chose is for other tangents than those of the problem."""
    if krylov in SYMMETRIC and not symmetric:
        log.warning(
            "-ksp_type %s is for symmetric tangents, and this one is not: it may not converge; remedy: -ksp_type "
            "gmres, or contact that is symmetric (-contact_theta 1, without friction)", krylov,
        )  # fmt: skip


# options with which PETSc takes differences of the residual, also off the supports
DIFFERENCES = ("snes_fd_color", "snes_fd", "snes_test_jacobian", "snes_mf", "snes_mf_operator")
# what multigrid is told where the operator is beside its matrix: the finest level multiplies by it
BY_OPERATOR = {"pc_use_amat": True}


def choose_operator(matrix, options, symmetric, direct, around):
    """Give the matrix of a problem the type that the user wants, and say what the preconditioner is made of.

    Parameters
    ----------
    matrix : pcontact.assembly.matrix.GlobalMatrix or pcontact.assembly.matrix.ConstrainedMatrix
    options : pcontact.runtime.options.Options
    symmetric : bool
        Whether the tangent is symmetric.
    direct : bool
        Whether the linear systems are factorised.
    around : object or None
        What stands around the preconditioner: it works on AIJ.

    Returns
    -------
    PETSc.Mat
        Of the type, where the user chose a preconditioner that takes it: factors, those of blocks, diagonals; else AIJ.

    Raises
    ------
    InputError
    """
    pc = options.get("pc_type")
    beside = pc in ("gamg", "mg") and not direct and not any(options.given(name) for name in DIFFERENCES)
    kind = options.get("mat_type", matrix.default if beside else "aij")
    allowed = [name for name in known_types(PETSc.Mat, (*AIJ, *BESIDE)) if symmetric or name != "sbaij"]
    if kind not in allowed:
        more = "" if symmetric else "; sbaij where tangents are symmetric"
        raise options.refusal("mat_type", " | ".join(allowed) + more)
    try:
        matrix.choose(kind)
    except PETSc.Error as error:
        # of a machine without the accelerator
        raise options.refusal("mat_type", " | ".join(name for name in allowed if name != kind)) from error
    takes = kind in ("baij", "sbaij") and options.given("pc_type") and pc not in MULTIGRID and not around
    return matrix.operator if takes else matrix.matrix


def solver_vectors(space, operator, options):
    """Residual and solution of Newton's method, in the type that the user wants, or that of the matrix. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    operator : PETSc.Mat
    options : pcontact.runtime.options.Options

    Returns
    -------
    residual : PETSc.Vec
    solution : PETSc.Vec or None
        None: of the type of the program's own vectors, which serve.

    Raises
    ------
    InputError
    """
    residual = space.vector()
    kind = options.get("vec_type", operator.getVecType())
    allowed = known_types(PETSc.Vec, VECTORS)
    if kind not in allowed:
        raise options.refusal("vec_type", " | ".join(allowed))
    own = residual.getType()
    residual.setType(kind)
    return residual, None if residual.getType() == own else residual.duplicate()


def check_tolerances(options):
    """Refuse tolerances and limits of the user's that no iteration can mean, before PETSc sees them.

    Old versions of PETSc take any number, newer ones refuse some in words of their own.

    Parameters
    ----------
    options : pcontact.runtime.options.Options

    Raises
    ------
    InputError
        On every rank.
    """
    for name in TOLERANCES:
        # written so that what is no number at all is refused, too
        if options.given(name) and not 0 <= options.number(name) < (RELATIVE if "rtol" in name else np.inf):
            allowed = f"a number from 0 to below {RELATIVE:g}" if "rtol" in name else "a finite number >= 0"
            raise options.refusal(name, allowed)


def newton_defaults(linear, direct, inexact, holds=False):
    """Options proposed for SNES and the tolerance of its linear solves.

    Parameters
    ----------
    linear : bool
        Whether one iteration will do.
    direct : bool
        Whether the linear systems are factorised.
    inexact : float
        Loosest tolerance of the linear solves if neither.
    holds : bool
        Whether something resists every motion of the bodies: then load steps end after few iterations, and the last
        linear solve leaves no less than is asked for.

    Returns
    -------
    dict of str to object
    """
    options = {
        "snes_type": "newtonls",
        # steps are shortened or prolonged before, see `pcontact.solve.newton`
        "snes_linesearch_type": full_steps,
        line_search_limit: 1.0,
        # absolute in PETSc: it would call small units converged
        "snes_linesearch_atol": 0.0,
        "snes_rtol": 1e-8,
        "snes_atol": 0.0,
        "snes_stol": 0.0,
        "snes_max_it": 50,
    }
    if linear or direct:
        return {**options, "ksp_rtol": 1e-10}
    # at 1e-2 the directions are too poor for stick and slip: twice the iterations, each with its set-up
    return {
        **options, "snes_ksp_ew": True, "snes_ksp_ew_version": 3 if holds else 2, "snes_ksp_ew_rtol0": inexact,
        "snes_ksp_ew_rtolmax": inexact,
    }  # fmt: skip


# [-] A weight is none below it. From: chosen; weights are at least 1/8.
LEAST_WEIGHT = 1e-9


class LowerDegree:
    """The level of degree 1 below that of degree 2.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Of degree 2, no component of which follows others.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem):
        space = problem.space
        self._space, self._vertex = space, _vertices(space)
        self._interpolation = _interpolation(space, problem.conditions.supports.fixed, self._vertex)
        self._product = None

    def attach(self, pc):
        """Give a new preconditioner its levels. *Collective.*"""
        self.forget_pattern()
        pc.setType("mg")
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self._interpolation)
        pc.setFromOptions()

    def forget_pattern(self):
        """Have the next product be one of a new pattern."""
        if self._product is not None:
            self._product.destroy()
        self._product = None

    def renew(self, pc, matrix):
        """Take the values of a matrix, before the preconditioner is set up with it. *Collective.*

        Parameters
        ----------
        pc : PETSc.PC
            That has been attached.
        matrix : PETSc.Mat
            Of degree 2, AIJ, with its near-null space.
        """
        lower = pc.getMGCoarseSolve()
        if self._product is not None:
            matrix.ptap(self._interpolation, result=self._product)
        else:
            self._product = matrix.ptap(self._interpolation)
            self._product.setBlockSize(self._space.dim)
            forget_pattern(lower)
        self._product.setNearNullSpace(self._modes(matrix))
        lower.setOperators(self._product, self._product)

    def _modes(self, matrix):
        """The near-null space of a matrix at the vertices. *Collective.*"""
        vectors = []
        for mode in matrix.getNearNullSpace().getVecs():
            vector = self._interpolation.createVecRight()
            values = mode.getArray(readonly=True).reshape(-1, self._space.dim)
            vector.setArray(values[self._vertex[self._space.owned_local]].ravel())
            for other in vectors:
                vector.axpy(-vector.dot(other), other)
            # bodies are the same at their vertices: none is a combination of others
            vector.normalize()
            vectors.append(vector)
        return PETSc.NullSpace().create(constant=False, vectors=vectors, comm=self._space.comm)


def _vertices(space):
    """Flags (n_local,) of the nodes that are vertices of cells. *Collective.*"""
    found = [table[:, : CELLS[block.cell].n_vertices].ravel() for block, table in _blocks(space)]
    return space.flag(np.concatenate([np.zeros(0, dtype=np.int64), *found]))


def _blocks(space):
    return zip(space.mesh.blocks, space.cells, strict=True)


def _weights(space, vertex):
    """Values of the functions of degree 1 at the owned nodes: rows, local vertices and values (n,) each, a node from
    the first cell that has it."""
    own = space.owned_local[vertex[space.owned_local]]
    parts, known = [(own, own, np.ones(len(own)))], vertex | ~space.owns(slice(None))
    for block, table in _blocks(space):
        n = CELLS[block.cell].n_vertices
        for a, row in enumerate(shape(block.cell, 1, reference_nodes(block.cell, 2)[n:]), start=n):
            nodes, first = np.unique(table[:, a], return_index=True)
            nodes, first = nodes[~known[nodes]], first[~known[nodes]]
            known[nodes] = True
            for k in np.flatnonzero(row > LEAST_WEIGHT):
                parts.append((nodes, table[first, k], np.full(len(nodes), row[k])))
    return (np.concatenate(part) for part in zip(*parts, strict=True))


def _interpolation(space, fixed, vertex):
    """P, without what moves prescribed components or what these move, but for the vertices' own rows. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_local, d) of bool
        Prescribed components.
    vertex : ndarray (n_local,) of bool

    Returns
    -------
    PETSc.Mat
    """
    d, rows = space.dim, space.n_owned * space.dim
    own = vertex[space.owned_local]
    count = int(own.sum())
    start = space.comm.scan(count) - count
    numbers = np.zeros((space.n_owned, d))
    numbers[own, 0] = start + np.arange(count)
    numbers = np.rint(space.at_nodes(numbers)[:, 0]).astype(np.int64)
    node, parent, value = _weights(space, vertex)
    kept = (node == parent)[:, None] | ~(fixed[node] | fixed[parent])
    row = ((space.nodes[node] - space.start)[:, None] * d + np.arange(d))[kept]
    column = (numbers[parent][:, None] * d + np.arange(d))[kept]
    value = np.broadcast_to(value[:, None], kept.shape)[kept]
    order = np.lexsort((column, row))
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
    sizes = ((rows, space.n_dofs), (count * d, space.comm.allreduce(count) * d))
    matrix = PETSc.Mat().create(comm=space.comm)
    matrix.setSizes(sizes)
    matrix.setBlockSizes(d, d)
    matrix.setType("aij")
    matrix.setPreallocationCSR((first.astype(PETSc.IntType), column[order].astype(PETSc.IntType), value[order]))
    matrix.assemble()
    return matrix


def lower_degree(problem, options):
    """The level of degree 1 where multigrid has one: the user chose no other preconditioner; else None. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    options : pcontact.runtime.options.Options
    """
    if options.get("pc_type") != "mg" or not has_lower_degree(problem):
        return None
    return LowerDegree(problem)


def has_lower_degree(problem):
    """Return whether there is a level of degree 1: a component that leads others may be none of a vertex."""
    return problem.space.degree == 2 and problem.conditions.followers is None
