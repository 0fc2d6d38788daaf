"""``pcontact warm``: the kernels that the examples need are compiled, in several processes, before somebody waits.

``python -m pcontact.warm PARENT FOLDER NAME ...`` runs some of the examples, and writes a line for each.
"""

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time as clock
import zlib
from pathlib import Path

from pcontact.io.examples import lay_out, scenes
from pcontact.runtime import jit, log
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.files import replace_file
from pcontact.runtime.process import environment_outside
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation

# examples that have most to compile: they come first, each in a process of its own
_FIRST = ("axisymmetric", "bimetal", "indentation", "press", "heap")
_SYSTEM, _ENDS_WITH_PARENT = ctypes.CDLL(None), 1  # PR_SET_PDEATHSIG of prctl(2)
_OFTEN = 0.5  # [s] between two looks at what has been compiled


def warm(jobs=None):
    """Compile what the examples need; in an installation without them, the scene of ``pcontact new``. Serial.

    Parameters
    ----------
    jobs : int, optional
        Processes; absent: one for each core.

    Returns
    -------
    str
        A line: what there is.

    Raises
    ------
    OutputError
        Compiled kernels cannot be kept.
    InputError
        An example does not run, as where its mesh cannot be made.
    """
    folder = jit.folder()
    if not jit.can_keep(folder):
        raise OutputError(f"{folder}: compiled kernels cannot be kept; NUMBA_CACHE_DIR names another directory")
    what = "the examples" if scenes() else "the scene of `pcontact new`"
    record = folder / "warm"
    if _is_there(record):
        return f"the kernels that {what} need{'' if scenes() else 's'} are there, in {folder}"
    names = sorted((path.stem for path in scenes()), key=lambda name: (*_FIRST, name).index(name)) or ["new"]
    jobs = min(jobs or len(os.sched_getaffinity(0)), len(names))
    start, before = clock.perf_counter(), jit.count()
    log.info("compiling the kernels that %s need%s, once, in %d process%s; they are kept in %s", what,
             "" if scenes() else "s", jobs, "es" if jobs > 1 else "", folder)  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        _follow([_Worker(Path(scratch) / str(k), names[k::jobs]) for k in range(jobs)], len(names), before)
    directories = jit.directories()
    there = [name for name in directories if (folder / name).is_dir()]
    replace_file(record, "\n".join([_version(directories), *there]))
    return f"{jit.count() - before} kernels compiled in {clock.perf_counter() - start:.0f} s"


def _version(directories):
    """Checksum of the program, by its directories of kernels, and of the examples."""
    return f"{zlib.crc32(repr([directories, *(path.read_bytes() for path in scenes())]).encode())}"


def _is_there(record):
    """Return whether kernels were compiled for the program as it is, and nothing of them has gone since."""
    try:
        version, *names = record.read_text().splitlines()
    except (OSError, ValueError):
        return False
    return version == _version(jit.directories()) and all((record.parent / name).is_dir() for name in names)


class _Worker:
    """A process that runs some of the examples.

    Parameters
    ----------
    folder : pathlib.Path
        Its own.
    names : sequence of str
    """

    def __init__(self, folder, names):
        folder.mkdir()
        self._said, self._wrong = folder / "said", folder / "wrong"
        # one thread each, as in runs: the cores are taken
        environment = {**environment_outside(), "OMP_NUM_THREADS": "1"}
        with open(self._said, "w") as said, open(self._wrong, "w") as wrong:
            command = [sys.executable, "-m", "pcontact.warm", str(os.getpid()), str(folder / "runs"), *names]
            self.process = subprocess.Popen(command, stdout=said, stderr=wrong, env=environment)

    def done(self):
        """Examples that it has run."""
        return self._said.read_text().count("\n")

    def check(self):
        """Raise an error if it has ended with one."""
        if self.process.poll():
            lines = self._wrong.read_text(errors="replace").strip().splitlines()
            said = lines[-1] if lines else f"exit status {self.process.returncode}"
            raise InputError(f"pcontact warm: an example did not run: {said}")


def _follow(workers, total, before):
    """Show how far the processes are until they have ended."""
    try:
        with log.Progress(total, "compiling", lines=5) as progress:
            while any([worker.process.poll() is None for worker in workers]):
                progress.to(sum(worker.done() for worker in workers), f"{jit.count() - before} kernels")
                clock.sleep(_OFTEN)
                for worker in workers:
                    worker.check()
            progress.to(total, f"{jit.count() - before} kernels")
    finally:
        for worker in workers:
            worker.process.kill()
            worker.process.wait()


def main(words):
    """Run examples in a folder, and write a line for each, as long as the process is there that asks for it. Serial."""
    parent, folder, *names = words
    # Linux sends the signal when it ends, however that comes about
    if hasattr(_SYSTEM, "prctl"):
        _SYSTEM.prctl(_ENDS_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != int(parent):
        return
    log.setup(level="error")
    for name in names:
        simulation = Simulation(read_scene(lay_out(name, Path(folder))))
        simulation.run(Path(folder) / f"{name}_results")
        simulation.close()
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
