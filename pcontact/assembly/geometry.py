"""Shape gradients of a block's cells, a chunk of cells at a time."""

import numpy as np

from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS
from pcontact.element.shape import shape, shape_gradient

CHUNK = 8192


def bulk_degree(cell, degree, geometry_degree):
    """Quadrature degree that integrates the stiffness: exact on straight simplices, full Gauss on tensor cells."""
    simplex = CELLS[cell].n_vertices == CELLS[cell].dim + 1
    if not simplex:
        return 2 * degree if geometry_degree == 1 else 2 * max(degree, 2)
    return max(2 * (degree - 1), 0) if geometry_degree == 1 else 4


def chunks(space, number):
    """Iterate over chunks of a block's cells with their gradients.

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.

    Yields
    ------
    rows : slice
    grad : ndarray (nc, nq, nn, d)
        Physical shape gradients [1/length]. Overwritten by the next chunk.
    jxw : ndarray (nc, nq)
        Quadrature weight times Jacobian.
    values : ndarray (nq, nn)
        Shape functions.
    """
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, geometry_degree = mesh.geometry_nodes(block)
    xi, weights = quadrature(block.cell, bulk_degree(block.cell, space.degree, geometry_degree))
    dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
    dshape = np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi))
    values = shape(block.cell, space.degree, xi)
    n, nq, nn = len(block.nodes), len(weights), dshape.shape[1]
    for first in range(0, n, CHUNK):
        rows = slice(first, min(first + CHUNK, n))
        x = np.ascontiguousarray(mesh.points[table[rows]])
        grad = np.empty((len(x), nq, nn, mesh.dim))
        jxw = np.empty((len(x), nq))
        gradients(x, dgeo, dshape, weights, grad, jxw)
        yield rows, grad, jxw, values
