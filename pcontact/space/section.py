"""Sections across bolts, whose two sides are drawn together by a force or a length.

The nodes of both sides are pairs in the same place. The sides move alike but for a shortening s along the normal n,
u+ = u- - s n: all of the components of one side follow the other. Where a force F draws, s is free: one component of
one node of the upper side leads, s = -(u+ - u-)_i / n_i, and F does the work F s. Else s is prescribed, or stays.
"""

import numpy as np

from pcontact.mesh.section import OTHER, plane
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI

# [-] Part of a normal along a prescribed direction that counts as none. From: far above rounding errors.
ACROSS = 1e-6
# [extents of the section] Nodes nearer than that are a pair. From: far above what files round, below sizes of cells.
NEAR = 1e-6


class PretensionSection:
    """The two sides of a section; in the place of a :class:`pcontact.space.rigid.RigidGroup`.

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
        sides = [self._side(name, fixed) for name in (pretension.region, OTHER.format(pretension.region))]
        self.nodes = np.unique(np.concatenate([space.region(pretension.region),
                                               space.region(OTHER.format(pretension.region))]))  # fmt: skip
        (lower, below, held), (upper, above, holds) = sides
        _, self.normal, _ = plane(below)
        # pairs: nodes of one side in the order of those of the other, along a direction in which no two coincide
        order = [np.argsort(points @ np.sqrt([2.0, 3.0, 5.0][: space.dim])) for points in (below, above)]
        lower, below, held = (one[order[0]] for one in (lower, below, held))
        upper, above, holds = (one[order[1]] for one in (upper, above, holds))
        agree(space.comm, self._conflict((below, above), (held, holds), where))
        self.count, d = len(upper), space.dim
        mine = (upper >= space.start) & (upper < space.start + space.n_owned)
        self._rows, self._twins, self._follows = upper[mine] - space.start, lower[mine], ~holds[mine]
        needed, self._column = np.unique(self._twins, return_inverse=True)
        self._exchange = space.exchange(needed)
        # the pair and the direction that say how far the sides have parted
        self._axis = int(np.argmax(np.round(np.abs(self.normal), 6)))
        self._pair = int(upper[0]) * d + self._axis, int(lower[0]) * d + self._axis
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

    def _side(self, name, fixed):
        """Global numbers (n,), places (n, d) and prescribed components (n, d) of all nodes of a side. *Collective.*"""
        space = self._space
        nodes = space.region(name)
        numbers = space.nodes[nodes]
        own = (numbers >= space.start) & (numbers < space.start + space.n_owned)
        parts = space.comm.allgather((numbers[own], space.points[nodes[own]], fixed[nodes[own]]))
        return tuple(np.concatenate(one) for one in zip(*parts, strict=True))

    def _conflict(self, points, held, where):
        """What is wrong with the two sides, or None."""
        extent = float(np.ptp(points[0], axis=0).max())
        if points[0].shape != points[1].shape or np.abs(points[0] - points[1]).max() > NEAR * extent:
            return f"{where[0]}: {where[1]}.region: found a section without pairs of nodes; allowed: facets in a body"
        if not np.array_equal(held[0], held[1]) or (held[0] & (np.abs(self.normal) > ACROSS)).any():
            return (f"{where[0]}: {where[1]}.region: found a section with nodes whose displacement along its normal is "
                    "prescribed, or that of one side; allowed: supports across the normal")  # fmt: skip
        return None

    # -- entries for the matrix -----------------------------------------------------------------------------------

    def ways(self):
        """Rows, columns and values of what follows on this rank: rows of owned components, columns global."""
        d = self._space.dim
        row, column = (nodes[:, None] * d + np.arange(d) for nodes in (self._rows, self._twins))
        follows = self._follows.ravel()
        row, column = row.ravel()[follows], column.ravel()[follows]
        if not self.free:
            return row, column, np.ones(len(row))
        parts = np.tile(self.normal / self.normal[self._axis], len(self._rows))[follows]
        leads = row + self._space.start * d == self._pair[0]
        some = (parts != 0.0) & ~leads
        rows = np.concatenate([row, row[some], row[some]])
        columns = np.concatenate([np.where(leads, self._pair[0], column), np.full(some.sum(), self._pair[0]),
                                  np.full(some.sum(), self._pair[1])])  # fmt: skip
        return rows, columns, np.concatenate([np.ones(len(row)), parts[some], -parts[some]])

    def followers(self):
        """Owned components (n,) that follow, the one that leads among them."""
        d = self._space.dim
        return (self._rows[:, None] * d + np.arange(d))[self._follows]

    @property
    def leading(self):
        """Global numbers of leading components of the upper side."""
        return np.array(self._pair[:1] if self.free else (), dtype=np.int64)

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

    def _move(self, u, shortening):
        """Let the upper side be where the lower one and a shortening have it. *Collective.*"""
        vector = self._space.vector()
        vector.setArray(u.ravel())
        below = self._exchange.gather(vector)[self._column]
        u[self._rows] = np.where(self._follows, below - shortening * self.normal, u[self._rows])

    def bring(self, u, fresh):
        """A section does not say where nodes are that are there from now on."""
        return False

    def enter(self, u, time):
        """Let the sides be as far from each other as a displacement (n_owned, d) and what is prescribed have it.
        *Collective.*"""
        keeps = self.free or self._locked
        self._move(u, self._shortened(u) if keeps else self._amplitude.factor(time) * self._shortening)

    def follow(self, y):
        """Let one side go along with the other in a step (n_owned, d). *Collective.*"""
        self._move(y, self._shortened(y) if self.free else 0.0)

    # -- forces -----------------------------------------------------------------------------------------------------

    def lead(self, f):
        """Take forces (n_owned, d) on the upper side to the lower one, and to what leads. *Collective.*"""
        space, own = self._space, np.where(self._follows, f[self._rows], 0.0)
        total = space.comm.allreduce(float((own @ self.normal).sum()), op=MPI.SUM)
        values = np.zeros((self._column.max(initial=-1) + 1, space.dim))
        values[self._column] = own
        vector = space.vector()
        self._exchange.add(values, vector)
        f[self._rows] -= own
        f += vector.getArray(readonly=True).reshape(f.shape)
        if self.free:
            first, flat = space.start * space.dim, f.reshape(-1)
            for number, sign in zip(self._pair, (1.0, -1.0), strict=True):
                if first <= number < first + f.size:
                    flat[number - first] += sign * total / self.normal[self._axis]

    def hold(self, modes):
        """A section holds no body to the ground."""
        return np.zeros((self._space.mesh.n_components, len(modes), len(modes)))

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
