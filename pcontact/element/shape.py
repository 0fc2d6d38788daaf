"""Lagrange shape functions of degrees 1 and 2 and their reference gradients.

Those of a serendipity cell of degree 2 are those of the complete cell, of whose middle nodes each takes its share:
N_a + sum_m w_ma N_m, with the weights of `pcontact.element.reference.middle_weights`.

Those of wedges are products of the triangle's and the segment's. Those of pyramids are rational: with w = 1 - z, in
degree 1 (w +- x) (w +- y) / (4 w) and z; in degree 2 they span the quadratic polynomials and  f, x f, y f, f^2  with
f = x y / w  (Bergot, Cohen, Durufle 2010). So they are those of triangles and quadrilaterals on the facets, and a
pyramid between hexahedra and tetrahedra leaves no gap.
"""

import functools

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, middle_weights, reference_nodes

# [points] Of tables that are kept: those of quadrature rules, of nodes and of all facets' rules. From: to make a table
# takes 50 microseconds, whatever it is for, and a run of some hundred unknowns wants hundreds.
FEW, TABLES = 160, 1024


def kept(function):
    """A function of cell, degree and reference points, with tables at few points kept; they are not to be changed."""

    @functools.lru_cache(maxsize=TABLES)
    def known(cell, degree, count, points):
        return function(cell, degree, np.frombuffer(points).reshape(count, -1))

    @functools.wraps(function)
    def table(cell, degree, xi):
        xi = _points(cell, xi)
        if not 0 < len(xi) <= FEW:
            return function(cell, degree, xi)
        return known(cell, degree, len(xi), xi.tobytes())

    return table


@kept
def shape(cell, degree, xi):
    """Shape functions at reference points.

    Parameters
    ----------
    cell : str
        Key in `pcontact.element.reference.CELLS`.
    degree : int
        1 or 2.
    xi : ndarray, (n_points, dim)
        Points in the reference domain.

    Returns
    -------
    ndarray, (n_points, n_nodes) float64
        Not to be changed: at few points it is kept.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2, or the points have another dimension than the cell.
    """
    if CELLS[cell].complete is not None:
        return _shared(cell, shape(CELLS[cell].complete, degree, xi))
    if CELLS[cell].is_tensor:
        return _lagrange(xi[:, None], reference_nodes(cell, degree), degree).prod(axis=2)
    nodes = reference_nodes(cell, degree)
    if CELLS[cell].is_wedge:
        column, height = _wedge_nodes(nodes, degree)
        return shape("triangle", degree, xi[:, :2])[:, column] * _lagrange(xi[:, 2:], height, degree)
    if CELLS[cell].is_pyramid:
        return _pyramid_basis(xi, degree)[0] @ _pyramid_weights(degree)
    bary = _barycentric(xi)
    if degree == 1:
        return bary
    a, b = edge_nodes(cell).T
    return np.hstack([bary * (2.0 * bary - 1.0), 4.0 * bary[:, a] * bary[:, b]])


@kept
def shape_gradient(cell, degree, xi):
    """Reference gradients of the shape functions at reference points.

    Parameters
    ----------
    cell : str
    degree : int
    xi : ndarray, (n_points, dim)

    Returns
    -------
    ndarray, (n_points, n_nodes, dim) float64
        Derivatives with respect to the reference coordinates; not to be changed.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2, or the points have another dimension than the cell.
    """
    if CELLS[cell].complete is not None:
        return _shared(cell, shape_gradient(CELLS[cell].complete, degree, xi))
    nodes = reference_nodes(cell, degree)
    if CELLS[cell].is_wedge:
        return _wedge_gradient(xi, *_wedge_nodes(nodes, degree), degree)
    if CELLS[cell].is_pyramid:
        return np.einsum("pmk,ma->pak", _pyramid_basis(xi, degree)[1], _pyramid_weights(degree))
    if not CELLS[cell].is_tensor:
        return _simplex_gradient(cell, degree, xi)
    values = _lagrange(xi[:, None], nodes, degree)
    slopes = _lagrange_slope(xi[:, None], nodes, degree)
    gradient = np.empty_like(values)
    for axis in range(CELLS[cell].dim):
        factors = values.copy()
        factors[:, :, axis] = slopes[:, :, axis]
        gradient[:, :, axis] = factors.prod(axis=2)
    return gradient


def _points(cell, xi):
    xi = np.asarray(xi, dtype=float)
    if xi.ndim != 2 or xi.shape[1] != CELLS[cell].dim:
        raise ValueError(f"{cell}: points of shape {xi.shape}, expected (n_points, {CELLS[cell].dim})")
    return xi


def _shared(cell, values):
    """Values (n_points, n_nodes, ...) of a serendipity cell from those of the complete one."""
    weights = middle_weights(cell)
    n = weights.shape[1]
    if values.shape[1] < n:
        return values  # degree 1: there are no middles
    return values[:, :n] + np.einsum("pm...,ma->pa...", values[:, n:], weights)


def _barycentric(xi):
    return np.hstack([1.0 - xi.sum(axis=1, keepdims=True), xi])


def _simplex_gradient(cell, degree, xi):
    dim = xi.shape[1]
    slope = np.vstack([-np.ones(dim), np.eye(dim)])
    if degree == 1:
        return np.tile(slope, (len(xi), 1, 1))
    bary = _barycentric(xi)[:, :, None]
    a, b = edge_nodes(cell).T
    edges = 4.0 * (bary[:, a] * slope[b] + bary[:, b] * slope[a])
    return np.concatenate([(4.0 * bary - 1.0) * slope, edges], axis=1)


def _wedge_nodes(nodes, degree):
    """Node of the triangle, and coordinate along the axis, of the nodes (n, 3) of a wedge."""
    triangle = reference_nodes("triangle", degree)
    column = np.abs(nodes[:, None, :2] - triangle).sum(axis=2).argmin(axis=1)
    return column, nodes[:, 2]


def _wedge_gradient(xi, column, height, degree):
    across = shape_gradient("triangle", degree, xi[:, :2])[:, column] * _lagrange(xi[:, 2:], height, degree)[:, :, None]
    along = shape("triangle", degree, xi[:, :2])[:, column] * _lagrange_slope(xi[:, 2:], height, degree)
    return np.concatenate([across, along[:, :, None]], axis=2)


def _pyramid_basis(xi, degree):
    """Functions (n, m) that span those of a pyramid, and their gradients (n, m, 3).

    At the apex, where gradients of f depend on the way, they are those on the axis.
    """
    x, y, z = xi.T
    w = 1.0 - z
    top = w <= 0.0
    u, v = (np.where(top, 0.0, coordinate / np.where(top, 1.0, w)) for coordinate in (x, y))
    one, zero = np.ones_like(x), np.zeros_like(x)
    f, df = u * v * w, np.stack([v, u, u * v], axis=1)
    values = [one, x, y, z, f]
    slopes = [np.stack(row, axis=1) for row in ((zero, zero, zero), (one, zero, zero), (zero, one, zero),
                                                (zero, zero, one))] + [df]  # fmt: skip
    if degree == 2:
        for a, b in ((1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3), (1, 4), (2, 4), (4, 4)):
            values.append(values[a] * values[b])
            slopes.append(values[a][:, None] * slopes[b] + values[b][:, None] * slopes[a])
    return np.stack(values, axis=1), np.stack(slopes, axis=1)


@functools.cache
def _pyramid_weights(degree):
    """Matrix (m, n_nodes) from the functions of `_pyramid_basis` to the shape functions."""
    # entries are multiples of 1 / 4: rounding takes the errors of the inverse away
    return np.rint(16.0 * np.linalg.inv(_pyramid_basis(reference_nodes("pyramid", degree), degree)[0])) / 16.0


def _lagrange(s, node, degree):
    """One-dimensional function that is 1 at `node` (-1, 0 or 1), at coordinates `s`; arguments broadcast."""
    if degree == 1:
        return 0.5 * (1.0 + node * s)
    return np.where(node == 0.0, 1.0 - s * s, 0.5 * s * (s + node))


def _lagrange_slope(s, node, degree):
    if degree == 1:
        return 0.5 * node + 0.0 * s
    return np.where(node == 0.0, -2.0 * s, s + 0.5 * node)
