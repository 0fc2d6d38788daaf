"""Averages over a group: the reference point that a total force and moment act on.

Over a group with the measure A (area, volume, number of nodes), centroid c, r = x - c and the inertia
J = int (|r|^2 I - r (x) r), in the plane int |r|^2, a force F at a point p and a moment M are spread as the density

    f(x) = F / A + w x r,    J w = M + (p - c) x F,

and do the work of F and M on the mean motion of the group

    rotation  q = J^-1 int r x u,    displacement of p  U = int u / A + q x (p - c).

A group whose mean motion is prescribed: a coupling on average, which leaves the group free to deform.

The motion of the reference point is that of `pcontact.assembly.coupling`, linear in the displacement of the group, and
each of its prescribed components is an equation, sum(w_k u_k) = value (`pcontact.space.constraints`). What holds them
is a force and a moment, spread over the group as a load on its point is.
"""

import numpy as np

from pcontact.assembly.patches import group_patches, node_patches
from pcontact.mesh.mesh import size_of
from pcontact.runtime.errors import coordinates, input_error
from pcontact.space.constraints import moved, resultant
from pcontact.space.supports import moments

# [-] Least part of the largest inertia that turns about an axis at all. From: far above rounding errors, far below what
# a group that is no line has.
LINE = 1e-9
# [sizes of the mesh] Distance of a node from where the scene says it is. From: what writing coordinates with seven
# digits leaves.
NEAR = 1e-6
# [sizes of the mesh] Difference of distances that does not say which of two nodes is nearer. From: rounding errors.
ALIKE = 1e-12


def turned(rotation, arms):
    """rotation x arms (n, d): a number in the plane, (3,) in space."""
    if arms.shape[1] == 3:
        return np.cross(rotation, arms)
    return rotation * np.column_stack([-arms[:, 1], arms[:, 0]])


class Average:
    """Mean motion of a group, and what forces on it do to its nodes.

    Parameters
    ----------
    space : pcontact.space.space.Space
    patches : list of pcontact.assembly.patches.Patch

    Attributes
    ----------
    measure : float
        Area, volume or number of nodes; with axial symmetry of the whole circumference.
    centre : ndarray (d,)
        [length]

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, patches):
        self.space, d = space, space.dim
        weights, arms = np.zeros(space.n_local), np.zeros((space.n_local, d))
        sums = np.zeros(1 + d)
        for patch in patches:
            sums += [patch.weight.sum(), *np.einsum("nq,nqd->d", patch.weight, patch.points)]
        sums = space.comm.allreduce(sums)
        self.measure, self.centre = float(sums[0]), sums[1:] / sums[0]
        spread = np.zeros((d, d))
        for patch in patches:
            r = patch.points - self.centre
            spread += np.einsum("nq,nqi,nqj->ij", patch.weight, r, r)
            np.add.at(weights, patch.nodes, np.einsum("nq,nqa->na", patch.weight, patch.shape))
            np.add.at(arms, patch.nodes, patch.forces(r))
        spread = space.comm.allreduce(spread)
        self._inertia = np.atleast_2d(np.trace(spread)) if d == 2 else np.trace(spread) * np.eye(3) - spread
        some = np.flatnonzero((weights != 0.0) | arms.any(axis=1))
        # of the local nodes, whose shares of other ranks are added where they are owned
        self._nodes, self._weights, self._arms = some, weights[some], arms[some]
        values, self._axes = np.linalg.eigh(self._inertia)
        turns = values > LINE * max(float(values[-1]), np.finfo(float).tiny)
        self._inverse = np.where(turns & (values[-1] > 0.0), 1.0 / np.where(turns, values, 1.0), 0.0)

    @property
    def turns(self):
        """Return whether the group turns about every axis: it is neither a point nor a line."""
        return bool(self._inverse.all())

    def _spin(self, moment):
        """J^-1 times a moment, a number in the plane; zero about axes that the group does not turn about."""
        result = self._axes @ (self._inverse * (self._axes.T @ np.atleast_1d(moment)))
        return result if self.space.dim == 3 else float(result[0])

    def bears(self, moment):
        """Return whether forces on the group can have a moment about its centre."""
        moment = np.atleast_1d(moment)
        left = moment - self._inertia @ np.atleast_1d(self._spin(moment))
        return bool(np.linalg.norm(left) <= LINE * np.linalg.norm(moment))

    def forces(self, force, moment):
        """Nodal forces (n_owned, d) of a force (d,) at the centre and a moment about it. *Collective.*"""
        local = np.zeros((self.space.n_local, self.space.dim))
        local[self._nodes] = np.outer(self._weights, force) / self.measure + turned(self._spin(moment), self._arms)
        return self.space.summed(self.space.local, local)

    def density(self, points, force, moment):
        """Return a force (d,) at the centre and a moment about it per measure, at points (..., d)."""
        arms = points.reshape(-1, points.shape[-1]) - self.centre
        return (force / self.measure + turned(self._spin(moment), arms)).reshape(points.shape)

    def motion(self, u):
        """Mean displacement (d,) [length] and rotation [radian] at a displacement. *Collective.*"""
        nodal = self.space.local.gather(u)[self._nodes]
        own = [*(self._weights @ nodal), *np.atleast_1d(moments(self._arms, nodal))]
        sums = self.space.comm.allreduce(np.array(own))
        return sums[: self.space.dim] / self.measure, self._spin(sums[self.space.dim :])


class TotalLoad:
    """A total force and moment on a group, with the mean motion of the point that they act on.

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
    number : int
        Of the load in the scene.
    amplitude : pcontact.scene.amplitude.Amplitude
    where : (str, str)
        Scene and key path of the load, for messages.

    Attributes
    ----------
    name : str
    vector : ndarray (n_owned, d)
        Nodal forces at factor 1 [force].
    amplitude : pcontact.scene.amplitude.Amplitude

    Raises
    ------
    InputError
        On every rank: no node is near enough, or the group cannot bear the moment.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, load, number, amplitude, where):
        self.amplitude, self.name = amplitude, load.name or load.region or f"loads[{number}]"
        patches = group_patches(space, load.region) if load.at is None else _node_at(space, load, where)
        self.average, d = Average(space, patches), space.dim
        self._force = np.zeros(d) if load.force is None else np.asarray(load.force, dtype=float)
        self._moment = np.zeros(3 if d == 3 else 1) if load.moment is None else np.atleast_1d(load.moment).astype(float)
        self._arm = np.zeros(d) if load.point is None else np.asarray(load.point, dtype=float) - self.average.centre
        about = self._moment + np.atleast_1d(moments(self._arm[None], self._force[None]))
        if about.any() and not self.average.bears(about):
            key = "moment" if load.moment is not None else "point"
            found = f"a moment on {load.region!r}, whose nodes are {_said(self.average)}"
            raise input_error(where[0], f"{where[1]}.{key}", found, "a group of facets, or nodes not in a line")
        self._about = about if d == 3 else float(about[0])
        self.vector = self.average.forces(self._force, self._about)

    def density(self, points):
        """Force per measure at points (..., d) at factor 1."""
        return self.average.density(points, self._force, self._about)

    def record(self, u, time):
        """Force, moment about the point, displacement and rotation of the point, for the report. *Collective.*"""
        factor, (mean, rotation) = float(self.amplitude.factor(time)), self.average.motion(u)
        result = {"force": (factor * self._force).tolist()}
        if not self.average.turns:
            return {**result, "displacement": mean.tolist()}
        moment = factor * self._moment
        mean = mean + turned(rotation, self._arm[None])[0]
        return {
            **result, "moment": moment.tolist() if len(moment) == 3 else float(moment[0]),
            "displacement": mean.tolist(), "rotation": rotation if len(moment) == 1 else rotation.tolist(),
        }  # fmt: skip


def _said(average):
    return "in a line" if average.space.dim == 3 and np.count_nonzero(average._inverse) else "in one place"


def _node_at(space, load, where):
    """The node that a force acts at. *Collective.*"""
    own = space.owned_local
    if load.region is not None:
        own = own[np.isin(own, space.region(load.region))]
    size = size_of(space.mesh)
    distance = np.linalg.norm(space.points[own] - np.asarray(load.at, dtype=float), axis=1)
    nearest = own[np.argsort(distance, kind="stable")[:2]]
    names, keys = space.mesh.component_names, space.mesh.file_nodes[space.mesh_nodes[nearest]]
    rows = [(float(np.linalg.norm(space.points[k] - load.at)), int(key), tuple(space.points[k].tolist()),
             names[space.component[k]]) for k, key in zip(nearest, keys, strict=True)]  # fmt: skip
    found = sorted(row for rows in space.comm.allgather(rows) for row in rows)
    within = NEAR * size if load.within is None else load.within
    file, key = where
    if found[0][0] > within:
        place = coordinates(found[0][2])
        said = f"{list(load.at)}, from which the nearest node, at {place}, is {found[0][0]:.4g} away"
        raise input_error(file, f"{key}.at", said, f"a place within {within:.4g} of a node (within)")
    if len(found) > 1 and found[1][0] - found[0][0] <= ALIKE * size:
        bodies = " and ".join(dict.fromkeys((found[0][3], found[1][3])))
        said = f"{list(load.at)}, from which two nodes are equally far away, of {bodies}"
        raise input_error(file, f"{key}.at", said, "a place that says which; or region, a group with one of them only")
    node = own[space.mesh.file_nodes[space.mesh_nodes[own]] == found[0][1]]
    return list(node_patches(space, node))


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
        at, keys = np.flatnonzero(weights), space.keys
        parts = zip(*space.comm.allgather((keys[at // d], at + space.start * d, weights[at])), strict=True)
        order, components, values = (np.concatenate(one) for one in parts)
        # what follows the others is one of the first: the same on any ranks
        by = np.argsort(order, kind="stable")
        return dict(zip(components[by].tolist(), values[by].tolist(), strict=True))

    def held_by(self, unbalanced):
        """Force (d,) on the group, and moment about its centre, that hold its prescribed components, as a density:
        a function of points. *Collective.*"""
        space, average = self._space, self._average
        forces = np.where(self._held, 0.0, unbalanced[self._rows])
        force, moment = resultant(space, average.centre, self._rows, forces)
        return lambda points: average.density(points, force, moment)

    def record(self, u, unbalanced):
        """Motion of the point, and what holds its prescribed components, for the report. *Collective.*

        Parameters
        ----------
        u, unbalanced : ndarray (n_owned, d)
            Displacement; internal plus contact minus external forces.
        """
        space = self._space
        mean, rotation = self._average.motion(space.vector(u))
        mean = mean + turned(rotation, (self.point - self._average.centre)[None])[0]
        forces = np.where(self._held, 0.0, unbalanced[self._rows])
        return moved(space, self.point, (mean, rotation), self._rows, forces)
