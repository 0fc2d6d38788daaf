"""Groups of a mesh by the places of their members."""

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.mesh.raw import cells_by_place, complete, facets_by_place, nodes_by_place
from pcontact.mesh.read import read_mesh


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("simplices", [False, True])
def test_the_groups_of_the_file(tmp_path, dim, simplices):
    """Two blocks whose surfaces lie on each other."""
    cell = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}[dim][simplices]
    raw = read_mesh(two_blocks(tmp_path / "b.msh", dim, 3, 2, cell))
    up = dim - 1
    upper = cells_by_place(raw, lambda x, normal: x[:, up] > 1.0)
    np.testing.assert_array_equal(upper, raw.cell_groups["upper"])

    def level(x, normal):
        return abs(x[:, up] - 1.0) < 1e-9

    for found, name in (
        (facets_by_place(raw, level, upper), "upper_bottom"),
        (facets_by_place(raw, level, raw.cell_groups["lower"]), "lower_top"),
        (facets_by_place(raw, lambda x, normal: level(x, normal) & (normal[:, up] < -0.9)), "upper_bottom"),
    ):
        np.testing.assert_array_equal(found, raw.facet_groups[name])
    assert not len(facets_by_place(raw, lambda x, normal: level(x, normal) & (abs(normal[:, 0]) > 0.5))[0])
    both = facets_by_place(raw, level)
    assert len(both[0]) == len(raw.facet_groups["upper_bottom"][0]) + len(raw.facet_groups["lower_top"][0])


def test_nodes_that_come_with_degree_2(tmp_path):
    """Of edges on the line; a circle that goes through both ends of an edge has not its middle."""
    raw = read_mesh(two_blocks(tmp_path / "b.msh", 2, 2, 2))
    for name, test in (("line", lambda x, normal: abs(x[:, 1]) < 1e-9),
                       ("circle", lambda x, normal: abs(np.hypot(x[:, 0] - 0.25, x[:, 1]) - 0.25) < 1e-9)):  # fmt: skip
        raw.node_groups[name], raw.edge_groups[name] = nodes_by_place(raw, test, raw.cell_groups["lower"])
    fine = complete(raw, 2)
    assert len(raw.node_groups["line"]) == 3 and len(fine.node_groups["line"]) == 5
    np.testing.assert_allclose(np.sort(fine.points[fine.node_groups["line"], 0]), [0.0, 0.25, 0.5, 0.75, 1.0])
    assert len(raw.node_groups["circle"]) == len(fine.node_groups["circle"]) == 2
