"""Unbiased contact: both surfaces are source and target, half and half (Chouly, Mlika, Renard 2017).

A pair of bodies has two halves: the points of each surface look for partners on the other, and all integrals of a
half, those of the theta terms too, have the weight 1/2. Each half has the tractions, normals, gaps and the gamma of its
own source; forces balance since every half acts on the jump. Self contact has one half: all points of the surface look
for partners on it, so that both of two places that touch have theirs.

With weight 1/2 the residual is monotone for gamma > (1 + theta)^2 / 8 times the constant of the trace inequality, half
of what contact with a source and a target needs; the default gamma0 is half as large, too.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcontact.assembly.pattern import JoinedPattern
from pcontact.contact.parameters import parameter
from pcontact.contact.smooth_geometry import facet_error
from pcontact.contact.summary import summarise
from pcontact.runtime.petsc import MPI

WEIGHT = 0.5
# what the halves are called in a checkpoint
SIDES = ("source", "target")


def is_unbiased(contact):
    """Whether a contact is made of halves: it says so, or it is self contact."""
    return contact.unbiased or contact.target == contact.source


def halved(source):
    """A source surface (SourceSurface) whose quadrature weights are halved, and with them all terms."""
    return replace(source, jxw=WEIGHT * source.jxw)


def contacts_of_halves(contact):
    """The contacts (one or two) that make up an unbiased one: from each surface to the other.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    """
    gamma0 = contact.gamma0
    if gamma0 is None and contact.formulation in (None, "nitsche"):
        gamma0 = WEIGHT * parameter(contact)
    forth = replace(contact, gamma0=gamma0)
    if contact.source == contact.target:
        return [forth]
    return [forth, replace(forth, source=contact.target, target=contact.source)]


@dataclass
class BothSides:
    """What observers need to know of the sources of all halves.

    Attributes
    ----------
    cells : ndarray (nf,)
        One entry for each facet: its global number.
    size : ndarray (nf,)
        Diameter of the facets [length].
    facet : ndarray (np,)
        Facet of each point.
    jxw : ndarray (np,)
        Area of the points.
    x, normal : ndarray (np, d)
        Reference position [length] and outward unit normal of the points.
    """

    cells: np.ndarray
    size: np.ndarray
    facet: np.ndarray
    jxw: np.ndarray
    x: np.ndarray
    normal: np.ndarray

    @classmethod
    def of(cls, halves):
        """Join the sources of some items."""
        sources = [half.source for half in halves]
        first = np.cumsum([0, *(len(source.cells) for source in sources)])[:-1]
        facet = np.concatenate([source.facet + n for source, n in zip(sources, first, strict=True)])

        def joined(key):
            return np.concatenate([getattr(source, key) for source in sources])

        return cls(
            joined("facet_ids"), joined("size"), facet, joined("jxw") / WEIGHT, joined("x"), joined("normal")
        )


class UnbiasedItem:
    """The halves of an unbiased contact pair, or the one half of self contact, as one item.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        As the scene has it.
    halves : list of ContactItem
        Of :func:`contacts_of_halves`, with :func:`halved` sources.

    Attributes
    ----------
    surfaces : tuple of str
        Facet groups of the sources of the halves.
    """

    changes, rigid = True, False

    def __init__(self, contact, halves):
        first = halves[0]
        self.contact, self.halves = contact, halves
        self.name, self.space, self.theta, self.gamma0 = first.name, first.space, first.theta, first.gamma0
        self.radius, self.floats = first.radius, any(half.floats for half in halves)
        self.surfaces = tuple(half.contact.source for half in halves)
        self.source = BothSides.of(halves)
        self.gamma = np.concatenate([half.gamma for half in halves])
        traces = [half.plastic for half in halves if half.plastic is not None]
        self.plastic = traces or None
        self._versions = None

    @property
    def version(self):
        """Grows when the pattern changes."""
        return sum(half.version for half in self.halves)

    @property
    def candidates(self):
        """Facets that the searches of this rank tried."""
        return sum(half.candidates for half in self.halves)

    @property
    def lost(self):
        """Points of this rank that have passed into their partner, and that have left it."""
        passed, left = zip(*(half.lost for half in self.halves), strict=True)
        return sum(passed), sum(left)

    @property
    def flips(self):
        """Points of this rank whose status changed in each Newton iteration."""
        return [sum(counts) for counts in zip(*(half.flips for half in self.halves), strict=True)]

    @property
    def closed(self):
        """Points (np,) that were closed at the end of the last load step."""
        return np.concatenate([half.closed for half in self.halves])

    # -- a load step: see `ContactItem`, whose methods these are ------------------------------------------------

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find the partners of the points of all halves. *Collective.*"""
        for half in self.halves:
            half.detect(u, time, motion, ahead)

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        versions = [half.version for half in self.halves]
        if versions != self._versions:
            self._joined = JoinedPattern([half.pattern() for half in self.halves], self.space.n_owned)
            self._versions = versions
        return self._joined.rowptr, self._joined.columns

    def residual(self, u, out):
        """Add the forces of all halves on the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        for half in self.halves:
            half.residual(u, out)

    def add_magnitude(self, u, out):
        """See :meth:`ContactItem.add_magnitude`. *Collective.*"""
        for half in self.halves:
            half.add_magnitude(u, out)

    def tangent(self, u):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        values = [half.tangent(u) for half in self.halves]
        self.pattern()
        return self._joined.sum(values)

    def commit(self, u, time):
        """End the load step. *Collective.*"""
        for half in self.halves:
            half.commit(u, time)

    def committed_areas(self):
        """Areas that were open, sticking, slipping at the end of the last load step: means of both sides."""
        return sum(half.committed_areas() for half in self.halves)

    def pulled(self, u):
        """Area that was closed and that ``u`` would open, the mean of both sides. *Collective.*"""
        return sum(half.pulled(u) for half in self.halves)

    def misled(self, before, u):
        """Area that supports alone open or close, the mean of both sides. *Collective.*"""
        return sum(half.misled(before, u) for half in self.halves)

    def defer(self, before, u):
        """See :meth:`ContactItem.defer`. *Collective.*"""
        return any([half.defer(before, u) for half in self.halves])

    def admit(self):
        """See :meth:`ContactItem.admit`."""
        for half in self.halves:
            half.admit()

    def glue(self, glued):
        """Keep points closed or open as they were at the end of the last load step; or let them go."""
        for half in self.halves:
            half.glue(glued)

    def reach(self, u, y):
        """See :meth:`ContactItem.reach`. *Collective.*"""
        parts = [half.reach(u, y) for half in self.halves]
        return min([part for part in parts if part is not None], default=None)

    def clearance(self, u, fields):
        """See :meth:`ContactItem.clearance`: of all halves. *Collective.*"""
        parts = [half.clearance(u, fields) for half in self.halves]
        return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))

    def strayed(self, u, since):
        """See :meth:`ContactItem.strayed`: of all halves. *Collective.*"""
        return max([half.strayed(u, since) for half in self.halves])

    def motion(self, u, before):
        """Largest motion of a point along its normal between two displacements [length]. *Collective.*"""
        return max([half.motion(u, before) for half in self.halves])

    @property
    def stiff(self):
        """Whether multigrid alone fares badly, see :attr:`ContactItem.stiff`."""
        return any(half.stiff for half in self.halves)

    def closed_area(self):
        """Area of the points of this rank that were closed in the last tangent [length^(d - 1)]."""
        return sum(half.closed_area() for half in self.halves)

    def active_nodes(self):
        """Owned nodes, global numbers, of the halves at points that were closed in the last tangent. *Collective.*"""
        return np.unique(np.concatenate([half.active_nodes() for half in self.halves]))

    # -- what remains of a load step ------------------------------------------------------------------------------

    def memory(self):
        """See :meth:`ContactItem.memory`: what the halves remember, under names that begin with their side."""
        return {
            f"{side}_{name}": table
            for side, half in zip(SIDES, self.halves, strict=False)
            for name, table in half.memory().items()
        }

    def memory_keys(self):
        """See :meth:`ContactItem.memory_keys`."""
        return np.concatenate([half.memory_keys() * len(SIDES) + side for side, half in enumerate(self.halves)])

    def recall(self, name, chunks):
        """See :meth:`ContactItem.recall`."""
        side, _, rest = name.partition("_")
        halves = dict(zip(SIDES, self.halves, strict=False))
        return halves[side].recall(rest, chunks) if side in halves else None

    def state(self, u):
        """Contact at the points of both surfaces, one after the other. *Collective.*

        Returns
        -------
        dict of str to ndarray
            As for `ContactItem`: ``traction`` acts on the body of the point, ``weight`` is the area of the point.
        """
        states = [half.state(u) for half in self.halves]
        state = {key: np.concatenate([one[key] for one in states]) for key in states[0]}
        return {**state, "weight": state["weight"] / WEIGHT}

    def summary(self, u):
        """Numbers of the pair for the report, the same on every rank. *Collective.*

        Force and area are the means of what the two sides say. Self contact has no sides: its force has in every
        direction the sum of the magnitudes, which is that between two places that touch where there are only two.
        """
        states = [half.state(u) for half in self.halves]
        if len(states) == 1:
            states[0]["traction"] = -np.abs(states[0]["traction"])
        else:
            states[1]["traction"] = -states[1]["traction"]
        joined = {key: np.concatenate([one[key] for one in states]) for key in states[0]}
        summary = summarise(joined, self.flips, self.lost, self.space.comm)
        summary |= facet_error(self.halves, states)
        return {**summary, "bodies": self._on_bodies(u)} if self.contact.all else summary

    def borne(self, u):
        """See :meth:`ContactItem.borne`: both sides together. *Collective.*"""
        return sum(half.borne(u) for half in self.halves)

    def touched(self):
        """See :meth:`ContactItem.touched`: both sides together. *Collective.*"""
        return sum(half.touched() for half in self.halves)

    def _on_bodies(self, u):
        """Force on every body that others touch, the same on every rank; they add up to zero. *Collective.*"""
        space, mesh = self.space, self.space.mesh
        nodal, table = np.zeros((space.n_owned, space.dim)), np.zeros((mesh.n_components, space.dim))
        self.residual(u, nodal)
        np.subtract.at(table, space.component[space.owned_local], nodal)
        table = space.comm.allreduce(table, op=MPI.SUM)
        touched = np.flatnonzero(np.any(table != 0.0, axis=1))
        return [{"number": int(k), "body": mesh.component_names[k], "force": table[k].tolist()} for k in touched]


class UnbiasedFrictionalItem(UnbiasedItem):
    """With friction."""

    def hold(self, held):
        """Let closed points stick whatever the law says, or give them back to it."""
        for half in self.halves:
            half.hold(held)
