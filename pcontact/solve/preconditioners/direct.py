"""Direct solves in the place of multigrid, where that fails: nearly incompressible bodies, cells of extreme aspect.

Multigrid with point smoothers has no answer to 1 / (1 - 2 nu) = 5e4, or to cells that are ten thousand times as long as
high. The factors of a matrix have; they cost memory that grows faster than the number of unknowns, so that only
problems of moderate size take them unasked.
"""

from pcontact.runtime import log
from pcontact.runtime.petsc import LEAST_PIVOT, can_factorise, has_package

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
