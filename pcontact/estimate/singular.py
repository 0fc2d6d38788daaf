"""Vertices around which the displacement may go like r^a: problems on the cells around them, beside those of cells.

In the space of `pcontact.estimate.toward`, V, which is zero outside of the cells around a vertex, find e with

    int sigma(e) : eps(v) = int f . v - sigma(u_h) : eps(v) + int_boundary g . v   for all v of V

As V consists of displacements that the bodies can have, the energy of e is at most that of the error in these cells
that vanishes around them: it takes the place of what the local problems of these cells say where it is more, and cells
get their own parts of it. Patches that have no cell in common have errors at right angles to each other, so of those
that have, the ones that bring most are taken.

Where contact presses, or holds, V has functions that are zero there: displacements that contact admits.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, facet_nodes
from pcontact.estimate.stress import turned
from pcontact.estimate.toward import n_halves, patches
from pcontact.runtime.petsc import MPI

# [-] Part of the squared estimate that cells around a vertex must have. From: chosen; with less all such vertices of a
# mesh together change the estimate little, and there are at most 150.
SHARE = 0.02
# [-] Of the squared estimate, that a patch must bring. From: rounding.
LEAST = 1e-6


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
        if gain[vertex] > LEAST * table.square.sum() and not cells & taken:
            taken |= cells
            found += [(order[row], energy[row]) for row in rows]
    return found
