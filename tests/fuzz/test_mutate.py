"""Some damaged inputs, and whether the second reader reads what the first one does."""

import mutate
import numpy as np
import pytest
from grids import msh_text
from independent import Unread, area_vectors, count, mesh_of, volume
from scenes import PLAIN, scene_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """Files of a base in space."""
    place = tmp_path_factory.mktemp("base") / "base"
    mutate.write_base(place, 1)
    return place


@pytest.mark.parametrize("name", ["text4", "binary4", "binary2"])
def test_all_formats_are_the_same_mesh(base, name):
    one, other = (_places(mesh_of((base / f"{which}.msh").read_bytes())) for which in ("mesh", name))
    assert one == other and len(one) >= 12


def _places(mesh):
    """Where the members of every group are, whatever their numbers."""
    places = [tuple(row) for row in mesh.points.round(12).tolist()]
    found = {name: {places[k] for k in nodes} for name, nodes in mesh.vertices.items()}
    for groups in (mesh.bodies, mesh.facets):
        for name, elements in groups.items():
            found[name] = {frozenset(places[k] for k in row) for e in elements for row in e.nodes}
    return found


def test_what_is_damaged_is_not_read(base):
    data = (base / "binary4.msh").read_bytes()
    for part in (data[:-100], data[:300], b""):
        with pytest.raises(Unread):
            mesh_of(part)


def test_counts_and_sizes():
    """Of boxes: their sides, their volume, their nodes of degree 2."""
    case = scene_of(0, {**PLAIN, "dim": 3, "arrangement": "stack", "bodies": 2, "kind0": "pair",
                        "low.cell": "hexahedron",
                        "low.curved": (0, 0), "middle.curved": (0, 0), "degree": 1, "order": 2, "low.n0": 2,
                        "low.n1": 1, "low.n2": 2, "low.height": 1.0, "middle.cell": "tetrahedron", "middle.n0": 1,
                        "middle.n1": 1, "middle.n2": 1, "middle.width": 0.5, "middle.height": 0.6,
                        "floor": False})  # fmt: skip
    assert volume(case.mesh, "low") == pytest.approx(1.0)
    assert volume(case.mesh, "middle") == pytest.approx(0.15)
    total, area = area_vectors(case.mesh, "low_z1")
    assert np.allclose(total, [0.0, 0.0, 1.0]) and area == pytest.approx(1.0)
    assert count(case.scene, case.mesh) == {"cells": 4 + 6, "dofs": 3 * (5 * 3 * 5 + 8 + 19)}
    assert mesh_of(msh_text(case.mesh).encode()).points.shape == case.mesh.points.shape


def test_damaged_scenes_and_meshes():
    """Refused with one line, or read as the second reader reads them."""
    said = []
    failures = mutate.campaign(16, 7, [1], said.append, targets=("scene", "msh"))
    assert not failures, "\n".join(said)
