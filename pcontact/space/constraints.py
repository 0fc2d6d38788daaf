"""Linear constraints u = W u_lead + g: components of the displacement that follow others, by one sparse W.

Newton's method does not have the components that follow: its matrix is P^T K P and its residual P^T f, P the identity
with the rows W of those that follow. A displacement that satisfies the constraints does the same work on P^T f as on f.
Sections across bolts, rigid groups and equations differ in the rows that they have and in g.

*Sections* have two sides, which are drawn together by a force or a length. The nodes of both sides are pairs in the
same place. The sides move alike but for a shortening s along the normal n, u+ = u- - s n: all of the components of one
side follow the other. Where a force F draws, s is free: one component of one node of the upper side leads, s = -(u+ -
u-)_i / n_i, and F does the work F s. Else s is prescribed, or stays.

Nodes of a *rigid group* have u = U + w x (X - point), small turns: all their components are linear in the m
components of the motion (U, w) that are not prescribed. As many components of the nodes themselves, far apart, are
*leading*; the others follow, u = W u_leading + what is prescribed.

An *equation* says sum(c_k u_k) = 0; of the numbers u_k some may be given, functions of time. One after the other
equations are solved for a component that no support prescribes, and that is put into all others (Gauss' elimination):
what is left are components that follow, u_i = sum(w_ij u_j) of components that do
not, prescribed ones among these. The forces that equations exert do no work, but for those with given numbers.
"""

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes, shape
from pcontact.mesh.topology import OTHER, plane
from pcontact.runtime.errors import InputError, coordinates
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI
from pcontact.space.modes import rigid_motions
from pcontact.space.supports import moments

# [-] Part of a normal along a prescribed direction that counts as none. From: far above rounding errors.
ACROSS = 1e-6
# [extents of the section] Nodes nearer than that are a pair. From: far above what files round, below sizes of cells.
PAIR_DISTANCE = 1e-6
# [-] Size of a group across the line through its farthest nodes, over that along it, below which it is a line. From:
# far above the rounding errors of coordinates, far below what is no line.
LINE = 1e-6
# [-] Part of the largest coefficient of an equation that counts as zero. From: far above rounding errors.
ZERO = 1e-12
# [-] Part of the largest coefficient from which the component that stands first may follow the others. From: chosen.
FIRST = 0.1
# [extents of a group] Distance of two nodes that are a pair. From: far above what files round, below sizes of cells.
PARTNER_DISTANCE = 1e-4
# nodes whose partners are looked for at a time
CHUNK = 512


class Constraint:
    """Components that follow others; kinds set the rows once, and say what is given.

    Attributes
    ----------
    leading : ndarray (m,)
        Global numbers of components that lead although they are among the rows, with 1 in their own.
    """

    leading = np.zeros(0, dtype=np.int64)

    def _set(self, at, row, column, weight, free=slice(None)):
        """Take the rows of what follows on this rank. *Collective.*

        Parameters
        ----------
        at : ndarray (n,)
            Owned components that follow.
        row, column, weight : ndarray (k,)
            Entries of W: which of `at`, global number of the component that leads, weight.
        free : ndarray (k,) of bool or slice
            Entries of components that no support prescribes.
        """
        d, self._at, self._row, self._column = self._space.dim, at, row, column
        self._weight, self._free = weight, free
        needed, node = np.unique(column // d, return_inverse=True)
        self._entry, self._count = node * d + column % d, len(needed) * d
        self._exchange = self._space.exchange(needed)

    def ways(self):
        """Rows, columns and values of W on this rank: rows of owned components, columns global."""
        return self._at[self._row[self._free]], self._column[self._free], self._weight[self._free]

    def followers(self):
        """Owned components (n,) that follow, those that lead among them."""
        return self._at

    def follow(self, y):
        """Let components follow in a step (n_owned, d). *Collective.*"""
        values = self._space.at_nodes(y, self._exchange).ravel()[self._entry]
        y.reshape(-1)[self._at] = np.bincount(self._row, self._weight * values, minlength=len(self._at))

    def lead(self, f):
        """Take forces (n_owned, d) on components that follow to the others. *Collective.*"""
        values = np.bincount(self._entry, self._weight * f.reshape(-1)[self._at][self._row], self._count)
        passed = self._space.summed(self._exchange, values.reshape(-1, self._space.dim))
        f.reshape(-1)[self._at] = 0.0
        f += passed

    def enter(self, u, time):
        """Let components be where a displacement (n_owned, d) and what is given at a time have them. *Collective.*"""
        given = self.given(u, time)
        self.follow(u)
        u.reshape(-1)[self._at] += given

    def bring(self, u, fresh):
        """Let nodes that are there from now on, flags (n_owned,), go along with the others in a displacement
        (n_owned, d). Whether others say where to. *Collective.*"""
        return False

    def hold(self, modes):
        """Return what rigid motions (n_modes, n_local, d) of the bodies do that is prescribed, on rank 0, see
        :func:`pcontact.space.modes.free_motions`. *Collective.*"""
        return np.zeros((self._space.mesh.n_components, len(modes), len(modes)))


def gathered(space, region, *more):
    """Global numbers (n,), places (n, d) and rows of more tables (n_local, ...) of all nodes of a region, on all ranks
    alike. *Collective.*"""
    nodes = space.region(region)
    own = nodes[space.owns(nodes)]
    parts = space.comm.allgather((space.nodes[own], space.points[own], *(table[own] for table in more)))
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))


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
        """Return what is wrong with the two sides, or None."""
        extent = float(np.ptp(points[0], axis=0).max())
        if points[0].shape != points[1].shape or np.abs(points[0] - points[1]).max() > PAIR_DISTANCE * extent:
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
        """Return what is given of the components of the upper side, in a displacement (n_owned, d). *Collective.*"""
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


def _chosen(rows):
    """The rows (m,) of a matrix (n, m) that are most independent, one after the other."""
    left, chosen = rows.copy(), []
    for _ in range(rows.shape[1]):
        k = int(np.argmax(np.round(np.linalg.norm(left, axis=1), 9)))
        chosen.append(k)
        way = left[k] / np.linalg.norm(left[k])
        left = left - np.outer(left @ way, way)
    return chosen


def moved(space, point, motion, rows, forces):
    """Motion of a reference point, and force and moment about it, for the report. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    point : ndarray (d,)
        [length]
    motion : (ndarray (d,), float or ndarray (3,))
        Displacement [length], and rotation [radian]: a number in the plane.
    rows : ndarray (k,)
        Owned nodes of the group, as rows of owned nodes.
    forces : ndarray (k, d)
        On the group, at these.

    Returns
    -------
    dict
    """
    (displacement, rotation), d = motion, space.dim
    force, moment = resultant(space, point, rows, forces)
    result = {"displacement": displacement.tolist(), "force": force.tolist()}
    if not space.axisymmetric:
        result["rotation"] = rotation if d == 2 else rotation.tolist()
        result["moment"] = moment if d == 2 else moment.tolist()
    return result


def resultant(space, point, rows, forces):
    """Sum (d,) of forces (k, d) at owned nodes (k,) of all ranks, and their moment about a point: a number in the
    plane. *Collective.*"""
    arms = space.points[space.owned_local[rows]] - point
    own = np.concatenate([forces.sum(axis=0), np.atleast_1d(moments(arms, forces))])
    force, moment = np.split(space.comm.allreduce(own, op=MPI.SUM), [space.dim])
    return force, float(moment[0]) if space.dim == 2 else moment


class RigidGroup(Constraint):
    """A group that moves as a rigid body.

    Parameters
    ----------
    space : pcontact.space.space.Space
    coupling : pcontact.scene.model.Coupling
    amplitude : pcontact.scene.amplitude.Amplitude
    fixed : ndarray (n_local, d) of bool
        Components that supports prescribe, and nodes of other rigid groups.
    where : (str, str)
        Scene and key path, for messages.

    Attributes
    ----------
    name : str
    nodes : ndarray (n,)
        Local nodes.
    rows : ndarray (k,)
        Those that are owned, as rows of owned nodes.
    leading : ndarray (m,)
        Global numbers of the leading components, the same on all ranks.

    Raises
    ------
    InputError
        On every rank: a component is prescribed, or the group is a line.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, coupling, amplitude, fixed, where):
        self._space, self._amplitude, d = space, amplitude, space.dim
        self.name, self.nodes = coupling.name or coupling.region, space.region(coupling.region)
        agree(space.comm, self._conflict(coupling, fixed, where))
        numbers, own = space.nodes[self.nodes], space.owns(self.nodes)
        self.rows, points = numbers[own] - space.start, space.points[self.nodes[own]]
        sums = space.comm.allreduce(np.concatenate([points.sum(axis=0), [len(points)]]))
        centre = sums[:d] / sums[d]
        spread = space.comm.allreduce(float(np.sum((points - centre) ** 2)))
        self._scale = np.sqrt(spread / sums[d]) if spread > 0.0 else 1.0
        self.point = centre if coupling.point is None else np.asarray(coupling.point, dtype=float)
        self._motions = rigid_motions(points - self.point, self._scale)
        ends = self._ends(points, numbers[own], centre, where, coupling)
        wanted = list(coupling.displacement or ["free"] * d)
        wanted += coupling.rotation if isinstance(coupling.rotation, tuple) else [coupling.rotation]
        wanted += [None] * (self._motions.shape[2] - len(wanted))
        if space.axisymmetric:
            wanted[0] = wanted[2] = 0.0
        self.free = np.array([one in (None, "free") for one in wanted])
        self._values = np.array([0.0 if free else float(one) for one, free in zip(wanted, self.free, strict=True)])
        self._values[d:] *= self._scale
        gram = space.comm.allreduce(np.einsum("kdi,kdj->ij", self._motions, self._motions))
        self._inverse = np.linalg.inv(gram)
        at = rigid_motions(ends[1] - self.point, self._scale)[:, :, self.free]
        at = at.reshape(len(ends[0]) * d, int(self.free.sum()))
        chosen = _chosen(at)
        self.leading = np.array([ends[0][k // d] * d + k % d for k in chosen], dtype=np.int64)
        # free motions of the leading components
        self._of_leading = np.linalg.inv(at[chosen].reshape(len(chosen), len(chosen)))
        following = (self._motions[:, :, self.free] @ self._of_leading).ravel()
        at, m = (self.rows[:, None] * d + np.arange(d)).ravel(), len(chosen)
        self._set(at, np.repeat(np.arange(len(at)), m), np.tile(self.leading, len(at)), following)

    def _conflict(self, coupling, fixed, where):
        """Return what is wrong with the group on this rank, or None."""
        held = fixed[self.nodes].any(axis=1) & ~self._space.on_axis()[self.nodes]
        if not held.any():
            return None
        at = coordinates(self._space.points[self.nodes[held][0]])
        return (f"{where[0]}: {where[1]}.region: found {coupling.region!r}, of which the point {at} has a prescribed "
                "displacement, or is in another coupling; allowed: a group that nothing else moves, or average = true "
                "where supports hold some of its components")  # fmt: skip

    def _ends(self, points, numbers, centre, where, coupling):
        """Global numbers and places of nodes far apart, two in the plane and three in space. *Collective.*"""
        space, d = self._space, points.shape[1]

        def farthest(distances):
            k = int(np.argmax(distances)) if len(distances) else -1
            own = (-1.0, 0, ()) if k < 0 else (float(distances[k]), int(numbers[k]), tuple(points[k]))
            # rounding errors must not choose among nodes that are as far
            return max(space.comm.allgather(own), key=lambda one: (float(f"{one[0]:.9e}"), -one[1]))

        _, first, a = farthest(np.linalg.norm(points - centre, axis=1))
        length, second, b = farthest(np.linalg.norm(points - np.array(a), axis=1))
        ends, wide = [(first, a), (second, b)], length > 0.0
        if d == 3 and wide:
            way = (np.array(b) - a) / length
            off = points - np.array(a)
            across, third, c = farthest(np.linalg.norm(off - np.outer(off @ way, way), axis=1))
            ends.append((third, c))
            wide = across > LINE * length
        if not wide:
            kind = "in a line" if d == 3 and length > 0.0 else "in one place"
            agree(space.comm, f"{where[0]}: {where[1]}.region: found {coupling.region!r}, whose nodes are {kind}; "
                              "allowed: a group with extent")  # fmt: skip
        return np.array([number for number, _ in ends]), np.array([place for _, place in ends])

    # -- displacements ----------------------------------------------------------------------------------------------

    def _amounts(self, u):
        """Motion (k,) of the group in a displacement (n_owned, d), turns times the scale. *Collective.*"""
        own = np.einsum("kdi,kd->i", self._motions, u[self.rows])
        return self._inverse @ self._space.comm.allreduce(own, op=MPI.SUM)

    def enter(self, u, time):
        """Let the group be where a displacement (n_owned, d) and what is prescribed have it. *Collective.*"""
        amounts = self._amounts(u)
        wanted = self._amplitude.factor(time) * self._values
        u[self.rows] = self._motions @ np.where(self.free, amounts, wanted)

    def bring(self, u, fresh):
        new = fresh[self.rows]
        old, comm = self._motions[~new], self._space.comm
        gram = comm.allreduce(np.einsum("kdi,kdj->ij", old, old))
        if np.linalg.matrix_rank(gram) < len(gram):
            return False
        amounts = np.linalg.solve(gram, comm.allreduce(np.einsum("kdi,kd->i", old, u[self.rows[~new]])))
        u[self.rows[new]] = self._motions[new] @ amounts
        return True

    def motion(self, u):
        """Displacement (d,) of the point [length], and rotation [radian]: a number in the plane. *Collective.*"""
        d, amounts = self._space.dim, self._amounts(u)
        turn = amounts[d:] / self._scale
        return amounts[:d], turn if d == 3 else float(turn[0])

    # -- mass of the point ------------------------------------------------------------------------------------------

    def inertia(self, mass, inertia):
        """Masses (k,) of the motions that :meth:`weigh` takes, of a mass at the point and an inertia about it, a number
        in the plane, (3,) in space."""
        d = self._space.dim
        turns = np.broadcast_to(np.atleast_1d(inertia), len(self.free) - d) / self._scale**2
        return np.concatenate([np.full(d, mass), turns])

    def weigh(self, masses, values, out, of=np.asarray):
        """Add to ``out`` (n_owned, d) what masses (k,) of the motions make of values (n_owned, d); `of` np.abs: the
        magnitude of that, for rounding errors. *Collective.*"""
        out[self.rows] += of(self._motions) @ (of(self._inverse) @ (masses * of(self._amounts(values))))

    def leading_mass(self, masses):
        """The same between the leading components (m, m)."""
        way = self._of_leading
        return way.T @ (masses[self.free, None] * way)

    def hold(self, modes):
        """Return what rigid motions (n_modes, n_local, d) of the bodies do that is prescribed, on rank 0, see
        :func:`pcontact.space.modes.free_motions`. *Collective.*
        """
        space = self._space
        amounts = np.array([self._amounts(mode[space.owned_local]) for mode in modes])[:, ~self.free]
        held = np.zeros((space.mesh.n_components, len(modes), len(modes)))
        bodies = space.comm.allgather(space.component[self.nodes[:1]].tolist())
        if space.comm.rank == 0:
            held[next(body for some in bodies for body in some)] = amounts @ amounts.T
        return held

    def record(self, u, unbalanced):
        """Motion of the point, and what holds its prescribed components, for the report. *Collective.*

        Parameters
        ----------
        u, unbalanced : ndarray (n_owned, d)
            Displacement; internal plus contact minus external forces.
        """
        return moved(self._space, self.point, self.motion(u), self.rows, unbalanced[self.rows])


def eliminate(rows, fixed):
    """Solve equations for components that are not prescribed.

    Parameters
    ----------
    rows : list of dict of int to float
        Coefficients by component; the first component is taken to follow where it can.
    fixed : set of int
        Prescribed components.

    Returns
    -------
    ways : dict of int to dict of int to float
        What each component that follows is in those that do not.
    bound : list of int
        Rows that are about prescribed components alone.
    """
    ways, used, bound = {}, {}, []
    for number, row in enumerate(rows):
        size, left = max(map(abs, row.values()), default=0.0), {}
        for component, factor in row.items():
            for other, weight in ways.get(component, {component: 1.0}).items():
                left[other] = left.get(other, 0.0) + factor * weight
        left = {component: factor for component, factor in left.items() if abs(factor) > ZERO * size}
        free = [component for component in left if component not in fixed]
        if not free:
            bound += [number] * bool(left)
            continue
        most = max(abs(left[component]) for component in free)
        chosen = next(component for component in free if abs(left[component]) >= FIRST * most)
        pivot = left.pop(chosen)
        way = {component: -factor / pivot for component, factor in left.items()}
        for user in used.pop(chosen, ()):
            weight = ways[user].pop(chosen)
            for component, factor in way.items():
                ways[user][component] = ways[user].get(component, 0.0) + weight * factor
                used.setdefault(component, set()).add(user)
        ways[chosen] = way
        for component in way:
            used.setdefault(component, set()).add(chosen)
    return ways, bound


def single(space, region, where):
    """Global number of the one node of a region. *Collective.*

    Raises
    ------
    InputError
        On every rank: it has others.
    """
    numbers = space.nodes[space.region(region)]
    numbers = sorted(set().union(*space.comm.allgather(set(numbers.tolist()))))
    if len(numbers) != 1:
        raise InputError(
            f"{where[0]}: {where[1]}.terms: found {region!r}, a group of {len(numbers)} nodes; allowed: groups of one"
        )
    return numbers[0]


def term_rows(space, equations, where):
    """Rows of `eliminate` of equations with terms. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    equations : list of pcontact.scene.model.Equation
    where : (str, list of str)
        Scene and key path of each, for messages.
    """
    node, rows = {}, []
    for path, one in zip(where[1], equations, strict=True):
        row = {}
        for region, direction, factor in one.terms:
            if region not in node:
                node[region] = single(space, region, (where[0], path))
            component = node[region] * space.dim + "xyz".index(direction)
            row[component] = row.get(component, 0.0) + factor
        rows.append(row)
    return rows


def _nearest(points, others):
    """Row of the nearest of other points (m, d), and how far it is, for each point (n, d)."""
    rows, far = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
    for k in range(0, len(points), CHUNK):
        distances = np.linalg.norm(points[k : k + CHUNK, None] - others[None], axis=2)
        rows[k : k + CHUNK] = distances.argmin(axis=1)
        far[k : k + CHUNK] = distances.min(axis=1)
    return rows, far


def pair_rows(space, pair, motion, where):
    """Rows of `eliminate` of two groups of which one moves as the other, turned. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pair : pcontact.scene.model.Periodic
    motion : (ndarray (d, d), ndarray (d,))
        Q and s: a node of the partner at x has its own at Q x + s, and u = Q u(partner).
    where : (str, str)
        Scene and key path, for messages.

    Raises
    ------
    InputError
        On every rank: a node has no partner.
    """
    d, (turn, shift) = space.dim, motion
    (followers, places), (leaders, others) = (gathered(space, name) for name in (pair.region, pair.partner))
    rows, far = _nearest(places, others @ turn.T + shift)
    within = PARTNER_DISTANCE * float(np.ptp(places, axis=0).max(initial=0.0)) if pair.within is None else pair.within
    if (far > within).any():
        worst = int(far.argmax())
        at = coordinates(places[worst])
        raise InputError(
            f"{where[0]}: {where[1]}.partner: found {pair.partner!r}, whose nearest node is {far[worst]:.3g} off where "
            f"that of the node {at} of {pair.region!r} is to be; allowed: nodes that are pairs, or a larger within"
        )
    found = []
    for own, partner in zip(followers.tolist(), leaders[rows].tolist(), strict=True):
        for i in range(d):
            row = {own * d + i: 1.0}
            for j in np.flatnonzero(turn[i]).tolist():
                row[partner * d + j] = row.get(partner * d + j, 0.0) - turn[i, j]
            found.append(row)
    return found


def linear_rows(space, bodies):
    """Rows of `eliminate` of the nodes in the middles of cells of bodies that have degree 1: they follow the vertices.
    *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2.
    bodies : set of int

    Returns
    -------
    list of dict of int to float
    """
    found = {}
    for block, table in zip(space.mesh.blocks, space.cells, strict=True):
        if block.body not in bodies:
            continue
        n, numbers = CELLS[block.cell].n_vertices, space.nodes[table]
        weights = shape(block.cell, 1, reference_nodes(block.cell, space.degree)[n:])
        for a, row in enumerate(weights, start=n):
            ends = np.flatnonzero(np.abs(row) > ZERO)
            middles, first = np.unique(numbers[:, a], return_index=True)
            for node, others in zip(middles.tolist(), numbers[first][:, ends].tolist(), strict=True):
                found[node] = dict(zip(others, row[ends].tolist(), strict=True))
    every = {node: row for part in space.comm.allgather(found) for node, row in part.items()}
    return [
        {node * space.dim + i: 1.0, **{other * space.dim + i: -weight for other, weight in row.items()}}
        for node, row in sorted(every.items()) for i in range(space.dim)
    ]  # fmt: skip


class Equations(Constraint):
    """All equations of a problem.

    Parameters
    ----------
    space : pcontact.space.space.Space
    rows : list of dict of int to float
        Coefficients by global number of the component, the same on all ranks.
    fixed, taken : ndarray (n_local, d) of bool
        Components that supports prescribe; those that other groups have.
    where : (str, list of str)
        Scene and the key path of each row, for messages.
    said : bool
        Whether the scene says any of them.
    given : dict of int to callable, optional
        Numbers beyond those of all components, which rows may name as well, and what stands for them at a time.

    Raises
    ------
    InputError
        On every rank: a node is in another group.

    Notes
    -----
    The constructor is *Collective*. An equation about prescribed components alone is left out: the supports say what
    they are.
    """

    def __init__(self, space, rows, fixed, taken, where, said=True, given=None):
        self._space, self._rows, self.said, self._given, d = space, rows, said, given or {}, space.dim
        every = sorted({component for row in rows for component in row} - self._given.keys())
        prescribed = self._flagged(fixed, every) | self._given.keys()
        others = self._flagged(taken, every)
        clash = next((k for k, row in enumerate(rows) if others & row.keys()), None)
        agree(space.comm, None if clash is None else (
            f"{where[0]}: {where[1][clash]}: found a node of a rigid group or of a section; allowed: other nodes"
        ))  # fmt: skip
        ways, bound = eliminate(rows, prescribed)
        self._check_given(bound, where)
        first, last = space.start * d, (space.start + space.n_owned) * d
        mine = sorted(component for component in ways if first <= component < last)
        self._shifts = {}
        for k, component in enumerate(mine):
            for number in ways[component].keys() & self._given.keys():
                self._shifts.setdefault(number, np.zeros(len(mine)))[k] = ways[component][number]
        entries = [(k, other, weight) for k, component in enumerate(mine)
                   for other, weight in ways[component].items() if other not in self._given]  # fmt: skip
        row, column, weight = (np.array([one[k] for one in entries], dtype=kind)
                               for k, kind in enumerate((np.int64, np.int64, float)))  # fmt: skip
        free = ~np.isin(column, np.array(sorted(prescribed), dtype=np.int64))
        self._set(np.array(mine, dtype=np.int64) - first, row, column, weight, free)
        self.count = len(ways)

    def _check_given(self, bound, where):
        """Refuse equations with a given value whose components are all prescribed."""
        for k in bound:
            if self._given.keys() & self._rows[k].keys():
                raise InputError(
                    f"{where[0]}: {where[1][k]}: found a motion of which supports, or others like it, leave nothing "
                    "open; allowed: a group that they do not hold"
                )

    def _flagged(self, flags, components):
        """Components whose flags (n_local, d) are set, on any rank. *Collective.*"""
        space, d = self._space, self._space.dim
        own = np.array(components, dtype=np.int64) - space.start * d
        own = own[(own >= 0) & (own < space.n_owned * d)]
        set_ = own[flags[space.owned_local].ravel()[own]] + space.start * d
        return set().union(*space.comm.allgather(set(set_.tolist())))

    def given(self, u, time):
        """Return what is given of components that follow, at a time."""
        return sum((self._given[number](time) * shift for number, shift in self._shifts.items()), 0.0)

    def hold(self, modes):
        """Return what rigid motions (n_modes, n_local, d) of bodies violate equations between nodes of one body, on
        rank 0. *Collective.*"""
        space, d = self._space, self._space.dim
        local = {int(number): k for k, number in zip(space.owned_local, space.nodes[space.owned_local], strict=True)}
        values = np.zeros((len(self._rows), len(modes)))
        bodies = np.zeros((len(self._rows), 2), dtype=np.int64)
        bodies[:, 0], bodies[:, 1] = space.mesh.n_components, -1
        for k, row in enumerate(self._rows):
            for component, factor in row.items():
                node = local.get(component // d)
                if node is not None:
                    values[k] += factor * modes[:, node, component % d]
                    body = space.component[node]
                    bodies[k] = min(bodies[k, 0], body), max(bodies[k, 1], body)
        space.comm.Allreduce(MPI.IN_PLACE, values)
        least, most = bodies[:, 0].copy(), bodies[:, 1].copy()
        space.comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
        space.comm.Allreduce(MPI.IN_PLACE, most, op=MPI.MAX)
        held = np.zeros((space.mesh.n_components, len(modes), len(modes)))
        if space.comm.rank == 0:
            same = least == most
            np.add.at(held, least[same], values[same][:, :, None] * values[same][:, None, :])
        return held

    def record(self, unbalanced):
        """Resultant of the forces that the equations exert on components that are not prescribed, for the report.
        *Collective.*

        Parameters
        ----------
        unbalanced : ndarray (n_owned, d)
            Internal plus contact minus external forces.
        """
        space, d = self._space, self._space.dim
        own = np.bincount(self._at % d, unbalanced.reshape(-1)[self._at], minlength=d)
        back = self._weight * unbalanced.reshape(-1)[self._at][self._row]
        own = own - np.bincount(self._column[self._free] % d, back[self._free], minlength=d)
        return {"force": space.comm.allreduce(own, op=MPI.SUM).tolist()}
