"""Bodies as VTK's meshes: skins are closed, sections whole, means at nodes stay in their body."""

import numpy as np
import pytest

from pcontact.element.reference import MESHIO_NAMES, reference_nodes
from pcontact.io.fields import Piece

pytest.importorskip("pyvista")

from pcontact.view import cells, shapes  # noqa: E402

SOLIDS = [(cell, degree) for cell in ("tetrahedron", "hexahedron") for degree in (1, 2)] + [("hexahedron20", 2)]


def solid(cell, degree):
    """One cell: the unit tetrahedron or the cube [-1, 1]^3, and its surface."""
    points = reference_nodes(cell, degree)
    piece = Piece(points, [(MESHIO_NAMES[cell, degree], np.arange(len(points))[None])])
    return piece, (1.5 + np.sqrt(3) / 2 if cell == "tetrahedron" else 24.0)


def length(lines):
    return lines.compute_cell_sizes(length=True, area=False, volume=False)["Length"].sum()


@pytest.mark.parametrize("cell, degree", SOLIDS)
def test_skin_of_a_cell_is_closed(cell, degree):
    piece, area = solid(cell, degree)
    shape = shapes.bodies(piece, piece.points)
    (skin, lit), = shape.faces
    assert lit and skin.area == pytest.approx(area) and skin.triangulate().clean().is_manifold
    edges = 3 + 3 * np.sqrt(2) if cell == "tetrahedron" else 24.0
    assert length(shape.lines[0]) == pytest.approx(edges), "each edge once, and nothing that only divides a facet"


@pytest.mark.parametrize("cell, degree", SOLIDS)
def test_section_has_the_area_and_the_outline_of_the_exact_cut(cell, degree):
    piece, _ = solid(cell, degree)
    values = piece.points @ [1.0, 2.0, 3.0]
    shape = shapes.bodies(piece, piece.points, values, "point", plane=((0.0, 0.0, 1.0), 0.3))
    section = shape.faces[1][0]
    side = 0.7 if cell == "tetrahedron" else 2.0
    half = 0.5 if cell == "tetrahedron" else 1.0
    np.testing.assert_allclose(section.points[:, 2], 0.3, atol=1e-6)
    assert section.area == pytest.approx(half * side**2, rel=1e-6)
    outline = (2 + np.sqrt(2)) * side if cell == "tetrahedron" else 4 * side
    assert length(shape.lines[1]) == pytest.approx(outline, rel=1e-6), "inner divisions are not drawn"
    np.testing.assert_allclose(section[shapes.VALUE], section.points @ [1.0, 2.0, 3.0], atol=1e-5)
    kept = shape.faces[0][0]
    assert kept.points[:, 2].max() <= 0.3 + 1e-6


def test_means_at_nodes_stay_in_their_body():
    """Two squares that share an edge, of one body or of two."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], dtype=float)
    piece = Piece(points, [("quad", np.array([[0, 1, 4, 3], [1, 2, 5, 4]]))])
    (faces, lit), = shapes.bodies(piece, points, np.array([1.0, 3.0]), smooth=True).faces
    assert not lit
    np.testing.assert_array_equal(np.unique(faces[shapes.VALUE]), [1.0, 2.0, 3.0])
    piece.cell_data["body"] = [np.array([0, 1])]
    own = cells.apart(piece)
    (faces, _), = shapes.bodies(own, own.points, np.array([1.0, 3.0]), smooth=True).faces
    np.testing.assert_array_equal(np.unique(faces[shapes.VALUE]), [1.0, 3.0])


def test_idle_facets_are_grey_or_left_out():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], dtype=float)
    piece = Piece(points, [("quad", np.array([[0, 1, 4, 3], [1, 2, 5, 4]]))])
    values = np.array([0.0, 2.0])
    (faces, _), = shapes.contact(piece, points, values, idle="grey").faces
    np.testing.assert_array_equal(faces[shapes.VALUE], [np.nan, 2.0])
    (faces, _), = shapes.contact(piece, points, values, idle="drop").faces
    np.testing.assert_array_equal(faces[shapes.VALUE], [2.0])
    assert not shapes.contact(piece, points, 0 * values, idle="drop").faces
