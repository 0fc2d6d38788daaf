"""How a solve of a load step ended, and whether it goes in circles."""

from dataclasses import dataclass, replace

# iterations in which the residual has to fall to half of what it was in as many before, else Newton goes in circles
# (and a multiple of two and three: short circles come back to where they were)
CYCLE = 6
# relative difference of norms that are the same
SAME = 1e-3


@dataclass
class NewtonResult:
    """How a solve ended.

    Attributes
    ----------
    converged : bool
    newton, krylov : int
        Iterations.
    hardest : int
        Krylov iterations of the linear solve that took most.
    reason : str
    residual, initial : float
        Last and first norm of the residual [force].
    detail : str
        Of a solve that did not converge: where the residual is largest, and which pairs were changing.
    uzawa : dict or None
        Updates of multipliers around the solve, where there are any, see `pcontact.stepping.uzawa`.
    free : list of int or None
        Loose bodies on which no contact acts, where there are loose ones, see `pcontact.stepping.loose`.
    final : bool
        Whether a shorter load step would end in the same way.
    """

    converged: bool
    newton: int
    krylov: int
    reason: str
    residual: float
    initial: float
    detail: str = ""
    uzawa: dict | None = None
    hardest: int = 0
    free: list | None = None
    final: bool = False


def combined(first, second):
    """The second of two solves of a load step, with the iterations of both."""
    return replace(
        second,
        newton=first.newton + second.newton,
        krylov=first.krylov + second.krylov,
        hardest=max(first.hardest, second.hardest),
    )


def cycles(norms):
    """Whether iterations go in circles: points change their status in turn, and the norm stays where it is."""
    if len(norms) < 2 * CYCLE:
        return False
    return bool(min(norms[-CYCLE:]) > 0.5 * min(norms[-2 * CYCLE : -CYCLE]))


def repeats(norms):
    """Whether iterations have gone through the same few states twice: the norms come back, one by one."""
    last, before = norms[-CYCLE:], norms[-2 * CYCLE : -CYCLE]
    return len(before) == CYCLE and all(abs(a - b) <= SAME * b for a, b in zip(last, before, strict=True))
