"""Sections across bolts, whose two sides are drawn together by a force or a length.

The nodes of both sides are pairs in the same place. The sides move alike but for a shortening s along the normal n,
u+ = u- - s n: all of the components of one side follow the other. Where a force F draws, s is free: one component of
one node of the upper side leads, s = -(u+ - u-)_i / n_i, and F does the work F s. Else s is prescribed, or stays.
"""

import numpy as np

from pcontact.mesh.topology import OTHER, plane
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI
from pcontact.space.constraints import Constraint, gathered

# [-] Part of a normal along a prescribed direction that counts as none. From: far above rounding errors.
ACROSS = 1e-6
# [extents of the section] Nodes nearer than that are a pair. From: far above what files round, below sizes of cells.
NEAR = 1e-6


class PretensionSection(Constraint):
    """The two sides of a section.

    Parameters
    ----------
    space : pcontact.space.space.Space
    pretension : pcontact.scene.model.Pretension
    amplitude : pcontact.scene.amplitude.Amplitude
    fixed : ndarray (n_local, d) of bool
        Components that supports prescribe, and nodes of rigid groups.
    where : (str, str)
        Scene and key path, for messages.

    Attributes
    ----------
    name : str
    nodes : ndarray (n,)
        Local nodes of both sides.
    free : bool
        Whether a force draws.
    vector : ndarray (n_owned, d)
        Nodal forces at factor 1 of a force; zero without.

    Raises
    ------
    InputError
        On every rank: a component is prescribed on one side alone, or along the normal.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, pretension, amplitude, fixed, where):
        self._space, self._amplitude = space, amplitude
        self.name = pretension.name or pretension.region
        self.free = pretension.force is not None and not pretension.locked
        self._locked, self._shortening = pretension.locked, pretension.shortening or 0.0
        names = pretension.region, OTHER.format(pretension.region)
        self.nodes = np.unique(np.concatenate([space.region(name) for name in names]))
        sides = [gathered(space, name, fixed) for name in names]
        (lower, below, held), (upper, above, holds) = sides
        _, self.normal, _ = plane(below)
        # pairs: nodes of one side in the order of those of the other, along a direction in which no two coincide
        order = [np.argsort(points @ np.sqrt([2.0, 3.0, 5.0][: space.dim])) for points in (below, above)]
        lower, below, held = (one[order[0]] for one in (lower, below, held))
        upper, above, holds = (one[order[1]] for one in (upper, above, holds))
        agree(space.comm, self._conflict((below, above), (held, holds), where))
        self.count, d = len(upper), space.dim
        mine = (upper >= space.start) & (upper < space.start + space.n_owned)
        self._rows, follows = upper[mine] - space.start, ~holds[mine].ravel()
        # the pair and the direction that say how far the sides have parted
        self._axis = int(np.argmax(np.round(np.abs(self.normal), 6)))
        self._pair = int(upper[0]) * d + self._axis, int(lower[0]) * d + self._axis
        self.leading = np.array(self._pair[:1] if self.free else (), dtype=np.int64)
        at, twins = ((nodes[:, None] * d + np.arange(d)).ravel()[follows] for nodes in (self._rows, lower[mine]))
        self._across = np.tile(self.normal, len(self._rows))[follows]
        self._set(at, *self._entries(at + space.start * d, twins))
        self._below = lower[(lower >= space.start) & (lower < space.start + space.n_owned)] - space.start
        self.vector = self.drawing(pretension.force if self.free else 0.0)

    def drawing(self, tension):
        """Nodal forces (n_owned, d) that draw the sides together [force]."""
        vector, force = np.zeros((self._space.n_owned, self._space.dim)), tension / self.count * self.normal
        vector[self._rows], vector[self._below] = -force, force
        return vector

    def at(self, time):
        """Nodal forces (n_owned, d) of its own force at a time [force]."""
        return self._amplitude.factor(time) * self.vector

    def tension(self, borne):
        """That of forces (n_owned, d) which the section exerts [force]. *Collective.*"""
        return -self._space.comm.allreduce(float((borne[self._rows] @ self.normal).sum()), op=MPI.SUM)

    @property
    def force(self):
        """Nodal forces at factor 1 with their amplitude."""
        return self.vector, self._amplitude

    def _conflict(self, points, held, where):
        """What is wrong with the two sides, or None."""
        extent = float(np.ptp(points[0], axis=0).max())
        if points[0].shape != points[1].shape or np.abs(points[0] - points[1]).max() > NEAR * extent:
            return f"{where[0]}: {where[1]}.region: found a section without pairs of nodes; allowed: facets in a body"
        if not np.array_equal(held[0], held[1]) or (held[0] & (np.abs(self.normal) > ACROSS)).any():
            return (f"{where[0]}: {where[1]}.region: found a section with nodes whose displacement along its normal is "
                    "prescribed, or that of one side; allowed: supports across the normal")  # fmt: skip
        return None

    def _entries(self, numbers, twins):
        """Entries of W, see :meth:`pcontact.space.constraints.Constraint._set`: where a force draws, the component that
        leads and its twin say how far the others are from theirs."""
        row = np.arange(len(numbers))
        if not self.free:
            return row, twins, np.ones(len(row))
        leads, parts = numbers == self._pair[0], self._across / self.normal[self._axis]
        some = np.flatnonzero((parts != 0.0) & ~leads)
        columns = [np.where(leads, numbers, twins), *(np.full(len(some), number) for number in self._pair)]
        return (np.concatenate([row, some, some]), np.concatenate(columns),
                np.concatenate([np.ones(len(row)), parts[some], -parts[some]]))  # fmt: skip

    # -- displacements ----------------------------------------------------------------------------------------------

    def _owned(self, values, number):
        """A component of owned nodes (n_owned, d) by its global number, on all ranks. *Collective.*"""
        first = self._space.start * self._space.dim
        own = values.reshape(-1)[number - first] if first <= number < first + values.size else 0.0
        return self._space.comm.allreduce(float(own), op=MPI.SUM)

    def _shortened(self, u):
        """Shortening s in a displacement (n_owned, d) [length]. *Collective.*"""
        apart = self._owned(u, self._pair[0]) - self._owned(u, self._pair[1])
        return -apart / self.normal[self._axis]

    def given(self, u, time):
        """What is given of the components of the upper side, in a displacement (n_owned, d). *Collective.*"""
        if self.free:
            return 0.0
        kept = self._shortened(u) if self._locked else self._amplitude.factor(time) * self._shortening
        return -kept * self._across

    def record(self, u, forces, time):
        """Tension and shortening, for the report. *Collective.*

        Parameters
        ----------
        u, forces : ndarray (n_owned, d)
            Displacement; internal plus contact minus external forces, the section's own force among the latter, and
            none that draws it beside that.
        time : float
        """
        return {"force": self.tension(forces + self.at(time)), "shortening": self._shortened(u)}
