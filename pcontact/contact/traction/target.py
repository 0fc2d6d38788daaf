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

Surfaces that do not match have two normals, and the traction of a side has a part along its own facet: the side that
gives the traction gives the normal, too, n = (w1 n_X - w2 n_Y) / |.| of the undeformed facets. The partner that the
search has found is moved along its facet until it lies on n, else moments of the two sides would differ. Areas are as
the cosines of their normals with n, J = (s_X |n_X . n|) / (s_Y |n_Y . n|) with the current over the undeformed areas s
of the two facets; along the mean normal, for the weights of n, they are as s_X to s_Y: both ways round n and the
weights are the same.
Where the partner is held at an edge, or faces the point much askew, w1 = 1 and the normal is that of the search. A cell
whose nodes are all held has no stress, however stiff it is: the traction is that of the other side.

What is linear in the displacement is evaluated where the points are, with the nodes of both cells. What is not (cells
that yield, are heated, have begun later) is evaluated where the partners' cells are, from their state, with a message
for each evaluation; its derivative by the nodes of these cells comes the same way.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.points import Excess
from pcontact.contact.search.table import EDGE
from pcontact.contact.surface.sides import at_places, source_surface
from pcontact.contact.traction.small import LocalCells, Traction
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.element.shape import shape as shape_at
from pcontact.element.shape import shape_gradient
from pcontact.runtime.jit import njit
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI

# [facet sizes] Gap up to which the partner of a point has a part in the traction. From: chosen, as far as facets get
# their place in the pattern before they close; nothing is asked of most points of most surfaces.
NEAR = 4.0
# [-] Inverse cosine of the angle between facets beyond which the partner has no part in the traction. From: chosen,
# 75 degrees.
ASKEW = 4.0
# [reference coordinates] Way of a partner along its facet, at most, until it lies along the weighted normal. From:
# chosen; points that go farther are open.
BESIDE = 0.5
# facets that are flat where they are of degree 1
FLAT = "segment", "triangle"
# [iterations] Of Newton's method for that place. From: one for flat facets; it converges quadratically.
ROUNDS = 3


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


class TargetTraction:
    """Stress of the cells of a target at partners. The constructor is *Collective*.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.bulk.Bulk
        Has the materials.
    target : pcontact.contact.surface.sides.TargetSurface
    contact : pcontact.scene.model.Contact
        With its numerics resolved.

    Attributes
    ----------
    is_linear : bool
        Whether it is what has rows, and nothing besides.
    symmetric : bool
        Whether the derivative of the traction is its adjoint operator.
    """

    def __init__(self, space, bulk, target, contact):
        name, self._sticks = contact.target, contact.alpha is None
        self.space, self._bulk, self._name, self._target = space, bulk, name, target
        # tied points take part wherever their partners are
        self._reach, self._groups = np.inf if contact.tied else NEAR, space.mesh.facet_groups.get(name, [])
        self.side = source_surface(space, name, bulk.constants, 1, bulk.orthotropic, self._sticks)
        self.width = space.comm.allreduce(self.side.cells.shape[1], op=MPI.MAX)
        # the normal is the same all over a facet
        self._flat = space.degree == 1 and not space.mesh.curved and all(f.kind in FLAT for f in self._groups)
        self._stiff = np.where(self._is_rigid(self.side.cells), np.inf, self.side.trace)
        traction = self.traction(self.side)
        self.is_linear, self.symmetric = traction.is_linear, traction.symmetric

    def _is_rigid(self, cells):
        """Which of some cells (n, nn) have no node that is free to move."""
        rigid = self._bulk.rigid
        return np.zeros(len(cells), dtype=bool) if rigid is None else rigid[cells].all(axis=1)

    def traction(self, at):
        """That of the cells at points on facets of the target. *Collective.*"""
        return Traction(at).of_materials(self.space, self._bulk, self._name, 0.0)

    def _at(self, rows, xi):
        """Points on facets of this rank, a `SourceSurface`; gradients (n, nn, d) of the cells as they are, and the
        order (n, nn) of their nodes in which those of the facet are the first ones."""
        side, d, n, first = self.side, self.space.dim, len(rows), 0
        x, normal, shape = np.empty((n, d)), np.empty((n, d)), np.zeros((n, side.cells.shape[1]))
        slope, grad = np.zeros((2, *shape.shape, d))
        order = np.tile(np.arange(shape.shape[1]), (n, 1))
        for facets in self._groups:
            c = np.flatnonzero((rows >= first) & (rows < first + len(facets.cells)))
            x[c], normal[c], v, g, strain = self._places(facets, rows[c], first, xi[c])
            nn = v.shape[1]
            shape[c, :nn], slope[c, :nn], grad[c, :nn] = v, g, strain
            on = facet_nodes(facets.cell, self.space.degree)
            own = np.array([[*nodes, *np.setdiff1d(np.arange(nn), nodes)] for nodes in on])
            order[c, :nn] = own[facets.local[rows[c] - first]]
            first += len(facets.cells)
        # its volumetric operator follows from the others
        at = replace(side, facet=rows, x=x, normal=normal, jxw=np.ones(n), shape=shape, grad=grad, slope=None)
        return at, slope, order

    def _places(self, facets, rows, first, xi):
        """Places, normals, shape functions and gradients of :func:`at_places`, of facets of this rank (n,)."""
        space, side = self.space, self.side
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

    def _facing(self, rows, xi):
        """Normals (n, d), gradients (n, nn, d) of shape functions and radii (n,) of undeformed facets of this rank."""
        if self._flat:
            slope = self.side.grad if self.side.slope is None else self.side.slope
            return self.side.normal[rows], slope[rows], self.side.x[rows, 0]
        at, slope, _ = self._at(rows, xi)
        return at.normal, slope, at.x[:, 0]

    def _meets(self, rows, xi, lines, nodal, origin):
        """Where lines, places (n, d) and unit directions (n, d), meet the deformed facets of partners, continued beyond
        their borders: reference points (n, d - 1), and distances along the lines (n,) [length]."""
        mesh, space, first = self.space.mesh, self.space, 0
        places, along = lines
        x, xi, way = self._target.deformed(nodal, origin)[rows], xi.copy(), np.zeros(len(rows))
        for facets in self._groups:
            c = np.flatnonzero((rows >= first) & (rows < first + len(facets.cells)))
            kind, degree = CELLS[facets.kind].complete or facets.kind, max(2 if mesh.curved else 1, space.degree)
            for _ in range(1 if self._flat else ROUNDS):
                values, slopes = shape_at(kind, degree, xi[c]), shape_gradient(kind, degree, xi[c])
                nodes = x[c, : values.shape[1]]
                off = np.einsum("pa,pai->pi", values, nodes) - places[c]
                tangents = np.einsum("paj,pai->pij", slopes, nodes)
                step = np.linalg.solve(np.concatenate([tangents, -along[c][:, :, None]], axis=2), -off[:, :, None])
                xi[c], way[c] = xi[c] + step[:, :-1, 0], step[:, -1, 0]
            first += len(facets.cells)
        return xi, way

    def answer(self, asked, nodal, origin):
        """What partners on this rank say. *Collective.*

        Parameters
        ----------
        asked : ndarray (n, 5 d + 1)
            Row of the facet on this rank and reference point on it; contact normal of the search, deformed point of the
            source relative to the origin, its normal, current area vector over the undeformed area, trace constant of
            its cell.
        nodal : ndarray (n_local, d)
        origin : ndarray (d,)

        Returns
        -------
        at : pcontact.contact.surface.sides.SourceSurface
            The partners.
        order : ndarray (n, nn)
            Nodes of their cells, those of the facets first.
        contact : ndarray (n, d)
            Contact normals.
        numbers : ndarray (n, 4 + 3 d + m)
            Trace constant, infinite where the partner has no say; its part in shear; ratio of areas; gap; contact
            normal; reference point, with one more column; normal; shape functions of the nodes of the facet.
        """
        d, rows = self.space.dim, asked[:, 0].astype(np.int64)
        xi, found, x, own, faces, l1 = np.split(asked[:, 1:], [k * d - 1 for k in range(1, 6)], axis=1)
        face, slope, radius = self._facing(rows, xi)
        normal, l2 = area_vectors(slope, nodal, self.side.cells[rows], face), self._stiff[rows]
        size, other = (np.linalg.norm(one, axis=1) for one in (faces, normal))
        with np.errstate(divide="ignore", invalid="ignore"):
            # the same from both sides: areas that face each other along the mean normal
            ratio = size / other * (radius if self.space.axisymmetric else 1.0)
            part = np.nan_to_num(harmonic(l1[:, 0], l2, ratio))[:, None]
            along = part * own - (1.0 - part) * face
            along /= np.linalg.norm(along, axis=1)[:, None]
            both = np.isfinite(l2) & (np.einsum("pd,pd->p", own, face) <= -1.0 / ASKEW)
        along = np.where(both[:, None], along, found)
        moved, gap = self._meets(rows, xi, (x, along), nodal, origin)
        # what leaves the facet by much is far from closing: it keeps the partner of the search
        beside = np.abs(moved - xi).max(axis=1, initial=0.0) > BESIDE
        along, moved = np.where(beside[:, None], found, along), np.where((beside | ~both)[:, None], xi, moved)
        gap[beside | ~both] = np.nan
        at, slope, order = self._at(rows, moved)
        normal = area_vectors(slope, nodal, at.cells[rows], at.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(np.einsum("pd,pd->p", faces, along) / np.einsum("pd,pd->p", normal, along))
            ratio *= at.x[:, 0] if self.space.axisymmetric else 1.0
        shape = self._target.shape(rows, moved)
        numbers = [np.where(both, l2, np.inf), at.shear[rows], ratio, gap, along, moved, np.zeros(len(rows)), at.normal]
        return at, order, along, np.column_stack([*numbers, shape])

    def sides(self, found, source, nodal, x, origin):
        """What both sides of the points of a source say at the partners that a search has found. *Collective.*

        Parameters
        ----------
        found : pcontact.contact.search.partners.Partners
        source : pcontact.contact.surface.sides.SourceSurface
        nodal : ndarray (n_local, d)
            Displacements at which partners were found [length].
        x : ndarray (np, d)
            The points under them, relative to the origin [length].
        origin : ndarray (d,)

        Returns
        -------
        pcontact.contact.search.partners.Partners
            With the weighted normal, the partner and the gap along it, and the ``sides``.
        """
        d = self.space.dim
        near = found.paired & (found.gap <= self._reach * source.size[source.facet]) & (found.held < EDGE)
        rows, facet = np.flatnonzero(near), source.facet
        slope = source.grad if source.slope is None else source.slope
        faces = area_vectors(slope[rows], nodal, source.cells[facet[rows]], source.normal[rows])
        if self.space.axisymmetric:
            faces /= source.x[rows, :1]
        l1 = np.where(self._is_rigid(source.cells), np.inf, source.trace)[facet]
        place = found.place[rows]
        asking = np.column_stack([place[:, 1:], found.normal[rows], x[rows], source.normal[rows], faces, l1[rows]])
        sends, order = split_by_rank(place[:, 0].astype(np.int64), asking)
        asked = self.space.exchanger(sends, np.float64, asking.shape[1])
        answer = self.answer(np.concatenate([np.zeros((0, asking.shape[1])), *asked.values()]), nodal, origin)
        counts = [(rank, len(one)) for rank, one in asked.items()]
        sides = Sides(self, *answer[:3], counts, rows[order], len(facet))
        numbers = sides.replies(answer[3])
        l2, shear2, ratio, gap = numbers[:, :4].T
        normal, xi, face, shape = np.split(numbers[:, 4:], [d, 2 * d, 3 * d], axis=1)
        both = near & np.isfinite(l2)
        ratio, l2 = np.where(both, ratio, 1.0), np.where(both, l2, 1.0)
        own = np.where(both, harmonic(l1, l2, ratio), 1.0)
        l1 = source.trace[facet]
        parts = own**2 * l1, (1.0 - own) ** 2 * ratio * l2
        trace = parts[0] + parts[1]
        part = (parts[0] * source.shear[facet] + parts[1] * shear2) / trace if self._sticks else None
        sides.weighted = Weighted(own, -(1.0 - own) * ratio, trace, part, np.ascontiguousarray(face))
        moved, wide = both & np.isfinite(gap), np.zeros_like(found.shape)
        wide[:, : shape.shape[1]] = shape
        turned = found._replace(sides=sides, gap=np.where(moved, gap, found.gap))
        for key, one in (("normal", normal), ("shape", wide)):
            turned = turned._replace(**{key: np.where(moved[:, None], one, getattr(found, key))})
        return turned


class Sides:
    """Points of a source and their partners, as a search has found them.

    Parameters
    ----------
    target : TargetTraction
    at, order, contact
        Of the partners on this rank, see :meth:`TargetTraction.answer`.
    asked : list of (int, int)
        Ranks whose points they are the partners of, and how many of each.
    rows : ndarray (n,)
        Points of this rank that have asked, in the order of the answers.
    count : int
        Points of this rank.

    Attributes
    ----------
    weighted : Weighted
    """

    weighted = None

    def __init__(self, target, at, order, contact, asked, rows, count):
        self._target, self._at, self._order, self._contact = target, at, order, contact
        self._asked, self._rows, self._count, self._traction = asked, rows, count, None

    @property
    def nodes(self):
        """Nodes (n,), global numbers, of the cells of the partners on this rank; none where their traction is linear:
        it is evaluated where the points are."""
        target = self._target
        cells = target.side.cells[np.unique(self._at.facet)]
        return np.zeros(0, np.int64) if target.is_linear else target.space.nodes[cells].ravel()

    def replies(self, table):
        """Rows (n, k) for the partners on this rank, at the points (np, k) that asked for them. *Collective.*"""
        ranks, ends = [rank for rank, _ in self._asked], np.cumsum([count for _, count in self._asked])
        replies = dict(zip(ranks, np.split(table, ends[:-1]), strict=True)) if ranks else {}
        back = self._target.space.exchanger(replies, np.float64, table.shape[1])
        out = np.zeros((self._count, table.shape[1]))
        if len(self._rows):
            out[self._rows] = np.concatenate([back[rank] for rank in sorted(back)])
        return out

    def derivative(self, m):
        """Nodes of the partners' cells (np, nt), those of the facets first, and the derivative (np, nt, m, d) of t2 by
        their displacements in m directions [stress/length]; zero where nothing was asked. *Collective.*"""
        target, n, d, width = self._target, len(self._at.facet), self._contact.shape[1], self._target.width
        out, nn = np.empty((n, self._at.shape.shape[1], m, d)), self._at.shape.shape[1]
        axes = np.eye(d)[None] if m == d else np.ascontiguousarray(self._contact[:, None])
        self._traction = target.traction(self._at)
        self._traction.derivative(np.arange(n), axes, np.ones(n), out)
        nodes = np.take_along_axis(target.space.nodes[target.side.cells[self._at.facet]], self._order, axis=1)
        wide = np.zeros((n, width * (1 + m * d)))
        wide[:, :width], wide[:, :nn] = nodes[:, :1], nodes
        wide[:, width : width + nn * m * d] = self._first(out).reshape(n, nn * m * d)
        nodes, rows = np.split(self.replies(wide), [width], axis=1)
        return nodes.astype(np.int64), rows.reshape(self._count, width, m, d)

    def _first(self, rows, some=slice(None)):
        """Rows (n, nn, m, d) of nodes of cells, those of the facets first."""
        return np.take_along_axis(rows, self._order[some][:, :, None, None], axis=1)

    def _local(self, p):
        """Numbers of the nodes of the cells into the values of a pairing, right where there are partners."""
        every, target = p.exchange.nodes, self._target
        numbers = np.searchsorted(every, target.space.nodes[target.side.cells])
        return LocalCells(None, np.minimum(numbers, max(len(every) - 1, 0)))

    def beyond(self, values, p):
        """What is not linear in t2 (np, d), at values (n, d) [stress]. *Collective.*"""
        out = np.zeros_like(self._at.x)
        self._traction.add_excess(values, self._local(p), out)
        return self.replies(out)

    def slopes(self, values, p):
        """Its derivative (np, nt, d, d) by displacements of the partners' nodes [stress/length]. *Collective.*"""
        excess, d, width = self._traction.excess(values, self._local(p)), self._at.x.shape[1], self._target.width
        rows = np.zeros((len(self._at.facet), width, d, d))
        if len(excess.rows):
            some = np.flatnonzero(excess.at >= 0)
            rows[some, : excess.rows.shape[1]] = self._first(excess.rows[excess.at[some]], some)
        return self.replies(rows.reshape(len(rows), width * d**2)).reshape(self._count, width, d, d)


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
        self._target, self._sides = target, None

    @property
    def weighted(self):
        """See :class:`Traction`."""
        return None if self._sides is None else self._sides.weighted

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
        return self._sides.nodes

    def face(self, found, nodal, x, origin):
        """See :meth:`Traction.face`."""
        return self._target.sides(found, self.source, nodal, x, origin)

    def weigh(self, found, m):
        """See :meth:`Traction.weigh`."""
        self._sides = found.sides
        nodes, self._derivative = self._sides.derivative(m)
        # those that have no part in the traction have their facets
        alone, width = self.weighted.other == 0.0, found.nodes.shape[1]
        nodes[alone, :width], nodes[alone, width:] = found.nodes[alone], found.nodes[alone, :1]
        return found._replace(nodes=nodes)

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
            traction += self.weighted.other[:, None] * self._sides.beyond(values, p)

    def excess(self, values, p):
        """See :meth:`Traction.excess`. *Collective.*"""
        own = super().excess(values, p)
        if self.symmetric:
            return own
        n, nn, d = self.source.grad.shape
        other = np.zeros((n, 0, d, d)) if self._target.symmetric else self._sides.slopes(values, p)
        flows = (self.weighted.other != 0.0) & other.any(axis=(1, 2, 3))
        own_flows = own.at >= 0 if len(own.at) else np.zeros(n, dtype=bool)
        some = np.flatnonzero(flows | own_flows)
        at, rows = np.full(n, -1, dtype=np.int64), np.zeros((len(some), nn + other.shape[1], d, d))
        at[some] = np.arange(len(some))
        rows[:, nn:] = self.weighted.other[some, None, None, None] * other[some]
        inner = np.flatnonzero(own_flows)
        rows[at[inner], :nn] = self.weighted.own[inner, None, None, None] * own.rows[own.at[inner]]
        return Excess(at, rows, len(rows))


def harmonic(l1, l2, ratio):
    """Weight w1 (n,) of the source from the trace constants of both sides and the ratio of areas; 0 for a source whose
    constant is infinite."""
    return ratio * l2 / (l1 + ratio * l2)


@njit
def area_vectors(slope, nodal, cells, normal):
    """Current over undeformed area times the current normal (n, d) of facets: cof(F) n.

    Parameters
    ----------
    slope : ndarray (n, nn, d)
        Gradients of the shape functions of their cells [1/length].
    nodal : ndarray (n_local, d)
        Displacements [length].
    cells : ndarray (n, nn)
        Nodes.
    normal : ndarray (n, d)
        Undeformed.
    """
    d = normal.shape[1]
    out, f = np.empty(normal.shape), np.zeros((3, 3))
    for p in range(len(normal)):
        f[:] = 0.0
        for i in range(3):
            f[i, i] = 1.0
        for a in range(cells.shape[1]):
            for i in range(d):
                for j in range(d):
                    f[i, j] += nodal[cells[p, a], i] * slope[p, a, j]
        for i in range(d):
            out[p, i] = 0.0
            for j in range(d):
                k, m, r, t = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                out[p, i] += (f[k, r] * f[m, t] - f[k, t] * f[m, r]) * normal[p, j]
    return out


def is_two_sided(space, bulk, contact):
    """Whether the traction of a contact by Nitsche's method is the weighted one of both sides. *Collective.*

    It is, unless the contact says otherwise, for two surfaces of bodies with small strain. The second derivative of the
    stress, which the consistent adjoint of cells that yield has, is that of the source alone.
    """
    if contact.target in (None, contact.source) or contact.all or contact.traction == "source":
        return False
    groups = [space.mesh.facet_groups.get(name, []) for name in (contact.source, contact.target)]
    numbers = {facets.block for group in groups for facets in group if len(facets.cells)}
    others = set(bulk.parts) | (set(bulk.states) if contact.adjoint == "consistent" else set())
    return space.comm.allreduce(not numbers & others, op=MPI.LAND)


def source_traction(space, bulk, contact, sides, theta):
    """The traction of a contact, that of a source as its materials say or the weighted one of both sides. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.bulk.Bulk
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    sides : (SourceSurface, TargetSurface or RigidObstacle)
        See `pcontact.contact.surface`.
    theta : float
        Of the adjoint term.

    Returns
    -------
    Traction
    """
    source, target = sides
    own = Traction(source)
    if is_two_sided(space, bulk, contact):
        own = WeightedTraction(source, TargetTraction(space, bulk, target, contact))
    return own.of_materials(space, bulk, contact.source, theta, contact.adjoint == "consistent")
