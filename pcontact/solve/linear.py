"""Defaults of the linear solver, per situation; the user's own options win."""


def solver_defaults(symmetric, mumps):
    """Options proposed for the Krylov method and the preconditioner.

    Parameters
    ----------
    symmetric : bool
        Whether the tangent is symmetric positive definite: theta = 1 (or no contact) without friction.
    mumps : bool
        Whether PETSc has MUMPS, for the coarse problem of several ranks.

    Returns
    -------
    dict of str to object
        Option names and values; a value of None is a flag.

    Notes
    -----
    The near-null space attached to the matrix holds the rigid modes of every body, so that aggregates that straddle a contact
    represent the bodies' relative motion. Chebyshev/Jacobi smoothing tolerates the empty coarse degrees of freedom that this
    makes; a threshold of 0 drops explicit zeros from the graph.
    """
    options = {
        "pc_type": "gamg",
        "pc_gamg_agg_nsmooths": 1,
        "pc_gamg_threshold": 0.0,
        # the estimate made for smoothed aggregation can be older than the contact; Chebyshev then amplifies its modes
        "pc_gamg_use_sa_esteig": False,
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_pc_type": "jacobi",
        "mg_levels_ksp_max_it": 2,
        "ksp_max_it": 500,
    }
    if symmetric:
        options.update({"ksp_type": "cg", "ksp_norm_type": "unpreconditioned"})
    else:
        options.update({"ksp_type": "gmres", "ksp_gmres_restart": 60, "ksp_pc_side": "right"})
    return options
