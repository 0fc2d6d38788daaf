"""Keys of a scene from the command line: ``-set KEY=VALUE``."""

import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.changes import assigned
from pcontact.scene.reader import read_scene
from pcontact.usage import parse, usage

SCENE = """
[mesh]
file = "m.msh"
[materials."hard steel"]
E = 1.0
nu = 0.3
[[bodies]]
region = "lower"
material = "hard steel"
[[contacts]]
source = "a"
target = "b"
[[contacts]]
name = "press"
source = "a"
obstacle = { shape = "sphere", center = [0, 0], radius = 1.0 }
[[displacements]]
region = "a"
value = [0, "free"]
[[displacements]]
region = "a"
value = ["free", 0]
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "m.msh").touch()
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def test_any_key(path):
    words = ["contacts.press.friction=0.6", "contacts.press.obstacle.radius = 2", "contacts.a-b.tied=true",
             'materials."hard steel".E=3', "displacements.1.value=['free', 1]", "steps.count=4", "mesh.strain=finite",
             "petsc.snes_rtol=1e-6", "title=x = y", "steps.count=5"]  # fmt: skip
    scene = read_scene(path, words=words)
    assert [one.friction for one in scene.contacts] == [None, 0.6] and scene.contacts[1].obstacle.radius == 2.0
    assert scene.contacts[0].tied and scene.materials["hard steel"].E == 3.0
    assert [one.value for one in scene.displacements] == [(0.0, "free"), ("free", 1.0)]
    assert (scene.steps.count, scene.mesh.strain, scene.title) == (5, "finite", "x = y")
    assert float(scene.petsc["snes_rtol"]) == 1e-6
    assert read_scene(path, words=["contacts.press.name="]).contacts[1].name == "a-sphere"


@pytest.mark.parametrize(
    ("word", "parts"),
    [
        ("contacts.press.friction=-1", ("-set contacts.press.friction: found an integer -1",)),
        ("contacts.press.frction=1", ("-set contacts.press.frction: found an unknown key", "'friction'")),
        ("contacts.pres.friction=1", ("-set contacts.pres.friction: contacts: found 'pres'", "'press'", "a-b, press")),
        ("contacts.2.friction=1", ("found '2'", "a number below 2")),
        ("displacements.a.value=[0, 0]", ("2 tables with region 'a'", "0, 1")),
        ("steps={count = 0}", ("-set steps: steps.count: found an integer 0",)),
        ("loads.a.pressure=1", ("found 'a', no such name or region", "there are none")),
        ("friction", ("-set: found 'friction'", "KEY=VALUE")),
        ("a b=1", ("-set: found 'a b=1'",)),
        ("", ("-set: found nothing",)),
        (".".join("a" * 40) + "=1", ("allowed: KEY=VALUE",)),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_of_the_option(path, word, parts):
    with pytest.raises(InputError) as error:
        read_scene(path, words=[word])
    for part in ("command line: ", *parts):
        assert part in str(error.value)
    # another reading of the file knows nothing of it
    assert read_scene(path).steps.count == 1


def test_every_one_counts():
    """PETSc, which reads the other options, would have the last one."""
    words = ["check", "s.toml", "-set", "a.b=1", "-mesh_order", "2", "-set", "c=-2"]
    assert parse(words) == ("check", "s.toml", {"set": ["a.b=1", "c=-2"], "mesh_order": "2"})
    assert "-set KEY=VALUE" in usage("run") and "-set KEY=VALUE" in usage("check")
    with pytest.raises(InputError, match="found '-set=a'"):
        parse(["run", "s.toml", "-set=a"])


def test_values():
    assert assigned("a.b=[1, 2]") == {"a": {"b": [1, 2]}}
    assert assigned("a=yes") == {"a": "yes"} and assigned('a="1"') == {"a": "1"} and assigned("a=") == {"a": None}
    assert assigned('a=C:\\x "y"') == {"a": 'C:\\x "y"'}
