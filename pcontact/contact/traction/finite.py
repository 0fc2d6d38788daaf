"""Traction at contact of bodies with finite strain: t = P N per undeformed area, with the first Piola-Kirchhoff stress
P of the parent cell's own quadrature points, extrapolated to the facet as in `pcontact.contact.traction.small`.

Facets of bodies without finite strain have P = sigma: t is what small strain says, on the undeformed facet.

How stiff a body is behind a facet is the largest eigenvalue of the acoustic tensor along the facet's normal N,

    Q_ik = dP_ij/dF_kl N_j N_l,

with elastic moduli, at any point of the parent cell; lambda + 2 mu in the undeformed state. For Hencky's law and a cell
that is compressed along N alone, to 1/w of its length, it is (1 + ln w) w^2 times that. How stiff it is in shear is the
second eigenvalue, mu in the undeformed state.

The traction of both sides of a pair of which a body has finite strain, weighted by their stiffness:

    t = w1 t1 - w2 J t2,    t1 = P1(X) N_X,    t2 = P1(Y) N_Y

at a point X of the source whose partner is Y, each per undeformed area of its own side, with the ratio J of the areas
that face each other (`pcontact.contact.formulation.finite_geometry`). As partners move, so do Y, t2 and J, in the
tangent, too; the cell of the partner is that of its facet, and follows where facets are searched again.

Weights and gamma are those of `pcontact.contact.traction.small`, with the constants of the trace inequality as they
have grown in the committed state and, in the place of J, the ratio of areas as they have stretched there, which does
not change where bodies turn; at closed points it is J. They stay for a load step. Partners on facets beside convex
corners of the target have no part: the stress there is singular, and says nothing of what presses on the next facet.
In contact of all surfaces they have it: the points there are a source as well.

The stress of a partner's cell is evaluated where the cell is, with a message each way.
"""

from copy import copy
from typing import NamedTuple

import numpy as np

from pcontact.assembly.finite_kernels import (
    STRESS,
    CellWork,
    FiniteCells,
    acoustic,
    begin_cell,
    cell_piola,
    cell_work,
    point_of_cell,
)
from pcontact.assembly.geometry import some_cells_weighted
from pcontact.contact.formulation.finite_geometry import area_ratios, point_work
from pcontact.contact.formulation.finite_kernels import Sides, Slopes
from pcontact.contact.surface.smooth_geometry import beside_corners
from pcontact.contact.traction.small import (
    FacetCells,
    FacetPoints,
    LocalCells,
    TargetTraction,
    Traction,
    area_vectors,
    facet_points,
    fill_rows,
    is_two_sided,
    source_areas,
    weights,
)
from pcontact.element.reference import facet_nodes
from pcontact.material.finite import CONSISTENT, ELASTIC
from pcontact.material.log_strain import eigenpairs
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI


class _Facets(NamedTuple):
    """Facets of the source whose parent cells, ``cells``, belong to one block with finite strain: ``first`` (nf + 1,)
    says where the points of each begin in ``places``."""

    cells: FiniteCells
    first: np.ndarray
    places: FacetPoints


class _Part(NamedTuple):
    """Those of one block: its ``number``, the ``rows`` of the parent cells in it, and ``which`` of the source's facets
    they are; the quadrature points of the cells, ``rule`` (nq, d), in the reference domain; how stiff they are behind
    the facets in the undeformed state, ``soft`` (n, 2) [stress]."""

    number: int
    rows: np.ndarray
    which: slice
    facets: _Facets
    rule: np.ndarray
    soft: np.ndarray


class _Asked(NamedTuple):
    """Wishes at the points (np): ``mode``, STRESS, CONSISTENT or ELASTIC; whether they are ``wanted`` (np,);
    the row ``at`` (np,) of their derivative, -1 for none."""

    mode: int
    wanted: np.ndarray
    at: np.ndarray


class _Answer(NamedTuple):
    """Tractions (np, d) [stress], and their derivatives ``rows`` (n, nn, d, d) [stress/length]."""

    tractions: np.ndarray
    rows: np.ndarray


class _Stresses(NamedTuple):
    """Scratch: ``cell``; the stress P (nq, d, d) of a cell at its points, and its derivative (nq, d, d, nn d)."""

    cell: CellWork
    piola: np.ndarray
    slope: np.ndarray


@njit
def _add_tractions(state, facets, nodal, normal, asked, work, out):
    """Add tractions of points with outward normals (np, d) and, unless STRESS, their derivatives to an `_Answer`.

    Of a cell that cannot be integrated both are NaN.
    """
    d, cells, first, places, wanted = normal.shape[1], facets.cells, facets.first, facets.places, asked.wanted
    piola, slope = work.piola, work.slope
    for c in range(len(cells.nodes)):
        some = False
        for k in range(first[c], first[c + 1]):
            some = some or wanted[places.points[k]]
        if not some:
            continue
        good = cell_piola(state, cells, nodal, c, asked.mode, work.cell, piola, slope)
        for k in range(first[c], first[c + 1]):
            p = places.points[k]
            if not wanted[p]:
                continue
            if not good:
                out.tractions[p, :] = np.nan
                continue
            for q in range(piola.shape[0]):
                share = places.matrix[k, q]
                for i in range(d):
                    for j in range(d):
                        out.tractions[p, i] += share * piola[q, i, j] * normal[p, j]
            if asked.mode == STRESS or asked.at[p] < 0:
                continue
            row = out.rows[asked.at[p]]
            for q in range(piola.shape[0]):
                share = places.matrix[k, q]
                for i in range(d):
                    for j in range(d):
                        factor = share * normal[p, j]
                        for a in range(cells.nodes.shape[1]):
                            for m in range(d):
                                row[a, i, m] += factor * slope[q, i, j, a * d + m]


@njit
def _stiffest(state, facets, nodal, normal, work, out):
    """Stiffness of cells behind their facets, and in shear: ``out`` (nf, 2) [stress], 0 for a cell that cannot be
    integrated."""
    cells, first, points = facets.cells, facets.first, facets.places.points
    tensor, values, vectors, m = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), work.point.stress.shape[0]
    for c in range(len(cells.nodes)):
        out[c, :] = 0.0
        # facets of other pairs have no points here
        if first[c] == first[c + 1] or not begin_cell(state, cells, nodal, c, ELASTIC, work):
            continue
        for q in range(cells.grad.shape[1]):
            if not point_of_cell(state, cells, c, q, ELASTIC, work):
                break
            for k in range(first[c], first[c + 1]):
                acoustic(state, cells, c, q, normal[points[k]], work, tensor)
                eigenpairs(tensor, m, values, vectors)
                values.sort()
                for i in range(2):
                    out[c, i] = max(out[c, i], values[2 - i])


class FiniteTraction:
    """Tractions of a source and their derivatives.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.solid.Bulk
        Holds the committed internal variables.
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.

    Attributes
    ----------
    symmetric, consistent, weighted, nodes
        See `pcontact.contact.traction.small.Traction`.
    two_sided : bool
        Whether partners have a part.
    small : SourceSurface
        The source, whose facets with finite strain have no moduli.
    """

    symmetric = consistent = two_sided = False
    weighted = None
    nodes = np.zeros(0, dtype=np.int64)

    def __init__(self, space, bulk, source, name):
        self.source, self._space, self._bulk, self._name = source, space, bulk, name
        self._parts, self._finite = [], np.zeros(len(source.cells), dtype=bool)
        for facets, which in space.mesh.facets_of(name):
            if facets.block in bulk.parts:
                self._parts.append(self._part(facets, which))
                self._finite[which] = True
        self.small = source.mute(self._finite)
        self._rest = self._small()

    @property
    def uniform(self):
        """Return whether the stress of no cell varies behind its facet."""
        return bool(self._finite.all()) and all(len(part.rule) == 1 for part in self._parts)

    def at(self, source):
        """The same of other points of the same facets, one facet after the other. *Collective.*"""
        other = copy(self)
        other.source, other.small = source, source.mute(self._finite)
        other._parts = [
            part._replace(facets=other._behind(part.number, part.facets.cells, part.which, part.rule))
            for part in self._parts
        ]
        other._rest = other._small()
        return other

    def _small(self):
        """Traction of the facets without finite strain."""
        return Traction(self.small).of_materials(self._space, self._bulk, self._name, 0.0)

    def _behind(self, number, cells, which, rule):
        """Facets with the points of the source."""
        places = facet_points(self.source, which, self._space.mesh.blocks[number].cell, self._space.degree, rule)
        places = places._replace(matrix=np.ascontiguousarray(places.matrix))
        return _Facets(cells, np.searchsorted(places.facet, np.arange(len(cells.nodes) + 1)), places)

    def _part(self, facets, which):
        rows = np.ascontiguousarray(facets.cells)
        grad, jxw, shapes, rule = some_cells_weighted(self._space, facets.block, rows)
        behind = self._behind(facets.block, self._bulk.parts[facets.block].cells(rows, grad, jxw, shapes), which, rule)
        state = self._bulk.parts[facets.block].of(rows)
        state, soft = state._replace(strain=0.0 * state.strain, p=0.0 * state.p), np.empty((len(rows), 2))
        nodal, work = np.zeros_like(self._space.points), cell_work(behind.cells)
        _stiffest(state, behind, nodal, self.source.normal, work, soft)
        return _Part(facets.block, rows, which, behind, rule, soft)

    def _present(self, part, p):
        """State of the cells of a part, and its facets with the nodes of a pairing."""
        nodes = np.ascontiguousarray(p.cells[part.which, : part.facets.cells.grad.shape[2]])
        facets = part.facets._replace(cells=part.facets.cells._replace(nodes=nodes))
        return self._bulk.parts[part.number].of(part.rows), facets

    def growth(self, values, p):
        """Growth of the stiffness of the cells behind the facets at nodal values (n, d), the committed ones, from
        the undeformed state on, and of that in shear: (nf, 2), at least 1; with small strain 1."""
        found = np.ones((len(p.cells), 2))
        for part in self._parts:
            state, facets = self._present(part, p)
            stiff = np.empty((len(part.rows), 2))
            _stiffest(state, facets, values, self.source.normal, cell_work(facets.cells), stiff)
            # facets of other pairs have no points here
            ratio = np.divide(stiff, part.soft, out=np.ones_like(stiff), where=part.soft > 0.0)
            found[part.which] = np.maximum(ratio, 1.0)
        return found

    def _add(self, values, p, asked, out):
        d = out.tractions.shape[1]
        for part in self._parts:
            state, facets = self._present(part, p)
            nq, nn = facets.cells.grad.shape[1:3]
            work = _Stresses(cell_work(facets.cells), np.zeros((nq, d, d)), np.zeros((nq, d, d, nn * d)))
            _add_tractions(state, facets, values, self.source.normal, asked, work, out)

    def weigh(self, found, nodal):
        """Partners as they are: no traction of theirs counts. *Collective.*"""
        return found

    def begin(self, method, growth, values, p):
        """Give a formulation its parameters for a load step that begins at nodal values (n, d), where the cells of the
        points have grown stiffer by ``growth`` (np, 2). *Collective.*"""
        method.begin(growth)

    def reaches(self, p):
        """Points (np,) whose traction is that of the cells of their partners, too."""
        return np.zeros(len(p.paired), dtype=bool)

    def adjoint(self, values, p, xi=None):
        """T (np, nn, d, d), see `pcontact.contact.formulation.finite_kernels`, at nodal values (n, d), with partners
        where the last search has found them, or at xi (np, 2) on their facets. *Collective.*"""
        return self.slopes(values, p, p.every, elastic=True).rows

    def traction(self, values, p, wanted, contact=None):
        """Tractions (np, d) of the points that are wanted (np,) at nodal values (n, d), of both sides where they are
        by a :class:`pcontact.contact.formulation.finite.Contact` [stress]."""
        out = self._rest.linear(values, p, wanted)
        self._rest.add_excess(values, p, out)
        asked = _Asked(STRESS, wanted, np.zeros(0, dtype=np.int64))
        self._add(values, p, asked, _Answer(out, np.zeros((0, 0, 0, 0))))
        return out

    def slopes(self, values, p, wanted, elastic=False, contact=None):
        """Derivatives of the tractions of the wanted points, a `Slopes`; where `elastic`, with elastic moduli."""
        source, d = p.source, self.source.x.shape[1]
        at = np.where(wanted, np.cumsum(wanted) - 1, -1)
        cells = FacetCells(source.grad, source.volumetric, source.mu[source.facet], source.normal)
        rows = np.zeros((len(at), self.source.shape.shape[1], d, d))
        # of small strain
        fill_rows(np.flatnonzero(wanted), cells, np.eye(d)[None], np.ones(len(at)), rows)
        rows = rows[wanted]
        if not elastic:
            for own in self._rest.beyond(values, p):
                some = np.flatnonzero(wanted & (own.at >= 0)) if len(own.at) else []
                rows[at[some]] += own.rows[own.at[some]]
        asked = _Asked(ELASTIC if elastic else CONSISTENT, wanted, at)
        self._add(values, p, asked, _Answer(np.zeros_like(self.source.x), rows))
        return Slopes(at, rows)


class NoTraction(FiniteTraction):
    """Traction of a source whose stress does not enter, but its stiffness does."""

    symmetric = True

    def __init__(self, space, bulk, source, name):
        super().__init__(space, bulk, source, name)
        self.small = source

    def _small(self):
        return None

    def traction(self, values, p, wanted, contact=None):
        """Zeros (np, d)."""
        return np.zeros_like(self.source.x)

    def slopes(self, values, p, wanted, elastic=False, contact=None):
        """None at any point."""
        d = self.source.x.shape[1]
        return Slopes(np.full(len(self.source.facet), -1), np.zeros((0, self.source.shape.shape[1], d, d)))


# [reference coordinates] Step of the differences of tractions along a facet. From: chosen; tractions are polynomials of
# degree 2 at most on flat facets, of which central differences are exact, and rounding errors are 1e-12 of them.
STEP = 1e-4


class FiniteTarget(TargetTraction):
    """Stress of the cells of a target at partners that move; parameters as for `TargetTraction`.

    Attributes
    ----------
    radius : ndarray (np,)
        Undeformed, of the partners of the last search [length].
    """

    def _prepare(self):
        space = self._space
        self.is_linear = self.symmetric = False
        self._behind = FiniteTraction(space, self._bulk, self._side, self._name)
        # nodes on the facets, and others of their cells
        counts = np.zeros((len(self._side.cells), 2), dtype=np.int64)
        self._middles = np.zeros((len(counts), space.dim - 1))
        for facets, which in space.mesh.facets_of(self._name):
            on = facet_nodes(facets.cell, space.degree)
            counts[which, 0] = np.array([len(nodes) for nodes in on], dtype=np.int64)[facets.local]
            self._middles[which] = 1.0 / 3.0 if facets.kind == "triangle" else 0.0
            counts[which, 1] = space.cells[facets.block].shape[1]
        counts[:, 1] -= counts[:, 0]
        self._counts = counts
        self._widths = [space.comm.allreduce(int(k), op=MPI.MAX) for k in counts.max(axis=0, initial=0)]
        self._asked = np.zeros(0, dtype=np.int64)
        if not self._is_one:
            self._stiff[beside_corners(space, self._name)] = np.inf

    @property
    def nodes(self):
        """See :attr:`TargetTraction.nodes`."""
        return self._space.nodes[self._side.cells[self._asked]].ravel()

    def _ask(self, place, rows, columns, answer):
        """Ask the partners with places (np, k) of some points (n,), with columns (n, ...) of these: rows (n, w).

        `answer` is given facets (m,) and columns, one facet after the other. *Collective.*
        """
        def sorted_answer(table):
            order = np.argsort(table[:, 0], kind="stable")
            said = answer(table[order, 0].astype(np.int64), table[order, 1:])
            out = np.empty_like(said)
            out[order] = said
            return out

        table = np.column_stack([place[rows, 1], columns]).astype(float)
        return self._space.exchanger.ask(place[rows, 0].astype(np.int64), table, sorted_answer)

    def _layout(self, rows, order):
        """Nodes (n, mt + no) of the cells of facets (n,), those on the facets and the others, and which are real."""
        (on, others), (width, rest) = self._counts[rows].T, self._widths
        column = np.arange(width + rest)[None]
        real = np.where(column < width, column < on[:, None], column - width < others[:, None])
        at = np.where(column < width, column, column - width + on[:, None])
        return np.take_along_axis(order, np.where(real, at, 0), axis=1), real

    def sides(self, found, source, nodal):
        """Partners with the other nodes of their cells, and a :class:`pcontact.contact.traction.small.Facing`.
        *Collective.*"""
        near, faces = self._near(found, source), source_areas(source, nodal)
        rows, d, width = np.flatnonzero(near), self._space.dim, found.nodes.shape[1]

        def answer(facets, columns):
            self._asked = np.unique(facets)
            at, slope, order = self._surface(facets, columns[:, : d - 1])
            layout, _ = self._layout(facets, order)
            nodes = np.take_along_axis(self._space.nodes[self._side.cells[facets]], layout, axis=1)
            numbers = self._numbers(at, slope, nodal, np.ascontiguousarray(columns[:, d - 1 : -1]), columns[:, -1])
            return np.column_stack([numbers, nodes[:, self._widths[0] :]])

        self._asked = self._asked[:0]
        columns = np.column_stack([found.place[:, 2:], found.normal, self._facing_area(found, source, faces)])
        said = self._ask(found.place, rows, columns[rows], answer)
        numbers, nodes = np.zeros((len(near), 5)), np.repeat(found.nodes[:, :1], width + self._widths[1], axis=1)
        nodes[:, :width], numbers[rows] = found.nodes, said[:, :5]
        self.radius = numbers[:, 4]
        nodes[rows, width:] = said[:, 5:].astype(np.int64)
        return found._replace(nodes=nodes), self._facing(found, source, near, numbers, faces)

    def _at(self, facets, xi):
        """The traction at points (n, d - 1) of facets (n,), one after the other, and in the place of a pairing what it
        needs. *Collective.*"""
        at, slope, order = self._surface(facets, xi)
        return self._behind.at(at), slope, order

    def _local(self, p, small):
        """The points of a source with the numbers of the nodes of its cells in a pairing, in the place of one."""
        cells = np.minimum(np.searchsorted(p.exchange.nodes, self._space.nodes[self._side.cells]),
                           max(len(p.exchange.nodes) - 1, 0))  # fmt: skip
        return LocalCells(small.numbered(cells), np.ascontiguousarray(cells))

    def growth(self, place, rows, values, p):
        """Of the partners' facets of some points (n,): how much stiffer their cells have grown, see
        :class:`pcontact.contact.formulation.finite.FiniteTerms`, and current over undeformed area: (n, 3). In
        the middles of the facets: what partners slide does not change it. *Collective.*"""
        d = self._space.dim

        def answer(facets, _):
            some, back = np.unique(facets, return_inverse=True)
            traction, slope, _ = self._at(some, self._middles[some])
            local = self._local(p, traction.small)
            found, moved = traction.growth(values, local)[some], values[local.cells[some]]
            areas = np.linalg.norm(area_vectors(slope, moved, traction.source.normal), axis=1)
            det = np.linalg.det(np.eye(d) + np.einsum("pai,paj->pij", moved, slope))
            w = np.maximum(np.divide(areas, det, out=np.ones(len(det)), where=det > 0.0), 1.0)
            found[:, 0] = np.maximum((1.0 + np.log(w)) * w**2, found[:, 0])
            return np.column_stack([found, areas])[back]

        return self._ask(place, rows, place[rows, :0], answer)

    def tractions(self, place, rows, xi, values, p):
        """t2 (n, d) of some points (n,) with partners xi (n, d - 1) [stress]. *Collective.*"""
        def answer(facets, columns):
            traction, _, _ = self._at(facets, columns)
            every = np.ones(len(facets), dtype=bool)
            return traction.traction(values, self._local(p, traction.small), every)

        return self._ask(place, rows, xi, answer)

    def slopes(self, place, rows, xi, values, p, elastic=False):
        """t2 (n, d), t2,i (n, 2, d) and the derivative (n, mt + no, d, d) of t2 by displacements. *Collective.*"""
        d, n = self._space.dim, len(rows)
        width = sum(self._widths)

        # a cell with one point has one stress
        ends = np.zeros((0, d - 1)) if self._behind.uniform else np.eye(d - 1)

        def answer(facets, columns):
            steps = [np.zeros(d - 1), *(sign * STEP * e for e in ends for sign in (1.0, -1.0))]
            # the points of a facet come one after the other
            every = np.repeat(facets, len(steps))
            shifted = (columns[:, None] + np.array(steps)).reshape(len(every), d - 1)
            traction, _, order = self._at(every, shifted)
            local, wanted = self._local(p, traction.small), np.zeros(len(every), dtype=bool)
            t = traction.traction(values, local, ~wanted).reshape(len(facets), len(steps), d)
            along = np.zeros((len(facets), 2, d))
            along[:, : len(ends)] = (t[:, 1::2] - t[:, 2::2]) / (2.0 * STEP)
            wanted[:: len(steps)] = True
            layout, real = self._layout(facets, order[:: len(steps)])
            found = traction.slopes(values, local, wanted, elastic).rows
            found = np.take_along_axis(found, layout[:, :, None, None], axis=1) * real[:, :, None, None]
            tables = (t[:, 0], d), (along, 2 * d), (found, width * d * d)
            return np.concatenate([part.reshape(len(facets), k) for part, k in tables], axis=1)

        said = self._ask(place, rows, xi, answer)
        t, along, found = np.split(said, np.cumsum([d, 2 * d]), axis=1)
        return t, along.reshape(n, 2, d), found.reshape(n, width, d, d)


class WeightedFiniteTraction(FiniteTraction):
    """The weighted traction of both sides of a pair, in the place of that of its source; parameters as for
    `FiniteTraction`, and the :class:`FiniteTarget` and alpha (np,) of the undeformed source."""

    two_sided = True

    def __init__(self, space, bulk, source, name, other):
        super().__init__(space, bulk, source, name)
        self._target, self._alpha = other
        # a contact, and what partners add to the traction there
        self._last = None, None

    @property
    def nodes(self):
        """See :attr:`FiniteTraction.nodes`."""
        return self._target.nodes

    def weigh(self, found, nodal):
        """See :meth:`FiniteTraction.weigh`. *Collective.*"""
        found, self._facing = self._target.sides(found, self.source, nodal)
        self._place, self._both = found.place, ~self._facing.alone
        self._own, self._other, _, _ = weights(self._facing)
        self._last = None, None
        return found

    def begin(self, method, growth, values, p):
        """See :meth:`FiniteTraction.begin`. *Collective.*"""
        facing, rows, self._last = self._facing, np.flatnonzero(self._both), (None, None)
        other, ratio, source = np.ones_like(growth), np.ones(len(growth)), self.source
        found = self._target.growth(self._place, rows, values, p)
        slope, moved = source.grad if source.slope is None else source.slope, values[p.cells[source.facet[rows]]]
        areas = np.linalg.norm(area_vectors(slope[rows], moved, source.normal[rows]), axis=1)
        other[rows], ratio[rows] = found[:, :2], areas / found[:, 2]
        if self._space.axisymmetric:
            ratio[rows] *= self._target.radius[rows] / source.x[rows, 0]
        first, second = facing.first.copy(), facing.second.copy()
        first[:, 1] = self._alpha
        if not self._target.sticks:
            second[:, 1] = self._alpha
        for side, grown in ((first, growth), (second, other)):
            # see :meth:`pcontact.contact.formulation.methods.Method.begin`
            side[:, 1] = np.maximum(side[:, 1], np.minimum(1.0, side[:, 1] * grown[:, 1] / grown[:, 0]))
            side[:, 0] *= grown[:, 0]
        self._facing = facing._replace(ratio=ratio)
        self._own, self._other, trace, part = weights(self._facing._replace(first=first, second=second))
        method.take_trace(trace)
        method.take_alpha(part)
        method.begin()

    def reaches(self, p):
        """See :meth:`FiniteTraction.reaches`."""
        return self._both

    def adjoint(self, values, p, xi=None):
        """See :meth:`FiniteTraction.adjoint`. *Collective.*"""
        own = super().slopes(values, p, p.every, elastic=True).rows
        xi = (p.frozen.xi if xi is None else xi)[:, : self._space.dim - 1]
        return self._joined(own, p.every, self._both, xi, self._facing.ratio, values, p, True)[0]

    def _moved(self, p, contact, wanted):
        """Points (np,) whose partner has a part, of those that are wanted; J (np,), and the axis of symmetry."""
        axis = np.inf
        if self._space.axisymmetric and len(self.source.x):
            axis = float(p.points.x[0, 0] - self.source.x[0, 0])
        ratio, d = (self._both & wanted & contact.placed.live).astype(float), self._space.dim
        work = point_work(d, p.points.on.shape[1] + p.targets.shape[1])
        area_ratios(p.points, contact.partner, contact.motion, axis, work, ratio)
        return ratio != 0.0, ratio, axis

    def traction(self, values, p, wanted, contact=None):
        """See :meth:`FiniteTraction.traction`. *Collective.*"""
        own = super().traction(values, p, wanted)
        return self._own[:, None] * own + self._added(values, p, contact)

    def _added(self, values, p, contact):
        """-w2 J t2 (np, d), where points have partners. *Collective.*"""
        if self._last[0] is not contact:
            both, ratio, _ = self._moved(p, contact, p.paired)
            rows, xi = np.flatnonzero(both), contact.placed.xi[:, : self._space.dim - 1]
            other = self._target.tractions(self._place, rows, xi[rows], values, p)
            added = np.zeros_like(self.source.x)
            added[rows] = -(self._other * ratio)[rows, None] * other
            self._last = contact, added
        return self._last[1]

    def _joined(self, own, wanted, both, xi, ratio, values, p, elastic):
        """Rows of the wanted points by the nodes of both cells, and t2 (np, d) and t2,i (np, 2, d). *Collective.*"""
        d, rows = self._space.dim, np.flatnonzero(both)
        other, along = np.zeros((len(both), d)), np.zeros((len(both), 2, d))
        other[rows], along[rows], found = self._target.slopes(self._place, rows, xi[rows], values, p, elastic)
        joined = np.zeros((len(own), own.shape[1] + found.shape[1], d, d))
        at = np.cumsum(wanted) - 1
        joined[:, : own.shape[1]] = self._own[wanted][:, None, None, None] * own
        joined[at[rows], own.shape[1] :] = -(self._other * ratio)[rows, None, None, None] * found
        return joined, other, along

    def slopes(self, values, p, wanted, elastic=False, contact=None):
        """See :meth:`FiniteTraction.slopes`. *Collective.*"""
        own = super().slopes(values, p, wanted, elastic)
        both, ratio, axis = self._moved(p, contact, wanted)
        xi = contact.placed.xi[:, : self._space.dim - 1]
        joined, other, along = self._joined(own.rows, wanted, both, xi, ratio, values, p, elastic)
        weight = np.where(self._both, -self._other, 0.0)
        return Slopes(own.at, joined, Sides(weight, other, along, axis))


def finite_traction(space, bulk, contact, source, alpha):
    """The traction of a contact, that of a source or the weighted one of both sides. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.solid.Bulk
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface
    alpha : ndarray (np,)
        Of the undeformed source.

    Returns
    -------
    FiniteTraction
    """
    if not is_two_sided(space, bulk, contact):
        return FiniteTraction(space, bulk, source, contact.source)
    target = FiniteTarget(space, bulk, contact, source)
    return WeightedFiniteTraction(space, bulk, source, contact.source, (target, alpha))
