"""Reduced integration of serendipity cells: the strain is the one that 2 points in each direction have.

Integrals are taken at these points alone, and at any other point of the cell the displacement's gradient counts as the
product of linear functions that it is at these points. So displacements of a cell that have no energy have no traction
on its facets either, and the trace inequality of Nitsche's method holds.
"""

import numpy as np

from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS
from pcontact.element.shape import shape, shape_gradient

# degree of the quadrature with 2 points in each direction
DEGREE = 3


def from_points(cell, xi):
    """Matrix (n, nq) that takes values at the cell's own points to reference points xi (n, d)."""
    complete, points = CELLS[cell].complete, quadrature(cell, DEGREE)[0]
    # the shape functions of degree 1 of the cell whose corners the points are, which are in another order
    scale = 1.0 / np.abs(points).max()
    return shape(complete, 1, scale * np.asarray(xi)) @ np.rint(shape(complete, 1, scale * points)).T


def reduced_gradients(cell, x, geometry_degree, xi):
    """Gradients of the shape functions of degree 2 as reduced integration has them.

    Parameters
    ----------
    cell : str
        Serendipity cell.
    x : ndarray, (nc, ng, d)
        Geometry nodes [length].
    geometry_degree : int
    xi : ndarray, (nc, n, d)
        Reference points of each cell.

    Returns
    -------
    ndarray, (nc, n, nn, d)
        [1/length]
    """
    points, weights = quadrature(cell, DEGREE)
    dshape = np.ascontiguousarray(shape_gradient(cell, 2, points))
    grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
    dgeo = np.ascontiguousarray(shape_gradient(cell, geometry_degree, points))
    gradients(np.ascontiguousarray(x), dgeo, dshape, weights, grad, jxw)
    nc, n, d = xi.shape
    share = from_points(cell, xi.reshape(nc * n, d)).reshape(nc, n, len(points))
    return np.matmul(share, grad.reshape(nc, len(points), dshape.shape[1] * d)).reshape(nc, n, dshape.shape[1], d)
