"""The benchmark of two revisions: scenes as tables, rows, ratios, a run of a tree."""

import json
import subprocess
from types import SimpleNamespace

import pytest

from drivers.studies._against import ROOT, against, compared, measure, show, summed, tables, unpack
from drivers.studies._press import CASES, make_scene
from meshes import ball_on_block
from pcontact.runtime.errors import InputError
from pcontact.scene.reader import scene_from


def run(solve, linear=1.0, search=0.0):
    """What a run took."""
    seconds = {"search": search, "linear": linear, "solve": solve}
    return {"unknowns": 9, "newton": 2, "krylov": 7, "memory_mb": 10.0 * solve, "seconds": seconds}


@pytest.mark.parametrize("case", CASES)
def test_tables_are_those_of_a_scene(tmp_path, case):
    mesh = tmp_path / "ball.msh"
    mesh.touch()
    scene = make_scene(mesh, case)
    found = tables(scene)
    assert "springs" not in found and found["mesh"]["file"] == str(mesh)
    again = scene_from(found)
    for name in ("mesh", "materials", "bodies", "displacements", "petsc", "title"):
        assert json.dumps(tables(getattr(again, name))) == json.dumps(tables(getattr(scene, name)))
    assert [one.friction for one in again.contacts] == [one.friction for one in scene.contacts]


def test_rows_and_ratios(caplog):
    caplog.set_level("INFO")
    old, elastic = summed([run(4.0), run(3.0, 2.0)]), summed([run(2.0, 0.5)])
    assert old["seconds"] == {"search": 0.0, "linear": 1.0, "solve": 3.0} and old["memory_mb"] == 40.0
    assert old["spread"] == pytest.approx(1.0 / 3.0)
    rows = {"elastic": {"old": elastic, "new": elastic}, "contact": {"old": old, "new": summed([run(6.0, 0.5)])}}
    rows["finite"] = {"new": elastic}
    ratios = compared(rows)
    assert ratios["new_to_old"]["contact"] == {"linear": 0.5, "solve": 2.0} and "finite" not in ratios["new_to_old"]
    assert ratios["to_old_elastic"]["contact"]["new"]["solve"] == 12.0
    show(rows, ratios)
    assert any("contact  new" in line and "12" in line for line in caplog.messages)
    assert compared({"contact": rows["contact"]})["to_old_elastic"] == {}


@pytest.mark.slow
def test_a_run_of_a_tree(tmp_path):
    """In a process of its own; one that fails says why."""
    args = SimpleNamespace(o=tmp_path, ranks=1)
    ball_on_block(tmp_path / "ball.msh", unknowns=600)
    scene = tables(make_scene(tmp_path / "ball.msh", "linear"))
    found = measure(ROOT, [scene, scene], args)
    assert found["newton"] == 1 and found["krylov"] > 1 and found["memory_mb"] > 0.0
    assert found["seconds"]["solve"] >= found["seconds"]["linear"] > 0.0 < found["seconds"]["krylov"]
    assert "allowed" in measure(ROOT, [{**scene, "moons": 3}], args)


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="needs the history")
def test_revisions(tmp_path):
    name, tree = unpack("HEAD", tmp_path)
    head = subprocess.run(["git", "-C", ROOT, "rev-parse", "HEAD"], capture_output=True, text=True).stdout
    assert head.startswith(name) and (tree / "pcontact" / "api").is_dir() and unpack("HEAD", tmp_path)[1] == tree
    with pytest.raises(InputError, match="--against: found 'nowhere', allowed: a commit"):
        against(SimpleNamespace(o=tmp_path, against="nowhere", ranks=1, repeat=1))
    with pytest.raises(InputError, match="--ranks 0"):
        against(SimpleNamespace(o=tmp_path, against="HEAD", ranks=0, repeat=1))
