"""The volumetric part of elasticity where it is more than lam div u: axial symmetry and mean dilatation.

Everywhere  stress = (P . u) I + mu (grad u + grad u^T)  in the plane or space of the mesh, with a vector per node:

* plane strain, plane stress (with a lam of its own), space    P_a = lam G_a
* axial symmetry, x the radius r                               P_a = lam D_a,  D_a = G_a + (N_a / r) e_r
* mean dilatation M_a = mean of D_a (B-bar; Hughes 1980)       P_a = (lam + 2/3 mu) M_a - 2/3 mu D_a

The cell's mean is weighted by its volume, with axial symmetry by the radius. The stress with the mean dilatation is
that of  int (lam + 2/3 mu) |M . u|^2 + 2 mu |dev eps(u)|^2,  so that the facet traction fits the energy of the cell.
"""

import numpy as np

from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.shape import shape, shape_gradient


def dilatation(grad, hoop=None):
    """D_a with D . u the trace of the strain.

    Parameters
    ----------
    grad : ndarray (..., nn, d)
        Shape gradients [1/length].
    hoop : ndarray (..., nn), optional
        N / r with axial symmetry [1/length].

    Returns
    -------
    ndarray (..., nn, d)
        ``grad`` itself in plane and space.
    """
    if hoop is None:
        return grad
    result = grad.copy()
    result[..., 0] += hoop
    return result


def mean(operators, weights):
    """Means (nc, nn, d) of operators (nc, nq, nn, d) with weights (nc, nq), and the sums of the weights (nc,)."""
    volume = weights.sum(axis=1)
    return np.einsum("cq,cqad->cad", weights, operators) / volume[:, None, None], volume


def factors(lam, mu, averaged):
    """Factor [stress] of D, and that of its mean, in P."""
    return (-2.0 / 3.0 * mu, lam + 2.0 / 3.0 * mu) if averaged else (lam, 0.0 * lam)


def squares(grad, jxw, hoop, averaged, lam, mu):
    """The energy beside  mu/2 |grad u + grad u^T|^2  as a sum of squares: int ... = sum_m w_m (A_m . u)^2.

    Parameters
    ----------
    grad : ndarray (nc, nq, nn, d)
    jxw : ndarray (nc, nq)
        With the factor r or 2 pi r where there is axial symmetry.
    hoop : ndarray (nc, nq, nn) or None
        N / r with axial symmetry.
    averaged : bool
        Mean dilatation.
    lam, mu : float or ndarray (nc,)
        [stress]

    Returns
    -------
    operators : ndarray (nc, m, nn, d)
    weights : ndarray (nc, m)
    """
    lam, mu = np.reshape(lam, (-1, 1)), np.reshape(mu, (-1, 1))
    operators = [dilatation(grad, hoop)]
    own, shared = factors(lam, mu, averaged)
    weights = [own * jxw]
    if averaged:
        middle, volume = mean(operators[0], jxw)
        operators.append(middle[:, None])
        weights.append(shared * volume[:, None])
    if hoop is not None:
        ring = np.zeros_like(grad)
        ring[..., 0] = hoop
        operators.append(ring)
        weights.append(2.0 * mu * jxw)
    return np.concatenate(operators, axis=1), np.concatenate(weights, axis=1)


def hoop_operator(values, radius):
    """N / r (..., nn) of shape functions (..., nn) at radii (...); zero on the axis, where it has no weight."""
    return np.divide(values, radius[..., None], out=np.zeros(np.broadcast(values, radius[..., None]).shape),
                     where=radius[..., None] > 0.0)  # fmt: skip


def mean_dilatation(cell, x, geometry_degree, degree, order, axisymmetric):
    """Mean dilatation operators M of cells.

    Parameters
    ----------
    cell : str
    x : ndarray (nc, ng, d)
        Geometry nodes [length].
    geometry_degree, degree, order : int
        Degrees of geometry, displacement, and of the quadrature.
    axisymmetric : bool
        The first coordinate is the radius.

    Returns
    -------
    ndarray (nc, nn, d)
        [1/length]
    """
    xi, weights = quadrature(cell, order)
    dshape = np.ascontiguousarray(shape_gradient(cell, degree, xi))
    grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
    gradients(x, np.ascontiguousarray(shape_gradient(cell, geometry_degree, xi)), dshape, weights, grad, jxw)
    hoop = None
    if axisymmetric:
        radius = x[:, :, 0] @ shape(cell, geometry_degree, xi).T
        jxw *= radius
        hoop = hoop_operator(shape(cell, degree, xi), radius)
    return mean(dilatation(grad, hoop), jxw)[0]
