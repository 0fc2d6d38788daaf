"""Tied pairs: surfaces that are glued together as they are, on meshes that need not match.

A tied point obeys the law of stick without a bound: the projection is the identity, P = tau, and Nitsche's method
becomes that of an interface condition [[u]] = 0,

    R  = - int tau . [[v]] + theta int (tau - t) . G^-1 T[v],   tau = t - G [[u]],

without a gap: what lies between the surfaces at the beginning, or how far they overlap, stays there without any force.
The condition is linear. Partners are found once, in the undeformed bodies, and the jump counts from there.
"""

import numpy as np

from pcontact.contact.augmented import AugmentedFrictionalItem
from pcontact.contact.frictional import FrictionalItem
from pcontact.contact.summary import components_of
from pcontact.runtime.petsc import MPI


class TiedItem(FrictionalItem):
    """Two surfaces glued together, by Nitsche's method or by penalty; parameters as for `FrictionalItem`."""

    changes = False
    # nothing can slip: there is no law to hold points against
    hold = None

    def __init__(self, *args, **more):
        super().__init__(*args, **more)
        self.bilateral = True

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find the partners in the undeformed bodies, the first time. *Collective.*"""
        if self.pairing is not None:
            self.flips, self._status = [], None
            self._begin(u, time)
            return
        super().detect(self.space.vector(), time)
        self.pairing.gap0[:] = 0.0
        # bodies that are tied do not lose each other
        self.radius = np.inf

    def joined(self):
        """Pairs (n, 2) of connected components with a tied point between them, on all ranks. *Collective.*"""
        own, other = components_of(self.space, self.pairing, self.source)
        pairs = np.unique(np.column_stack([own, other])[self.pairing.paired], axis=0)
        return np.unique(np.concatenate(self.space.comm.allgather(pairs)), axis=0)

    def count(self):
        """Points that have a partner, and all points, of all ranks. *Collective.*"""
        own = np.array([np.sum(self.pairing.paired), len(self.source.facet)])
        return tuple(int(n) for n in self.space.comm.allreduce(own, op=MPI.SUM))

    def _begin(self, u, time):
        self._start = self._before = np.zeros_like(self.source.x)

    def _couples(self, closed):
        return self.pairing.paired

    def _end(self, values):
        _, self.committed = self._augmented(values)

    def committed_areas(self):
        """None: tied areas tell nothing of whether a contact opens or slips."""
        return np.zeros(3)

    def glue(self, glued):
        """Tied points are glued."""

    def reach(self, u, y):
        """All of it: nothing can pass through anything. *Collective.*"""
        return 1.0

    def motion(self, u, before):
        """None that partners could be lost by. *Collective.*"""
        return 0.0

    def memory(self):
        """Nothing: partners are those of the undeformed bodies."""
        return {}

    def recall(self, name, chunks):
        """Nothing to take back."""
        return None


class AugmentedTiedItem(AugmentedFrictionalItem, TiedItem):
    """Two surfaces glued together by the augmented Lagrangian method; parameters as for `FrictionalItem`."""
