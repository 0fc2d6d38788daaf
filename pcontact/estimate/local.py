"""The local problems: elasticity of one cell at a time, small dense systems, all cells of a block in one call."""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.strains import fill_operator, pull, square
from pcontact.runtime.jit import njit


class LocalFunctions(NamedTuple):
    """Test functions of the local problems of nc cells, at nq points each.

    Attributes
    ----------
    grad : ndarray (nc, nq, nb, d)
        Physical gradients [1/length].
    ring : ndarray (nc, nq, nb), or (0, 0, 0)
        Test functions over radius with axial symmetry [1/length].
    jxw : ndarray (nc, nq)
        Weights of the points, see `pcontact.assembly.geometry.chunks`.
    basis : ndarray (nc, nq, n)
        Of the mean dilatation, see `pcontact.element.dilatation.components`; not looked at where that does not count.
    """

    grad: np.ndarray
    ring: np.ndarray
    jxw: np.ndarray
    basis: np.ndarray


# of isotropic bodies
NO_REST = np.zeros((0, 0, 0))


class Moduli(NamedTuple):
    """Moduli of the cells of a block [stress].

    Attributes
    ----------
    own, shared : float
        Factors of the dilatation and of its mean, see `pcontact.element.dilatation.factors`.
    mu : float
        Shear modulus.
    rest : ndarray (k, m, m)
        What an orthotropic stiffness differs by, Mandel components: k = 0 of an isotropic body, 1 where it is the same
        everywhere, else of each of the nc nq points.
    """

    own: float
    shared: float
    mu: float
    rest: np.ndarray = NO_REST


class Bound(NamedTuple):
    """Addend of springs to the ground to the stiffness of some cells.

    Attributes
    ----------
    at : ndarray (nc,) of int
        Row of each cell in ``matrices``, -1 where there is none.
    matrices : ndarray (k, n, n)
    """

    at: np.ndarray
    matrices: np.ndarray


@njit
def _add_bound(bound, c, out):
    """Add them to the stiffness (n, n) of cell c."""
    if bound.at[c] >= 0:
        out += bound.matrices[bound.at[c]]


@njit
def _assemble(functions, c, moduli, out):
    """Stiffness (n, n) of cell c for the test functions; the lower triangle is enough."""
    grad, ring, jxw, basis = functions.grad, functions.ring, functions.jxw, functions.basis
    lam, shared, mu = moduli.own, moduli.shared, moduli.mu
    nq, nb, d = grad.shape[1], grad.shape[2], grad.shape[3]
    out[:, :] = 0.0
    if shared != 0.0:
        for k in range(basis.shape[2]):
            _add_mean(functions, c, shared, basis[c, :, k], out)
    for q in range(nq):
        w = jxw[c, q]
        for a in range(nb):
            hoop_a = ring[c, q, a] if ring.shape[0] else 0.0
            for b in range(a + 1):
                hoop_b = ring[c, q, b] if ring.shape[0] else 0.0
                dot = 0.0
                for i in range(d):
                    dot += grad[c, q, a, i] * grad[c, q, b, i]
                for i in range(d):
                    left = grad[c, q, a, i] + (hoop_a if i == 0 else 0.0)
                    for j in range(d):
                        right = grad[c, q, b, j] + (hoop_b if j == 0 else 0.0)
                        value = lam * left * right + mu * grad[c, q, a, j] * grad[c, q, b, i]
                        if i == j:
                            value += mu * dot
                        if i == 0 and j == 0:
                            value += 2.0 * mu * hoop_a * hoop_b
                        out[a * d + i, b * d + j] += w * value
    if moduli.rest.shape[0]:
        _add_rest(functions, c, moduli.rest, out)


@njit
def _add_rest(functions, c, rest, out):
    """Add the energy of what an orthotropic stiffness differs by to the stiffness (n, n) of cell c."""
    grad, jxw, m = functions.grad, functions.jxw, rest.shape[1]
    nq, nb, d = grad.shape[1], grad.shape[2], grad.shape[3]
    operator, pulled = np.zeros((m, nb, d)), np.zeros((m, nb * d))
    flat = operator.reshape(m, nb * d)
    for q in range(nq):
        fill_operator(functions, c, q, operator)
        pull(rest[c * nq + q if len(rest) > 1 else 0], flat, jxw[c, q], pulled)
        square(flat, pulled, out)


@njit
def _add_mean(functions, c, shared, weight, out):
    """Add the energy of one component, of values ``weight`` (nq,), of the mean dilatation of cell c."""
    grad, ring, jxw = functions.grad, functions.ring, functions.jxw
    nq, nb, d = grad.shape[1], grad.shape[2], grad.shape[3]
    mean, volume = np.zeros(nb * d), 0.0
    for q in range(nq):
        volume += jxw[c, q]
        w = jxw[c, q] * weight[q]
        for a in range(nb):
            for i in range(d):
                mean[a * d + i] += w * grad[c, q, a, i]
            if ring.shape[0]:
                mean[a * d] += w * ring[c, q, a]
    for a in range(nb * d):
        for b in range(nb * d):
            out[a, b] += shared / volume * mean[a] * mean[b]


@njit
def _soften(functions, c, softening, out):
    """Take away from the stiffness (n, n) of cell c what yielding does, see `pcontact.estimate.stress`."""
    grad, jxw, moduli = functions.grad, functions.jxw, softening.moduli
    m, nb, d = moduli.shape[0], grad.shape[2], grad.shape[3]
    operator, pulled = np.zeros((m, nb, d)), np.zeros((m, nb * d))
    flat = operator.reshape(m, nb * d)
    for q in range(grad.shape[1]):
        part = softening.part[c, softening.near[q]]
        if part != 0.0:
            fill_operator(functions, c, q, operator)
            pull(moduli, flat, -part * jxw[c, q], pulled)
            square(flat, pulled, out)


@njit
def factorise(a):
    """Cholesky factor of the lower triangle, in place."""
    n = a.shape[0]
    for j in range(n):
        s = a[j, j]
        for k in range(j):
            s -= a[j, k] * a[j, k]
        a[j, j] = np.sqrt(s)
        for i in range(j + 1, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s / a[j, j]


@njit
def _square(a, b):
    """b . A^-1 b from the Cholesky factor of A; b is overwritten."""
    total = 0.0
    for i in range(a.shape[0]):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]
        total += b[i] * b[i]
    return total


@njit
def _forward(a, b):
    """L^-1 b from the Cholesky factor L, in place."""
    for i in range(a.shape[0]):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]


@njit
def solve(a, b):
    """A^-1 b from the Cholesky factor of A, in place."""
    n = a.shape[0]
    _forward(a, b)
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= a[k, i] * b[k]
        b[i] = s / a[i, i]


@njit
def _square_in(stiffness, a, b):
    """e . K e with the lower triangle of the stiffness K and e = A^-1 b from the Cholesky factor of A; b becomes e."""
    n, total = a.shape[0], 0.0
    solve(a, b)
    for i in range(n):
        total += stiffness[i, i] * b[i] * b[i]
        for k in range(i):
            total += 2.0 * stiffness[i, k] * b[i] * b[k]
    return total


@njit
def _without(matrix, fixed, c, d):
    """Take the components that supports hold out of the stiffness of cell c."""
    for a in range(fixed.shape[1]):
        for i in range(d):
            if fixed[c, a, i]:
                row = a * d + i
                matrix[row, :] = 0.0
                matrix[:, row] = 0.0
                matrix[row, row] = 1.0


@njit
def products(functions, moduli, softening, bound, loads, others, fixed, out):
    """Energy products of the solutions of two local problems on every cell, and energies of the second one.

    Parameters
    ----------
    functions, moduli, softening, bound, fixed
        As for :func:`energies`.
    loads, others : ndarray (nc, nb, d)
        Their right-hand sides [force].
    out : ndarray (nc, 2)
        Output [energy].
    """
    nc, nb, d = loads.shape
    n = nb * d
    matrix, first, second = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for c in range(nc):
        _assemble(functions, c, moduli, matrix)
        if softening.part[c].any():
            _soften(functions, c, softening, matrix)
        _add_bound(bound, c, matrix)
        _without(matrix, fixed, c, d)
        factorise(matrix)
        for a in range(nb):
            for i in range(d):
                free = 0.0 if fixed[c, a, i] else 1.0
                first[a * d + i], second[a * d + i] = free * loads[c, a, i], free * others[c, a, i]
        _forward(matrix, first)
        _forward(matrix, second)
        out[c] = 0.0
        for i in range(n):
            out[c, 0] += first[i] * second[i]
            out[c, 1] += second[i] ** 2


@njit
def energies(functions, moduli, softening, bound, loads, fixed, out):
    """Squared energy norms of the solutions of the cells' local problems.

    Find e with  int sigma(e) : eps(v) = load(v)  for all test functions v of the cell. Where the cell has yielded sigma
    is softer than that of elasticity; the energy is always that of elasticity, without that of springs.

    Parameters
    ----------
    functions : LocalFunctions
    moduli : Moduli
    softening : pcontact.estimate.stress.Softening
    bound : Bound
    loads : ndarray (nc, n_parts, nb, d)
        Residual of each kind, tested [force].
    fixed : ndarray (nc, nb, d) of bool
        Components that supports hold.
    out : ndarray (nc, n_parts + 1)
        Output [energy]: of each kind alone, and last of their sum.
    """
    nc, parts, nb, d = loads.shape
    n = nb * d
    matrix, elastic, vector = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    for c in range(nc):
        _assemble(functions, c, moduli, matrix)
        softer = softening.part[c].any()
        other = softer or bound.at[c] >= 0
        if other:
            for i in range(n):
                for j in range(n):
                    elastic[i, j] = matrix[i, j]
        if softer:
            _soften(functions, c, softening, matrix)
        _add_bound(bound, c, matrix)
        _without(matrix, fixed, c, d)
        factorise(matrix)
        for part in range(parts + 1):
            loaded = False
            for a in range(nb):
                for i in range(d):
                    value = 0.0
                    if not fixed[c, a, i]:
                        if part < parts:
                            value = loads[c, part, a, i]
                        else:
                            for k in range(parts):
                                value += loads[c, k, a, i]
                    vector[a * d + i] = value
                    loaded |= value != 0.0
            # most cells have no facet on the boundary
            out[c, part] = 0.0
            if not loaded:
                continue
            out[c, part] = _square_in(elastic, matrix, vector) if other else _square(matrix, vector)
