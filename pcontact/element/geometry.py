"""Physical gradients, volumes, facet normals: the compiled geometry of cells and of their facets.

The degree of the geometry and that of the shape functions are independent: both come in as tables of
reference gradients. Two- and three-dimensional kernels are written out apart because the unrolled Jacobian is
several times faster than loops over the dimension.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, facet_area_vectors, facet_points, shape, shape_gradient
from pcontact.runtime.jit import njit


class FacetGeometry(NamedTuple):
    """Geometry of facets at their quadrature points.

    Attributes
    ----------
    points : ndarray, (nf, nq, d)
        Coordinates of the quadrature points [length].
    normals : ndarray, (nf, nq, d)
        Outward unit normals of the parent cell.
    jxw : ndarray, (nf, nq)
        Quadrature weight times surface (length in 2D) element [length^(d-1)].
    shape : ndarray, (nf, nq, nn) or None
        Shape functions of the parent cell.
    gradients : ndarray, (nf, nq, nn, d)
        Physical gradients of the parent cell's shape functions [1/length].
    """

    points: np.ndarray
    normals: np.ndarray
    jxw: np.ndarray
    shape: np.ndarray | None
    gradients: np.ndarray


class FacetPoints(NamedTuple):
    """Arrays that kernels write of a :class:`FacetGeometry`."""

    points: np.ndarray
    normals: np.ndarray
    jxw: np.ndarray
    gradients: np.ndarray


class FacetTables(NamedTuple):
    """Tables of the facets of one kind of cell; row ``facet * nq + point`` of a table is a point of a facet.

    Attributes
    ----------
    geo : ndarray, (n_facets nq, ng)
    dgeo : ndarray, (n_facets nq, ng, d)
        Shape functions of the geometry, and their reference gradients.
    dshape : ndarray, (n_facets nq, nn, d)
        Reference gradients of the displacement's shape functions.
    area : ndarray, (n_facets, d)
        Area vectors of the reference cell's facets.
    weights : ndarray, (nq,)
        Of the quadrature.
    """

    geo: np.ndarray
    dgeo: np.ndarray
    dshape: np.ndarray
    area: np.ndarray
    weights: np.ndarray


@njit
def gradients(x, dgeo, dshape, weights, grad, jxw):
    """Physical shape gradients and volume weights of cells.

    Parameters
    ----------
    x : ndarray, (nc, ng, d) float64
        Coordinates of the cells' geometry nodes, d = 2 or 3.
    dgeo : ndarray, (nq, ng, d) float64
        Reference gradients of the geometry's shape functions.
    dshape : ndarray, (nq, nn, d) float64
        Reference gradients of the displacement's shape functions.
    weights : ndarray, (nq,) float64
        Quadrature weights on the reference cell.
    grad : ndarray, (nc, nq, nn, d) float64
        Output: physical gradients [1/length].
    jxw : ndarray, (nc, nq) float64
        Output: weight times det J, negative in an inverted cell [length^d].

    Returns
    -------
    float
        The smallest det J met; infinite if there is no cell. Not positive: an inverted or degenerate cell.
    """
    if x.shape[2] == 2:
        return _gradients2(x, dgeo, dshape, weights, grad, jxw)
    return _gradients3(x, dgeo, dshape, weights, grad, jxw)


def cell_geometry(cell, x, geometry_degree, degree, xi, weights):
    """Gradients of shape functions, and volume weights, at points of cells.

    Parameters
    ----------
    cell : str
    x : ndarray, (nc, ng, d)
        Coordinates of the geometry nodes of each cell.
    geometry_degree, degree : int
        Degrees of the geometry and of the shape functions.
    xi, weights : ndarray, (nq, d), (nq,)
        Quadrature rule on the reference cell.

    Returns
    -------
    tuple of ndarray, ndarray, float
        ``grad``, ``jxw`` and the smallest det J of :func:`gradients`.
    """
    dgeo, dshape = (np.ascontiguousarray(shape_gradient(cell, one, xi)) for one in (geometry_degree, degree))
    grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
    return grad, jxw, gradients(np.ascontiguousarray(x), dgeo, dshape, weights, grad, jxw)


def facet_geometry(cell, x, local_facet, geometry_degree, degree, xi, weights):
    """Geometry of facets, and the parent cells' shape functions on them.

    Parameters
    ----------
    cell : str
        Parent cell, of dimension 2 or 3.
    x : ndarray, (nf, ng, d)
        Coordinates of the geometry nodes of each facet's parent cell.
    local_facet : ndarray, (nf,) int
        Local number of each facet in its parent cell.
    geometry_degree, degree : int
        Degree of the geometry and of the shape functions.
    xi : ndarray, (nq, d - 1)
        Quadrature points in the facets' reference domain.
    weights : ndarray, (nq,)
        Their weights.

    Returns
    -------
    FacetGeometry
        With n dA = det J J^{-T} N dA_ref for the normals and the surface element (Nanson's formula).
    """
    local_facet = np.ascontiguousarray(local_facet, dtype=np.int64)
    on_cell = facet_points(cell, xi).reshape(-1, CELLS[cell].dim)
    values = shape(cell, degree, on_cell)
    values = values.reshape(-1, len(weights), values.shape[1])[local_facet]
    return _facet_geometry(cell, x, local_facet, (geometry_degree, degree), (xi, weights), values)


def every_facet(cell, x, geometry_degree, degree, xi, weights):
    """Geometry of all facets of cells, cell after cell.

    Parameters
    ----------
    cell, geometry_degree, degree, xi, weights
        As for :func:`facet_geometry`.
    x : ndarray, (nc, ng, d)
        Coordinates of the geometry nodes of each cell.

    Returns
    -------
    FacetGeometry
        Of nc times the number of facets; `shape` is None: it is the same of all cells.
    """
    count = len(CELLS[cell].facets)
    local = np.tile(np.arange(count), len(x))
    return _facet_geometry(cell, np.repeat(x, count, axis=0), local, (geometry_degree, degree), (xi, weights), None)


def _facet_geometry(cell, x, local_facet, degrees, rule, values):
    """A :class:`FacetGeometry` of facets with the shape functions `values`."""
    x, (xi, weights) = np.ascontiguousarray(x, dtype=np.float64), rule
    weights = np.ascontiguousarray(weights, dtype=np.float64)
    dim, nf, nq = CELLS[cell].dim, len(x), len(weights)
    on_cell = facet_points(cell, xi).reshape(-1, dim)
    geo, dgeo = shape(cell, degrees[0], on_cell), shape_gradient(cell, degrees[0], on_cell)
    dshape = shape_gradient(cell, degrees[1], on_cell)
    out = np.empty((nf, nq, dim)), np.empty((nf, nq, dim)), np.empty((nf, nq)), np.empty((nf, nq, *dshape.shape[1:]))
    kernel = _facets2 if dim == 2 else _facets3
    kernel(x, local_facet, FacetTables(geo, dgeo, dshape, facet_area_vectors(cell), weights), FacetPoints(*out))
    return FacetGeometry(*out[:3], values, out[3])


@njit
def _inverse2(x, c, dgeo, q):
    """det J, and the entries of J^{-1} (row: reference coordinate) in their order, of cell c at table row q."""
    j00 = j01 = j10 = j11 = 0.0
    for a in range(x.shape[1]):
        x0, x1 = x[c, a, 0], x[c, a, 1]
        d0, d1 = dgeo[q, a, 0], dgeo[q, a, 1]
        j00 += x0 * d0
        j01 += x0 * d1
        j10 += x1 * d0
        j11 += x1 * d1
    det = j00 * j11 - j01 * j10
    return det, (j11 / det, -j01 / det, -j10 / det, j00 / det)


@njit
def _inverse3(x, c, dgeo, q):
    """det J, and the entries of J^{-1} (row: reference coordinate) in their order, of cell c at table row q."""
    j00 = j01 = j02 = j10 = j11 = j12 = j20 = j21 = j22 = 0.0
    for a in range(x.shape[1]):
        x0, x1, x2 = x[c, a, 0], x[c, a, 1], x[c, a, 2]
        d0, d1, d2 = dgeo[q, a, 0], dgeo[q, a, 1], dgeo[q, a, 2]
        j00 += x0 * d0
        j01 += x0 * d1
        j02 += x0 * d2
        j10 += x1 * d0
        j11 += x1 * d1
        j12 += x1 * d2
        j20 += x2 * d0
        j21 += x2 * d1
        j22 += x2 * d2
    c00, c01, c02 = j11 * j22 - j12 * j21, j12 * j20 - j10 * j22, j10 * j21 - j11 * j20
    det = j00 * c00 + j01 * c01 + j02 * c02
    return det, (
        c00 / det, (j02 * j21 - j01 * j22) / det, (j01 * j12 - j02 * j11) / det,
        c01 / det, (j00 * j22 - j02 * j20) / det, (j02 * j10 - j00 * j12) / det,
        c02 / det, (j01 * j20 - j00 * j21) / det, (j00 * j11 - j01 * j10) / det,
    )  # fmt: skip


@njit
def _push2(dshape, k, inverse, grad, c, q):
    """Physical gradients of table row k into grad[c, q]."""
    i00, i01, i10, i11 = inverse
    for a in range(dshape.shape[1]):
        d0, d1 = dshape[k, a, 0], dshape[k, a, 1]
        grad[c, q, a, 0] = d0 * i00 + d1 * i10
        grad[c, q, a, 1] = d0 * i01 + d1 * i11


@njit
def _push3(dshape, k, inverse, grad, c, q):
    """Physical gradients of table row k into grad[c, q]."""
    i00, i01, i02, i10, i11, i12, i20, i21, i22 = inverse
    for a in range(dshape.shape[1]):
        d0, d1, d2 = dshape[k, a, 0], dshape[k, a, 1], dshape[k, a, 2]
        grad[c, q, a, 0] = d0 * i00 + d1 * i10 + d2 * i20
        grad[c, q, a, 1] = d0 * i01 + d1 * i11 + d2 * i21
        grad[c, q, a, 2] = d0 * i02 + d1 * i12 + d2 * i22


@njit
def _gradients2(x, dgeo, dshape, weights, grad, jxw):
    smallest = np.inf
    for c in range(x.shape[0]):
        for q in range(weights.shape[0]):
            det, inverse = _inverse2(x, c, dgeo, q)
            _push2(dshape, q, inverse, grad, c, q)
            jxw[c, q] = weights[q] * det
            smallest = min(smallest, det)
    return smallest


@njit
def _gradients3(x, dgeo, dshape, weights, grad, jxw):
    smallest = np.inf
    for c in range(x.shape[0]):
        for q in range(weights.shape[0]):
            det, inverse = _inverse3(x, c, dgeo, q)
            _push3(dshape, q, inverse, grad, c, q)
            jxw[c, q] = weights[q] * det
            smallest = min(smallest, det)
    return smallest


@njit
def _facets2(x, local_facet, tables, out):
    """:class:`FacetPoints` in 2D."""
    geo, dgeo, dshape, area, weights = tables.geo, tables.dgeo, tables.dshape, tables.area, tables.weights
    points, normals, jxw, grad = out.points, out.normals, out.jxw, out.gradients
    nq = weights.shape[0]
    for c in range(x.shape[0]):
        facet = local_facet[c]
        for q in range(nq):
            k = facet * nq + q
            det, inverse = _inverse2(x, c, dgeo, k)
            _push2(dshape, k, inverse, grad, c, q)
            i00, i01, i10, i11 = inverse
            n0 = det * (i00 * area[facet, 0] + i10 * area[facet, 1])
            n1 = det * (i01 * area[facet, 0] + i11 * area[facet, 1])
            size = np.sqrt(n0 * n0 + n1 * n1)
            jxw[c, q] = weights[q] * size
            normals[c, q, 0] = n0 / size
            normals[c, q, 1] = n1 / size
            p0 = p1 = 0.0
            for a in range(x.shape[1]):
                p0 += geo[k, a] * x[c, a, 0]
                p1 += geo[k, a] * x[c, a, 1]
            points[c, q, 0] = p0
            points[c, q, 1] = p1


@njit
def _facets3(x, local_facet, tables, out):
    """:class:`FacetPoints` in 3D."""
    geo, dgeo, dshape, area, weights = tables.geo, tables.dgeo, tables.dshape, tables.area, tables.weights
    points, normals, jxw, grad = out.points, out.normals, out.jxw, out.gradients
    nq = weights.shape[0]
    for c in range(x.shape[0]):
        facet = local_facet[c]
        r0, r1, r2 = area[facet, 0], area[facet, 1], area[facet, 2]
        for q in range(nq):
            k = facet * nq + q
            det, inverse = _inverse3(x, c, dgeo, k)
            _push3(dshape, k, inverse, grad, c, q)
            i00, i01, i02, i10, i11, i12, i20, i21, i22 = inverse
            n0 = det * (i00 * r0 + i10 * r1 + i20 * r2)
            n1 = det * (i01 * r0 + i11 * r1 + i21 * r2)
            n2 = det * (i02 * r0 + i12 * r1 + i22 * r2)
            size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            jxw[c, q] = weights[q] * size
            normals[c, q, 0] = n0 / size
            normals[c, q, 1] = n1 / size
            normals[c, q, 2] = n2 / size
            p0 = p1 = p2 = 0.0
            for a in range(x.shape[1]):
                p0 += geo[k, a] * x[c, a, 0]
                p1 += geo[k, a] * x[c, a, 1]
                p2 += geo[k, a] * x[c, a, 2]
            points[c, q, 0] = p0
            points[c, q, 1] = p1
            points[c, q, 2] = p2
