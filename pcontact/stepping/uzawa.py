"""Uzawa's loop: multipliers of contact are updated around Newton's method until they settle."""

from dataclasses import replace

from pcontact.runtime import log
from pcontact.solve.outcome import together

# of the traction; Newton's method starts anew, near its solution, with each update
RTOL, MAX_IT = 1e-4, 30
# change up to which a load step may end after the last update, with a warning: bodies enter each other by this part of
# what pressure does to a layer of cells
CREEP = 1e-2


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
    grow : bool
        Whether gamma grows with the updates where it is smaller than the default one.
    accept : bool
        Whether a load step may end with multipliers that are far from settled.
    """

    def __init__(self, items, newton, rtol=RTOL, max_it=MAX_IT, grow=True, accept=False):
        self.items, self.newton, self.rtol, self.max_it = items, newton, rtol, max_it
        self.grow, self.accept = grow, accept

    def __call__(self, u, outcome):
        """Go on from the solution with the multipliers of the last load step. *Collective.*

        The displacement and the traction that acts are in equilibrium whatever the number of updates, but bodies enter
        each other. Multipliers that creep (there are more conditions at the points than the displacement can meet) are
        reported; with those that are far from settled the load step has not converged.

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
            if self.grow:
                for item in self.items:
                    item.stiffen()
            then = self.newton.again(u)
            updates += 1
            outcome = together(outcome, then)
            if not outcome.converged:
                break
        if outcome.converged and change > self.rtol:
            text = (
                f"multipliers of contact still change by {change:.1e} of the traction after {updates} updates "
                f"(-contact_uzawa_rtol {self.rtol:.1e})"
            )
            if self.accept or change <= CREEP:
                log.warning("%s", text)
            else:
                text += "; remedy: -contact_uzawa_max_it, or a gamma0 near 1; -contact_uzawa_accept takes it as it is"
                outcome = replace(outcome, converged=False, reason=text)
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
    max_it = options.get("contact_uzawa_max_it", MAX_IT, int, text=text, positive=True)
    text = "let gamma grow with the updates, up to the default"
    grow = options.get("contact_uzawa_grow", True, bool, text=text)
    text = "end a load step, with a warning, where multipliers are far from settled after the last update"
    return Uzawa(items, newton, rtol, max_it, grow, options.get("contact_uzawa_accept", False, bool, text=text))
