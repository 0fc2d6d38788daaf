"""Presets of accuracy: applied, overridden key by key, reported; bad values."""

import json

import pytest

from drivers._common import make_mesh, running
from drivers.cases.rings import ring_scene
from meshes import rings
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import PETSc
from pcontact.runtime.presets import PRESETS, Choice
from pcontact.scene.validate import validate


def scene_of(folder, accuracy=None, **petsc):
    scene = ring_scene(make_mesh(rings, folder / "rings.msh", n=8, order=2), 1, 0.0, gamma0=None)
    scene.accuracy, scene.petsc, scene.mesh.order = accuracy, petsc, None
    return scene


@pytest.mark.parallel
@pytest.mark.parametrize("name", list(PRESETS))
def test_applied_and_reported(shared_tmp, name):
    scene = scene_of(shared_tmp, name)
    with running(scene, shared_tmp / "out") as (simulation, converged):
        assert converged
        assert simulation.newton.snes.getTolerances()[0] == PRESETS[name].options["snes_rtol"]
        chosen = simulation.accuracy.chosen
        assert chosen["snes_rtol"] == PRESETS[name].options["snes_rtol"] and not simulation.accuracy.overridden
    simulation.comm.Barrier()
    section = json.loads((shared_tmp / "out" / "report.json").read_text())["accuracy"]
    assert section["preset"] == name and section["chosen"]["snes_rtol"] == chosen["snes_rtol"]
    # the next run has none of it
    with running(scene_of(shared_tmp)) as (simulation, _):
        assert simulation.newton.snes.getTolerances()[0] == 1e-8
        assert simulation.accuracy.report() == {"preset": None, "chosen": {}, "overridden": {}}


@pytest.mark.parallel
def test_options_win(shared_tmp):
    """Option over preset, command line over the scene's own word for the preset; the report tells both."""
    database = PETSc.Options()
    database.setValue("accuracy", "draft")
    try:
        with running(scene_of(shared_tmp, "fine", snes_rtol=1e-9)) as (simulation, _):
            assert simulation.accuracy.name == "draft"
            assert simulation.newton.snes.getTolerances()[0] == 1e-9
            assert float(simulation.accuracy.overridden["snes_rtol"]) == 1e-9
            assert "snes_rtol" not in simulation.accuracy.chosen
            assert any("yours instead: snes_rtol" in line for line in simulation.accuracy.lines())
    finally:
        database.delValue("accuracy")


def test_fine_takes_twice_the_load_steps_where_the_answer_depends_on_them():
    for name, remembers, given, count, chosen in (
        ("fine", True, False, 10, {"steps_count": 10}), ("fine", False, False, 5, {}), ("fine", True, True, 5, {}),
        ("standard", True, False, 5, {}), (None, True, False, 5, {}),
    ):  # fmt: skip
        choice = Choice()
        choice.name = name
        assert choice.steps(5, remembers, given) == count and choice.chosen == chosen
        assert choice.overridden == ({"steps_count": 5} if given else {})


def test_degree():
    """That of the mesh, unless the user or a preset says one; without a preset nothing is chosen."""
    for name, degree, said, asked, chosen, overridden in (
        ("standard", 2, None, 2, {"mesh_order": 2}, {}), ("standard", 1, None, 1, {"mesh_order": 1}, {}),
        ("draft", 2, None, 1, {"mesh_order": 1}, {}), ("fine", 2, 1, 1, {}, {"mesh_order": 1}),
        ("fine", 2, 2, 2, {}, {}), (None, 2, None, 2, {}, {}), (None, 1, 2, 2, {}, {}), (None, 2, 1, 1, {}, {}),
        (None, 1, None, 1, {}, {}),
    ):  # fmt: skip
        choice = Choice()
        choice.name = name
        assert choice.order(said, degree) == asked
        assert (choice.chosen, choice.overridden) == (chosen, overridden)


@pytest.mark.parallel
def test_degree_of_a_run(shared_tmp):
    """The mesh of the rings is of degree 2."""
    for accuracy, order, asked in (("standard", None, 2), ("standard", 1, 1), (None, None, 2), (None, 1, 1)):
        scene = scene_of(shared_tmp, accuracy)
        scene.mesh.order = order
        with running(scene) as (simulation, converged):
            assert converged and simulation.problem.space.degree == asked


def test_linear_and_direct():
    """One linear solve has its own tolerance; a direct one none."""

    class Database(dict):
        def propose(self, wanted):
            return wanted, {}

    choice = Choice()
    choice.name = "standard"
    choice.propose(Database(), True)
    assert choice.chosen == {"ksp_rtol": PRESETS["standard"].linear}
    choice.chosen = {}
    choice.propose(Database(pc_type="lu"), False)
    assert choice.chosen == PRESETS["standard"].options


@pytest.mark.parallel
def test_bad_values(shared_tmp):
    scene = scene_of(shared_tmp, "best")
    with pytest.raises(InputError, match="accuracy: found a string 'best'; allowed: .*draft.*standard.*fine"):
        validate(scene)
    database = PETSc.Options()
    database.setValue("accuracy", "best")
    try:
        with pytest.raises(InputError, match="-accuracy: found 'best'; allowed: draft . standard . fine"):
            with running(scene_of(shared_tmp)):
                pass
    finally:
        database.delValue("accuracy")
