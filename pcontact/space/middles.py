"""Serendipity quadrilaterals and hexahedra of degree 2: 8 and 20 nodes carry the displacement.

Their displacements are those of the complete cells of 9 and 27 nodes whose middle nodes follow the others,

    u(middle of a face) = 1/2 sum(u of the middles of its edges) - 1/4 sum(u of its vertices),
    u(middle of a hexahedron) = 1/4 sum(u of the middles of its edges) - 1/4 sum(u of its vertices),

the values of the 8 and 20 shape functions there (Zienkiewicz, Taylor: The Finite Element Method, vol. 1). The matrix of
the complete cells becomes P^T K P, P the identity with these weights in the rows of the nodes that follow.
"""

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, face_nodes


def weights(cell):
    """Local nodes of a cell of degree 2 that follow, with those they follow.

    Parameters
    ----------
    cell : str
        Key in `pcontact.element.reference.CELLS`.

    Returns
    -------
    list of (int, ndarray (k,) int64, ndarray (k,))
        Node, leading nodes, weights. Empty for triangles and tetrahedra.
    """
    reference = CELLS[cell]
    if not reference.is_tensor:
        return []
    edges, n = edge_nodes(cell), reference.n_vertices
    middles = n + np.arange(len(edges))
    rows = []
    for number, face in enumerate(face_nodes(cell)):
        inside = middles[np.isin(edges, face).all(axis=1)]
        rows.append((n + len(edges) + number, np.concatenate([face, inside]), np.repeat([-0.25, 0.5], 4)))
    share = 0.5 if reference.dim == 2 else 0.25
    every = np.concatenate([np.arange(n), middles])
    last = n + len(edges) + len(rows)
    return [*rows, (last, every, np.repeat([-0.25, share], [n, len(edges)]))]


class MiddleNodes:
    """The nodes in the middles of faces and cells, which follow the others.

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2.

    Attributes
    ----------
    rows : ndarray (n,)
        Rows of owned nodes that follow, ascending.
    count : int
        Those of all ranks.

    Notes
    -----
    The constructor is *Collective*. A node that follows is owned by a rank of one of its cells: all that it follows is
    local there.
    """

    def __init__(self, space):
        self._space = space
        row_of = np.full(space.n_local, -1, dtype=np.int64)
        row_of[space.owned_local] = np.arange(space.n_owned)
        parts = [(np.zeros(0, np.int64), np.zeros((0, 1), np.int64), np.zeros(1))]
        for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
            for node, leading, values in weights(block.cell):
                mine = cells[row_of[cells[:, node]] >= 0]
                # neighbours say the same of the node in the middle of their face
                _, first = np.unique(mine[:, node], return_index=True)
                parts.append((row_of[mine[first, node]], mine[first][:, leading], values))
        row = np.concatenate([np.repeat(rows, table.shape[1]) for rows, table, _ in parts])
        leading = np.concatenate([table.ravel() for _, table, _ in parts])
        weight = np.concatenate([np.tile(values, len(rows)) for rows, _, values in parts])
        # of two blocks, or of two faces of one, that have the node
        _, first = np.unique(row * np.int64(space.n_local) + leading, return_index=True)
        self._row, self._leading, self._weight = row[first], leading[first], weight[first]
        self.rows = np.unique(self._row)
        self._at = np.searchsorted(self.rows, self._row)
        self.count = space.comm.allreduce(len(self.rows))

    def _followed(self, values):
        """What values (n_owned, d) make of the nodes that follow, (n, d). *Collective.*"""
        vector = self._space.vector()
        vector.setArray(values.ravel())
        local = self._space.local.gather(vector)
        vector.destroy()
        out = np.zeros((len(self.rows), values.shape[1]))
        np.add.at(out, self._at, self._weight[:, None] * local[self._leading])
        return out

    def follow(self, values):
        """Have the nodes follow in displacements (n_owned, d). *Collective.*"""
        values[self.rows] = self._followed(values)

    def lead(self, forces):
        """Take forces (n_owned, d) at the nodes to those that they follow. *Collective.*"""
        local = np.zeros((self._space.n_local, forces.shape[1]))
        np.add.at(local, self._leading, self._weight[:, None] * forces[self._row])
        forces[self.rows] = 0.0
        forces += self._space.summed(self._space.local, local)

    def entries(self, fixed):
        """Rows of P: what the components follow that are not prescribed.

        Parameters
        ----------
        fixed : ndarray (n_local, d) of bool

        Returns
        -------
        rows, columns : ndarray (m,)
            Owned rows, global columns.
        weights : ndarray (m,)
        """
        d = self._space.dim
        free = ~fixed[self._leading]
        row = (self._row[:, None] * d + np.arange(d))[free]
        column = (self._space.nodes[self._leading][:, None] * d + np.arange(d))[free]
        return row, column, np.broadcast_to(self._weight[:, None], free.shape)[free]

    def at(self):
        """Owned components that follow, (n d,)."""
        d = self._space.dim
        return (self.rows[:, None] * d + np.arange(d)).ravel()
