"""Reference cells, shape functions, quadrature and geometry."""

import itertools

import numpy as np
import pytest

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import (
    CELLS,
    MESHIO_NAMES,
    edge_nodes,
    face_nodes,
    facet_area_vectors,
    facet_nodes,
    facet_points,
    n_nodes,
    reference_nodes,
)
from pcontact.element.shape import shape, shape_gradient

SOLID = ["triangle", "quadrilateral", "tetrahedron", "hexahedron", "quadrilateral8", "hexahedron20"]
ALL = ["segment", *SOLID]
COUNTS = {
    "segment": (2, 3),
    "triangle": (3, 6),
    "quadrilateral": (4, 9),
    "tetrahedron": (4, 10),
    "hexahedron": (8, 27),
    "quadrilateral8": (4, 8),
    "hexahedron20": (8, 20),
}


def inner_points(cell, n=7, seed=0):
    """Random points inside the reference domain."""
    random = np.random.default_rng(seed)
    if CELLS[cell].is_tensor:
        return random.uniform(-0.9, 0.9, (n, CELLS[cell].dim))
    return random.dirichlet(np.full(CELLS[cell].dim + 1, 2.0), n)[:, 1:]


def distorted(cell, degree, count=5, size=0.15, seed=1):
    """Node coordinates of randomly distorted cells (count, n_nodes, d), curved at degree 2."""
    random = np.random.default_rng(seed)
    nodes = reference_nodes(cell, degree)
    size = size if CELLS[cell].is_tensor else 0.4 * size
    return nodes + size * random.uniform(-1, 1, (count, *nodes.shape))


@pytest.mark.parametrize("cell", ALL)
@pytest.mark.parametrize("degree", [1, 2])
def test_nodes_and_shape(cell, degree):
    nodes = reference_nodes(cell, degree)
    assert len(nodes) == n_nodes(cell, degree) == COUNTS[cell][degree - 1]
    np.testing.assert_allclose(shape(cell, degree, nodes), np.eye(len(nodes)), atol=1e-15)
    xi = inner_points(cell)
    np.testing.assert_allclose(shape(cell, degree, xi).sum(axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(shape_gradient(cell, degree, xi).sum(axis=1), 0.0, atol=1e-14)
    np.testing.assert_allclose(shape(cell, degree, xi) @ nodes, xi, atol=1e-14)
    step = 1e-6 * np.eye(CELLS[cell].dim)
    for axis, h in enumerate(step):
        slope = (shape(cell, degree, xi + h) - shape(cell, degree, xi - h)) / 2e-6
        np.testing.assert_allclose(shape_gradient(cell, degree, xi)[:, :, axis], slope, atol=1e-9)


@pytest.mark.parametrize("cell", SOLID)
def test_degree_2_space_is_complete(cell):
    """Quadratic monomials (all products of them on complete tensor cells) are reproduced."""
    nodes, xi = reference_nodes(cell, 2), inner_points(cell)
    for powers in itertools.product(range(3), repeat=CELLS[cell].dim):
        if (CELLS[cell].is_tensor and CELLS[cell].complete is None) or sum(powers) <= 2:
            values = (nodes ** np.array(powers)).prod(axis=1)
            expected = (xi ** np.array(powers)).prod(axis=1)
            np.testing.assert_allclose(shape(cell, 2, xi) @ values, expected, atol=1e-14)


@pytest.mark.parametrize("cell", SOLID)
def test_node_positions_follow_the_tables(cell):
    nodes, corners = reference_nodes(cell, 2), reference_nodes(cell, 1)
    first = len(corners)
    np.testing.assert_allclose(
        nodes[first : first + len(edge_nodes(cell))], corners[edge_nodes(cell)].mean(axis=1)
    )
    first += len(edge_nodes(cell))
    np.testing.assert_allclose(
        nodes[first : first + len(face_nodes(cell))], corners[face_nodes(cell)].mean(axis=1)
    )
    assert face_nodes(cell).shape == ((6, 4) if cell == "hexahedron" else (0, 4))
    assert edge_nodes(cell).dtype == face_nodes(cell).dtype == facet_nodes(cell, 2).dtype == np.int64


def test_hexahedron_faces_in_vtk_order():
    np.testing.assert_allclose(
        reference_nodes("hexahedron", 2)[20:],
        [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1], [0, 0, 0]],
    )


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("degree", [1, 2])
def test_facet_is_trace_of_parent(cell, degree):
    facet = CELLS[cell].facet
    xi = inner_points(facet)
    on_facet, on_cell = shape(facet, degree, xi), facet_points(cell, xi)
    for numbers, points in zip(facet_nodes(cell, degree), on_cell, strict=True):
        parent = shape(cell, degree, points)
        np.testing.assert_allclose(parent[:, numbers], on_facet, atol=1e-14)
        others = np.setdiff1d(np.arange(parent.shape[1]), numbers)
        np.testing.assert_allclose(parent[:, others], 0.0, atol=1e-14)
        np.testing.assert_allclose(on_facet @ reference_nodes(cell, degree)[numbers], points, atol=1e-14)


@pytest.mark.parametrize("cell", SOLID)
def test_reference_area_vectors(cell):
    area = facet_area_vectors(cell)
    outward = reference_nodes(cell, 1)[facet_nodes(cell, 1)].mean(axis=1) - reference_nodes(cell, 1).mean(
        axis=0
    )
    assert ((area * outward).sum(axis=1) > 0).all()
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-15)


def test_meshio_names_and_bad_arguments():
    assert set(MESHIO_NAMES) == {(cell, p) for cell in ALL for p in (1, 2) if p == 2 or CELLS[cell].complete is None}
    with pytest.raises(ValueError, match="degree 3"):
        shape("triangle", 3, np.zeros((1, 2)))
    with pytest.raises(ValueError, match="expected"):
        shape("triangle", 1, np.zeros((1, 3)))
    with pytest.raises(ValueError, match="0 to 20"):
        quadrature("triangle", 21)
