"""How the points of a contact pair stood at the end of the last load step, and what a displacement would change."""

import numpy as np

from pcontact.contact.laws import OPEN
from pcontact.runtime.parallel import matching


class Standing:
    """Part of :class:`pcontact.contact.item.ContactItem`."""

    @property
    def closed(self):
        """Points (np,) that were closed at the end of the last load step."""
        return self.committed > OPEN

    def committed_areas(self):
        """Areas of the points that were open, sticking, slipping at the end of the last load step, of this rank."""
        return np.bincount(self.committed, self.source.jxw, minlength=3)

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

    def _pressed(self, u):
        """Augmented normal traction (np,) [stress], negative where points are closed."""
        traction, gap = self._contact(self.pairing.exchange.gather(u))
        return traction + self.gamma[self.source.facet] * gap

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

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave under a name.

        Parameters
        ----------
        name : str
        chunks : iterable of (ndarray (n,), ndarray (n, m))
            The rows of all ranks, a part at a time.
        """
        if name == "status":
            self.committed[:] = OPEN
            for rows, values in matching(self.source.point_keys(), chunks):
                self.committed[rows] = values[:, 0]
