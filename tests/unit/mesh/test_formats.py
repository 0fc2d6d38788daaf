"""Meshes with groups in formats of other programs: the same groups, whatever the file."""

import meshio
import numpy as np
import pytest

from pcontact.mesh.read import read_mesh

# two bricks on each other, with the lower face of the first one and the upper face of the second one
POINTS = np.array([[x, y, z] for z in range(3) for y in range(2) for x in range(2)], dtype=float)
BRICKS = np.array([[0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]])
FACES = np.array([[0, 2, 3, 1], [8, 9, 11, 10]])
TAGS = [np.array([1, 2]), np.array([3, 4])]


@pytest.mark.parametrize(("suffix", "key"), [("bdf", "nastran:ref"), ("vtk", "cell_tags"), ("vtu", "medit:ref")])
def test_numbers_of_cells_are_groups(tmp_path, suffix, key):
    path = tmp_path / f"m.{suffix}"
    meshio.Mesh(POINTS, [("hexahedron", BRICKS), ("quad", FACES)], cell_data={key: TAGS}).write(path)
    raw = read_mesh(path)
    assert {name: cells.tolist() for name, cells in raw.cell_groups.items()} == {"volume_1": [0], "volume_2": [1]}
    assert {name: rows[0].tolist() for name, rows in raw.facet_groups.items()} == {"surface_3": [0], "surface_4": [1]}
