"""A new user's first commands: new, run, lines for programs, doctor."""

import json
import re
import subprocess
import sys

import pytest

from pcontact.io.template import write_template
from pcontact.runtime.errors import InputError
from tests.support.commands import TIMEOUT, environment


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
    assert re.search(r"press.max_pressure +0.8\d+ +largest contact pressure", text)
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


@pytest.mark.slow
def test_doctor_says_what_there_is(tmp_path):
    text = command(tmp_path, "doctor")
    for word in ("PETSc 3.", "numba", "mumps", "GB/s (triad)", "the scene of `pcontact new`"):
        assert word in text
