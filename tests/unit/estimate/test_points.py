"""Sums over the nodes of cells at their points, against numpy."""

import numpy as np
import pytest

from pcontact.estimate.points import (
    INTERIOR,
    JUMPS,
    PARTS,
    Sides,
    add_at,
    add_work,
    of_nodes_on_normals,
    on_normals,
    slopes,
    stresses,
    weigh_facets,
)


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


@pytest.mark.parametrize("d", [2, 3])
def test_stresses_and_their_work(d):
    rng = np.random.default_rng(d)
    nc, nq, nn, lam, mu = 3, 4, 5, 1.3, 0.7
    u, grad, jxw = rng.normal(size=(nc, nn, d)), rng.normal(size=(nc, nq, nn, d)), rng.random((nc, nq))
    slope, out, work = np.einsum("cai,cqaj->cqij", u, grad), np.empty((nc, nq, d, d)), np.ones((nc, nn, d))
    stresses(u, grad, lam, mu, out)
    trace = np.trace(slope, axis1=2, axis2=3)
    assert out == pytest.approx(lam * trace[:, :, None, None] * np.eye(d) + mu * (slope + slope.swapaxes(2, 3)))
    add_work(out, grad, jxw, work)
    assert work == pytest.approx(1.0 - np.einsum("cq,cqij,cqbj->cbi", jxw, out, grad))


def test_tractions_of_both_sides():
    rng, (nc, nf, nq, nb, d) = np.random.default_rng(0), (3, 3, 2, 4, 2)
    values, jxw, share = rng.normal(size=(nf, nq, nb)), rng.random((nc, nf, nq)), rng.random((nc, nf))
    # the cells come after others, and have the other sides of their points among these, among themselves, or nowhere
    first, traction = 5, rng.normal(size=(nc, nf, nq, d))
    flux, other = rng.normal(size=(first + nc * nf * nq, d)), rng.permutation(first + nc * nf * nq)
    other[rng.random(len(other)) < 0.3] = -1
    out = np.zeros((nc, len(PARTS), nb, d))
    weigh_facets(values, jxw, Sides(traction, flux, other, share), first, out)
    there, share = (other[first:] >= 0).reshape(nc, nf, nq, 1), share[:, :, None, None]
    own, theirs = flux[first:].reshape(traction.shape), flux[other[first:]].reshape(traction.shape)
    jump = np.where(there, (1.0 - share) * own - share * theirs - traction, 0.0)
    assert out[:, INTERIOR] == pytest.approx(np.einsum("cfq,fqb,cfqi->cbi", jxw, values, traction))
    assert out[:, JUMPS] == pytest.approx(np.einsum("cfq,fqb,cfqi->cbi", jxw, values, jump))
    assert not np.delete(out, [INTERIOR, JUMPS], axis=1).any()


def test_what_points_add_to_their_cells():
    rng, rows = np.random.default_rng(1), np.array([2, 0, 2, 1])
    values, out = rng.normal(size=(4, 3, 2)), np.ones((3, len(PARTS), 3, 2))
    twin = out.copy()
    add_at(rows, JUMPS, values, out)
    np.add.at(twin, (rows, JUMPS), values)
    assert out == pytest.approx(twin)
