"""Detection: where the points of a source are, and the partners and gaps that they find there."""

import numpy as np

from pcontact.contact.points import interpolate
from pcontact.mesh.mesh import bounding_box


class Detection:
    """Looks for the partners of the points of a source.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
    source : pcontact.contact.surface.sides.SourceSurface
    among : pcontact.contact.search.partners.TargetSearch or ObstacleSearch
        Says who the partner of a point is.
    radius : float
        How far partners are looked for [length].
    chords : pcontact.contact.surface.smooth_geometry.Chords, optional
        What straight facets do to the gap.

    Attributes
    ----------
    normals : ndarray (np, d)
        Outward normals of the source by which partners are looked for: those of the undeformed one.
    origin : ndarray (d,)
        To which places of points are relative, so that they lose no digits [length].
    rounding : float
        Rounding errors that a gap may carry [length].
    offset : float or ndarray (np,)
        What the last search has added to gaps for those that the undeformed bodies are given, see
        :class:`InitialGap` [length].
    """

    def __init__(self, space, contact, source, among, radius, chords=None):
        self._space, self._source, self.among, self.radius, self.chords = space, source, among, radius, chords
        self.normals, self._initial, self.offset = source.normal, initial_gap(contact), 0.0
        low, high = bounding_box(space.comm, space.points)
        # of few digits, so that subtracting it rounds nothing
        self.origin = (0.5 * (low + high)).astype(np.float32).astype(float)
        self.rounding = np.finfo(float).eps * (4.0 * np.max(np.abs([low, high])) + 64.0 * np.max(high - low))

    @property
    def target(self):
        """Target surface or obstacle."""
        return self.among.target

    def interpolated(self, nodal):
        """Values (np, d) at the points of a field of the nodes (n_local, d)."""
        source = self._source
        values = np.empty_like(source.x)
        interpolate(nodal, source.cells, source.facet, source.shape, values)
        return values

    def deformed(self, nodal):
        """Points (np, d) under displacements (n_local, d), relative to the origin: no digits are lost."""
        space = self._space
        # the geometry is of the degree of the displacement at most, which interpolates it
        if space.mesh.curved and space.degree == 1:
            return (self._source.x - self.origin) + self.interpolated(nodal)
        return self.interpolated(space.points - self.origin + nodal)

    def turn(self, nodal):
        """Take the normals of the source under displacements (n_local, d): those of the undeformed one stay."""

    def find(self, u, time, radius=None):
        """Partners of the points among the bodies at ``u``, and obstacles at a time, within the radius or another one.
        *Collective.*

        Returns
        -------
        pcontact.contact.search.partners.Partners
            With the gap between the surfaces that the facets stand for, if they are to be told apart, and with what is
            added for the gap that the undeformed bodies are given.
        """
        found = self._found(u, time, radius)
        if self._initial is None:
            return found
        self.offset = self._initial.offset(time)
        return found._replace(gap=found.gap + self.offset)

    def _found(self, u, time, radius=None):
        nodal = self._space.local.gather(u)
        self.turn(nodal)
        radius = self.radius if radius is None else radius
        found = self.among.find(nodal, self.deformed(nodal), self.normals, time, radius, self.origin)
        gap = found.gap
        if self.chords is not None:
            gap = self.chords(gap, found.normal, found.paired, found.offset)
        # surfaces that touch are closed in the first tangent, whatever the rounding of their coordinates says
        return found._replace(gap=np.where(found.paired & (np.abs(gap) > self.rounding), gap, 0.0))

    def measure(self, u, time):
        """Take the gap between the undeformed bodies, from which the first load step begins at ``u``, with an obstacle
        where it is before it moves, at a time; once. *Collective.*"""
        if self._initial is not None and not self._initial.known:
            found = self._found(u, time)
            self._initial.take(found.gap, found.paired)


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
        """Return True if the gap between the undeformed bodies is known."""
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
        """Addend of gaps (np,) at a time [length]."""
        if self._table is None:
            return self._base
        times, factors = np.transpose(self._table)
        return self._base + (np.interp(time, times, factors) - 1.0) * self._overlap


def initial_gap(contact):
    """The :class:`InitialGap` of a contact; None where the bodies are as they are in the mesh."""
    said = contact.clearance is not None or contact.interference_amplitude is not None
    return InitialGap(contact) if said or contact.interference == "adjust" else None
