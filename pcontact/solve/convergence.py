"""Convergence of Newton's method, and results of the solves of load steps.

The norm of the residual is that of all bodies. One that hardly anything holds, beside others that are pressed hard, may
bear less than the others leave open: what says whether it has come to rest is that its own forces balance along the
motions that supports leave it.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcontact.runtime.petsc import PETSc, diverged_nan
from pcontact.solve.problem import ROUNDINGS
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
        self._nodes = space.by_component()[self._bodies.bodies]
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
        """Return whether the residual ``f`` at ``u`` leaves hardly a part of the forces on each body along its free
        motions, or iterations do not make it less any more. *Collective.*

        Rounding errors of a body's own forces are nothing.
        """
        sums = self._bodies.sums_along(self._problem.space.of_owned(f))
        left = np.linalg.norm(sums, axis=1)
        moves = self._moves(u, left)
        if not moves.any():
            return True
        rest = float(np.linalg.norm(left[moves]))
        self._vain = 0 if rest <= LESS * self._least else self._vain + 1
        self._least = min(self._least, rest)
        return self._vain >= VAIN

    def _moves(self, u, left):
        """Return whether forces (n_bodies,) along the free motions are more than what counts as none. *Collective.*"""
        forces = self._problem.active.borne(u) + self._problem.forces.by_component(u)
        return left > np.maximum(LEFT * forces[self._bodies.bodies] / np.sqrt(self._nodes), self._rounding(u))

    def falls(self, u, y, f):
        """Components (n_components,) that nothing but the stabilisation holds back in the Newton step ``-y`` from
        ``u``, where the residual is ``f``. *Collective.*

        What the tangent says of such a body is where it goes, not how far. What counts as no force makes none fall.
        """
        problem, bodies = self._problem, self._bodies
        y, f = map(problem.space.of_owned, (y, f))
        force, held = bodies.sums_along(f), bodies.sums_along(problem.stabilisation[:, None] * y)
        rest, force = np.linalg.norm(force - held, axis=1), np.linalg.norm(force, axis=1)
        falls = np.zeros(problem.space.mesh.n_components, dtype=bool)
        falls[bodies.bodies] = (force > 0.0) & (rest <= BORNE_IN_FALL * force)
        # the sums are the same on all ranks; what counts as no force costs as much as a residual
        if falls.any():
            falls[bodies.bodies] &= self._moves(u, force)
        return falls


# [-] Rounding errors of forces whose norm is 1, as many as an exact solution leaves.
ROUNDOFF = ROUNDINGS * np.finfo(float).eps

# [-] Part of the first residual below which the forces of a solution are not known. From: chosen, 5e5 rounding
# errors of a double.
ROUNDED = 1e-10
# [-] So many times the expected rounding errors, a residual that no longer falls ends the method. From: chosen, two
# digits.
NEARLY = 100.0
# [-] Part of the forces at work that rounding errors may hide. From: chosen, less than what meshes leave open.
BALANCED = 1e-3
# [-] Part of the displacements that rounding errors may hide where no force is applied. From: chosen, nine digits.
MOVED = 1e-9
# [-] A residual of this part of the forces at work is small enough, unless the tolerance is looser.
# From: chosen, ten times the default of snes_rtol; with 1e-6 a pressure of the study of extremes is wrong by 1.2e-6.
SMALL = 1e-7


class ConvergenceTest:
    """Compares the residual with the first one, the forces at work and its rounding errors; the step says nothing.

    Called by SNES at every iterate.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    balance : pcontact.solve.convergence.Balance or None
        Of loose bodies, if there are some: they are to be at rest, too.
    residual : PETSc.Vec
        At the present iterate, whenever this is called.

    Attributes
    ----------
    norms : list of float
        Of the residual [force] at the iterates of the present run.
    krylov : list of int
        Sums of the Krylov iterations before them, in this run.
    predicted : bool
        Whether SNES gets a predicted residual at the first iterate of the run: that is no solution, however small.
    predicted_from : float
        The norm of the true residual there, where it is known; else nan.
    carried : float
        Largest forces at work at solutions of the run so far [force]: their rounding errors are nothing in the load
        steps after them, in which nothing may act any more.
    told : callable, optional
        Called with the norms at every iterate.
    """

    def __init__(self, problem, balance, residual):
        self._problem, self._balance, self._residual = problem, balance, residual
        self._floor, self._least, self._first, self._start = 0.0, 0.0, None, None
        self.predicted, self.predicted_from, self.told, self.carried = False, np.nan, None, 0.0
        self.begin()

    def begin_step(self, u):
        """A load step begins at ``u``. *Collective.*"""
        # loads that supports or equations bear leave their rounding errors, too
        self._least = max(ROUNDINGS * self._problem.forces.roundoff(u), ROUNDOFF * self._problem.forces.loaded(u))
        self._first, self._start, self.predicted_from = None, u, np.nan

    def begin(self, near=False):
        """A run begins; with `near`, it may end where it begins."""
        self._near, self.predicted = near, False
        self.norms, self.krylov = [], [0]

    def negligible(self, norm, first, rtol):
        """Return whether a predicted residual of some norm is none: within its rounding errors, or as small beside the
        true one (nan: not known) as that of a solution."""
        return norm <= self._least or norm <= rtol * first

    @property
    def part(self):
        """Part of the largest residual of the run that is left."""
        return self.norms[-1] / max(self._first, *self.norms)

    def __call__(self, snes, iteration, norms):
        norm = norms[2]
        reasons = PETSc.SNES.ConvergedReason
        if not np.isfinite(norm):
            return diverged_nan
        if iteration == 0:
            self.norms, self.krylov, self._floor = [], [], self._least
        self.krylov.append(snes.getLinearSolveIterations())
        if self._first is None:
            # the predicted one may be much larger, and means no more
            self._first = float(np.fmin(norm, self.predicted_from))
            if self._problem.prediction.goes_on:
                # there is little to do where bodies go on as they did: its residual says nothing of the forces
                acting = self._problem.forces.acting(snes.getSolution())
                self._first = max(self._first, self._problem.prediction.imposing, acting)
        self.norms.append(norm)
        if self.told is not None:
            self.told(self.norms)
        u = snes.getSolution()
        if iteration > 0 and norm > 0.5 * self.norms[-2]:
            self._floor = ROUNDINGS * self._problem.forces.roundoff(u)
        if iteration == 0 and self.predicted:
            return reasons.ITERATING
        reason = self._ends(u, iteration, norm, snes.getTolerances())
        rests = reason == reasons.ITERATING or self._balance is None or self._balance.rests(u, self._residual)
        if not rests:
            return reasons.ITERATING
        if reason != reasons.ITERATING:
            self.carried = max(self.carried, self._problem.forces.acting(u))
        return reason

    def _ends(self, u, iteration, norm, tolerances):
        """Reason for which an iteration ends with this norm of the residual, or that it does not. *Collective.*"""
        reasons = PETSc.SNES.ConvergedReason
        rtol, atol = tolerances[:2]
        rounded = norm <= max(self._floor, self._least) and self._settled(u, iteration, norm)
        hidden = rounded and self._balanced(u, norm)
        if norm <= max(atol, ROUNDOFF * self.carried) or hidden:
            return reasons.CONVERGED_FNORM_ABS
        if (iteration > 0 or self._near) and norm <= rtol * self._first:
            if self._small(u, norm, max(rtol, SMALL)):
                return reasons.CONVERGED_FNORM_RELATIVE
            stuck = iteration > 0 and norm <= NEARLY * self._floor and norm > 0.5 * self.norms[-2]
            if stuck and self._balanced(u, norm):
                return reasons.CONVERGED_FNORM_ABS
        return reasons.ITERATING

    def _settled(self, u, iteration, norm):
        """Return whether another iteration would gain nothing: the residual no longer falls, or is small against the
        forces at work, or these are rounding errors. Those of a stiff body may hide what is left in a soft one.
        *Collective.*"""
        if iteration == 0 or norm > 0.5 * self.norms[-2]:
            return True
        acting = self._problem.forces.acting(u)
        return norm <= SMALL * acting or acting <= max(self._floor, self._least)

    def _balanced(self, u, norm):
        """Return whether a residual that rounding errors hide is small against the forces: those of a body that flows
        without bound exceed any load, those of a gap times a huge gamma any stress. Bodies that nothing loads may move
        without any force: there a residual is enough that hardly changes their displacements. *Collective.*"""
        if norm <= BALANCED * self._problem.forces.acting(u):
            return True
        if self._problem.forces.loaded(u, springs=False) > 0.0:
            return False
        # bodies that spring back to where they were have no displacements left to compare with
        scale = max(self._problem.forces.stiffness_scale(x) for x in (u, self._start))
        # springs that bear nothing leave the rounding errors of their forces
        return self._problem.forces.loaded(u) <= ROUNDOFF * scale and norm <= MOVED * scale

    def _small(self, u, norm, part):
        """Return whether a residual is small against the forces at work. The first residual, of bodies whose supports
        alone have moved, is many orders of magnitude larger where one is stiff, or gamma large: its rounding errors may
        be what is left. *Collective.*"""
        if norm <= part * self._problem.forces.acting(u):
            return True
        return norm <= part * ROUNDED * self._first and self._balanced(u, norm)


@dataclass
class NewtonResult:
    """Result of a solve.

    Attributes
    ----------
    converged : bool
    newton, krylov : int
        Iterations.
    hardest : int
        Krylov iterations of the linear solve that took most.
    reason : str
    residual, initial : float
        Last and first norm of the residual [force].
    detail : str
        Of a solve that did not converge: where the residual is largest, and which pairs were changing.
    uzawa : dict or None
        Updates of multipliers around the solve, where there are any, see `pcontact.stepping.load_step`.
    free : list of int or None
        Loose bodies on which no contact acts, where there are loose ones, see `pcontact.stepping.loose`.
    partners : dict or None
        What the last search for partners has said, see :class:`pcontact.stepping.load_step.PartnerUpdate`.
    final : bool
        Whether a shorter load step would end in the same way.
    """

    converged: bool
    newton: int
    krylov: int
    reason: str
    residual: float
    initial: float
    detail: str = ""
    uzawa: dict | None = None
    hardest: int = 0
    free: list | None = None
    partners: dict | None = None
    final: bool = False


def combined(first, second):
    """The second of two solves of a load step, with the iterations of both."""
    return replace(
        second,
        newton=first.newton + second.newton,
        krylov=first.krylov + second.krylov,
        hardest=max(first.hardest, second.hardest),
    )
