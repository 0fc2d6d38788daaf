"""Quadrature rules with positive weights and interior points on the reference cells.

Reduced integration of serendipity cells: the strain is the one that 2 points in each direction have.

Integrals are taken at these points alone, and at any other point of the cell the displacement's gradient counts as the
product of linear functions that it is at these points. So displacements of a cell that have no energy have no traction
on its facets either, and the trace inequality of Nitsche's method holds.
"""

import functools
import itertools
import math

import numpy as np

from pcontact.element.geometry import cell_geometry
from pcontact.element.reference import CELLS, shape

MAX_DEGREE = 20

# Symmetric rules: lists of (weight, barycentric coordinates), weights summing to 1. Every distinct permutation
# of the coordinates is taken: how the vertices of a cell are numbered does not matter.
# Triangle: Dunavant (1985), degree 7 with three orbits of three points and one of six. Tetrahedron: degrees 3 and 6
# after Keast (1986), degree 5 Walkington. Every constant is converged by Newton's method on the moment equations.
_R15 = np.sqrt(15.0)
# degree of the quadrature with 2 points in each direction
DEGREE = 3


def _one(n, weight, a):
    """Orbit of points with n - 1 equal barycentric coordinates."""
    return (weight, (1.0 - (n - 1) * a, *([a] * (n - 1))))


_TRIANGLE = {
    1: [(1.0, (1 / 3, 1 / 3, 1 / 3))],
    2: [_one(3, 1 / 3, 1 / 6)],
    4: [_one(3, 0.22338158967801125, 0.44594849091596483), _one(3, 0.1099517436553221, 0.09157621350977092)],
    5: [
        (0.225, (1 / 3, 1 / 3, 1 / 3)),
        _one(3, (155 - _R15) / 1200, (6 - _R15) / 21),
        _one(3, (155 + _R15) / 1200, (6 + _R15) / 21),
    ],
    6: [
        _one(3, 0.05084490637021571, 0.06308901449150836),
        _one(3, 0.1167862757264309, 0.2492867451708791),
        (0.08285107561834334, (0.3103524510338078, 0.053145049844795664, 0.6365024991213966)),
    ],
    7: [
        _one(3, 0.04715600514349066, 0.4094713422581646),
        _one(3, 0.09763810265670875, 0.22788309864669554),
        _one(3, 0.05197404546118128, 0.06422241176499403),
        (0.06828259003597636, (0.042796248611059254, 0.3126108972721635, 0.64459285411677725)),
    ],
    8: [
        (0.14431560767779836, (1 / 3, 1 / 3, 1 / 3)),
        _one(3, 0.09509163426727682, 0.45929258829273095),
        _one(3, 0.10321737053471484, 0.17056930775176965),
        _one(3, 0.032458497623196664, 0.05054722831703029),
        (0.02723031417443944, (0.2631128296346092, 0.008394777409972395, 0.7284923929554184)),
    ],
    9: [
        (0.09713579628281867, (1 / 3, 1 / 3, 1 / 3)),
        _one(3, 0.07964773892721139, 0.1882035356190345),
        _one(3, 0.03133470022712661, 0.48968251919874406),
        _one(3, 0.025577675658697858, 0.04472951339445263),
        _one(3, 0.07782754100477829, 0.437089591492948),
        (0.04328353937728984, (0.03683841205473686, 0.22196298916076515, 0.74119859878449799)),
    ],
}
_TETRAHEDRON = {
    1: [(1.0, (0.25, 0.25, 0.25, 0.25))],
    2: [_one(4, 0.25, (5 - np.sqrt(5.0)) / 20)],
    3: [_one(4, 0.1385132693219899, 0.32805535118603213), _one(4, 0.11148673067801011, 0.10695933936074394)],
    5: [
        _one(4, 0.1126879257180165, 0.3108859192633005),
        _one(4, 0.07349304311636223, 0.09273525031089137),
        (
            0.04254602077708088,
            (0.04550370412564878, 0.04550370412564878, 0.45449629587435122, 0.45449629587435122),
        ),
    ],
    6: [
        _one(4, 0.03992275025815924, 0.2146028712591755),
        _one(4, 0.010077211055319588, 0.04067395853460774),
        _one(4, 0.05535718154365374, 0.32233789014227576),
        (
            0.048214285714289144,
            (0.06366100187502023, 0.06366100187502023, 0.2696723314583138, 0.60300566479164574),
        ),
    ],
}
_SYMMETRIC = {"triangle": _TRIANGLE, "tetrahedron": _TETRAHEDRON}


def quadrature(cell, degree):
    """Quadrature rule on a reference cell.

    Parameters
    ----------
    cell : str
        Key in `pcontact.element.reference.CELLS`, also "segment".
    degree : int
        0 to 20. Polynomials are integrated exactly up to this total degree on simplices, up to this degree in
        each direction on tensor cells. On wedges up to this total degree in the triangle, times this degree along
        the axis; on pyramids up to this degree in each of x / (1 - z), y / (1 - z) and z.

    Returns
    -------
    points : ndarray, (n, dim) float64
        Strictly inside the cell; on tensor cells the first coordinate runs fastest, on wedges and pyramids those across
        the axis.
    weights : ndarray, (n,) float64
        Positive, with the volume of the reference cell as their sum.

    Raises
    ------
    ValueError
        If the degree is out of range.
    """
    points, weights = _rule(cell, degree)
    # callers may change theirs
    return points.copy(), weights.copy()


@functools.cache
def _rule(cell, degree):
    """See :func:`quadrature`; made once."""
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"quadrature degree {degree}: allowed are 0 to {MAX_DEGREE}")
    if CELLS[cell].is_tensor:
        return _tensor(CELLS[cell].dim, degree)
    if CELLS[cell].is_wedge:
        return _layers(*quadrature("triangle", degree), *_gauss_jacobi(degree // 2 + 1, 0))
    if CELLS[cell].is_pyramid:
        x, w = _gauss_jacobi(degree // 2 + 1, 2)
        # dV = (1 - z)^2 du dv dz with u = x / (1 - z), v = y / (1 - z); from [-1, 1] to [0, 1]: a factor of 1/8
        points, weights = _layers(*_tensor(2, degree), 0.5 * (x + 1.0), w / 8.0)
        points[:, :2] *= 1.0 - points[:, 2:]
        return points, weights
    known = [d for d in _SYMMETRIC[cell] if d >= degree]
    if known:
        return _symmetric(_SYMMETRIC[cell][min(known)])
    if cell == "triangle":
        return _around_centroid(*_collapsed(2, degree))
    return _collapsed(CELLS[cell].dim, degree)


def _around_centroid(points, weights):
    """A rule folded onto the triangle, with the fold in the centroid, in each of three parts: a symmetric rule."""
    top, others = points[:, 0], np.column_stack([1.0 - points.sum(axis=1), points[:, 1]])
    bary = [(top / 3.0)[:, None] + others @ np.eye(3)[[i, (i + 1) % 3]] for i in range(3)]
    return np.concatenate(bary)[:, 1:].copy(), np.tile(weights / 3.0, 3)


def _tensor(dim, degree):
    x, w = _gauss_jacobi(degree // 2 + 1, 0)
    grids = np.meshgrid(*[x] * dim, indexing="ij")[::-1]
    weights = np.prod(np.meshgrid(*[w] * dim, indexing="ij"), axis=0)
    return np.stack([g.ravel() for g in grids], axis=1), weights.ravel()


def _layers(points, weights, heights, along):
    """A rule of the plane (n, 2) at several heights."""
    repeated = np.repeat(heights, len(points))[:, None]
    return np.hstack([np.tile(points, (len(heights), 1)), repeated]), np.outer(along, weights).ravel()


def _symmetric(orbits):
    bary, weights = [], []
    for weight, point in orbits:
        images = sorted(set(itertools.permutations(point)))
        bary += images
        weights += [weight] * len(images)
    points = np.array(bary)[:, 1:].copy()
    weights = np.array(weights)
    return points, weights / (weights.sum() * math.factorial(points.shape[1]))


def _collapsed(dim, degree):
    """Gauss rule of the cube folded onto the simplex; the Jacobian (1 - u)^k is the Gauss-Jacobi weight."""
    n = degree // 2 + 1
    rules = [_gauss_jacobi(n, dim - 1 - k) for k in range(dim)]
    # from [-1, 1] to [0, 1]: du (1 - u)^alpha = dx (1 - x)^alpha / 2^(alpha + 1)
    u = np.meshgrid(*[(x + 1.0) / 2.0 for x, _ in rules], indexing="ij")
    w = np.prod(np.meshgrid(*[w / 2.0 ** (dim - k) for k, (_, w) in enumerate(rules)], indexing="ij"), axis=0)
    points, left = [], np.ones_like(u[0])
    for coordinate in u:
        points.append((left * coordinate).ravel())
        left = left * (1.0 - coordinate)
    return np.stack(points, axis=1), w.ravel()


def _gauss_jacobi(n, alpha):
    """n-point Gauss rule on [-1, 1] for the weight (1 - x)^alpha, by the eigenvalues of the Jacobi matrix.

    Golub and Welsch (1969).
    """
    if alpha == 0:
        return np.polynomial.legendre.leggauss(n)
    k = np.arange(n, dtype=float)
    diagonal = -(alpha**2) / ((2 * k + alpha) * (2 * k + alpha + 2))
    k = k[1:]
    square = 4 * k**2 * (k + alpha) ** 2 / ((2 * k + alpha) ** 2 * (2 * k + alpha + 1) * (2 * k + alpha - 1))
    off = np.sqrt(square)
    points, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off, 1) + np.diag(off, -1))
    return points, vectors[0] ** 2 * 2.0 ** (alpha + 1) / (alpha + 1)


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
    grad, *_ = cell_geometry(cell, x, geometry_degree, 2, points, weights)
    nc, n, d = xi.shape
    share = from_points(cell, xi.reshape(nc * n, d)).reshape(nc, n, len(points))
    return np.matmul(share, grad.reshape(nc, len(points), -1)).reshape(nc, n, -1, d)
