"""Kernels that are compiled before somebody waits."""

import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

from pcontact import warm as module
from pcontact.io.examples import FOLDER
from pcontact.runtime import jit
from pcontact.runtime.errors import InputError, OutputError
from pcontact.warm import warm
from tests.support.commands import TIMEOUT, environment


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache that has what the user's has."""
    real = jit.folder()
    real.mkdir(parents=True, exist_ok=True)
    folder = tmp_path / "cache"
    folder.mkdir()
    for one in real.iterdir():
        if one.is_dir():
            (folder / one.name).symlink_to(one)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    return folder


def test_a_second_call_finds_that_all_is_there(cache, tmp_path, monkeypatch):
    """Until a part of it goes, or an example is another one."""
    name = next(name for name in jit.directories() if name.startswith("pcontact.assembly.solid-"))
    made, scene = [], tmp_path / "one.toml"
    scene.write_text("first")

    class Compiles:
        """In the place of the processes."""

        def __init__(self, folder, names):
            made.append(names)
            (cache / name).mkdir(exist_ok=True)
            self.process = self

        poll = wait = kill = lambda self: 0

        def done(self):
            return 1

        def check(self):
            pass

    monkeypatch.setattr(module, "_Worker", Compiles)
    monkeypatch.setattr(module, "_OFTEN", 0.0)
    monkeypatch.setattr(module, "scenes", lambda: [scene])
    for change in (lambda: None, lambda: (cache / name).rename(tmp_path / "gone"), lambda: scene.write_text("second")):
        change()
        assert "kernels compiled in" in warm()
        assert warm() == f"the kernels that the examples need are there, in {cache}"
    assert made == [["one"]] * 3


@pytest.mark.slow
def test_one_example_in_a_process(cache, monkeypatch):
    """The process runs it, and keeps what it compiles."""
    monkeypatch.setattr(module, "scenes", lambda: [FOLDER / "water.toml"])
    assert "kernels compiled in" in warm(4)
    version, *names = (cache / "warm").read_text().splitlines()
    assert [name for name in names if name.startswith("pcontact.assembly.solid-")] and (cache / names[0]).is_dir()


@pytest.mark.slow
def test_an_example_that_does_not_run(cache, monkeypatch):
    monkeypatch.setattr(module, "scenes", lambda: [Path("missing.toml")])
    monkeypatch.setattr(module, "_version", lambda directories: "0")
    with pytest.raises(InputError, match="pcontact warm: an example did not run: .*missing.toml"):
        warm()
    assert not (cache / "warm").exists()


def test_no_place_for_kernels(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.raises(OutputError, match="cannot be kept; NUMBA_CACHE_DIR names"):
        warm()


@pytest.mark.slow
def test_a_signal_ends_its_processes_too(tmp_path):
    given = {**environment(), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    run = subprocess.Popen([sys.executable, "-m", "pcontact", "warm", "-jobs", "1"], env=given, text=True,
                           stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip

    def at_work():
        """Processes that run examples and are this run's."""
        found = [Path("/proc", child) for child in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()]
        return [path for path in found if b"pcontact.warm" in (path / "cmdline").read_bytes()]

    assert run.stdout.readline().startswith("compiling the kernels that the examples need, once, in 1 process;")
    while not (workers := at_work()):
        time.sleep(0.1)
    run.terminate()
    assert run.wait(TIMEOUT) == 143 and len(workers) == 1
    # it looks for its parent once it has been loaded
    for _ in range(300):
        if not workers[0].exists() or b"pcontact.warm" not in (workers[0] / "cmdline").read_bytes():
            return
        time.sleep(0.1)
    pytest.fail("the process goes on")
