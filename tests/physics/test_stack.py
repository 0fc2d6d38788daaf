"""The heap: its mesh, loose bodies under a plate or their weight, the same on any ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.stack import History, costs, scene
from meshes import heap
from meshes.heap import layers
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF


@pytest.mark.parametrize("dim, count, n", [(2, 5, 5), (2, 20, 21), (2, 100, 105), (3, 5, 5), (3, 27, 35), (3, 64, 66)])
def test_layers(dim, count, n):
    """Full layers; every body touches neighbours, the outer ones the box; nobody is nearer than the overlap."""
    centres, size = layers(dim, count, 0.01)
    assert len(centres) == n
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + 10.0 * np.eye(n)
    np.testing.assert_allclose(apart.min(axis=1), 1.98, rtol=1e-12)
    np.testing.assert_allclose(np.minimum(centres, size - centres).min(axis=0), 0.99, rtol=1e-12)


@pytest.mark.parametrize("dim, hollow, cell", [(2, 0.0, "triangle"), (2, 0.5, "quadrilateral"), (3, 0.0, None)])
def test_mesh(tmp_path, dim, hollow, cell):
    raw = read_mesh(heap(tmp_path / "h.msh", dim, 5, 0.5, hollow, cell))
    assert components(raw).max() == 4 and list(raw.cell_groups) == ["heap"]
    r = np.linalg.norm(raw.points[:, None] - layers(dim, 5)[0], axis=2).min(axis=1)
    assert r.max() == pytest.approx(1.0, rel=1e-9) and (hollow == 0.0 or r.min() == pytest.approx(hollow, rel=1e-9))


@pytest.mark.parametrize("said, words", [
    ({"overlap": 0.3}, "overlap 0.3"), ({"count": 0}, "count 0"), ({"dim": 3, "cell": "hexahedron"}, "tetrahedron"),
])  # fmt: skip
def test_mesh_refuses(tmp_path, said, words):
    with pytest.raises(ValueError, match=words):
        heap(tmp_path / "h.msh", **said)


def solved(path, comm=WORLD, count=5, **said):
    """Rows and costs of a run. Collective on `comm`."""
    history = History(2, said.get("press", 0.05))
    simulation = Simulation(scene(path, 2, count, steps=2, petsc={"snes_rtol": "1e-10"}, **said), comm)
    try:
        assert simulation.run(None, [history])
        return history, costs(simulation)
    finally:
        simulation.close()


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("said", [{}, {"friction": 0.0}, {"yield_stress": 5.0}])
def test_pressed(shared_tmp, said):
    path = make_mesh(heap, shared_tmp / "h.msh", 2, 5, 0.3)
    history, found = solved(path, **said)
    assert history.cuts == 0 and found["bodies"] == 5
    for row in history.rows:
        assert row["imbalance"] < 1e-7 and row["sum"] < 1e-7 * row["floor"]
    last = history.rows[-1]
    # without friction the walls bear nothing of the plate's force
    if said == {"friction": 0.0}:
        assert last["floor"] == pytest.approx(last["plate"], rel=1e-6)
    else:
        assert 0.5 * last["plate"] < last["floor"] < last["plate"]


@pytest.mark.parallel(2, 3)
def test_weight(shared_tmp):
    """The floor and the friction of the walls bear the weight of all bodies."""
    path = make_mesh(heap, shared_tmp / "h.msh", 2, 5, 0.3)
    history, _ = solved(path, friction=0.0, press=0.0, weight=0.5)
    area = 5 * 0.5 * 24 * np.sin(2.0 * np.pi / 24)
    assert history.rows[-1]["floor"] == pytest.approx(0.5 * area, rel=1e-6)


@pytest.mark.parallel(2, 3)
def test_ranks_do_not_matter(shared_tmp):
    path = make_mesh(heap, shared_tmp / "h.msh", 2, 5, 0.3, 0.5)
    one = solved(path, SELF)[0].rows
    WORLD.Barrier()
    all_, found = solved(path)
    assert found["items"] == 6
    for a, b in zip(one, all_.rows, strict=True):
        assert [a[key] for key in ("open", "stick", "slip")] == [b[key] for key in ("open", "stick", "slip")]
        np.testing.assert_allclose([a["floor"], a["plate"]], [b["floor"], b["plate"]], rtol=1e-6)


def test_cost_per_point_does_not_grow_with_the_bodies(tmp_path):
    """Items, near-null vectors and candidates per point of 21 bodies and of 60."""
    found = []
    for count in (20, 60):
        path = make_mesh(heap, tmp_path / f"h{count}.msh", 2, count, 0.4)
        found.append(solved(path, count=count)[1])
    assert found[0]["items"] == found[1]["items"] and found[0]["near_null"] == found[1]["near_null"] == 3
    # a body inside a heap has more neighbours than one at its rim
    assert found[1]["candidates"] < 1.3 * found[0]["candidates"], found
