"""The solution of a load step: Newton's method, and again with other partners and multipliers until these settle.

Partners are found again where the bodies have gone: a load step ends when that changes its answer no more. Multipliers
of contact are updated around Newton's method (Uzawa) until they change no more.
"""

import math
import time as clock
from dataclasses import replace
from functools import partial

import numpy as np

from pcontact.contact.formulation.methods import AugmentedLagrangian, update_multipliers
from pcontact.runtime import log, profile
from pcontact.runtime.petsc import MPI
from pcontact.solve.convergence import combined

# [searches] Between the iterations of Newton's method in a load step at most, where closed points leave their facets.
# From: chosen; points that go to and fro keep the facets of the last one.
WITHIN = 8
# [searches] After so many of them points that are hardly beyond their facets keep them. From: ball on block, 12,000
# unknowns: a point that is to end on the edge between two facets goes to and fro, with 4 four times.
FIRM = 1
# [-] Part of the largest residual of a run below which iterates are so near to the solution that partners are those of
# the solution: found again between the iterations, they need no run of their own. From: ball on block, 12,000 and
# 50,000 unknowns, finite strain, 8 iterations without and 6 with it, whether 0.1 or 0.001.
NEAR_SOLUTION = 1e-3
# [searches] In a load step at most where the user does without a check, and bodies have finite strain. From: chosen.
MOST = 8
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


class PartnerUpdate:
    """Solves a load step, and again with the partners that points have at the solution, until they hardly change it.

    Newton's method always has the exact derivative of what is frozen. Between two searches partners are frozen: places,
    normals and gaps at small strain, facets that go on beyond their edges where bodies have finite strain. Closed
    points that an iteration takes beyond their facets get others at once. Points that end on an edge would change
    between its two facets for ever: in later searches they stay.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    newton : pcontact.solve.newton.Newton
    most : int
        Searches of a load step where Newton's method has ended. What still changes after them has not converged.
    tolerance : float
        Part of the answer that frozen partners may change, see :func:`pcontact.contact.active_set.misled`.
    items : list of pcontact.assembly.item.Item
        That are asked.
    multipliers : callable, optional
        From what solves on to the :class:`Uzawa` that settles multipliers, or None. It does so before partners are
        verified: until then the bodies are deep in each other; with finite strain, where they slide along each other
        meanwhile, after that.

    Attributes
    ----------
    carried : float
        Whether the last load step took other partners than it began with, so that those of the next one are found near
        its solution already, or not (0); where it did, how many times as much as expected that has changed the forces,
        at least 1. A restarted run goes on with it.
    """

    def __init__(self, problem, newton, most, tolerance, items, multipliers=lambda solver: None):
        self.problem, self.newton, self.most, self.tolerance, self.items = problem, newton, most, tolerance, items
        # committed displacement and end of the load step
        self._step, self._searches, self.carried = None, 0, 0.0
        # where the last search has changed nothing
        self._found = None
        self._follows = any(item.follows for item in items)
        self._settle = multipliers(self if self._follows else newton)
        # how many times as much the last change of partners has changed forces as was expected, at least 1
        self._gain = 1.0

    def __call__(self, u, before, time):
        """Solve a load step. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            As for :meth:`pcontact.solve.newton.Newton.solve`.
        before : PETSc.Vec
            The committed displacement.
        time : float
            At which the load step ends.

        Returns
        -------
        pcontact.solve.convergence.NewtonResult
            With the iterations of all runs, and what the last search has said.
        """
        left, self._step, self._searches, self._found = [WITHIN], (before, time), 0, None

        # bodies that yield move far, and take as many iterations to flow anew as they took to flow
        near = NEAR_SOLUTION if self._follows or self.carried or self.problem.bulk.yields else 0.0
        self._gain, self.carried = max(self.carried, 1.0), 0.0

        def follow(x, part):
            if not left[0] or not (part < near or any([item.strays(x) for item in self.items])):
                return False
            changed = self._renewed(x, self._follows and left[0] <= WITHIN - FIRM, self.tolerance / self._gain)
            left[0] -= changed
            return changed

        result = self.newton.solve(u, follow) if self.items else self.newton.solve(u)
        result = self._settled(u, self._with_multipliers(u, result, False))
        return self._with_multipliers(u, result, True)

    def _with_multipliers(self, u, result, verified):
        """The result after multipliers have settled, if there are some, and if that is to be when partners have been
        verified, or before. *Collective.*"""
        wanted = self._settle is not None and result.converged and verified == self._follows
        return self._settle(u, result) if wanted else result

    def again(self, u):
        """Solve on from the solution ``u`` of the load step after multipliers have changed, see
        :meth:`pcontact.solve.newton.Newton.again`. *Collective.*"""
        self._found = None
        return self._settled(u, self.newton.again(u))

    def _settled(self, u, result):
        """Go on from a solution until partners hardly change it. *Collective.*

        What partners change is expected from the gaps; what they have changed tells how much that is worth.
        """
        if not self.items:
            return result
        for searches in range(self.most + 1):
            before = self._forces(u) if result.converged else None
            if before is None or not self._renewed(u, searches >= FIRM, self.tolerance / self._gain):
                break
            if searches == self.most:
                reason = f"points of contact still find other partners after {self.most} searches"
                result = replace(result, converged=False, reason=reason)
                break
            expected = np.array([item.stale for item in self.items])
            result = self._with_multipliers(u, combined(result, self.newton.again(u, near=True)), False)
            self._compare(before, self._forces(u), expected)
        change = self._gain * max(item.stale for item in self.items)
        # points that may keep what they have are in it
        unsettled = sorted({item.name for item in self.items if self._gain * item.stale > self.tolerance})
        self.carried = self._gain if self.carried else 0.0
        return replace(result, partners={"change": change, "searches": self._searches, "unsettled": unsettled})

    def _forces(self, u):
        """Contact forces (np, d) at the points of every item [force]. *Collective.*"""
        return [item.forces(u)[0] * item.source.jxw[:, None] for item in self.items]

    def _compare(self, before, after, expected):
        """Take the gain from the forces of all items before and after partners have changed, and from the parts (n,)
        that were expected to change. *Collective.*"""
        own = [[np.linalg.norm(one, axis=1).sum() for one in (b - a, a, b)]
               for a, b in zip(before, after, strict=True)]  # fmt: skip
        change, *sizes = self.problem.space.comm.allreduce(np.array(own), op=MPI.SUM).T
        size = np.maximum(*sizes)
        # partners of one contact change the forces of the others, too; Newton's tolerance changes all of them
        part = np.max(change[size > 0.0] / size[size > 0.0], initial=0.0)
        if np.max(expected) > 0.0:
            self._gain = max(1.0, float(part / max(np.max(expected), self.newton.snes.getTolerances()[0])))

    def _stays(self, u):
        """Return whether bodies have moved so little since the last search, which has changed nothing, that this one
        would change nothing either. *Collective.*"""
        if self._found is None:
            return False
        space = self.problem.space
        moved = space.longest(space.of_owned(u - self._found))
        return moved <= min(item.lasts for item in self.items)

    def _renewed(self, u, firm, part):
        """Return True if an item has changed its partners, with those that it has wrong by more than a part, see
        :meth:`pcontact.assembly.item.Item.renew`. *Collective.*"""
        if self._stays(u):
            return False
        start = clock.perf_counter()
        with profile.phase("search"):
            changed = [item.renew(u, *self._step, firm, part) for item in self.items]
        self._searches += 1
        lasts = 0.0 if any(changed) else min(item.lasts for item in self.items)
        self._found = u.copy() if lasts > 0.0 else None
        self.newton.timing["search"] += clock.perf_counter() - start
        if any(changed):
            self.carried = self._gain
        return any(changed)


def load_steps(problem, newton, options):
    """Return what solves the load steps of a problem: a :class:`PartnerUpdate` of the items that ask for it, none
    where the user does without, with the multipliers of contacts that have some."""
    most = options.get("contact_search_again")
    items = [item for item in problem.others if item.follows or (item.verifies and most > 0)]
    return PartnerUpdate(problem, newton, most or MOST, options.get("contact_partner_rtol"), items,
                         partial(uzawa, problem.contacts, options=options))  # fmt: skip


class Uzawa:
    """Solves a load step on with new multipliers, again and again.

    Parameters
    ----------
    contacts : list of list of pcontact.contact.pair.ContactPair
        Of each contact that has multipliers its pair, or its halves.
    solver : pcontact.solve.newton.Newton or pcontact.stepping.load_step.PartnerUpdate
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
