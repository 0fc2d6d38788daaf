"""Loose bodies that no contact force holds any more: they stay where the last load step left them.

A body that supports leave free, and on which no contact acts, may be anywhere: all its rigid motions solve the load
step. Where Newton's method happens to leave it depends on rounding errors, and with them on the number of ranks, the
numbering and the linear solver. Among the solutions the program takes the one with the least rigid motion since the end
of the last load step: least in the mean square over the body, of all motions that let it overlap with nothing.

The point of a polyhedron that is nearest to the origin.

Least distance programming, by non-negative least squares (C. L. Lawson, R. J. Hanson, Solving Least Squares Problems,
1974, chapter 23). The matrices are small and dense.
"""

from dataclasses import replace

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.mesh.topology import merged
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI
from pcontact.solve.problem import ROUNDINGS
from pcontact.space.modes import RigidBodies, component_frames

# [-] Part of the columns' size below which a gradient is a rounding error. From: 500 rounding errors of a double.
TINY = 1e-13
# [-] What bounds that are not met cost, in squares of distances. From: chosen, below the inverse of TINY.
UNMET = 1e12


def least_squares_of_positive(a, b):
    """The x >= 0 (n,) with the least |a x - b|, for a (m, n), b (m,)."""
    n = a.shape[1]
    x, passive = np.zeros(n), np.zeros(n, dtype=bool)
    least = TINY * np.linalg.norm(a, axis=0) * np.linalg.norm(b)
    for _ in range(3 * n):
        rise = np.where(passive, -np.inf, a.T @ (b - a @ x) - least)
        if n == 0 or rise.max() <= 0.0:
            break
        passive[np.argmax(rise)] = True
        while passive.any():
            best = np.zeros(n)
            best[passive] = np.linalg.lstsq(a[:, passive], b, rcond=None)[0]
            down = passive & (best <= 0.0)
            if not down.any():
                x = best
                break
            x += np.min(x[down] / np.maximum(x[down] - best[down], 1e-300)) * (best - x)
            passive &= ~(down & (x <= TINY * x.max(initial=0.0)))
            x[~passive] = 0.0
    return x


def nearest_point(rows, bounds):
    """The x with the least norm for which rows @ x >= bounds.

    Bounds that contradict each other, if only by rounding errors, are met as well as all of them can be: what is left
    costs `UNMET` times its square.

    Parameters
    ----------
    rows : ndarray (m, n)
    bounds : ndarray (m,)

    Returns
    -------
    ndarray (n,)
    """
    m, n = rows.shape
    size = np.linalg.norm(rows, axis=1)
    # distances of the bounds from the origin; nothing helps one that no x changes
    size = np.where(size > 0.0, size, np.inf)
    distance = bounds / size
    scale = np.max(distance, initial=0.0)
    if not scale > 0.0:
        return np.zeros(n)
    columns = np.vstack([(rows / size[:, None]).T, np.eye(m) / np.sqrt(UNMET), distance / scale])
    last = np.zeros(len(columns))
    last[-1] = 1.0
    rest = columns @ least_squares_of_positive(columns, last) - last
    return -scale * rest[:n] / rest[-1]


# [-] Part of the external forces on a body: contact that bears less of them bears none. From: as LEFT of
# convergence.py, what is left of them where Newton's method ends.
NOTHING = 1e-6
# [-] So many times the sum of the magnitudes of a body's residual may be that of its contact forces: pressures that
# balance each other, and rounding errors of strains. From: chosen, two digits.
MORE = 100.0
# [body sizes] Distance that is left where a free body touches. From: 5000 rounding errors of a double.
CLEAR = 1e-12
# [points] On each rank in a round, those that overlap most. From: chosen; a round solves a dense problem of this size.
WORST = 200
# [rounds] At most. From: chosen; what overlaps after them stays where Newton's method has left it.
ROUNDS = 50
# [names] In a line of the log. From: chosen; no iteration depends on it.
NAMED = 5


class LooseBodies:
    """Treatment of bodies that supports leave free, at the end of a load step.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    motions : dict of int to ndarray
        Their rigid motions, see :func:`pcontact.space.modes.free_motions`.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, motions):
        self.problem, self.motions = problem, motions
        self._loose = np.zeros(problem.space.mesh.n_components, dtype=bool)
        self._loose[list(motions)] = True
        space = problem.space
        self._unknowns = space.dim * space.by_component()
        self._clear = CLEAR * float(np.max(component_frames(space)[1]))

    def open(self, u):
        """Contact forces (n_components,) that count as none at a solution: what its residual leaves open [force].
        *Collective.*
        """
        problem, space = self.problem, self.problem.space
        applied, residual = problem.forces.by_component(u), space.vector()
        problem.residual(u, residual)
        forces = space.of_owned(residual)
        # a norm of the residual is this much in the sum of its magnitudes; that of all bodies says nothing of one that
        # bears less than the others leave open
        rounding = ROUNDINGS * problem.forces.roundoff_of(u)
        least = MORE * np.sqrt(self._unknowns) * np.maximum(space.norms(forces), rounding)
        residual.destroy()
        return np.where(applied > 0.0, np.minimum(least, NOTHING * applied), least)

    def free(self, u, least):
        """Loose bodies on which no contact acts, or less than `least` (n_components,) [force], and that no
        contact holds which bears tension. *Collective.*

        Returns
        -------
        list of int
            Connected components.
        """
        contact = self.problem.active.borne(u)
        return np.flatnonzero(self._loose & (contact <= least) & (self.problem.active.bonds() < np.inf)).tolist()

    def __call__(self, u, before, result):
        """Choose among the solutions of a load step. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            The solution that Newton's method has found; overwritten.
        before : PETSc.Vec
            The committed displacement.
        result : pcontact.solve.convergence.NewtonResult

        Returns
        -------
        NewtonResult
            With ``free``: the bodies on which no contact acts.
        """
        least = self.open(u)
        free = self.free(u, least)
        if free:
            found, chosen = u.copy(), np.isin(np.arange(len(least)), free)
            placed = self._place(u, before, free)
            # a place without overlap is no solution where an adhesion acts before bodies touch
            bonds = NOTHING * self.problem.active.bonds()
            borne = self.problem.active.borne(u) if placed else 0.0
            if placed and np.any((bonds > 0.0) & (borne > np.maximum(least, bonds)), where=chosen):
                found.copy(u)
                placed = self._place(u, before, free, True)
            found.destroy()
            if not placed:
                text = "free bodies have no place that they do not share with others: they stay where Newton left them"
                log.info(text)
        return replace(result, free=free)

    def begin(self, u):
        """Before a load step is solved: move free bodies out of the way of what has moved into them. *Collective.*

        Newton's method would find their places one after the other, as each of them pushes the next. Where they have
        none, because they are caught, they stay: their forces are to be found.

        Parameters
        ----------
        u : PETSc.Vec
            The committed displacement with the prescribed ones entered; overwritten.
        """
        free = self._loose & (self.problem.active.touched() == 0.0) & (self.problem.forces.by_component(u) == 0.0)
        if free.any():
            self._place(u, u, np.flatnonzero(free).tolist(), True)

    def _place(self, u, before, free, beyond=False):
        """Move free bodies to the place nearest to where they were, on demand beyond the reach of adhesion; whether
        they have one. *Collective.*"""
        space = self.problem.space
        bodies = RigidBodies(space, self.problem.stabilisation, {k: self.motions[k] for k in free})
        change = (u.getArray(readonly=True) - before.getArray(readonly=True)).reshape(-1, space.dim)
        back = -bodies.amounts(change)
        points = Points(self.problem, u, bodies, beyond)
        away = points.apart(back, self._clear)
        # where nothing has been moved apart yet, what overlaps says nothing of what may
        least = self._clear if before is u else max(points.overlap(0.0 * back), self._clear)
        if points.overlap(back + away) > 2.0 * least:
            return False
        u.setArray(u.getArray(readonly=True) + bodies.field(back + away).ravel())
        return True


class Points:
    """Points at which free bodies may touch others, and what their motions do to the distance. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    u : PETSc.Vec
        Where distances are measured.
    bodies : pcontact.space.modes.RigidBodies
        The free ones.
    beyond : bool
        Distances count from where the law bears nothing any more, not from where points touch.
    """

    def __init__(self, problem, u, bodies, beyond=False):
        space = problem.space
        self._comm, fields = space.comm, [space.vector(values) for values in bodies.fields]
        sets = (one for _, one in problem.active.sets)
        parts = [ActiveSet().clearance(u, fields), *(one.clearance(u, fields, beyond) for one in sets)]
        distance, numbers, rows = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        # the last place is that of what does not move
        place = np.full(space.mesh.n_components + 1, -1, dtype=np.int64)
        place[bodies.bodies] = np.arange(len(bodies.bodies))
        numbers = place[numbers]
        some = (numbers >= 0).any(axis=1)
        self._distance, self._bodies, self._rows = distance[some], numbers[some], rows[some]
        self._rows[self._bodies < 0] = 0.0
        for field in fields:
            field.destroy()

    def _left(self, amounts):
        """Distances (n,) after motions (n_bodies, m)."""
        return self._distance + np.einsum("pbm,pbm->p", self._rows, amounts[self._bodies])

    def overlap(self, amounts):
        """Largest overlap after motions (n_bodies, m) [length]. *Collective.*"""
        return self._comm.allreduce(float(np.max(-self._left(amounts), initial=0.0)), op=MPI.MAX)

    def apart(self, amounts, clear):
        """The least motions (n_bodies, m) after some which leave a distance at all points. *Collective.*

        Parameters
        ----------
        amounts : ndarray (n_bodies, m)
        clear : float
            The distance [length].
        """
        away, known = np.zeros_like(amounts), np.zeros(len(self._distance), dtype=bool)
        first, table = self._left(amounts), []
        for _ in range(ROUNDS):
            left = np.where(known, np.inf, self._left(amounts + away))
            worst = np.argsort(left, kind="stable")[:WORST]
            worst = worst[left[worst] < 0.5 * clear]
            known[worst] = True
            found = self._comm.gather((self._bodies[worst], self._rows[worst], clear - first[worst]))
            if found is not None:
                table += found
                away = _least_motions(away.shape, *(np.concatenate(arrays) for arrays in zip(*table, strict=True)))
            away = self._comm.bcast(away)
            if not self._comm.allreduce(len(worst)):
                break
        return away


def _least_motions(shape, bodies, rows, bounds):
    """Least motions (n_bodies, m) that add to the distance of some points what it lacks, (n,) bounds.

    Bodies that touch no body in common are independent of each other.
    """
    n, m = shape
    away = np.zeros(shape)
    partners = np.where(bodies >= 0, bodies, bodies[:, ::-1])
    group = merged(n, partners)
    for k in np.unique(group[partners[:, 0]]):
        some, chosen = np.flatnonzero(group == k), np.flatnonzero(group[partners[:, 0]] == k)
        matrix = np.zeros((len(chosen), n, m))
        for side in (0, 1):
            at = np.flatnonzero(bodies[chosen, side] >= 0)
            matrix[at, bodies[chosen[at], side]] += rows[chosen[at], side]
        found = nearest_point(matrix[:, some].reshape(len(chosen), -1), bounds[chosen])
        away[some] = found.reshape(len(some), m)
    return away


class Announcer:
    """Says which bodies have become free, with a warning the first time, and which no longer are.

    Parameters
    ----------
    names : list of str
        Of all connected components.
    """

    def __init__(self, names):
        several = {name for name in names if names.count(name) > 1}
        self.names = [f"{name} {k}" if name in several else name for k, name in enumerate(names)]
        # bodies that are free now, that were so once, and that a contact force has held at the end of a load step
        self._free, self._known, self._held = set(), set(), set()

    def __call__(self, time, free, first=False):
        """Names of the free bodies (components) of a load step, which may be the first one of a run."""
        if not (first or self._free or self._held):
            # who goes on does not know what was before
            self._held = set(range(len(self.names)))
        gone, caught = [k for k in free if k not in self._free], sorted(self._free.difference(free))
        self._free = set(free)
        self._held.update(set(range(len(self.names))) - self._free)
        never = [k for k in gone if k not in self._held]
        if never:
            self._known.update(never)
            log.warning(
                "time %g: no support holds %s, and no contact force ever has: left where %s. Is a support missing? "
                "Does a load press %s on another body? Do contacts name the surfaces that meet?",
                time, self._listed(never), "it is" if len(never) == 1 else "they are",
                "it" if len(never) == 1 else "them",
            )  # fmt: skip
        gone = [k for k in gone if k in self._held]
        if gone:
            say = log.info if self._known.issuperset(gone) else log.warning
            self._known.update(gone)
            say(
                "time %g: no support and no contact force holds %s: free, left where the last load step left %s",
                time, self._listed(gone), "it" if len(gone) == 1 else "them",
            )  # fmt: skip
        if caught:
            log.info("time %g: in contact again: %s", time, self._listed(caught))
        return [self.names[k] for k in free]

    def _listed(self, bodies):
        more = f" and {len(bodies) - NAMED} more" if len(bodies) > NAMED else ""
        return ("body " if len(bodies) == 1 else "bodies ") + ", ".join(self.names[k] for k in bodies[:NAMED]) + more
