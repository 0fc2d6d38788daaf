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
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import some_cells
from pcontact.assembly.solid import PointStates
from pcontact.assembly.strains import CellPoints, add_stiffness, cell_points, fill_operator, pull
from pcontact.contact.points import Excess, SourcePoints, no_excess
from pcontact.element.dilatation import hoop_operator
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.material.elastic import FLOWS, STILL
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.jit import njit, njit_inner
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


def _blocks(space, source, name):
    """Facets of a group by block of their cells, and which facets of its source they are."""
    first = 0
    for facets in space.mesh.facet_groups.get(name, []):
        yield facets, slice(first, first + len(facets.cells))
        first += len(facets.cells)


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
        for facets, which in _blocks(space, source, name):
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
        for facets, which in _blocks(space, source, name):
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
        for facets, which in _blocks(space, source, name):
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
    weighted : pcontact.contact.traction.target.Weighted or None
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
