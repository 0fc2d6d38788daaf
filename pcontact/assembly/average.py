"""A group whose mean motion is prescribed: a coupling on average, which leaves the group free to deform.

The motion of the reference point is that of `pcontact.assembly.coupling`, linear in the displacement of the group, and
each of its prescribed components is an equation, sum(w_k u_k) = value (`pcontact.space.constraints`). What holds them
is a force and a moment, spread over the group as a load on its point is.
"""

import numpy as np

from pcontact.assembly.coupling import Average, turned
from pcontact.assembly.patches import group_patches
from pcontact.runtime.messages import input_error
from pcontact.runtime.petsc import MPI
from pcontact.space.constraints import moved
from pcontact.space.turn import moments

# [nodes] Largest group. From: an equation couples all its nodes with each other, in space 430 MB of the matrix.
MOST = 2000


class AverageCoupling:
    """A coupling on average.

    Parameters
    ----------
    space : pcontact.space.space.Space
    coupling : pcontact.scene.model.Coupling
    amplitude : pcontact.scene.amplitude.Amplitude
    fixed : ndarray (n_local, d) of bool
        Components that supports prescribe.
    where : (str, str)
        Scene and key path, for messages.

    Attributes
    ----------
    name : str
    nodes : ndarray (n,)
        Local nodes.
    point : ndarray (d,)
    values : ndarray (m,)
        Of the prescribed components of displacement and rotation at factor 1 [length, radian].
    rows : list of dict of int to float
        The weights of each in the displacement, by the global number of the component; the same on all ranks.

    Raises
    ------
    InputError
        On every rank: the group is too large, or turns about no axis of which the rotation is prescribed.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, coupling, amplitude, fixed, where):
        self._space, self.amplitude, d = space, amplitude, space.dim
        self.name, self.nodes = coupling.name or coupling.region, space.region(coupling.region)
        self.region = coupling.region
        numbers, own = space.nodes[self.nodes], space.owns(self.nodes)
        self._rows, self._held = numbers[own] - space.start, fixed[self.nodes[own]]
        count = space.comm.allreduce(int(own.sum()))
        if count > MOST:
            found = f"{coupling.region!r} on average, a group of {count} nodes"
            raise input_error(where[0], f"{where[1]}.region", found, f"groups of at most {MOST} nodes, or a rigid one")
        self._average = Average(space, group_patches(space, coupling.region))
        centre = self._average.centre
        self.point = centre if coupling.point is None else np.asarray(coupling.point, dtype=float)
        wanted = [*(coupling.displacement or ["free"] * d)]
        wanted += coupling.rotation if isinstance(coupling.rotation, tuple) else [coupling.rotation]
        wanted += [None] * (d + (1 if d == 2 else 3) - len(wanted))
        some = [k for k, one in enumerate(wanted) if one not in (None, "free")]
        self.values = np.array([float(wanted[k]) for k in some])
        self.rows = [self._row(k, where) for k in some]

    def _row(self, k, where):
        """The weights of a component of the motion: by duality, the nodal forces of a force or a moment of 1."""
        space, d = self._space, self._space.dim
        force, moment = np.zeros(d), np.zeros(1 if d == 2 else 3)
        if k < d:
            force[k] = 1.0
            moment += np.atleast_1d(moments((self.point - self._average.centre)[None], force[None]))
        else:
            moment[k - d] = 1.0
        if moment.any() and not self._average.bears(moment):
            key, found = ("rotation", "a rotation") if k >= d else ("point", "a point off the group")
            allowed = "a group that turns about all axes: of facets, or of nodes not in a line"
            raise input_error(where[0], f"{where[1]}.{key}", found, allowed)
        weights = self._average.forces(force, moment if d == 3 else float(moment[0])).ravel()
        at = np.flatnonzero(weights)
        parts = space.comm.allgather((at + space.start * d, weights[at]))
        return {int(c): float(w) for components, values in parts for c, w in zip(components, values, strict=True)}

    def held_by(self, unbalanced):
        """Force (d,) on the group, and moment about its centre, that hold its prescribed components, as a density:
        a function of points. *Collective.*"""
        space, average = self._space, self._average
        forces = np.where(self._held, 0.0, unbalanced[self._rows])
        arms = space.points[space.owned_local[self._rows]] - average.centre
        own = np.concatenate([forces.sum(axis=0), np.atleast_1d(moments(arms, forces))])
        sums = space.comm.allreduce(own, op=MPI.SUM)
        force, moment = sums[: space.dim], sums[space.dim :] if space.dim == 3 else float(sums[space.dim])
        return lambda points: average.density(points, force, moment)

    def record(self, u, unbalanced):
        """Motion of the point, and what holds its prescribed components, for the report. *Collective.*

        Parameters
        ----------
        u, unbalanced : ndarray (n_owned, d)
            Displacement; internal plus contact minus external forces.
        """
        space = self._space
        vector = space.vector()
        vector.setArray(u.ravel())
        mean, rotation = self._average.motion(vector)
        mean = mean + turned(rotation, (self.point - self._average.centre)[None])[0]
        forces = np.where(self._held, 0.0, unbalanced[self._rows])
        return moved(space, self.point, (mean, rotation), self._rows, forces)
