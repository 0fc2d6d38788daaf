"""Gradients, normals and volumes of cells that are not the reference cell."""

import numpy as np
import pytest

from pcontact.element.geometry import facet_geometry, gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import (
    CELLS,
    facet_area_vectors,
    facet_nodes,
    facet_points,
    n_nodes,
    reference_nodes,
    shape,
    shape_gradient,
)

SOLID = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


def distorted(cell, degree, count=5, size=0.15, seed=1):
    """Node coordinates of randomly distorted cells (count, n_nodes, d), curved at degree 2."""
    random = np.random.default_rng(seed)
    nodes = reference_nodes(cell, degree)
    size = size if CELLS[cell].is_tensor else 0.4 * size
    return nodes + size * random.uniform(-1, 1, (count, *nodes.shape))


def all_facets(cell, x):
    """Every facet of every cell: parent coordinates and local facet numbers."""
    n = len(CELLS[cell].facets)
    return np.repeat(x, n, axis=0), np.tile(np.arange(n), len(x))


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("geometry_degree", [1, 2])
@pytest.mark.parametrize("degree", [1, 2])
def test_gradients(cell, geometry_degree, degree):
    """Against a numpy twin, and against the gradient of an affine field."""
    x = distorted(cell, geometry_degree)
    points, weights = quadrature(cell, 3)
    dgeo, dshape = shape_gradient(cell, geometry_degree, points), shape_gradient(cell, degree, points)
    dim = CELLS[cell].dim
    grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
    smallest = gradients(x, dgeo, dshape, weights, grad, jxw)
    jacobian = np.einsum("cai,qaj->cqij", x, dgeo)
    det = np.linalg.det(jacobian)
    np.testing.assert_allclose(grad, np.einsum("qaj,cqji->cqai", dshape, np.linalg.inv(jacobian)), atol=1e-12)
    np.testing.assert_allclose(jxw, weights * det, rtol=1e-12)
    assert smallest == pytest.approx(det.min()) and smallest > 0
    slope = np.arange(1.0, dim + 1)
    if degree >= geometry_degree:
        at_nodes = (
            np.einsum("na,cai->cni", shape(cell, geometry_degree, reference_nodes(cell, degree)), x) @ slope
        )
        result = np.einsum("cqai,ca->cqi", grad, at_nodes)
        np.testing.assert_allclose(result, np.broadcast_to(slope, result.shape), atol=1e-12)


def test_gradients_report_an_inverted_cell():
    points, weights = quadrature("triangle", 1)
    table = shape_gradient("triangle", 1, points)
    x = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]])
    grad, jxw = np.empty((2, 1, 3, 2)), np.empty((2, 1))
    assert gradients(x, table, table, weights, grad, jxw) == -1.0
    np.testing.assert_allclose(jxw, [[0.5], [-0.5]])
    assert gradients(x[:0], table, table, weights, grad[:0], jxw[:0]) == np.inf


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("geometry_degree", [1, 2])
def test_facet_normals(cell, geometry_degree):
    """Outward, unit, equal to the normal of the facet's own map, on distorted and curved cells."""
    x, local = all_facets(cell, distorted(cell, geometry_degree))
    facet = CELLS[cell].facet
    xi, weights = quadrature(facet, 4)
    result = facet_geometry(cell, x, local, geometry_degree, 1, xi, weights)
    np.testing.assert_allclose(np.linalg.norm(result.normals, axis=2), 1.0, rtol=1e-14)
    nodes = np.take_along_axis(x, facet_nodes(cell, geometry_degree)[local][:, :, None], axis=1)
    np.testing.assert_allclose(
        result.points, np.einsum("qa,fai->fqi", shape(facet, geometry_degree, xi), nodes), atol=1e-13
    )
    tangents = np.einsum("fai,qak->fqik", nodes, shape_gradient(facet, geometry_degree, xi))
    if CELLS[cell].dim == 2:
        area = np.stack([tangents[..., 1, 0], -tangents[..., 0, 0]], axis=-1)
    else:
        area = np.cross(tangents[..., 0], tangents[..., 1])
    np.testing.assert_allclose(result.jxw[..., None] * result.normals, weights[:, None] * area, atol=1e-13)
    # outward: a step along the normal, pulled back to the reference cell, leaves it through this facet
    outward = reference_outward_component(cell, x, local, geometry_degree, xi, result.normals)
    assert (outward > 0).all()


def reference_outward_component(cell, x, local, degree, xi, normals):
    """Component of J^{-1} n along the outward reference area vector of the facet."""
    dgeo = shape_gradient(cell, degree, facet_points(cell, xi).reshape(-1, CELLS[cell].dim))
    dgeo = dgeo.reshape(len(CELLS[cell].facets), len(xi), *dgeo.shape[1:])[local]
    jacobian = np.einsum("fai,fqaj->fqij", x, dgeo)
    step = np.linalg.solve(jacobian, normals[..., None])[..., 0]
    return np.einsum("fqi,fi->fq", step, facet_area_vectors(cell)[local])


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("geometry_degree", [1, 2])
@pytest.mark.parametrize("degree", [1, 2])
def test_facet_shapes_and_gradients(cell, geometry_degree, degree):
    x, local = all_facets(cell, distorted(cell, geometry_degree))
    xi, weights = quadrature(CELLS[cell].facet, 4)
    result = facet_geometry(cell, x, local, geometry_degree, degree, xi, weights)
    on_cell = facet_points(cell, xi).reshape(-1, CELLS[cell].dim)
    values = shape(cell, degree, on_cell).reshape(-1, len(xi), n_nodes(cell, degree))
    np.testing.assert_allclose(result.shape, values[local])
    dshape = shape_gradient(cell, degree, on_cell).reshape(*values.shape, -1)[local]
    dgeo = shape_gradient(cell, geometry_degree, on_cell).reshape(len(values), len(xi), x.shape[1], -1)[local]
    inverse = np.linalg.inv(np.einsum("fai,fqaj->fqij", x, dgeo))
    np.testing.assert_allclose(result.gradients, np.einsum("fqaj,fqji->fqai", dshape, inverse), atol=1e-12)


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("geometry_degree", [1, 2])
def test_divergence_theorem(cell, geometry_degree):
    """Volume = int x.n / d, and int grad N = int N n over the closed surface, on curved cells."""
    x = distorted(cell, geometry_degree)
    dim = CELLS[cell].dim
    points, weights = quadrature(cell, 8)
    dgeo, dshape = shape_gradient(cell, geometry_degree, points), shape_gradient(cell, 2, points)
    grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
    gradients(x, dgeo, dshape, weights, grad, jxw)
    parents, local = all_facets(cell, x)
    facets = facet_geometry(cell, parents, local, geometry_degree, 2, *quadrature(CELLS[cell].facet, 8))
    flux = (
        np.einsum("fqi,fqi,fq->f", facets.points, facets.normals, facets.jxw).reshape(len(x), -1).sum(axis=1)
        / dim
    )
    np.testing.assert_allclose(flux, jxw.sum(axis=1), rtol=1e-12)
    surface = np.einsum("fqa,fqi,fq->fai", facets.shape, facets.normals, facets.jxw)
    surface = surface.reshape(len(x), -1, *surface.shape[1:]).sum(axis=1)
    np.testing.assert_allclose(surface, np.einsum("cqai,cq->cai", grad, jxw), atol=1e-12)
