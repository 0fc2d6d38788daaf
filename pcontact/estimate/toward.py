"""Test functions on the cells around a vertex in the plane, for displacements that go like r^a there.

The local problems of cells know what the next degree adds. Of a displacement r^a, which no degree follows, that is
a part: around a clamped corner half of the squared error. Here s is the distance from the vertex, 0 there and 1 on the
opposite sides, and t goes from one side of a cell to the other; functions are

    1 - s   and   s^b (1 - s) l(t),   b of `POWERS`, l of Lagrange's polynomials of `ANGULAR` in t

They are zero on the opposite sides, and continuous from cell to cell: no traction between cells has to be known. The
vertex is the first corner of each cell; quadrilaterals are two triangles each.
"""

import functools

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes
from pcontact.estimate.local import factorise, solve
from pcontact.runtime.jit import njit

# exponents that together follow r^a with a between 0.4 and 2. From: clamped corners (0.76), of whose error around the
# vertex these find 0.97 to 0.98, 0.5 and 1.5 alone 0.95 to 0.96, these and 2 with a higher degree in t 0.98 to 0.99
POWERS = (0.5, 1.0, 1.5)
# degree in t, even for one cell of 90 degrees. From: degree 2 finds 0.90 of the squared error there, 3 and 4 0.98
ANGULAR = 3
# of functions on a cell: the one that is 1 at the vertex, then for each power those of t from side to side
NUMBER = 1 + len(POWERS) * (ANGULAR + 1)
# points of the rule in s and in t: as many as straight cells need
POINTS = {"triangle": (5, 4), "quadrilateral": (7, 6)}


def n_halves(cell):
    """Into how many triangles that meet in the first corner a cell is divided: a quadrilateral into two."""
    return CELLS[cell].n_vertices - 2


def sides(cell, half):
    """Facets of a cell among the two sides of one of its triangles at the vertex.

    Returns
    -------
    list of (int, int)
        Side, 0 where t is 0 and 1 where it is 1, and facet: the first one, which begins at the vertex, or the last one,
        which ends there.
    """
    last = len(CELLS[cell].facets) - 1
    return [(0, 0)] * (half == 0) + [(1, last)] * (half == n_halves(cell) - 1)


def _map(cell, half):
    """Vertex (2,) and slopes (2, 2) of the reference triangle's map onto one of the triangles of a reference cell."""
    corners = reference_nodes(cell, 1)
    return corners[0], np.column_stack([corners[1 + half] - corners[0], corners[2 + half] - corners[0]])


@functools.cache
def _triangle_rule(cell):
    """Gauss's rule in sqrt(s) and t on the reference triangle: points (n, 2), weights (n,)."""
    (root, radial), (t, across) = map(_gauss, POINTS[cell])
    s, t = (one.ravel() for one in np.meshgrid(root**2, t, indexing="ij"))
    # the area of the triangle is s ds dt, and ds = 2 sqrt(s) d sqrt(s)
    return np.column_stack([s * (1.0 - t), s * t]), np.outer(2.0 * root**3 * radial, across).ravel()


@functools.cache
def rule(cell, half=0):
    """Quadrature of products of gradients on one of the triangles of a cell; not to be changed.

    Returns
    -------
    xi : ndarray (n, 2)
        Reference points of the cell.
    weights : ndarray (n,)
    """
    (xi, weights), (vertex, slopes) = _triangle_rule(cell), _map(cell, half)
    return vertex + xi @ slopes.T, np.linalg.det(slopes) * weights


@functools.cache
def inside(cell, half):
    """The functions at the points of :func:`rule`: values (n, NUMBER), and gradients (n, NUMBER, 2) in the reference
    coordinates of the cell; not to be changed."""
    values, gradients = toward(_triangle_rule(cell)[0])
    return values, np.ascontiguousarray(gradients @ np.linalg.inv(_map(cell, half)[1]))


@functools.cache
def side_rule(side):
    """The same in s alone, on a facet that is a side: points (n, 1) between -1 and 1, weights (n,), and the functions
    (n, NUMBER); not to be changed."""
    root, weights = _gauss(2 * ANGULAR + 1)
    s, zero = root**2, np.zeros_like(root)
    points = (2.0 * s - 1.0) * (1.0 if side == 0 else -1.0)
    values = toward(np.column_stack([s, zero] if side == 0 else [zero, s]))[0]
    return points[:, None], 4.0 * root * weights, values


def toward(xi):
    """The functions on one triangle, whose first corner is the vertex.

    Parameters
    ----------
    xi : ndarray (n, 2)
        Its reference points, none of them the vertex.

    Returns
    -------
    values : ndarray (n, NUMBER)
    gradients : ndarray (n, NUMBER, 2)
        In reference coordinates.
    """
    xi = np.asarray(xi, dtype=float)
    s = xi.sum(axis=1)
    t = xi[:, 1] / s
    across, slope = _lagrange(t)
    # derivatives in s, and those in t over s
    values, along, around = [1.0 - s], [-np.ones_like(s)], [np.zeros_like(s)]
    for power in POWERS:
        for k in range(ANGULAR + 1):
            values.append(s**power * (1.0 - s) * across[:, k])
            along.append((power * s ** (power - 1.0) * (1.0 - s) - s**power) * across[:, k])
            around.append(s ** (power - 1.0) * (1.0 - s) * slope[:, k])
    values, along, around = (np.stack(some, axis=1) for some in (values, along, around))
    gradients = np.stack([along - t[:, None] * around, along + (1.0 - t)[:, None] * around], axis=2)
    return values, np.ascontiguousarray(gradients)


def held(vertex, on_sides):
    """Flags of the functions that are held, where a vertex and the sides of a cell are.

    Parameters
    ----------
    vertex : ndarray (n, d) of bool
    on_sides : ndarray (n, 2, d) of bool
        Of the side on which t is 0, and of that on which it is 1.

    Returns
    -------
    ndarray (n, NUMBER, d) of bool
    """
    n, d = vertex.shape
    found = np.zeros((n, len(POWERS), ANGULAR + 1, d), dtype=bool)
    found[:, :, 0], found[:, :, -1] = on_sides[:, None, 0], on_sides[:, None, 1]
    return np.concatenate([vertex[:, None], found.reshape(n, -1, d)], axis=1)


@njit
def patches(first, ends, stiffness, bound, loads, fixed, out):
    """Energies of the problems on the cells around vertices.

    Parameters
    ----------
    first : ndarray (n + 1,) of int
        Where the cells of each vertex begin.
    ends : ndarray (nc, 2) of int
        Nodes at the other ends of the two sides of each: those with a common side have functions in common.
    stiffness : ndarray (nc, m, m)
        Of elasticity, for the functions of :func:`toward` and directions [force / length].
    bound : ndarray (nc, m, m)
        What springs add.
    loads : ndarray (nc, m)
        Residual, tested [force].
    fixed : ndarray (nc, m) of bool
        What is held on one of the cells is so on all.
    out : ndarray (nc,)
        Output [energy]: in each cell, without that of springs.
    """
    d, powers, inside = loads.shape[1] // NUMBER, len(POWERS), ANGULAR - 1
    for v in range(len(first) - 1):
        low, n, sides = first[v], first[v + 1] - first[v], 0
        names, place = np.empty(2 * n, dtype=np.int64), np.empty((n, NUMBER), dtype=np.int64)
        for c in range(n):
            place[c, 0] = 0
            for k in range(2):
                side = 0
                while side < sides and names[side] != ends[low + c, k]:
                    side += 1
                if side == sides:
                    names[side] = ends[low + c, k]
                    sides += 1
                for p in range(powers):
                    place[c, 1 + p * (ANGULAR + 1) + k * ANGULAR] = 1 + side * powers + p
        for c in range(n):
            for p in range(powers):
                for j in range(inside):
                    place[c, 2 + p * (ANGULAR + 1) + j] = 1 + sides * powers + (c * powers + p) * inside + j
        size = d * (1 + sides * powers + n * powers * inside)
        matrix, vector, free = np.zeros((size, size)), np.zeros(size), np.ones(size)
        for c in range(n):
            for a in range(loads.shape[1]):
                row = d * place[c, a // d] + a % d
                vector[row] += loads[low + c, a]
                if fixed[low + c, a]:
                    free[row] = 0.0
                for b in range(loads.shape[1]):
                    column = d * place[c, b // d] + b % d
                    matrix[row, column] += stiffness[low + c, a, b] + bound[low + c, a, b]
        for row in range(size):
            if free[row] == 0.0:
                matrix[row, :] = 0.0
                matrix[:, row] = 0.0
                matrix[row, row] = 1.0
                vector[row] = 0.0
        factorise(matrix)
        solve(matrix, vector)
        for c in range(n):
            total = 0.0
            for a in range(loads.shape[1]):
                left = vector[d * place[c, a // d] + a % d]
                for b in range(loads.shape[1]):
                    total += left * stiffness[low + c, a, b] * vector[d * place[c, b // d] + b % d]
            out[low + c] = total


def _gauss(n):
    """Points and weights on the interval from 0 to 1."""
    points, weights = np.polynomial.legendre.leggauss(n)
    return 0.5 * (points + 1.0), 0.5 * weights


@functools.cache
def _coefficients():
    return np.linalg.inv(np.vander(np.linspace(0.0, 1.0, ANGULAR + 1), increasing=True))


def _lagrange(t):
    """Lagrange's polynomials (n, ANGULAR + 1) and their derivatives."""
    powers = np.vander(t, ANGULAR + 1, increasing=True)
    slopes = np.zeros_like(powers)
    slopes[:, 1:] = powers[:, :-1] * np.arange(1, ANGULAR + 1)
    return powers @ _coefficients(), slopes @ _coefficients()
