"""How a solve of a load step ended."""

from dataclasses import dataclass, replace


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
    partners : dict or None
        What the last search for partners has said, see :class:`pcontact.stepping.partner_update.PartnerUpdate`.
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
    partners: dict | None = None
    final: bool = False


def combined(first, second):
    """The second of two solves of a load step, with the iterations of both."""
    return replace(
        second,
        newton=first.newton + second.newton,
        krylov=first.krylov + second.krylov,
        hardest=max(first.hardest, second.hardest),
    )
