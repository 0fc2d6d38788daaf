"""Presets of accuracy: applied, overridden key by key, reported; bad values."""

import json

import pytest

from drivers._common import make_mesh, running
from drivers.rings import ring_scene
from meshes import rings
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import PETSc
from pcontact.runtime.presets import PRESETS, Choice
from pcontact.scene.validate import validate


def scene_of(folder, accuracy=None, **petsc):
    scene = ring_scene(make_mesh(rings, folder / "rings.msh", n=8, order=2), 1, 0.0, gamma0=None)
    scene.accuracy, scene.petsc = accuracy, petsc
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


def test_keys(monkeypatch):
    """A key of the scene: the preset's value where nobody says one, of one pair or of all."""
    keys = {"order": 2, "quadrature": 3}
    monkeypatch.setitem(PRESETS, "standard", PRESETS["standard"].__class__({}, 1e-2, 1e-5, keys))
    choice = Choice()
    choice.name = "standard"
    assert (
        choice.key("order", None) == 2
        and choice.key("quadrature", [None, 7]) == 3
        and choice.key("theta", None) is None
    )
    assert choice.chosen == keys and choice.overridden == {"quadrature": 7}
    other = Choice()
    other.name = "standard"
    assert other.key("order", 1) is None and other.key("quadrature", [None, 7], 9) is None
    assert not other.chosen and other.overridden == {"order": 1, "quadrature": 9}


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
