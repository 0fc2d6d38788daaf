"""The volumetric part of elasticity where it is more than lam div u: axial symmetry and mean dilatation.

Everywhere  stress = (P . u) I + mu (grad u + grad u^T)  in the plane or space of the mesh, with a vector per node:

* plane strain, plane stress (with a lam of its own), space    P_a = lam G_a
* axial symmetry, x the radius r                               P_a = lam D_a,  D_a = G_a + (N_a / r) e_r
* mean dilatation M_a = mean of D_a (B-bar; Hughes 1980)       P_a = (lam + 2/3 mu) M_a - 2/3 mu D_a
* the same in cells of degree 2                                P_a = lam M_a

The cell's mean is its projection of D_a: onto constants in cells of degree 1 and in triangles and tetrahedra of degree
2, onto the linear functions of the place in other cells of degree 2 (pairs of displacement and pressure that are
stable: Boffi, Brezzi, Fortin 2013, chapter 8; for tetrahedra of degree 2 with constants, wedges and pyramids that is
not proved). It is weighted by volume, with axial symmetry by the radius. The stress with the mean dilatation is that of
int (lam + 2/3 mu) |M . u|^2 + 2 mu |dev eps(u)|^2,  so that the facet traction fits the energy of the cell; with degree
2 that of  int lam |M . u|^2 + 2 mu |eps(u)|^2:  a tetrahedron of degree 2 has displacements without a deviator whose
dilatation is linear, with a mean of zero (u = 2 (b . x) x - |x|^2 b), and they must not be free.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.geometry import cell_geometry
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape


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


class Dilatation(NamedTuple):
    """Mean dilatation: a stress other than that of lam div u and mu (grad u + grad u^T) at the point itself.

    Attributes
    ----------
    axisymmetric : bool
        Axial symmetry: the first coordinate is the radius.
    averaged : bool
        Mean dilatation.
    reduced : bool
        Reduced integration, see `pcontact.element.quadrature`; without axial symmetry.
    law : pcontact.material.orthotropic.Orthotropic or None
        Elasticity of which lam and mu are the nearest isotropic constants; without mean dilatation.
    shear : ndarray (nf,) or None
        Of the trace constant of facets: squares of tangential tractions count over this part; None: over 1.
    """

    axisymmetric: bool
    averaged: bool
    reduced: bool = False
    law: object = None
    shear: np.ndarray | None = None


# lam div u alone
PLAIN = Dilatation(False, False)


class Mean(NamedTuple):
    """Mean dilatation of cells: M(x) = slopes[0] + sum_k (x - centre)_k slopes[k].

    Attributes
    ----------
    centre : ndarray (nc, d)
        Centroids [length].
    slopes : ndarray (nc, nb, nn, d)
        nb is 1 for constants [1/length], 1 + d for linear functions [1/length^2].
    """

    centre: np.ndarray
    slopes: np.ndarray

    def at(self, x, cells=None):
        """Operators (n, nq, nn, d) at points x (n, nq, d) of the cells, or of those with numbers (n,)."""
        centre, slopes = (self.centre, self.slopes) if cells is None else (self.centre[cells], self.slopes[cells])
        if slopes.shape[1] == 1:
            return slopes
        return slopes[:, :1] + np.einsum("cqk,ckad->cqad", x - centre[:, None], slopes[:, 1:])

    def times(self, factors):
        """The same times factors (nc,)."""
        return Mean(self.centre, self.slopes * factors[:, None, None, None])


def linear(cell, degree):
    """Return True if the mean dilatation of a kind of cells is linear, not constant."""
    return degree == 2 and not CELLS[cell].is_simplex


def components(weights, x=None):
    """An orthogonal basis of what the mean dilatation is projected onto.

    Parameters
    ----------
    weights : ndarray (nc, nq)
    x : ndarray (nc, nq, d), optional
        Points, for linear functions; constants alone without.

    Returns
    -------
    basis : ndarray (nc, nq, nb)
        Its members have the squared norm of 1, the volume.
    volume : ndarray (nc,)
    centre : ndarray (nc, d), or (nc, 0) without points
    inverse : ndarray (nc, d, d) or None
        Basis 1 to d over x - centre: the inverse of the Cholesky factor of the mean of (x - centre) (x - centre)^T.
    """
    volume = weights.sum(axis=1)
    constant = np.ones((*weights.shape, 1))
    if x is None:
        return constant, volume, np.zeros((len(weights), 0)), None
    centre = np.einsum("cq,cqk->ck", weights, x) / volume[:, None]
    offset = x - centre[:, None]
    spread = np.einsum("cq,cqk,cql->ckl", weights, offset, offset) / volume[:, None, None]
    inverse = np.linalg.inv(np.linalg.cholesky(spread))
    return np.concatenate([constant, np.einsum("ckl,cql->cqk", inverse, offset)], axis=2), volume, centre, inverse


def mean(operators, weights, basis, volume):
    """Components (nc, nb, nn, d) of operators (nc, nq, nn, d) on a basis of :func:`components`."""
    weighted = weights[:, :, None] * basis / volume[:, None, None]
    n, d = operators.shape[2:]
    # no -1: a rank may have no cells
    flat = np.matmul(weighted.transpose(0, 2, 1), operators.reshape(*weights.shape, n * d))
    return flat.reshape(len(flat), basis.shape[2], n, d)


def factors(lam, mu, averaged, degree):
    """Factor [stress] of D, and that of its mean, in P; with the degree of the displacement."""
    if averaged and degree == 2:
        return 0.0 * lam, lam
    return (-2.0 / 3.0 * mu, lam + 2.0 / 3.0 * mu) if averaged else (lam, 0.0 * lam)


def squares(grad, jxw, hoop, averaged, degree, lam, mu, x=None):
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
    degree : int
        Of the displacement.
    lam, mu : float or ndarray (nc,)
        [stress]
    x : ndarray (nc, nq, d), optional
        The points [length], where the mean dilatation is linear.

    Returns
    -------
    operators : ndarray (nc, m, nn, d)
    weights : ndarray (nc, m)
    """
    lam, mu = np.reshape(lam, (-1, 1)), np.reshape(mu, (-1, 1))
    operators = [dilatation(grad, hoop)]
    own, shared = factors(lam, mu, averaged, degree)
    weights = [own * jxw]
    if averaged:
        basis, volume, _, _ = components(jxw, x)
        operators.append(mean(operators[0], jxw, basis, volume))
        weights.append(np.repeat(shared * volume[:, None], basis.shape[2], axis=1))
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


def mean_dilatation(cell, x, geometry_degree, degree, order, axisymmetric, of=None):
    """Mean dilatation operators of cells.

    Parameters
    ----------
    cell : str
    x : ndarray (nc, ng, d)
        Geometry nodes [length].
    geometry_degree, degree, order : int
        Degrees of geometry, displacement, and of the quadrature.
    axisymmetric : bool
        The first coordinate is the radius.
    of : int, optional
        Degree of the displacements that the cells have, where it is less than that of their shape functions.

    Returns
    -------
    Mean
    """
    xi, weights = quadrature(cell, order)
    grad, jxw, _ = cell_geometry(cell, x, geometry_degree, degree, xi, weights)
    hoop = None
    if axisymmetric:
        radius = x[:, :, 0] @ shape(cell, geometry_degree, xi).T
        jxw *= radius
        hoop = hoop_operator(shape(cell, degree, xi), radius)
    points = shape(cell, geometry_degree, xi) @ x if linear(cell, of or degree) else None
    basis, volume, centre, inverse = components(jxw, points)
    middle = mean(dilatation(grad, hoop), jxw, basis, volume)
    if points is None:
        return Mean(np.zeros((len(x), x.shape[2])), middle)
    slopes = np.einsum("ckl,ckad->clad", inverse, middle[:, 1:])
    return Mean(centre, np.concatenate([middle[:, :1], slopes], axis=1))
