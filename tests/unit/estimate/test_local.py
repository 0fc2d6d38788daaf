"""Local problems on cells."""

import numpy as np
import pytest

from pcontact.estimate.local import LocalFunctions, Moduli, energies
from tests.support.small import elasticity


@pytest.mark.parametrize("dim, hoop", [(2, False), (2, True), (3, False)])
@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_local_problems(dim, hoop, shared):
    """The kernel against dense matrices."""
    rng = np.random.default_rng(2)
    nc, nq, nb, parts, lam, mu = 2, 7, 3, 2, 1.7, 0.6
    grad, jxw = rng.normal(size=(nc, nq, nb, dim)), rng.uniform(0.5, 1.0, (nc, nq))
    ring = rng.normal(size=(nc, nq, nb)) if hoop else np.zeros((0, 0, 0))
    loads = rng.normal(size=(nc, parts, nb, dim))
    fixed = np.zeros((nc, nb, dim), dtype=bool)
    fixed[1, 2, 0] = fixed[0, 0, 1] = True
    out = np.empty((nc, parts + 1))
    basis = rng.normal(size=(nc, nq, 2))
    energies(LocalFunctions(grad, ring, jxw, basis), Moduli(lam, shared, mu), loads, fixed, out)
    c4 = elasticity(lam, mu, 3)
    for c in range(nc):
        full = np.zeros((nq, nb, dim, 3, 3))
        for i in range(dim):
            full[:, :, i, i, :dim] = grad[c]
        if hoop:
            full[:, :, 0, 2, 2] = ring[c]
        matrix = np.einsum("q,qaimn,mnkl,qbjkl->aibj", jxw[c], full, c4, full).reshape(nb * dim, nb * dim)
        for mode in basis[c].T:
            mean = np.einsum("q,q,qaikk->ai", jxw[c], mode, full).ravel()
            matrix += shared / jxw[c].sum() * np.outer(mean, mean)
        free = ~fixed[c].ravel()
        for k, b in enumerate([*loads[c], loads[c].sum(axis=0)]):
            b = b.ravel()[free]
            expected = b @ np.linalg.solve(matrix[np.ix_(free, free)], b)
            assert out[c, k] == pytest.approx(expected, rel=1e-9)
