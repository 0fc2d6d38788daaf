"""The traction t = sigma(u) n_X of a source with small strain, as the materials of its cells say.

That of isotropic elasticity, sigma = (P . u) I + 2 mu eps, is evaluated at the points of the facets, with operators of
the source. What is added where the law of a cell is another one:

* **C_dev : eps.** It is linear, so its derivative is known once and for all, at a point and by node

      d t_i / d u_aj = sum_(k, l) N_ik C_dev,kl B_l,aj

  with the strain operator B of the parent cell at the point, and N from stresses to the traction on n_X. The adjoint of
  theta = 1 and -1 has it, too: the method is consistent, and symmetric where that of an isotropic body is.

* **The excess** of a law that is not linear is taken from the parent cell's own points and extrapolated to the facet:
  facets have no internal variables of their own, and the tangent is the cell's. Extrapolation is by the polynomials
  that the cell's points determine: constants for simplices of degree 1, linear functions for those of degree 2,
  products of degree k for tensor cells of degree k, of linear ones with reduced integration. The adjoint operator of
  theta = 1 and -1 is that of elasticity, or (``adjoint = "consistent"``) the derivative of the traction. The residual
  is continuous at yield with the first; with the second the tangent has the second derivative of the stress.

* **What does not depend on the displacement**: the stress of heated cells at zero strain, and minus the linear traction
  at the displacement from which bodies count their strain that have begun without any.

The traction of both sides of a pair, weighted by their stiffness.

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
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import some_cells
from pcontact.assembly.solid import PointStates
from pcontact.assembly.strains import CellPoints, add_stiffness, cell_points, fill_operator, pull
from pcontact.contact.formulation.finite_geometry import ASKEW
from pcontact.contact.formulation.methods import WEIGHT, is_unbiased
from pcontact.contact.law import sticks_by_shear
from pcontact.contact.points import Excess, SourcePoints, no_excess
from pcontact.contact.search.projection import EDGE
from pcontact.contact.surface.sides import at_places, source_surface
from pcontact.element.dilatation import hoop_operator
from pcontact.element.reference import CELLS, facet_nodes, reference_nodes
from pcontact.element.reference import shape as shape_at
from pcontact.material.elastic import FLOWS, STILL
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.jit import njit, njit_inner
from pcontact.runtime.parallel import Asked
from pcontact.runtime.petsc import MPI


class FacetCells(NamedTuple):
    """Points (np) on facets, of which the stress of the cell is asked for.

    Attributes
    ----------
    grad : ndarray (np, nn, d)
        Shape gradients of the cell [1/length].
    volumetric : ndarray (np, nn, d)
        Volumetric operator P, lam G in plane strain [stress/length].
    mu : ndarray (np,)
        Shear modulus [stress].
    normal : ndarray (np, d)
        Outward normal n_X of the facet.
    """

    grad: np.ndarray
    volumetric: np.ndarray
    mu: np.ndarray
    normal: np.ndarray


@njit
def fill_rows(points, cells, axes, factor, out):
    """Derivative of the components of the elastic boundary traction along directions e_k, at some points.

    Parameters
    ----------
    points : ndarray (n,)
        Those whose rows of ``out`` are written.
    cells : FacetCells
    axes : ndarray (1 or np, m, d)
        The directions.
    factor : ndarray (np,)
        What the traction is multiplied with.
    out : ndarray (np, nr, m, d)
        With the nodes of the cells in its first columns.
        (n_X . e_k) P_a + mu ((G_a . n_X) e_k + (G_a . e_k) n_X) [stress/length].
    """
    grad, volumetric, normal, last = cells.grad, cells.volumetric, cells.normal, len(axes) - 1
    d = grad.shape[2]
    for n in range(len(points)):
        p = points[n]
        shear, e = factor[p] * cells.mu[p], axes[min(p, last)]
        for k in range(axes.shape[1]):
            cosine = 0.0
            for i in range(d):
                cosine += factor[p] * normal[p, i] * e[k, i]
            for a in range(grad.shape[1]):
                along_x, along_e = 0.0, 0.0
                for i in range(d):
                    along_x += grad[p, a, i] * normal[p, i]
                    along_e += grad[p, a, i] * e[k, i]
                for i in range(d):
                    out[p, a, k, i] = cosine * volumetric[p, a, i] + shear * (
                        along_x * e[k, i] + along_e * normal[p, i]
                    )


@njit_inner
def tractions(u, source, wanted, out):
    """Boundary traction t = sigma(u) n_X (np, d) [stress] of linear elasticity, sigma = (P . u) I + 2 mu eps.

    Parameters
    ----------
    u : ndarray (n, d)
    source : pcontact.contact.points.SourcePoints
    wanted : ndarray (np,) of bool
        The others get zero.
    out : ndarray (np, d)
    """
    facet, cells, grad, normal = source.facet, source.cells, source.grad, source.normal
    d = u.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        for i in range(d):
            out[p, i] = 0.0
        if not wanted[p]:
            continue
        bulk = 0.0
        for a in range(grad.shape[1]):
            node, along, across = cells[f, a], 0.0, 0.0
            for i in range(d):
                bulk += source.volumetric[p, a, i] * u[node, i]
                along += grad[p, a, i] * normal[p, i]
                across += u[node, i] * normal[p, i]
            for i in range(d):
                out[p, i] += source.mu[f] * (along * u[node, i] + across * grad[p, a, i])
        for i in range(d):
            out[p, i] += bulk * normal[p, i]


class FacetPoints(NamedTuple):
    """Points of the source, and what takes values at the points of their parent cells to them.

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
def _add_tractions(stress, active, places, onto, out):
    """Add the tractions of stresses (n, m) of the points of the parent cells to ``out`` (np, d), see
    :func:`traction_rows`."""
    nq = places.matrix.shape[1]
    for n in range(len(places.points)):
        p = places.points[n]
        for q in range(nq):
            k = places.facet[n] * nq + q
            if active[k] == STILL:
                continue
            for i in range(out.shape[1]):
                value = 0.0
                for c in range(stress.shape[1]):
                    value += onto[n, i, c] * stress[k, c]
                out[p, i] += places.matrix[n, q] * value


@njit
def traction_rows(parents, moduli, places, onto, out):
    """Derivative of the traction C : eps n at points.

    Parameters
    ----------
    parents : pcontact.assembly.strains.CellPoints
        Of the nf parent cells, with nq points each.
    moduli : ndarray (k, m, m)
        C [stress], of all points of the cells (k = 1), or of each.
    places : FacetPoints
        The n points.
    onto : ndarray (n, d, m)
        From Mandel stresses to tractions.
    out : ndarray (n, nn, d, d)
        Overwritten [stress/length].
    """
    nq, nn, d, m = parents.grad.shape[1], parents.grad.shape[2], parents.grad.shape[3], moduli.shape[1]
    operator, pulled = np.zeros((m, nn, d)), np.zeros((nq, m, nn * d))
    flat, last = operator.reshape(m, nn * d), -1
    out[:] = 0.0
    for n in range(len(out)):
        f = places.facet[n]
        if f != last:
            last = f
            for q in range(nq):
                fill_operator(parents, f, q, operator)
                pull(moduli[f * nq + q if len(moduli) > 1 else 0], flat, 1.0, pulled[q])
        for q in range(nq):
            for k in range(m):
                for i in range(d):
                    factor = places.matrix[n, q] * onto[n, i, k]
                    if factor != 0.0:
                        for a in range(nn):
                            for j in range(d):
                                out[n, a, i, j] += factor * pulled[q, k, a * d + j]


@njit
def _add_rows(at, rows, values, cells, facet, out):
    """Add the rows of the points times nodal values (n, d) to tractions (np, d)."""
    d = values.shape[1]
    for p in range(len(at)):
        if at[p] < 0:
            continue
        for a in range(cells.shape[1]):
            node = cells[facet[p], a]
            for i in range(d):
                for j in range(d):
                    out[p, i] += rows[at[p], a, i, j] * values[node, j]


@njit
def _add_rows_adjoint(at, rows, weights, cells, facet, out):
    """Add the rows of the points times vectors (np, d) to nodal forces (n, d)."""
    d = weights.shape[1]
    for p in range(len(at)):
        if at[p] < 0:
            continue
        for a in range(cells.shape[1]):
            node = cells[facet[p], a]
            for j in range(d):
                for i in range(d):
                    out[node, j] += weights[p, i] * rows[at[p], a, i, j]


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


def _speaking(source, which):
    """Points (n,) of facets of a source; facets without a shear modulus take part without their traction."""
    return np.flatnonzero((source.facet >= which.start) & (source.facet < which.stop) & (source.mu > 0.0)[source.facet])


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
    points, nodes = _speaking(source, which), reference_nodes(cell, degree)
    xi = source.shape[points, : len(nodes)] @ nodes
    return FacetPoints(points, source.facet[points] - which.start, extrapolation(cell, degree, rule, xi))


class _LinearRows:
    """Derivative of the traction of C_dev at the points of a source.

    Attributes
    ----------
    at : ndarray (np,)
        Row of each point in ``rows``, -1 where the parent cell is isotropic.
    rows : ndarray (n, nn, d, d)
        [stress/length]
    """

    def __init__(self, space, bulk, source, name):
        self.at, found, count = np.full(len(source.facet), -1, dtype=np.int64), [], 0
        ring = hoop_operator(source.shape, source.x[:, 0]) if source.axisymmetric else None
        for facets, which in space.mesh.facets_of(name):
            law, some = bulk.orthotropic.get(space.mesh.blocks[facets.block].body), _speaking(source, which)
            if law is None or not len(some):
                continue
            # each point is a cell of its own
            alone = FacetPoints(some, np.arange(len(some)), np.ones((len(some), 1)))
            around = None if ring is None else ring[some][:, None]
            points = cell_points(np.zeros((0, 0), dtype=np.int64), source.grad[some][:, None], around)
            rows = np.empty((len(some), *source.grad.shape[1:], source.grad.shape[2]))
            traction_rows(points, law.deviation(source.x[some]), alone, traction_matrix(source.normal[some]), rows)
            self.at[some] = np.arange(count, count + len(some))
            count += len(some)
            found.append(rows)
        shape = (*source.grad.shape[1:], source.grad.shape[2])
        self.rows = np.concatenate([np.zeros((0, *shape)), *found])


@dataclass
class _Part:
    """Facets of the source with points whose parent cells belong to one block with internal variables.

    ``rows`` are the parent cells in the block; ``grad`` and ``ring`` those of
    :class:`pcontact.assembly.strains.CellPoints`; ``onto`` (n, d, m) takes stresses to the tractions at the places.
    """

    state: PointStates
    rows: np.ndarray
    facets: np.ndarray
    grad: np.ndarray
    ring: np.ndarray
    places: FacetPoints
    onto: np.ndarray

    def parents(self, cells):
        """Points of the parent cells, by the nodes (nf, nn) of the parent cells of all facets of the source."""
        return CellPoints(np.ascontiguousarray(cells[self.facets, : self.grad.shape[2]]), self.grad, self.ring)


class _Excess:
    """Excess traction at the points of a source.

    Attributes
    ----------
    parts : list of _Part
        By block of parent cells on this rank with internal variables.
    """

    def __init__(self, space, bulk, source, name):
        self._source, self._bulk, self.parts = source, bulk, []
        for facets, which in space.mesh.facets_of(name):
            if facets.block not in bulk.states:
                continue
            used, on = np.unique(source.facet[_speaking(source, which)], return_inverse=True)
            rows = np.ascontiguousarray(facets.cells[used - which.start])
            grad, ring, rule = some_cells(space, facets.block, rows)
            places = facet_points(source, which, space.mesh.blocks[facets.block].cell, space.degree, rule)
            points = cell_points(rows, grad, ring)
            self.parts.append(_Part(bulk.states[facets.block], rows, used, grad, points.ring, places._replace(facet=on),
                                    traction_matrix(source.normal[places.points])))  # fmt: skip

    def _moved(self, part, values, cells):
        """Displacements (n, d) of which the parent cells of a part have the strain."""
        origin = self._bulk.origins.get(part.state.number)
        if origin is None:
            return values
        width, values = part.grad.shape[2], values.copy()
        nodes, local = cells[part.facets, :width], self._source.cells[part.facets, :width]
        start = values[nodes]
        values[nodes] = start - origin[local]
        return values

    def _response(self, part, values, cells, tangent=False):
        return part.state.stress(part.rows, part.parents(cells), self._moved(part, values, cells), tangent)

    def add(self, values, cells, out):
        """Add the excess to tractions (np, d) [stress].

        Parameters
        ----------
        values : ndarray (n, d)
            Displacements.
        cells : ndarray (nf, nn)
            Nodes of the parent cells of all facets of the source, numbers into ``values``.
        out : ndarray (np, d)
        """
        for part in self.parts:
            found = self._response(part, values, cells)
            _add_tractions(found.excess, found.active, part.places, part.onto, out)

    def rows(self, values, cells):
        """Derivatives of the excess traction with respect to the parent cell's displacements.

        Returns
        -------
        at : ndarray (np,)
            Row of each point in ``rows``; -1 where the cell does not flow.
        rows : ndarray (n, nn, d, d)
            d t_i / d u_aj [stress/length].
        """
        source, found, count = self._source, [], 0
        at, shape = np.full(len(source.facet), -1, dtype=np.int64), (source.shape.shape[1], *[source.x.shape[1]] * 2)
        for part in self.parts:
            response, places = self._response(part, values, cells, True), part.places
            flows = (response.active.reshape(part.grad.shape[:2]) == FLOWS).any(axis=1)
            response.tangent[response.active != FLOWS] = 0.0
            some = np.flatnonzero(flows[places.facet])
            rows = np.zeros((len(some), *shape))
            width = part.grad.shape[2]
            own = np.empty((len(some), width, *shape[1:]))
            some_places = FacetPoints(places.points[some], places.facet[some], places.matrix[some])
            traction_rows(part.parents(cells), response.tangent, some_places, part.onto[some], own)
            rows[:, :width] = own
            at[some_places.points] = np.arange(count, count + len(some))
            count += len(some)
            found.append(rows)
        return at, np.concatenate([np.zeros((0, *shape)), *found])

    def add_curvature(self, values, cells, weights, blocks):
        """Add the derivative of the rows, tested with vectors (np, d), to blocks (BlockRows).

        Returns
        -------
        int
            Entries that have no place in the pattern.
        """
        missing = 0
        for part in self.parts:
            places, (nf, nq) = part.places, part.grad.shape[:2]
            # Mandel stresses, by whose work the vectors test the traction
            work = np.matmul(weights[places.points][:, None], part.onto)[:, 0]
            tested = np.zeros((nf, nq, work.shape[1]))
            np.add.at(tested, places.facet, places.matrix[:, :, None] * work[:, None])
            parents = part.parents(cells)
            moduli, active = part.state.curvature(
                part.rows, parents, self._moved(part, values, cells), tested.reshape(nf * nq, tested.shape[2])
            )
            missing += add_stiffness(parents, np.ones((nf, nq)), moduli, active, blocks)[1]
        return missing


class LocalCells(NamedTuple):
    """The points of a source, whose ``cells`` (nf, nn) are local nodes: in the place of a pairing."""

    source: SourcePoints | None
    cells: np.ndarray


class _Begun:
    """Minus the linear traction at the displacement from which blocks that have begun count their strain."""

    def __init__(self, space, bulk, source, name):
        self._bulk, self._of, self._values = bulk, None, None
        # block of each facet, -1 of those that are there from the beginning
        self._block = np.full(len(source.cells), -1, dtype=np.int64)
        for facets, which in space.mesh.facets_of(name):
            if facets.block in bulk.added:
                self._block[which] = facets.block
        self.parts = np.flatnonzero(self._block >= 0)

    def tractions(self, traction):
        """Tractions (np, d) at the points of the source of a :class:`Traction` [stress]."""
        if self._of is not self._bulk.origins or self._values is None:
            self._of, self._values = self._bulk.origins, self._evaluated(traction)
        return self._values

    def _evaluated(self, traction):
        source = traction.source
        result, at = np.zeros_like(source.x), self._block[source.facet]
        local = LocalCells(source.numbered(source.cells), source.cells)
        for number, origin in self._bulk.origins.items():
            wanted = at == number
            if wanted.any():
                result[wanted] -= traction.linear(origin, local, wanted)[wanted]
        return result


class Traction:
    """Traction of a source; that of isotropic elasticity alone where nothing else is said, and zero where the operators
    of the source have width 0.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface

    Attributes
    ----------
    consistent : bool
        Whether the adjoint operator has the derivative of the excess, too; it jumps where cells yield.
    weighted : pcontact.contact.traction.small.Weighted or None
        Of both sides, where it is theirs.
    """

    consistent = False
    weighted = None
    _linear = _excess = None
    _constant = ()

    def __init__(self, source):
        self.source = source

    def of_materials(self, space, bulk, name, theta, consistent=False):
        """This traction, with what the materials of the cells add to it. *Collective.*

        Parameters
        ----------
        space : pcontact.space.space.Space
        bulk : pcontact.assembly.solid.Bulk
            Has the materials, the committed internal variables, and the displacement from which strain is counted.
        name : str
            Facet group of the source.
        theta : float
            Of the adjoint term.
        consistent : bool
            Whether its operator has the excess, too.
        """
        def some(part):
            return part if space.comm.allreduce(len(part), op=MPI.SUM) else None

        self.with_linear(space, bulk, name)
        if bulk.yields:
            own = _Excess(space, bulk, self.source, name)
            self._excess = own if some(own.parts) is not None else None
        begun = _Begun(space, bulk, self.source, name) if bulk.added else None
        constant = [None if bulk.heat is None else bulk.heat.trace(self.source, name),
                    begun if begun is not None and some(begun.parts) is not None else None]  # fmt: skip
        self._constant = [part for part in constant if part is not None]
        self.consistent = self._excess is not None and theta != 0.0 and consistent
        return self

    def with_linear(self, space, bulk, name):
        """This traction, with that of C_dev."""
        own = _LinearRows(space, bulk, self.source, name) if bulk.orthotropic else None
        self._linear = own if own is not None and len(own.rows) else None
        return self

    @property
    def symmetric(self):
        """Return whether the derivative of the traction is its adjoint operator."""
        return self._excess is None

    @property
    def nodes(self):
        """Nodes (n,), global numbers, whose displacement this rank needs besides those of its points."""
        return np.zeros(0, dtype=np.int64)

    def weigh(self, found, nodal, m):
        """Partners on the nodes that have a part in a traction in m directions, found at displacements (n_local, d);
        `weighted` is of them from here on. *Collective.*"""
        return found

    @property
    def is_linear(self):
        """Return whether the traction is that of :meth:`rows`, and nothing besides."""
        return self._excess is None and not self._constant

    def rows(self, axes, normal, last):
        """Derivative (np, nr, m, d) of the linear traction in m directions [stress/length], and how many nodes of each
        point have a part in it (np,), see :class:`pcontact.contact.points.TractionOperator`.

        Parameters
        ----------
        axes : ndarray (1 or np, m, d)
        normal : ndarray (np, d)
            Contact normals.
        last : pcontact.contact.pair.Pairing or None
            Of the last search, whose rows are overwritten: most normals are as they were, of obstacles and without
            partner.
        """
        (n, nn, d), m = self.source.grad.shape, axes.shape[1]
        if last is None:
            rows, some = np.empty((n, nn, m, d)), np.arange(n)
        else:
            rows, some = last.operator.rows, np.flatnonzero((normal != last.normal).any(axis=1) & (len(axes) > 1))
        self.derivative(some, axes, np.ones(n), rows)
        return rows, np.full(n, self.source.shape.shape[1])

    def derivative(self, points, axes, factor, out):
        """Derivative of the components of the linear traction along directions, see :func:`fill_rows`."""
        source = self.source
        cells = FacetCells(source.grad, source.volumetric, source.mu[source.facet], source.normal)
        fill_rows(points, cells, axes, factor, out)
        if self._linear is not None:
            some = points[self._linear.at[points] >= 0]
            rows = factor[some, None, None, None] * self._linear.rows[self._linear.at[some]]
            out[some, : rows.shape[1]] += np.matmul((axes[some] if len(axes) > 1 else axes)[:, None], rows)

    def elastic(self, values, p, wanted):
        """The isotropic part of the traction (np, d) at values (n, d), of the points that are wanted (np,)."""
        out = np.empty_like(self.source.x)
        tractions(values, p.source, wanted, out)
        return out

    def linear(self, values, p, wanted):
        """Part of the traction that is linear in the displacement, (np, d) at values (n, d); of points not wanted
        something else."""
        out = self.elastic(values, p, wanted)
        if self._linear is not None:
            _add_rows(self._linear.at, self._linear.rows, values, p.cells, self.source.facet, out)
        return out

    def add_excess(self, values, p, traction):
        """Add what is not linear in the displacement to tractions (np, d)."""
        if self._excess is not None:
            self._excess.add(values, p.cells, traction)
        for part in self._constant:
            traction += part.tractions(self)

    def add_normal_excess(self, values, p, traction):
        """The same along the contact normals (np,)."""
        if self.is_linear:
            return
        own = np.zeros_like(self.source.x)
        self.add_excess(values, p, own)
        traction += np.einsum("pd,pd->p", own, p.normal)

    def excess(self, values, p):
        """Derivative of what is not linear, a :class:`pcontact.contact.points.Excess`."""
        if self._excess is None:
            return no_excess(self.source.shape.shape[1], self.source.x.shape[1])
        at, rows = self._excess.rows(values, p.cells)
        return Excess(at, rows, 0 if self.consistent else len(rows))

    def beyond(self, values, p):
        """Derivatives of the traction beyond that of isotropic elasticity, all that has rows at points."""
        return [self.excess(values, p), *([] if self._linear is None else [self._linear])]

    def add_adjoint(self, values, p, weights, out):
        """Add the excess of a consistent adjoint operator, tested with vectors (np, d), to nodal forces (n, d)."""
        at, rows = self._excess.rows(values, p.cells)
        _add_rows_adjoint(at, rows, weights, p.cells, self.source.facet, out)

    def add_curvature(self, values, p, weights, blocks):
        """Add the derivative of :meth:`add_adjoint` at constant weights; returns how many entries had no place."""
        return self._excess.add_curvature(values, p.cells, weights, blocks)


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
        At the partners on this rank, of the last search; where it is linear, nothing asks for it again.
    """

    def __init__(self, space, bulk, contact, source):
        self._space, self._bulk, self._name, self.sticks = space, bulk, contact.target, sticks_by_shear(contact)
        # halves of unbiased contact have half the areas of their points
        self._half = WEIGHT if is_unbiased(contact) else 1.0
        # gap up to which partners have a part in the traction [facet sizes]
        self._reach = np.inf if contact.tied else NEAR
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
        if self.is_linear:
            return np.zeros(0, np.int64)
        return self._space.nodes[self._side.cells[np.unique(self.traction.source.facet)]].ravel()

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
        if self.is_linear:
            traction = Traction(at).with_linear(self._space, self._bulk, self._name)
        else:
            self._first, self.traction = order, Traction(at).of_materials(self._space, self._bulk, self._name, 0.0)
            traction = self.traction
        out = np.empty((*slope.shape[:2], m, d))
        traction.derivative(np.arange(n), np.eye(d)[None] if m == d else contact[:, None], np.ones(n), out)
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
        order = np.tile(np.arange(shape.shape[1]), (n, 1))
        for facets, which in space.mesh.facets_of(self._name):
            c = np.flatnonzero((rows >= which.start) & (rows < which.stop))
            on, local = facet_nodes(facets.cell, space.degree), facets.local[rows[c] - which.start]
            x[c], normal[c], v, g, strain = self._places(facets, rows[c], which.start, xi[c])
            nn = v.shape[1]
            shape[c, :nn], slope[c, :nn], grad[c, :nn] = v, g, strain
            own = np.array([[*nodes, *np.setdiff1d(np.arange(nn), nodes)] for nodes in on])
            order[c, :nn] = own[local]
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
        answers, self._asked.rows = self._answer(self._asked.rows, nodal, m), None
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
        self._nodes = [(which, space.facet_nodes(facets)) for facets, which in space.mesh.facets_of(name)]

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

    It is, unless the contact says otherwise. The second derivative of the stress, which the consistent adjoint of
    cells with small strain that yield has, is that of the source alone.
    """
    if contact.target is None or contact.traction == "source":
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
