"""Sums over the nodes of cells at their points, against numpy."""

import numpy as np
import pytest

from pcontact.estimate.points import of_nodes_on_normals, on_normals, slopes


@pytest.mark.parametrize("d", [2, 3])
def test_twins(d):
    rng = np.random.default_rng(d)
    nc, nq, nn = 5, 4, 6
    u, grad, values = rng.normal(size=(nc, nn, d)), rng.normal(size=(nc, nq, nn, d)), rng.normal(size=(nq, nn))
    stress, nodal, normals = (rng.normal(size=(nc, *own, d)) for own in ((nq, d), (nn, d), (nq,)))
    slope, traction, flux = np.empty((nc, nq, d, d)), np.empty((nc, 2, nq, d)), np.empty((nc, nq, d))
    slopes(u, grad, slope)
    on_normals(stress, normals, traction[:, 1])
    of_nodes_on_normals(values, nodal, normals, flux)
    assert slope == pytest.approx(np.einsum("cai,cqaj->cqij", u, grad))
    assert traction[:, 1] == pytest.approx(np.einsum("cqij,cqj->cqi", stress, normals))
    assert flux == pytest.approx(np.einsum("qa,caij,cqj->cqi", values, nodal, normals))
