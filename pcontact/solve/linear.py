"""Defaults of the solvers, per situation; the user's own options win."""

import numpy as np

from pcontact.assembly.operator import AIJ, BESIDE
from pcontact.runtime import log
from pcontact.runtime.petsc import PETSc, forget_pattern, full_steps, known_types, line_search_limit
from pcontact.solve.preconditioners import MULTIGRID, preconditioner

# [-] The area in contact may grow by this factor before the preconditioner is set up again. Row: reuse.
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
        """Whether there has been a solve since it has forgotten."""
        return self._rate is not None

    def forget(self):
        """Have the next solve set up its preconditioner."""
        self._rate, self._fresh, self._area = None, True, 0.0

    def keep(self, ksp, area):
        """Whether the next solve keeps the preconditioner. To be asked once before each solve.

        Parameters
        ----------
        ksp : PETSc.KSP
            With the iterations of the last solve.
        area : float
            That is in contact.
        """
        if self._rate is None or area > GROWN * self._area:
            self._rate, self._fresh, self._area = np.inf, True, area
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


def solver_defaults(symmetric, ranks, krylov=None, lower=None):
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
    if ranks <= FEW:
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


def newton_defaults(linear, direct, inexact):
    """Options proposed for SNES and the tolerance of its linear solves.

    Parameters
    ----------
    linear : bool
        Whether one iteration will do.
    direct : bool
        Whether the linear systems are factorised.
    inexact : float
        Loosest tolerance of the linear solves if neither.

    Returns
    -------
    dict of str to object
    """
    options = {
        "snes_type": "newtonls",
        # steps are shortened or prolonged before, see `pcontact.solve.globalisation`
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
        **options, "snes_ksp_ew": True, "snes_ksp_ew_version": 2, "snes_ksp_ew_rtol0": inexact,
        "snes_ksp_ew_rtolmax": inexact,
    }  # fmt: skip
