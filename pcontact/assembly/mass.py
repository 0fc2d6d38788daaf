"""The mass of the bodies: M_ab = int rho N_a N_b, the same for every direction, or lumped."""

import numpy as np

from pcontact.assembly.graph import multiply, node_graph
from pcontact.assembly.patches import cell_patches
from pcontact.assembly.pattern import OwnedRows


class Mass:
    """Mass matrix of the bodies, a number per pair of nodes.

    Parameters
    ----------
    space : pcontact.space.space.Space
    densities : dict of str to float
        Mass per volume of the cells of each region [mass / length^3]; other cells have none.
    lumped : bool
        On the diagonal alone: that of the matrix of every cell, scaled to its mass. Positive for degree 2 as well.

    Attributes
    ----------
    rowptr, columns : ndarray
        Pattern of the owned rows, global nodes: that of cells.
    values : ndarray (nnz, d, d)
        [mass]

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, densities, lumped=False):
        self.space = space
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
        self.rowptr, self.columns = owned.rowptr, owned.columns
        self.values = owned.sum(local[:, None, None]) * np.eye(space.dim)
        nodes, self._column = np.unique(self.columns, return_inverse=True)
        self._exchange, self._vector = space.exchange(nodes), space.vector()

    def times(self, values, matrix=None):
        """Product (n_owned, d) with the values (n_owned, d) of nodes; `matrix`: of other blocks (nnz, d, d) than those
        of the mass. *Collective.*"""
        self._vector.setArray(values.ravel())
        out = np.empty_like(values)
        multiply(self.rowptr, self._column, self.values if matrix is None else matrix,
                 self._exchange.gather(self._vector), out)  # fmt: skip
        return out
