"""The mass of the bodies: M_ab = int rho N_a N_b, the same for every direction, or lumped; and that of the reference
points of rigid groups."""

import numpy as np

from pcontact.assembly.graph import Product, node_graph
from pcontact.assembly.matrix import JoinedPattern, OwnedRows
from pcontact.assembly.patches import cell_patches


class Mass:
    """Mass matrix of the bodies.

    Parameters
    ----------
    space : pcontact.space.space.Space
    densities : dict of str to float
        Mass per volume of the cells of each region [mass / length^3]; other cells have none.
    lumped : bool
        On the diagonal alone: that of the matrix of every cell, scaled to its mass. Positive for degree 2 as well.
    points : sequence of (pcontact.space.constraints.RigidGroup, ndarray (k,))
        Groups whose points have masses, see :meth:`pcontact.space.constraints.RigidGroup.inertia`.

    Attributes
    ----------
    rowptr, columns : ndarray
        Pattern of the owned rows, global nodes: that of cells, and of the leading components of groups.
    values : ndarray (nnz, d, d)
        [mass]. Of points it has what those of their motions that are free need.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, densities, lumped=False, points=()):
        self.space, self._points = space, points
        rowptr, columns = node_graph(space.cells, space.n_local)
        # sorted: columns are sorted in each row
        place = np.repeat(np.arange(space.n_local), np.diff(rowptr)) * space.n_local + columns
        local = np.zeros(len(columns))
        for region, density in densities.items():
            for patch in cell_patches(space, region):
                weights = density * patch.weight
                cells = np.einsum("nq,nqa,nqb->nab", weights, patch.shape, patch.shape)
                if lumped:
                    diagonal = np.einsum("naa->na", cells)
                    scale = weights.sum(axis=1) / diagonal.sum(axis=1)
                    cells = (diagonal * scale[:, None])[:, :, None] * np.eye(diagonal.shape[1])
                at = np.searchsorted(place, patch.nodes[:, :, None] * space.n_local + patch.nodes[:, None, :])
                local += np.bincount(at.ravel(), cells.ravel(), minlength=len(local))
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self._rows = owned.rowptr, owned.columns
        self.values = self._cells = owned.sum(local[:, None, None]) * np.eye(space.dim)
        self._product, self._vector = Product(space, *self._rows), space.vector()
        self.rowptr, self.columns = self._rows
        if points:
            leading = [self._leading(*one) for one in points]
            patterns = [self._rows, *((one.rowptr, one.columns) for one, _ in leading)]
            self._joined, self._leads = JoinedPattern(patterns, space.n_owned), [values for _, values in leading]
            self.rowptr, self.columns = self._joined.rowptr, self._joined.columns
            self.values = self._joined.sum([self._cells, *self._leads])

    def _leading(self, group, masses):
        """Rows and values (nnz, d, d) between the leading components of a group, which rank 0 brings. *Collective.*"""
        space, d = self.space, self.space.dim
        nodes, at = np.unique(group.leading // d, return_inverse=True)
        n = len(nodes) if space.comm.rank == 0 else 0
        blocks = np.zeros((n, d, n, d))
        if n:
            components = at * d + group.leading % d
            blocks.reshape(n * d, n * d)[np.ix_(components, components)] = group.leading_mass(masses)
        rowptr, columns = np.arange(n + 1, dtype=np.int64) * n, np.tile(np.arange(n, dtype=np.int64), n)
        owned = OwnedRows(space.numbering, space.exchanger, nodes[:n], rowptr, columns)
        return owned, owned.sum(np.ascontiguousarray(blocks.transpose(0, 2, 1, 3).reshape(-1, d, d)))

    def magnitude(self, values):
        """Sum of the absolute terms of the product (n_owned, d) with values (n_owned, d) >= 0. *Collective.*"""
        out = self.times(values, np.abs(self._cells))
        for group, masses in self._points:
            group.weigh(masses, values, out, np.abs)
        return out

    def spread(self, values):
        """Blocks on the pattern of cells (n, d, d) as values on the whole one (nnz, d, d)."""
        return values if not self._points else self._joined.sum([values, *(0.0 * one for one in self._leads)])

    def matrix(self, problem):
        """A matrix of a problem that has the mass alone. *Collective.*"""
        matrix = problem.conditions.new_matrix()
        matrix.fill((self.rowptr, self.columns), self.values)
        return matrix

    def times(self, values, matrix=None):
        """Product (n_owned, d) with the values (n_owned, d) of nodes; `matrix`: of other blocks (nnz, d, d) than those
        of the mass. *Collective.*"""
        self._vector.setArray(values.ravel())
        out = self._product(self._cells if matrix is None else matrix, self._vector)
        for group, masses in self._points if matrix is None else ():
            group.weigh(masses, values, out)
        return out
