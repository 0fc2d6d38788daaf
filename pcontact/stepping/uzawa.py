"""Uzawa's loop: multipliers of contact are updated around Newton's method until they settle."""

from dataclasses import replace

from pcontact.runtime import log
from pcontact.solve.outcome import together

# of the traction; Newton's method starts anew, near its solution, with each update
RTOL, MAX_IT = 1e-4, 30


class Uzawa:
    """Solves a load step on with new multipliers, again and again.

    Parameters
    ----------
    items : list
        Those that have multipliers, see `pcontact.contact.augmented`.
    newton : pcontact.solve.newton.Newton
    rtol : float
        Change of the multipliers, relative to the traction, at which they have settled.
    max_it : int
        Updates of a load step at most.
    """

    def __init__(self, items, newton, rtol=RTOL, max_it=MAX_IT):
        self.items, self.newton, self.rtol, self.max_it = items, newton, rtol, max_it

    def __call__(self, u, outcome):
        """Go on from the solution with the multipliers of the last load step. *Collective.*

        The displacement and the traction that acts are in equilibrium whatever the number of updates. Multipliers that
        do not settle (more conditions at the points than the displacement can meet make them creep) are reported.

        Parameters
        ----------
        u : PETSc.Vec
            Overwritten.
        outcome : pcontact.solve.outcome.Outcome
            Of that solution, which converged.

        Returns
        -------
        Outcome
            With the iterations of all solves, and ``uzawa``: the ``updates`` and the last ``change``.
        """
        updates = 0
        while True:
            last = updates == self.max_it
            change = max(item.update_multipliers(u, float("inf") if last else self.rtol) for item in self.items)
            if change <= self.rtol or last:
                break
            then = self.newton.again(u)
            updates += 1
            outcome = together(outcome, then)
            if not outcome.converged:
                break
        if outcome.converged and change > self.rtol:
            log.warning(
                "multipliers still change by %.1e of the traction after %d updates (-contact_uzawa_rtol %.1e)",
                change, updates, self.rtol,
            )  # fmt: skip
        return replace(outcome, uzawa={"updates": updates, "change": change})


def uzawa(items, newton, options):
    """The loop of a problem; None where no item has multipliers."""
    halves = [half for item in items for half in getattr(item, "halves", [item])]
    items = [half for half in halves if hasattr(half, "update_multipliers")]
    if not items:
        return None
    text = "change of the multipliers relative to the traction at which they have settled"
    rtol = options.get("contact_uzawa_rtol", RTOL, float, text=text, positive=True)
    text = "updates of the multipliers in a load step at most"
    return Uzawa(items, newton, rtol, options.get("contact_uzawa_max_it", MAX_IT, int, text=text, positive=True))
