"""The integrators of inertia: rows of a table, which name what one step takes from its two ends.

With displacement u, velocity v, acceleration a and the forces q = M a at both ends 0 and 1 of a step dt,

    (1 - m) M a1 + m M a0 = (1 - f) q1 + f q0,
    u1 = u0 + dt v0 + dt^2 (d0 a0 + d1 a1),      v1 = v0 + dt (s0 a0 + s1 a1).

Forces are those of states at ends of steps alone: what is committed there (friction, plastic flow, partners) needs to
know of no other time. To add an integrator is to add a row: six numbers, or a function of alpha that returns them.
"""

from collections.abc import Callable
from typing import NamedTuple


class Weights(NamedTuple):
    """The numbers of an integrator [-], see the module.

    Attributes
    ----------
    force, mass : float
        f and m: parts of the forces and of the inertia that are those of the beginning.
    displacement, velocity : (float, float)
        (d0, d1) and (s0, s1) of the accelerations at the beginning and at the end; d1 > 0.
    """

    force: float
    mass: float
    displacement: tuple[float, float]
    velocity: tuple[float, float]

    @property
    def error(self) -> float:
        """The local error of the displacement over dt^2 (a1 - a0), against u''' dt^3 / 6 of a Taylor series."""
        return abs(self.displacement[1] - 1.0 / 6.0)


class Integrator(NamedTuple):
    """A row of the table.

    Attributes
    ----------
    weights : callable
        From alpha to :class:`Weights`.
    alpha : float or None
        Default of alpha; None: it has none.
    help : str
        One line.
    """

    weights: Callable[[float], Weights]
    alpha: float | None
    help: str


def newmark(alpha: float, force: float = 0.0, mass: float = 0.0) -> Weights:
    """Newmark's rule of second order whose dissipation grows with -alpha."""
    beta, gamma = 0.25 * (1.0 - alpha) ** 2, 0.5 - alpha
    return Weights(force, mass, (0.5 - beta, beta), (1.0 - gamma, gamma))


# least alpha of those that have one: stable without a bound of the step up to there
LEAST_ALPHA = -1.0 / 3.0
INTEGRATORS = {
    "hht": Integrator(lambda alpha: newmark(alpha, force=-alpha), -0.1,
                      "Hilber, Hughes, Taylor: damps what the steps are too long for, and little else"),
    "bossak": Integrator(lambda alpha: newmark(alpha, mass=alpha), -0.1,
                         "Wood, Bossak, Zienkiewicz: as much, by the inertia instead of the forces"),
    "trapezoidal": Integrator(lambda alpha: newmark(0.0), None, "damps nothing; impacts leave oscillations"),
    "euler": Integrator(lambda alpha: Weights(0.0, 0.0, (0.0, 1.0), (0.0, 1.0)), None,
                        "backward Euler, of first order: damps much, for bodies that are to come to rest"),
}  # fmt: skip
