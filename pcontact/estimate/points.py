"""What is summed over the nodes of cells at their points: small products, of which numpy takes each by itself.

`PARTS` are the kinds of residuals, see `pcontact.estimate.estimator`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit

PARTS = ("interior", "jumps", "neumann", "contact", "friction")
INTERIOR, JUMPS, NEUMANN, CONTACT, FRICTION = range(len(PARTS))


class Sides(NamedTuple):
    """Tractions on the facets of some cells.

    Attributes
    ----------
    traction : ndarray (nc, nf, nq, d)
        Of the cells' own stress.
    flux : ndarray (n, d)
        Of the averaged stress, at the points of all facets, on both sides of those between cells.
    other : ndarray (n,) of int
        Row of `flux` that has the other side of a point, -1 where there is no other cell.
    share : ndarray (nc, nf)
        What share of a jump a cell takes.
    """

    traction: np.ndarray
    flux: np.ndarray
    other: np.ndarray
    share: np.ndarray


@njit
def slopes(u, grad, out):
    """Displacement gradients.

    Parameters
    ----------
    u : ndarray (nc, nn, d)
        At the nodes.
    grad : ndarray (nc, nq, nn, d)
        Physical gradients of the shape functions [1/length].
    out : ndarray (nc, nq, d, d)
        Output: row by component, column by direction of the derivative.
    """
    n_nodes, d = u.shape[1], u.shape[2]
    for c in range(grad.shape[0]):
        for q in range(grad.shape[1]):
            for i in range(d):
                for j in range(d):
                    total = 0.0
                    for a in range(n_nodes):
                        total += u[c, a, i] * grad[c, q, a, j]
                    out[c, q, i, j] = total


@njit
def stresses(u, grad, lam, mu, out):
    """Stresses of isotropic elasticity, in space or plane strain.

    Parameters
    ----------
    u : ndarray (nc, nn, d)
        At the nodes.
    grad : ndarray (nc, nq, nn, d)
        Physical gradients of the shape functions [1/length].
    lam, mu : float
        Lame's constants [stress].
    out : ndarray (nc, nq, d, d)
        Output [stress].
    """
    n_nodes, d = u.shape[1], u.shape[2]
    for c in range(grad.shape[0]):
        for q in range(grad.shape[1]):
            trace = 0.0
            for i in range(d):
                for j in range(i + 1):
                    one = other = 0.0
                    for a in range(n_nodes):
                        one += u[c, a, i] * grad[c, q, a, j]
                        other += u[c, a, j] * grad[c, q, a, i]
                    out[c, q, i, j] = out[c, q, j, i] = mu * (one + other)
                    if i == j:
                        trace += one
            for i in range(d):
                out[c, q, i, i] += lam * trace


@njit
def on_normals(stress, normals, out):
    """Tractions (nc, nq, d) of stresses (nc, nq, d, d) on normals (nc, nq, d), into `out`."""
    d = normals.shape[2]
    for c in range(normals.shape[0]):
        for q in range(normals.shape[1]):
            for i in range(d):
                total = 0.0
                for j in range(d):
                    total += stress[c, q, i, j] * normals[c, q, j]
                out[c, q, i] = total


@njit
def add_work(stress, test, jxw, out):
    """Add the work of stresses on test functions.

    Parameters
    ----------
    stress : ndarray (nc, nq, d, d)
    test : ndarray (nc, nq, nb, d)
        Physical gradients of the test functions [1/length].
    jxw : ndarray (nc, nq)
        Weights of the points.
    out : ndarray (nc, nb, d)
        Changed: its negative is added.
    """
    nb, d = test.shape[2], test.shape[3]
    for c in range(test.shape[0]):
        for q in range(test.shape[1]):
            w = jxw[c, q]
            for b in range(nb):
                for i in range(d):
                    total = 0.0
                    for j in range(d):
                        total += stress[c, q, i, j] * test[c, q, b, j]
                    out[c, b, i] -= w * total


@njit
def add_at(rows, part, values, out):
    """Add values of points to the residuals of their cells.

    Parameters
    ----------
    rows : ndarray (n,) of int
        Cells of the points.
    part : int
        Of the residual, see `pcontact.estimate.points`.
    values : ndarray (n, nb, d)
    out : ndarray (nc, n_parts, nb, d)
        Changed.
    """
    for p in range(values.shape[0]):
        for b in range(values.shape[1]):
            for i in range(values.shape[2]):
                out[rows[p], part, b, i] += values[p, b, i]


@njit
def weigh_facets(values, jxw, sides, first, out):
    """Test what both sides of the facets of cells say of their tractions.

    Parameters
    ----------
    values : ndarray (nf, nq, nb)
        Test functions at the points of the facets.
    jxw : ndarray (nc, nf, nq)
        Weights of the points.
    sides : Sides
        Tractions.
    first : int
        Row of the first point of the cells in those of all facets.
    out : ndarray (nc, n_parts, nb, d)
        Changed: the tractions of the cells are added to the part `INTERIOR`, and what the common ones have beside these
        to `JUMPS`.
    """
    (nf, nq, nb), d = values.shape, out.shape[3]
    for c in range(jxw.shape[0]):
        for f in range(nf):
            share = sides.share[c, f]
            for q in range(nq):
                w, point = jxw[c, f, q], first + (c * nf + f) * nq + q
                other = sides.other[point]
                for i in range(d):
                    own, jump = sides.traction[c, f, q, i], 0.0
                    if other >= 0:
                        jump = (1.0 - share) * sides.flux[point, i] - share * sides.flux[other, i] - own
                    for b in range(nb):
                        out[c, INTERIOR, b, i] += w * values[f, q, b] * own
                        out[c, JUMPS, b, i] += w * values[f, q, b] * jump


@njit
def of_nodes_on_normals(values, stress, normals, out):
    """Tractions of stresses that are given at nodes.

    Parameters
    ----------
    values : ndarray (nq, nn)
        Shape functions at the points.
    stress : ndarray (nc, nn, d, d)
    normals : ndarray (nc, nq, d)
    out : ndarray (nc, nq, d)
        Output.
    """
    n_nodes, d = values.shape[1], normals.shape[2]
    for c in range(normals.shape[0]):
        for q in range(normals.shape[1]):
            for i in range(d):
                total = 0.0
                for a in range(n_nodes):
                    part = 0.0
                    for j in range(d):
                        part += stress[c, a, i, j] * normals[c, q, j]
                    total += values[q, a] * part
                out[c, q, i] = total
