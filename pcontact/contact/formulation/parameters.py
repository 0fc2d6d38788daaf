"""Parameters of a pair, and the dimensionless ones that it takes when the scene does not say them.

gamma = gamma0 times the constant of the trace inequality of the parent cell [stress/length], in every formulation. That
constant has lam + 2 mu, which bounds the normal traction. The tangential one is bounded by the shear modulus alone,

    t_n^2 / (lam + 2 mu) + |t_T|^2 / mu <= sigma : eps,

so on simplices alpha gamma may be as small as mu / (lam + 2 mu) times gamma: with the same gamma0 the method is
coercive. Four times that, min(1, 4 mu / (lam + 2 mu)), which is 1 up to a Poisson's ratio of 1/3, is taken unless alpha
is said, and the trace constant of other cells is that of the traction whose tangential part counts over it.
Near Poisson's ratio 0.5, lam is hundreds of times mu: with alpha = 1 points would stick by springs hundreds of times as
stiff as the body is in shear, and Newton's method would not find which of them slip.
"""

from typing import NamedTuple

import numpy as np

# by theta. theta = -1 is coercive for any value; below 1 multigrid fails for quadratic hexahedra
GAMMA0 = {1.0: 2.0, 0.0: 1.0, -1.0: 1.0}
# bodies enter each other by p / gamma, a third of what the pressure does to a layer of cells: the error falls with the
# mesh. On curved surfaces a larger number makes the gap small at every point and spoils the pressure (cylinder on a
# block, 10 facets in the half width, error in L2: 19 % with 3, 49 % with 10, 138 % with 100). Multipliers take the
# penetration away in a few updates, and leave the smaller number
TRACELESS = {"penalty": 3.0, "augmented_lagrangian": 1.0}


class Parameters(NamedTuple):
    """What the terms of a pair are weighted with.

    Attributes
    ----------
    theta : float
        Of the adjoint term: 1, 0, -1.
    alpha : ndarray (np,)
        Of the tangential part over that of the normal one.
    gamma : ndarray (np,)
        Of the points of the source [stress/length].
    """

    theta: float
    alpha: np.ndarray
    gamma: np.ndarray


def coercive(theta):
    """gamma0 above which Nitsche's method is coercive on any mesh, for a source and a target: (1 + theta)^2 / 4."""
    return 0.25 * (1.0 + theta) ** 2


def parameter(contact):
    """gamma0 of a contact.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved; a formulation that is not said is Nitsche's.

    Returns
    -------
    float
    """
    if contact.gamma0 is not None:
        return contact.gamma0
    return TRACELESS.get(contact.formulation) or GAMMA0[float(contact.theta)]
