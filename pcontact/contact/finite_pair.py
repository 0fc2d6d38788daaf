"""A contact pair of bodies with finite motion: the facets of the partners are frozen, and the adjoint term, which is of
the places on them that the search has found."""

from dataclasses import dataclass

import numpy as np

from pcontact.contact.active_set import misled
from pcontact.contact.formulation.finite import FiniteTerms
from pcontact.contact.formulation.finite_geometry import (
    AWAY,
    CLOSEST,
    FIXED,
    HELD,
    NONE,
    OBSTACLE,
    RAY,
    TIED,
    FinitePartner,
    FiniteSource,
    current_normals,
    tied_offsets,
)
from pcontact.contact.formulation.layer import FiniteLayerTerms
from pcontact.contact.formulation.methods import facet_columns
from pcontact.contact.law import OPEN, contact_law
from pcontact.contact.pair import NOTHING_MORE, ContactPair, Pairing, method_of, partner_search
from pcontact.contact.search.partners import Detection
from pcontact.contact.surface.facet_maps import KIND, MAX_NODES
from pcontact.contact.surface.sides import tangents_of
from pcontact.contact.traction.finite import NoTraction, finite_traction
from pcontact.element.reference import reference_nodes
from pcontact.mesh.mesh import size_of
from pcontact.runtime.petsc import MPI

# difference of unit vectors from which a contact normal is not that of the facet: a partner held at an edge
APART = 1e-6
# step of the differences that make the curvature of an obstacle, in parts of the model
STEP = 1e-5
# [reference coordinates] How far beside its facet a closed point may be before it looks for another one within Newton's
# method, and after it where searches do not settle. From: chosen; what is beside an edge by rounding errors stays.
PAST = 0.05


@dataclass
class FinitePairing(Pairing):
    """Partners of the source points, whose facets are frozen until the next search.

    ``partner`` has shape functions and normals where the search found them.

    Attributes
    ----------
    points : FiniteSource
    frozen : FinitePartner
    x : ndarray (n, d)
        Undeformed places of the nodes, relative to the origin [length].
    obstacle : ObstacleAt or None
    """

    points: FiniteSource
    frozen: FinitePartner
    x: np.ndarray
    obstacle: object = None

    def partner_at(self, values, curved):
        """The partners at nodal values (n, d), of obstacles with their curvature where `curved`. *Collective.*"""
        if self.obstacle is None:
            return self.frozen
        return self.obstacle(self.points, self.frozen, values, curved)

    def lengths(self, values):
        """See :meth:`Pairing.lengths`: gaps are differences of places."""
        return np.abs(values) + np.abs(self.x), np.zeros(len(self.paired))

    def carry(self, places):
        """See :meth:`Pairing.carry`."""
        self.frozen = self.frozen._replace(start=places)


class FiniteDetection(Detection):
    """With the normals of the deformed source; parameters as for `Detection`."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.points = finite_source(self._source, self.origin)

    def turn(self, nodal):
        """Take the normals of the source under displacements (n_local, d)."""
        self.normals = np.empty_like(self._source.normal)
        current_normals(self.points, nodal, self.normals)


class ObstacleAt:
    """An obstacle at the end of a load step.

    Parameters
    ----------
    search : ObstacleSearch
    time : float
    origin : ndarray (d,)
    step : float
        Of differences of normals [length].
    """

    def __init__(self, search, time, origin, step):
        self.search, self.time, self.origin, self.step = search, time, origin, step

    def __call__(self, points, frozen, values, curved):
        """Partners with normal, gap and curvature at nodal values (n, d). *Collective.*"""
        x = places(points, values)
        gap, normal = self.search.gap(x, self.time, self.origin)
        curvature, d = np.zeros((0, x.shape[1], x.shape[1])), x.shape[1]
        if curved:
            curvature = np.empty((len(x), d, d))
            for j in range(d):
                shift = self.step * np.eye(d)[j]
                (_, ahead), (_, back) = (self.search.gap(x + s, self.time, self.origin) for s in (shift, -shift))
                curvature[:, :, j] = (back - ahead) / (2.0 * self.step)
        gap, normal = np.ascontiguousarray(gap), np.ascontiguousarray(normal)
        return frozen._replace(gap=gap, normal=normal, curvature=curvature)


def places(points, values):
    """Places (np, d) of source points, relative to the origin, at nodal values (n, d) [length]."""
    on = np.take_along_axis(points.cells, points.on, axis=1)[points.facet]
    return points.x + np.einsum("pa,pad->pd", points.shape, values[on])


def finite_source(source, origin):
    """The points of a source as kernels of finite motion want them.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface
        With the gradients of its cells.
    origin : ndarray (d,)
    """
    on = np.ascontiguousarray(facet_columns(source)[0])
    tangent, columns = tangents_of(source.normal), on[source.facet]
    grad = source.grad if source.slope is None else source.slope
    slope = np.einsum("pad,pbd->pba", grad, tangent)
    return FiniteSource(
        source.facet, source.cells, on, np.ascontiguousarray(np.take_along_axis(source.shape, columns, axis=1)),
        np.ascontiguousarray(np.take_along_axis(slope, columns[:, None], axis=2)),
        np.ascontiguousarray(source.x - origin), np.ascontiguousarray(tangent), source.jxw,
    )  # fmt: skip


def kinds_of(nodes, d, degree):
    """Kinds (np,) of facets from their nodes (np, m), of which short rows are padded with the first one."""
    if d == 2:
        return np.full(len(nodes), KIND["segment", degree])
    kinds = np.full(len(nodes), KIND["triangle", degree])
    for name in ("quadrilateral8", "quadrilateral"):
        last = len(reference_nodes(name, degree)) - 1
        if last < nodes.shape[1]:
            kinds[nodes[:, last] != nodes[:, 0]] = KIND[name, degree]
    return kinds


def _reference(kinds, degree):
    """Reference coordinates (np, 9, 2) of the nodes of facets of some kinds."""
    table = np.zeros((MAX_NODES, MAX_NODES, 2))
    for (name, order), kind in KIND.items():
        if order == degree:
            nodes = reference_nodes(name, degree)
            table[kind, : len(nodes), : nodes.shape[1]] = nodes
    return table[kinds]


def _inside(kinds, xi):
    """Return whether reference points (np, 2) are on facets of some kinds (np,), or hardly beside them."""
    u, v = xi.T
    triangle = np.isin(kinds, [KIND["triangle", degree] for degree in (1, 2)])
    inside = np.where(triangle, np.minimum(np.minimum(u, v), 1.0 - u - v) >= -PAST, np.abs(u) <= 1.0 + PAST)
    return inside & (triangle | (np.abs(v) <= 1.0 + PAST))


def _clipped(kinds, xi):
    """Reference points (np, 2) moved onto facets of some kinds (np,)."""
    low = np.where(np.isin(kinds, [KIND["triangle", degree] for degree in (1, 2)]), 0.0, -1.0)[:, None]
    xi = np.clip(xi, low, 1.0)
    return np.where(low == 0.0, xi / np.maximum(xi.sum(axis=1, keepdims=True), 1.0), xi)


class FinitePair(ContactPair):
    """One source surface and its partners at finite motion; parameters as for `ContactPair`, with `FiniteTerms`, a
    `FiniteDetection` and a source that has the gradients of its cells, whatever the formulation."""

    def __init__(self, space, contact, source, search, terms, setting):
        super().__init__(space, contact, source, search, terms, setting)
        self.verifies = self.follows = not (self.rigid or self.law.tied)
        self._stressed, self._traces = terms.traction.small, contact.search == "ray_tracing" and not self.rigid

    def detect(self, u, time, motion=0.0, ahead=None):
        """See :meth:`ContactPair.detect`. *Collective.*"""
        self._time = time
        self.terms.start()
        super().detect(u, time, motion, ahead)

    def _plan(self, nodes, paired):
        super()._plan(nodes, paired)
        space = self.space
        self._places = space.at_nodes((space.points - self.search.origin)[space.owned_local], self._planned[0])

    def _paired(self, normal, found):
        p, (n, d) = super()._paired(normal, found), normal.shape
        mode = OBSTACLE if self.rigid else TIED if self.law.tied else RAY if self._traces else CLOSEST
        kinds, xi, obstacle = np.zeros(n, dtype=np.int64), np.zeros((n, 2)), None
        self._found_at = found.place
        if self.rigid:
            obstacle = ObstacleAt(self.search.among, self._time, self.search.origin, STEP * size_of(self.space.mesh))
        else:
            kinds = kinds_of(found.nodes[:, : found.shape.shape[1]], d, self.space.degree).astype(np.int64)
            at = _reference(kinds, self.space.degree)[:, : p.target_shape.shape[1]]
            xi = np.einsum("pm,pmk->pk", p.target_shape, at)
        frozen = FinitePartner(
            np.where(p.paired, mode, NONE), np.ascontiguousarray(p.targets), kinds, xi, normal, np.zeros(n),
            np.zeros((n, d)), np.zeros(n), np.zeros((0, d, d)), np.zeros((n, d)),
            np.ascontiguousarray(p.partner.nodes[:, p.targets.shape[1] :]),
        )  # fmt: skip
        points = self.search.points._replace(cells=p.cells)
        return FinitePairing(**vars(p), points=points, frozen=frozen, x=self._places, obstacle=obstacle)

    def _take_gap(self, values, gap):
        """Modes and numbers of points that do not follow the facets alone; and of points that have lost their partner
        a plane across the normal. Tied points keep what lies between them. *Collective.*
        """
        p = self.pairing
        if self.law.tied:
            offset = np.zeros_like(self.source.x)
            tied_offsets(p.points, p.frozen, p.x, values, offset)
            p.frozen = p.frozen._replace(offset=offset)
            return
        contact = self.terms.place(p, values)
        mode = p.frozen.mode
        if not self.rigid and not self._traces:
            off = np.ones(len(mode), dtype=bool)
            # held at an edge, unless the line to the partner is not along the normal: where they touch
            for other in (HELD, FIXED):
                off &= ~self._on_facets(contact, values) | (np.abs(contact.normal - p.normal).max(axis=1) > APART)
                p.frozen = p.frozen._replace(mode=np.where((mode == CLOSEST) & off, other, p.frozen.mode))
                contact = self.terms.place(p, values)
        p.frozen = p.frozen._replace(shift=np.where(contact.live, gap - contact.gap, 0.0))
        jump = np.einsum("pa,pad->pd", self.source.shape, values[p.cells[self.source.facet]])
        jump -= np.einsum("pm,pmd->pd", p.target_shape, values[p.targets])
        p.gap0[:] = gap + np.einsum("pd,pd->p", jump, p.normal)

    def _couples(self, closed, wide):
        """Also points that are open, where the closest point's normal stands in their adjoint term."""
        if self.method.theta != 0.0 and not self.rigid:
            return self.pairing.paired
        return super()._couples(closed, wide)

    def strays(self, u):
        """Return whether a point that was closed in the last tangent is beyond the facet of its partner. *Collective.*

        There the facet that goes on is no longer the body, and farther away there is no partner any more: a pressure
        would end at once, and no displacement might fulfil the equations.
        """
        astray = False
        if self.verifies and self.status is not None:
            values = self.pairing.exchange.gather(u)
            astray = bool(np.any(self._astray(self._on_facets(self.terms.place(self.pairing, values), values))))
        return self.space.comm.allreduce(astray, op=MPI.LOR)

    def _astray(self, on):
        """Points (np,) that were closed in the last tangent, and are not on their facets or hardly beside them."""
        return False if self.status is None else self.pairing.paired & (self.status > OPEN) & ~on

    def renew(self, u, before, time, firm=False, tolerance=0.0):
        """See :meth:`pcontact.assembly.item.Item.renew`: until points have the facets that they find, whatever the
        tolerance, which is for the adjoint term. To end by that changes forces of the ironing slab by 0.7 %, and takes
        a third more iterations in short steps by ray tracing (`drivers/studies/robustness.py`). *Collective.*"""
        if not self.verifies:
            return False
        p, found, values = self.pairing, self.search.find(u, time), self.pairing.exchange.gather(u)
        force, status = self.terms.forces(p, values, self.view())
        closed, contact = status > OPEN, self.terms.place(p, values)
        on = self._on_facets(contact, values)
        touches = closed | (found.paired & (found.gap <= 0.0)) | self._astray(on)
        self.stale, *_ = misled(self, u, found, contact.normal, time)
        others = np.where(found.paired, found.ids, -1) != np.where(p.paired, p.ids, -1)
        turned = found.paired & (np.abs(found.normal - contact.normal).max(axis=1) > APART)
        # on the same facet, but held at its edge where it was not, or no longer
        changed = others if self._traces else others | turned
        if firm:
            touches &= ~(p.paired & on)
        slid = self._slid(values, contact, force)
        self.stale = max(self.stale, slid)
        left = self.space.comm.allreduce(bool(np.any(touches & changed)), op=MPI.LOR)
        if not (left or (slid > tolerance and not firm)):
            return False
        self._time = time
        if firm and not self._traces and self._former is not None:
            returns = touches & others & turned & contact.live & (found.ids == self._former.ids)
            returns &= np.einsum("pd,pd->p", found.normal, contact.normal) > 0.0
            found = self._between(found, contact, values, returns)
        self.take_again(found, u, before, time)
        return True

    def _slid(self, values, contact, force):
        """Part of the forces (np, d) by which they would be others with the adjoint of where partners are by now.
        *Collective.*"""
        if self.method.theta == 0.0 or not self.terms.traction.two_sided:
            return 0.0
        p = self.pairing
        xi = np.where(contact.live[:, None], _clipped(p.frozen.kind, contact.xi), p.frozen.xi)
        change = self.space.summed(p.exchange, self.terms.shifted(p, values, self.view(), xi))
        sums = np.linalg.norm(change, axis=1).sum(), self.source.jxw @ np.linalg.norm(force, axis=1)
        change, total = self.space.comm.allreduce(np.array(sums), op=MPI.SUM)
        return float(min(change / total, 1.0)) if total > 0.0 else 0.0

    def _on_facets(self, contact, values):
        """Points (np,) whose partner is on its facet or hardly beside it, and has not been left behind at an edge."""
        p = self.pairing
        on, held = contact.live & _inside(p.frozen.kind, contact.xi), np.isin(p.frozen.mode, (HELD, FIXED))
        if held.any():
            corners, normal = (p.x + values)[p.targets[held]], contact.normal[held]
            y = np.einsum("pm,pmd->pd", contact.shape[held], corners)
            way = y - places(p.points, values)[held]
            beside = np.linalg.norm(way - np.einsum("pd,pd->p", way, normal)[:, None] * normal, axis=1)
            length = np.linalg.norm(corners - y[:, None], axis=2).max(axis=1)
            turns = p.frozen.mode[held] == HELD
            on[held] &= beside <= np.where(turns, AWAY * np.linalg.norm(way, axis=1), 0.5 * PAST * length)
        return on

    def _between(self, found, contact, values, returns):
        """Return what was found, where points that go back to the facet that they came from are held at the edge
        between the two, by the mean of their normals: each solution is beside its own facet. *Collective.*"""
        p, normal, back = self.pairing, found.normal.copy(), returns[:, None]
        mean = contact.normal[returns] + found.normal[returns]
        normal[returns] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        p.frozen = p.frozen._replace(
            mode=np.where(returns, FIXED, p.frozen.mode), normal=normal, shift=np.where(returns, 0.0, p.frozen.shift),
            xi=np.where(back, _clipped(p.frozen.kind, contact.xi), p.frozen.xi),
        )  # fmt: skip
        held = self.terms.place(p, values)
        return found._replace(
            gap=np.where(returns, held.gap, found.gap), normal=normal, ids=np.where(returns, p.ids, found.ids),
            nodes=np.where(back, self._planned[2][p.targets], found.nodes),
            shape=np.where(back, held.shape, found.shape), place=np.where(back, self._found_at, found.place),
        )  # fmt: skip

    def normal_motion(self, u, before):
        """Largest change of the gap of a point with a partner between two displacements [length]; where bodies turn,
        the motion of points without one says nothing. *Collective.*
        """
        if self.law.tied:
            return 0.0
        p = self.pairing
        change = self.terms.gap(p, p.exchange.gather(u)) - self.terms.gap(p, p.exchange.gather(before))
        return self.space.comm.allreduce(float(np.max(np.abs(change[p.paired]), initial=0.0)), op=MPI.MAX)

    def target_shape(self, u):
        """See :meth:`ContactPair.target_shape`. *Collective.*"""
        p = self.pairing
        return p.target_shape if self.rigid else self.terms.place(p, p.exchange.gather(u)).shape

    def state(self, u):
        """See :meth:`ContactPair.state`; pressure, traction and weight are per undeformed area. *Collective.*"""
        p = self.pairing
        state = self.terms.state(p, p.exchange.gather(u), self.view())
        gap = np.where(p.paired, state["gap"], self.radius)
        return {**state, "gap": gap, "weight": self.source.jxw, "x": self.source.x}


def finite_pair(space, bulk, contact, source, target, radius, setting=NOTHING_MORE):
    """The pair of a contact between bodies of which some have finite strain. *Collective.*

    Parameters
    ----------
    bulk : pcontact.assembly.solid.Bulk
    others
        See :func:`pcontact.contact.pair.contact_pair`.

    Returns
    -------
    FinitePair
    """
    law = contact_law(contact)
    method = method_of(space, contact, source)
    if method.has_traction:
        traction = finite_traction(space, bulk, contact, source, method.alpha)
    else:
        traction = NoTraction(space, bulk, source, contact.source)
    kind = FiniteTerms if contact.pressure_overclosure is None else FiniteLayerTerms
    terms = kind(space, source, method, traction, law)
    among = partner_search(space, contact, target, law)
    search = FiniteDetection(space, contact, source, among, radius, setting.chords)
    return FinitePair(space, contact, source, search, terms, setting)
