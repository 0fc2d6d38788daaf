"""Reduced integration: gradients from 2 points in each direction, and the trace constant that goes with them."""

import numpy as np
import pytest

from pcontact.element.dilatation import Dilatation
from pcontact.element.geometry import facet_geometry, gradients
from pcontact.element.quadrature import DEGREE, from_points, quadrature, reduced_gradients
from pcontact.element.reference import CELLS, facet_points, reference_nodes, shape_gradient
from pcontact.element.trace import trace_constant

SERENDIPITY = ["quadrilateral8", "hexahedron20"]


def bent(cell, random):
    """One cell with curved edges, (1, nn, d)."""
    nodes = reference_nodes(cell, 2)
    return (nodes + 0.08 * random.uniform(-1, 1, nodes.shape))[None]


@pytest.mark.parametrize("cell", SERENDIPITY)
def test_products_of_linear_functions_go_through_the_points(cell):
    random = np.random.default_rng(1)
    points, d = quadrature(cell, DEGREE)[0], CELLS[cell].dim
    assert len(points) == 2**d
    np.testing.assert_allclose(from_points(cell, points), np.eye(2**d), atol=1e-14)
    xi = random.uniform(-1, 1, (5, d))
    np.testing.assert_allclose(from_points(cell, xi) @ (1 + points).prod(axis=1), (1 + xi).prod(axis=1), atol=1e-13)


@pytest.mark.parametrize("cell", SERENDIPITY)
def test_linear_displacements_have_their_gradient(cell):
    random = np.random.default_rng(2)
    x, d = bent(cell, random), CELLS[cell].dim
    slope = random.uniform(-1, 1, (d, d))
    grad = reduced_gradients(cell, x, 2, random.uniform(-1, 1, (1, 4, d)))
    found = np.einsum("cqaj,ai->cqij", grad, x[0] @ slope.T)[0]
    np.testing.assert_allclose(found, np.tile(slope, (4, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("cell", SERENDIPITY)
def test_trace_constant_bounds_the_traction_and_is_reached(cell):
    """The largest int |sigma n|^2 over the energy, of the strain at the points."""
    random, lam, mu = np.random.default_rng(3), 3.0, 2.0
    x, d = bent(cell, random), CELLS[cell].dim
    local = np.arange(len(CELLS[cell].facets))
    kind = Dilatation(False, False, True)
    found = trace_constant(cell, np.repeat(x, len(local), axis=0), local, 2, 2, lam, mu, kind)
    points, w = quadrature(cell, DEGREE)
    dshape = shape_gradient(cell, 2, points)
    grad, jxw = np.empty((1, *dshape.shape)), np.empty((1, len(w)))
    gradients(x, dshape, dshape, w, grad, jxw)
    unit = np.eye(x.shape[1] * d).reshape(-1, x.shape[1], d)

    def stress(grad):
        strain = np.einsum("qaj,kai->kqij", grad, unit)
        strain = 0.5 * (strain + strain.swapaxes(2, 3))
        return lam * np.trace(strain, axis1=2, axis2=3)[..., None, None] * np.eye(d) + 2 * mu * strain, strain

    sigma, strain = stress(grad[0])
    energy = np.einsum("kqij,lqij,q->kl", sigma, strain, jxw[0])
    xi, w = quadrature(CELLS[cell].facet, 6)
    for facet in local:
        at = facet_geometry(cell, x, np.array([facet]), 2, 2, xi, w)
        sigma = stress(reduced_gradients(cell, x, 2, facet_points(cell, xi)[[facet]])[0])[0]
        traction = np.einsum("kqij,qj->kqi", sigma, at.normals[0])
        squares = np.einsum("kqi,lqi,q->kl", traction, traction, at.jxw[0])
        values, vectors = np.linalg.eigh(energy)
        kept = values > 1e-10 * values[-1]
        # what has no energy has no traction
        assert np.abs(vectors[:, ~kept].T @ squares).max() < 1e-9
        root = vectors[:, kept] / np.sqrt(values[kept])
        assert found[facet] == pytest.approx(np.linalg.eigvalsh(root.T @ squares @ root)[-1], rel=1e-4)
