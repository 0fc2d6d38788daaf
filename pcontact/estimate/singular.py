"""Vertices around which the displacement may go like r^a: problems on the cells around them, beside those of cells.

In the space of `pcontact.estimate.toward`, V, which is zero outside of the cells around a vertex, find e with

    int sigma(e) : eps(v) = int f . v - sigma(u_h) : eps(v) + int_boundary g . v   for all v of V

As V consists of displacements that the bodies can have, the energy of e is at most that of the error in these cells
that vanishes around them: it takes the place of what the local problems of these cells say where it is more, and cells
get their own parts of it. Patches that have no cell in common have errors at right angles to each other, so of those
that have, the ones that bring most are taken.

Where contact presses, or holds, V has functions that are zero there: displacements that contact admits.
"""

from functools import cache, partial
from typing import NamedTuple

import numpy as np

from pcontact.element.geometry import facet_geometry
from pcontact.element.reference import CELLS, facet_nodes, facet_points, shape
from pcontact.estimate.facets import facet_rule
from pcontact.estimate.interiors import Tables, Volume
from pcontact.estimate.local import stiffnesses
from pcontact.estimate.points import NEUMANN
from pcontact.estimate.stress import BlockStress, turned
from pcontact.estimate.toward import NUMBER, held, inside, n_halves, patches, rule, side_rule, sides
from pcontact.runtime.petsc import MPI

# [-] Part of the squared estimate that cells around a vertex must have. From: chosen; with less all such vertices of a
# mesh together change the estimate little, and there are at most 150.
SHARE = 0.02


class Around(NamedTuple):
    """Cells around vertices: one row for each vertex of a cell that is looked at, two if it is a quadrilateral.

    Attributes
    ----------
    vertex : ndarray (n,) of int
        Global number of the node.
    ends : ndarray (n, 2) of int
        Those of the next two vertices of the triangle that the row stands for.
    cell : ndarray (n,) of int
        Global number of the cell.
    square : ndarray (n,)
        What its local problem says [energy].
    stiffness : ndarray (n, m, m)
        Of its m test functions and directions.
    bound : ndarray (n, m, m)
        What springs add.
    loads : ndarray (n, m)
        Residual, tested [force].
    held : ndarray (n, m) of bool
    """

    vertex: np.ndarray
    ends: np.ndarray
    cell: np.ndarray
    square: np.ndarray
    stiffness: np.ndarray
    bound: np.ndarray
    loads: np.ndarray
    held: np.ndarray


class SingularPoints:
    """Vertices on the boundary of bodies in the plane, and where bodies share nodes; not of bodies that may yield.

    Parameters
    ----------
    space : pcontact.space.space.Space
    pairs : pcontact.estimate.facets.FacetPairs
    yielding : set of int
        Blocks of bodies that may yield.
    """

    def __init__(self, space, pairs, yielding):
        self._space, self._pairs, self._yielding, self._flags = space, pairs, yielding, None

    def improve(self, squares, around):
        """Let cells around vertices have what patches say. *Collective.*

        Parameters
        ----------
        squares : list of ndarray (nc,)
            Squared estimates of the cells of each block [energy]; changed.
        around : callable
            ``around(number, rows, corners, half)`` gives stiffness, bound, loads and held of :class:`Around` for cells
            of a block, each around one of its corners; half: see `pcontact.estimate.toward.n_halves`.
        """
        if self._space.dim != 2:
            return
        chosen, rows, own = self._chosen(squares), [], []
        for number in range(len(squares)):
            kind = self._space.mesh.blocks[number].cell
            cells, corners = np.nonzero(chosen[self._space.cells[number][:, : CELLS[kind].n_vertices]])
            for half in range(n_halves(kind) if len(cells) else 0):
                rows += [(number, cell) for cell in cells]
                # what a cell has counts once
                has = squares[number][cells] * (half == 0)
                own.append(self._around(number, cells, corners, half, has, around))
        table, first = self._gathered(own)
        best = [(*rows[row - first], square) for row, square in _best(table) if first <= row < first + len(rows)]
        for number, cell, _ in best:
            squares[number][cell] = 0.0
        for number, cell, square in best:
            squares[number][cell] += square

    def _chosen(self, squares):
        """Flags (n_local,) of the vertices that are looked at. *Collective.*"""
        space = self._space
        if self._flags is None:
            self._flags = self._candidates()
        sums = np.zeros((space.n_local, space.dim))
        for block, cells, own in zip(space.mesh.blocks, space.cells, squares, strict=True):
            for corner in cells[:, : CELLS[block.cell].n_vertices].T:
                sums[:, 0] += np.bincount(corner, own, space.n_local)
        around = space.together(sums)[:, 0]
        total = space.comm.allreduce(float(sum(own.sum() for own in squares)), op=MPI.SUM)
        return self._flags & (around > SHARE * total) if total > 0.0 else np.zeros(space.n_local, dtype=bool)

    def _candidates(self):
        """Flags (n_local,) of the vertices that may be. *Collective.*"""
        space, blocks = self._space, self._space.mesh.blocks
        edge, other = np.zeros(space.n_local, dtype=bool), np.zeros(space.n_local, dtype=bool)
        bodies = np.zeros((space.n_local, 2))
        for number, (block, cells) in enumerate(zip(blocks, space.cells, strict=True)):
            first, last = self._pairs.first[number : number + 2]
            outer = ~self._pairs.inner[first:last].reshape(-1, len(CELLS[block.cell].facets))
            edge[cells[:, facet_nodes(block.cell, 1)][outer]] = True
            if number in self._yielding:
                other[cells] = True
            vertices = cells[:, : CELLS[block.cell].n_vertices]
            np.add.at(bodies, vertices.ravel(), [1.0, block.body])
        # where all cells are of one body, its number times that of the cells is the sum
        count, sums = space.together(bodies).T
        mine = np.zeros((space.n_local, 2))
        for block, cells in zip(blocks, space.cells, strict=True):
            vertices = cells[:, : CELLS[block.cell].n_vertices]
            mine[vertices, 0] = np.abs(sums[vertices] - block.body * count[vertices]) > 0.5
        return (space.flag(edge) | (space.together(mine)[:, 0] > 0.5)) & ~space.flag(other)

    def _around(self, number, rows, corners, half, squares, around):
        """Rows of the table."""
        nodes = turned(self._space.nodes[self._space.cells[number][rows]], corners)
        return Around(nodes[:, 0].copy(), nodes[:, 1 + half : 3 + half].copy(),
                      self._space.mesh.blocks[number].ids[rows], squares,
                      *around(number, rows, corners, half))  # fmt: skip

    def _gathered(self, own):
        """The table of all ranks, None where it is empty, and the first row of this one. *Collective.*"""
        comm = self._space.comm
        parts = comm.allgather([tuple(one) for one in own]) if comm.size > 1 else [own]
        first = sum(len(one[0]) for part in parts[: comm.rank] for one in part)
        parts = [one for part in parts for one in part]
        return (Around(*map(np.concatenate, zip(*parts, strict=True))) if parts else None), first


def _best(table):
    """Rows of a table and the squares that they get, of patches without a common cell."""
    if table is None:
        return []
    # the order of the ranks makes no difference
    order = np.lexsort([table.ends[:, 0], table.cell, table.vertex])
    table, energy = Around(*(part[order] for part in table)), np.zeros(len(order))
    first = np.append(np.flatnonzero(np.diff(table.vertex, prepend=-1)), len(order))
    patches(first, table.ends, table.stiffness, table.bound, table.loads, table.held, energy)
    gain, found, taken = np.add.reduceat(energy - table.square, first[:-1]), [], set()
    for vertex in np.argsort(-gain, kind="stable"):
        rows = range(first[vertex], first[vertex + 1])
        cells = set(table.cell[rows.start : rows.stop].tolist())
        if gain[vertex] > 0.0 and not cells & taken:
            taken |= cells
            found += [(order[row], energy[row]) for row in rows]
    return found


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
        """Parts that do not depend on the displacement: stiffness, what springs add, and a
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
