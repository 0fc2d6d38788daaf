"""Cutting meshes across a body."""

import numpy as np
import pytest

from meshes.blocks import one_block
from pcontact.element.reference import facet_nodes
from pcontact.mesh.read import complete, read_mesh
from pcontact.mesh.topology import OTHER, components, cut, plane
from pcontact.runtime.errors import InputError


def with_section(path, cell, order):
    """A block of two cells a side with the group "cut" in its middle plane, each facet with its first cell."""
    raw = read_mesh(one_block(path, 2 if cell in ("triangle", "quadrilateral") else 3, 2, cell, order=order))
    seen, cells, local, first = set(), [], [], 0
    for block in raw.blocks:
        for row, nodes in enumerate(block.nodes):
            for number, facet in enumerate(facet_nodes(block.cell, block.degree)):
                key = tuple(sorted(nodes[facet]))
                if np.allclose(raw.points[nodes[facet], -1], 0.5) and key not in seen:
                    seen.add(key)
                    cells.append(first + row)
                    local.append(number)
        first += len(block.nodes)
    raw.facet_groups["cut"] = np.array(cells), np.array(local)
    return raw


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_a_cut_parts_the_mesh(tmp_path, cell, order):
    """Two components with as many facets, nodes in the same places, and nothing else changed."""
    raw = with_section(tmp_path / "block.msh", cell, order)
    before, count = raw.points.copy(), len(raw.facet_groups["cut"][0])
    places = [before[block.nodes] for block in raw.blocks]
    cut(raw, "cut")
    assert components(raw).max() == 1 and len(raw.facet_groups["cut"][0]) == count
    for place, block in zip(places, raw.blocks, strict=True):
        np.testing.assert_array_equal(raw.points[block.nodes], place)
    on_plane = np.isclose(before[:, -1], 0.5).sum()
    assert len(raw.points) == len(before) + on_plane
    sides = [raw.facet_groups[name] for name in ("cut", OTHER.format("cut"))]
    assert len(sides[0][0]) == len(sides[1][0]) and not set(sides[0][0]) & set(sides[1][0])
    completed = complete(raw, 2)
    assert components(completed).max() == 1


def test_groups_of_edges_and_vertices(tmp_path):
    """Edges that end in the section go with their cells, those within it and vertices are there twice."""
    raw = with_section(tmp_path / "block.msh", "hexahedron", 1)
    at = {tuple(point): number for number, point in enumerate(np.round(raw.points, 6))}
    line = [at[0.0, 0.0, z] for z in (0.0, 0.5, 1.0)] + [at[0.5, 0.0, 0.5]]
    raw.edge_groups["line"] = np.array([[line[0], line[1]], [line[1], line[2]], [line[1], line[3]]])
    raw.node_groups["line"] = np.array(sorted(line))
    count = len(raw.points)
    cut(raw, "cut")
    assert len(raw.node_groups["line"]) == 6
    edges = raw.edge_groups["line"]
    assert (edges >= count).sum(axis=1).tolist() == [0, 1, 0, 2]
    assert complete(raw, 2).node_groups["line"].shape == (10,)


def test_facets_of_the_boundary_and_bent_ones_are_refused(tmp_path):
    raw = with_section(tmp_path / "block.msh", "hexahedron", 1)
    with pytest.raises(InputError, match="0 on one side|on one side of their plane"):
        cut(raw, "bottom")
    cells, local = (np.concatenate([raw.facet_groups[name][k] for name in ("bottom", "left")]) for k in (0, 1))
    raw.facet_groups["bent"] = cells, local
    with pytest.raises(InputError, match="not in a plane"):
        cut(raw, "bent")


def test_planes():
    centre, normal, off = plane(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]))
    np.testing.assert_allclose([centre, normal], [[0.5, 0.5, 1.0], [0, 0, 1]], atol=1e-15)
    assert off < 1e-15
