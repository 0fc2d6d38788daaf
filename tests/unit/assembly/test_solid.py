"""Stiffness and stress of elastic cells against plain numpy, and against what is known."""

import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.assembly.geometry import bulk_degree
from pcontact.assembly.graph import node_graph
from pcontact.assembly.loads import load_vector, lumped_volume
from pcontact.assembly.solid import add_stiffness
from pcontact.assembly.strains import NO_RING, CellPoints, add_means, strains
from pcontact.element.quadrature import quadrature
from pcontact.material.elastic import equivalent_stress, isotropic, lame
from pcontact.scene.model import Load
from pcontact.space.modes import rigid_modes
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    dense_item,
    elastic_solid,
    elasticity,
    magnitude_of,
    make_space,
    numpy_gradients,
    vector_of,
)

LAME = (3.0, 2.0)
# geometry degree and displacement degree
DEGREES = [(1, 1), (1, 2), (2, 2)]


@pytest.fixture(
    params=[(c, g, p) for c in DIMENSION for g, p in DEGREES], ids=lambda p: f"{p[0]}-{p[1]}{p[2]}"
)
def space(request, tmp_path):
    """A bent box on one rank; with second-order geometry its cells are curved."""
    cell, geometry, degree = request.param
    n = 1 if (cell, degree) == ("hexahedron", 2) else 2
    path = block_file(tmp_path / "block.msh", cell, n, geometry)
    return make_space(SELF, path, ["block"], degree, bend)


def twin_stiffness(space, lam, mu):
    """K (n d, n d) by einsum, with the quadrature that the program uses."""
    d, tensor = space.dim, elasticity(lam, mu, space.dim)
    out = np.zeros((space.n_local, d, space.n_local, d))
    for number, block in enumerate(space.mesh.blocks):
        degree = bulk_degree(block.cell, space.degree, space.mesh.geometry_nodes(block)[1])
        grad, jxw, _ = numpy_gradients(space, number, *quadrature(block.cell, degree))
        cells = space.cells[number]
        local = np.einsum("cq,cqaj,ijkl,cqbl->caibk", jxw, grad, tensor, grad, optimize=True)
        i, j = np.broadcast_arrays(cells[:, :, None], cells[:, None, :])
        np.add.at(out.transpose(0, 2, 1, 3), (i, j), local.transpose(0, 1, 3, 2, 4))
    return out.reshape(space.n_local * d, -1)


def linear_field(points, gradient, shift):
    return points @ gradient.T + shift


def ordered(space, array):
    """Rows of local nodes in the order of the owned ones."""
    return array[space.owned_local]


def test_lame_constants():
    young, poisson = 210e3, 0.3
    lam, mu = lame(young, poisson)
    assert mu == pytest.approx(young / 2.6)
    # shear, bulk and P-wave modulus give E and nu back
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(young)
    assert lam / (2 * (lam + mu)) == pytest.approx(poisson)
    assert lame(5.0, 0.0) == (0.0, 2.5)


def test_equivalent_stress():
    stress = np.array(
        [[7.0, 0, 0, 0, 0, 0], [4.0, 4, 4, 0, 0, 0], [0, 0, 0, 2.0, 0, 0], [1, 2, 3, 4, 5, 6.0]]
    )
    full = stress[3][[[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    deviator = full - np.eye(3) * np.trace(full) / 3
    expected = [7.0, 0.0, 2.0 * np.sqrt(3.0), np.sqrt(1.5 * np.sum(deviator**2))]
    np.testing.assert_allclose(equivalent_stress(stress), expected, atol=1e-14)


@pytest.mark.parametrize("d, nn, nq", [(2, 3, 1), (2, 4, 3), (3, 4, 2), (3, 5, 4)])
def test_kernel_adds_what_numpy_adds(d, nn, nq):
    """Random gradients: no symmetry of a real element hides an error."""
    rng = np.random.default_rng(1)
    n, nc, (lam, mu) = 7, 5, LAME
    cells = np.array([rng.permutation(n)[:nn] for _ in range(nc)])
    grad, jxw = rng.normal(size=(nc, nq, nn, d)), rng.random((nc, nq))
    rowptr, columns = node_graph([cells], n)
    start = rng.normal(size=(len(columns), d, d))
    values = start.copy()
    add_stiffness(grad, jxw, cells, lam, mu, rowptr, columns, values)
    local = np.einsum("cq,cqaj,ijkl,cqbl->caibk", jxw, grad, elasticity(lam, mu, d), grad)
    full = np.zeros((n, n, d, d))
    i, j = np.broadcast_arrays(cells[:, :, None], cells[:, None, :])
    np.add.at(full, (i, j), local.transpose(0, 1, 3, 2, 4))
    rows = np.repeat(np.arange(n), np.diff(rowptr))
    np.testing.assert_allclose(values - start, full[rows, columns], atol=1e-13)
    # everything has a place in the pattern
    assert np.count_nonzero(np.abs(full).sum(axis=(2, 3))) == len(columns)


@pytest.mark.parametrize("d", [2, 3])
def test_mean_stress_is_what_numpy_averages(d):
    rng = np.random.default_rng(2)
    n, nc, nq, nn, (lam, mu) = 6, 4, 3, 4, LAME
    cells = np.array([rng.permutation(n)[:nn] for _ in range(nc)])
    grad, jxw, nodal = rng.normal(size=(nc, nq, nn, d)), 0.1 + rng.random((nc, nq)), rng.normal(size=(n, d))
    out = np.zeros((nc, 6))
    moduli = isotropic(lam, mu, 6 if d == 3 else 4, False)
    add_means(jxw, strains(CellPoints(cells, grad, NO_RING), nodal) @ moduli, out)
    h = np.zeros((nc, nq, 3, 3))
    h[..., :d, :d] = np.einsum("cai,cqaj->cqij", nodal[cells], grad)
    sigma = np.einsum("ijkl,cqkl->cqij", elasticity(lam, mu, 3), h)
    mean = np.einsum("cq,cqij->cij", jxw, sigma) / jxw.sum(axis=1)[:, None, None]
    np.testing.assert_allclose(out, mean[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]], atol=1e-12)


def test_stiffness_is_that_of_numpy(space):
    bulk = elastic_solid(space, [LAME])
    u = space.vector()
    expected = twin_stiffness(space, *LAME)
    rows = (space.owned_local[:, None] * space.dim + np.arange(space.dim)).ravel()
    assert np.array_equal(space.nodes[space.owned_local], np.arange(space.n_local))
    np.testing.assert_allclose(dense_item(bulk, u), expected[np.ix_(rows, rows)], atol=1e-12)


def test_stiffness_is_symmetric_and_only_rigid_modes_cost_nothing(space):
    bulk = elastic_solid(space, [LAME])
    k = dense_item(bulk, space.vector())
    assert np.abs(k - k.T).max() < 1e-13 * np.abs(k).max()
    modes = rigid_modes(ordered(space, space.points), np.zeros(space.dim), 1.0)
    n_modes = len(modes)
    assert np.abs(k @ modes.reshape(n_modes, -1).T).max() < 1e-12 * np.abs(k).max()
    eigenvalues = np.linalg.eigvalsh(k)
    assert np.all(np.abs(eigenvalues[:n_modes]) < 1e-11 * eigenvalues[-1])
    assert eigenvalues[n_modes] > 1e-5 * eigenvalues[-1]


def test_residual_is_stiffness_times_displacement(space):
    bulk, rng = elastic_solid(space, [LAME]), np.random.default_rng(3)
    values = rng.normal(size=(space.n_owned, space.dim))
    u = vector_of(space, values)
    start = rng.normal(size=values.shape)
    out = start.copy()
    bulk.residual(u, out)
    k = dense_item(bulk, u)
    np.testing.assert_allclose((out - start).ravel(), k @ values.ravel(), atol=1e-11)
    np.testing.assert_allclose(magnitude_of(bulk, u).ravel(), np.abs(k) @ np.abs(values).ravel(), rtol=1e-12)


def test_uniaxial_stress(space):
    """u = strain x: the known stress in every cell, its traction at the boundary, no force inside."""
    d, young, poisson, pull = space.dim, 7.0, 0.3, 0.5
    lam, mu = lame(young, poisson)
    bulk = elastic_solid(space, [(lam, mu)])
    # plane strain: the stress out of plane holds the strain there at zero
    strain = np.full(d, -poisson * (1 + poisson) if d == 2 else -poisson) * pull / young
    strain[0] = (1 - poisson**2 if d == 2 else 1.0) * pull / young
    field = linear_field(ordered(space, space.points), np.diag(strain), np.ones(d))
    expected = np.zeros(6)
    expected[0], expected[2] = pull, poisson * pull if d == 2 else 0.0
    for stress, volume in bulk.stress(vector_of(space, field)):
        np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), atol=1e-13)
        assert np.all(volume > 0)
    force = np.zeros((space.n_owned, d))
    bulk.residual(vector_of(space, field), force)
    traction = np.zeros((space.n_owned, d))
    for side in ("left", "right", "bottom", "top", *(("front", "back") if d == 3 else ())):
        traction += pull * normal_forces(space, side)
    np.testing.assert_allclose(force, traction, atol=1e-13)


def normal_forces(space, side):
    """int N_a n_x e_x over a side: minus the forces of a unit pressure, x component only."""
    forces = -load_vector(space, Load(side, pressure=1.0))
    forces[:, 1:] = 0.0
    return forces


def test_loads_have_the_right_sum(space):
    """Body force times volume; a closed surface under pressure is in balance and does no turning."""
    d = space.dim
    volume = sum(v.sum() for _, v in elastic_solid(space, [LAME]).stress(space.vector()))
    force = load_vector(space, Load("block", body_force=[2.0, -1.0, 3.0][:d]))
    np.testing.assert_allclose(force.sum(axis=0), volume * np.array([2.0, -1.0, 3.0][:d]), rtol=1e-12)
    share = lumped_volume(space)
    assert share.min() > 0
    assert share.sum() == pytest.approx(volume)
    sides = ("left", "right", "bottom", "top", *(("front", "back") if d == 3 else ()))
    pressure = sum(load_vector(space, Load(side, pressure=1.0)) for side in sides)
    modes = rigid_modes(ordered(space, space.points), np.zeros(d), 1.0)
    np.testing.assert_allclose(np.einsum("mnd,nd->m", modes, pressure), 0.0, atol=1e-13)
    # virtual work of the pressure in a blow-up x -> (1 + e) x is d times the volume
    assert np.sum(pressure * ordered(space, space.points)) == pytest.approx(-d * volume)


def test_two_materials_and_two_kinds_of_cells(tmp_path):
    """Each block with its own constants."""
    path = two_blocks(tmp_path / "blocks.msh", 2, 2, 3, "quadrilateral", cell_upper="triangle")
    space = make_space(SELF, path, ["lower", "upper"], 1, bend)
    both = dense_item(elastic_solid(space, [LAME, (5.0, 1.0)]), space.vector())
    first = dense_item(elastic_solid(space, [LAME, (0.0, 0.0)]), space.vector())
    second = dense_item(elastic_solid(space, [(0.0, 0.0), (5.0, 1.0)]), space.vector())
    np.testing.assert_allclose(both, first + second, atol=1e-13)
    lower = np.repeat(space.component[space.owned_local] == 0, 2)
    assert np.abs(first[~lower]).max() == 0 and np.abs(second[lower]).max() == 0
    assert np.abs(first[lower]).max() > 0 and np.abs(second[~lower]).max() > 0
