"""What the problems around vertices are made of, see `pcontact.estimate.singular`."""

from functools import cache, partial

import numpy as np

from pcontact.element.geometry import facet_geometry
from pcontact.element.reference import facet_points
from pcontact.element.shape import shape
from pcontact.estimate.facets import facet_rule
from pcontact.estimate.interiors import Tables, Volume
from pcontact.estimate.local import stiffnesses
from pcontact.estimate.points import NEUMANN
from pcontact.estimate.stress import BlockStress, turned
from pcontact.estimate.toward import NUMBER, held, inside, rule, side_rule, sides


class AroundVertices:
    """Cells around their corners.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    pairs : pcontact.estimate.facets.FacetPairs
    springs : pcontact.estimate.springs.Springs
    held : pcontact.estimate.interiors.Held
    interiors : pcontact.estimate.interiors.Interiors
    kinds : list of ndarray (nc, nf, 2) of int
        See :class:`pcontact.estimate.residuals.FacetResiduals`.
    kept : pcontact.space.space.Kept
    """

    def __init__(self, problem, pairs, springs, held, interiors, kinds, kept):
        self._space, self._bulk, self._pairs, self._springs = problem.space, problem.bulk, pairs, springs
        self._held, self._interiors, self._kinds, self._kept = held, interiors, kinds, kept

    def __call__(self, known, time, loads, number, rows, corners, half):
        """Stiffness, what springs add, residuals and what is held of the functions around corners of some cells, see
        :class:`pcontact.estimate.singular.Around`.

        Parameters
        ----------
        known : pcontact.estimate.estimator.Tested
        time : float
        loads : list
        number : int
            Block.
        rows, corners : ndarray (n,) of int
            Cells, and which corner of each.
        half : int
            Which of their triangles there, see `pcontact.estimate.toward.n_halves`.
        """
        block = self._space.mesh.blocks[number]
        degree, size = self._space.degree_of(block), NUMBER * self._space.dim
        tables = Tables.of(block.cell, degree, rule(block.cell, half), inside(block.cell, half))
        # load step after load step it is mostly the same vertices
        key = "around", number, half, rows.tobytes(), corners.tobytes()
        found = self._kept(key, partial(self._made, number, rows, corners, half, tables))
        (stiffness, bound), volume = found[:2], Volume(*found[2:])
        stress = BlockStress(self._space, self._bulk, number, rows, known.nodal, corners=corners)
        tested = self._interiors.residual(number, rows, volume, tables, stress, time, loads)
        self._add_sides(known, number, rows, corners, half, tested)
        # displacements that contact admits
        pressed = (self._kinds[number][rows, :, 0] != NEUMANN) & known.pressed[number][rows, None]
        fixed, every = self._held.of_facets(number, rows) | pressed[:, :, None], np.arange(len(rows))
        on_sides = np.zeros((len(rows), 2, self._space.dim), dtype=bool)
        vertex = self._held.nodes[self._space.cells[number][rows, corners]]
        for side, facet in sides(block.cell, half):
            facets = (corners + facet) % fixed.shape[1]
            on_sides[:, side] = fixed[every, facets]
            vertex |= pressed[every, facets][:, None]
        return stiffness, bound, tested.reshape(len(rows), size), held(vertex, on_sides).reshape(len(rows), size)

    def _made(self, number, rows, corners, half, tables):
        """What does not depend on the displacement: stiffness, what springs add, and a
        :class:`pcontact.estimate.interiors.Volume`."""
        volume = self._interiors.volume(number, rows, tables, corners)
        size = NUMBER * self._space.dim
        stiffness = np.empty((len(rows), size, size))
        stiffnesses(*self._interiors.local(self._space.mesh.blocks[number], volume), stiffness)
        bound = self._springs.around(number, rows, corners, half, (tables.tests, volume.jxw))
        return stiffness, bound, *volume

    def _add_sides(self, known, number, rows, corners, half, tested):
        """Add what acts on outer facets beside contact, tested with the functions around corners: with a rule of their
        own, as g is large where the residual is small."""
        space, block = self._space, self._space.mesh.blocks[number]
        table, geometry_degree = space.mesh.geometry_nodes(block)
        degree, (first, last) = space.degree_of(block), self._pairs.first[number : number + 2]
        inner, (touched, rest) = self._pairs.inner[first:last].reshape(len(block.nodes), -1), known.outer[number]
        for side, facet in sides(block.cell, half):
            xi, weights, tests = side_rule(side)
            outer = np.flatnonzero(~inner[rows, (corners + facet) % inner.shape[1]])
            cells, corner = rows[outer], corners[outer]
            x, local = space.mesh.points[turned(table[cells], corner)], np.full(len(cells), facet)
            at = facet_geometry(block.cell, x, local, geometry_degree, degree, xi, weights)
            at_xi = facet_points(block.cell, xi)[facet]
            radius = at.points[:, :, 0] if space.axisymmetric else None
            stress = BlockStress(space, self._bulk, number, cells, known.nodal, corners=corner)
            sigma, _ = stress(at.gradients, shape(block.cell, degree, at_xi), radius, at_xi)
            force = np.matmul(sigma, at.normals[:, :, :, None])[:, :, :, 0]
            # g - t is known at the points of the facets' own rule
            force += _through(block.cell, space.degree, side) @ rest[
                np.searchsorted(touched, cells), (corner + facet) % inner.shape[1]]  # fmt: skip
            force *= (at.jxw * space.circumference(at.points))[:, :, None]
            tested[outer] += np.matmul(tests.T, force)


@cache
def _through(cell, degree, side):
    """Values (n, k) at the n points of the rule of a side of the polynomials that are 1 at one of the k points of the
    rule of a cell's facets, 0 at the rest."""
    points, others = facet_rule(cell, degree)[0], side_rule(side)[0]
    count = len(points)
    return np.vander(others[:, 0], count) @ np.linalg.inv(np.vander(points[:, 0], count))
