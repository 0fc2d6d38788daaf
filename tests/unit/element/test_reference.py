"""Reference cells, shape functions, quadrature and geometry."""

import itertools
import math

import numpy as np
import pytest

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import (
    CELLS,
    MESHIO_NAMES,
    edge_nodes,
    face_nodes,
    facet_area_vectors,
    facet_kinds,
    facet_nodes,
    facet_points,
    n_nodes,
    reference_nodes,
    shape,
    shape_gradient,
)

SOLID = ["triangle", "quadrilateral", "tetrahedron", "hexahedron", "quadrilateral8", "hexahedron20", "wedge", "wedge15",
         "pyramid", "pyramid13"]  # fmt: skip
ALL = ["segment", *SOLID]
COUNTS = {
    "segment": (2, 3),
    "triangle": (3, 6),
    "quadrilateral": (4, 9),
    "tetrahedron": (4, 10),
    "hexahedron": (8, 27),
    "quadrilateral8": (4, 8),
    "hexahedron20": (8, 20),
    "wedge": (6, 18),
    "wedge15": (6, 15),
    "pyramid": (5, 14),
    "pyramid13": (5, 13),
}


def inner_points(cell, n=7, seed=0):
    """Random points inside the reference domain."""
    random = np.random.default_rng(seed)
    if CELLS[cell].is_tensor:
        return random.uniform(-0.9, 0.9, (n, CELLS[cell].dim))
    if CELLS[cell].is_wedge:
        return np.hstack([inner_points("triangle", n, seed), random.uniform(-0.9, 0.9, (n, 1))])
    if CELLS[cell].is_pyramid:
        xi = random.uniform([-0.9, -0.9, 0.1], 0.9, (n, 3))
        xi[:, :2] *= 1.0 - xi[:, 2:]
        return xi
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
    assert face_nodes(cell).shape == ({"hexahedron": 6, "wedge": 3, "pyramid": 1}.get(cell, 0), 4)
    tables = [facet_nodes(kind, 2) for kind, _ in facet_kinds(cell)]
    assert {table.dtype for table in (edge_nodes(cell), face_nodes(cell), *tables)} == {np.dtype(np.int64)}


def test_hexahedron_faces_in_vtk_order():
    np.testing.assert_allclose(
        reference_nodes("hexahedron", 2)[20:],
        [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1], [0, 0, 0]],
    )


@pytest.mark.parametrize("cell", SOLID)
@pytest.mark.parametrize("degree", [1, 2])
def test_facet_is_trace_of_parent(cell, degree):
    for kind, rows in facet_kinds(cell):
        facet = CELLS[kind].facet
        xi = inner_points(facet)
        on_facet, on_cell = shape(facet, degree, xi), facet_points(kind, xi)[rows]
        for numbers, points in zip(facet_nodes(kind, degree)[rows], on_cell, strict=True):
            parent = shape(cell, degree, points)
            np.testing.assert_allclose(parent[:, numbers], on_facet, atol=1e-14)
            others = np.setdiff1d(np.arange(parent.shape[1]), numbers)
            np.testing.assert_allclose(parent[:, others], 0.0, atol=1e-14)
            np.testing.assert_allclose(on_facet @ reference_nodes(cell, degree)[numbers], points, atol=1e-14)


@pytest.mark.parametrize("cell", SOLID)
def test_reference_area_vectors(cell):
    total = np.zeros(CELLS[cell].dim)
    for kind, rows in facet_kinds(cell):
        area, nodes = facet_area_vectors(kind)[rows], reference_nodes(cell, 1)
        outward = nodes[facet_nodes(kind, 1)[rows]].mean(axis=1) - nodes.mean(axis=0)
        assert ((area * outward).sum(axis=1) > 0).all()
        total += quadrature(CELLS[kind].facet, 1)[1].sum() * area.sum(axis=0)
    np.testing.assert_allclose(total, 0.0, atol=1e-14)


@pytest.mark.parametrize("cell", ["wedge", "pyramid"])
@pytest.mark.parametrize("degree", [1, 4, 7])
def test_quadrature_of_wedges_and_pyramids(cell, degree):
    """Polynomials of the degree, against their integrals over the plane sections, whose sides shrink as 1 - z."""
    points, weights = quadrature(cell, degree)
    assert weights.min() > 0.0
    for a, b, c in itertools.product(range(degree + 1), repeat=3):
        if a + b + c > degree:
            continue
        if cell == "wedge":
            flat = math.factorial(a) * math.factorial(b) / math.factorial(a + b + 2)
            exact = flat * (1 + (-1) ** c) / (c + 1)
        else:
            square = (1 + (-1) ** a) * (1 + (-1) ** b) / ((a + 1) * (b + 1))
            # int z^c (1 - z)^(a + b + 2) dz
            exact = square * math.factorial(c) * math.factorial(a + b + 2) / math.factorial(a + b + c + 3)
        assert weights @ (points ** [a, b, c]).prod(axis=1) == pytest.approx(exact, rel=1e-12, abs=1e-14)


def test_gradients_at_the_apex_are_finite():
    assert np.isfinite(shape_gradient("pyramid", 2, np.array([[0.0, 0.0, 1.0]]))).all()


def test_meshio_names_and_bad_arguments():
    assert set(MESHIO_NAMES) == {(cell, p) for cell in ALL for p in (1, 2) if p == 2 or CELLS[cell].complete is None}
    assert {c.name for c in CELLS.values() if c.whole is None} == set(ALL)
    with pytest.raises(ValueError, match="degree 3"):
        shape("triangle", 3, np.zeros((1, 2)))
    with pytest.raises(ValueError, match="expected"):
        shape("triangle", 1, np.zeros((1, 3)))
    with pytest.raises(ValueError, match="0 to 20"):
        quadrature("triangle", 21)
