"""Scenes written to a file say what they said."""

from dataclasses import replace
from pathlib import Path

import pytest

from pcontact.scene.reader import read_scene
from pcontact.scene.writer import tables_of, text

EXAMPLES = sorted(Path(__file__).parents[3].glob("drivers/examples/*.toml"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_read_as_it_was_written(tmp_path, path):
    """From another folder, whose files are those beside the first one."""
    (tmp_path / path.name).write_text(path.read_text())
    for line in path.read_text().splitlines():
        key, _, value = line.partition(" = ")
        if key == "file":
            (tmp_path / value.split('"')[1]).touch()
    scene = read_scene(tmp_path / path.name)
    other = tmp_path / "a" / "b"
    other.mkdir(parents=True)
    (other / "again.toml").write_text(text(tables_of(scene, other)))
    again = read_scene(other / "again.toml")
    assert again.mesh_path.resolve() == scene.mesh_path.resolve()
    again.mesh = replace(again.mesh, file=scene.mesh.file)
    again.path = scene.path
    assert again == scene


def test_what_has_no_text_is_refused(tmp_path):
    """A function of Python."""
    scene = read_scene(_press(tmp_path))
    scene.displacements[0].value = [lambda x, t: x[:, 0], 0.0, 0.0]
    with pytest.raises(TypeError, match="function has no text"):
        tables_of(scene, tmp_path)


def _press(folder):
    (path := folder / "press.toml").write_text((EXAMPLES[0].parent / "press.toml").read_text())
    (folder / "press.msh").touch()
    return path
