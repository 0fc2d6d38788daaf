"""The interiors of cells: their geometry at the points of local problems, and what they add to residuals.

Supports hold components of the displacements that the estimate tests with, see :class:`Held`.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from pcontact.element.dilatation import components, factors, hoop_operator, linear
from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_nodes, shape, shape_gradient
from pcontact.estimate.loads import force_density
from pcontact.estimate.local import LocalFunctions, Moduli
from pcontact.estimate.points import add_work, bubbles, supports
from pcontact.estimate.stress import own_nodes
from pcontact.space.constraints import RigidGroup


class Held:
    """Components that supports hold.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    pairs : pcontact.estimate.facets.FacetPairs

    Attributes
    ----------
    nodes : ndarray (n_local, d) of bool
        Of nodes.
    """

    def __init__(self, problem, pairs):
        self._space, self._pairs = problem.space, pairs
        # what moves as a rigid body is as much held as what is prescribed
        self.nodes = problem.conditions.supports.fixed.copy()
        for group in problem.conditions.groups:
            if isinstance(group, RigidGroup):
                self.nodes[group.nodes] = True

    def of_tests(self, number, rows):
        """Components (n, nb, d) of the test functions of some cells of a block."""
        block = self._space.mesh.blocks[number]
        on = supports(block.cell, self._space.degree_of(block))
        return np.einsum("bf,cfi->cbi", on.astype(float), self.of_facets(number, rows).astype(float)) > 0.5

    def of_facets(self, number, rows):
        """Components (n, nf, d) of the displacement of the facets of some cells of a block."""
        space, block = self._space, self._space.mesh.blocks[number]
        held, degree = self.nodes[own_nodes(space, number)[rows]], space.degree_of(block)
        first, last = self._pairs.first[number : number + 2]
        outer = ~self._pairs.inner[first:last].reshape(len(block.nodes), -1)[rows]
        facets = held[:, facet_nodes(block.cell, degree)].all(axis=2)
        return facets & (outer[:, :, None] | held.all(axis=1)[:, None, :])


# numbers per cell and quadrature point in one chunk
CHUNK = 2**21


class Volume(NamedTuple):
    """Some cells of a block at the points of the local problems.

    Attributes
    ----------
    grad, test : ndarray (n, nq, nn, d)
        Gradients of the shape functions and of the tests [1/length].
    jxw : ndarray (n, nq)
        Weights, with axial symmetry times 2 pi r.
    ring : ndarray (n, nq, nb)
        Tests over r with axial symmetry [1/length], else empty.
    radius : ndarray (n, nq) or None
    places : ndarray (n, nq, d)
        The points [length].
    fixed : ndarray (n, nb, d)
        Components of tests that supports hold.
    """

    grad: np.ndarray
    test: np.ndarray
    jxw: np.ndarray
    ring: np.ndarray
    radius: np.ndarray | None
    places: np.ndarray
    fixed: np.ndarray


class Tables(NamedTuple):
    """Tables that all cells of a kind share at the points of their local problems.

    Attributes
    ----------
    xi : ndarray (nq, d)
        The points in the reference cell.
    weights : ndarray (nq,)
    values : ndarray (nq, nn)
        Shape functions.
    slopes : ndarray (nq, nn, d)
        Their reference gradients.
    tests : ndarray (nq, nb)
    test_slopes : ndarray (nq, nb, d)
    """

    xi: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    tests: np.ndarray
    test_slopes: np.ndarray

    @classmethod
    def of(cls, cell, degree, rule, tests):
        """Those of a cell, a degree of the displacement, a rule (points and weights), tests and their gradients."""
        xi, weights = rule
        slopes = np.ascontiguousarray(shape_gradient(cell, degree, xi))
        return cls(xi, weights, shape(cell, degree, xi), slopes, tests[0], np.ascontiguousarray(tests[1]))


def volume_rule(cell, geometry_degree, degree, axisymmetric):
    """Quadrature that integrates the energy of the test functions."""
    simplex = not CELLS[cell].is_tensor
    return quadrature(cell, 2 * degree + 2 * (geometry_degree - 1) * simplex + (2 - 2 * simplex) + 2 * axisymmetric)


def chunks(space, number, points):
    """Chunks of a block's cells that have so many numbers each."""
    n, size = len(space.mesh.blocks[number].nodes), max(CHUNK // points, 1)
    return [slice(first, min(first + size, n)) for first in range(0, n, size)]


class Interiors:
    """Interiors of the cells of one problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    springs : pcontact.estimate.springs.Springs
    held : pcontact.estimate.interiors.Held
    kept : pcontact.space.space.Kept
    """

    def __init__(self, problem, springs, held, kept):
        self._space, self._bulk, self._springs = problem.space, problem.bulk, springs
        self._held, self._kept = held, kept

    def tables(self, number):
        """The :class:`Tables` of a block's local problems."""
        space, block = self._space, self._space.mesh.blocks[number]
        degree, geometry_degree = space.degree_of(block), space.mesh.geometry_nodes(block)[1]
        rule = volume_rule(block.cell, geometry_degree, degree, space.axisymmetric)
        return Tables.of(block.cell, degree, rule, bubbles(block.cell, degree, rule[0]))

    def chunks(self, number, tables):
        """Chunks of a block's cells, and the :class:`Volume` of each."""
        for rows in chunks(self._space, number, tables.test_slopes.size + tables.slopes.size):
            yield rows, self._kept(("cells", number, rows.start), partial(self.volume, number, rows, tables))

    def volume(self, number, rows, tables):
        """A :class:`Volume` of some cells of a block, from :class:`Tables`."""
        space, block, xi = self._space, self._space.mesh.blocks[number], tables.xi
        table, geometry_degree = space.mesh.geometry_nodes(block)
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        x = np.ascontiguousarray(space.mesh.points[table[rows]])
        places, jxw, radius = shape(block.cell, geometry_degree, xi) @ x, np.empty((len(x), len(xi))), None
        grad = np.empty((len(x), *tables.slopes.shape))
        test = np.empty((len(x), *tables.test_slopes.shape))
        gradients(x, dgeo, tables.slopes, tables.weights, grad, jxw)
        gradients(x, dgeo, tables.test_slopes, tables.weights, test, jxw)
        ring = np.zeros((0, 0, 0))
        if space.axisymmetric:
            radius = np.ascontiguousarray(places[:, :, 0])
            jxw *= 2.0 * np.pi * radius
            ring = np.ascontiguousarray(hoop_operator(tables.tests, radius))
        return Volume(grad, test, jxw, ring, radius, places, self._held.of_tests(number, rows))

    def local(self, block, volume):
        """Test functions and moduli of the local problems of some cells of a block."""
        material, degree = self._bulk.materials[block.body], self._space.degree_of(block)
        (lam, mu), places = material.constants, volume.places
        rest = material.deviation(places.reshape(-1, places.shape[2]))
        averaged = self._space.averages(block)
        basis = np.zeros((0, 0, 0))
        if averaged:
            basis = components(volume.jxw, places if linear(block.cell, degree) else None)[0]
        functions = LocalFunctions(volume.test, volume.ring, volume.jxw, basis)
        return functions, Moduli(*factors(lam, mu, averaged, degree), mu, rest)

    def residual(self, number, rows, volume, tables, stress, time, loads):
        """Addend of the interiors of some cells of a block to their residuals (n, nb, d), with a
        :class:`pcontact.estimate.stress.BlockStress`."""
        sigma, around = stress(volume.grad, tables.values, volume.radius, tables.xi)
        result = np.zeros((len(sigma), *volume.test.shape[2:]))
        add_work(sigma, volume.test, volume.jxw, result)
        if around is not None:
            result[:, :, 0] -= np.einsum("cq,cq,cqb->cb", volume.jxw, around, volume.ring)
        force = self._body_force(number, rows, volume.places, time, loads, (tables.values, stress.u))
        if force is not None:
            result += np.einsum("cq,qb,cqd->cbd", volume.jxw, tables.tests, force)
        return result

    def _body_force(self, number, rows, points, time, loads, displacement):
        """Force density at points (n, nq, d) of some of a block's cells, None where there is none in the block, at a
        displacement: shape functions (nq, nn) and values at the nodes of the cells (n, nn, d)."""
        block = self._space.mesh.blocks[number]
        total = self._springs.force(number, rows, *displacement)
        for load in loads:
            groups = self._space.mesh.cell_groups.get(load.region, []) if not load.on_facets else []
            if number < len(groups) and len(groups[number]):
                chosen = np.zeros(len(block.nodes), dtype=bool)
                chosen[groups[number]] = True
                total, own = np.zeros(points.shape) if total is None else total, chosen[rows]
                total[own] += force_density(self._space, load, points[own], None, block.body, time)
        return total
