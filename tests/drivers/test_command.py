"""How `scripts/pcontact.sh` finds a driver."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import drivers

SCRIPT = Path(drivers.__path__[0]).parent / "scripts" / "pcontact.sh"
# in the place of the interpreter: what it was called with
SPEAK = '#!/bin/sh\nprintf "%s\\n" "$@"\n'


@pytest.fixture
def repository(tmp_path):
    """A copy of the script, an environment that sets up nothing, and one driver."""
    for folder in ("scripts", "bin", "drivers/cases", "elsewhere"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(SCRIPT, tmp_path / "scripts")
    (tmp_path / "scripts" / "env.sh").write_text("")
    (tmp_path / "drivers" / "cases" / "hertz.py").write_text("")
    (tmp_path / "bin" / "python3").write_text(SPEAK)
    (tmp_path / "bin" / "python3").chmod(0o755)
    return tmp_path


def call(repository, driver):
    path = f"{repository / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", repository / "scripts" / "pcontact.sh", "run", driver, "--tiny"], cwd=repository / "elsewhere",
        env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("folder", ["drivers/cases/", "drivers/", ""])
def test_a_driver_is_found_by_its_path_or_its_name(repository, folder):
    found, option = call(repository, f"{folder}hertz.py").stdout.split()
    assert Path(found).resolve() == repository / "drivers" / "cases" / "hertz.py" and option == "--tiny"


def test_a_driver_of_the_current_directory_comes_first(repository):
    (repository / "elsewhere" / "hertz.py").write_text("")
    assert call(repository, "hertz.py").stdout.split() == ["hertz.py", "--tiny"]


def test_no_driver(repository):
    done = call(repository, "herz.py")
    assert done.returncode == 2 and done.stderr == "pcontact.sh: no driver herz.py\n"
