"""Kernels of cells with finite strain: the first Piola-Kirchhoff stress of a cell, and its derivative."""

import numpy as np
import pytest

from pcontact.assembly.finite_kernels import cell_work, piola_at
from pcontact.material.finite import CONSISTENT, ELASTIC, STRESS
from tests.support.finite import LAWS, deformed, finite_bulk, finite_grid, finite_space, history
from tests.support.small import vector_of


def stresses(cells, state, nodal, mode):
    """P (nc, nq, d, d) and dP (nc, nq, d, d, nn d) of all cells."""
    nc, nq, nn, d = cells.grad.shape
    piola, slope = np.zeros((nc, nq, d, d)), np.zeros((nc if mode else 1, nq, d, d, nn * d))
    missed = piola_at(state, cells, nodal, mode, cell_work(cells), piola, slope)
    return piola, slope, missed


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
        harder = state._replace(
            material=state.material._replace(small=state.material.small._replace(curve=np.array([[0.0, 1e9, 0.0]])))
        )
        np.testing.assert_allclose(elastic, stresses(cells, harder, nodal, CONSISTENT)[1], rtol=1e-9, atol=1e-9)


def test_cells_turned_inside_out_are_counted(tmp_path):
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    bulk = finite_bulk(space, "hencky")
    nodal = -2.0 * space.points
    nodal[:, 1] = 0.0
    for _, _, cells, state in bulk.chunks():
        piola, _, missed = stresses(cells, state, nodal, CONSISTENT)
        assert missed == len(cells.nodes) and np.isnan(piola).all()
