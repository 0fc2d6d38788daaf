"""Kernels of cells with finite strain: the first Piola-Kirchhoff stress of a cell, and its derivative."""

import numpy as np
import pytest

from pcontact.assembly.finite_kernels import acoustic, begin_cell, cell_piola, cell_work, point_of_cell
from pcontact.material.finite import CONSISTENT, ELASTIC, STRESS
from tests.support.finite import (
    LAM,
    LAWS,
    MU,
    deformed,
    finite_bulk,
    finite_grid,
    finite_material,
    finite_space,
    history,
    twin,
)
from tests.support.plastic import tensor
from tests.support.small import vector_of


def not_yielding(material):
    """The same one, but for a yield stress that nothing reaches."""
    if not material.yields:
        return material
    return material._replace(small=material.small._replace(curve=np.array([[0.0, 1e9, 0.0]])))


def acoustic_at(cells, state, nodal, normal, q=0):
    """Acoustic tensor (3, 3) of a point of the first cell."""
    work, found = cell_work(cells), np.empty((3, 3))
    assert begin_cell(state, cells, nodal, 0, ELASTIC, work) and point_of_cell(state, cells, 0, q, ELASTIC, work)
    acoustic(state, cells, 0, q, normal, work, found)
    return found


def stresses(cells, state, nodal, mode):
    """P (nc, nq, d, d) and dP (nc, nq, d, d, nn d) of all cells."""
    nc, nq, nn, d = cells.grad.shape
    piola, slope = np.zeros((nc, nq, d, d)), np.zeros((nc if mode else 1, nq, d, d, nn * d))
    work, found = cell_work(cells), np.empty(nc, dtype=bool)
    for c in range(nc):
        found[c] = cell_piola(state, cells, nodal, c, mode, work, piola[c], slope[c if mode else 0])
    piola[~found] = np.nan
    return piola, slope, np.sum(~found)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "cell, degree, kinematics", [("quadrilateral", 2, "axisymmetric"), ("hexahedron", 1, "plane_strain")]
)
def test_piola_stress(tmp_path, cell, degree, kinematics, law):
    """Its work on the gradients of the test functions are the forces; its derivative is that of differences."""
    rng = np.random.default_rng(1)
    space = finite_space(finite_grid(tmp_path, cell, degree), degree, kinematics, True)
    bulk = history(finite_bulk(space, law), rng)
    nodal, way, h = deformed(space, rng), rng.standard_normal((space.n_local, space.dim)), 1e-5
    forces = np.zeros((space.n_owned, space.dim))
    bulk.residual(vector_of(space, nodal[space.owned_local]), forces)
    total = np.zeros_like(nodal)
    for _, _, cells, state in bulk.chunks():
        piola, slope, missed = stresses(cells, state, nodal, CONSISTENT)
        assert missed == 0
        parts = np.einsum("cq,cqij,cqaj->cai", cells.jxw, piola, cells.grad)
        np.add.at(total, cells.nodes, parts)
        ends = [stresses(cells, state, nodal + k * h * way, STRESS)[0] for k in (-2, -1, 1, 2)]
        change = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        along = np.einsum("cqijn,cn->cqij", slope, way[cells.nodes].reshape(len(cells.nodes), -1))
        np.testing.assert_allclose(along, change, rtol=0.0, atol=1e-7 * np.abs(change).max())
    # the hoop stress has a radial force of its own
    component = 1 if space.axisymmetric else slice(None)
    np.testing.assert_allclose(
        total[space.owned_local][:, component], forces[:, component], rtol=0.0, atol=1e-12 * np.abs(forces).max()
    )


def test_elastic_slope_at_the_committed_state(tmp_path):
    """It is that of a body that does not yield between: the consistent one of a step back."""
    rng = np.random.default_rng(4)
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    bulk = history(finite_bulk(space, "multiplicative"), rng)
    nodal = deformed(space, rng)
    bulk.commit(vector_of(space, nodal[space.owned_local]), 0.0)
    assert bulk.plasticity()[0] > 0.05
    for _, _, cells, state in bulk.chunks():
        at, elastic, _ = stresses(cells, state, nodal, ELASTIC)
        np.testing.assert_array_equal(at, stresses(cells, state, nodal, STRESS)[0])
        # inside the yield surface, whatever rounding errors say
        harder = state._replace(material=not_yielding(state.material))
        np.testing.assert_allclose(elastic, stresses(cells, harder, nodal, CONSISTENT)[1], rtol=1e-9, atol=1e-9)


def test_cells_turned_inside_out_are_counted(tmp_path):
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    bulk = finite_bulk(space, "hencky")
    nodal = -2.0 * space.points
    nodal[:, 1] = 0.0
    for _, _, cells, state in bulk.chunks():
        piola, _, missed = stresses(cells, state, nodal, CONSISTENT)
        assert missed == len(cells.nodes) and np.isnan(piola).all()


@pytest.mark.parametrize("law", ["hencky", "multiplicative", "additive", "ogden"])
@pytest.mark.parametrize("cell, averaged", [("quadrilateral", True), ("quadrilateral", False), ("hexahedron", True)])
def test_acoustic_tensor(tmp_path, cell, averaged, law):
    """Differences of the traction of the twin, with the plastic strain of two steps."""
    rng, h = np.random.default_rng(3), 1e-4
    space = finite_space(finite_grid(tmp_path, cell, 1), 1, "plane_strain", averaged)
    bulk, d = history(finite_bulk(space, law), rng), space.dim
    f, n, material = np.eye(3), np.zeros(3), not_yielding(finite_material(law))
    f[:d, :d] += 0.2 * rng.standard_normal((d, d))
    n[:d] = rng.standard_normal(d)
    n /= np.linalg.norm(n)
    _, _, cells, state = next(iter(bulk.chunks()))
    plastic = tensor(state.strain[0, 0])

    def traction(k, step):
        gradient = f + step * np.outer(np.eye(3)[k], n)
        stress, ui = twin(material, gradient, plastic, state.p[0, 0], 6 if d == 3 else 4)[:2]
        return gradient @ ui @ stress @ ui @ n

    steps = zip((1.0, -8.0, 8.0, -1.0), (-2, -1, 1, 2), strict=True)
    expected = np.zeros((3, 3))
    for weight, at in steps:
        for k in range(d):
            expected[:, k] += weight * traction(k, at * h) / (12.0 * h)
    state = state._replace(material=not_yielding(state.material))
    found = acoustic_at(cells, state, space.points @ (f - np.eye(3))[:d, :d].T, n[:d])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("law", LAWS)
def test_acoustic_tensor_of_the_undeformed_body(tmp_path, law):
    """lambda + 2 mu along the normal, mu across."""
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", True)
    _, _, cells, state = next(iter(finite_bulk(space, law).chunks()))
    found = acoustic_at(cells, state, np.zeros_like(space.points), np.array([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(np.linalg.eigvalsh(found), [MU, MU, LAM + 2.0 * MU], rtol=1e-12)
