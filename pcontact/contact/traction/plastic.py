"""Traction at contact where the parent cell may yield.

The stress in excess of linear elasticity is taken from the parent cell's own quadrature points and extrapolated to the
facet: facets have no internal variables of their own, and the tangent is the cell's. The elastic part of the traction
is that of an elastic body.

The adjoint operator of theta = 1 and -1 is that of elasticity, or (``adjoint = "consistent"``) the derivative of the
traction. The residual is continuous at yield with the first; with the second the tangent has the second derivative of
the stress.

Extrapolation is by the polynomials that the cell's points determine: constants for simplices of degree 1, linear
functions for those of degree 2, products of degree k for tensor cells of degree k, of
linear ones with reduced integration.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import some_cells
from pcontact.assembly.plastic import NO_RING
from pcontact.assembly.plastic_kernels import (
    CellPoints,
    PlasticState,
    excess_at,
    fill_operator,
    pull,
    scatter,
    square,
    strain_at,
)
from pcontact.contact.points import Excess
from pcontact.contact.traction.elastic import ElasticTraction
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.material.mandel import HALF
from pcontact.material.plastic import second_derivative
from pcontact.runtime.jit import njit, njit_inline


def _monomials(cell, degree, xi):
    """Values (n, nb) of the polynomials of extrapolation at reference points (n, d)."""
    d, kind = xi.shape[1], CELLS[cell]
    powers = np.stack(np.meshgrid(*[np.arange(degree + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    if not kind.is_tensor:
        powers = powers[powers[:, : 2 if kind.is_wedge else d].sum(axis=1) <= degree]
    return np.prod(xi[:, None, :] ** powers[None], axis=2)


def extrapolation(cell, degree, points, xi):
    """Matrix (np, nq) that takes values at a cell's quadrature points to other points of it.

    Parameters
    ----------
    cell : str
    degree : int
        Of the displacement.
    points : ndarray (nq, d)
        Quadrature points in the reference domain.
    xi : ndarray (np, d)
        Other points there.
    """
    order = degree - 1 if CELLS[cell].is_simplex else degree
    if CELLS[cell].is_tensor:
        order = min(degree, round(len(points) ** (1.0 / points.shape[1])) - 1)
    return _monomials(cell, order, xi) @ np.linalg.pinv(_monomials(cell, order, points))


@njit_inline
def _row(i, normal, k):
    """Entry (i, k) of the matrix that takes Mandel components of a stress to the traction on a normal."""
    if k < 3:
        return normal[i] if i == k else 0.0
    if k == 3:
        return HALF * normal[1 - i] if i < 2 else 0.0
    if k == 4:
        return HALF * normal[3 - i] if i > 0 else 0.0
    return HALF * normal[2 - i] if i != 1 else 0.0


class FacetPoints(NamedTuple):
    """Points on facets, to which the stress at the parent cells' own nq points is extrapolated.

    Attributes
    ----------
    points : ndarray (n,)
        Their numbers among the np points of the source.
    facet : ndarray (n,)
        Facet of each, 0 to nf - 1.
    matrix : ndarray (n, nq)
        See :func:`extrapolation`.
    """

    points: np.ndarray
    facet: np.ndarray
    matrix: np.ndarray


@njit
def _add_tractions(excess, places, normal, out):
    """Add the extrapolated excess (nf, nq, m) times the outward normal at the points to ``out`` (np, d)."""
    points, facet, matrix = places.points, places.facet, places.matrix
    d = out.shape[1]
    for n in range(len(points)):
        p = points[n]
        for q in range(excess.shape[1]):
            for k in range(excess.shape[2]):
                stress = matrix[n, q] * excess[facet[n], q, k]
                for i in range(d):
                    out[p, i] += _row(i, normal[p], k) * stress


@njit
def _add_operators(parents, tangent, yields, places, normal, first, at, out):
    """Derivative of the excess traction of the points on facets that yield, from row ``first`` of ``out`` on."""
    points, facet, matrix = places.points, places.facet, places.matrix
    nq, nn, d = parents.grad.shape[1], parents.grad.shape[2], parents.grad.shape[3]
    m = tangent.shape[2]
    operator, pulled = np.zeros((m, nn, d)), np.zeros((nq, m, nn * d))
    flat, last, row = operator.reshape(m, nn * d), -1, first
    for n in range(len(points)):
        f, p = facet[n], points[n]
        if not yields[f]:
            continue
        if f != last:
            last = f
            for q in range(nq):
                fill_operator(parents, f, q, operator)
                pull(tangent[f, q], flat, 1.0, pulled[q])
        at[p] = row
        for q in range(nq):
            for k in range(m):
                for i in range(d):
                    factor = matrix[n, q] * _row(i, normal[p], k)
                    if factor != 0.0:
                        for a in range(nn):
                            for j in range(d):
                                out[row, a, i, j] += factor * pulled[q, k, a * d + j]
        row += 1


@njit
def add_rows_adjoint(at, rows, weights, cells, facet, out):
    """Add the excess operators times vectors (np, d) at the points to ``out`` (n, d)."""
    d = weights.shape[1]
    for p in range(len(at)):
        if at[p] < 0:
            continue
        for a in range(cells.shape[1]):
            node = cells[facet[p], a]
            for j in range(d):
                for i in range(d):
                    out[node, j] += weights[p, i] * rows[at[p], a, i, j]


@njit
def _gather(places, normal, weights, out):
    """Mandel stresses (nf, nq, m), by whose work the vectors (np, d) at the points test the traction."""
    points, facet, matrix = places.points, places.facet, places.matrix
    for n in range(len(points)):
        p = points[n]
        for q in range(out.shape[1]):
            for k in range(out.shape[2]):
                for i in range(weights.shape[1]):
                    out[facet[n], q, k] += matrix[n, q] * _row(i, normal[p], k) * weights[p, i]


@njit
def _add_curvature(parents, state, nodal, weights, blocks):
    """Add second derivatives of the stress of parent cells, tested with ``weights`` (nf, nq, m), to block rows.

    Returns how many entries had no place.
    """
    material, plastic_strain, p = state.material, state.strain, state.p
    nf, nq, m = weights.shape
    nn, d = parents.grad.shape[2], parents.grad.shape[3]
    strain, work, second = np.zeros(m), np.zeros((2, m)), np.zeros((m, m))
    operator, pulled = np.zeros((m, nn, d)), np.zeros((m, nn * d))
    flat, stiffness, missing = operator.reshape(m, nn * d), np.zeros((nn * d, nn * d)), 0
    for f in range(nf):
        touched = False
        stiffness[:] = 0.0
        for q in range(nq):
            strain_at(parents, nodal, f, q, strain)
            if not second_derivative(material, strain, plastic_strain[f, q], p[f, q], weights[f, q], work, second):
                continue
            fill_operator(parents, f, q, operator)
            pull(second, flat, 1.0, pulled)
            square(flat, pulled, stiffness)
            touched = True
        if touched:
            missing += scatter(stiffness, parents.cells, f, blocks)
    return missing


@dataclass
class _Part:
    """Facets of the source whose parent cells belong to one block that may yield.

    ``state`` is that of the block, whose ``number`` it is, ``rows`` are the parent cells in it; ``grad`` and ``ring``
    are those of :class:`pcontact.assembly.plastic_kernels.CellPoints`.
    """

    number: int
    state: PlasticState
    rows: np.ndarray
    facets: slice
    grad: np.ndarray
    ring: np.ndarray
    places: FacetPoints

    def parents(self, cells):
        """Points of the parent cells, by the nodes (nf, nn) of the parent cells of all facets of the source."""
        return CellPoints(np.ascontiguousarray(cells[self.facets, : self.grad.shape[2]]), self.grad, self.ring)


def facet_points(source, which, cell, degree, rule):
    """The points of some facets of a source, in their order.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface
    which : slice
        Facets of the source, whose parent cells are of one kind.
    cell : str
        That kind.
    degree : int
        Of the displacement.
    rule : ndarray (nq, d)
        Quadrature points of the cells in the reference domain.

    Returns
    -------
    FacetPoints
    """
    # facets without a shear modulus take part without their traction
    speaks = source.mu[source.facet] > 0.0
    points = np.flatnonzero((source.facet >= which.start) & (source.facet < which.stop) & speaks)
    nodes = reference_nodes(cell, degree)
    xi = source.shape[points, : len(nodes)] @ nodes
    return FacetPoints(points, source.facet[points] - which.start, extrapolation(cell, degree, rule, xi))


class PlasticTrace:
    """Excess traction at the quadrature points of a source.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.plastic.PlasticBulk
        Holds the committed internal variables.
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.
    """

    def __init__(self, space, bulk, source, name):
        self._source, self._bulk, self._parts, first = source, bulk, [], 0
        for facets in space.mesh.facet_groups.get(name, []):
            last = first + len(facets.cells)
            if facets.block in bulk.states:
                self._parts.append(self._part(space, bulk, facets, slice(first, last)))
            first = last

    @property
    def parts(self):
        """Number of blocks of parent cells on this rank that may yield."""
        return len(self._parts)

    def _part(self, space, bulk, facets, which):
        cell = space.mesh.blocks[facets.block].cell
        rows = np.ascontiguousarray(facets.cells)
        grad, ring, rule = some_cells(space, facets.block, rows)
        return _Part(
            facets.block, bulk.states[facets.block], rows, which, grad,
            NO_RING if ring is None else np.ascontiguousarray(ring),
            facet_points(self._source, which, cell, space.degree, rule),
        )  # fmt: skip

    def _moved(self, part, values, cells):
        """Displacements (n, d) of which the parent cells of a part have the strain."""
        origin = self._bulk.origins.get(part.number)
        if origin is None:
            return values
        width, values = part.grad.shape[2], values.copy()
        nodes, local = cells[part.facets, :width], self._source.cells[part.facets, :width]
        start = values[nodes]
        values[nodes] = start - origin[local]
        return values

    def _excess(self, part, values, cells, want_tangent):
        nf, nq, m = len(part.rows), *part.state.strain.shape[1:]
        excess = np.zeros((nf, nq, m))
        tangent = np.zeros((nf, nq, m, m) if want_tangent else (0, 0, m, m))
        moved = self._moved(part, values, cells)
        yields = excess_at(part.parents(cells), part.state.of(part.rows), moved, want_tangent, excess, tangent)
        return excess, tangent, yields

    def traction(self, values, cells):
        """Excess traction (np, d) [stress].

        Parameters
        ----------
        values : ndarray (n, d)
            Displacements.
        cells : ndarray (nf, nn)
            Nodes of the parent cells of all facets of the source, numbers into ``values``.
        """
        out = np.zeros_like(self._source.x)
        for part in self._parts:
            excess, _, _ = self._excess(part, values, cells, False)
            _add_tractions(excess, part.places, self._source.normal, out)
        return out

    def operators(self, values, cells):
        """Derivatives of the excess traction with respect to the parent cell's displacements.

        Returns
        -------
        at : ndarray (np,)
            Row of each point in ``rows``; -1 where the cell is elastic.
        rows : ndarray (n, nn, d, d)
            d t_i / d u_aj [stress/length].
        """
        source, found, count = self._source, [], 0
        at = np.full(len(source.facet), -1, dtype=np.int64)
        for part in self._parts:
            _, tangent, yields = self._excess(part, values, cells, True)
            found.append((part, tangent, yields, count))
            count += int(np.sum(yields[part.places.facet]))
        rows = np.zeros((count, source.shape.shape[1], *[source.x.shape[1]] * 2))
        for part, tangent, yields, first in found:
            _add_operators(part.parents(cells), tangent, yields, part.places, source.normal, first, at, rows)
        return at, rows

    def add_adjoint(self, values, cells, weights, out):
        """Add the excess operators, tested with vectors at the points, to nodal forces.

        Parameters
        ----------
        values, cells
            As in :meth:`traction`.
        weights : ndarray (np, d)
            [length^(d-1)]
        out : ndarray (n, d)
        """
        at, rows = self.operators(values, cells)
        add_rows_adjoint(at, rows, weights, cells, self._source.facet, out)

    def add_curvature(self, values, cells, weights, blocks):
        """Add the derivative of :meth:`add_adjoint` at constant weights to blocks (BlockRows).

        Returns
        -------
        int
            Entries that have no place in the pattern.
        """
        missing = 0
        for part in self._parts:
            tested = np.zeros((len(part.rows), *part.state.strain.shape[1:]))
            _gather(part.places, self._source.normal, weights, tested)
            moved = self._moved(part, values, cells)
            missing += _add_curvature(part.parents(cells), part.state.of(part.rows), moved, tested, blocks)
        return missing


class PlasticTraction(ElasticTraction):
    """Where cells of the source may yield.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface
    trace : PlasticTrace
        Of this source.
    consistent : bool
        See `pcontact.contact.traction.elastic.ElasticTraction`.
    """

    symmetric = False

    def __init__(self, source, trace, consistent=False):
        super().__init__(source)
        self.trace, self.consistent, self.jumps = trace, consistent, consistent

    def add_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_excess`."""
        traction += self.trace.traction(values, p.cells)

    def add_normal_excess(self, values, p, traction):
        """See :meth:`ElasticTraction.add_normal_excess`."""
        traction += np.einsum("pd,pd->p", self.trace.traction(values, p.cells), p.normal)

    def excess(self, values, p):
        """See :meth:`ElasticTraction.excess`."""
        at, rows = self.trace.operators(values, p.cells)
        return Excess(at, rows, 0 if self.consistent else len(rows))

    def add_adjoint(self, values, p, weights, out):
        """See :meth:`ElasticTraction.add_adjoint`."""
        self.trace.add_adjoint(values, p.cells, weights, out)

    def add_curvature(self, values, p, weights, blocks):
        """See :meth:`ElasticTraction.add_curvature`."""
        return self.trace.add_curvature(values, p.cells, weights, blocks)
