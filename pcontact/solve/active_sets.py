"""Points of all items that open and close: their sums over items and ranks, and the rules that some of them follow."""

import numpy as np

from pcontact.assembly.item import FROZEN, LAW, active_set
from pcontact.runtime.petsc import MPI

# [points] So many, and such a part of the closed area, have to open, or to close, for a rule that takes a contact to
# grow or to recede all along its edge. Row: opening.
MANY = 12
# [-] See MANY. Row: opening.
WIDE = 0.02
# [-] Part of that area which may change the other way at the same time. Row: opening.
MIXED = 0.1
# [-] Part of the area opened since a contact began to recede that may overlap; where most of it does, the bodies do
# not lift off. Row: opening.
MOSTLY = 0.6


class ActiveSets:
    """Active sets of the items of a problem.

    A status rule (`pcontact.assembly.item.StatusRule`) for each item but the bulk is an argument of residual and
    tangent of a problem: a tuple, :attr:`by_law` if nothing is said.

    Parameters
    ----------
    space : pcontact.space.space.Space
    others : list of pcontact.assembly.item.Item
        All items but the bulk.
    yields : bool
        Whether bodies may yield.

    Attributes
    ----------
    sets : list of (pcontact.assembly.item.Item, pcontact.assembly.item.ActiveSet)
        Of the items with points that open and close.
    by_law : tuple of pcontact.assembly.item.StatusRule
        All points go by their laws.
    """

    def __init__(self, space, others, yields):
        self._space, self._others = space, others
        self._recedes = not (yields or any(item.can_slip for item in others))
        self.sets = [(item, one) for item in others if (one := active_set(item)) is not None]
        self.by_law = (LAW,) * len(others)

    def changed_by_supports(self, before, u):
        """Names of the items with points that the supports alone open or close. *Collective.*"""
        areas = np.array([one.area_changed_by_supports(before, u) for _, one in self.sets])
        areas = self._space.comm.allreduce(areas, op=MPI.SUM)
        return {item.name for (item, _), area in zip(self.sets, areas, strict=True) if area > 0.0}

    def frozen(self, changed=frozenset()):
        """Rules by which items with points closed at the end of the last load step keep them so, and the others open.
        *Collective.*

        Items without closed points go by their laws, but for those with a name that has `changed`: supports that move
        have closed some of their points.
        """
        counts = np.array([one.closed_count() for _, one in self.sets], dtype=np.int64)
        counts = self._space.comm.allreduce(counts, op=MPI.SUM)
        kept = changed | {item.name for (item, _), count in zip(self.sets, counts, strict=True) if count}
        return tuple(FROZEN if item.name in kept else LAW for item in self._others)

    def turned(self, u):
        """See :meth:`pcontact.assembly.item.ActiveSet.turned`: sums (4,) over items and ranks. *Collective.*"""
        own = sum((one.turned(u) for _, one in self.sets), np.zeros(4))
        return self._space.comm.allreduce(own, op=MPI.SUM)

    def recede(self, u, since=None):
        """Rules under which points that are open in the last tangent, or at the end ``u`` of a full Newton step, stay
        so; None where the step ends otherwise. *Collective.*

        A step has many points to open, and none to close, where a contact recedes: bodies that touch everywhere are
        pressed in one place. Taken at its word, the next step closes points far away: what is cut loose there overlaps.
        They open in the iteration after, while others overlap farther on: a false contact travels through the bodies.
        Points that do not close again cannot travel, and each iteration leaves fewer of them closed; which of them are
        to close is asked when no more open, and they are few. With friction a load step may have several solutions, and
        which of them is found depends on which points have slipped on the way: there the law holds throughout.

        Parameters
        ----------
        u : PETSc.Vec
        since : float, optional
            Closed area before the first step that such rules followed, if this one has begun under them
            [length^(d - 1)].
        """
        if not self._recedes:
            return None
        closed, opens, closes, count = self.turned(u)
        if since is None:
            goes = count >= MANY and opens > WIDE * closed and closes <= MIXED * opens
        else:
            goes = count > 0 and closes <= MOSTLY * (since - self.closed_area())
        if not goes:
            return None
        found = {id(item): one.recede(u, LAW) for item, one in self.sets}
        return None if None in found.values() else tuple(found.get(id(item), LAW) for item in self._others)

    def closed_area(self):
        """Area of all points that were closed in the last tangent [length^(d - 1)]. *Collective.*"""
        own = sum(one.closed_area() for _, one in self.sets)
        return self._space.comm.allreduce(own, op=MPI.SUM) if self.sets else 0.0

    def step_limit(self, u, y, falls=None):
        """Part of the Newton step ``-y`` that all items admit; more than 1 where loose bodies touch nothing yet.
        *Collective.* `falls` (n_components,) of bool says which bodies nothing but the stabilisation holds back in it.
        """
        if falls is None and any(item.holds for item in self._others):
            falls = np.zeros(self._space.mesh.n_components, dtype=bool)
        parts = [one.step_limit(u, y, falls) for _, one in self.sets]
        # nothing holds a loose body before it touches something: it goes there whatever its load is
        return min([part for part in parts if part is not None], default=1.0)

    def borne(self, u):
        """Sums of the magnitudes of the contact forces on every component (n_components,) [force]. *Collective.*"""
        return self._by_component(one.force_magnitudes(u) for _, one in self.sets)

    def bonds(self):
        """Forces (n_components,) that adhesion may exert on every component without pressure [force]. *Collective.*"""
        return self._by_component(one.bonds() for _, one in self.sets)

    def touched(self):
        """Area of every component (n_components,) that was closed at the end of the last load step. *Collective.*"""
        return self._by_component(one.closed_areas() for _, one in self.sets)

    def _by_component(self, parts):
        """Sum (n_components,) over ranks of arrays that are. *Collective.*"""
        return self._space.comm.allreduce(sum(parts, np.zeros(self._space.mesh.n_components)), op=MPI.SUM)
