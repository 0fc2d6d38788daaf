"""The discrete problem: sums the items into a residual and a matrix, with supports and external forces."""

import numpy as np

from pcontact.assembly.constrained import ConstrainedMatrix
from pcontact.assembly.item import FROZEN, LAW, active_set
from pcontact.assembly.matrix import GlobalMatrix
from pcontact.assembly.pattern import JoinedPattern
from pcontact.runtime import profile
from pcontact.runtime.petsc import MPI

# [-] So many rounding errors of the sum of magnitudes, an exact solution would leave. From: sums of
# some eighty terms, whose rounding errors add up as the square root of their number.
ROUNDINGS = 8.0
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


class Problem:
    """Residual and generalised Jacobian of one load step.

    Parameters
    ----------
    space : pcontact.space.space.Space
    items : list of pcontact.assembly.item.Item
        The bulk comes first.
    supports : pcontact.space.supports.Supports
    forces : list of (ndarray (n_owned, d), callable)
        Nodal forces at factor 1 and their factor of time.
    stabilisation : ndarray (n_owned,)
        Added to the diagonal of the matrix, never to the residual: steadies bodies that nothing holds yet.
    contacts : list of pcontact.contact.report.ContactReport, optional
        Of the contact pairs among the items.
    viscous : pcontact.assembly.viscous.ViscousStabilisation, optional
        Joins the items.

    Attributes
    ----------
    time : float
        Time at which the load step ends.
    active : list of (pcontact.assembly.item.Item, pcontact.assembly.item.ActiveSet)
        Items with points that open and close.
    linear : bool
        Whether the tangent is constant.
    goes_on : bool
        Whether the load step begins where the bodies are if they go on as they did.
    imposing : float
        Norm of the residual [force] where it would begin else, of small strain: what is prescribed alone has moved.
    stabilised : bool
        Whether `stabilisation` is added to the matrix.
    timed : sequence of pcontact.assembly.loads.TimedLoad
        External forces whose distribution depends on the time.
    total : sequence of pcontact.assembly.coupling.TotalLoad
        Loads of which the report has resultant and mean motion.
    springs : sequence of pcontact.assembly.springs.GroundSprings
        Those among the items.
    groups : sequence of pcontact.space.rigid.RigidGroup
        Whose displacement is rigid: Newton's method has their leading components.
    sections : sequence of pcontact.space.section.PretensionSection
        Those among the groups.
    equations : pcontact.space.equations.Equations or None
    lower : pcontact.space.equations.Equations or None
        Those of nodes in the middles of bodies of degree 1 alone.
        Those among the groups.
    release : pcontact.assembly.release.Release or None
        The item of what a phase of the run goes on from.
    averages : sequence of pcontact.assembly.average.AverageCoupling
        Groups whose mean motion is prescribed; their equations are among the others.
    since : dict of str to int
        Number of the phase at whose beginning the bodies of a contact are as they are in the mesh, by its name.
    energy : pcontact.stepping.energy.EnergyBalance or None
        What sums up the works of the load steps.
    inertia : pcontact.assembly.inertia.Inertia or None
        That among the items.
    loose : sequence of int
        Bodies whose rigid motions get a coarse space, see `pcontact.solve.preconditioners.deflation`.

    Notes
    -----
    A status rule (`pcontact.assembly.item.StatusRule`) for each item but the bulk is an argument of residual and
    tangent: a tuple, :attr:`by_law` if nothing is said.
    """

    def __init__(self, space, items, supports, forces, stabilisation, contacts=(), viscous=None):
        items = items if viscous is None else [*items, viscous]
        self.space, self.items, self.supports, self.forces = space, items, supports, forces
        self.stabilisation = stabilisation
        self.bulk, self.others, self.contacts = items[0], items[1:], list(contacts)
        self.active = [(item, one) for item in self.others if (one := active_set(item)) is not None]
        self.time, self.loose, self.stabilised, self.viscous, self.timed = 0.0, (), True, viscous, ()
        self.total, self.springs, self.sections, self.release, self.energy = (), (), (), None, None
        self.equations, self.lower, self.since, self.averages = None, None, {}, ()
        self.fixed = np.ascontiguousarray(supports.fixed[space.owned_local])
        self.groups = supports.groups
        self.matrix, self.inertia = self.new_matrix(), None
        self._versions = None
        self.pattern_changes = 0
        self._committed, self._changed, self.goes_on, self.imposing = None, set(), False, 0.0

    def new_matrix(self):
        """A matrix of the problem's unknowns, without entries. *Collective.*"""
        fixed = self.supports.fixed
        return ConstrainedMatrix(self.space, fixed, self.groups) if self.groups else GlobalMatrix(self.space, fixed)

    @property
    def linear(self):
        """Whether one linear solve is the answer: no item changes with the displacement."""
        return not any(item.changes for item in self.items)

    @property
    def yields(self):
        """Whether bodies may yield."""
        return self.bulk.yields

    @property
    def extrapolates(self):
        """Whether load steps begin where the bodies are if they go on as they did, once they have moved."""
        return self.bulk.extrapolates

    @property
    def continues(self):
        """Whether load steps begin where the bodies are if they go on as they did, once they have moved: also elastic
        bodies that nothing but supports, loads and contact moves."""
        if self.extrapolates:
            return True
        return not (self.linear or self.yields or self.inertia or any(item.floats for item in self.others))

    @property
    def parts(self):
        """What reports, remembers and is counted as one: the items, those of a contact together."""
        pairs = {id(pair) for contact in self.contacts for pair in contact.pairs}
        items = [*(item for item in self.items if id(item) not in pairs), *self.contacts]
        return items if self.energy is None else [*items, self.energy]

    def undeformed(self, item):
        """Displacement at which the gap of a contact is that between the undeformed bodies, a vector: zero but for
        bodies that have begun in a later phase than the first. *Collective.*"""
        number = self.since.get(item.name, 0)
        return self.release.origin(number) if number else self.space.vector()

    def angle(self, start, end):
        """Largest angle by which supports or obstacles turn between two times [radian]."""
        return max([self.supports.turned(start, end), *(item.angle(start, end) for item in self.others)])

    @property
    def predicts(self):
        """Whether the load step begins with what :meth:`predicted` says."""
        return self._committed is not None

    def prescribe(self, u, time, ahead=None):
        """Enter the prescribed displacements of a time into ``u``, the committed displacement so far. *Collective.*

        Decides whether the load step begins with a prediction: where bodies may yield, where supports that move alone
        open or close points, and where bodies have finite strain. These, and elastic ones, begin where they are if they
        go on as they did (`ahead`), unless they cannot be there: from a committed state they would have to turn by a
        whole load step.
        """
        moves = not self.linear and self.imposed(u, time) > 0.0
        before = u.copy() if self.yields or moves or self.extrapolates else None
        self.goes_on = self.continues and ahead is not None and (not self.extrapolates or self.integrable(ahead))
        self.imposing = 0.0
        if self.goes_on:
            if not self.extrapolates:
                # what is prescribed alone says how large forces are that are to be balanced
                self.enter(u, time)
                forces = u.duplicate()
                self.residual(u, forces)
                self.imposing = forces.norm()
            if before is not None:
                ahead.copy(before)
            ahead.copy(u)
        self.enter(u, time)
        self._changed = self._changed_by_supports(before, u) if moves else set()
        self._committed = before if self.yields or self._changed or self.extrapolates else None

    def expect(self, u, expected):
        """Begin the load step where the bodies are expected, but for what is prescribed. *Collective.*

        Parameters
        ----------
        u, expected : PETSc.Vec
            ``u`` after :meth:`prescribe`; overwritten.
        """
        array = u.getArray().reshape(self.fixed.shape)
        own = expected.getArray(readonly=True).reshape(self.fixed.shape)
        array[~self.fixed] = own[~self.fixed]
        u.assemble()
        # nothing is left to predict, and the first residual says nothing of the forces
        self._committed, self.goes_on = None, True

    def expected(self, u, time):
        """Displacement (n_owned, d) that an item expects at the end of a load step from ``u`` to a time; None."""
        return next((one for one in (item.expected(u, time) for item in self.others) if one is not None), None)

    def error(self, u):
        """Largest local error of the load step that ends at ``u``, over the one that is allowed. *Collective.*"""
        return max((item.error(u) for item in self.others), default=0.0)

    def integrable(self, u):
        """Whether all points of the bodies can be integrated: no cell is turned inside out. *Collective.*"""
        out = np.zeros((self.space.n_owned, self.space.dim))
        self.bulk.residual(u, out)
        return bool(np.isfinite(self.norm(out)))

    def _changed_by_supports(self, before, u):
        """Names of the items with points that the supports alone open or close. *Collective.*"""
        areas = np.array([one.area_changed_by_supports(before, u) for _, one in self.active])
        areas = self.space.comm.allreduce(areas, op=MPI.SUM)
        return {item.name for (item, _), area in zip(self.active, areas, strict=True) if area > 0.0}

    def _prescribed(self, time):
        """Prescribed displacements (n_owned, d) [length]. *Collective.*"""
        values = self.supports.values(time)[self.space.owned_local]
        return values if self.release is None else values + self.release.shift(time)

    def enter(self, u, time):
        """Enter the prescribed displacements of a time into ``u``. *Collective.*"""
        values = self._prescribed(time)
        array = u.getArray().reshape(values.shape)
        array[self.fixed] = values[self.fixed]
        for group in self.groups:
            group.enter(array, time)
        u.assemble()

    def imposed(self, u, time):
        """Largest change that the prescribed displacements make to ``u`` [length]. *Collective.*"""
        values = self._prescribed(time)
        before = u.getArray(readonly=True).reshape(values.shape)
        change = np.where(self.fixed, values - before, 0.0)
        if self.groups:
            after = before.copy()
            for group in self.groups:
                group.enter(after, time)
            change += after - before
        return self.space.longest(change)

    @property
    def followers(self):
        """Components (n_owned, d) that follow others and are none of the linear system's; None without any."""
        return self.matrix.follows if self.groups else None

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
        follows = self.followers
        if follows is not None:
            before = 0.0
            if x is not None:
                before = (x.getArray(readonly=True) - start.getArray(readonly=True)).reshape(array.shape)
            after = before - array
            for group in self.groups:
                group.follow(after)
            array[follows] = (before - after)[follows]
        y.assemble()

    def external(self, time):
        """Nodal external forces (n_owned, d) [force]. *Collective.*"""
        total = np.zeros((self.space.n_owned, self.space.dim))
        for force, amplitude in self.forces:
            total += amplitude.factor(time) * force
        for load in self.timed:
            total += load.at(time)
        return total

    def applied_forces(self, u, springs=True):
        """Nodal external forces (n_owned, d), with those that depend on the displacement, of springs or without them
        [force]. *Collective.*"""
        total, left_out = self.external(self.time), () if springs else self.springs
        for item in self.others:
            if item not in left_out:
                item.external(u, total)
        return total

    def unbalanced(self, u, rules=None):
        """Internal plus contact minus external forces (n_owned, d); reactions where prescribed. *Collective.*"""
        out = -self.external(self.time)
        with profile.phase("bulk_assembly"):
            self.bulk.residual(u, out)
        self._add_others(u, out, rules)
        return out

    def forces_of_items(self, u):
        """What :meth:`unbalanced` is the sum of. *Collective.*

        Returns
        -------
        forces : list of ndarray (n_owned, d)
            Minus the loads that do not depend on the displacement, the internal forces of the bodies, and those of all
            other items [force].
        unbalanced : ndarray (n_owned, d)
        """
        forces = [-self.external(self.time)]
        for item in self.items:
            with profile.phase("bulk_assembly" if item is self.bulk else "contact_assembly"):
                forces.append(np.zeros_like(forces[0]))
                item.residual(u, forces[-1])
        unbalanced = np.sum(forces, axis=0)
        return forces, unbalanced

    def _add_others(self, u, out, rules):
        with profile.phase("contact_assembly"):
            for item, rule in zip(self.others, rules or self.by_law, strict=True):
                item.residual(u, out, rule)

    def residual(self, u, f, rules=None):
        """Residual vector: zero at prescribed components. *Collective.*"""
        self.as_residual(self.unbalanced(u, rules), f)

    def extended(self, u, f, diagonal):
        """Residual vector at any ``u``, also off the supports: there it is the diagonal of the matrix, a vector, times
        the distance from what is prescribed, and all others do not hear of it. Its derivative is the matrix.
        *Collective.*
        """
        away, on = u.copy(), u.copy()
        self.enter(on, self.time)
        self.residual(on, f)
        away.axpy(-1.0, on)
        away.pointwiseMult(away, diagonal)
        f.axpy(1.0, away)

    def as_residual(self, out, f):
        """Forces (n_owned, d), overwritten, as a residual vector: zero at prescribed components and at those that
        follow, whose forces go to the others. *Collective.*"""
        self.condense(out)
        f.setArray(out.ravel())

    def condense(self, out):
        """Leave of forces (n_owned, d) what supports and groups do not bear, in place: see :meth:`as_residual`.
        *Collective.*"""
        out[self.fixed] = 0.0
        for group in self.groups:
            group.lead(out)
        if self.equations is not None:
            # some of what follows goes along with what is prescribed
            out[self.fixed] = 0.0

    def predicted(self, u, f):
        """Residual vector at the beginning of a load step, for bodies that do not yield on the way, and points that
        stay open or closed. *Collective.*

        The prescribed nodes have moved there and their neighbours have not. Taken at its word, that strains a row of
        cells far beyond the yield stress and makes their tangent soft; elastic cells pass the motion on to the bodies.
        Points at or near those nodes would open or close, which the bodies' motion undoes at once. Obstacles have
        moved, too: where one goes back, all points would open, and the bodies spring back and hit again.
        """
        out = -self.external(self.time)
        with profile.phase("bulk_assembly"):
            self.bulk.predict(u, self._committed, out)
        self._add_others(u, out, self._predicted_rules)
        self.as_residual(out, f)

    @property
    def _predicted_rules(self):
        """Bodies that go on as they did bring their points along; else see :meth:`predicted`. *Collective.*"""
        return self.by_law if self.goes_on else self.frozen()

    # -- rules for the status of points -----------------------------------------------------------------------------

    @property
    def by_law(self):
        """All points go by their laws."""
        return (LAW,) * len(self.others)

    def frozen(self):
        """Items with points closed at the end of the last load step keep them so, and the others open. *Collective.*

        Items without closed points go by their laws, unless supports that move have closed some of them.
        """
        counts = np.array([one.closed_count() for _, one in self.active], dtype=np.int64)
        counts = self.space.comm.allreduce(counts, op=MPI.SUM)
        kept = self._changed | {item.name for (item, _), count in zip(self.active, counts, strict=True) if count}
        return tuple(FROZEN if item.name in kept else LAW for item in self.others)

    def turned(self, u):
        """See :meth:`pcontact.assembly.item.ActiveSet.turned`: sums (4,) over items and ranks. *Collective.*"""
        own = sum((one.turned(u) for _, one in self.active), np.zeros(4))
        return self.space.comm.allreduce(own, op=MPI.SUM)

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
        if self.yields or any(item.can_slip for item in self.others):
            return None
        closed, opens, closes, count = self.turned(u)
        if since is None:
            goes = count >= MANY and opens > WIDE * closed and closes <= MIXED * opens
        else:
            goes = count > 0 and closes <= MOSTLY * (since - self.closed_area())
        if not goes:
            return None
        found = {id(item): one.recede(u, LAW) for item, one in self.active}
        return None if None in found.values() else tuple(found.get(id(item), LAW) for item in self.others)

    # -- tangent ----------------------------------------------------------------------------------------------------

    def tangent(self, u, rules=None, predicted=False):
        """Write the generalised Jacobian at ``u``, or that of :meth:`predicted`, into the matrix. *Collective.*"""
        rules = self._predicted_rules if predicted else (rules or self.by_law)
        with profile.phase("contact_assembly"):
            values = [item.tangent(u, rule) for item, rule in zip(self.others, rules, strict=True)]
        with profile.phase("bulk_assembly"):
            stiffness = self.bulk.tangent(self._committed if predicted else u)
        with profile.phase("matrix"):
            versions = [item.version for item in self.others]
            if versions != self._versions:
                self._renew()
                self._versions = versions
            added = self.stabilisation if self.stabilised else 0.0 * self.stabilisation
            self.matrix.write(stiffness, self._sum(values), added)
        profile.mark("assembly")

    def stiffness(self, u):
        """The matrix of small motions about a committed state, without stabilisation: points that are closed stay so,
        and stick, all others are open. *Collective.*"""
        # rows without contact are written anew, too
        self.stabilised, self._versions = False, None
        self.tangent(u, self.frozen())
        return self.matrix.matrix

    def closed_area(self):
        """Area of all points that were closed in the last tangent [length^(d - 1)]. *Collective.*"""
        own = sum(one.closed_area() for _, one in self.active)
        return self.space.comm.allreduce(own, op=MPI.SUM) if self.active else 0.0

    def _renew(self):
        self._joined = JoinedPattern([item.pattern() for item in self.others], self.space.n_owned)
        if self.matrix.renew(self.bulk.pattern(), (self._joined.rowptr, self._joined.columns)):
            self.pattern_changes += 1

    def _sum(self, values):
        d = self.space.dim
        return self._joined.sum(values) if values else np.zeros((0, d, d))

    def step_limit(self, u, y, falls=None):
        """Part of the Newton step ``-y`` that all items admit; more than 1 where loose bodies touch nothing yet.
        *Collective.* `falls` (n_components,) of bool says which bodies nothing but the stabilisation holds back in it.
        """
        if falls is None and any(item.holds for item in self.others):
            falls = np.zeros(self.space.mesh.n_components, dtype=bool)
        parts = [one.step_limit(u, y, falls) for _, one in self.active]
        # nothing holds a loose body before it touches something: it goes there whatever its load is
        return min([part for part in parts if part is not None], default=1.0)

    def _magnitude(self, u):
        """Sums of the absolute terms of the residual at ``u`` (n_owned, d) [force]. *Collective.*"""
        size = np.zeros((self.space.n_owned, self.space.dim))
        for item in self.items:
            item.add_magnitude(u, size)
        return size

    def norm(self, forces):
        """Norm over all ranks of forces (n_owned, d) [force]. *Collective.*"""
        return float(np.sqrt(self.space.comm.allreduce(float(np.sum(forces**2)))))

    def roundoff(self, u):
        """Norm of the rounding errors that the residual at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * self.norm(self._magnitude(u))

    def roundoff_of(self, u):
        """The same for the forces on every component (n_components,) [force]. *Collective.*"""
        return np.finfo(float).eps * self.space.norms(self._magnitude(u))

    def rounding_of_sum(self, u):
        """Rounding errors that the sum of all forces at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * float(np.linalg.norm(self.space.comm.allreduce(self._magnitude(u).sum(axis=0))))

    def loaded(self, u, springs=True):
        """Norm of :meth:`applied_forces` at ``u`` [force]. *Collective.*"""
        return self.norm(self.applied_forces(u, springs))

    def acting(self, u):
        """Largest of the norms of the external forces, and of those of the stresses at ``u`` where nodes are supported
        and where they are free [force]. *Collective.*

        At equilibrium supports and contact bear them. What contact says at ``u`` is no measure: it is gamma times a
        gap, of which rounding errors may be all.
        """
        external, stresses = self.applied_forces(u), np.zeros((self.space.n_owned, self.space.dim))
        self.bulk.residual(u, stresses)
        held = np.where(self.fixed, stresses, 0.0)
        return max(self.norm(external), self.norm(held), self.norm(stresses - held))

    def stiffness_scale(self, u):
        """Norm of the sums of the absolute terms of the bodies' forces at ``u`` [force]: residuals that are small
        against it leave displacements open that are small against ``u``. *Collective.*"""
        size = np.zeros((self.space.n_owned, self.space.dim))
        self.bulk.add_magnitude(u, size)
        return self.norm(size)

    def rounding_of_contacts(self, u):
        """Norm of the rounding errors of the forces of every contact at ``u`` [force], by name. *Collective.*"""
        errors = {}
        for contact in self.contacts:
            size = np.zeros((self.space.n_owned, self.space.dim))
            for pair in contact.pairs:
                pair.add_magnitude(u, size)
            errors[contact.name] = np.finfo(float).eps * self.norm(size)
        return errors

    def borne(self, u):
        """Sums of the magnitudes of the contact forces on every component (n_components,) [force]. *Collective.*"""
        return self._by_component(one.force_magnitudes(u) for _, one in self.active)

    def bonds(self):
        """Forces (n_components,) that adhesion may exert on every component without pressure [force]. *Collective.*"""
        return self._by_component(one.bonds() for _, one in self.active)

    def touched(self):
        """Area of every component (n_components,) that was closed at the end of the last load step. *Collective.*"""
        return self._by_component(one.closed_areas() for _, one in self.active)

    def _by_component(self, parts):
        """Sum (n_components,) over ranks of arrays that are. *Collective.*"""
        return self.space.comm.allreduce(sum(parts, np.zeros(self.space.mesh.n_components)), op=MPI.SUM)

    def applied(self, u):
        """Sums of the magnitudes of the external forces on every component (n_components,) at ``u`` [force].
        *Collective.*
        """
        space, size = self.space, np.linalg.norm(self.applied_forces(u), axis=1)
        own = np.bincount(space.component[space.owned_local], size, minlength=space.mesh.n_components)
        return space.comm.allreduce(own, op=MPI.SUM)

    def worst(self, f):
        """Where a residual vector is largest. *Collective.*

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
        space, mesh = self.space, self.space.mesh
        size = np.linalg.norm(f.getArray(readonly=True).reshape(-1, space.dim), axis=1)
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
        total = self.space.comm.allreduce((self.applied_forces(u) + self._drag(u)).sum(axis=0))
        obstacles = {contact.name for contact in self.contacts if contact.rigid}
        forces = [*record["reactions"].values()]
        forces += [-np.asarray(pair["force"]) for name, pair in record["contacts"].items() if name in obstacles]
        forces += [group["force"] for group in record.get("couplings", {}).values()]
        forces += [record["equations"]["force"]] if "equations" in record else []
        total = total + np.sum(forces, axis=0)
        if self.space.axisymmetric:
            total[0] = 0.0  # radial forces are borne by the ring
        return float(np.linalg.norm(total))

    def _drag(self, u):
        """Forces (n_owned, d) on the bodies that answer their motions [force]. *Collective.*"""
        out = np.zeros((self.space.n_owned, self.space.dim))
        for item in self.others:
            item.drag(u, out)
        return out

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
        acting, answers = [self.external(self.time)], [borne, self._drag(u)]
        for item in self.others:
            forces = answers if item in self.springs else acting
            forces.append(np.zeros_like(borne))
            item.external(u, forces[-1])
        heat = [] if self.bulk.heat is None else [self.bulk.heat.forces]
        own = [sum(float(np.linalg.norm(one, axis=1).sum()) for one in forces) for forces in (acting, answers, heat)]
        acts, answer, thermal = self.space.comm.allreduce(np.array(own))
        acts += float(np.sum(self.borne(u)))
        return float(acts + answer + (thermal if acts == 0.0 else 0.0))

    def acts(self, u, borne, roundings):
        """Whether loads act on the bodies, or forces of supports and groups that are no rounding errors. *Collective.*

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
            What :meth:`unbalanced` said of it before the state was committed [force].

        Returns
        -------
        dict of str to list of float
        """
        supports, own = self.supports, self.space.owned_local
        forces = self.unbalanced(u) if unbalanced is None else unbalanced
        which = supports.which[own]
        table = np.zeros((len(supports.regions), self.space.dim))
        for number in range(len(supports.regions)):
            table[number] = np.where(which == number, forces, 0.0).sum(axis=0)
        table = self.space.comm.allreduce(table)
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
        own = self.supports.moments(self.time, self.space.owned_local, moved, unbalanced)
        return {self.supports.regions[k]: self.space.comm.allreduce(value).tolist() for k, value in own.items()}
