"""The program as the user meets it: bad input of every kind ends with one line and status 2, on every rank.

Most of the time of a run is the start of Python: the cases of bad_input.py go through the program one after the
other in one process (per rank); some of them have processes of their own, too.
"""

import json
import re

import pytest

from tests.support.bad_input import CASES, Case
from tests.support.commands import LATE, check_line, execute, in_turn, lay_out


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 3])
def test_bad_input(tmp_path, ranks):
    """Every rank ends with status 2, one line comes out, nobody waits for the others, nothing is written."""
    folders = [tmp_path / str(k) for k in range(len(CASES))]
    jobs = [(str(f), lay_out(f, case)) for f, case in zip(folders, CASES.values(), strict=True)]
    before = sorted(tmp_path.rglob("*"))
    for (name, case), (line, status) in zip(CASES.items(), in_turn(tmp_path, jobs, ranks), strict=True):
        assert status == ranks * [2], name
        check_line(line, case.parts)
    assert before == sorted(tmp_path.rglob("*"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["no scene", "NaN", "ksp", "command", "output over a file"])
def test_exit_status(tmp_path, name):
    """A process of its own ends with status 2 and says one line."""
    words = lay_out(tmp_path / "case", CASES[name])
    before = sorted(tmp_path.rglob("*"))
    done = execute(tmp_path / "case", words)
    assert done.returncode == 2, done.stderr
    check_line(done.stderr, CASES[name].parts)
    assert before == sorted(tmp_path.rglob("*"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["conflicting supports", "smoother", "level set that stops"])
def test_exit_status_on_three_ranks(tmp_path, name):
    """And so do three of them, whose mpirun adds words of its own."""
    words = lay_out(tmp_path / "case", CASES[name])
    done = execute(tmp_path / "case", words, ranks=3)
    assert done.returncode == 2
    ours = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]
    assert len(ours) == 1
    check_line(ours[0], CASES[name].parts)
    for word in ("Traceback", "PETSC ERROR", "MPI_ABORT"):
        assert word not in done.stderr
    assert not (tmp_path / "case" / "scene_results").exists()


# -- runs that start well ----------------------------------------

# one iteration of a weak linear solver is not enough for anything that moves
WEAK = [
    "-snes_max_it",
    "1",
    "-ksp_max_it",
    "1",
    "-pc_type",
    "jacobi",
    "-steps_count",
    "4",
    "-steps_min",
    "0.1",
]


def report_of(folder):
    """report.json."""
    return json.loads((folder / "report.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [None, 3])
def test_a_step_that_does_not_converge(tmp_path, ranks):
    """Status 1, one line that says why; the steps before it are kept in all files."""
    lay_out(tmp_path / "case", LATE)
    done = execute(tmp_path / "case", ["run", "scene.toml", "-o", "out", *WEAK], ranks)
    assert done.returncode == 1, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error")]
    assert len(lines) == 1
    assert re.search(r"0\.5 to 0\.625 .*residual", lines[0])
    assert ranks or len(done.stderr.splitlines()) == 1
    assert done.stdout.count("cut back") == 2
    report = report_of(tmp_path / "case" / "out")
    assert report["converged"] is False
    assert [step["time"] for step in report["steps"]] == [0.25, 0.5]
    rows = (tmp_path / "case" / "out" / "history.csv").read_text().splitlines()
    assert len(rows) == 3
    pvd = (tmp_path / "case" / "out" / "fields.pvd").read_text()
    assert set(re.findall(r'timestep="([^"]*)"', pvd)) == {"0.0", "0.25", "0.5"}, "that of the undeformed bodies, too"


def test_a_run_and_a_check(tmp_path):
    """Status 0 and what the user reads; an option that nothing asked for is named."""
    lay_out(tmp_path / "case", Case([]))
    done = execute(tmp_path / "case", ["check", "scene.toml"])
    assert done.returncode == 0 and done.stderr == ""
    for text in (
        "two squares",
        "body upper: 1 cells (quadrilateral), material m",
        "16 unknowns",
        "left out: friction",
    ):
        assert text in done.stdout
    assert not list((tmp_path / "case").glob("*results*"))
    done = execute(tmp_path / "case", ["run", "scene.toml", "-contact_tehta", "1"])
    assert done.returncode == 0, done.stderr
    assert report_of(tmp_path / "case" / "scene_results")["converged"] is True
    said = "-contact_tehta: neither pcontact nor PETSc has it; the nearest is -contact_theta"
    assert said in done.stdout + done.stderr


def test_modes(tmp_path):
    """Frequencies in words and in a file, and fields; a body without a density is refused before anything is solved."""
    lay_out(tmp_path / "case", Case([]))
    done = execute(tmp_path / "case", ["modes", "scene.toml", "-count", "2"])
    refused = r"density: found nothing \(body \w+\); allowed: a number > 0"
    assert done.returncode == 2 and re.search(refused, done.stderr)
    text = (tmp_path / "case" / "scene.toml").read_text()
    (tmp_path / "case" / "scene.toml").write_text(text.replace("nu = ", "density = 2.0\nnu = ", 1))
    done = execute(tmp_path / "case", ["modes", "scene.toml", "-count", "2"])
    assert done.returncode == 0 and done.stderr == ""
    found = json.loads((tmp_path / "case" / "scene_results" / "modes.json").read_text())["modes"]
    assert len(found) == 2 and found[0]["frequency"] < found[1]["frequency"] and found[0]["stable"]
    assert f"mode 1: frequency {found[0]['frequency']:.6g}" in done.stdout and "was not used" not in done.stdout
    assert (tmp_path / "case" / "scene_results" / "modes" / "fields.pvd").exists()
