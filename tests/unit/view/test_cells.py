"""What is drawn of cells: edges, middles, chains of segments."""

import numpy as np
import pytest

from pcontact.element.reference import CELLS, MESHIO_NAMES, reference_nodes
from pcontact.io.fields import Piece
from pcontact.view import cells


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("degree", [1, 2])
def test_edges_and_middles_of_a_plane_cell(cell, degree):
    points = np.pad(reference_nodes(cell, degree), ((0, 0), (0, 1)))
    piece = Piece(points, [(MESHIO_NAMES[cell, degree], np.arange(len(points))[None])])
    lines = cells.edges(piece).reshape(-1, degree + 2)
    assert len(lines) == CELLS[cell].n_vertices and (lines[:, 0] == degree + 1).all()
    if degree == 2:
        ends = points[lines[:, [1, 3]]]
        np.testing.assert_allclose(points[lines[:, 2]], ends.mean(axis=1))
    middle, area, owner = cells.middles(piece, points)
    assert np.linalg.norm(area) == pytest.approx({"triangle": 0.5, "quadrilateral": 4.0}[cell])
    np.testing.assert_allclose(middle[0], points[: CELLS[cell].n_vertices].mean(axis=0))
    assert owner.tolist() == [0]


def test_arc_length_follows_the_chain_whatever_the_numbering():
    rng = np.random.default_rng(3)
    angle = np.linspace(0, np.pi / 2, 41)
    place = rng.permutation(41)
    points = np.empty((41, 3))
    points[place] = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    nodes = np.column_stack([place[:-1], place[1:]])
    swapped = rng.random(40) < 0.5
    nodes[swapped] = nodes[swapped, ::-1]
    nodes = nodes[rng.permutation(40)]
    order, length, turned = cells.arc_length(nodes, points)
    ends = nodes[order].copy()
    ends[turned] = ends[turned, ::-1]
    np.testing.assert_array_equal(ends[1:, 0], ends[:-1, 1])
    np.testing.assert_allclose(length[1:, 0], length[:-1, 1])
    assert length[-1, 1] == pytest.approx(np.pi / 2, rel=1e-3)


def test_bodies_share_no_nodes_afterwards():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], dtype=float)
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    piece = Piece(points, [("quad", quads)], {"t": points[:, 0]}, {"body": [np.array([0, 1])]})
    own = cells.apart(piece)
    (_, table), = own.cells
    assert len(own.points) == 8 and not set(table[0]) & set(table[1])
    np.testing.assert_array_equal(own.points[table], points[quads])
    np.testing.assert_array_equal(own.point_data["t"][table], points[quads][..., 0])
