"""Test functions of the local problems: what the displacement cannot represent, a degree higher.

The space of a cell is the kernel of the nodal interpolation from degree p + 1 to degree p (Bank and Weiser 1985). It
has no rigid motion in it, so a problem with forces on all facets can be solved. On tensor cells only products with one
factor of degree p + 1 are taken: in the others the error of smooth solutions has no leading term.
"""

import functools
import itertools

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_points
from pcontact.element.shape import kept

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
    """Which functions live on which facets of the cell, (nb, n_facets) bool; not to be changed."""
    points = facet_points(cell, quadrature(CELLS[cell].facet, 5)[0])
    return np.stack([np.abs(bubbles(cell, degree, at)[0]).max(axis=0) > ZERO for at in points], axis=1)
