"""A new user's first commands: new, run, lines for programs, doctor."""

import json
import os
import re
import shlex
import subprocess
import sys

import pytest

from pcontact.io.examples import write_example, write_template
from pcontact.runtime.errors import InputError
from tests.support.commands import ROOT, TIMEOUT, environment


def command(folder, *words):
    """What it says, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "pcontact", *words], cwd=folder, capture_output=True, text=True, timeout=TIMEOUT,
        env=environment(),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_new_scene_runs_as_it_is(tmp_path):
    command(tmp_path, "new", "first")
    text = command(tmp_path, "run", "first/scene.toml", "-o", "first/results")
    assert "done: 8 load steps to time 2" in text and "pcontact view first/results" in text
    last = json.loads((tmp_path / "first/results/report.json").read_text())["steps"][-1]
    assert last["contacts"]["foot"]["force"][0] == pytest.approx(-0.2 * last["contacts"]["foot"]["force"][1], rel=0.1)
    lines = command(tmp_path, "run", "first/scene.toml", "-json", "-o", "first/results")
    events = [json.loads(line) for line in lines.splitlines()]
    assert [event["event"] for event in events] == ["step"] * 8 + ["end"] and events[-1]["converged"]
    assert events[0]["contacts"]["foot"]["max_pressure"] > 0


@pytest.mark.slow
def test_a_first_look(tmp_path):
    """What the numbers mean and where they are; who has changed the scene gets the numbers of the changed one."""
    text = command(tmp_path, "demo", "-o", "look")
    expected, found = re.search(r"expected: contacts.press.force\[2\] = (\S+) within 2 %.* found (\S+)", text).groups()
    assert float(found) == pytest.approx(float(expected), rel=0.02)
    assert re.search(r"press.max_pressure +0.7\d+ +largest contact pressure", text)
    named = re.findall(r"^  (look/results/\S+) ", text, re.MULTILINE)
    assert len(named) == 3 and all((tmp_path / name).stat().st_size > 100 for name in named)
    assert "a picture: " in text or "no picture: " in text
    scene = tmp_path / "look/press.toml"
    scene.write_text(scene.read_text().replace("count = 2", "count = 1").replace("-0.06]", "-0.03]"))
    text = command(tmp_path, "demo", "-o", "look")
    assert "done: 1 load steps" in text and "expected:" not in text


def test_a_new_scene_overwrites_nothing(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a").touch()
    with pytest.raises(InputError, match="new: found .*mine, which is there already; allowed: a new directory"):
        write_template(str(tmp_path / "mine"))


def test_an_example_comes_with_its_mesh(tmp_path):
    """The command of its head comment makes the mesh, without the repository."""
    command(tmp_path, "new", "first", "-example", "wood")
    text = (tmp_path / "first/wood.toml").read_text()
    words = shlex.split(next(line for line in text.splitlines() if "python -m meshes" in line).lstrip("# "))
    assert words[1:4] == ["-m", "meshes", "one_block"] and words[-2:] == ["-o", "wood.msh"]
    alone, folder = {**environment(), "PYTHONPATH": ""}, tmp_path / "first"
    done = subprocess.run([sys.executable, *words[1:]], cwd=folder, env=alone, capture_output=True, text=True)
    assert done.returncode == 0 and (tmp_path / "first/wood.msh").exists(), done.stderr
    assert "modelled: " in command(tmp_path / "first", "check", "wood.toml")


def test_all_examples_are_to_be_had(tmp_path):
    """Their head comments name commands that are typed in the new directory."""
    names = sorted(path.stem for path in (ROOT / "drivers/examples").glob("*.toml"))
    for name in names:
        text = write_example(str(tmp_path / name), name).read_text()
        head = text[: text.index("title =")]
        assert f"#     pcontact run {name}.toml -o results\n" in head and "results/report.json" in head
        assert f'file = "{name}.msh"' in text and not {"drivers", "scripts"} & set(head.replace("/", " ").split())
    with pytest.raises(InputError, match="-example: found 'pres'; allowed: .*wood; the nearest is 'press'"):
        write_example(str(tmp_path / "other"), "pres")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("words, said", [
    ("raise ModuleNotFoundError('none such')", "no petsc4py and mpi4py that work (none such); remedy, one of: "),
    ("def init(words):\n    raise ValueError('numpy.dtype size changed')",
     "petsc4py was built for another numpy than "),
])  # fmt: skip
def test_a_petsc4py_that_does_not_serve(words, said, tmp_path):
    """One line says what to do; help needs none."""
    (tmp_path / "petsc4py").mkdir()
    (tmp_path / "petsc4py/__init__.py").write_text(words)
    there = {**environment(), "PYTHONPATH": os.pathsep.join([str(tmp_path), environment()["PYTHONPATH"]])}
    for asked, status in (["--help"], 0), (["doctor"], 2):
        done = subprocess.run([sys.executable, "-m", "pcontact", *asked], env=there, capture_output=True, text=True)
        assert done.returncode == status
    assert done.stdout == "" and done.stderr.startswith(f"pcontact: error: {said}") and done.stderr.count("\n") == 1
    assert "pip install" in done.stderr


@pytest.mark.slow
def test_doctor_says_what_there_is(tmp_path):
    text = command(tmp_path, "doctor")
    for word in ("PETSc 3.", "numba", "mumps", "GB/s (triad)", "the scene of `pcontact new`"):
        assert word in text
