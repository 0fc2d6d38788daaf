"""Local problems on cells."""

import numpy as np
import pytest

from pcontact.estimate.local import Bound, LocalFunctions, Moduli, energies, products
from pcontact.estimate.stress import Softening
from tests.support.small import elasticity

# places of Mandel components
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def in_mandel(full, m):
    """Strain operators (nq, n, 3, 3) in Mandel components (nq, m, n)."""
    symmetric = 0.5 * (full + full.swapaxes(2, 3))
    return np.stack([symmetric[:, :, i, j] * (1.0 if i == j else np.sqrt(2.0)) for i, j in PLACES[:m]], axis=1)


@pytest.mark.parametrize("dim, hoop", [(2, False), (2, True), (3, False)])
@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_local_problems(dim, hoop, shared):
    """The kernels against dense matrices, one cell softened, which the energy does not see."""
    rng = np.random.default_rng(2)
    nc, nq, nb, parts, lam, mu = 2, 7, 3, 2, 1.7, 0.6
    grad, jxw = rng.normal(size=(nc, nq, nb, dim)), rng.uniform(0.5, 1.0, (nc, nq))
    ring = rng.normal(size=(nc, nq, nb)) if hoop else np.zeros((0, 0, 0))
    loads = rng.normal(size=(nc, parts, nb, dim))
    fixed = np.zeros((nc, nb, dim), dtype=bool)
    fixed[1, 2, 0] = fixed[0, 0, 1] = True
    out, work = np.empty((nc, parts + 1)), np.empty((nc, 2))
    basis, m = rng.normal(size=(nc, nq, 2)), 6 if dim == 3 else 4
    flow = rng.normal(size=m)
    flow /= np.linalg.norm(flow)
    softer = Softening(np.array([[0.0, 0.0], [0.9, 0.3]]), 1.1 * np.outer(flow, flow), np.arange(nq) % 2)
    rest = rng.normal(size=(nc * nq, m, m))
    rest = 0.1 * (rest + rest.transpose(0, 2, 1))
    functions, moduli = LocalFunctions(grad, ring, jxw, basis), Moduli(lam, shared, mu, rest)
    held = rng.normal(size=(nb * dim, nb * dim))
    bound = Bound(np.array([0, -1]), (held @ held.T)[None])
    energies(functions, moduli, softer, bound, loads, fixed, out)
    products(functions, moduli, softer, bound, loads[:, 0], loads[:, 1], fixed, work)
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
        free = np.flatnonzero(~fixed[c].ravel())
        energy = matrix[np.ix_(free, free)]
        operator = in_mandel(full.reshape(nq, nb * dim, 3, 3), m)
        energy += np.einsum("q,qmi,qmn,qnj->ij", jxw[c], operator, rest[c * nq : c * nq + nq], operator)[
            np.ix_(free, free)]  # fmt: skip
        part = jxw[c] * softer.part[c, softer.near]
        taken = np.einsum("q,qmi,mn,qnj->ij", part, operator, softer.moduli, operator)
        stiffness = energy - taken[np.ix_(free, free)]
        if bound.at[c] >= 0:
            stiffness += bound.matrices[bound.at[c]][np.ix_(free, free)]
        assert np.linalg.eigvalsh(stiffness)[0] > 0.0
        right = [b.ravel()[free] for b in [*loads[c], loads[c].sum(axis=0)]]
        for k, b in enumerate(right):
            e = np.linalg.solve(stiffness, b)
            assert out[c, k] == pytest.approx(e @ energy @ e, rel=1e-9)
        answer = np.linalg.solve(stiffness, right[1])
        assert work[c] == pytest.approx([right[0] @ answer, right[1] @ answer], rel=1e-9)
