"""The local problems of triangles of degree 1, solved together.

The functions that triangles of degree 1 lack are those of their edges, of degree 2. In the local problems each cell has
its own; here both cells of an edge have one in common, and the displacement that is found is continuous. It is the
error of the displacement in these functions, all of them at once, and its work on the residual of a dual displacement
needs no traction between cells, as both sides' tractions cancel. A force or displacement has an error whose cells have
both signs: what local problems miss of each by some percent may be more than is left of their sum.

The stiffness of these functions alone has a condition number that does not depend on the size of the cells: conjugate
gradients take a few dozen iterations.
"""

from functools import partial

import numpy as np

from pcontact.estimate.bubbles import supports
from pcontact.runtime.petsc import MPI

# [-] Residual of the iteration over that of its start, and iterations at most. From: chosen; a laminate wound around
# wood on 562 to 31,598 unknowns takes 79 to 101 iterations to 1e-8. The iteration is the same on any ranks.
RTOL, MOST = 1e-4, 300


class Together:
    """Functions of the edges of triangles of degree 1, which both cells of an edge have in common.

    Parameters
    ----------
    space : pcontact.space.space.Space
    pairs : pcontact.estimate.facets.FacetPairs
    yields : bool
        Whether cells may yield.

    Attributes
    ----------
    holds : bool
        Whether all cells are such triangles, and do not yield.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, pairs, yields):
        self._space, self._pairs = space, pairs
        other = any(len(b.nodes) and (b.cell, space.degree_of(b)) != ("triangle", 1) for b in space.mesh.blocks)
        self.holds = not space.comm.allreduce(other, op=MPI.LOR) and space.dim == 2 and not yields

    def product(self, problems):
        """Work of the solution of one problem on the right-hand side of another. *Collective.*

        Parameters
        ----------
        problems : list of (ndarray (nc, nb d, nb d), ndarray (nc, nb, d), ndarray (nc, nb, d), ndarray (nc, nb, d))
            Of the cells of this rank, in their order: stiffness [force / length], components that supports hold, and
            right-hand sides of both [force].

        Returns
        -------
        float
            [energy]
        """
        stiffness, *tables = zip(*problems, strict=True) if problems else ((), (), (), ())
        held, first, second = (self._joined(self._table(some)) for some in tables)
        held = held > 0.5
        first, second = (np.where(held, 0.0, some) for some in (first, second))
        matrices = self._by_edges(stiffness)
        times = partial(self._times, matrices, held)
        diagonal = self._joined(np.einsum("cii->ci", matrices).reshape(first.shape))
        return self._dot(self._solved(times, first, np.where(held, 1.0, diagonal)), second)

    def _order(self):
        """Which function of a cell is that of its first facet, and so on."""
        return np.argmax(supports("triangle", 1), axis=0)

    def _by_edges(self, stiffness):
        """Stiffness (nc, nf d, nf d) of all cells, with the functions in the order of the facets."""
        rows = (self._space.dim * self._order()[:, None] + np.arange(self._space.dim)).ravel()
        every = np.concatenate([np.zeros((0, len(rows), len(rows))), *stiffness])
        return np.ascontiguousarray(every[:, rows[:, None], rows])

    def _table(self, values):
        """Values (n_facets, d) of the functions of all facets of all cells."""
        order, d = self._order(), self._space.dim
        return np.concatenate([np.zeros((0, d)), *(one[:, order].reshape(-1, d) for one in values)])

    def _joined(self, values):
        """Sums of both sides. *Collective.*"""
        return values + self._pairs.other_side(values)

    def _times(self, matrices, held, values):
        product = np.einsum("cij,cj->ci", matrices, values.reshape(matrices.shape[:2]))
        return np.where(held, 0.0, self._joined(product.reshape(values.shape)))

    def _dot(self, one, other):
        """Sum over all facets, those between cells once. *Collective.*"""
        once = np.where(self._pairs.inner, 0.5, 1.0)
        return self._space.comm.allreduce(float(once @ np.sum(one * other, axis=1)), op=MPI.SUM)

    def _solved(self, times, right, diagonal):
        """Conjugate gradients, preconditioned with the diagonal. *Collective.*"""
        result, rest = np.zeros_like(right), right.copy()
        way = rest / diagonal
        before = begin = self._dot(rest, way)
        for _ in range(MOST):
            if before <= RTOL**2 * begin:
                break
            product = times(way)
            step = before / self._dot(way, product)
            result, rest = result + step * way, rest - step * product
            turned = rest / diagonal
            now = self._dot(rest, turned)
            way, before = turned + now / before * way, now
        return result
