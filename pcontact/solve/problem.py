"""The discrete problem: sums the items into a residual and a matrix, with supports and external forces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pcontact.assembly.matrix import JoinedPattern
from pcontact.runtime import profile
from pcontact.solve.active_sets import ActiveSets
from pcontact.solve.essential import EssentialConditions
from pcontact.solve.forces import Forces
from pcontact.solve.prediction import Prediction


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
    release : pcontact.assembly.release.Release or None
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
    conditions : pcontact.solve.essential.EssentialConditions
        What is prescribed of the displacement.
    forces : pcontact.solve.forces.Forces
        Loads, reactions, and how large forces are.
    active : pcontact.solve.active_sets.ActiveSets
        Points that open and close, and the rules that they follow.
    prediction : pcontact.solve.prediction.Prediction
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
        self._versions, self.pattern_changes = None, 0

    @property
    def parts(self):
        """What reports, remembers and is counted as one: the items, those of a contact together."""
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
        """Whether all points of the bodies can be integrated: no cell is turned inside out. *Collective.*"""
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
            self.matrix.write(stiffness, self._sum(values), self._added if added is None else added)
        profile.mark("assembly")

    def _renew(self):
        self._joined = JoinedPattern([item.pattern() for item in self.others], self.space.n_owned)
        if self.matrix.renew(self.bulk.pattern(), (self._joined.rowptr, self._joined.columns)):
            self.pattern_changes += 1

    def _sum(self, values):
        d = self.space.dim
        return self._joined.sum(values) if values else np.zeros((0, d, d))
