"""Traction at contact of bodies with finite strain: t = P N per undeformed area, with the first Piola-Kirchhoff stress
P of the parent cell's own quadrature points, extrapolated to the facet as in `pcontact.contact.traction.small`.

Facets of bodies without finite strain have P = sigma: t is what small strain says, on the undeformed facet.

How stiff a body is behind a facet is the largest eigenvalue of the acoustic tensor along the facet's normal N,

    Q_ik = dP_ij/dF_kl N_j N_l,

with elastic moduli, at any point of the parent cell; lambda + 2 mu in the undeformed state. For Hencky's law and a cell
that is compressed along N alone, to 1/w of its length, it is (1 + ln w) w^2 times that. How stiff it is in shear is the
second eigenvalue, mu in the undeformed state.
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
from pcontact.contact.formulation.finite_kernels import Slopes
from pcontact.contact.traction.small import FacetPoints, Traction, facet_points
from pcontact.material.finite import CONSISTENT, ELASTIC
from pcontact.material.log_strain import eigenpairs
from pcontact.runtime.jit import njit


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


@njit
def _add_elastic(source, at, rows):
    """Add the derivatives of elastic tractions of small strain to the rows ``at`` (np,) of the points."""
    d = source.normal.shape[1]
    for p in range(len(source.facet)):
        mu = source.mu[source.facet[p]]
        if at[p] < 0:
            continue
        for a in range(source.grad.shape[1]):
            along = 0.0
            for i in range(d):
                along += source.grad[p, a, i] * source.normal[p, i]
            for i in range(d):
                for j in range(d):
                    value = source.normal[p, i] * source.volumetric[p, a, j]
                    rows[at[p], a, i, j] += value + mu * source.grad[p, a, i] * source.normal[p, j]
                rows[at[p], a, i, i] += mu * along


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
    small : SourceSurface
        The source, whose facets with finite strain have no moduli.
    """

    symmetric = consistent = False
    weighted = None
    nodes = np.zeros(0, dtype=np.int64)

    def __init__(self, space, bulk, source, name):
        self.source, self._space, self._bulk, self._name = source, space, bulk, name
        self._parts, first, self._finite = [], 0, np.zeros(len(source.cells), dtype=bool)
        for facets in space.mesh.facet_groups.get(name, []):
            which = slice(first, first + len(facets.cells))
            first = which.stop
            if facets.block in bulk.parts:
                self._parts.append(self._part(facets, which))
                self._finite[which] = True
        self.small = source.mute(self._finite)
        self._rest = self._small()

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

    def adjoint(self, values, p):
        """T (np, nn, d, d), see `pcontact.contact.formulation.finite_kernels`, at nodal values (n, d). *Collective.*"""
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
        d = self.source.x.shape[1]
        at = np.where(wanted, np.cumsum(wanted) - 1, -1)
        rows = np.zeros((int(wanted.sum()), self.source.shape.shape[1], d, d))
        _add_elastic(p.source, at, rows)
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
