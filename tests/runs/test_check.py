"""What ``pcontact check`` says of contacts that are open at first."""

import pytest

from meshes import two_blocks
from pcontact.cli import check_scene
from pcontact.runtime import log
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene

GAP = 0.7


def said(path, capsys, contact, value=(0.0, 0.0), **more):
    log.setup(0)
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")], [contact],
        [Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", list(value))],
        output=Output(fields=False), **more,
    )  # fmt: skip
    check_scene(scene)
    out = capsys.readouterr()
    lines = (out.out + out.err).splitlines()
    return next((line for line in lines if "open at first" in line or "do not face" in line), "")


@pytest.fixture
def path(tmp_path):
    return two_blocks(tmp_path / "blocks.msh", 2, gap=GAP)


def test_how_far_a_contact_is_and_what_closes_it(path, capsys):
    """Farther than partners are looked for, too; obstacles move towards bodies."""
    pair = Contact("upper_bottom", "lower_top", name="pair")
    load = Load("upper_left", pressure=1.0)
    assert "pair: open at first, least distance 0.7; " in said(path, capsys, pair, (0.0, -0.1))
    assert "up to 0.1, less than that, and no load acts: it stays open" in said(path, capsys, pair, (0.0, -0.1))
    assert "less than that: loads have to close it" in said(path, capsys, pair, (0.0, -0.1), loads=[load])
    assert "up to 0.8 and can close it" in said(path, capsys, pair, (0.0, -0.8))
    for down, words in ((-0.1, "less than that"), (-0.5, "can close it")):
        lid = Obstacle("plane", point=[0.0, 3.0], normal=[0.0, -1.0], displacement=[0.0, down])
        line = said(path, capsys, Contact("upper_top", obstacle=lid, name="lid"))
        assert "lid: open at first, least distance 0.3; " in line and words in line
    assert "do not face each other" in said(path, capsys, Contact("lower_bottom", "upper_top", name="pair"))
    lid = Obstacle("plane", point=[0.0, 3.0], normal=[0.0, 1.0])
    assert "the normal of an obstacle points to" in said(path, capsys, Contact("upper_top", obstacle=lid, name="lid"))
    # together they are
    assert not said(two_blocks(path.with_name("closed.msh"), 2), capsys, pair)
