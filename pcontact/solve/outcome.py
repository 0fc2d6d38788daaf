"""How a solve of a load step ended, and whether it goes in circles."""

from dataclasses import dataclass, replace

# iterations in which the residual has to fall to half of what it was in as many before, else Newton goes in circles
CYCLE = 6


@dataclass
class Outcome:
    """How a solve ended.

    Attributes
    ----------
    converged : bool
    newton, krylov : int
        Iterations.
    reason : str
    residual, initial : float
        Last and first norm of the residual [force].
    detail : str
        Of a solve that did not converge: where the residual is largest, and which pairs were changing.
    uzawa : dict or None
        Updates of multipliers around the solve, where there are any, see `pcontact.stepping.uzawa`.
    """

    converged: bool
    newton: int
    krylov: int
    reason: str
    residual: float
    initial: float
    detail: str = ""
    uzawa: dict | None = None


def together(first, second):
    """The second of two solves of a load step, with the iterations of both."""
    return replace(second, newton=first.newton + second.newton, krylov=first.krylov + second.krylov)


def cycles(norms):
    """Whether iterations go in circles: points change their status in turn, and the norm stays where it is."""
    if len(norms) < 2 * CYCLE:
        return False
    return bool(min(norms[-CYCLE:]) > 0.5 * min(norms[-2 * CYCLE : -CYCLE]))
