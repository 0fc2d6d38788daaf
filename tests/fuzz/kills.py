"""Runs that are killed again and again: ``python tests/fuzz/kills.py [--kills 50] [--seed 1] [--only WORD] [-o DIR]``.

Every chain is a scene of tests/support/restart_kinds.py or tests/support/driver_scenes.py whose run is ended with
SIGKILL, all of its ranks at once, at a random moment; the next life goes on from the checkpoint that is there, until a
last one comes to the end. About half of the kills come while a checkpoint is being written, and count as such only if
the unfinished file has stayed behind. Half of the chains stay on one number of ranks, 1 to 3: report and history then
have the numbers of a run that was never killed, to 1e-12. On three ranks PETSc adds what other ranks send to the coarse
matrices of multigrid in the order in which it comes, unless told otherwise, as here; a direct solver on several ranks
always does. Where two runs that were never killed differ, the numbers, without those of the solver, agree to ten times
that difference. The lives of the other chains are on numbers of ranks of their own, and the numbers agree to 1e-7.

The exit status is 1 if a life failed, or its numbers are not those.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from runner import begin, command, environment, kill, of_session, take_along

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from pcontact.cli import guarded, run_scene  # noqa: E402
from pcontact.runtime.petsc import PETSc  # noqa: E402
from tests.support.driver_scenes import SCENES  # noqa: E402
from tests.support.restart_kinds import COUNTED, KINDS, worst

STEPS = 10
EVERY = {**KINDS, **SCENES}
SAME, OTHER = 1e-12, 1e-7
MOST = 5  # kills of a chain
PATIENCE = 300.0  # seconds of a life on a busy machine
CHECKPOINT, PART = "checkpoint.h5", "checkpoint.h5.part"


@dataclass
class Life:
    """One start of a run.

    Attributes
    ----------
    ranks : int
    steps : int
        Load steps of this life that are over when it is killed.
    within : bool
        Whether it is killed while a checkpoint is being written.
    part : float
        Random number from 0 to 1: how far into the next step, or into the writing.
    """

    ranks: int
    steps: int
    within: bool
    part: float


def scene_of(kind, folder):
    """The scene of a kind with more load steps and fields, its mesh in a folder. *Collective.*"""
    case = EVERY[kind](folder)
    case.steps.count, case.output.fields = STEPS, True
    return case


def live(kind, folder, out, restart=None):
    """What a life does: a run as from the command line; returns the exit status. *Collective.*"""
    # where pytest has been imported, nothing of the command line is PETSc's
    if PETSc.COMM_WORLD.size > 2:
        PETSc.Options().setValue("matptap_via", "allatonce")
    if restart is not None:
        PETSc.Options().setValue("restart", restart)
    return guarded(lambda: 0 if run_scene(scene_of(kind, Path(folder)), out)[1] else 1)


def start(kind, folder, out, ranks, restart, log):
    """A process that runs a scene on some ranks, in a session of its own."""
    words = ["--live", kind, folder, out, *([out] if restart else [])]
    folder.mkdir(parents=True, exist_ok=True)
    places = {"TMPDIR": str(folder), "OMPI_MCA_btl_vader_backing_directory": str(folder)}
    return begin(command(__file__, ranks, *words), log, {**environment(), **places})


def stamp(path):
    """When a file was written, None if it is not there."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return None


def end_of(process, out, life, pace):
    """Wait for the moment of a kill; processes of the run then, none if it has come to its end before.

    Parameters
    ----------
    process : subprocess.Popen
    out : pathlib.Path
        Its results.
    life : Life
    pace : list of float
        Seconds of a load step and of the writing of a checkpoint.
    """
    last, steps, since, looked, known = stamp(out / CHECKPOINT), 0, time.monotonic(), 0.0, [process.pid]
    while process.poll() is None and time.monotonic() - since < PATIENCE:
        if time.monotonic() - looked > 0.2:
            looked, known = time.monotonic(), of_session(process.pid)
        now = stamp(out / CHECKPOINT)
        if now != last:
            last, steps = now, steps + 1
        if steps >= life.steps and not life.within:
            time.sleep(life.part * pace[0])
            break
        if steps >= life.steps and (out / PART).exists():
            time.sleep(life.part * pace[1])
            break
        time.sleep(2e-4)
    return known if process.poll() is None else []


def run_to_end(kind, folder, out, ranks, restart=False):
    """The last life; raises if it fails."""
    with open(folder / "log", "a+") as log:
        process = start(kind, folder / f"mesh{ranks}", out, ranks, restart, log)
        try:
            status = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            kill(process)
            status = "no end"
        if status:
            log.seek(0)
            raise RuntimeError(f"{kind} on {ranks} ranks: status {status}: {log.read()[-2000:]}")


def results(out):
    """Load steps of the report, and rows of the history."""
    report = json.loads((out / "report.json").read_text())
    with open(out / "history.csv", newline="") as stream:
        rows = list(csv.reader(stream))
    if not report["converged"] or len(rows) != len(report["steps"]) + 1 or len({len(row) for row in rows}) != 1:
        raise RuntimeError(f"{out}: {len(report['steps'])} steps in the report, {len(rows)} rows of the history")
    return report["steps"]


def chain(kind, lives, last, folder):
    """Kill lives, one after the other, and compare what the last one ends with.

    Parameters
    ----------
    kind : str
        Of `EVERY`.
    lives : list of Life
    last : int
        Ranks of the last life, and of the run that is never killed.
    folder : pathlib.Path

    Returns
    -------
    kills, within : int
        Kills, and those while a checkpoint was being written.
    difference : float
        Largest one to the run that was never killed.
    allowed : float
    where : str
    """
    folder.mkdir(parents=True)
    whole, out, log = folder / "whole", folder / "out", open(folder / "log", "w")
    begin = time.monotonic()
    run_to_end(kind, folder, whole, last)
    # imports and reading take about half of a short run
    pace = [0.5 * (time.monotonic() - begin) / STEPS, 0.01]
    kills = within = 0
    with log:
        for life in lives:
            (out / PART).unlink(missing_ok=True)
            process = start(kind, folder / f"mesh{life.ranks}", out, life.ranks, (out / CHECKPOINT).exists(), log)
            if known := end_of(process, out, life, pace):
                kill(process, known)
                kills += 1
                within += (out / PART).exists()
            elif process.wait():
                raise RuntimeError(f"{kind} on {life.ranks} ranks: {(folder / 'log').read_text()[-2000:]}")
    run_to_end(kind, folder, out, last, (out / CHECKPOINT).exists())
    same, allowed = all(life.ranks == last for life in lives), OTHER
    if same:
        allowed = SAME
        if last > 2:
            run_to_end(kind, folder, folder / "again", last)
            same = worst(results(whole), results(folder / "again"))[0] == 0.0
            allowed = max(SAME, 10.0 * worst(results(whole), results(folder / "again"), COUNTED)[0])
    difference, where = worst(results(whole), results(out), () if same else COUNTED)
    return kills, within, difference, allowed, where


def plan(seed, kinds):
    """Kind, one of some, lives and ranks of the last life of a chain."""
    rng = np.random.default_rng(seed)
    kind, same, last = rng.choice(kinds), bool(rng.random() < 0.5), int(rng.integers(1, 4))
    # some come too late for the writing that they wait for
    lives = [
        Life(
            last if same else int(rng.integers(1, 4)), int(rng.integers(0, 4)), k % 5 not in (1, 4), float(rng.random())
        )
        for k in range(MOST)
    ]
    return str(kind), lives, last, same


def say(line):
    """A line for whoever waits."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def study(kills, seed, kinds, folder):
    """Chains of some kinds until there are so many kills; prints a line for each. Returns the number of failures."""
    total = within = failed = 0
    worst_of = {True: 0.0, False: 0.0}
    while total < kills:
        kind, lives, last, same = plan(seed, kinds)
        try:
            count, inside, difference, allowed, where = chain(kind, lives, last, folder / str(seed))
        except RuntimeError as error:
            count, inside, difference, allowed, where = 1, 0, np.inf, 0.0, str(error)
        good = difference <= allowed
        total, within, failed = total + count, within + inside, failed + (not good)
        worst_of[same] = max(worst_of[same], difference)
        ranks = " ".join(str(life.ranks) for life in lives)
        say(f"seed {seed}: {kind}, ranks {ranks} then {last}: {count} kills, {inside} of them while a checkpoint was "
            f"written, difference {difference:.1e}{'' if good else f' FAILED: {where}'}")  # fmt: skip
        seed += 1
    say(f"{total} kills, {within} of them while a checkpoint was written: largest difference on the same ranks "
        f"{worst_of[True]:.1e}, on others {worst_of[False]:.1e}; {failed} failures")  # fmt: skip
    return failed


def main():
    """The study, or a life of it."""
    if sys.argv[1:2] == ["--live"]:
        sys.exit(live(*sys.argv[2:]))
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], allow_abbrev=False)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1, help="of the first chain; they count up")
    parser.add_argument("--only", default="", help="kinds of scenes whose names have this word, such as finite, driver")
    parser.add_argument("-o", type=Path, help="results stay there (default: nowhere)")
    args = parser.parse_args()
    take_along()
    kinds = [kind for kind in EVERY if args.only in kind]
    if not kinds:
        parser.error(f"--only {args.only}: no kind of scenes has this word; there are {', '.join(EVERY)}")
    with tempfile.TemporaryDirectory(prefix="kills") as folder:
        sys.exit(1 if study(args.kills, args.seed, kinds, Path(args.o or folder)) else 0)


if __name__ == "__main__":
    main()
