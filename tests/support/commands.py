"""The program as a process of its own: its files, its environment, its one line of an error."""

import csv
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from pcontact.io.report import read_report
from pcontact.io.result import load_result
from tests.support.bad_input import SCENE, Case

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 60


def environment():
    """That of a fresh shell: nothing of the MPI job that the tests may run in."""
    keep = {
        k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "PRTE_", "OMPI_COMM_", "OPAL_"))
    }
    keep["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [keep.get("PYTHONPATH")])])
    return {
        **keep,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # the same for Open MPI 5
        "OMP_NUM_THREADS": "1",
    }


def lay_out(folder, case):
    """The files of a case in a folder of its own; returns its command line."""
    folder.mkdir()
    if case.scene is not None:
        (folder / "scene.toml").write_text(case.scene)
    if case.mesh is not None:
        (folder / "mesh.msh").write_text(case.mesh)
    if case.functions is not None:
        (folder / "functions.py").write_text(case.functions)
    return ["scene.toml" if word == "SCENE" else word for word in case.words]


def launch(command, folder):
    """Run a command in a folder; one that hangs is an error."""
    return subprocess.run(
        command,
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        stdin=subprocess.DEVNULL,
    )


def execute(folder, words, ranks=None):
    """Run the program in a folder."""
    start = [] if ranks is None else ["mpirun", "-n", str(ranks)]
    return launch([*start, sys.executable, "-m", "pcontact", *words], folder)


IN_TURN = """\
import json, os, sys
from pcontact.cli import main
from pcontact.runtime.petsc import MPI, PETSc
options = PETSc.Options()
for folder, words in json.loads(sys.argv[1]):
    os.chdir(folder)
    for name, value in zip(words[2::2], words[3::2]):
        options.setValue(name, value)
    MPI.COMM_WORLD.Barrier()
    status = "0"
    try:
        main(words)
    except SystemExit as end:
        status = str(end.code)
    for name in options.getAll():
        options.delValue(name)
    everyone = MPI.COMM_WORLD.gather(status)
    if MPI.COMM_WORLD.rank == 0:
        sys.stderr.write("status " + " ".join(everyone) + chr(10))
        sys.stderr.flush()
"""


def in_turn(folder, jobs, ranks=1):
    """Line on stderr and exit status of all ranks, of commands that one process per rank does one after the other.

    Parameters
    ----------
    folder : pathlib.Path
    jobs : list of tuple (folder, words)
        Each ends with one line.
    ranks : int
    """
    start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    done = launch([*start, sys.executable, "-c", IN_TURN, json.dumps(jobs)], folder)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 2 * len(jobs), done.stderr
    answers = zip(lines[::2], lines[1::2], strict=True)
    return [(line, [int(word) for word in status.split()[1:]]) for line, status in answers]


def check_line(text, parts):
    """Exactly one line, with everything in it."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    assert lines[0].startswith("pcontact: error: ")
    for part in parts:
        assert re.search(part, lines[0]), f"{part!r} is not in {lines[0]!r}"


# nothing moves in the first half of the run
LATE = Case([], scene=SCENE.replace("-0.05]", "-0.05]\namplitude = [[0, 0], [0.5, 0], [1, 1]]"))
# linear solves that never end, from the third load step of LATE on: the bodies do not move before
ENDLESS = ["-steps_count", "4", "-snes_ksp_ew", "false", "-ksp_type", "richardson", "-ksp_pc_side", "left", "-pc_type",
           "none", "-ksp_richardson_scale", "1e-9", "-ksp_rtol", "1e-300", "-ksp_max_it", "1000000000"]  # fmt: skip


def check_whole(folder, steps, aside=False):
    """All files have the first steps, and may have one that came after; what was being written is left only `aside`."""
    report = read_report(folder)["steps"]
    rows = list(csv.DictReader(io.StringIO((folder / "history.csv").read_text())))
    assert len(report) in (steps, len(rows)) and len(rows) in (steps, steps + 1) and len(set(map(len, rows))) == 1
    assert len(load_result(folder, steps).times) in (steps, steps + 1)
    with h5py.File(folder / "checkpoint.h5") as file:
        assert file.attrs["number"] in (steps - 1, steps)
        assert np.isfinite(file["displacement/value"][:]).all()
    assert aside or not list(folder.rglob("*.part"))
