"""The error to reach: from the scene, from the command line, and who wins."""

import pytest

from pcontact.adapt.loop import Loop
from pcontact.adapt.passes import wanted
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import own_options
from pcontact.scene.model import Contact, Coupling, Load, Temperature
from pcontact.scene.reader import read_scene
from pcontact.scene.target import Target
from tests.support.bad_input import SCENE, mesh_text


def scene_of(folder, accuracy=""):
    (folder / "mesh.msh").write_text(mesh_text())
    (folder / "scene.toml").write_text(f"{accuracy}\n{SCENE}")
    return read_scene(folder / "scene.toml")


def asked(scene, options):
    with own_options():
        read = Options()
        read.give(options)
        return wanted(scene, read)


def test_nothing_is_wanted(tmp_path):
    assert asked(scene_of(tmp_path), {}) is None
    assert asked(scene_of(tmp_path, 'accuracy = "draft"'), {}) is None


@pytest.mark.parametrize("text", ["2%", "0.02", "2 %", "2e-2"])
def test_of_the_command_line(tmp_path, text):
    found = asked(scene_of(tmp_path), {"error": text, "error_of": "force:pair", "error_memory": "2 GB"})
    assert found.accuracy.error == pytest.approx(0.02) and found.accuracy.quantity == "force"
    assert found.accuracy.name == "pair" and found.accuracy.budget.memory == 2.0**31


def test_the_least_error(tmp_path):
    found = asked(scene_of(tmp_path), {"error": "best", "error_time": "1min"}).accuracy
    assert found.best and found.words == "best" and found.budget.time == 60.0
    text = 'accuracy = { error = "best", budget = { unknowns = 1e4 } }'
    assert asked(scene_of(tmp_path, text), {}).accuracy.best and not Target(0.1).best


def test_of_the_scene(tmp_path):
    text = 'accuracy = { error = "1%", of = "support:upper_top", budget = { unknowns = 2e6, time = "10 min" } }'
    scene = scene_of(tmp_path, text)
    assert isinstance(scene.accuracy, Target)
    found = asked(scene, {}).accuracy
    assert (found.error, found.of) == (0.01, "support:upper_top")
    assert (found.budget.unknowns, found.budget.time, found.budget.memory) == (2e6, 600.0, None)
    found = asked(scene, {"error": "3%"}).accuracy
    assert (found.error, found.of, found.budget.time) == (0.03, "support:upper_top", 600.0)
    assert scene.accuracy.error == 0.01
    # a word of the command line is another wish
    assert asked(scene, {"accuracy": "draft"}) is None
    with pytest.raises(InputError, match="-accuracy: found a preset beside an error to reach"):
        asked(scene, {"accuracy": "draft", "error": "3%"})


def test_a_suffix_is_a_component_unless_a_name_has_it(tmp_path):
    """Of forces and displacements; the pressure of a contact has none."""
    found = asked(scene_of(tmp_path), {"error": "2%", "error_of": "force:pair.y"}).accuracy
    assert found.of_known(["pair"]) == ("pair", 1)
    assert Target(0.1, "force:pair.y").of_known(["pair.y", "pair"]) == ("pair.y", None)
    assert Target(0.1, "force:pair.xy").of_known(["pair"]) == ("pair.xy", None)
    for of in ("pressure:pair.x", "force:pair.n", "force:pear.x"):
        with pytest.raises(InputError, match=r"accuracy\.of: found .*the nearest is"):
            asked(scene_of(tmp_path), {"error": "2%", "error_of": of})
    with pytest.raises(InputError, match=r"accuracy\.of: found 'force:pair.z'; allowed: components x, y, the mesh"):
        Loop(asked(scene_of(tmp_path), {"error": "2%", "error_of": "force:pair.z"})).run()


def test_what_is_not_estimated_is_refused(tmp_path):
    scene = scene_of(tmp_path)
    scene.mesh.strain = "finite"
    with pytest.raises(InputError, match=r"accuracy\.error: found 0\.02 together with finite strain \(body lower\)"):
        asked(scene, {"error": "2%"})
    scene = scene_of(tmp_path)
    scene.contacts = [Contact("upper_bottom", "lower_top", name="pair", formulation="penalty")]
    with pytest.raises(InputError, match=r'accuracy\.error: found .*"penalty"; allowed: "nitsche"'):
        asked(scene, {"error": "2%"})
    scene.contacts = [Contact("upper_bottom", "lower_top", name="pair", pressure_overclosure=1.0)]
    with pytest.raises(InputError, match=r"accuracy\.error: found .*pressure_overclosure \(contact pair\)"):
        asked(scene, {"error": "2%"})
    with pytest.raises(InputError, match=r"accuracy\.of: .*there are none\); probes of \[output\]"):
        asked(scene_of(tmp_path), {"error": "2%", "error_of": "displacement:upper_top"})
    (tmp_path / "warm.vtu").touch()
    for key, one, found in (
        ("loads", Load(force=[0.0, -1.0], at=[0.0, 0.0]), r"loads\[0\].*at"),
        ("couplings", Coupling("upper_top"), r"couplings\[0\].* without point"),
        ("temperatures", Temperature(file="warm.vtu", field="T"), r"temperatures\[0\].*file"),
    ):
        scene = scene_of(tmp_path)
        setattr(scene, key, [one])
        with pytest.raises(InputError, match=rf"accuracy\.error: found 0\.02 together with {found}"):
            asked(scene, {"error": "2%"})
    with pytest.raises(InputError, match="-restart"):
        asked(scene_of(tmp_path), {"error": "2%", "restart": "there"})
