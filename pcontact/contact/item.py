"""One contact pair as an item: search, residual, tangent, report."""

import numpy as np

from pcontact.assembly.graph import node_graph
from pcontact.assembly.pattern import OwnedRows
from pcontact.contact.averages import add_at_nodes
from pcontact.contact.exchange import find_partners
from pcontact.contact.laws import OPEN, SLIP
from pcontact.contact.nitsche import (
    add_residual,
    add_tangent,
    evaluate,
    interpolate,
    no_operators,
    traction_operator,
)
from pcontact.contact.pairing import Pairing
from pcontact.contact.parameters import GAMMA0, parameter
from pcontact.contact.smooth_geometry import facet_error
from pcontact.contact.standing import Standing
from pcontact.contact.summary import borne, summarise
from pcontact.contact.way import Way
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI

# times the default, beyond which multigrid needs more than twice the iterations of one with a filter
STIFF = 30.0
# smallest cosine between the normals of a source point and its obstacle
FACING = 0.1
# facets ahead, in their own sizes, that get their place in the pattern before they close
FORESEEN = 4.0


class ContactItem(Standing, Way):
    """Frictionless contact of one pair by Nitsche's method, or by penalty where the source has no traction.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.SourceSurface
    target : pcontact.contact.surface.TargetSurface or pcontact.contact.obstacle.RigidObstacle
    radius : float
        Search radius [length].
    floats : bool
        Whether a body of the pair is not held by supports.
    plastic : pcontact.contact.plastic_trace.PlasticTrace, optional
        Where cells of the source may yield.

    Attributes
    ----------
    gamma : ndarray (nf,)
        gamma0 times the constant of the trace inequality of the parent cell [stress/length].
    version : int
        Grows when the pattern changes.
    deep : int
        Points of this rank deeper in the obstacle than the search radius: they have no partner.
    lost : (int, int)
        Points of this rank that the frozen partners have misled: that passed into their partner without a word, and
        that have left it, see :meth:`_lost`.
    committed : ndarray (np,)
        Status of the points at the end of the last load step, see `pcontact.contact.laws`.
    chords : pcontact.contact.smooth_geometry.Chords or None
        What straight facets do to the gap; None where they do nothing, or nobody asks.
    """

    changes = True

    def __init__(self, space, contact, source, target, radius, floats=False, plastic=None):
        self.space, self.contact, self.source, self.target = space, contact, source, target
        self.name, self.theta, self.radius = contact.name, float(contact.theta), radius
        self.gamma0 = parameter(contact)
        self.gamma = self.gamma0 * source.trace
        self.rigid = contact.obstacle is not None
        self.time = 0.0
        self.flips = []
        self._status = None
        self.floats, self.plastic = floats, plastic
        self.bilateral = contact.bilateral
        self.version = 0
        self.offset, self.deep = None, 0
        self.candidates = 0
        self.lost, self._begun = (0, 0), False
        self.pairing, self.chords = None, None
        self._coupled = np.zeros(len(source.facet), dtype=bool)
        self.committed = np.full(len(source.facet), OPEN, dtype=np.int64)
        self._owned = None
        low, high = bounding_box(space.comm, space.points)
        # of few digits, so that subtracting it rounds nothing
        self._origin = (0.5 * (low + high)).astype(np.float32).astype(float)
        self._rounding = np.finfo(float).eps * (4.0 * np.max(np.abs([low, high])) + 64.0 * np.max(high - low))

    # -- search -------------------------------------------------------------------------------------------------

    def detect(self, u, time, motion=0.0, ahead=None):
        """Find the partner of every source point, at a time. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            The committed displacement.
        time : float
            At which the load step ends: obstacles are where they will be.
        motion : float
            What the load step is known to move [length]: points that it may close get their place in the pattern now.
        ahead : PETSc.Vec, optional
            Displacement of the bodies among which partners are looked for: where the load step is expected to end. The
            committed one if absent.
        """
        source, space = self.source, self.space
        ahead = u if ahead is None else ahead
        nodal = space.local.gather(ahead)
        x = self._deformed(nodal)
        if self.rigid:
            gap, normal, paired = self._against_obstacle(x, time)
            ids = np.zeros(len(gap), dtype=np.int64)
            nodes, shape = np.zeros((len(gap), 0), dtype=np.int64), np.zeros((len(gap), 0))
        else:
            found = find_partners(
                space, self.target, nodal, x, source.normal, self.radius, self.contact.search, self._origin
            )
            normal, paired, ids = found.normal, found.id >= 0, found.id
            gap = self._between(found.gap, normal, paired, found.offset)
            nodes, shape = found.nodes, found.shape
            self.candidates += found.candidates
        # surfaces that touch are closed in the first tangent, whatever the rounding of their coordinates says
        gap = self._adjust(np.where(paired & (np.abs(gap) > self._rounding), gap, 0.0), paired, x)
        normal = np.where(paired[:, None], normal, source.normal)
        # obstacles have moved on already, and displacements that are expected are not those of a solution
        self.lost = self._lost(gap, paired) if self._begun and ahead is u and not self.rigid else (0, 0)
        self._freeze(ahead, gap, np.ascontiguousarray(normal), paired, ids, nodes, shape)
        self._begin(u, time)
        size = source.size[source.facet]
        # half of the motion closes points (see APPROACH in `pcontact.solve.newton`) before contact pushes them back
        self._coupled = self._couples(gap <= 0.5 * size + np.minimum(0.55 * motion, FORESEEN * size))
        self.flips, self._status = [], None
        self._new_pattern()

    def _deformed(self, nodal):
        """Points of the source (np, d) under nodal displacements, relative to the origin: no digits are lost."""
        source, space = self.source, self.space
        # the geometry is of the degree of the displacement at most, which interpolates it
        curved, moved = space.mesh.curved and space.degree == 1, np.empty_like(source.x)
        values = nodal if curved else space.points - self._origin + nodal
        interpolate(values, source.cells, source.facet, source.shape, moved)
        return (source.x - self._origin) + moved if curved else moved

    def _against_obstacle(self, x, time):
        # a level set of the user's may fail on some ranks only
        gap, normal = together(self.space.comm, self.target.gap, x, time, self._origin)
        paired = np.einsum("pd,pd->p", normal, self.source.normal) >= FACING
        self.deep = int(np.sum(paired & (gap < -self.radius)))
        paired &= np.abs(gap) <= self.radius
        return self._between(gap, normal, paired), normal, paired

    def _between(self, gap, normal, paired, offset=None):
        """The gap (np,) between the surfaces that the facets stand for, if they are to be told apart. *Collective.*"""
        return gap if self.chords is None else self.chords(gap, normal, paired, offset)

    def _adjust(self, gap, paired, x):
        """An initial overlap that is to be adjusted away is added to the gap for good."""
        if self.contact.interference != "adjust":
            return gap
        if self.offset is None and self.rigid:
            # that with the obstacle where it is before it moves
            initial, _, near = self._against_obstacle(x, self.time)
            self.offset = np.where(near, np.maximum(-initial, 0.0), 0.0)
        elif self.offset is None:
            self.offset = np.where(paired, np.maximum(-gap, 0.0), 0.0)
        return gap + self.offset

    def _freeze(self, u, gap, normal, paired, ids, nodes, shape):
        if not self.rigid or self.pairing is None:
            self._plan(nodes, paired)
        exchange, cells, unique = self._planned
        places = np.zeros(nodes.shape, dtype=np.int64)
        if len(unique):
            places = np.minimum(np.searchsorted(unique, nodes), len(unique) - 1)
        b = self._operator(normal)
        shape = np.ascontiguousarray(np.where(paired[:, None], shape, 0.0))
        places = np.ascontiguousarray(np.where(paired[:, None], places, 0).astype(np.int64))
        every = np.ones(len(gap), dtype=bool)
        self.pairing = Pairing(
            exchange, cells, places, paired, ids, normal, b, shape, np.zeros(len(gap)),
            paired.copy() if self.theta == 0.0 else every, every,
        )  # fmt: skip
        # the gap is linear in u from here on and takes the value found where partners were looked for
        self.pairing.gap0 = np.ascontiguousarray(gap - self._gap(exchange.gather(u)))

    def _operator(self, normal):
        """Operator of the normal traction (np, nn, d); most normals are as they were: of obstacles, without partner."""
        source, last = self.source, self.pairing
        if last is None:
            b, turned = np.empty_like(source.grad), np.arange(len(normal))
        else:
            b, turned = last.b, np.flatnonzero((normal != last.normal).any(axis=1))
        traction_operator(turned, source.grad, source.volumetric, source.facet, source.mu, source.normal, normal, b)
        return b

    def _plan(self, nodes, paired):
        """Who brings the displacement of the source's cells and of the partners (np, m): against obstacles, once."""
        space, source_nodes = self.space, self.space.nodes[self.source.cells]
        unique = np.unique(np.concatenate([source_nodes.ravel(), nodes[paired].ravel()]))
        cells = np.ascontiguousarray(np.searchsorted(unique, source_nodes).astype(np.int64))
        self._planned = space.exchange(unique), cells, unique

    def _begin(self, u, time):
        """Frictionless contact starts every load step afresh."""

    def _couples(self, closed):
        """Points that may need an entry in the matrix for both sides, among them those that are ``closed``."""
        return self.pairing.paired & closed

    # -- pattern ------------------------------------------------------------------------------------------------

    def _new_pattern(self):
        """Pattern of the points that are coupled to their partners (and, for theta != 0, of all source cells)."""
        p, source = self.pairing, self.source
        chosen = np.flatnonzero(self._coupled)
        # one of the points of a source facet that have a target facet in common
        key = source.facet[chosen] * (np.max(p.ids, initial=0) + 1) + p.ids[chosen]
        _, first = np.unique(key, return_index=True)
        facets = source.facet[chosen[first]]
        tables = [np.concatenate([p.cells[facets], p.targets[chosen[first]]], axis=1)]
        if self.theta != 0.0:
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

    def _evaluate(self, values, wanted=None):
        """Normal traction of the elastic stress and gap (np,), at least of the points that are wanted (np,)."""
        p, source = self.pairing, self.source
        traction, gap = np.empty(len(source.facet)), np.empty(len(source.facet))
        evaluate(
            values, p.cells, p.targets, source.facet, source.shape, p.target_shape, p.b, p.normal, p.gap0, traction, gap
        )
        return traction, gap

    def _gap(self, values):
        """Gap (np,) at displacements (n, d)."""
        return self._evaluate(values)[1]

    def _contact(self, values, wanted=None):
        """Normal traction and gap (np,) at displacements (n, d), see :meth:`_evaluate`."""
        traction, gap = self._evaluate(values, wanted)
        if self.plastic is not None:
            p = self.pairing
            traction += np.einsum("pd,pd->p", self.plastic.traction(values, p.cells), p.normal)
        return traction, gap

    def _operators(self, values):
        """What plasticity adds to the derivative of the traction, and whether to that of the adjoint, too."""
        if self.plastic is None:
            return *no_operators(self.source.shape.shape[1], self.space.dim), False
        return *self.plastic.operators(values, self.pairing.cells), self.consistent

    @property
    def consistent(self):
        """Whether the adjoint operator is the derivative of the traction where cells yield."""
        return self.plastic is not None and self.theta != 0.0 and self.contact.adjoint == "consistent"

    def _weights(self, values):
        """What the adjoint operator is tested with: theta G^-1 (P - t) (np, d), times the weights of the points."""
        traction, gap = self._contact(values)
        gamma, p = self.gamma[self.source.facet], self.pairing
        tau = traction + gamma * gap
        pressure = np.where(p.paired & ((tau < 0.0) | self.bilateral), tau, 0.0)
        return (self.theta / gamma * (pressure - traction) * self.source.jxw)[:, None] * p.normal

    def residual(self, u, out):
        """Add the pair's forces on the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        p = self.pairing
        values = p.exchange.gather(u)
        local = np.zeros_like(values)
        self._add_residual(values, local)
        if self.consistent:
            self.plastic.add_adjoint(values, p.cells, self._weights(values), local)
        out += self.space.summed(p.exchange, local)

    def _add_residual(self, values, local):
        p, source = self.pairing, self.source
        traction, gap = self._contact(values)
        add_residual(
            self.theta, self.bilateral, p.paired, source.jxw, self.gamma, traction, gap, p.cells, p.targets,
            source.facet, source.shape, p.target_shape, p.b, p.normal, local,
        )  # fmt: skip

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d): the scale of rounding errors.
        *Collective.*
        """
        p, source = self.pairing, self.source
        values = p.exchange.gather(u)
        _, status = self._augmented(values)
        # open points bear nothing, however far they are
        some = np.flatnonzero(status > OPEN)
        values, facet, targets = np.abs(values), source.facet[some], p.targets[some]
        own, other = np.abs(source.shape[some]), np.abs(p.target_shape[some])
        size = np.einsum("pa,pad->p", own, values[p.cells[facet]]) + np.einsum("pm,pmd->p", other, values[targets])
        size = (size + np.abs(p.gap0[some])) * self.gamma[facet] * source.jxw[some]
        size = np.repeat(size[:, None], self.space.dim, axis=1)
        local = np.zeros_like(values)
        add_at_nodes(own, p.cells, facet, size, local)
        add_at_nodes(other, targets, np.arange(len(some)), size, local)
        out += self.space.summed(p.exchange, local)

    def tangent(self, u):
        """Values (nnz, d, d) on :meth:`pattern`, which grows when a point closes that was thought far. *Collective.*"""
        p = self.pairing
        values = p.exchange.gather(u)
        tau, status = self._augmented(values)
        new = self._couples(status > OPEN) & ~self._coupled
        if self.space.comm.allreduce(bool(new.any()), op=MPI.LOR):
            self._coupled |= new
            self._new_pattern()
        if self._status is not None:
            self.flips.append(int(np.sum(status != self._status)))
        self._status = status
        d = self.space.dim
        local = np.zeros((len(self._columns), d, d))
        missing = self._add_tangent(tau, self._operators(values), local)
        if self.consistent:
            missing += self.plastic.add_curvature(
                values, p.cells, self._weights(values), self._rowptr, self._columns, local
            )
        if missing:
            raise RuntimeError(f"contact {self.name}: {missing} entries of the tangent outside the pattern")
        return self._owned.sum(local)

    def _augmented(self, values):
        """What the tangent is made from, and the status (np,) of the points."""
        traction, gap = self._contact(values)
        tau = traction + self.gamma[self.source.facet] * gap
        closed = self.pairing.paired & ((tau <= 0.0) | self.bilateral)
        return tau, np.where(closed, SLIP, OPEN)

    def _add_tangent(self, tau, operators, local):
        p, source = self.pairing, self.source
        at, extra, consistent = operators
        points = np.flatnonzero(at >= 0)
        across = np.einsum("kaij,ki->kaj", extra, p.normal[points[np.argsort(at[points])]])
        return add_tangent(
            self.theta, self.bilateral, p.paired, source.jxw, self.gamma, tau, p.cells, p.targets,
            source.facet, source.shape, p.target_shape, p.b, at, np.ascontiguousarray(across), consistent, p.normal,
            self._rowptr, self._columns, local,
        )  # fmt: skip

    @property
    def stiff(self):
        """Whether multigrid alone fares badly: far more than the default gamma0, or the skew tangent of theta = -1."""
        return self.theta < 0.0 or self.gamma0 > STIFF * GAMMA0[self.theta]

    def closed_area(self):
        """Area of the points of this rank that were closed in the last tangent [length^(d - 1)]."""
        return float(np.sum(self.source.jxw[self._status > OPEN])) if self._status is not None else 0.0

    def active_nodes(self):
        """Owned nodes, global numbers, of the pair at points that were closed in the last tangent. *Collective.*"""
        closed = self._status > OPEN if self._status is not None else np.zeros(len(self.source.facet), dtype=bool)
        return self.pairing.touched(self.space, self.source.facet, self.pairing.paired & closed)

    def commit(self, u, time):
        """End the load step. *Collective.*"""
        self.time, self._begun = time, True
        values = self.pairing.exchange.gather(u)
        self._end(values)
        if self.rigid:
            self._compare_with_obstacle(u, values)

    def _end(self, values):
        """Keep what the next load step needs to know of the displacements (n, d). *Collective.*"""
        _, self.committed = self._augmented(values)

    # -- report -------------------------------------------------------------------------------------------------

    def state(self, u):
        """Contact at the quadrature points of this rank. *Collective.*

        Returns
        -------
        dict of str to ndarray
            ``pressure`` [stress], ``gap`` [length] (without a partner the search radius: nothing is as near as that),
            ``traction`` (np, d) acting on the source, ``normal``, ``status`` (0 open, 2 slip), ``weight`` (area of the
            point), ``x`` (reference position), ``paired``.
        """
        p, source = self.pairing, self.source
        traction, gap = self._contact(p.exchange.gather(u))
        tau = traction + self.gamma[source.facet] * gap
        closed = p.paired & ((tau <= 0.0) | self.bilateral)
        pressure = np.where(closed, -tau, 0.0)
        return {
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

    def summary(self, u):
        """Numbers of the pair for the report, the same on every rank. *Collective.*"""
        state = self.state(u)
        return {**summarise(state, self.flips, self.lost, self.space.comm), **facet_error([self], [state])}

    def borne(self, u):
        """Magnitudes of the forces on every component, see :func:`pcontact.contact.summary.borne`. *Collective.*"""
        return borne(self.space, self.pairing, self.source, np.linalg.norm(self.state(u)["traction"], axis=1))
