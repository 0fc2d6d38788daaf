"""The trace constant lambda_F: table of C_p, invariances, a dense numpy twin."""

from functools import partial

import numpy as np
import pytest

from pcontact.element import trace
from pcontact.element.dilatation import Dilatation
from pcontact.element.geometry import facet_geometry
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_nodes, n_nodes, reference_nodes, shape, shape_gradient
from pcontact.element.trace import trace_constant
from tests.support.orthotropic import LAMINATE, SKEW, law_of, plane_axes

SOLID = ["triangle", "quadrilateral", "tetrahedron", "hexahedron", "wedge:triangle", "wedge:quadrilateral",
         "pyramid:triangle"]  # fmt: skip
CASES = [(cell, geometry, degree) for cell in SOLID for geometry in (1, 2) for degree in (1, 2)]
CASES += [("quadrilateral8", 2, 2), ("hexahedron20", 1, 2)]


def lame(poisson, young=1.0):
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), 0.5 * young / (1 + poisson)


def facets_of(cell, degree, size=0.0, count=1, seed=3):
    """All facets of `count` cells of side 1 with nodes moved at random: coordinates and local numbers."""
    nodes = reference_nodes(cell, degree) / (2.0 if CELLS[cell].is_tensor else 1.0)
    size = size if CELLS[cell].is_tensor else 0.5 * size
    x = nodes + size * np.random.default_rng(seed).uniform(-1, 1, (count, *nodes.shape))
    n = len(CELLS[cell].facets)
    return np.repeat(x, n, axis=0), np.tile(np.arange(n), count)


def measures(cell, x, local):
    """|F| and |E| of facets of cells with degree-1 geometry, by quadrature."""
    points, weights = quadrature(cell, 4)
    volume = np.linalg.det(np.einsum("fai,qaj->fqij", x, shape_gradient(cell, 1, points))) @ weights
    return facet_geometry(cell, x, local, 1, 1, *quadrature(CELLS[cell].facet, 4)).jxw.sum(axis=1), volume


def dense_twin(cell, x, local, geometry, degree, lam, mu, order):
    """lambda_F of one facet from stresses in full tensor form and a pseudo-inverse."""
    identity = np.eye(CELLS[cell].dim)

    def stress(grad):
        # (q, a, i) -> sigma[q, a, i, k, l] of the field N_a e_i
        full = np.einsum("qal,ik->qaikl", grad, identity)
        sym = 0.5 * (full + full.swapaxes(3, 4))
        return lam * np.einsum("qaikk,lm->qailm", sym, identity) + 2 * mu * sym, sym

    points, weights = quadrature(cell, order)
    jacobian = np.einsum("ai,qaj->qij", x, shape_gradient(cell, geometry, points))
    grad = np.einsum("qaj,qji->qai", shape_gradient(cell, degree, points), np.linalg.inv(jacobian))
    sigma, strain = stress(grad)
    energy = np.einsum("qaikl,qbjkl,q->aibj", sigma, strain, weights * np.linalg.det(jacobian))
    xi, facet_weights = quadrature(CELLS[cell].facet, order)
    facet = facet_geometry(cell, x[None], np.array([local]), geometry, degree, xi, facet_weights)
    traction = np.einsum("qaikl,ql->qaik", stress(facet.gradients[0])[0], facet.normals[0])
    boundary = np.einsum("qaik,qbjk,q->aibj", traction, traction, facet.jxw[0])
    size = grad.shape[1] * grad.shape[2]
    values, vectors = np.linalg.eigh(energy.reshape(size, size))
    kept = values > 1e-11 * values[-1]
    basis = vectors[:, kept] / np.sqrt(values[kept])
    return np.linalg.eigvalsh(basis.T @ boundary.reshape(size, size) @ basis)[-1]


@pytest.mark.parametrize(
    ("cell", "degree", "expected", "digits"),
    [
        ("triangle", 1, 1.0, 1e-12),
        ("triangle", 2, 3.0, 1e-12),
        ("quadrilateral", 1, 1.45, 5e-3),
        ("quadrilateral", 2, 4.65, 5e-3),
        ("tetrahedron", 1, 1.0, 1e-12),
        ("tetrahedron", 2, 8 / 3, 1e-12),
        ("hexahedron", 1, 1.66, 5e-3),
        ("hexahedron", 2, 5.0, 1e-2),
    ],
)
def test_table(cell, degree, expected, digits):
    """C_p = lambda_F h_F / (lam + 2 mu) of cells of unit shape at Poisson's ratio 0.3."""
    lam, mu = lame(0.3)
    x, local = facets_of(cell, 1)
    area, volume = measures(cell, x, local)
    c_p = trace_constant(cell, x, local, 1, degree, lam, mu) * volume / area / (lam + 2 * mu)
    np.testing.assert_allclose(c_p, expected, atol=digits)


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49])
def test_closed_form_is_the_largest_eigenvalue(cell, degree, poisson):
    lam, mu = lame(poisson)
    x, local = facets_of(cell, 1, 0.3, count=4)
    area, volume = measures(cell, x, local)
    dim = CELLS[cell].dim
    closed = trace_constant(cell, x, local, 1, degree, lam, mu)
    expected = degree * (degree + dim - 1) / dim * (lam + 2 * mu) * area / volume
    np.testing.assert_allclose(closed, expected, rtol=1e-12)
    moduli = np.full(len(x), lam), np.full(len(x), mu)
    np.testing.assert_allclose(trace._largest(cell, x, local, 1, degree, *moduli), closed, rtol=1e-9)


@pytest.mark.parametrize("poisson", [-0.3, 0.0, 0.3, 0.4995])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_shear_modulus_bounds_tangential_tractions(cell, degree, poisson):
    """With gamma = lambda_F, |t_n|^2 / gamma + |t_T|^2 / (alpha gamma) is no larger than the energy."""
    lam, mu = lame(poisson)
    x, local = facets_of(cell, 1, 0.1)
    d, moduli = x.shape[2], (np.full(len(x), lam), np.full(len(x), mu))
    part = min(1.0, 4.0 * mu / (lam + 2.0 * mu))
    kind = Dilatation(False, False, shear=np.full(len(x), part))
    constant = trace_constant(cell, x, local, 1, degree, lam, mu, kind)
    layout = cell, 1, degree, 2 * degree
    loads = trace._tractions(layout, x, local, *moduli, Dilatation(False, False))
    normals = facet_geometry(cell, x, local, 1, degree, *quadrature(CELLS[cell].facet, 2 * degree)).normals
    loads = loads.reshape(len(x), -1, d, loads.shape[2])
    along = np.einsum("fqi,fqin->fqn", normals, loads)[:, :, None] * normals[..., None]
    scaled = (along + (loads - along) / np.sqrt(part)).reshape(len(x), -1, loads.shape[3])
    stiffness = trace._stiffness(layout, x, *moduli, Dilatation(False, False))
    for one, k, bound in zip(scaled, stiffness, constant, strict=True):
        largest = np.linalg.eigvalsh(one @ np.linalg.pinv(k, rcond=1e-10, hermitian=True) @ one.T)[-1]
        if CELLS[cell].is_simplex:
            assert largest < bound * (1.0 + 1e-6)
        else:
            np.testing.assert_allclose(largest, bound, rtol=1e-6)


@pytest.mark.parametrize(("cell", "geometry", "degree"), CASES)
def test_dense_twin(cell, geometry, degree):
    """Also with displacements of lower degree than a curved geometry, where rotations are no rigid modes."""
    lam, mu = lame(0.3)
    x, local = facets_of(cell, geometry, 0.04)
    result = trace_constant(cell, x, local, geometry, degree, lam, mu)
    order = 2 * degree + 2 * (geometry - 1)
    for k in (0, len(local) - 1):
        expected = dense_twin(cell, x[k], local[k], geometry, degree, lam, mu, order)
        assert result[k] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(("cell", "geometry", "degree"), CASES)
def test_scaling(cell, geometry, degree):
    """Units change the result by their factor only, a rotation and a shift not at all."""
    lam, mu = lame(0.3)
    x, local = facets_of(cell, geometry, 0.04)
    result = trace_constant(cell, x, local, geometry, degree, lam, mu)
    for length in (1e-6, 1e6):
        scaled = trace_constant(cell, length * x, local, geometry, degree, 1e9 * lam, 1e9 * mu)
        np.testing.assert_allclose(scaled, result * 1e9 / length, rtol=1e-9)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(x.shape[2], x.shape[2])))[0]
    turn[0] *= np.sign(np.linalg.det(turn))
    moved = trace_constant(cell, x @ turn.T + 100.0, local, geometry, degree, lam, mu)
    np.testing.assert_allclose(moved, result, rtol=1e-8)


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("degree", [1, 2])
def test_straight_degree_2_geometry(cell, degree):
    """Degree-2 nodes on the middles give exactly what the vertices give, next to a curved cell."""
    lam, mu = lame(0.3)
    straight, local = facets_of(cell, 1, 0.1)
    middles = np.einsum("na,fai->fni", shape(cell, 1, reference_nodes(cell, 2)), straight)
    curved = middles + 0.02 * np.random.default_rng(2).uniform(-1, 1, middles.shape)
    both = trace_constant(cell, np.vstack([middles, curved]), np.tile(local, 2), 2, degree, lam, mu)
    np.testing.assert_array_equal(
        both[: len(local)], trace_constant(cell, straight, local, 1, degree, lam, mu)
    )
    assert (both[len(local) :] != both[: len(local)]).all()
    if degree == 2:  # at degree 1 a rotation of the curved cell has stresses: no small change
        assert (np.abs(both[len(local) :] / both[: len(local)] - 1) < 0.8).all()


def test_moduli_per_facet_and_batches(monkeypatch):
    x, local = facets_of("hexahedron", 1, 0.05, count=3)
    poisson = np.linspace(0.0, 0.49, len(local))
    lam, mu = lame(poisson, young=np.linspace(1.0, 200.0, len(local)))
    whole = trace_constant("hexahedron", x, local, 1, 1, lam, mu)
    monkeypatch.setattr(trace, "_BATCH", 5)
    np.testing.assert_allclose(trace_constant("hexahedron", x, local, 1, 1, lam, mu), whole, rtol=1e-12)
    single = trace_constant("hexahedron", x[7:8], local[7:8], 1, 1, lam[7], mu[7])
    assert single[0] == pytest.approx(whole[7], rel=1e-12)


@pytest.mark.parametrize(("cell", "geometry", "degree"), CASES)
def test_no_facets(cell, geometry, degree):
    x = np.empty((0, n_nodes(cell, geometry), CELLS[cell].dim))
    assert trace_constant(cell, x, np.empty(0, dtype=int), geometry, degree, 1.0, 1.0).shape == (0,)


def test_inverted_cell():
    x, local = facets_of("hexahedron", 1)
    with pytest.raises(ValueError, match="inverted"):
        trace_constant("hexahedron", x * [1.0, 1.0, -1.0], local, 1, 1, 1.0, 1.0)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_closed_form_of_orthotropic_cells_is_the_largest_eigenvalue(cell, degree):
    """With the largest eigenvalue of the acoustic tensor in the place of lam + 2 mu."""
    x, local = facets_of(cell, 1, 0.3, count=4)
    dim = CELLS[cell].dim
    law = law_of(LAMINATE, SKEW if dim == 3 else plane_axes(35.0), dim)
    kind, moduli = Dilatation(False, False, law=law), [np.full(len(x), one) for one in law.constants]
    closed = trace_constant(cell, x, local, 1, degree, *moduli, kind)
    np.testing.assert_allclose(trace._largest(cell, x, local, 1, degree, *moduli, kind), closed, rtol=1e-9)


@pytest.mark.parametrize("cell, degree, axisymmetric", [("quadrilateral", 1, False), ("quadrilateral", 2, True),
                                                        ("triangle", 2, True), ("hexahedron", 1, False)])  # fmt: skip
def test_split_of_the_stiffness_does_not_matter(cell, degree, axisymmetric):
    """C_iso and C_dev, in whichever way; and no displacement is beyond the constant."""
    x, local = facets_of(cell, 1, 0.05, count=2)
    x = x + [2.0] * x.shape[2]
    dim = CELLS[cell].dim
    axes, found = SKEW if dim == 3 else plane_axes(35.0), []
    for split in (None, (1.0, 4.0), (0.0, 9.0)):
        law = law_of(LAMINATE, axes, dim, "axisymmetric" if axisymmetric else "plane_strain", split=split)
        kind = Dilatation(axisymmetric, False, law=law)
        found.append(trace_constant(cell, x, local, 1, degree, *law.constants, kind))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-9)
    if not axisymmetric:
        layout = cell, 1, degree, 2 * degree
        ones, rest = [np.full(len(x), one) for one in law.constants], partial(law_at, law)
        stiffness, tractions = (of(*arguments, *ones, kind, rest) for of, arguments in (
            (trace._stiffness, (layout, x)), (trace._tractions, (layout, x, local))))  # fmt: skip
        v = np.random.default_rng(5).normal(size=(len(x), stiffness.shape[1], 200))
        ratio = np.sum((tractions @ v) ** 2, axis=1) / np.einsum("fas,fab,fbs->fs", v, stiffness, v)
        assert np.all(ratio.max(axis=1) < found[0] * (1.0 + 1e-12))


def law_at(law, points):
    """C_dev (1, 1, m, m) of a uniform law."""
    return law.deviation(points[0])[None]


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_cells_so_flat_that_pivots_are_rounding_errors_have_a_constant(cell):
    """On the small sides of rectangles and boxes it does not grow with them, on the large ones as they get thinner."""
    constants = []
    for thin in np.geomspace(1e-2, 1e-5, 25):
        x, local = facets_of(cell, 1)
        x[..., -1] *= thin
        found = trace_constant(cell, x, local, 1, 1, *lame(0.3))
        heights = x[np.arange(len(x))[:, None], facet_nodes(cell, 1)[local], -1]
        constants.append(found * np.where(np.ptp(heights, axis=1) > 0.0, 1.0, thin))
    assert np.allclose(constants, constants[0], rtol=0.02)
