"""Whether the forces on each loose body balance along the motions that supports leave it.

The norm of the residual is that of all bodies. One that hardly anything holds, beside others that are pressed hard, may
bear less than the others leave open: its own forces are what says whether it has come to rest.
"""

import numpy as np

from pcontact.runtime.petsc import MPI
from pcontact.solve.forces import ROUNDINGS
from pcontact.space.modes import RigidBodies

# [-] Part of the forces on a loose body that may be left along its free motions. From: chosen, ten times SMALL of
# convergence.py, for the forces on one body instead of those on all.
LEFT = 1e-6
# [-] Part of what was left that an iteration has to get below. From: bisection, the slowest method that counts.
LESS = 0.5
# [iterations] So many in a row that leave more: then what is left counts as rounding errors. Row: stabilisation.
VAIN = 3
# [-] Part of the force along its free motions that contact and supports may bear where a body counts as falling.
# Row: step_limit.
BORNE_IN_FALL = 0.5


class Balance:
    """Forces along the free motions of loose bodies.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    motions : dict of int to ndarray
        Rigid motions of the bodies, see :func:`pcontact.space.modes.free_motions`.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, motions):
        self._problem, space = problem, problem.space
        self._bodies = RigidBodies(space, np.ones(space.n_owned), motions)
        own = np.bincount(space.component[space.owned_local], minlength=space.mesh.n_components)
        self._nodes = space.comm.allreduce(own, op=MPI.SUM)[self._bodies.bodies]
        self._rounded, self._least, self._vain = 0.0, np.inf, 0

    def begin(self, u):
        """Forget the iterations of the last solve. *Collective.*

        Bodies that spring back keep the rounding errors of the forces that held them in ``u``.
        """
        self._rounded, self._least, self._vain = 0.0, np.inf, 0
        self._rounded = self._rounding(u)

    def _rounding(self, u):
        """Rounding errors of the forces on the bodies at ``u``, or at the beginning [force]. *Collective.*"""
        return np.maximum(ROUNDINGS * self._problem.forces.roundoff_of(u)[self._bodies.bodies], self._rounded)

    def rests(self, u, f):
        """Whether the residual ``f`` at ``u`` leaves hardly a part of the forces on each body along its free motions,
        or iterations do not make it less any more. *Collective.*

        Rounding errors of a body's own forces are nothing.
        """
        problem, bodies = self._problem, self._bodies
        left = np.linalg.norm(bodies.sums_along(f.getArray(readonly=True).reshape(-1, problem.space.dim)), axis=1)
        forces = (problem.active.borne(u) + problem.forces.by_component(u))[bodies.bodies] / np.sqrt(self._nodes)
        moves = left > np.maximum(LEFT * forces, self._rounding(u))
        if not moves.any():
            return True
        rest = float(np.linalg.norm(left[moves]))
        self._vain = 0 if rest <= LESS * self._least else self._vain + 1
        self._least = min(self._least, rest)
        return self._vain >= VAIN

    def falls(self, u, y, f):
        """Components (n_components,) that nothing but the stabilisation holds back in the Newton step ``-y`` from
        ``u``, where the residual is ``f``. *Collective.*

        What the tangent says of such a body is where it goes, not how far. Rounding errors make none fall.
        """
        problem, bodies = self._problem, self._bodies
        y, f = (vector.getArray(readonly=True).reshape(-1, problem.space.dim) for vector in (y, f))
        force, held = bodies.sums_along(f), bodies.sums_along(problem.stabilisation[:, None] * y)
        rest, force = np.linalg.norm(force - held, axis=1), np.linalg.norm(force, axis=1)
        falls = np.zeros(problem.space.mesh.n_components, dtype=bool)
        falls[bodies.bodies] = (force > 0.0) & (rest <= BORNE_IN_FALL * force)
        # the sums are the same on all ranks; rounding errors cost as much as a residual
        if falls.any():
            falls[bodies.bodies] &= force > self._rounding(u)
        return falls
