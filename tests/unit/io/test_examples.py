"""Scenes of the repository that are put into a folder."""

import pytest

from pcontact.io import examples
from pcontact.io.examples import lay_out
from pcontact.runtime.errors import InputError
from pcontact.scene.reader import read_scene


def test_what_is_there_already_stays(tmp_path):
    (tmp_path / "water.msh").write_text("a mesh")
    path = lay_out("water", tmp_path)
    assert path.read_text() == (examples.FOLDER / "water.toml").read_text()
    path.write_text("changed")
    assert lay_out("water", tmp_path).read_text() == "changed" and (tmp_path / "water.msh").read_text() == "a mesh"


def test_an_installation_without_examples_has_the_scene_of_new(tmp_path, monkeypatch):
    monkeypatch.setattr(examples, "FOLDER", tmp_path / "none")
    path = lay_out("press", tmp_path / "demo")
    assert read_scene(path).steps.count == 8
    path.write_text("changed")
    assert lay_out("press", tmp_path / "demo").read_text() == "changed"


def test_a_mesh_that_cannot_be_made(tmp_path, monkeypatch):
    """The generator's last line is the reason."""
    monkeypatch.setattr(examples, "FOLDER", tmp_path / "examples")
    examples.FOLDER.mkdir()
    text = (examples.ROOT / "drivers" / "examples" / "water.toml").read_text()
    (examples.FOLDER / "water.toml").write_text(text.replace("meshes beam", "meshes beem"))
    with pytest.raises(InputError, match=r"water\.msh: found no mesh, .*beem.*; allowed: -m meshes beem"):
        lay_out("water", tmp_path)
