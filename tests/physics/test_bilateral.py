"""Contact that bears tension: between places that lie opposite each other, not with what juts out over the border."""

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
GAP = 0.2


def overhanging(path, dim, law):
    """A block, and a wider one above a gap that its way down just closes: no stress, were it not pulled sideways."""
    if WORLD.rank == 0:
        two_blocks(path, dim, 2, 4, gap=GAP, widths=[1.0, 2.0], offset=-0.5)
    WORLD.Barrier()
    still = [0.0] * dim
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", search_radius=0.6, **law)],
        displacements=[
            Displacement("lower_bottom", still),
            Displacement("upper_top", [*still[1:], -GAP]),
        ],
        petsc={"snes_rtol": 1e-12, "pc_type": "lu"},
        output=Output(fields=False),
    )


class Last(Observer):
    """Observer: the last record."""

    def step(self, step, u, record):
        self.record = record


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", [{"bilateral": True}, {"bilateral": True, "friction": 0.3}, {"tied": True}])
def test_what_juts_out_is_not_pulled_to_the_border(tmp_path, dim, law):
    """Points up to three gaps beside the lower block would be drawn to its rim, along normals 70 degrees askew."""
    simulation, last = Simulation(overhanging(tmp_path / "b.msh", dim, law)), Last()
    try:
        (pair,) = simulation.problem.contacts[0].pairs
        assert simulation.run(None, [last])
        x, paired = pair.source.x[:, :-1], pair.pairing.paired
        np.testing.assert_array_equal(paired, ((x > 0.0) & (x < 1.0)).all(axis=1))
        if "tied" not in law:
            assert np.abs(last.record["contacts"]["pair"]["force"]).max() < 1e-9
    finally:
        simulation.close()


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [None, 0.3])
def test_a_body_that_a_contact_holds_which_bears_tension_is_not_free(shared_tmp, friction):
    """It goes along with the other one, without any force."""
    path = shared_tmp / "b.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 2, 3)
    WORLD.Barrier()
    scene = Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", bilateral=True, friction=friction)],
        displacements=[Displacement("lower", [0.0, -0.1]), Displacement("upper_left", [0.0, "free"])],
        output=Output(fields=False, probes=["upper_top"]),
    )
    simulation, last = Simulation(scene), Last()
    try:
        assert simulation.run(None, [last])
        assert last.record["free"] == []
        np.testing.assert_allclose(last.record["probes"]["upper_top"]["mean"], [0.0, -0.1], atol=1e-8)
    finally:
        simulation.close()


def apart(path, amplitude):
    """Two blocks apart by a gap, held at their ends, that contact draws together in two load steps."""
    if WORLD.rank == 0:
        two_blocks(path, 2, 2, 2, gap=GAP)
    WORLD.Barrier()
    keys = {"bilateral": True, "search_radius": 0.6, "interference_amplitude": amplitude}
    return Scene(
        mesh=MeshSpec(path), materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", **keys)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, 0.0])],
        steps=Steps(count=2), petsc={"snes_rtol": 1e-12, "pc_type": "lu"}, output=Output(fields=False),
    )  # fmt: skip


class Forces(Observer):
    """Observer: the force of every load step."""

    def __init__(self):
        self.found = []

    def step(self, step, u, record):
        self.found.append(np.linalg.norm(record["contacts"]["pair"]["force"]))


def test_gap_that_closes_over_the_time(tmp_path):
    """Half of it in the first of two load steps; without an amplitude all of it, half of that in half of the step, as
    a cut leaves it, and no more comes."""
    found = {}
    for amplitude in ([(0.0, 0.0), (1.0, 1.0)], None):
        simulation, forces = Simulation(apart(tmp_path / "b.msh", amplitude)), Forces()
        try:
            pair, u = simulation.problem.contacts[0].pairs[0], simulation.problem.space.vector()
            pair.search.measure(u, 0.0)
            gap = pair.search.find(u, 0.25).gap
            np.testing.assert_allclose(gap, GAP * (0.5 if amplitude is None else 0.25), rtol=1e-9)
            assert simulation.run(None, [forces])
            found[amplitude is None] = forces.found
        finally:
            simulation.close()
    assert found[True][0] > 1.0
    # partners are found on the deformed bodies
    np.testing.assert_allclose(found[True], found[True][0], rtol=0.02)
    np.testing.assert_allclose(found[False], [0.5 * found[True][0], found[True][0]], rtol=0.02)
