"""What `scripts/setup.sh` does at its end."""

import os
import subprocess

import pytest

from tests.support.commands import ROOT

# in the place of the interpreter: notes what it was called with; what is compiled is said on standard output
SPEAK = """\
#!/bin/sh
printf '%s\\n' "$*" >> "$CALLS"
case "$*" in *"pcontact warm"*) echo compiling; exit "$STATUS" ;; esac
"""


@pytest.fixture
def call(tmp_path):
    """Runs the set-up with an environment that has all, in a copy of the scripts."""
    for folder in ("copy/scripts", "venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("pyproject.toml", "scripts/setup.sh"):
        (tmp_path / "copy" / name).write_bytes((ROOT / name).read_bytes())
    (tmp_path / "venv" / "pyvenv.cfg").touch()
    (tmp_path / "venv/bin/python3").write_text(SPEAK)
    (tmp_path / "venv/bin/python3").chmod(0o755)

    def run(**environment):
        (tmp_path / "calls").write_text("")
        known = {key: value for key, value in os.environ.items() if not key.startswith("PCONTACT_")}
        given = {**known, "PATH": f"{tmp_path / 'venv/bin'}:{os.environ['PATH']}", "STATUS": "0",
                 "TMPDIR": str(tmp_path), "CALLS": str(tmp_path / "calls"), **environment}  # fmt: skip
        done = subprocess.run(["bash", tmp_path / "copy/scripts/setup.sh", "--env"], env=given, capture_output=True,
                              text=True, timeout=60)  # fmt: skip
        return done, (tmp_path / "calls").read_text().count("-m pcontact warm")

    return run


@pytest.mark.parametrize("status", [0, 3])
def test_kernels_are_compiled_once(call, status):
    """After a set-up alone; what that says is nothing for the shell to evaluate, and if it fails the rest is there."""
    done, count = call(STATUS=str(status))
    assert (done.returncode, count) == (0, 1) and "compiling" not in done.stdout and "export PATH" in done.stdout
    assert done.stderr.count("not compiled (above)") == (status != 0)
    done, count = call()
    assert (done.returncode, count, done.stderr) == (0, 0, "") and "export PATH" in done.stdout


def test_compiling_can_be_left_out(call):
    done, count = call(PCONTACT_NO_WARM="1")
    assert (done.returncode, count) == (0, 0) and "setup: done" in done.stderr
