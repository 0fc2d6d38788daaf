"""Forces of a contact, its slip and wear, and the largest values of a load step, in report, history and fields."""

from functools import partial

import numpy as np
import pytest

from meshes import one_block
from pcontact.io.report import read_report
from pcontact.io.result import load_result
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
E, PRESSED, WAY, MU = 100.0, 0.01, 0.3, 0.2


def dragged(path, strain="small", **output):
    """A unit square of a material without lateral strain is pressed on a plane in the first half of the run, and drawn
    along it in the second one."""
    press, draw = [(0.0, 0.0), (0.5, 1.0)], [(0.0, 0.0), (0.5, 0.0), (1.0, 1.0)]
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(E, 0.0)}, [Body("block", "m")],
        [Contact("bottom", obstacle=Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0]), name="floor", friction=MU)],
        [Displacement("top", ["free", -PRESSED], amplitude=press), Displacement("top", [WAY, "free"], amplitude=draw)],
        steps=Steps(count=8), output=Output(**{"slip": True, **output}),
    )  # fmt: skip


def run(scene, directory, restart=None):
    database = PETSc.Options()
    if restart is not None:
        database.setValue("restart", str(restart))
    try:
        simulation = Simulation(scene)
        assert simulation.run(directory)
        simulation.close()
    finally:
        database.delValue("restart")
    WORLD.Barrier()
    return read_report(directory)["steps"]


@pytest.mark.parallel
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_block_that_is_drawn(shared_tmp, strain):
    path = shared_tmp / "block.msh"
    on_root(WORLD, partial(one_block, path, 2, 4))
    steps = run(dragged(path, strain), shared_tmp / "out")
    pressed, last = steps[3]["contacts"]["floor"], steps[-1]["contacts"]["floor"]
    force = E * PRESSED
    assert pressed["max_slip_total"] < 1e-9 and pressed["max_wear_per_coefficient"] < 1e-9
    assert last["normal_force"] == pytest.approx([0.0, -force], rel=0.03, abs=1e-9)
    assert last["friction_force"] == pytest.approx([MU * force, 0.0], rel=0.03, abs=1e-9)
    np.testing.assert_allclose(np.add(last["normal_force"], last["friction_force"]), last["force"], atol=1e-12)
    x, y = last["centre"]
    # the friction turns the block: its pressure is larger in front
    assert 0.5 + 0.7 * WAY < x < 1.3 and y == pytest.approx(0.0, abs=1e-3)
    assert last["moment"] == pytest.approx(x * last["normal_force"][1], rel=1e-2)
    # less what the block is sheared by before it slides
    assert last["max_slip_total"] == pytest.approx(WAY, rel=0.1)
    slips = [step["contacts"]["floor"]["max_slip"] for step in steps]
    assert sum(slips) == pytest.approx(last["max_slip_total"], rel=0.05)
    assert last["wear_volume_per_coefficient"] == pytest.approx(force * last["max_slip_total"], rel=0.1)
    assert last["max_wear_per_coefficient"] > last["wear_volume_per_coefficient"]
    assert last["facets"] == 4
    found = load_result(shared_tmp / "out")
    for name in ("slip", "slip_total", "wear_per_coefficient"):
        top = np.max(found.points["floor"].point_data[name])
        assert top == pytest.approx(last[f"max_{name}"], rel=1e-5) and name in found.surfaces["floor"].cell_data
    top = steps[-1]["largest"]
    assert top["displacement"]["body"] == "block" and top["displacement"]["place"][1] == 1.0
    assert top["displacement"]["value"] == pytest.approx(np.hypot(WAY, PRESSED), rel=1e-2)
    stress = np.concatenate([np.ravel(one) for one in found.bodies.cell_data["equivalent_stress"]])
    assert top["equivalent_stress"]["value"] == pytest.approx(np.max(stress), rel=1e-5)
    assert "equivalent_plastic_strain" not in top


@pytest.mark.parallel
def test_a_restarted_run_goes_on_with_the_slip(shared_tmp):
    path = shared_tmp / "block.msh"
    on_root(WORLD, partial(one_block, path, 2, 2))
    whole = run(dragged(path, fields=False), shared_tmp / "whole")[-1]["contacts"]["floor"]
    first = dragged(path, fields=False, checkpoint=True)
    first.steps.count, first.steps.end = 6, 0.75
    run(first, shared_tmp / "first")
    last = run(dragged(path, fields=False), shared_tmp / "last", restart=shared_tmp / "first")[-1]["contacts"]["floor"]
    for name in ("max_slip_total", "max_wear_per_coefficient", "wear_volume_per_coefficient"):
        assert last[name] == pytest.approx(whole[name], rel=1e-6)


def test_nothing_of_it_unless_asked(tmp_path):
    one_block(tmp_path / "block.msh", 2, 2)
    contact = run(dragged(tmp_path / "block.msh", slip=False, fields=False), tmp_path / "out")[-1]["contacts"]["floor"]
    assert "max_slip" not in contact and "normal_force" in contact
