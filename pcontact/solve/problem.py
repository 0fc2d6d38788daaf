"""The discrete problem: sums the items into a residual and a matrix, with supports, external forces, and points of all
items that open and close."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import is_not

import numpy as np

from pcontact.assembly.item import FROZEN, LAW, active_set
from pcontact.assembly.matrix import ConstrainedMatrix, GlobalMatrix, JoinedPattern
from pcontact.runtime import profile
from pcontact.runtime.petsc import MPI


class EssentialConditions:
    """Prescribed components of the displacement, and those that follow others.

    Parameters
    ----------
    space : pcontact.space.space.Space
    supports : pcontact.space.supports.Supports
    features : pcontact.solve.problem.Features
        Its `release` says how far supports have begun beside what they prescribe.

    Attributes
    ----------
    fixed : ndarray (n_owned, d) of bool
        Prescribed components.
    groups : sequence of pcontact.space.constraints.RigidGroup
        Whose displacement is rigid, sections, and equations: Newton's method has their leading components.
    matrix : GlobalMatrix or ConstrainedMatrix
        Of the unknowns, without entries.
    followers : ndarray (n_owned, d) of bool or None
        Components that follow others and are none of the linear system's; None without any.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, supports, features):
        self._space, self.supports, self.groups, self._features = space, supports, supports.groups, features
        self.fixed = np.ascontiguousarray(supports.fixed[space.owned_local])
        self.matrix = self.new_matrix()
        self.followers = self.matrix.follows if self.groups else None

    def new_matrix(self):
        """A matrix of the unknowns, without entries. *Collective.*"""
        space, fixed = self._space, self.supports.fixed
        return ConstrainedMatrix(space, fixed, self.groups) if self.groups else GlobalMatrix(space, fixed)

    def _values(self, time):
        """Prescribed displacements (n_owned, d) [length]. *Collective.*"""
        values = self.supports.values(time)[self._space.owned_local]
        release = self._features.release
        return values if release is None else values + release.shift(time)

    def enter(self, u, time):
        """Enter the prescribed displacements of a time into ``u``. *Collective.*"""
        values = self._values(time)
        array = u.getArray().reshape(values.shape)
        array[self.fixed] = values[self.fixed]
        for group in self.groups:
            group.enter(array, time)
        u.assemble()

    def imposed(self, u, time):
        """Largest change that the prescribed displacements make to ``u`` [length]. *Collective.*"""
        values = self._values(time)
        before = u.getArray(readonly=True).reshape(values.shape)
        change = np.where(self.fixed, values - before, 0.0)
        if self.groups:
            after = before.copy()
            for group in self.groups:
                group.enter(after, time)
            change += after - before
        return self._space.longest(change)

    def follow(self, y, x=None, start=None):
        """Prescribed components stay where they are in a step ``y``; what follows others does so. *Collective.*

        Parameters
        ----------
        y : PETSc.Vec
        x, start : PETSc.Vec, optional
            Displacements: from ``x`` the step ``-y`` goes on, in ``start`` components followed, and so they do after
            the step. No residual tells of the rounding errors that larger iterates have left in those that follow.
        """
        array = y.getArray().reshape(self.fixed.shape)
        array[self.fixed] = 0.0
        if self.followers is not None:
            before = 0.0
            if x is not None:
                before = (x.getArray(readonly=True) - start.getArray(readonly=True)).reshape(array.shape)
            after = before - array
            for group in self.groups:
                group.follow(after)
            array[self.followers] = (before - after)[self.followers]
        y.assemble()

    def condense(self, out):
        """Leave of forces (n_owned, d) what supports and groups do not bear, in place: zero at prescribed components
        and at those that follow, whose forces go to the others. *Collective.*"""
        out[self.fixed] = 0.0
        for group in self.groups:
            group.lead(out)
        if self._features.equations is not None:
            # some of what follows goes along with what is prescribed
            out[self.fixed] = 0.0


# [-] So many rounding errors of the sum of magnitudes, an exact solution would leave. From: sums of
# some eighty terms, whose rounding errors add up as the square root of their number.
ROUNDINGS = 8.0


class Forces:
    """Forces on the bodies of a problem at its time.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    loads : list of (ndarray (n_owned, d), callable)
        Nodal forces at factor 1 and their factor of time.

    Notes
    -----
    Whatever sums over nodes or components is the same on every rank.
    """

    def __init__(self, problem, loads):
        self._problem, self._space, self.loads = problem, problem.space, loads

    def _zero(self):
        return np.zeros((self._space.n_owned, self._space.dim))

    def external(self, time=None):
        """Nodal external forces (n_owned, d) at a time, or that of the problem [force]. *Collective.*"""
        total, time = self._zero(), self._problem.time if time is None else time
        for force, amplitude in self.loads:
            total += amplitude.factor(time) * force
        for load in self._problem.features.timed:
            total += load.at(time)
        return total

    def applied(self, u, springs=True):
        """Nodal external forces (n_owned, d), with those that depend on the displacement, of springs or without them
        [force]. *Collective.*"""
        total, left_out = self.external(), () if springs else self._problem.features.springs
        for item in self._problem.others:
            if item not in left_out:
                item.external(u, total)
        return total

    def _drag(self, u):
        """Forces (n_owned, d) on the bodies that answer their motions [force]. *Collective.*"""
        out = self._zero()
        for item in self._problem.others:
            item.drag(u, out)
        return out

    def norm(self, forces):
        """Norm over all ranks of forces (n_owned, d) [force]. *Collective.*"""
        return float(np.sqrt(self._space.comm.allreduce(float(np.sum(forces**2)))))

    def _magnitude(self, u):
        """Sums of the absolute terms of the residual at ``u`` (n_owned, d) [force]. *Collective.*"""
        size = self._zero()
        for item in self._problem.items:
            item.add_magnitude(u, size)
        return size

    def roundoff(self, u):
        """Norm of the rounding errors that the residual at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * self.norm(self._magnitude(u))

    def roundoff_of(self, u):
        """The same for the forces on every component (n_components,) [force]. *Collective.*"""
        return np.finfo(float).eps * self._space.norms(self._magnitude(u))

    def rounding_of_sum(self, u):
        """Rounding errors that the sum of all forces at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * float(np.linalg.norm(self._space.comm.allreduce(self._magnitude(u).sum(axis=0))))

    def loaded(self, u, springs=True):
        """Norm of :meth:`applied` at ``u`` [force]. *Collective.*"""
        return self.norm(self.applied(u, springs))

    def acting(self, u):
        """Largest of the norms of the external forces, and of those of the stresses at ``u`` where nodes are supported
        and where they are free [force]. *Collective.*

        At equilibrium supports and contact bear them. What contact says at ``u`` is no measure: it is gamma times a
        gap, of which rounding errors may be all.
        """
        external, stresses = self.applied(u), self._zero()
        self._problem.bulk.residual(u, stresses)
        held = np.where(self._problem.conditions.fixed, stresses, 0.0)
        return max(self.norm(external), self.norm(held), self.norm(stresses - held))

    def stiffness_scale(self, u):
        """Norm of the sums of the absolute terms of the bodies' forces at ``u`` [force]: residuals that are small
        against it leave displacements open that are small against ``u``. *Collective.*"""
        size = self._zero()
        self._problem.bulk.add_magnitude(u, size)
        return self.norm(size)

    def by_component(self, u):
        """Sums of the magnitudes of the external forces on every component (n_components,) at ``u`` [force].
        *Collective.*
        """
        return self._space.by_component(np.linalg.norm(self.applied(u), axis=1))

    def worst(self, f):
        """Find where a residual vector is largest. *Collective.*

        Parameters
        ----------
        f : PETSc.Vec

        Returns
        -------
        value : float
            [force]
        point : ndarray (d,)
            Reference position [length].
        body : str
        """
        space, mesh = self._space, self._space.mesh
        size = np.linalg.norm(space.of_owned(f), axis=1)
        size = np.where(np.isfinite(size), size, np.inf)
        own, k = (-1.0, None, ""), int(np.argmax(size)) if len(size) else -1
        if k >= 0:
            node = space.owned_local[k]
            own = (float(size[k]), space.points[node], mesh.component_names[space.component[node]])
        return max(space.comm.allgather(own), key=lambda entry: entry[0])

    def resultant(self, record, u):
        """Norm of the sum of all forces on the bodies at ``u`` [force]: zero at equilibrium. *Collective.*

        Parameters
        ----------
        record : dict
            With ``reactions`` and ``contacts`` of a step, and ``couplings`` and ``equations`` where there are some.
        u : PETSc.Vec
        """
        total = self._space.comm.allreduce((self.applied(u) + self._drag(u)).sum(axis=0))
        obstacles = {contact.name for contact in self._problem.contacts if contact.rigid}
        forces = [*record["reactions"].values()]
        forces += [-np.asarray(pair["force"]) for name, pair in record["contacts"].items() if name in obstacles]
        forces += [group["force"] for group in record.get("couplings", {}).values()]
        forces += [record["equations"]["force"]] if "equations" in record else []
        total = total + np.sum(forces, axis=0)
        if self._space.axisymmetric:
            total[0] = 0.0  # radial forces are borne by the ring
        return float(np.linalg.norm(total))

    def sum_of_magnitudes(self, u, borne):
        """Sum of the magnitudes of all forces on the bodies at ``u`` [force]: what their resultant is compared with,
        for forces that balance each other, of rings, shrink fits, clamped bodies, leave no resultant. *Collective.*

        They are those of supports and groups at their nodes, those of contact at its points, on both bodies, those of
        loads, springs and dashpots at nodes; where nothing is applied and nothing touches, those of thermal stress.

        Parameters
        ----------
        u : PETSc.Vec
        borne : ndarray (n_owned, d)
            By supports and groups [force].
        """
        acting, answers = [self.external()], [borne, self._drag(u)]
        for item in self._problem.others:
            forces = answers if item in self._problem.features.springs else acting
            forces.append(np.zeros_like(borne))
            item.external(u, forces[-1])
        heat = [] if self._problem.bulk.heat is None else [self._problem.bulk.heat.forces]
        own = [sum(float(np.linalg.norm(one, axis=1).sum()) for one in forces) for forces in (acting, answers, heat)]
        acts, answer, thermal = self._space.comm.allreduce(np.array(own))
        acts += float(np.sum(self._problem.active.borne(u)))
        return float(acts + answer + (thermal if acts == 0.0 else 0.0))

    def acts(self, u, borne, roundings):
        """Return whether loads act on the bodies, or forces of supports and groups that are no rounding errors.
        *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        borne : ndarray (n_owned, d)
            By supports and groups [force].
        roundings : float
            So many rounding errors are no force.
        """
        return self.loaded(u) > 0.0 or self.norm(borne) > roundings * self.roundoff(u)

    def reactions(self, u, unbalanced=None):
        """Support forces that the surroundings exert, by region. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        unbalanced : ndarray (n_owned, d), optional
            What the problem's `unbalanced` said of it before the state was committed [force].

        Returns
        -------
        dict of str to list of float
        """
        problem, own = self._problem, self._space.owned_local
        supports = problem.conditions.supports
        forces = problem.unbalanced(u) if unbalanced is None else unbalanced
        which = supports.which[own]
        table = np.zeros((len(supports.regions), self._space.dim))
        for number in range(len(supports.regions)):
            table[number] = np.where(which == number, forces, 0.0).sum(axis=0)
        table = self._space.comm.allreduce(table)
        result = {}
        for region, row in zip(supports.regions, table, strict=True):
            result[region] = (np.asarray(result.get(region, 0.0)) + row).tolist()
        return result

    def moments(self, u, unbalanced):
        """Moments of the reactions of supports that turn, about their centres, by region. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        unbalanced : ndarray (n_owned, d)
            As for :meth:`reactions`.

        Returns
        -------
        dict of str to float or list of float
            [force * length]
        """
        moved = u.getArray(readonly=True).reshape(unbalanced.shape)
        supports = self._problem.conditions.supports
        own = supports.moments(self._problem.time, self._space.owned_local, moved, unbalanced)
        return {supports.regions[k]: self._space.comm.allreduce(value).tolist() for k, value in own.items()}


class Prediction:
    """Beginning of the load steps of a problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem

    Attributes
    ----------
    committed : PETSc.Vec or None
        Displacement of which the stresses are those of the prediction; None where the load step begins without one.
    goes_on : bool
        Whether the load step begins where the bodies are if they go on as they did.
    imposing : float
        Norm of the residual [force] where it would begin else, of small strain: what is prescribed alone has moved.
    """

    def __init__(self, problem):
        self._problem, self.committed, self._changed = problem, None, frozenset()
        self.goes_on, self.imposing = False, 0.0

    @property
    def continues(self):
        """Return whether load steps begin where the bodies are if they go on as they did, once they have moved: bodies
        with finite strain, and elastic ones that nothing but supports, loads and contact moves."""
        problem, bulk = self._problem, self._problem.bulk
        if bulk.extrapolates:
            return True
        return not (problem.linear or bulk.yields or any(item.floats or item.holds for item in problem.others))

    def begin(self, u, time, ahead=None):
        """Enter the prescribed displacements of a time into ``u``, the committed displacement so far. *Collective.*

        Decides whether the load step begins with a prediction: where bodies may yield, where supports that move alone
        open or close points, and where bodies have finite strain. These, and elastic ones, begin where they are if they
        go on as they did (`ahead`), unless they cannot be there: from a committed state they would have to turn by a
        whole load step.
        """
        problem, bulk, conditions = self._problem, self._problem.bulk, self._problem.conditions
        moves = not problem.linear and conditions.imposed(u, time) > 0.0
        before = u.copy() if bulk.yields or moves or bulk.extrapolates else None
        self.goes_on = self.continues and ahead is not None and (not bulk.extrapolates or problem.integrable(ahead))
        self.imposing = 0.0
        if self.goes_on:
            if not bulk.extrapolates:
                # what is prescribed alone says how large forces are that are to be balanced
                conditions.enter(u, time)
                forces = u.duplicate()
                problem.residual(u, forces)
                self.imposing = forces.norm()
            if before is not None:
                ahead.copy(before)
            ahead.copy(u)
        conditions.enter(u, time)
        self._changed = problem.active.changed_by_supports(before, u) if moves else frozenset()
        self.committed = before if bulk.yields or self._changed or bulk.extrapolates else None

    def expect(self, u, expected):
        """Begin the load step where the bodies are expected, but for what is prescribed, and what follows others: it
        does so from the first iterate on. *Collective.*

        Parameters
        ----------
        u, expected : PETSc.Vec
            ``u`` is overwritten.
        """
        expected.copy(u)
        self._problem.conditions.enter(u, self._problem.time)
        # nothing is left to predict, and the first residual says nothing of the forces
        self.committed, self.goes_on = None, True

    @property
    def rules(self):
        """Status rules: bodies that go on as they did bring their points along; else see :meth:`residual`.
        *Collective.*"""
        active = self._problem.active
        return active.by_law if self.goes_on else active.frozen(self._changed)

    def residual(self, u, f):
        """Residual vector at the beginning of a load step, for bodies that do not yield on the way, and points that
        stay open or closed. *Collective.*

        The prescribed nodes have moved there and their neighbours have not. Taken at its word, that strains a row of
        cells far beyond the yield stress and makes their tangent soft; elastic cells pass the motion on to the bodies.
        Points at or near those nodes would open or close, which the bodies' motion undoes at once. Obstacles have
        moved, too: where one goes back, all points would open, and the bodies spring back and hit again.
        """
        problem = self._problem
        out = -problem.forces.external()
        with profile.phase("bulk_assembly"):
            problem.bulk.predict(u, self.committed, out)
        problem.add_others(u, out, self.rules)
        problem.as_residual(out, f)


@dataclass(frozen=True)
class Features:
    """Parts of a problem beside bodies, contact and loads that stay as they are; some of them are among its items.

    Attributes
    ----------
    timed : sequence of pcontact.assembly.loads.TimedLoad
        External forces whose distribution depends on the time.
    total : sequence of pcontact.assembly.coupling.TotalLoad
        Loads of which the report has resultant and mean motion.
    springs : sequence of pcontact.assembly.springs.GroundSprings
    sections : sequence of pcontact.space.constraints.PretensionSection
    averages : sequence of pcontact.assembly.coupling.AverageCoupling
        Groups whose mean motion is prescribed; their equations are among the others.
    equations : pcontact.space.constraints.Equations or None
    lower : pcontact.space.constraints.Equations or None
        Those of nodes in the middles of bodies of degree 1 alone.
    release : pcontact.assembly.phases.Release or None
        The item of what a phase of the run goes on from.
    inertia : pcontact.assembly.inertia.Inertia or None
    viscous : pcontact.assembly.viscous.ViscousStabilisation or None
    since : dict of str to int
        Number of the phase at whose beginning the bodies of a contact are as they are in the mesh, by its name.
    loose : sequence of int
        Bodies whose rigid motions get a coarse space, see `pcontact.solve.preconditioners`.
    stabilised : bool
        Whether the stabilisation is added to the matrix.
    snap : pcontact.assembly.inertia.Snap or None
        That of static load steps that find no equilibrium.
    """

    timed: Sequence = ()
    total: Sequence = ()
    springs: Sequence = ()
    sections: Sequence = ()
    averages: Sequence = ()
    equations: object = None
    lower: object = None
    release: object = None
    inertia: object = None
    viscous: object = None
    since: Mapping = field(default_factory=dict)
    loose: Sequence = ()
    stabilised: bool = True
    snap: object = None


class Problem:
    """Residual and generalised Jacobian of one load step.

    Parameters
    ----------
    space : pcontact.space.space.Space
    items : list of pcontact.assembly.item.Item
        The bulk comes first.
    supports : pcontact.space.supports.Supports
    loads : list of (ndarray (n_owned, d), callable)
        Nodal forces at factor 1 and their factor of time.
    stabilisation : ndarray (n_owned,)
        Added to the diagonal of the matrix, never to the residual: steadies bodies that nothing holds yet.
    contacts : list of pcontact.contact.report.ContactReport, optional
        Of the contact pairs among the items.
    features : Features, optional

    Attributes
    ----------
    time : float
        Time at which the load step ends.
    conditions : pcontact.solve.problem.EssentialConditions
        What is prescribed of the displacement.
    forces : pcontact.solve.problem.Forces
        Loads, reactions, and how large forces are.
    active : pcontact.solve.problem.ActiveSets
        Points that open and close, and the rules that they follow.
    prediction : pcontact.solve.problem.Prediction
        How load steps begin.
    linear : bool
        Whether one linear solve is the answer: no item changes with the displacement.
    pattern_changes : int
        How often the pattern of the matrix has changed.
    """

    def __init__(self, space, items, supports, loads, stabilisation, contacts=(), features=None):
        self.space, self.items, self.bulk, self.others = space, items, items[0], items[1:]
        self.features, self.contacts, self.time = Features() if features is None else features, list(contacts), 0.0
        self.conditions = EssentialConditions(space, supports, self.features)
        self.matrix, self.stabilisation = self.conditions.matrix, stabilisation
        self._added = stabilisation if self.features.stabilised else np.zeros_like(stabilisation)
        self.linear = not any(item.changes for item in items)
        self.active = ActiveSets(space, self.others, self.bulk.yields)
        self.forces, self.prediction = Forces(self, loads), Prediction(self)
        self._versions, self.pattern_changes, self._terms, self._bodies = None, 0, [], None

    @property
    def parts(self):
        """Parts that report, remember and are counted as one: the items, those of a contact together."""
        pairs = {id(pair) for contact in self.contacts for pair in contact.pairs}
        return [*(item for item in self.items if id(item) not in pairs), *self.contacts]

    def undeformed(self, item):
        """Displacement at which the gap of a contact is that between the undeformed bodies, a vector: zero but for
        bodies that have begun in a later phase than the first. *Collective.*"""
        number = self.features.since.get(item.name, 0)
        return self.features.release.origin(number) if number else self.space.vector()

    def angle(self, start, end):
        """Largest angle by which supports or obstacles turn between two times [radian]."""
        return max([self.conditions.supports.turned(start, end), *(item.angle(start, end) for item in self.others)])

    def integrable(self, u):
        """Return whether all points of the bodies can be integrated: no cell is turned inside out. *Collective.*"""
        out = np.zeros((self.space.n_owned, self.space.dim))
        self.bulk.residual(u, out)
        return bool(np.isfinite(self.forces.norm(out)))

    def unbalanced(self, u, rules=None):
        """Internal plus contact minus external forces (n_owned, d); reactions where prescribed. *Collective.*"""
        out = -self.forces.external()
        with profile.phase("bulk_assembly"):
            self.bulk.residual(u, out)
        self.add_others(u, out, rules)
        return out

    def add_others(self, u, out, rules=None):
        """Add the forces of all items but the bulk to ``out`` (n_owned, d). *Collective.*"""
        with profile.phase("contact_assembly"):
            for item, rule in zip(self.others, rules or self.active.by_law, strict=True):
                item.residual(u, out, rule)

    def residual(self, u, f, rules=None):
        """Residual vector: zero at prescribed components. *Collective.*"""
        self.as_residual(self.unbalanced(u, rules), f)

    def as_residual(self, out, f):
        """Forces (n_owned, d), overwritten, as a residual vector: zero at prescribed components and at those that
        follow. *Collective.*"""
        self.conditions.condense(out)
        f.setArray(out.ravel())

    def tangent(self, u, rules=None, predicted=False, added=None):
        """Write the generalised Jacobian at ``u``, or that of the prediction, into the matrix. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        rules : tuple of pcontact.assembly.item.StatusRule, optional
        predicted : bool
        added : ndarray (n_owned,), optional
            What is added to the diagonal in the place of the stabilisation.
        """
        rules = self.prediction.rules if predicted else (rules or self.active.by_law)
        with profile.phase("contact_assembly"):
            values = [item.tangent(u, rule) for item, rule in zip(self.others, rules, strict=True)]
        with profile.phase("bulk_assembly"):
            stiffness = self.bulk.tangent(self.prediction.committed if predicted else u)
        with profile.phase("matrix"):
            versions = [item.version for item in self.others]
            if versions != self._versions:
                self._renew()
                self._versions = versions
            self.matrix.write(*self._sums(stiffness, values), self._added if added is None else added)
        profile.mark("assembly")

    def _renew(self):
        """Items with the pattern of the bodies add to their values, and only where others are, rows are written anew
        as long as these stay the same."""
        bodies, patterns = self.bulk.pattern(), [item.pattern() for item in self.others]
        self._with_bodies = [all(map(np.array_equal, one, bodies)) for one in patterns]
        apart = [one for one, within in zip(patterns, self._with_bodies, strict=True) if not within]
        self._joined = JoinedPattern(apart, self.space.n_owned)
        if self.matrix.renew(bodies, (self._joined.rowptr, self._joined.columns)):
            self.pattern_changes += 1
            profile.spare()

    def _sums(self, stiffness, values):
        """Values (nnz, d, d) on the pattern of the bodies, the same object where they are those of the last time, and
        on that of all else."""
        terms = [stiffness, *(one for one, within in zip(values, self._with_bodies, strict=True) if within)]
        apart = [one for one, within in zip(values, self._with_bodies, strict=True) if not within]
        if len(terms) > 1 and (len(terms) != len(self._terms) or any(map(is_not, terms, self._terms))):
            self._terms, self._bodies = terms, sum(terms[1:], terms[0])
        d = self.space.dim
        return stiffness if len(terms) == 1 else self._bodies, self._joined.sum(apart) if apart else np.zeros((0, d, d))


# [points] So many, and such a part of the closed area, have to open, or to close, for a rule that takes a contact to
# grow or to recede all along its edge. Row: opening.
MANY = 12
# [-] See MANY. Row: opening.
WIDE = 0.02
# [-] Part of that area which may change the other way at the same time. Row: opening.
MIXED = 0.1
# [-] Part of the area opened since a contact began to recede that may overlap; where most of it does, the bodies do
# not lift off. Row: opening.
MOSTLY = 0.6


class ActiveSets:
    """Active sets of the items of a problem.

    A status rule (`pcontact.assembly.item.StatusRule`) for each item but the bulk is an argument of residual and
    tangent of a problem: a tuple, :attr:`by_law` if nothing is said.

    Parameters
    ----------
    space : pcontact.space.space.Space
    others : list of pcontact.assembly.item.Item
        All items but the bulk.
    yields : bool
        Whether bodies may yield.

    Attributes
    ----------
    sets : list of (pcontact.assembly.item.Item, pcontact.assembly.item.ActiveSet)
        Of the items with points that open and close.
    by_law : tuple of pcontact.assembly.item.StatusRule
        All points go by their laws.
    """

    def __init__(self, space, others, yields):
        self._space, self._others = space, others
        self._recedes = not (yields or any(item.can_slip for item in others))
        self.sets = [(item, one) for item in others if (one := active_set(item)) is not None]
        self.by_law = (LAW,) * len(others)

    def changed_by_supports(self, before, u):
        """Names of the items with points that the supports alone open or close. *Collective.*"""
        areas = np.array([one.area_changed_by_supports(before, u) for _, one in self.sets])
        areas = self._space.comm.allreduce(areas, op=MPI.SUM)
        return {item.name for (item, _), area in zip(self.sets, areas, strict=True) if area > 0.0}

    def frozen(self, changed=frozenset()):
        """Rules by which items with points closed at the end of the last load step keep them so, and the others open.
        *Collective.*

        Items without closed points go by their laws, but for those with a name that has `changed`: supports that move
        have closed some of their points.
        """
        counts = np.array([one.closed_count() for _, one in self.sets], dtype=np.int64)
        counts = self._space.comm.allreduce(counts, op=MPI.SUM)
        kept = changed | {item.name for (item, _), count in zip(self.sets, counts, strict=True) if count}
        return tuple(FROZEN if item.name in kept else LAW for item in self._others)

    def turned(self, u):
        """See :meth:`pcontact.assembly.item.ActiveSet.turned`: sums (4,) over items and ranks. *Collective.*"""
        own = sum((one.turned(u) for _, one in self.sets), np.zeros(4))
        return self._space.comm.allreduce(own, op=MPI.SUM)

    def recede(self, u, since=None):
        """Rules under which points that are open in the last tangent, or at the end ``u`` of a full Newton step, stay
        so; None where the step ends otherwise. *Collective.*

        A step has many points to open, and none to close, where a contact recedes: bodies that touch everywhere are
        pressed in one place. Taken at its word, the next step closes points far away: what is cut loose there overlaps.
        They open in the iteration after, while others overlap farther on: a false contact travels through the bodies.
        Points that do not close again cannot travel, and each iteration leaves fewer of them closed; which of them are
        to close is asked when no more open, and they are few. With friction a load step may have several solutions, and
        which of them is found depends on which points have slipped on the way: there the law holds throughout.

        Parameters
        ----------
        u : PETSc.Vec
        since : float, optional
            Closed area before the first step that such rules followed, if this one has begun under them
            [length^(d - 1)].
        """
        if not self._recedes:
            return None
        closed, opens, closes, count = self.turned(u)
        if since is None:
            goes = count >= MANY and opens > WIDE * closed and closes <= MIXED * opens
        else:
            goes = count > 0 and closes <= MOSTLY * (since - self.closed_area())
        if not goes:
            return None
        found = {id(item): one.recede(u, LAW) for item, one in self.sets}
        return None if None in found.values() else tuple(found.get(id(item), LAW) for item in self._others)

    def closed_area(self):
        """Area of all points that were closed in the last tangent [length^(d - 1)]. *Collective.*"""
        own = sum(one.closed_area() for _, one in self.sets)
        return self._space.comm.allreduce(own, op=MPI.SUM) if self.sets else 0.0

    def step_limit(self, u, y, falls=None):
        """Part of the Newton step ``-y`` that all items admit; more than 1 where loose bodies touch nothing yet.
        *Collective.* `falls` (n_components,) of bool says which bodies nothing but the stabilisation holds back in it.
        """
        if falls is None and any(item.holds for item in self._others):
            falls = np.zeros(self._space.mesh.n_components, dtype=bool)
        parts = [one.step_limit(u, y, falls) for _, one in self.sets]
        # nothing holds a loose body before it touches something: it goes there whatever its load is
        return min([part for part in parts if part is not None], default=1.0)

    def borne(self, u):
        """Sums of the magnitudes of the contact forces on every component (n_components,) [force]. *Collective.*"""
        return self._by_component(one.force_magnitudes(u) for _, one in self.sets)

    def bonds(self):
        """Forces (n_components,) that adhesion may exert on every component without pressure [force]. *Collective.*"""
        return self._by_component(one.bonds() for _, one in self.sets)

    def touched(self):
        """Area of every component (n_components,) that was closed at the end of the last load step. *Collective.*"""
        return self._by_component(one.closed_areas() for _, one in self.sets)

    def _by_component(self, parts):
        """Sum (n_components,) over ranks of arrays that are. *Collective.*"""
        return self._space.comm.allreduce(sum(parts, np.zeros(self._space.mesh.n_components)), op=MPI.SUM)
