"""How the points of a contact pair stood at the end of the last load step, and what a displacement would change."""

import numpy as np

from pcontact.contact.laws import OPEN
from pcontact.contact.summary import borne
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# Where the contact is too small by a width d, the bodies overlap beside its edge up to 3/2 d from there: their gap is
# that of a crack and that of the edge, proportional to sqrt(x) (2/3 x - d). So much of what closes is right.
RIGHT = 2.0 / 3.0
# points, and part of the closed area, that have to close for this, and part of that area that may open at the same time
MANY, WIDE, MIXED = 12, 0.02, 0.1
# places along a step between which points that close are told apart
BINS = 1000


class Standing:
    """Part of :class:`pcontact.contact.item.ContactItem`."""

    # what the points that are paired were before some were deferred
    _admitted = None

    @property
    def closed(self):
        """Points (np,) that were closed at the end of the last load step."""
        return self.committed > OPEN

    def committed_areas(self):
        """Areas of the points that were open, sticking, slipping at the end of the last load step, of this rank."""
        return np.bincount(self.committed, self.source.jxw, minlength=3)

    def touched(self):
        """Area of the points of this rank that were closed at the end of the last load step, for every component, see
        :func:`pcontact.contact.summary.borne`. *Collective.*
        """
        return borne(self.space, self.pairing, self.source, self.closed.astype(float))

    def pulled(self, u):
        """Area of the points of this rank that were closed and that ``u`` would open. *Collective.*"""
        return float(np.sum(self.source.jxw[self.closed & (self._pressed(u) > 0.0)]))

    def misled(self, before, u):
        """Area of the points of this rank that ``u``, in which only supports have moved, opens or closes. *Collective.*

        Obstacles have moved already: against them the comparison is with the last load step, else with the
        displacement ``before``.
        """
        now = self._pressed(u)
        then = np.where(self.closed, -1.0, 1.0) if self.rigid else self._pressed(before)
        # surfaces that just touch are closed, and remain so
        return float(np.sum(self.source.jxw[(now * then < 0.0) & self.pairing.paired]))

    def _pressed(self, u, wanted=None):
        """Augmented normal traction (np,) [stress], negative where points are closed; of the wanted ones at least."""
        traction, gap = self._contact(self.pairing.exchange.gather(u), wanted)
        return traction + self.gamma[self.source.facet] * gap

    def defer(self, before, u):
        """Keep open, until :meth:`admit`, a third of the area that a full Newton step closes: what closes last in it.
        *Collective.*

        Newton's method closes half as much again as it should, see `RIGHT`, and opens half of what is too much in each
        of the next iterations: the finer the mesh, the more of them.

        Parameters
        ----------
        before, u : PETSc.Vec
            Where the step began, and where it ended.

        Returns
        -------
        bool
            Whether there are such points: where many close, and hardly any open.
        """
        if self.bilateral:
            return False
        p, jxw = self.pairing, self.source.jxw
        first, last = self._pressed(before, p.acts), self._pressed(u, p.acts)
        closed, closes = p.paired & (first <= 0.0), np.flatnonzero(p.paired & (first > 0.0) & (last <= 0.0))
        place = (BINS * first[closes] / (first[closes] - last[closes])).astype(np.int64)
        areas = np.bincount(place, jxw[closes], minlength=BINS + 1)
        others = [jxw[closed].sum(), jxw[closed & (last > 0.0)].sum(), len(closes)]
        areas = self.space.comm.allreduce(np.append(np.cumsum(areas), others), op=MPI.SUM)
        areas, (area, opens, count) = areas[:-3], areas[-3:]
        if area == 0.0 or count < MANY or areas[-1] < WIDE * area or opens > MIXED * areas[-1]:
            return False
        self._admitted, p.paired = p.paired, p.paired.copy()
        p.paired[closes[place > np.searchsorted(areas, RIGHT * areas[-1])]] = False
        return True

    def admit(self):
        """Leave all points to the law again."""
        if self._admitted is not None:
            self.pairing.paired, self._admitted = self._admitted, None

    def glue(self, glued):
        """Keep points closed or open as they were at the end of the last load step; or let them go."""
        p = self.pairing
        if glued:
            self._free = p.paired, self.bilateral
            p.paired, self.bilateral = p.paired & self.closed, True
        else:
            p.paired, self.bilateral = self._free

    def memory(self):
        """What the next load step needs to know of this one, apart from the displacement.

        Returns
        -------
        dict of str to (ndarray (n,), ndarray (n, m))
            Keys of rows, the same on any number of ranks, and their values; rows of zeros are left out.
        """
        rows = np.flatnonzero(self.closed)
        return {"status": (self.source.point_keys()[rows], self.committed[rows, None].astype(float))}

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have."""
        return self.source.point_keys()

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave under a name.

        Parameters
        ----------
        name : str
        chunks : iterable of (ndarray (n,), ndarray (n, m))
            The rows of all ranks, a part at a time.

        Returns
        -------
        int or None
            Rows that were found on this rank; None for a name under which nothing is remembered here.
        """
        if name != "status":
            return None
        status = np.zeros((len(self.committed), 1))
        count = take_rows(self.source.point_keys(), chunks, status)
        self.committed[:] = status[:, 0]
        return count
