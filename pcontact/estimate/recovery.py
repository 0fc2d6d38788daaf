"""A continuous stress: the means of what cells say at their common nodes, in each body for itself."""

from functools import partial

import numpy as np

from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import reference_nodes
from pcontact.element.shape import shape, shape_gradient
from pcontact.estimate.stress import BlockStress, own_nodes
from pcontact.runtime.petsc import MPI

# upper triangle of a symmetric tensor
UPPER = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))}


class Recovery:
    """Nodal means of the stress.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space):
        self.space = space
        body = np.full(space.n_local, -1, dtype=np.int64)
        clash = False
        for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
            clash |= bool(np.any((body[cells] >= 0) & (body[cells] != block.body)))
            body[cells] = block.body
        # ranks may meet in a node with different bodies, too: its owner's number has to be everybody's
        numbers, one = np.zeros((space.n_local, space.dim)), np.zeros((space.n_local, space.dim))
        numbers[:, 0], one[:, 0] = body, 1.0
        mean = space.together(numbers)[:, 0] / np.maximum(space.together(one)[:, 0], 1.0)
        clash |= bool(np.any(np.abs(mean - body) > 1e-9))
        bodies = sorted(set().union(*space.comm.allgather({block.body for block in space.mesh.blocks})))
        clash = space.comm.allreduce(clash, op=MPI.LOR)
        self._groups = [{number} for number in bodies] if clash else [set(bodies)]

    def __call__(self, bulk, nodal, found=None):
        """Stress at the nodes of each block's cells. *Collective.*

        Parameters
        ----------
        bulk : pcontact.assembly.solid.Solid
        nodal : ndarray (n_local, d)
        found : dict, optional
            See :class:`pcontact.estimate.stress.BlockStress`.

        Returns
        -------
        list of ndarray (nc, nn, d, d)
        """
        space, d = self.space, self.space.dim
        upper, result = UPPER[d], [None] * len(space.mesh.blocks)
        for group in self._groups:
            sums = np.zeros((space.n_local, d * -(-(len(upper) + 1) // d)))
            for number, block in enumerate(space.mesh.blocks):
                if block.body in group:
                    self._add(BlockStress(space, bulk, number, slice(None), nodal, found), number, sums)
            sums = np.concatenate([self.space.together(sums[:, k : k + d]) for k in range(0, sums.shape[1], d)], axis=1)
            mean = sums[:, : len(upper)] / np.where(sums[:, len(upper)] > 0.0, sums[:, len(upper)], 1.0)[:, None]
            tensor = np.empty((space.n_local, d, d))
            for k, (i, j) in enumerate(upper):
                tensor[:, i, j] = tensor[:, j, i] = mean[:, k]
            for number, block in enumerate(space.mesh.blocks):
                if block.body in group:
                    result[number] = tensor[own_nodes(space, number)]
        return result

    def _add(self, stress, number, sums):
        """Add stress times volume, and volume, of a block's cells at their nodes."""
        space, upper = self.space, UPPER[self.space.dim]
        grad, values, radius, nodes, weight, cells = space.kept(("averaged", number), partial(self._at_nodes, number))
        tensor, _ = stress(grad, values, radius, nodes)
        for k, (i, j) in enumerate(upper):
            sums[:, k] += np.bincount(cells, (weight[:, None] * tensor[:, :, i, j]).ravel(), len(sums))
        sums[:, len(upper)] += np.bincount(cells, np.repeat(weight, len(nodes)), len(sums))

    def _at_nodes(self, number):
        """Of a block's cells at their nodes: gradients and values of shape functions, radii or None, reference nodes;
        volumes (nc,) and nodes (nc nn,) of the cells."""
        space, mesh, block = self.space, self.space.mesh, self.space.mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = quadrature(block.cell, 2)
        degree = space.degree_of(block)
        nodes = reference_nodes(block.cell, degree)
        x = np.ascontiguousarray(mesh.points[table])
        dshape = np.ascontiguousarray(shape_gradient(block.cell, degree, nodes))
        grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(nodes)))
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, nodes))
        gradients(x, dgeo, dshape, np.ones(len(nodes)), grad, jxw)
        radius = x[:, :, 0] @ shape(block.cell, geometry_degree, nodes).T if space.axisymmetric else None
        one, volume = np.empty((len(x), len(weights), 1, mesh.dim)), np.empty((len(x), len(weights)))
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        gradients(x, dgeo, np.ascontiguousarray(dgeo[:, :1]), weights, one, volume)
        cells = own_nodes(space, number).ravel()
        return grad, shape(block.cell, degree, nodes), radius, nodes, volume.sum(axis=1), cells
