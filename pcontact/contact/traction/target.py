"""The traction of both sides of a pair, weighted by their stiffness.

At a point X of the source with the partner Y the traction is

    t = w1 t1 - w2 J t2,    t1 = sigma(u)(X) n_X,    t2 = sigma(u)(Y) n_Y,    w1 + w2 = 1,

with the ratio J of the areas of target and source that face each other, both undeformed. With the constants l1, l2 of
the trace inequality of the two cells

    |t|^2 <= (w1^2 l1 + w2^2 J l2) (|t1|^2 / l1 + J |t2|^2 / l2),

and the integral of the last bracket over the source is bounded by the energy of the cells of both sides. So gamma =
gamma0 (w1^2 l1 + w2^2 J l2) makes the method coercive as it does with the traction of one side, and the weights that
make it least are w1 = J l2 / (l1 + J l2): the traction is mostly that of the softer side, which knows it better
(Annavarapu, Hautefeuille, Dolbow 2012). The same holds of tangential tractions with the part of the constants that
these need.

The partner sits where the search finds it: along a direction m from X, areas are as the cosines of their normals with
it, J = (s_X |n_X . m|) / (s_Y |n_Y . m|) with the current over the undeformed areas s of the two facets. Where the
partner is held at an edge, or faces it so much askew that J says little, w1 = 1. A cell whose nodes are all held has no
stress, however stiff it is: the traction is that of the other side.

Where the other surface covers less than a facet, the stress of the cell is the mean of what presses on all of the
facet, not the pressure on that part. The l of the facet is that of a cell as large as the part, l / phi in the plane
and l / sqrt(phi) in space with the part phi of its area: the stiffness of the body against a load there, whatever its
mesh. What is covered is that of the facets around a node, the one of the facet's nodes with most of it.

What is linear in the displacement is evaluated where the points are, with the nodes of both cells. What is not (cells
that yield, are heated, have begun later) is evaluated where the partners' cells are, from their state, with a message
for each evaluation; its derivative by the nodes of these cells comes the same way.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.formulation.finite_geometry import ASKEW
from pcontact.contact.formulation.methods import WEIGHT, is_unbiased
from pcontact.contact.law import sticks_by_shear
from pcontact.contact.points import Excess
from pcontact.contact.search.nearest import EDGE
from pcontact.contact.surface.sides import at_places, source_surface
from pcontact.contact.traction.small import LocalCells, Traction
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.element.shape import shape as shape_at
from pcontact.runtime.parallel import Asked
from pcontact.runtime.petsc import MPI

# [facet sizes] Gap up to which the partner of a point has a part in the traction. From: chosen, as far as facets get
# their place in the pattern before they close; nothing is asked of most points of most surfaces.
NEAR = 4.0


class Weighted(NamedTuple):
    """The sides of the points (np) of a source.

    Attributes
    ----------
    own, other : ndarray (np,)
        w1 and -w2 J.
    trace : ndarray (np,)
        w1^2 l1 + w2^2 J l2 [stress/length].
    shear : ndarray (np,) or None
        Part of it that tangential tractions need, where points stick.
    normal : ndarray (np, d)
        n_Y.
    """

    own: np.ndarray
    other: np.ndarray
    trace: np.ndarray
    shear: np.ndarray | None
    normal: np.ndarray


class Facing(NamedTuple):
    """The two sides at the points (np) of a source.

    Attributes
    ----------
    alone : ndarray (np,) of bool
        Points without a part of their partners in the traction.
    still : ndarray (np,) of bool
        Points of whose cells no node is free to move.
    ratio : ndarray (np,)
        J.
    first, second : ndarray (np, 2)
        Trace constants l1, l2 of the cells [stress/length] for what is covered of their facets, and parts in shear.
    """

    alone: np.ndarray
    still: np.ndarray
    ratio: np.ndarray
    first: np.ndarray
    second: np.ndarray


def weights(facing):
    """w1, w2 (np,) of a :class:`Facing`, the trace constant [stress/length] and its part in shear."""
    (l1, shear1), (l2, shear2), ratio = facing.first.T, facing.second.T, facing.ratio
    own = np.where(facing.alone, 1.0, np.where(facing.still, 0.0, ratio * l2 / (l1 + ratio * l2)))
    other = 1.0 - own
    parts = own**2 * l1, other**2 * ratio * l2
    trace = parts[0] + parts[1]
    return own, other, trace, (parts[0] * shear1 + parts[1] * shear2) / trace


class TargetTraction:
    """Stress of the cells of a target at partners. The constructor is *Collective*.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.solid.Bulk
        Has the materials.
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface

    Attributes
    ----------
    sticks : bool
        Whether tangential tractions need a part of the trace constant only.
    is_linear : bool
        Whether it is what has rows, and nothing besides.
    symmetric : bool
        Whether the derivative of the traction is its adjoint operator.
    traction : pcontact.contact.traction.small.Traction
        At the partners on this rank, of the last search.
    """

    def __init__(self, space, bulk, contact, source):
        self._space, self._bulk, self._name, self.sticks = space, bulk, contact.target, sticks_by_shear(contact)
        # halves of unbiased contact have half the areas of their points
        self._half = WEIGHT if is_unbiased(contact) else 1.0
        # gap up to which partners have a part in the traction [facet sizes]
        self._reach = np.inf if contact.tied else NEAR
        self._groups = space.mesh.facet_groups.get(self._name, [])
        self._side = source_surface(space, self._name, bulk.constants, 1, bulk.orthotropic, self.sticks)
        self._width = space.comm.allreduce(self._side.cells.shape[1], op=MPI.MAX)
        self._stiff = np.where(self._is_rigid(self._side.cells), np.inf, self._side.trace)
        self._is_one = contact.source == contact.target
        if self._is_one:
            # facets whose stress has what is imposed there, too
            self._stiff[source.mu == 0.0] = np.inf
        self._share, self._own_share = Share(space, self._name, self._side), Share(space, contact.source, source)
        self._prepare()

    def _prepare(self):
        """Set the traction up."""
        self.traction = Traction(self._side).of_materials(self._space, self._bulk, self._name, 0.0)
        self.is_linear, self.symmetric = self.traction.is_linear, self.traction.symmetric

    @property
    def nodes(self):
        """Nodes (n,), global numbers, of the cells of the partners on this rank; none where their traction is linear:
        it is evaluated where the points are."""
        cells = self._side.cells[np.unique(self.traction.source.facet)]
        return np.zeros(0, np.int64) if self.is_linear else self._space.nodes[cells].ravel()

    def _is_rigid(self, cells):
        """Flags of the cells (n, nn) that have no node that is free to move."""
        rigid = self._bulk.rigid
        return np.zeros(len(cells), dtype=bool) if rigid is None else rigid[cells].all(axis=1)

    def _answer(self, asked, nodal, m):
        """Answers of partners, a list of arrays of n rows: nodes, derivative of the traction; :meth:`_numbers`, normal.

        Parameters
        ----------
        asked : ndarray (n, 2 d + 1)
            Row of the facet on this rank, reference point on it, contact normal, and the area of :meth:`_facing_area`.
        nodal : ndarray (n_local, d)
        m : int
            Directions in which tractions count.
        """
        side, d, n = self._side, self._space.dim, len(asked)
        rows, xi, contact = asked[:, 0].astype(np.int64), asked[:, 1:d], np.ascontiguousarray(asked[:, d:-1])
        at, slope, order = self._surface(rows, xi)
        self._first = order
        if self.is_linear:
            self.traction = Traction(at).with_linear(self._space, self._bulk, self._name)
        else:
            self.traction = Traction(at).of_materials(self._space, self._bulk, self._name, 0.0)
        out = np.empty((*slope.shape[:2], m, d))
        self.traction.derivative(np.arange(n), np.eye(d)[None] if m == d else contact[:, None], np.ones(n), out)
        # the nodes of the facets are the first ones
        every = np.arange(n)[:, None]
        nodes = self._space.nodes[side.cells[rows]][every, order]
        numbers = self._numbers(at, slope, nodal, contact, asked[:, -1])
        return [nodes, out[every, order], np.column_stack([numbers, at.normal])]

    def _numbers(self, at, slope, nodal, contact, facing):
        """Trace constant, its part in shear, area vector along the contact normal (n, d), its length, and radius, of
        partners that all points which face this rank's facets have, with areas ``facing`` (n,): (n, 5)."""
        rows, radius = at.facet, at.x[:, 0]
        faces = area_vectors(slope, nodal[self._side.cells[rows]], at.normal)
        along, length = np.einsum("pd,pd->p", faces, contact), np.linalg.norm(faces, axis=1)
        covered = np.divide(facing, np.abs(along), out=np.zeros(len(rows)), where=along != 0.0)
        covered *= radius if self._space.axisymmetric else 1.0
        stiff = self._stiff / self._share(np.bincount(rows, covered, len(self._stiff)))
        return np.column_stack([stiff[rows], self._side.shear[rows], along, length, radius])

    def _surface(self, rows, xi):
        """Points xi (n, d - 1) of facets (n,) of this rank as those of a source, gradients of the shape functions
        (n, nn, d), and the nodes (n, nn) of the cells in an order in which those of the facets are first."""
        space, side, d, n = self._space, self._side, self._space.dim, len(rows)
        x, normal, shape = np.empty((n, d)), np.empty((n, d)), np.zeros((n, side.cells.shape[1]))
        slope, grad = np.zeros((2, *shape.shape, d))
        order, first = np.tile(np.arange(shape.shape[1]), (n, 1)), 0
        for facets in self._groups:
            c = np.flatnonzero((rows >= first) & (rows < first + len(facets.cells)))
            on, local = facet_nodes(facets.cell, space.degree), facets.local[rows[c] - first]
            x[c], normal[c], v, g, strain = self._places(facets, rows[c], first, xi[c])
            nn = v.shape[1]
            shape[c, :nn], slope[c, :nn], grad[c, :nn] = v, g, strain
            own = np.array([[*nodes, *np.setdiff1d(np.arange(nn), nodes)] for nodes in on])
            order[c, :nn] = own[local]
            first += len(facets.cells)
        # its volumetric operator follows from the others
        at = replace(side, facet=rows, x=x, normal=normal, jxw=np.ones(n), shape=shape, grad=grad, slope=None)
        return at, slope, order

    def _places(self, facets, rows, first, xi):
        """Places, normals, shape functions and gradients of :func:`at_places`, of facets of this rank (n,)."""
        space, side = self._space, self._side
        block = space.mesh.blocks[facets.block]
        table, degree = space.mesh.geometry_nodes(block)
        if not CELLS[block.cell].is_simplex or degree * space.degree > 1:
            x, normal, _, *others = at_places(space, facets, rows - first, xi)
            return x, normal, *others
        # gradients and normals do not change along the facet
        nn = table.shape[1]
        v, on = np.zeros((len(rows), nn)), facet_nodes(facets.cell, 1)[facets.local[rows - first]]
        np.put_along_axis(v, on, shape_at(facets.kind, 1, xi), axis=1)
        x = np.einsum("pa,pai->pi", v, space.mesh.points[table[facets.cells[rows - first]]])
        return x, side.normal[rows], v, side.grad[rows, :nn], side.grad[rows, :nn]

    def _replies(self, table):
        """Rows (n, k) for the partners on this rank, at the points (np, k) that asked for them. *Collective.*"""
        out = np.zeros((self._count, table.shape[1]))
        out[self._rows] = self._asked.reply(table)
        return out

    def ask(self, found, rows, columns, nodal, m):
        """Answers of the partners of some points (n,) of a source: the arrays of :meth:`_answer`, of all points (np,),
        with as many columns on all ranks; zero for the others. *Collective.*"""
        d, width, place = self._space.dim, self._width, found.place[rows]
        table = np.column_stack([place[:, 1:], columns])
        self._rows, self._count = rows, len(found.paired)
        self._asked = Asked(self._space.exchanger, place[:, 0].astype(np.int64), table)
        answers = self._answer(self._asked.rows, nodal, m)
        n, shapes = len(answers[0]), [(width,), (width, m, d), (5 + d,)]
        wide = [np.zeros((n, *shape)) for shape in shapes]
        for whole, part in zip(wide, answers, strict=True):
            whole[:, : part.shape[1]] = part
        wide[0][:, answers[0].shape[1] :] = answers[0][:, :1]
        sizes = [math.prod(shape) for shape in shapes]
        out = self._replies(np.concatenate([part.reshape(n, k) for part, k in zip(wide, sizes, strict=True)], axis=1))
        parts = np.split(out, np.cumsum(sizes)[:-1], axis=1)
        return [part.reshape(self._count, *shape) for part, shape in zip(parts, shapes, strict=True)]

    def _local(self, p):
        """Numbers of the nodes of the cells into the values of a pairing, right where there are partners."""
        every = p.exchange.nodes
        numbers = np.searchsorted(every, self._space.nodes[self._side.cells])
        return LocalCells(None, np.minimum(numbers, max(len(every) - 1, 0)))

    def beyond(self, values, p):
        """Part of t2 (np, d) that is not linear, at values (n, d) [stress]. *Collective.*"""
        out = np.zeros_like(self.traction.source.x)
        self.traction.add_excess(values, self._local(p), out)
        return self._replies(out)

    def slopes(self, values, p):
        """Its derivative (np, nt, d, d) by displacements of the partners' nodes [stress/length]. *Collective.*"""
        excess, d = self.traction.excess(values, self._local(p)), self._space.dim
        rows = np.zeros((len(self.traction.source.facet), self._width, d, d))
        if len(excess.rows):
            some = np.flatnonzero(excess.at >= 0)
            own = np.take_along_axis(excess.rows[excess.at[some]], self._first[some][:, :, None, None], axis=1)
            rows[some, : own.shape[1]] = own
        return self._replies(rows.reshape(len(rows), self._width * d**2)).reshape(self._count, self._width, d, d)

    def sides(self, found, source, nodal, m):
        """Weigh the two sides of the points of a source. *Collective.*

        Parameters
        ----------
        found : pcontact.contact.search.partners.Partners
        source : pcontact.contact.surface.sides.SourceSurface
        nodal : ndarray (n_local, d)
            Displacements at which partners were found [length].
        m : int
            Directions in which tractions count.

        Returns
        -------
        found : pcontact.contact.search.partners.Partners
            With the other nodes of the cells behind those of the facets.
        Weighted
        derivative : ndarray (np, nt, m, d)
            Of t2 by displacements of these nodes [stress/length].
        """
        near, faces = self._near(found, source), source_areas(source, nodal)
        rows = np.flatnonzero(near)
        columns = np.column_stack([found.normal, self._facing_area(found, source, faces)])[rows]
        nodes, derivative, numbers = self.ask(found, rows, columns, nodal, m)
        facing = self._facing(found, source, near, numbers, faces)
        own, other, trace, part = weights(facing)
        nodes = nodes.astype(np.int64)
        # those that are asked nothing have their facets
        rest, width = found.paired & ~near, found.nodes.shape[1]
        nodes[rest, :width], nodes[rest, width:] = found.nodes[rest], found.nodes[rest, :1]
        found = found._replace(nodes=nodes)
        part = part if self.sticks else None
        return found, Weighted(own, -other * facing.ratio, trace, part, numbers[:, 5:].copy()), derivative

    def _near(self, found, source):
        """Points (np,) that ask their partners."""
        return found.paired & (found.gap <= self._reach * source.size[source.facet])

    def _facing_area(self, found, source, faces):
        """Current area (np,) of points, with area vectors (np, d), across the direction to their partners; of a ring
        over its radius. Points whose partner is held at an edge cover nothing."""
        area = source.jxw / self._half * np.abs(np.einsum("pd,pd->p", faces, found.normal)) * (found.held < EDGE)
        return area / source.x[:, 0] if self._space.axisymmetric else area

    def _facing(self, found, source, near, numbers, faces):
        """A :class:`Facing` of the points of a source with area vectors (np, d), of which some (np,) have asked, and
        been told numbers (np, 5 or more) of :meth:`_numbers`."""
        l2, shear2, along, length, radius = numbers[:, :5].T
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(np.einsum("pd,pd->p", faces, found.normal) / along)
            askew = ratio * length / np.linalg.norm(faces, axis=1)
            if self._space.axisymmetric:
                ratio *= radius / source.x[:, 0]
            both = near & (found.held < EDGE) & (askew <= ASKEW) & (askew >= 1.0 / ASKEW)
        alone, still = ~both | np.isinf(l2), (self._is_rigid(source.cells) | (source.mu == 0.0))[source.facet]
        share = self._own_share(np.bincount(source.facet, source.jxw * both, len(source.cells)))
        first = np.column_stack([source.trace / share, source.shear])[source.facet]
        second = np.column_stack([np.where(alone, 1.0, l2), shear2])
        return Facing(alone, still, np.where(both, ratio, 1.0), first, second)


class WeightedTraction(Traction):
    """The weighted traction of both sides of a pair, in the place of that of its source.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface
    target : TargetTraction

    Attributes
    ----------
    weighted : Weighted or None
        The sides of the present pairing.
    """

    def __init__(self, source, target):
        super().__init__(source)
        self._target, self._derivative = target, None

    @property
    def is_linear(self):
        """See :attr:`Traction.is_linear`."""
        return super().is_linear and self._target.is_linear

    @property
    def symmetric(self):
        """See :class:`Traction`."""
        return self._excess is None and self._target.symmetric

    @property
    def nodes(self):
        """See :attr:`Traction.nodes`."""
        return self._target.nodes

    def weigh(self, found, nodal, m):
        """See :meth:`Traction.weigh`."""
        found, self.weighted, self._derivative = self._target.sides(found, self.source, nodal, m)
        return found

    def rows(self, axes, normal, last):
        """See :meth:`Traction.rows`."""
        (n, nn, _), other = self.source.grad.shape, self.weighted.other
        rows = np.empty((n, nn + self._derivative.shape[1], *self._derivative.shape[2:]))
        self.derivative(np.arange(n), axes, self.weighted.own, rows)
        np.multiply(other[:, None, None, None], self._derivative, out=rows[:, nn:])
        self._derivative = None
        width = np.full(n, self.source.shape.shape[1])
        width[other != 0.0] += rows.shape[1] - nn
        return rows, width

    def add_excess(self, values, p, traction):
        """See :meth:`Traction.add_excess`. *Collective.*"""
        if not super().is_linear:
            own = np.zeros_like(traction)
            super().add_excess(values, p, own)
            traction += self.weighted.own[:, None] * own
        if not self._target.is_linear:
            traction += self.weighted.other[:, None] * self._target.beyond(values, p)

    def excess(self, values, p):
        """See :meth:`Traction.excess`. *Collective.*"""
        own = super().excess(values, p)
        if self.symmetric:
            return own
        n, nn, d = self.source.grad.shape
        other = np.zeros((n, 0, d, d)) if self._target.symmetric else self._target.slopes(values, p)
        flows = (self.weighted.other != 0.0) & other.any(axis=(1, 2, 3))
        own_flows = own.at >= 0 if len(own.at) else np.zeros(n, dtype=bool)
        some = np.flatnonzero(flows | own_flows)
        at, rows = np.full(n, -1, dtype=np.int64), np.zeros((len(some), nn + other.shape[1], d, d))
        at[some] = np.arange(len(some))
        rows[:, nn:] = self.weighted.other[some, None, None, None] * other[some]
        inner = np.flatnonzero(own_flows)
        rows[at[inner], :nn] = self.weighted.own[inner, None, None, None] * own.rows[own.at[inner]]
        return Excess(at, rows, len(rows))


def area_vectors(slope, values, normal):
    """Current over undeformed area times the current normal (n, d) of facets, from gradients of shape functions
    (n, nn, d), displacements of nodes (n, nn, d), and undeformed normals (n, d)."""
    turn = np.eye(normal.shape[1]) + np.einsum("pai,paj->pij", values, slope)
    if normal.shape[1] == 2:
        # its cofactors
        turn = turn[:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    else:
        turn = np.cross(np.roll(turn, -1, axis=1), np.roll(turn, -2, axis=1))
    return np.einsum("pij,pj->pi", turn, normal)


def source_areas(source, nodal):
    """:func:`area_vectors` (np, d) of the points of a source at displacements (n_local, d)."""
    slope = source.grad if source.slope is None else source.slope
    return area_vectors(slope, nodal[source.cells[source.facet]], source.normal)


class Share:
    """Sizes of what is covered of a surface beside those of its facets; parameters as for `source_surface`, and it."""

    def __init__(self, space, name, side):
        self._space, self._areas = space, np.bincount(side.facet, side.jxw, len(side.cells))
        self._nodes, first = [], 0
        for facets in space.mesh.facet_groups.get(name, []):
            self._nodes.append((slice(first, first + len(facets.cells)), space.facet_nodes(facets)))
            first += len(facets.cells)

    def __call__(self, covered):
        """Size over that of the facet (nf,), at most 1, where areas (nf,) of facets are covered; 1 where none are.
        *Collective.*"""
        around, most = np.zeros((self._space.n_local, self._space.dim)), np.zeros(len(covered))
        for part, nodes in self._nodes:
            np.add.at(around[:, 0], nodes, covered[part, None])
        around = self._space.together(around)[:, 0]
        for part, nodes in self._nodes:
            most[part] = around[nodes].max(axis=1, initial=0.0)
        share = np.divide(most, self._areas, out=np.ones(len(most)), where=(most > 0.0) & (most < self._areas))
        return share ** (1.0 / (self._space.dim - 1))


def is_two_sided(space, bulk, contact):
    """Return whether the traction of a contact by Nitsche's method is the weighted one of both sides. *Collective.*

    It is, unless the contact says otherwise, between bodies. Where a body meets itself partners jump around corners,
    with their stress, and sides are as stiff as each other. The second derivative of the stress, which the
    consistent adjoint of cells with small strain that yield has, is that of the source alone.
    """
    if contact.target is None or contact.meets_itself or contact.traction == "source":
        return False
    groups = [space.mesh.facet_groups.get(name, []) for name in (contact.source, contact.target)]
    numbers = {facets.block for group in groups for facets in group if len(facets.cells)}
    others = set(bulk.states) if contact.adjoint == "consistent" else set()
    return space.comm.allreduce(not numbers & others, op=MPI.LAND)


def source_traction(space, bulk, contact, source, theta):
    """The traction of a contact, that of a source as its materials say or the weighted one of both sides. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.solid.Bulk
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface
    theta : float
        Of the adjoint term.

    Returns
    -------
    Traction
    """
    own = Traction(source)
    if is_two_sided(space, bulk, contact):
        own = WeightedTraction(source, TargetTraction(space, bulk, contact, source))
    return own.of_materials(space, bulk, contact.source, theta, contact.adjoint == "consistent")
