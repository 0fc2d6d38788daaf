"""What surrounds a run: streams that nobody reads, signals, a second run, other locales, no place for a cache."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import pcontact as pc
from pcontact.cli import main
from pcontact.runtime import log
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.lock import NAME, reserved
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from tests.support.bad_input import SCENE, Case, mesh_text
from tests.support.commands import ENDLESS, LATE, ROOT, TIMEOUT, check_line, check_whole, environment, execute, lay_out

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


@pytest.fixture(autouse=True)
def log_afterwards():
    """Whatever a test does to the log, or to the stream that it goes to."""
    yield
    log.setup(WORLD.rank)
    log.forget_warnings()


START = [sys.executable, "-m", "pcontact", "run", "scene.toml", "-o", "out"]


def report_of(folder):
    """report.json."""
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


# -- standard streams ----------------------------------------


def test_a_log_that_is_full(capsys):
    """The log goes on without its stream, and says so once."""
    log.forget_warnings()
    with open("/dev/full", "w") as stream:
        log.setup(0, stream)
        log.info("first")
        log.info("second")
        log.error_line("wrong", stream)
    (text,) = log.warnings()
    assert text.startswith("standard output cannot be written (no space left on device)")
    assert capsys.readouterr().err == f"pcontact: warning: {text}\n"


def test_a_log_that_does_not_know_all_letters(tmp_path):
    """They are written as numbers."""
    with open(tmp_path / "log", "w", encoding="ascii") as stream:
        log.setup(0, stream)
        log.info("Würfel")
        log.error_line("Träger", stream)
    assert (tmp_path / "log").read_text() == "W\\xfcrfel\npcontact: error: Tr\\xe4ger\n"


@pytest.mark.slow
def test_a_run_that_nobody_reads(tmp_path):
    """It goes on and keeps its results, with what PETSc prints, too."""
    lay_out(tmp_path / "case", Case([]))
    command = '"$@" | head -1; echo status ${PIPESTATUS[0]} >status'
    words = ["bash", "-c", command, "bash", *START, "-snes_monitor"]
    done = subprocess.run(words, cwd=tmp_path / "case", env=environment(), capture_output=True, text=True,
                          timeout=TIMEOUT)  # fmt: skip
    assert (tmp_path / "case" / "status").read_text() == "status 0\n", done.stderr
    report = report_of(tmp_path / "case" / "out")
    assert report["converged"] and len(done.stdout.splitlines()) == 1
    check = "standard output cannot be written (broken pipe)"
    assert any(text.startswith(check) for text in report["warnings"]) and check in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_standard_streams_that_are_closed(tmp_path):
    """No file takes their places, where what libraries print would end up in it."""
    code = """if True:
        from pcontact.runtime import log, process
        process.reserve()
        log.setup()
        with open("file", "w") as stream:
            stream.write(str(stream.fileno()))
            log.info("nobody reads this")
            log.error_line("nor this")
    """
    words = ["bash", "-c", '"$@" <&- >&- 2>&-', "bash", sys.executable, "-c", code]
    done = subprocess.run(words, cwd=tmp_path, env=environment())
    assert done.returncode == 0 and int((tmp_path / "file").read_text()) > 2


# -- other locales ----------------------------------------

LETTERS = SCENE.replace("two squares", "zwei Würfel").replace("upper_top", "kräfte").replace('"pair"', '"Paar ä"')


@pytest.mark.slow
def test_a_locale_without_letters(tmp_path):
    """Names in the scene may have all letters."""
    folder = tmp_path / "case"
    lay_out(folder, Case([], scene=LETTERS, mesh=None))
    (folder / "mesh.msh").write_text(mesh_text().replace("upper_top", "kräfte"))
    plain = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(START, cwd=folder, env=environment() | plain, capture_output=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    assert report_of(folder / "out")["title"] == "zwei Würfel" and rb"zwei W\xfcrfel" in done.stdout
    assert "reactions.kräfte_x" in (folder / "out" / "history.csv").read_text(encoding="utf-8")


def test_names_of_files_that_the_locale_does_not_have(tmp_path, monkeypatch, capfd):
    """They are wrong input: those of the scene, and those of the command line, which Python cannot read."""
    lay_out(tmp_path / "case", Case([], scene=LETTERS.replace("mesh.msh", "würfel.msh"), mesh=None))
    with monkeypatch.context() as patch:
        patch.setattr("os.fsencode", lambda name: name.encode("ascii"))
        with pytest.raises(InputError, match=r"scene\.toml: mesh\.file: found .*'ascii' codec .*; allowed: the name"):
            read_scene(tmp_path / "case" / "scene.toml")
    with pytest.raises(SystemExit, match="2"):
        main(["run", "szen\udcc3\udca4.toml"])
    check_line(capfd.readouterr().err, [r"command line: found 'szen\\udcc3", "allowed: .*UTF-8"])


# -- signals and locks ----------------------------------------


def wait_for(path, number):
    """Until a report has some steps."""
    end = time.monotonic() + TIMEOUT
    while not path.exists() or len(json.loads(path.read_text())["steps"]) < number:
        assert time.monotonic() < end
        time.sleep(0.02)


def endless(folder, ranks=1):
    """A run that has committed two steps and is in a linear solve without end."""
    lay_out(folder, Case([], scene=LATE.scene + "[output]\ncheckpoint = true\n"))
    start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    process = subprocess.Popen([*start, *START, *ENDLESS], cwd=folder, env=environment(), stdin=subprocess.DEVNULL,
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)  # fmt: skip
    wait_for(folder / "out" / "report.json", 2)
    time.sleep(0.3)
    return process


@pytest.fixture(autouse=True)
def interruptible():
    """Tests that a shell has started in the background ignore interrupts, and so would what they start."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_that_stop(tmp_path, number):
    """One line, and nothing is left that was being written; what has to be said before is said."""
    code = """if True:
        import time
        from pcontact.runtime.files import replace_file, written_aside
        from pcontact.runtime.process import last_words, stopping
        replace_file("file", "before")
        with last_words(lambda: replace_file("said", "too late")):
            pass
        with stopping(True), last_words(lambda: replace_file("said", "last")), written_aside("file") as part:
            part.write_text("aft")
            print("ready", flush=True)
            time.sleep(60)
    """
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, env=environment(), text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    error = process.communicate(timeout=20)[1]
    assert process.returncode == 128 + number
    check_line(error, [f"stopped by {number.name}"])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"file": "before", "said": "last"}


@pytest.mark.slow
def test_a_run_that_is_killed(tmp_path):
    """What it has done so far is loaded."""
    process = endless(tmp_path / "case")
    process.kill()
    process.communicate(timeout=20)
    run = pc.load(tmp_path / "case" / "out")
    assert len(run.steps) == len(run.history["time"]) == 2 and not run.converged and run.report["title"]


@pytest.mark.slow
def test_a_second_run_and_a_run_that_is_stopped(tmp_path):
    """The second is refused; the first ends in the middle of a linear solve; what is committed stands."""
    process = endless(tmp_path / "case")
    try:
        done = execute(tmp_path / "case", ["run", "scene.toml", "-o", "out"])
        assert done.returncode == 3
        check_line(done.stderr, [f"out: another run writes there.*process {process.pid} on", "allowed"])
        process.send_signal(signal.SIGTERM)
        error = process.communicate(timeout=20)[1]
    finally:
        process.kill()
    assert process.returncode == 143
    check_line(error, ["stopped by SIGTERM"])
    check_whole(tmp_path / "case" / "out", 2)
    assert not (tmp_path / "case" / "out" / NAME).exists()


@pytest.mark.slow
def test_three_ranks_that_are_stopped(tmp_path):
    """mpirun hands the signal on; what is committed stands, and stood all the time."""
    process = endless(tmp_path / "case", 3)
    try:
        process.send_signal(signal.SIGTERM)
        time.sleep(1.0)
        # mpirun kills what takes longer than it waits: a file that was being written may be left aside
        check_whole(tmp_path / "case" / "out", 2, aside=True)
        error = process.communicate(timeout=20)[1]
    finally:
        process.kill()
    assert process.returncode != 0 and "Traceback" not in error and "PETSC ERROR" not in error


def test_signals_that_the_caller_ignores(tmp_path):
    """Neither PETSc nor gmsh takes them: nohup has SIGHUP ignored, Python SIGPIPE."""
    code = """if True:
        import signal
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        import gmsh
        from pcontact.mesh.remesh import _fresh
        from pcontact.runtime.petsc import PETSc
        def ignored():
            (line,) = [line for line in open("/proc/self/status") if line.startswith("SigIgn")]
            return {number for number in range(1, 32) if int(line.split()[1], 16) >> (number - 1) & 1}
        assert {signal.SIGHUP, signal.SIGPIPE} <= ignored(), ignored()
        with _fresh():
            assert {signal.SIGHUP, signal.SIGPIPE} <= ignored(), ignored()
    """
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_interrupt_while_the_program_is_loaded(tmp_path):
    """The process is gone, without a traceback."""
    code = """if True:
        import os, runpy, signal, sys
        class Finder:
            def find_spec(self, name, *more):
                if name == "pcontact.cli":
                    os.kill(os.getpid(), signal.SIGINT)
        sys.meta_path.insert(0, Finder())
        sys.argv = ["pcontact", "doctor"]
        runpy.run_module("pcontact", run_name="__main__")
    """
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True)
    assert done.returncode == -signal.SIGINT and done.stderr == ""


@pytest.mark.parametrize("number, error", [
    (errno.EACCES, OutputError), (errno.EROFS, OutputError), (errno.ENOSPC, OutputError),
    (errno.ENAMETOOLONG, InputError),
])  # fmt: skip
def test_a_directory_that_cannot_be(tmp_path, monkeypatch, number, error):
    """The fault of its name, or of the place."""

    def stop(*arguments):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("os.ftruncate", stop)
    with pytest.raises(error, match=os.strerror(number).lower()), reserved(tmp_path / "a" / "out", SELF):
        pass
    monkeypatch.undo()
    with pytest.raises(InputError, match="too long"), reserved(tmp_path / ("o" * 300), SELF):
        pass
    assert not list(tmp_path.iterdir())


@parallel
def test_a_directory_is_reserved(shared_tmp):
    """On every rank alike, and only while it lasts; what was made for nothing is taken away."""
    folder = shared_tmp / "a" / "b"
    with reserved(folder, WORLD):
        assert (folder / NAME).read_text().split()[0].isdigit()
        with pytest.raises(OutputError, match=r"b: another run writes there \(process \d+ on .*\); allowed"):
            with reserved(folder, WORLD):
                pass
        with pytest.raises(InputError, match=rf"-o .*: found .*{NAME}: not a directory"):
            with reserved(folder / NAME / "c", WORLD):
                pass
        WORLD.Barrier()
    WORLD.Barrier()
    assert not list(shared_tmp.iterdir())
    # the first rank makes it anew
    WORLD.Barrier()
    with reserved(folder, WORLD):
        if WORLD.rank == 0:
            (folder / "result").write_text("")
        WORLD.Barrier()
    assert folder.is_dir()


def test_a_lock_dies_with_its_process(tmp_path):
    """Even with SIGKILL; the file it leaves means nothing."""
    code = f"""if True:
        import time
        from pcontact.runtime.lock import reserved
        from pcontact.runtime.petsc import MPI
        with reserved({str(tmp_path / "out")!r}, MPI.COMM_SELF):
            print("locked", flush=True)
            time.sleep(60)
    """
    process = subprocess.Popen([sys.executable, "-c", code], env=environment(), stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline() == b"locked\n"
        with pytest.raises(OutputError, match=f"process {process.pid} on"):
            with reserved(tmp_path / "out", SELF):
                pass
    finally:
        process.kill()
        process.communicate()
    assert (tmp_path / "out" / NAME).exists()
    with reserved(tmp_path / "out", SELF):
        assert (tmp_path / "out" / NAME).read_text().split()[0] == str(os.getpid())
    assert not (tmp_path / "out" / NAME).exists()


def test_a_file_system_without_locks(tmp_path, monkeypatch):
    """The run goes on, with a warning."""

    def flock(file, how):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("fcntl.flock", flock)
    log.forget_warnings()
    with reserved(tmp_path / "out", SELF):
        assert "no locks" in log.warnings()[0]


class Vanish(Observer):
    """Takes the output directory away after the first load step."""

    def __init__(self, directory):
        self.directory = directory

    def step(self, step, u, record):
        if WORLD.rank == 0:
            shutil.rmtree(self.directory)
        WORLD.Barrier()


@parallel
@pytest.mark.parametrize("fields", [True, False])
def test_a_directory_that_vanishes(shared_tmp, fields):
    """Every rank learns of it, whoever writes first."""
    text = SCENE + f"[steps]\ncount = 3\n[output]\nfields = {str(fields).lower()}\n"
    if WORLD.rank == 0:
        lay_out(shared_tmp / "case", Case([], scene=text))
    WORLD.Barrier()
    simulation = Simulation(read_scene(shared_tmp / "case" / "scene.toml"))
    out = shared_tmp / "case" / "out"
    try:
        with pytest.raises(OutputError, match=r"out/(fields/|history).*: cannot be written \(no such file or dir"):
            simulation.run(out, [Vanish(out)])
    finally:
        simulation.close()
    WORLD.Barrier()
    assert not out.exists()


# -- compiled kernels ----------------------------------------


def test_an_installation_that_cannot_be_written(tmp_path):
    """Kernels are compiled and not kept, and a warning says so."""
    package = tmp_path / "read_only" / "pcontact"
    shutil.copytree(ROOT / "pcontact" / "runtime", package / "runtime", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pcontact" / "__init__.py", package)
    (package / "kernel.py").write_text(
        "from pcontact.runtime.jit import njit\nfrom pcontact.runtime.jit import tell_uncached\n"
        "@njit\ndef f(x):\n    return x\nf(1)\ntell_uncached()\n"
    )
    for path in (*tmp_path.parents, tmp_path):
        if os.stat(path).st_uid == os.getuid() and path != Path("/"):
            path.chmod(path.stat().st_mode | 0o555)
    for path in (tmp_path / "read_only").rglob("*"):
        path.chmod(0o555)
    package.chmod(0o555)
    home = {"HOME": "/nonexistent", "PYTHONPATH": f"{package.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    keep = {k: v for k, v in environment().items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    code = "from pcontact.runtime import log; log.setup(); import pcontact.kernel"
    # nothing is read-only for root
    nobody = {"user": "nobody"} if os.getuid() == 0 else {}
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, env=keep | home, cwd="/", capture_output=True, text=True, **nobody)
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first == "compiling kernels"
    assert re.fullmatch(r"warning: compiled kernels cannot be kept \(.*\): .* NUMBA_CACHE_DIR .*", second)


@pytest.mark.slow
def test_options_in_the_folder_of_a_scene(tmp_path):
    """PETSc reads a file of options in the working directory, unless no code is to be run."""
    lay_out(tmp_path / "given", Case([]))
    (tmp_path / "given" / ".petscrc").write_text("-pc_type python\n-pc_python_type ./evil.py:PC\n")
    (tmp_path / "given" / "evil.py").write_text("open('ran', 'w').close()\nraise SystemExit\n")
    done = execute(tmp_path / "given", ["run", "scene.toml", "-no_code"])
    assert done.returncode == 0 and not (tmp_path / "given" / "ran").exists()
