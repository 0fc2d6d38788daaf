"""The item of inertia: M a + C v beside the forces of all other items, by an integrator of the table.

With the numbers f, m, d0, d1, s0, s1 of `pcontact.scene.integrators`, the forces q that accelerate nodes (those of all
other items, of supports and of damping, with the sign of M a) follow at the end of a step from

    (1 - f) q1 = (1 - m) M a1 + m M a0 - f q0,

where a1 and v1 are linear in the displacement u1. What the item adds to the sum of the others, C v1 + q1, is therefore
known from u1 and from its own state (v, a, q) at the beginning: it needs no force of any other item, and what is left
at supports are their reactions.
"""

import numpy as np

from pcontact.assembly.item import LAW, Item, Sum
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI
from pcontact.scene.integrators import INTEGRATORS
from pcontact.space.supports import moments

# what a checkpoint keeps of every node
STATE = ("velocity", "acceleration", "force")
# [-] Relative residual of the mass matrix at the beginning. From: chosen, rounding errors of some hundred terms.
MASS_RTOL = 1e-13
# [quarters of a step] Where what is prescribed is looked at for its velocity at the beginning. From: chosen; the error
# is of the fourth order, two above that of integrators.
STENCIL = np.arange(5.0)
# [-] Part of the largest velocity that is no jump of it. From: chosen, rounding errors of differences are 1e-4 of that.
CORNER = 1e-9
# [-] Bodies rest where the forces of inertia are this part of the largest ones of their motion. From: chosen; the load
# step is then solved without them, from there.
REST_FORCE = 1e-2
# [-] Least part of the first step of a motion that one may have. From: as `min_step` of `[steps]`.
LEAST_MOTION = 1.0 / 1024.0
# [iterations] Of Newton's method up to which the steps of a motion grow. From: as Schedule.EASY.
EASY_MOTION = 8


class Inertia(Item):
    """Inertia of all bodies, with damping that is linear in the velocity.

    Parameters
    ----------
    space : pcontact.space.space.Space
    mass : pcontact.assembly.mass.Mass
    damping : ndarray (nnz, d, d) or None
        C on the pattern of cells [force * time / length].
    weights : pcontact.scene.integrators.Weights
    step_error : float or None
        Local error of the velocity that is allowed, as a part of the largest velocity so far.
    initial : callable
        Displacement and velocity (n_owned, d) of the owned nodes at the beginning [length, length / time].

    Attributes
    ----------
    velocity, acceleration, force : ndarray (n_owned, d)
        State at the end of the last step: v, a and q.
    begun : bool
        Whether there has been one.
    damps, controls : bool
        Whether the integrator takes energy from motions that steps are too long for, and whether the local error
        controls the length of steps.
    carried : float
        Largest norm of the velocity so far, sqrt(v M v), where the length of steps asks for it.
    """

    name, changes, holds = "inertia", False, True

    def __init__(self, space, mass, damping, weights, initial, step_error=None):
        self.space, self.mass, self._damping, self._weights, self._initial = space, mass, damping, weights, initial
        self._allowed, self.carried = step_error, 0.0
        self.velocity, self.acceleration, self.force = (np.zeros((space.n_owned, space.dim)) for _ in STATE)
        # of the last step; whether it goes on: if not, forces are those of the state
        self._since, self._size, self._begin, self._goes_on = 0.0, 0.0, np.zeros_like(self.velocity), False
        # a step, and the tangent of steps of this size
        self._linear = np.nan, None
        self.begun, self.damps, self.controls = False, weights.velocity[1] > 0.5, step_error is not None

    # -- a step -----------------------------------------------------------------------------------------------------

    def expected(self, u, time):
        """Where nodes are (n_owned, d) at a time with the velocity that they have [length]; accelerations of what
        touches jump from step to step, and say less than nothing of the next one."""
        return self.space.of_owned(u) + (time - self._since) * self.velocity

    def detect(self, u, time, motion=0.0, ahead=None):
        """A step to a time begins at ``u``."""
        self._size, self._begin = time - self._since, self.space.of_owned(u).copy()
        self._goes_on = self._size > 0.0

    def error(self, u):
        """Of the velocity, from the change of the acceleration in the step: what the integrator takes of dt^3 u''' less
        what a Taylor series does; over the allowed part of the largest velocity so far. *Collective.*"""
        if self._allowed is None or not self._goes_on:
            return 0.0
        acceleration, velocity = self._motion(u)
        change = acceleration - self.acceleration
        wrong, fast = (np.sqrt(self._work(self.mass.times(one), one)) for one in (change, velocity))
        self.carried = max(self.carried, fast)
        return self._weights.error * self._size * wrong / max(self._allowed * self.carried, np.finfo(float).tiny)

    def commit(self, u, time):
        """The step has ended at ``u``. *Collective.*"""
        if self._goes_on:
            acceleration, velocity = self._motion(u)
            self.force = self._forces(acceleration)
            self.velocity, self.acceleration = velocity, acceleration
        self._since, self._goes_on = time, False

    def _motion(self, u):
        """Acceleration and velocity (n_owned, d) at the end of the step."""
        size, (first, last), (own, then) = self._size, self._weights.displacement, self._weights.velocity
        way = self.space.of_owned(u) - self._begin
        acceleration = (way - size * self.velocity - size**2 * first * self.acceleration) / (size**2 * last)
        return acceleration, self.velocity + size * (own * self.acceleration + then * acceleration)

    def _forces(self, acceleration):
        """q1 (n_owned, d) of the acceleration at the end of the step. *Collective.*"""
        mass, force = self._weights.mass, self._weights.force
        product = self.mass.times((1.0 - mass) * acceleration + mass * self.acceleration)
        return (product - force * self.force) / (1.0 - force)

    def _drag(self, velocity):
        """C v (n_owned, d), or 0. *Collective.*"""
        return 0.0 if self._damping is None else self.mass.times(velocity, self._damping)

    def _sum(self, u):
        """C v + q (n_owned, d) at ``u``, or of the state between steps. *Collective.*"""
        if not self._goes_on:
            return self._drag(self.velocity) + self.force
        acceleration, velocity = self._motion(u)
        return self._drag(velocity) + self._forces(acceleration)

    def pattern(self):
        """That of the mass."""
        return self.mass.rowptr, self.mass.columns

    def residual(self, u, out, rule=LAW):
        """Add C v + q to ``out`` (n_owned, d). *Collective.*"""
        out += self._sum(u)

    def drag(self, u, out):
        """Add the forces of inertia and damping on the bodies to ``out`` (n_owned, d) [force]. *Collective.*"""
        out -= self._sum(u)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        if self._size == 0.0:
            return
        size, (first, last) = self._size, self._weights.displacement
        way = np.abs(self.space.of_owned(u)) + np.abs(self._begin) + size * np.abs(self.velocity)
        way += size**2 * abs(first) * np.abs(self.acceleration)
        out += self.mass.magnitude(way / (size**2 * last))

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`, the same object for steps of the same size; between steps none, for
        small motions about the state."""
        size, weights = self._size if self._goes_on else 0.0, self._weights
        if size != self._linear[0]:
            last = size * weights.displacement[1]
            mass = 0.0 if size == 0.0 else (1.0 - weights.mass) / (1.0 - weights.force) / (size * last)
            values = mass * self.mass.values
            if self._damping is not None and size > 0.0:
                values += weights.velocity[1] / last * self.mass.spread(self._damping)
            self._linear = size, values
        return self._linear[1]

    # -- the beginning ----------------------------------------------------------------------------------------------

    def start(self, problem, u, time, end):
        """Begin at a time, unless that has been done, with displacement and velocity of the nodes; and let them move on
        from there as what is prescribed does: it may move at once, or its amplitudes have a corner. *Collective.*

        Nodes whose motion is prescribed take up a velocity at once, and so the others get an impulse: the motion that
        follows is the nearest one, in the norm of the mass, that supports and groups admit. The acceleration is the one
        that the forces leave then.

        Parameters
        ----------
        problem : pcontact.solve.problem.Problem
            This item among its own.
        u : PETSc.Vec
            The committed displacement; overwritten.
        time, end : float
            Of the coming step: what is prescribed is smooth in it.

        Returns
        -------
        bool
            Whether velocity or acceleration are others than before.
        """
        fresh = not self.begun
        if fresh:
            self._enter(problem, u, time)
        before, (velocity, acceleration) = self.velocity, self._given(problem, u, time, end)
        if not fresh:
            wrong = self._barred(problem, before - velocity)
            wrong += (end - time) * self._barred(problem, self.acceleration - acceleration)
            if self.space.longest(wrong) <= CORNER * max(map(self.space.longest, (before, velocity))):
                return False
        matrix = self.mass.matrix(problem)
        self.velocity = velocity + self._accelerated(problem, matrix, self.mass.times(before - velocity))
        forces = self.force + self._drag(before - self.velocity) - self.mass.times(acceleration)
        self.acceleration = acceleration + self._accelerated(problem, matrix, forces)
        self.force = self.mass.times(self.acceleration)
        return True

    def _enter(self, problem, u, time):
        """Displacement and velocity at the beginning, and the forces of all others there. *Collective.*"""
        self._since, self._goes_on, self.begun, problem.time = time, False, True, time
        displacement, velocity = self._initial(time)
        moved = displacement is not None
        if moved:
            u.setArray(displacement.ravel())
        # what supports and groups prescribe holds from the beginning
        problem.conditions.enter(u, time)
        for at in (None, u) if moved else (u,):
            for item in problem.items:
                where = problem.undeformed(item) if at is None else at
                item.detect(where, time)
                if moved:
                    item.commit(where, time)
        self.velocity, self.acceleration, self.force = velocity, *(np.zeros_like(velocity) for _ in range(2))
        self.force = -problem.unbalanced(u)

    def _given(self, problem, u, time, end):
        """Velocity and acceleration (n_owned, d) of what is prescribed, right after a time, by the polynomial through
        what it is in the step; 0 of what is free. *Collective.*"""
        size, ways = (end - time) / (len(STENCIL) - 1), []
        for k in range(len(STENCIL)):
            then = u.copy()
            problem.conditions.enter(then, time + k * size)
            ways.append(self.space.of_owned(then) - (ways[0] if ways else 0.0))
            then.destroy()
        ways[0] = np.zeros_like(ways[0])
        first, second = np.tensordot(np.linalg.inv(np.vander(STENCIL, increasing=True))[1:3], ways, 1)
        return first / size, 2.0 * second / size**2

    def _barred(self, problem, motion):
        """What supports and groups do not admit of a motion (n_owned, d), as it is between two that they prescribe.
        *Collective.*"""
        vector = self.space.vector(motion)
        problem.conditions.follow(vector)
        return motion - self.space.of_owned(vector)

    def _accelerated(self, problem, matrix, forces):
        """Accelerations (n_owned, d) by forces, overwritten, or velocities by impulses; 0 of what is prescribed.
        *Collective.*"""
        problem.conditions.condense(forces)
        left = matrix.solved(forces, MASS_RTOL, 10000)
        problem.conditions.follow(left)
        return self.space.of_owned(left).copy()

    def fields_of_nodes(self):
        """Velocity and acceleration."""
        return {name: getattr(self, name) for name in STATE[:2]}

    # -- energy -----------------------------------------------------------------------------------------------------

    def _work(self, forces, motion):
        return self.space.comm.allreduce(float(np.sum(forces * motion)), op=MPI.SUM)

    def kinetic(self):
        """Kinetic energy of the state [force * length]. *Collective.*"""
        return 0.5 * self._work(self.mass.times(self.velocity), self.velocity)

    def damped(self, u):
        """What damping takes up in the step that goes on to ``u``, by the trapezoidal rule, on this rank
        [force * length]. *Collective.*"""
        if self._damping is None:
            return 0.0
        velocity = self._motion(u)[1]
        return 0.5 * float(np.sum(self._drag(self.velocity + velocity) * (self.space.of_owned(u) - self._begin)))

    def report(self, u):
        """Momentum, and moment of momentum about the origin. *Collective.*"""
        space, momentum = self.space, self.mass.times(self.velocity)
        places = space.points[space.owned_local] + self.space.of_owned(u)
        about = np.atleast_1d(moments(places, momentum))
        sums = space.comm.allreduce(np.concatenate([momentum.sum(axis=0), about]), op=MPI.SUM)
        d = space.dim
        result = {"momentum": sums[:d].tolist()}
        if not space.axisymmetric:
            result["moment_of_momentum"] = sums[d:].tolist() if d == 3 else float(sums[d])
        return {"inertia": result}

    # -- a checkpoint -----------------------------------------------------------------------------------------------

    def memory_keys(self):
        """Numbers (n_owned,) of the owned nodes."""
        return self.space.keys

    def memory(self):
        """Velocity, acceleration and force."""
        return {name: (self.memory_keys(), getattr(self, name)) for name in STATE}

    def recall(self, name, chunks):
        """See :meth:`pcontact.assembly.item.Item.recall`."""
        if name not in STATE:
            return None
        values, self.begun = np.zeros_like(self.velocity), True
        count = take_rows(self.memory_keys(), chunks, values)
        setattr(self, name, values)
        return count


class Snap(Inertia):
    """Inertia at a standing load, which leads bodies without an equilibrium near by to the next one: backward Euler,
    whose steps grow as long as they are easy, and which therefore ends where inertia plays no part any more.

    It has a time of its own; in load steps it is not there.

    Parameters
    ----------
    space : pcontact.space.space.Space
    mass : pcontact.assembly.mass.Mass
    first : float
        First step of a motion [time].
    bulk : pcontact.assembly.solid.Bulk
        The bodies, whose energy says what the steps of a motion, which may be long, have taken.

    Attributes
    ----------
    taken : pcontact.assembly.viscous.Sum
        Energy that motions have set free so far, and that is gone [force * length].
    steps : int
        Of the last motion.
    """

    name = "snap"

    def __init__(self, space, mass, first, bulk):
        super().__init__(space, mass, None, INTEGRATORS["euler"].weights(None), None)
        self._first, self._step, self._largest, self.taken, self.steps = first, 0.0, 0.0, Sum(), 0
        self._bulk, self._stresses, self._energy = bulk, self._begin, 0.0

    @property
    def moves(self):
        """Whether bodies have inertia."""
        return self._step > 0.0

    @property
    def holds(self):
        """Whether it resists motions: while bodies have inertia."""
        return self.moves

    def release(self):
        """Bodies begin to move from rest."""
        self.velocity, self.acceleration, self.force = (np.zeros_like(self.velocity) for _ in STATE)
        self._step, self._largest, self.steps = self._first, 0.0, 0

    def hold(self):
        """Take inertia away; the step with which a motion would go on."""
        step, self._step, self._size, self._goes_on = self._step, 0.0, 0.0, False
        return step

    def go_on(self, step):
        """The motion goes on, with a step of this size [time]."""
        self._step = step

    def shorten(self):
        """Halve the step; whether it is long enough yet."""
        self._step *= 0.5
        return self._step >= LEAST_MOTION * self._first

    def rests(self, iterations):
        """Whether bodies rest, after a step of the motion with some iterations of Newton's method. *Collective.*"""
        self.steps += 1
        self._step *= 2.0 if iterations <= EASY_MOTION else 1.0
        now = float(np.sqrt(self._work(self.force, self.force)))
        self._largest = max(self._largest, now)
        return now <= REST_FORCE * self._largest

    def expected(self, u, time):
        """None: bodies that snap do not go on as they do."""
        return None

    def detect(self, u, time, motion=0.0, ahead=None):
        """A step of the motion, or a load step, begins at ``u``."""
        self._size, self._begin, self._goes_on = self._step, self.space.of_owned(u).copy(), self.moves
        if self.moves:
            self._stresses, self._energy = self._held(u)

    def _held(self, u):
        """Forces (n_owned, d) of the stresses and energy of the bodies, at a committed displacement. *Collective.*"""
        stresses = np.zeros_like(self._begin)
        self._bulk.residual(u, stresses)
        return stresses, sum(self._bulk.energies(u))

    def commit(self, u, time):
        """Count what the step has taken: what others have done on the bodies and these do not hold. *Collective.*"""
        if not self._goes_on:
            return
        before, way = self.force, self.space.of_owned(u) - self._begin
        super().commit(u, time)
        stresses, energy = self._held(u)
        done = 0.5 * self._work(before + self.force + self._stresses + stresses, way)
        self.taken.carried += done - (energy - self._energy)

    def residual(self, u, out, rule=LAW):
        """Add the forces of inertia to ``out`` (n_owned, d). *Collective.*"""
        if self._goes_on:
            super().residual(u, out, rule)

    def drag(self, u, out):
        """Add them to ``out`` (n_owned, d), on the bodies [force]. *Collective.*"""
        if self._goes_on:
            super().drag(u, out)

    def report(self, u):
        """Energy that motions have set free so far."""
        return {"snaps": {"energy": self.taken.carried}}

    def fields_of_nodes(self):
        """None: in load steps bodies rest."""
        return {}

    def memory_keys(self):
        """None: nothing of a motion outlives it."""
        return None

    def memory(self):
        """Nothing."""
        return {}
