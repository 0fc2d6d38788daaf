"""What a contact says of the gap between the undeformed bodies: adjusted away, a clearance, an overlap that grows."""

import numpy as np


class InitialGap:
    """The gap that the undeformed bodies are given, and what is added to gaps for it.

    With the gap g of the first search, the bodies are given g' = 0 where they are adjusted, the clearance where it is
    said, or g. Of an overlap, g' < 0, the part f(t) acts: to all gaps there is added g' - g + (f - 1) min(g', 0). Of
    a gap that a bilateral contact closes that part does, too: g' stands in the place of min(g', 0).

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
    """

    def __init__(self, contact):
        self._within = (contact.adjust_within or 0.0) if contact.interference == "adjust" else None
        self._clearance, self._table = contact.clearance, contact.interference_amplitude
        self._bilateral, self._base, self._overlap = contact.bilateral, None, None

    @property
    def known(self):
        """Whether the gap between the undeformed bodies is known."""
        return self._base is not None

    def take(self, gap, paired):
        """Take the gap (np,) of the undeformed bodies [length], at points (np,) that have a partner."""
        given = gap
        if self._within is not None:
            given = np.where(gap <= self._within, 0.0, gap)
        elif self._clearance is not None:
            given = np.full_like(gap, self._clearance)
        self._base = np.where(paired, given - gap, 0.0)
        self._overlap = np.where(paired, given if self._bilateral else np.minimum(given, 0.0), 0.0)

    def offset(self, time):
        """What is added to gaps (np,) at a time [length]."""
        if self._table is None:
            return self._base
        times, factors = np.transpose(self._table)
        return self._base + (np.interp(time, times, factors) - 1.0) * self._overlap


def initial_gap(contact):
    """The :class:`InitialGap` of a contact; None where the bodies are as they are in the mesh."""
    said = contact.clearance is not None or contact.interference_amplitude is not None
    return InitialGap(contact) if said or contact.interference == "adjust" else None
