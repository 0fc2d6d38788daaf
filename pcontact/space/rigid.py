"""Groups that move as rigid bodies: components of the displacement that follow from a few others.

The nodes of a rigid group have u = U + w x (X - point), small turns: all their components are linear in the m
components of the motion (U, w) that are not prescribed. As many components of the nodes themselves, far apart, are
*leading*; the others follow, u = W u_leading + what is prescribed (:mod:`pcontact.space.constraints`).
"""

import numpy as np

from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI
from pcontact.space.constraints import Constraint
from pcontact.space.moments import moments

# [-] Size of a group across the line through its farthest nodes, over that along it, below which it is a line. From:
# far above the rounding errors of coordinates, far below what is no line.
LINE = 1e-6


def rigid_motions(arms, scale):
    """Displacements (n, d, k) of translations and of turns by 1 / scale, at the ends of arms (n, d): k = 3 or 6."""
    n, d = arms.shape
    turns = np.zeros((n, d, 1 if d == 2 else 3))
    if d == 2:
        turns[:, 0, 0], turns[:, 1, 0] = -arms[:, 1], arms[:, 0]
    else:
        turns = np.cross(np.eye(3)[None], arms[:, None, :]).transpose(0, 2, 1)
    return np.concatenate([np.broadcast_to(np.eye(d), (n, d, d)), turns / scale], axis=2)


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
    arms = space.points[space.owned_local[rows]] - point
    own = np.concatenate([forces.sum(axis=0), np.atleast_1d(moments(arms, forces))])
    sums = space.comm.allreduce(own, op=MPI.SUM)
    result = {"displacement": displacement.tolist(), "force": sums[:d].tolist()}
    if not space.axisymmetric:
        result["rotation"] = rotation if d == 2 else rotation.tolist()
        result["moment"] = float(sums[d]) if d == 2 else sums[d:].tolist()
    return result


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
        """What is wrong with the group on this rank, or None."""
        held = fixed[self.nodes].any(axis=1) & ~self._space.on_axis()[self.nodes]
        if not held.any():
            return None
        at = ", ".join(f"{c:g}" for c in self._space.points[self.nodes[held][0]])
        return (f"{where[0]}: {where[1]}.region: found {coupling.region!r}, of which the point ({at}) has a prescribed "
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

    def weigh(self, masses, values, out):
        """Add to ``out`` (n_owned, d) what masses (k,) of the motions make of values (n_owned, d). *Collective.*"""
        out[self.rows] += self._motions @ (self._inverse @ (masses * self._amounts(values)))

    def leading_mass(self, masses):
        """The same between the leading components (m, m)."""
        way = self._of_leading
        return way.T @ (masses[self.free, None] * way)

    def hold(self, modes):
        """What rigid motions (n_modes, n_local, d) of the bodies do that is prescribed, on rank 0, see
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
