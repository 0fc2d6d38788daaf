"""A contact pair: one source surface and its partners, as an item of the discrete problem.

A pair is made of a *detection* (who is the partner of a point: `pcontact.contact.search.partners`), *terms* (residual
and tangent at the points: `pcontact.contact.formulation`) with a *traction* (the stress of the source at its points:
`pcontact.contact.traction`), a *method* (Nitsche, penalty, augmented Lagrangian) and a *law* (frictionless, Coulomb,
Tresca, tied: `pcontact.contact.law`), and of a *history* (what points remember: `pcontact.contact.history`).

The life of a pair: `detect` finds the partners, which stay for the load step, the *pairing*; residual and tangent are
functions of the displacement, the state committed last and the status rule; `commit` takes the state to the end of the
load step.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.matrix import OwnedRows
from pcontact.contact import active_set
from pcontact.contact.formulation.layer import Layer, LayerTerms
from pcontact.contact.formulation.methods import AugmentedLagrangian, Method, Penalty
from pcontact.contact.formulation.small import SmallTerms, add_at_nodes
from pcontact.contact.history import PointHistory
from pcontact.contact.law import OPEN, SLIP, View, contact_law
from pcontact.contact.points import PartnerPoints, SourcePoints, TractionOperator
from pcontact.contact.search.partners import Detection, ObstacleSearch, TargetSearch
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.traction.small import Traction, source_traction
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI

# [facet sizes] So far ahead, facets get their place in the pattern before they close. From: chosen; what closes
# farther away makes a new pattern.
FORESEEN = 4.0

# formulations of a scene
METHODS = {"nitsche": Method, "penalty": Penalty, "augmented_lagrangian": AugmentedLagrangian}


class Setting(NamedTuple):
    """Settings of a pair beside its contact.

    Attributes
    ----------
    floats : bool
        Whether a body of the pair is not held by supports.
    chords : pcontact.contact.surface.smooth_geometry.Chords or None
        What straight facets do to the gap; None where they do nothing, or nobody asks.
    wears : bool
        Whether slip and wear are summed up.
    """

    floats: bool = False
    chords: object = None
    wears: bool = False


NOTHING_MORE = Setting()


@dataclass
class Pairing:
    """Partners of the source points, frozen until the next search.

    Attributes
    ----------
    exchange : pcontact.runtime.parallel.NodeExchange
        Brings the displacement of all nodes of the pair.
    source : pcontact.contact.points.SourcePoints
        With numbers into these nodes, as the partners.
    partner : pcontact.contact.points.PartnerPoints
    paired : ndarray (np,) of bool
    ids : ndarray (np,)
        Target facets, for the pattern.
    operator : pcontact.contact.points.TractionOperator or None
        Derivative of the traction; None at finite motion, where it is not the same at all displacements.
    acts : ndarray (np,) of bool
        Points that add to residual and tangent. Without a partner there is no pressure, and only the adjoint term of
        theta = 1, -1 asks for the traction.
    every : ndarray (np,) of bool
        All of them.
    """

    exchange: object
    source: SourcePoints
    partner: PartnerPoints
    paired: np.ndarray
    ids: np.ndarray
    operator: TractionOperator | None
    acts: np.ndarray
    every: np.ndarray

    @property
    def cells(self):
        """Nodes (nf, nn) of the parent cells."""
        return self.source.cells

    @property
    def targets(self):
        """Nodes (np, m) of the partners' facets."""
        return self.partner.nodes[:, : self.partner.shape.shape[1]]

    @property
    def target_shape(self):
        """Shape functions (np, m) there."""
        return self.partner.shape

    @property
    def normal(self):
        """Contact normals (np, d)."""
        return self.partner.normal

    @property
    def gap0(self):
        """Gap (np,) at zero displacement [length]."""
        return self.partner.gap0

    def touched(self, space, points):
        """Owned nodes (n,), global numbers, of the cells and target facets of some points (np,). *Collective.*"""
        local = np.zeros((len(self.exchange.nodes), space.dim))
        local[self.cells[self.source.facet[points]].ravel(), 0] = 1.0
        local[self.targets[points].ravel(), 0] = 1.0
        return space.start + np.flatnonzero(space.summed(self.exchange, local)[:, 0] > 0.5)

    def lengths(self, values):
        """Magnitudes of the terms whose differences gaps are [length]: those at the nodes (n, d), and of the points
        (np,) besides."""
        return np.abs(values), np.abs(self.gap0)

    def carry(self, places):
        """Take the places (np, d) of the points from which the load step begins, moved by an obstacle [length]."""


class PairPattern:
    """Pattern of the tangent of a pair.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Attributes
    ----------
    coupled : ndarray (np,) of bool
        Points that have a partner which they may close with, and a place in the pattern for both.
    version : int
        Grows when the pattern changes.
    """

    def __init__(self, space, n):
        self._space, self.coupled, self.version = space, np.zeros(n, dtype=bool), 0

    def renew(self, pairing, coupled, wide, cells):
        """Take the pattern of points (np,) that are coupled to their partners, `wide` with what else these bring, and,
        with `cells`, of all source cells. *Collective.*"""
        p, facet, self.coupled = pairing, pairing.source.facet, coupled
        chosen = np.flatnonzero(coupled)
        # one of the points of a source facet that have a target facet, and all of its cell, in common
        key = 2 * (facet[chosen] * (np.max(p.ids, initial=0) + 1) + p.ids[chosen]) + wide[chosen]
        _, first = np.unique(key, return_index=True)
        tables = [np.concatenate([p.cells[facet[chosen[first]]], p.partner.nodes[chosen[first]]], axis=1)]
        if cells:
            tables.append(p.cells)
        self._rows = node_graph(tables, len(p.exchange.nodes))
        space = self._space
        self.owned = OwnedRows(space.numbering, space.exchanger, p.exchange.nodes, *self._rows)
        self.version += 1

    def blocks(self):
        """Blocks of zeros, :class:`pcontact.assembly.graph.BlockRows`."""
        d = self._space.dim
        return BlockRows(*self._rows, np.zeros((len(self._rows[1]), d, d)))


class ContactPair(Item):
    """One source surface and its partners.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface
        As the formulation needs it, with the weight of the pair in its quadrature weights.
    search : pcontact.contact.search.partners.Detection
    terms : SmallTerms
        Tractions, formulation and law at the points.
    setting : Setting

    Attributes
    ----------
    method : pcontact.contact.formulation.methods.Method
    law : pcontact.contact.law.Frictionless
    history : pcontact.contact.history.PointHistory
    pairing : Pairing or None
        Of the last search.
    rows : PairPattern
    status : ndarray (np,)
        Status of the points in the last tangent of this load step, see `pcontact.contact.law`, None before there is
        any.
    lost : (int, int)
        Points of this rank that the frozen partners have misled: that passed into their partner without a word, and
        that have left it, see :func:`pcontact.contact.active_set.lost`.
    """

    def __init__(self, space, contact, source, search, terms, setting):
        self.space, self.contact, self.name = space, contact, contact.name
        self.source, self.search, self.terms, self.method, self.law = source, search, terms, terms.method, terms.law
        law, method, self.radius, self.floats = self.law, self.method, search.radius, setting.floats
        self.rigid, self.changes, self.can_slip = search.among.rigid, not law.tied, law.can_slip
        self.bilateral, self.stiff = contact.bilateral or law.tied or law.held, method.stiff
        self.symmetric = (method.theta == 1.0 or not method.has_traction) and law.symmetric and terms.traction.symmetric
        self.history = PointHistory(source, law, terms, setting.wears)
        self.flips, self.status, self.lost, self.pairing = [], None, (0, 0), None
        self.rows, self.active = PairPattern(space, len(source.facet)), active_set.PairActiveSet(self)
        # partners before those of the last search within a load step
        self.verifies, self.stale, self._former, self._turns = not law.tied, 0.0, None, None
        # with the moduli of its traction
        self._stressed = source
        # partners, slopes and parameters, and values of the last tangent of the load step
        self._written = None, (), None

    @property
    def version(self):
        """Grows when the pattern changes."""
        return self.rows.version

    @property
    def too_deep(self):
        """Points of this rank deeper in the obstacle than the search radius: they have no partner."""
        return self.search.among.too_deep

    # -- search -------------------------------------------------------------------------------------------------

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find the partner of every source point, at a time. *Collective.*

        Points that the load step may close get their place in the pattern now. Tied pairs search once, among the
        undeformed bodies.
        """
        if self.law.tied and self.pairing is not None:
            self._start_step(u, time)
            return
        expected = u if ahead is None else ahead
        if self.law.tied:
            expected = self.space.vector()
        self.search.measure(u, self.history.time)
        self._take(self.search.find(expected, time), expected, u, time, motion)
        if self.law.tied:
            # bodies that are tied do not lose each other
            self.radius = np.inf

    def _take(self, found, expected, u, time, moves=0.0):
        """Take the partners that were found at displacements that are expected, in a load step that begins at ``u``.
        *Collective.*
        """
        source, paired, gap, begun = self.source, found.paired, found.gap, self.history.begun
        normal = np.ascontiguousarray(np.where(paired[:, None], found.normal, self.search.normals))
        size = source.size[source.facet]
        # obstacles have moved on already, and displacements that are expected are not those of a solution
        compares = begun and expected is u and not self.rigid
        clear = gap - self.method.begins
        self.lost = active_set.lost(clear, paired, self.history.closed, size) if compares else (0, 0)
        found = self.terms.weigh(found, self.space.local.gather(expected))
        if not self.rigid or self.pairing is None:
            self._plan(found.nodes, paired)
        self.pairing = self._paired(normal, found)
        self._take_gap(self.pairing.exchange.gather(expected), gap)
        # half of the motion closes points (see APPROACH in `pcontact.solve.newton`) before contact pushes them back
        near = clear <= 0.5 * size + np.minimum(0.55 * moves, FORESEEN * size)
        wide = self.terms.wide(self.pairing)
        self.rows.renew(self.pairing, self._couples(near, wide), wide, self.method.theta != 0.0)
        self._start_step(u, time)

    def _start_step(self, u, time):
        self.flips, self.status, self._former, self._turns, self._written = [], None, None, None, (None, (), None)
        p, among, moved, since = self.pairing, self.search.among, 0.0, self.history.time
        values = p.exchange.gather(u)
        if self.rigid:
            x = np.einsum("pa,pad->pd", self.source.shape, values[p.cells[self.source.facet]])
            x += self.source.x - self.search.origin
            moved = among.moved(x, since, time, self.search.origin)
            p.carry(x + moved)
        if self.law.varies:
            # an expression of the user's may fail on some ranks only
            together(self.space.comm, self.law.begin, self.source.x, time)
        self.terms.begin(p, values, moved, lambda vectors: among.turned(vectors, since, time))

    def _paired(self, normal, found):
        """Points and partners, whose nodes have their numbers in the exchange: a :class:`Pairing`."""
        (exchange, cells, unique), paired, source = self._planned, found.paired, self._stressed
        nodes = np.zeros(found.nodes.shape, dtype=np.int64)
        if len(unique):
            nodes = np.minimum(np.searchsorted(unique, found.nodes), len(unique) - 1)
        nodes = np.ascontiguousarray(np.where(paired[:, None], nodes, 0).astype(np.int64))
        shape = np.ascontiguousarray(np.where(paired[:, None], found.shape, 0.0))
        points = source.numbered(cells)
        partner, every = PartnerPoints(nodes, shape, normal, np.zeros(len(paired))), np.ones(len(paired), dtype=bool)
        acts = paired.copy() if self.method.theta == 0.0 else every
        operator = self.terms.operator(normal, self.pairing)
        return Pairing(exchange, points, partner, paired, found.ids, operator, acts, every)

    def _take_gap(self, values, gap):
        """The gap is linear from here on and takes the value found where partners were looked for; that of tied points
        is none. *Collective.*"""
        if not self.law.tied:
            self.pairing.gap0[:] = gap - self.terms.gap(self.pairing, values)

    def _plan(self, nodes, paired):
        """Plan that brings the displacement of the source's cells and of the partners (np, m): against obstacles, once.
        *Collective.*"""
        space, source_nodes = self.space, self.space.nodes[self.source.cells]
        unique = np.unique(np.concatenate([source_nodes.ravel(), nodes[paired].ravel(), self.terms.traction.nodes]))
        cells = np.ascontiguousarray(np.searchsorted(unique, source_nodes).astype(np.int64))
        self._planned = space.exchange(unique), cells, unique

    def _couples(self, closed, wide):
        """Points that may need an entry in the matrix for both sides, among them those that are ``closed``; `wide`:
        with the cell of their partner."""
        # a bound that does not follow the pressure acts wherever there is a partner, as the adjoint of its cell does
        return self.pairing.paired & (closed | (not self.law.follows_pressure) | (wide & (self.method.theta != 0.0)))

    def renew(self, u, before, time, firm=False, tolerance=0.0):
        """See :meth:`pcontact.assembly.item.Item.renew`. *Collective.*"""
        if not self.verifies:
            return False
        found, keeps = self.search.find(u, time), tolerance if firm else 0.0
        former = None if self._former is None else self._former.normal
        self.stale, part, lost, way = active_set.misled(self, u, found, self.pairing.normal, time, keeps, former)
        self.lasts = 0.0
        if part <= tolerance and (firm or not lost):
            # no gap changes by more than the bodies move, neither that which is kept nor that which is found
            self.lasts = 0.0 if lost else 0.5 * (tolerance - part) * way
            return False
        # a gap that lies beyond the one before by turns goes less of the way
        p = self.pairing
        linear = self.terms.gap(p, p.exchange.gather(u))
        way = np.where(p.paired & found.paired, found.gap - linear, 0.0)
        self._turns = active_set.damped(way, self._turns)
        self.take_again(found._replace(gap=found.gap - (1.0 - self._turns[1]) * way), u, before, time)
        return True

    def take_again(self, found, u, before, time):
        """Take partners that were found at ``u`` within the load step that begins at ``before``: it goes on with the
        same points; another half of the contact may have kept its partners. *Collective.*"""
        kept, former = (self.flips, self.status, self._turns), self.pairing
        self._take(found, u, before, time)
        (self.flips, self.status, self._turns), self._former = kept, former

    # -- residual and tangent -------------------------------------------------------------------------------------

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.rows.owned.rowptr, self.rows.owned.columns

    def view(self, rule=LAW):
        """The points under a status rule, a :class:`pcontact.contact.law.View`."""
        paired, tied = self.pairing.paired, self.law.tied
        if self.law.held or (rule.frozen and not tied):
            return View(paired & self.history.closed, True, not self.law.held)
        if rule.closed is not None:
            return View(paired & rule.closed, True, rule.stick and self.can_slip)
        if rule.opened is not None:
            paired = paired & ~rule.opened
        return View(paired, self.bilateral, rule.stick and self.can_slip)

    def residual(self, u, out, rule=LAW):
        """Add the pair's forces on the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        p = self.pairing
        values = p.exchange.gather(u)
        local = np.zeros_like(values)
        self.terms.add_residual(p, values, self.view(rule), local)
        out += self.space.summed(p.exchange, local)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        p, source = self.pairing, self.source
        values = p.exchange.gather(u)
        _, status = self.terms.forces(p, values, self.view())
        # open points bear nothing, however far they are
        some = np.flatnonzero(status > OPEN)
        size, initial = p.lengths(values)
        facet, targets = source.facet[some], p.targets[some]
        own, other = np.abs(source.shape[some]), np.abs(p.target_shape[some])
        size = np.einsum("pa,pad->p", own, size[p.cells[facet]]) + np.einsum("pm,pmd->p", other, size[targets])
        size = (size + initial[some]) * self.method.firmest[some] * source.jxw[some]
        size = np.repeat(size[:, None], self.space.dim, axis=1)
        local = np.zeros_like(values)
        add_at_nodes(own, p.cells, facet, size, local)
        add_at_nodes(other, targets, np.arange(len(some)), size, local)
        out += self.space.summed(p.exchange, local)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`, which grows when a point closes that was thought far. *Collective.*"""
        p, view, rows = self.pairing, self.view(rule), self.rows
        values = p.exchange.gather(u)
        (slopes, status), wide = self.terms.slopes(p, values, view), self.terms.wide(p)
        new = self._couples(status > OPEN, wide) & ~rows.coupled
        # multipliers may let gamma grow
        depends = *slopes, self.method.gamma, self.method.alpha
        same = self.terms.repeats and self._written[0] is p and all(map(np.array_equal, depends, self._written[1]))
        grows, changes = self.space.comm.allreduce(np.array([new.any(), not same], dtype=int), op=MPI.SUM)
        if grows:
            rows.renew(p, rows.coupled | new, wide, self.method.theta != 0.0)
        if self.status is not None:
            self.flips.append(int(np.sum(status != self.status)))
        self.status = status
        if changes or grows:
            blocks = rows.blocks()
            missing = self.terms.add_tangent(p, values, view, slopes, blocks)
            if missing:
                raise RuntimeError(f"contact {self.name}: {missing} entries of the tangent outside the pattern")
            self._written = p, depends, rows.owned.sum(blocks.values)
        return self._written[2]

    def forces(self, u):
        """Tractions (np, d) that act on the source by the law [stress], and status (np,). *Collective.*"""
        return self.terms.forces(self.pairing, self.pairing.exchange.gather(u), self.view())

    def derivative(self, u, rule=LAW):
        """Derivative (np, d, d) of the tractions of :meth:`forces` in the augmented ones. *Collective.*"""
        p = self.pairing
        return self.terms.derivative(p, p.exchange.gather(u), self.view(rule))

    def target_shape(self, u):
        """Shape functions (np, m) of the partners' facets where the partners are at ``u``. *Collective.*"""
        return self.pairing.target_shape

    def commit(self, u, time):
        """End the load step. *Collective.*"""
        values = self.pairing.exchange.gather(u)
        if self.history.path is not None:
            self.history.path.add(self.state(u))
        self.history.commit(self.pairing, values, self.view(), time)
        if self.rigid:
            self.lost = active_set.lost_by_obstacle(self, u, values)

    # -- how the points stand -------------------------------------------------------------------------------------

    def pressed(self, u, wanted=None):
        """Augmented normal traction (np,) [stress], negative where points are closed; of the wanted ones at least.
        *Collective.*
        """
        traction, gap = self.terms.normal_state(self.pairing, self.pairing.exchange.gather(u), wanted)
        return traction + self.method.gamma * gap

    def angle(self, start, end):
        """See :meth:`pcontact.assembly.item.Item.angle`."""
        return abs(self.search.target.angle(start, end)) if self.rigid else 0.0

    def normal_motion(self, u, before):
        """See :func:`pcontact.contact.active_set.normal_motion`. *Collective.*"""
        return 0.0 if self.law.tied else active_set.normal_motion(self, u, before)

    def state(self, u):
        """Contact at the quadrature points of this rank. *Collective.*

        Returns
        -------
        dict of str to ndarray
            ``pressure`` [stress], ``gap`` [length] (without a partner the search radius: nothing is as near as that),
            ``traction`` (np, d) acting on the source, ``normal``, ``status`` (0 open, 1 stick, 2 slip), ``weight``
            (area of the point, times the weight of the pair), ``x`` (reference position), ``normal_stress`` (the
            traction of the stress along the normal), ``paired``; with friction ``slip`` (np, d), the tangential slip of
            the load step [length], and ``own_traction`` (np, d), that of the stress, of the source or weighted of both
            sides.
        """
        p, source, view = self.pairing, self.source, self.view()
        values = p.exchange.gather(u)
        traction, gap = self.terms.normal_state(p, values)
        tau = traction + self.method.gamma * gap
        closed = self.law.closed(view, tau)
        pressure = np.where(closed, -tau, 0.0)
        state = {
            "pressure": pressure,
            "gap": np.where(p.paired, gap, self.radius),
            "traction": -pressure[:, None] * p.normal,
            "normal": p.normal,
            "status": np.where(closed, SLIP, OPEN),
            "weight": source.jxw,
            "x": source.x,
            "normal_stress": traction,
            "paired": p.paired,
        }
        state.update(self.terms.state(p, values, view))
        state["status"] = np.where(closed, state["status"], OPEN)
        return state


def method_of(space, contact, source):
    """The formulation of a contact, for a source surface. *Collective.*"""
    trace = source.trace[source.facet]
    if contact.pressure_overclosure is None:
        method = METHODS[contact.formulation or "nitsche"](contact, trace, source.x.shape)
    else:
        softest = space.comm.allreduce(float(np.min(trace, initial=np.inf)), op=MPI.MIN)
        method = Layer(contact, trace, softest)
    if contact.alpha is None:
        method.take_alpha(source.shear[source.facet])
    return method


def partner_search(space, contact, target, law):
    """Search for the partners of points, of a contact with a law: a :class:`TargetSearch` or `ObstacleSearch`."""
    if isinstance(target, RigidObstacle):
        return ObstacleSearch(space, target)
    return TargetSearch(space, target, contact.search, contact.bilateral or law.tied)


def contact_pair(space, contact, source, target, radius, setting=NOTHING_MORE, bulk=None, law=None):
    """The pair of a contact in its formulation. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        With its numerics resolved; a formulation that is not said is Nitsche's.
    source : pcontact.contact.surface.sides.SourceSurface
    target : pcontact.contact.surface.sides.TargetSurface or pcontact.contact.surface.obstacle.RigidObstacle
    radius : float
        Search radius [length].
    setting : Setting, optional
    bulk : pcontact.assembly.solid.Bulk, optional
        Has the materials of both sides; isotropic elasticity of the source alone without.
    law : pcontact.contact.law.Frictionless, optional
        Another law than the contact's.

    Returns
    -------
    ContactPair
    """
    law = contact_law(contact) if law is None else law
    method = method_of(space, contact, source)
    source = method.source(source)
    alone = bulk is None or not method.has_traction
    traction = Traction(source) if alone else source_traction(space, bulk, contact, source, method.theta)
    kind = SmallTerms if contact.pressure_overclosure is None else LayerTerms
    terms = kind(space, source, method, traction, law)
    search = Detection(space, contact, source, partner_search(space, contact, target, law), radius, setting.chords)
    return ContactPair(space, contact, source, search, terms, setting)
