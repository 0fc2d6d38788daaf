"""A contact pair: one source surface and its partners, as an item of the discrete problem.

A pair is made of a *search* (who is the partner of a point: `pcontact.contact.search`), a *traction* (the stress of the
source at its points: `pcontact.contact.traction`), a *formulation* (Nitsche, penalty, augmented Lagrangian:
`pcontact.contact.formulation`) and a *law* (frictionless, Coulomb, Tresca, tied: `pcontact.contact.law`).

The life of a pair: `detect` finds the partners, which stay for the load step; residual and tangent are functions of the
displacement, the state committed last and the status rule; `commit` takes the state to the end of the load step.
"""

import numpy as np

from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.pattern import OwnedRows
from pcontact.contact import motion
from pcontact.contact.active_set import PairActiveSet
from pcontact.contact.formulation.augmented import AugmentedLagrangian
from pcontact.contact.formulation.averages import add_at_nodes
from pcontact.contact.formulation.layer import Layer, LayerTerms
from pcontact.contact.formulation.methods import Method, Penalty
from pcontact.contact.formulation.small import SmallTerms
from pcontact.contact.initial import initial_gap
from pcontact.contact.law import OPEN, SLIP, View, contact_law
from pcontact.contact.pairing import Pairing
from pcontact.contact.path import NAME as PATH
from pcontact.contact.points import PartnerPoints, SourcePoints, interpolate
from pcontact.contact.search.partners import ObstacleSearch, TargetSearch
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.traction.small import Traction
from pcontact.contact.traction.target import source_traction
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime.parallel import take_rows, together
from pcontact.runtime.petsc import MPI
from pcontact.space.turn import moments

# [facet sizes] So far ahead, facets get their place in the pattern before they close. From: chosen; what closes
# farther away makes a new pattern.
FORESEEN = 4.0

# formulations of a scene
METHODS = {"nitsche": Method, "penalty": Penalty, "augmented_lagrangian": AugmentedLagrangian}
# [-] Part of the way to a gap that is found again which a point goes at least. From: chosen.
DAMPED = 0.25


class ContactPair(Item):
    """One source surface and its partners.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface
        As the formulation needs it, with the weight of the pair in its quadrature weights.
    search : TargetSearch or ObstacleSearch
    terms : SmallTerms
        Tractions, formulation and law at the points.
    radius : float
        Search radius [length].
    floats : bool
        Whether a body of the pair is not held by supports.

    Attributes
    ----------
    method : pcontact.contact.formulation.methods.Method
    law : pcontact.contact.law.Frictionless
    pairing : pcontact.contact.pairing.Pairing or None
        Of the last search.
    coupled : ndarray (np,) of bool
        Points that have a partner which they may close with, and a place in the pattern for both.
    committed, status : ndarray (np,)
        Status of the points at the end of the last load step, see `pcontact.contact.law`, and in the last tangent of
        this one, None before there is any.
    lost : (int, int)
        Points of this rank that the frozen partners have misled: that passed into their partner without a word, and
        that have left it, see :func:`pcontact.contact.motion.lost`.
    chords : pcontact.contact.surface.smooth_geometry.Chords or None
        What straight facets do to the gap; None where they do nothing, or nobody asks.
    origin : ndarray (d,)
        To which places of points are relative, so that they lose no digits [length].
    rounding : float
        Rounding errors that a gap may carry [length].
    closing : float
        Largest gap at points of this rank that is closed, whatever the load, in the first load step [length].
    stiffer : float
        How many times as stiff as the target the source is, where that is too much; else 0.
    path : pcontact.contact.path.SlipPath or None
        Slip and wear so far, where they are asked for and points can slip.
    offset : ndarray (np,) or None
        What is added to gaps for those that the undeformed bodies are given, see `pcontact.contact.initial` [length].
    """

    def __init__(self, space, contact, source, search, terms, radius, floats=False):
        self.space, self.contact, self.name = space, contact, contact.name
        self.source, self.search, self.terms, self.radius, self.floats = source, search, terms, radius, floats
        self.method, self.law = terms.method, terms.law
        self.rigid, self.changes, self.can_slip = search.rigid, not self.law.tied, self.law.can_slip
        self.bilateral = contact.bilateral or self.law.tied or self.law.held
        self.time, self.version, self.flips, self.status = 0.0, 0, [], None
        self.lost, self._begun, self.offset, self.chords, self.pairing = (0, 0), False, None, None, None
        self.active = PairActiveSet(self)
        # partners before those of the last search within a load step
        self.verifies, self.stale, self._former, self._turns = not self.law.tied, 0.0, None, None
        self._initial, self.closing, self.stiffer, self.path = initial_gap(contact), 0.0, 0.0, None
        self._normals, self.coupled = source.normal, np.zeros(len(source.facet), dtype=bool)
        self.committed = np.full(len(source.facet), OPEN, dtype=np.int64)
        low, high = bounding_box(space.comm, space.points)
        # of few digits, so that subtracting it rounds nothing
        self.origin = (0.5 * (low + high)).astype(np.float32).astype(float)
        self.rounding = np.finfo(float).eps * (4.0 * np.max(np.abs([low, high])) + 64.0 * np.max(high - low))

    @property
    def target(self):
        """Target surface or obstacle."""
        return self.search.target

    @property
    def gamma(self):
        """Parameter of the points (np,), as it acts [stress/length]."""
        return self.method.gamma

    @property
    def stiff(self):
        """Whether multigrid alone fares badly, see `pcontact.contact.formulation.methods.Method.stiff`."""
        return self.method.stiff

    @property
    def symmetric(self):
        """Whether the tangent is symmetric."""
        own = self.method.theta == 1.0 or not self.method.has_traction
        return own and self.law.symmetric and self.terms.traction.symmetric

    @property
    def too_deep(self):
        """Points of this rank deeper in the obstacle than the search radius: they have no partner."""
        return self.search.too_deep

    @property
    def candidates(self):
        """Facets that the searches of this rank tried."""
        return self.search.candidates

    @property
    def closed(self):
        """Points (np,) that were closed at the end of the last load step."""
        return self.committed > OPEN

    # -- search -------------------------------------------------------------------------------------------------

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find the partner of every source point, at a time. *Collective.*

        Points that the load step may close get their place in the pattern now. Tied pairs search once, among the
        undeformed bodies.
        """
        if self.law.tied and self.pairing is not None:
            self._start_step(u, time)
            return
        space, expected = self.space, u if ahead is None else ahead
        if self.law.tied:
            expected = space.vector()
        if self._initial is not None and not self._initial.known:
            self._measure(u)
        self._take(self._partners_at(expected, time), expected, u, time, motion)

    def _partners_at(self, u, time):
        """Partners among the bodies at ``u``. *Collective.*"""
        nodal = self.space.local.gather(u)
        return self._find(nodal, self.deformed(nodal), time)

    def _measure(self, u):
        """Take the gap between the undeformed bodies, from which the first load step begins at ``u``, with an obstacle
        where it is before it moves. *Collective.*"""
        found = self._partners_at(u, self.time)
        self._initial.take(self._clean(found), found.paired)

    def _clean(self, found):
        """Gap (np,) [length] that a search has found: surfaces that touch are closed in the first tangent, whatever the
        rounding of their coordinates says."""
        return np.where(found.paired & (np.abs(found.gap) > self.rounding), found.gap, 0.0)

    def _offset(self, time):
        """What is added to gaps (np,) that a search has found for those that the undeformed bodies are given, or 0
        [length]."""
        if self._initial is None:
            return 0.0
        self.offset = self._initial.offset(time)
        return self.offset

    def _take(self, found, expected, u, time, motion=0.0):
        """Take the partners that were found at displacements that are expected, in a load step that begins at ``u``.
        *Collective.*
        """
        source, paired, gap = self.source, found.paired, self._clean(found) + self._offset(time)
        normal = np.ascontiguousarray(np.where(paired[:, None], found.normal, self._normals))
        # obstacles have moved on already, and displacements that are expected are not those of a solution
        compares = self._begun and expected is u and not self.rigid
        self.lost = self._count_lost(gap, paired) if compares else (0, 0)
        at_once = paired & (self.contact.bilateral and not self._begun)
        self.closing = float(np.max(gap[at_once], initial=0.0))
        self._freeze(expected, gap, normal, found)
        size = source.size[source.facet]
        # half of the motion closes points (see APPROACH in `pcontact.solve.newton`) before contact pushes them back
        near = gap - self.method.begins <= 0.5 * size + np.minimum(0.55 * motion, FORESEEN * size)
        self.coupled = self._couples(near)
        self._new_pattern()
        self._start_step(u, time)
        if self.law.tied:
            # bodies that are tied do not lose each other
            self.radius = np.inf

    def _start_step(self, u, time):
        self.flips, self.status, self._former, self._turns = [], None, None, None
        p, search, moved = self.pairing, self.search, 0.0
        values = p.exchange.gather(u)
        if self.rigid:
            moved = search.moved(self._places_at(p, values), self.time, time, self.origin)
            self._carry(p, values, moved)
        if self.law.varies:
            # an expression of the user's may fail on some ranks only
            together(self.space.comm, self.law.begin, self.source.x, time)
        self.terms.begin(p, values, moved, lambda vectors: search.turned(vectors, self.time, time))

    def _places_at(self, p, values):
        """Places (np, d) of the source points at nodal values (n, d), relative to the origin [length]."""
        jump = np.einsum("pa,pad->pd", self.source.shape, values[p.cells[self.source.facet]])
        return (self.source.x - self.origin) + jump

    def _carry(self, p, values, moved):
        """An obstacle moves points (np, d), (d,) or not at all [length]."""

    def deformed(self, nodal):
        """Points of the source (np, d) under displacements (n_local, d), relative to the origin: no digits are lost."""
        space = self.space
        # the geometry is of the degree of the displacement at most, which interpolates it
        if space.mesh.curved and space.degree == 1:
            return (self.source.x - self.origin) + self.at_points(nodal)
        return self.at_points(space.points - self.origin + nodal)

    def at_points(self, nodal):
        """Values (np, d) at the points of the source of a field of the nodes (n_local, d)."""
        source = self.source
        values = np.empty_like(source.x)
        interpolate(nodal, source.cells, source.facet, source.shape, values)
        return values

    def _find(self, nodal, x, time):
        """Partners, with the gap between the surfaces that the facets stand for, if they are to be told apart.
        *Collective.*
        """
        self._turn(nodal)
        found = self.search.find(nodal, x, self._normals, time, self.radius, self.origin)
        if self.chords is None:
            return found
        return found._replace(gap=self.chords(found.gap, found.normal, found.paired, found.offset))

    def _turn(self, nodal):
        """Outward normals of the source by which partners are looked for: those of the undeformed one."""

    def _freeze(self, u, gap, normal, found):
        """Partners that stay until the next search, with the gap that it found at displacements. *Collective.*"""
        found = self.terms.weigh(found, self.space.local.gather(u))
        if not self.rigid or self.pairing is None:
            self._plan(found.nodes, found.paired)
        self.pairing = self._paired(normal, found)
        if not self.law.tied:
            self._take_gap(self.pairing.exchange.gather(u), gap)

    def _paired(self, normal, found):
        """Points and partners, whose nodes have their numbers in the exchange: a :class:`Pairing`."""
        (exchange, cells, unique), paired, source = self._planned, found.paired, self._stressed
        nodes = np.zeros(found.nodes.shape, dtype=np.int64)
        if len(unique):
            nodes = np.minimum(np.searchsorted(unique, found.nodes), len(unique) - 1)
        nodes = np.ascontiguousarray(np.where(paired[:, None], nodes, 0).astype(np.int64))
        shape = np.ascontiguousarray(np.where(paired[:, None], found.shape, 0.0))
        points = SourcePoints(
            source.facet, cells, source.shape, source.jxw, source.normal, source.grad, source.volumetric, source.mu
        )
        partner, every = PartnerPoints(nodes, shape, normal, np.zeros(len(paired))), np.ones(len(paired), dtype=bool)
        acts = paired.copy() if self.method.theta == 0.0 else every
        operator = self.terms.operator(normal, self.pairing)
        return Pairing(exchange, points, partner, paired, found.ids, operator, acts, every)

    @property
    def _stressed(self):
        """The source with the moduli of its traction."""
        return self.source

    def _take_gap(self, values, gap):
        """The gap is linear from here on and takes the value found where partners were looked for."""
        self.pairing.gap0[:] = gap - self.terms.gap(self.pairing, values)

    def _plan(self, nodes, paired):
        """Who brings the displacement of the source's cells and of the partners (np, m): against obstacles, once."""
        space, source_nodes = self.space, self.space.nodes[self.source.cells]
        unique = np.unique(np.concatenate([source_nodes.ravel(), nodes[paired].ravel(), self.terms.traction.nodes]))
        cells = np.ascontiguousarray(np.searchsorted(unique, source_nodes).astype(np.int64))
        self._planned = space.exchange(unique), cells, unique

    def _couples(self, closed):
        """Points that may need an entry in the matrix for both sides, among them those that are ``closed``."""
        # a bound that does not follow the pressure acts wherever there is a partner, as the adjoint of its cell does
        return self.pairing.paired & (closed | (not self.law.follows_pressure) | self.terms.wide(self.pairing))

    def renew(self, u, before, time, firm=False, tolerance=0.0):
        """See :meth:`pcontact.assembly.item.Item.renew`. *Collective.*"""
        if not self.verifies:
            return False
        found, keeps = self._partners_at(u, time), tolerance if firm else 0.0
        offset = self._offset(time)
        gap = self._clean(found) + offset
        former = None if self._former is None else self._former.normal
        self.stale, part, lost = motion.misled(self, u, found, gap, self.pairing.normal, time, keeps, former)
        if part <= tolerance and (firm or not lost):
            return False
        self._take_again(found._replace(gap=self._damped(u, found, gap) - offset), u, before, time)
        return True

    def _damped(self, u, found, gap):
        """Gap (np,) that a point takes whose gap, found again, lies beyond the one before by turns: less of the way.

        A partner that stays takes along a gap whose derivative is that along the normal. Where the normal is not that
        of the partner's facet the true one is larger, by a ray at 45 degrees twice as large, and the gap that is found
        goes to and fro. Aitken's rule at each point.
        """
        p = self.pairing
        linear, part = self.terms.normal_state(p, p.exchange.gather(u))[1], 1.0
        way = np.where(p.paired & found.paired, gap - linear, 0.0)
        if self._turns is not None:
            before, part = self._turns
            with np.errstate(divide="ignore", invalid="ignore"):
                part = part * before / (before - way)
            part = np.where((part > 0.0) & (part < 1.0), np.maximum(part, DAMPED), 1.0)
        self._turns = way, part
        return gap - (1.0 - part) * way

    def _take_again(self, found, u, before, time):
        """Take partners that were found at ``u`` within the load step that begins at ``before``: it goes on with the
        same points; another half of the contact may have kept its partners. *Collective.*"""
        kept, former = (self.flips, self.status, self.closing, self._turns), self.pairing
        self._take(found, u, before, time)
        (self.flips, self.status, self.closing, self._turns), self._former = kept, former

    def _count_lost(self, gap, paired):
        size = self.source.size[self.source.facet]
        return motion.lost(gap - self.method.begins, paired, self.closed, size)

    # -- pattern ------------------------------------------------------------------------------------------------

    def _new_pattern(self):
        """Pattern of the points that are coupled to their partners (and, for theta != 0, of all source cells)."""
        p, source = self.pairing, self.source
        chosen = np.flatnonzero(self.coupled)
        # one of the points of a source facet that have a target facet, and all of its cell, in common
        wide = 0 if p.operator is None else p.operator.width[chosen] > p.cells.shape[1]
        key = 2 * (source.facet[chosen] * (np.max(p.ids, initial=0) + 1) + p.ids[chosen]) + wide
        _, first = np.unique(key, return_index=True)
        facets = source.facet[chosen[first]]
        tables = [np.concatenate([p.cells[facets], p.partner.nodes[chosen[first]]], axis=1)]
        if self.method.theta != 0.0:
            tables.append(p.cells)
        n = len(p.exchange.nodes)
        self._rowptr, self._columns = node_graph(tables, n)
        space = self.space
        self._owned = OwnedRows(space.numbering, space.exchanger, p.exchange.nodes, self._rowptr, self._columns)
        self.version += 1

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self._owned.rowptr, self._owned.columns

    # -- residual and tangent -------------------------------------------------------------------------------------

    def _view(self, rule=LAW):
        """The points under a status rule."""
        paired, tied = self.pairing.paired, self.law.tied
        if self.law.held or (rule.frozen and not tied):
            return View(paired & self.closed, True, not self.law.held)
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
        self.terms.add_residual(p, values, self._view(rule), local)
        out += self.space.summed(p.exchange, local)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        p, source = self.pairing, self.source
        values = p.exchange.gather(u)
        _, status = self.terms.forces(p, values, self._view())
        # open points bear nothing, however far they are
        some = np.flatnonzero(status > OPEN)
        size, initial = self._lengths(p, values)
        facet, targets = source.facet[some], p.targets[some]
        own, other = np.abs(source.shape[some]), np.abs(p.target_shape[some])
        size = np.einsum("pa,pad->p", own, size[p.cells[facet]]) + np.einsum("pm,pmd->p", other, size[targets])
        size = (size + initial[some]) * self.method.firmest[some] * source.jxw[some]
        size = np.repeat(size[:, None], self.space.dim, axis=1)
        local = np.zeros_like(values)
        add_at_nodes(own, p.cells, facet, size, local)
        add_at_nodes(other, targets, np.arange(len(some)), size, local)
        out += self.space.summed(p.exchange, local)

    def _lengths(self, p, values):
        """What gaps are differences of [length]: magnitudes at the nodes (n, d), and of the points (np,) besides."""
        return np.abs(values), np.abs(p.gap0)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`, which grows when a point closes that was thought far. *Collective.*"""
        p, view = self.pairing, self._view(rule)
        values = p.exchange.gather(u)
        slopes, status = self.terms.slopes(p, values, view)
        new = self._couples(status > OPEN) & ~self.coupled
        if self.space.comm.allreduce(bool(new.any()), op=MPI.LOR):
            self.coupled |= new
            self._new_pattern()
        if self.status is not None:
            self.flips.append(int(np.sum(status != self.status)))
        self.status = status
        d = self.space.dim
        local = np.zeros((len(self._columns), d, d))
        missing = self.terms.add_tangent(p, values, view, slopes, BlockRows(self._rowptr, self._columns, local))
        if missing:
            raise RuntimeError(f"contact {self.name}: {missing} entries of the tangent outside the pattern")
        return self._owned.sum(local)

    def forces(self, u):
        """Tractions (np, d) that act on the source by the law [stress], and status (np,). *Collective.*"""
        return self.terms.forces(self.pairing, self.pairing.exchange.gather(u), self._view())

    def derivative(self, u, rule=LAW):
        """Derivative (np, d, d) of the tractions of :meth:`forces` in the augmented ones. *Collective.*"""
        p = self.pairing
        return self.terms.derivative(p, p.exchange.gather(u), self._view(rule))

    def target_shape(self, u):
        """Shape functions (np, m) of the partners' facets where the partners are at ``u``. *Collective.*"""
        return self.pairing.target_shape

    def commit(self, u, time):
        """End the load step. *Collective.*"""
        values = self.pairing.exchange.gather(u)
        if self.path is not None:
            self.path.add(self.state(u))
        self._commit(values, time)
        if self.rigid:
            self.lost = motion.lost_by_obstacle(self, u, values)

    def _commit(self, values, time):
        """Take status, speed of slip and what the terms remember to the end of the load step. *Collective.*"""
        duration, self.time, self._begun = time - self.time, time, True
        if self.law.slows:
            slip = self.terms.slip(self.pairing, values)
        self.committed = self.terms.commit(self.pairing, values, self._view())
        if self.law.slows:
            self.law.slid(slip, self.committed, duration)

    # -- how the points stand -------------------------------------------------------------------------------------

    def pressed(self, u, wanted=None):
        """Augmented normal traction (np,) [stress], negative where points are closed; of the wanted ones at least.
        *Collective.*
        """
        traction, gap = self.terms.normal_state(self.pairing, self.pairing.exchange.gather(u), wanted)
        return traction + self.gamma * gap

    def angle(self, start, end):
        """See :meth:`pcontact.assembly.item.Item.angle`."""
        return abs(self.target.angle(start, end)) if self.rigid else 0.0

    def normal_motion(self, u, before):
        """See :func:`pcontact.contact.motion.normal_motion`. *Collective.*"""
        return 0.0 if self.law.tied else motion.normal_motion(self, u, before)

    # -- what remains of a load step ------------------------------------------------------------------------------

    def memory(self):
        """Status of the closed points, and what the terms remember."""
        keys, rows = self.source.point_keys(), np.flatnonzero(self.closed)
        status = {} if self.law.tied else {"status": (keys[rows], self.committed[rows, None].astype(float))}
        if self.law.slows and self.law.speed is not None:
            fast = np.flatnonzero(self.law.speed)
            status["speed"] = keys[fast], self.law.speed[fast, None]
        path = {} if self.path is None else self.path.memory(keys)
        return {**status, **path, **self.terms.memory(keys)}

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have."""
        return self.source.point_keys()

    def recall(self, name, chunks):
        """See :meth:`pcontact.assembly.item.Item.recall`."""
        keys = self.source.point_keys()
        if name == "speed" and self.law.slows:
            speed = np.zeros((len(keys), 1))
            count = take_rows(keys, chunks, speed)
            self.law.speed = speed[:, 0]
            return count
        if name == PATH:
            return None if self.path is None else self.path.recall(keys, chunks)
        if name != "status" or self.law.tied:
            return self.terms.recall(name, keys, chunks)
        status = np.zeros((len(self.committed), 1))
        count = take_rows(keys, chunks, status)
        self.committed = status[:, 0].astype(np.int64)
        return count

    # -- report -------------------------------------------------------------------------------------------------

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
        p, source, view = self.pairing, self.source, self._view()
        values = p.exchange.gather(u)
        traction, gap = self.terms.normal_state(p, values)
        tau = traction + self.gamma * gap
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

    def moment(self, u, state):
        """Moment of contact on an obstacle about the point that it turns about, of the points of this rank: a number in
        the plane, (3,) in space [force * length]. *Collective.*
        """
        arms = self.deformed(self.space.local.gather(u)) + (self.origin - self.target.pivot(self.time))
        return moments(arms, -state["traction"] * state["weight"][:, None])


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
    """Who says who the partner of a point is, of a contact with a law: a :class:`TargetSearch` or `ObstacleSearch`."""
    if isinstance(target, RigidObstacle):
        return ObstacleSearch(space, target)
    return TargetSearch(space, target, contact.search, contact.bilateral or law.tied)


def contact_pair(space, contact, source, target, radius, floats=False, bulk=None, law=None):
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
    floats : bool
        Whether a body of the pair is not held by supports.
    bulk : pcontact.assembly.bulk.Bulk, optional
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
    return ContactPair(space, contact, source, partner_search(space, contact, target, law), terms, radius, floats)
