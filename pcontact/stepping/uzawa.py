"""Uzawa's loop: multipliers of contact are updated around Newton's method until they settle."""

import math
from dataclasses import replace

from pcontact.contact.formulation.augmented import AugmentedLagrangian, update_multipliers
from pcontact.runtime import log
from pcontact.solve.convergence import combined

# [-] Change of the multipliers, in parts of the traction, up to which a load step may end after the last update, with a
# warning. From: bodies enter each other by 1 % of what pressure does to a layer of cells.
CREEP = 1e-2
# [updates] So many in a row, each of which leaves the same part of the change, tell the rate. From: chosen; it decides
# whether a load step is cut or the run ends.
STEADY = 4
# [-] Difference of these parts, in parts of one, that counts as none. From: chosen, as STEADY.
ALIKE = 0.1
# [updates] That a user may be asked for. From: chosen; a sentence depends on it, no iteration.
ASKED = 300


class Uzawa:
    """Solves a load step on with new multipliers, again and again.

    Parameters
    ----------
    contacts : list of list of pcontact.contact.pair.ContactPair
        Of each contact that has multipliers its pair, or its halves.
    solver : pcontact.solve.newton.Newton or pcontact.stepping.partner_update.PartnerUpdate
        Solves on with other multipliers by its `again`.
    rtol : float
        Change of the multipliers, relative to the traction, at which they have settled.
    max_it : int
        Updates of a load step at most.
    """

    def __init__(self, contacts, solver, rtol, max_it):
        self.contacts, self.solver, self.rtol, self.max_it = contacts, solver, rtol, max_it
        self._failed = False

    def __call__(self, u, result):
        """Go on from the solution with the multipliers of the last load step. *Collective.*

        The displacement and the traction that acts are in equilibrium whatever the number of updates, but bodies enter
        each other. Multipliers that creep (there are more conditions at the points than the displacement can meet) are
        reported; with those that are far from settled the load step has not converged.

        How fast they settle follows from mesh and gamma. A load step of half the size begins half as far away, which
        saves an update or two, and there are twice as many of them: where the rate is known, or a shorter load step
        has failed as well, it is not cut.

        Parameters
        ----------
        u : PETSc.Vec
            Overwritten.
        result : pcontact.solve.convergence.NewtonResult
            Of that solution, which converged.

        Returns
        -------
        NewtonResult
            With the iterations of all solves, and ``uzawa``: the ``updates`` and the last ``change``.
        """
        updates, sizes = 0, []
        while True:
            last = updates == self.max_it
            changes = [update_multipliers(pairs, u, float("inf") if last else self.rtol) for pairs in self.contacts]
            change = max(part for part, _ in changes)
            sizes.append([size for _, size in changes])
            if change <= self.rtol or last:
                break
            for pair in (pair for pairs in self.contacts for pair in pairs):
                pair.method.stiffen()
            then = self.solver.again(u)
            updates += 1
            result = combined(result, then)
            if not result.converged:
                break
        if result.converged:
            worst = [part for part, _ in changes].index(change)
            result = self._judged(result, change, [size[worst] for size in sizes], self.contacts[worst][0].name)
        return replace(result, uzawa={"updates": updates, "change": change})

    def _judged(self, result, change, sizes, name):
        """The result after the last update.

        Parameters
        ----------
        result : NewtonResult
        change : float
            Largest change of the multipliers that is left, relative to the traction.
        sizes : list of float
            Norms of the changes of that pair, before each update and after the last one.
        name : str
            Of that pair.
        """
        updates = len(sizes) - 1
        if change <= self.rtol:
            self._failed = False
            return result
        text = (
            f"contact {name}: multipliers still change by {change:.1e} of the traction after {updates} updates "
            f"(-contact_uzawa_rtol {self.rtol:.1e})"
        )
        if change <= CREEP:
            self._failed = False
            log.warning("%s", text)
            return result
        left = rate(sizes)
        final, self._failed = self._failed or left is not None, True
        text += "; a shorter load step does not change that" if final else ""
        text += f"; remedy: {_remedy(left, updates, self.rtol / change)}"
        return replace(result, converged=False, reason=text, final=final)


def rate(sizes):
    """Part of the change of the multipliers that an update leaves; None as long as it differs from one to the next.

    Parameters
    ----------
    sizes : list of float
        Norms of the changes, before each update and after the last one.
    """
    last = sizes[-STEADY - 1 :]
    if len(last) <= STEADY or min(last) <= 0.0:
        return None
    ratios = [after / before for before, after in zip(last, last[1:], strict=False)]
    return ratios[-1] if max(ratios) - min(ratios) <= ALIKE * ratios[-1] else None


def _remedy(left, updates, wanted):
    """Advice where each update leaves a part of the change, and another part of it is wanted."""
    if left is not None and left < 1.0:
        needed = updates + math.ceil(math.log(wanted) / math.log(left))
        if needed <= ASKED:
            return f"-contact_uzawa_max_it {needed}"
    more = "" if left is not None else "-contact_uzawa_max_it, "
    return more + 'a gamma0 near 1, formulation = "nitsche"'


def uzawa(contacts, solver, options):
    """The loop of the contacts of a problem; None where no pair has multipliers."""
    contacts = [contact.pairs for contact in contacts if isinstance(contact.method, AugmentedLagrangian)]
    if not contacts:
        return None
    return Uzawa(contacts, solver, options.get("contact_uzawa_rtol"), options.get("contact_uzawa_max_it"))
