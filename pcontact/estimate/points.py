"""Sums over the nodes of cells at their points: small products, of which numpy takes each by itself.

`PARTS` are the kinds of residuals, see `pcontact.estimate.estimator`.

Test functions of the local problems: what the displacement cannot represent, a degree higher.

The space of a cell is the kernel of the nodal interpolation from degree p + 1 to degree p (Bank and Weiser 1985). It
has no rigid motion in it, so a problem with forces on all facets can be solved. On tensor cells only products with one
factor of degree p + 1 are taken: in the others the error of smooth solutions has no leading term.
"""

import functools
import itertools
from typing import NamedTuple

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_points, kept
from pcontact.runtime.jit import njit

# values below this are zeros
ZERO = 1e-12


def _forms(cell, degree):
    """Functions of a simplex as products of linear forms: a list of arrays (k, dim + 1) of barycentric coefficients."""
    corner = np.eye(CELLS[cell].n_vertices)
    edges = [(corner[a], corner[b]) for a, b in CELLS[cell].edges]
    if degree == 1:
        return [np.array([a, b]) for a, b in edges]
    faces = itertools.combinations(corner, 3)
    return [np.array([a, b, a - b]) for a, b in edges] + [np.array(face) for face in faces]


@functools.cache
def _stacked(cell, degree):
    """The products of :func:`_forms` by their numbers of factors: which, and the forms (n, k, dim + 1)."""
    forms = _forms(cell, degree)
    sizes = np.array([len(one) for one in forms])
    return [(np.flatnonzero(sizes == k), np.stack([one for one in forms if len(one) == k])) for k in np.unique(sizes)]


def _simplex(cell, degree, xi):
    dim, stacked = xi.shape[1], _stacked(cell, degree)
    slope = np.vstack([-np.ones(dim), np.eye(dim)])
    bary = np.hstack([1.0 - xi.sum(axis=1, keepdims=True), xi])
    count = sum(len(which) for which, _ in stacked)
    values, gradients = np.empty((len(xi), count)), np.empty((len(xi), count, dim))
    for which, forms in stacked:
        factors = np.tensordot(bary, forms, (1, 2))
        values[:, which] = factors.prod(axis=2)
        total = 0.0
        for k in range(forms.shape[1]):
            others = np.delete(factors, k, axis=2).prod(axis=2)
            total = total + others[:, :, None] * (forms[:, k] @ slope)
        gradients[:, which] = total
    return values, gradients


def _line(degree, s):
    """Values and slopes (k, n) in one dimension: the nodal functions, and last the one of degree + 1."""
    one, zero = np.ones_like(s), np.zeros_like(s)
    if degree == 1:
        return np.array([(1 - s) / 2, (1 + s) / 2, 1 - s * s]), np.array([-one / 2, one / 2, -2 * s])
    values = np.array([s * (s - 1) / 2, s * (s + 1) / 2, 1 - s * s, s * (1 - s * s)])
    return values, np.array([s - 0.5, s + 0.5, -2 * s, one - 3 * s * s]) + zero


def _tensor(cell, degree, xi):
    dim, last = CELLS[cell].dim, degree + 1
    lines = [_line(degree, xi[:, axis]) for axis in range(dim)]
    chosen = [k for k in itertools.product(range(last + 1), repeat=dim) if k.count(last) == 1]
    values = np.stack([np.prod([lines[a][0][k[a]] for a in range(dim)], axis=0) for k in chosen], axis=1)
    gradients = np.empty((len(xi), len(chosen), dim))
    for axis in range(dim):
        for n, k in enumerate(chosen):
            factors = [lines[a][1 if a == axis else 0][k[a]] for a in range(dim)]
            gradients[:, n, axis] = np.prod(factors, axis=0)
    return values, gradients


@kept
def bubbles(cell, degree, xi):
    """Functions of degree + 1 that vanish at the nodes of a degree; not to be changed.

    Parameters
    ----------
    cell : str
    degree : int
        Of the displacement.
    xi : ndarray (n, dim)
        Reference points.

    Returns
    -------
    values : ndarray (n, nb)
    gradients : ndarray (n, nb, dim)
        In reference coordinates.
    """
    return _tensor(cell, degree, xi) if CELLS[cell].is_tensor else _simplex(cell, degree, xi)


@functools.cache
def number_of(cell, degree):
    """Number of these functions."""
    return bubbles(cell, degree, np.zeros((0, CELLS[cell].dim)))[0].shape[1]


@functools.cache
def supports(cell, degree):
    """Flags of the functions that live on facets of the cell, (nb, n_facets) bool; not to be changed."""
    points = facet_points(cell, quadrature(CELLS[cell].facet, 5)[0])
    return np.stack([np.abs(bubbles(cell, degree, at)[0]).max(axis=0) > ZERO for at in points], axis=1)


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
    """Displacement gradients (nc, nq, d, d), row by component, column by direction of the derivative, from nodal values
    (nc, nn, d) and gradients (nc, nq, nn, d) of shape functions."""
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
    """Take the work of stresses (nc, nq, d, d) on test functions of gradients (nc, nq, nb, d), with weights (nc, nq) of
    the points, off `out` (nc, nb, d)."""
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
    """Add values (n, nb, d) of points to a part, see `pcontact.estimate.points`, of the residuals (nc, n_parts, nb, d)
    of their cells (n,)."""
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
    """Tractions (nc, nq, d) on normals (nc, nq, d) of stresses (nc, nn, d, d) at nodes, with shape functions (nq, nn)
    at the points."""
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
