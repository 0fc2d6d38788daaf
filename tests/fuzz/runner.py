"""Lists of runs in processes of their own, on one rank or under mpirun, that survive crashes and hangs of a run."""

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# seconds that one run may take on a machine that does other things as well, and compiles the kernels first
PATIENCE = float(os.environ.get("PCONTACT_FUZZ_PATIENCE", 400.0))
# processes of runs, and who starts one
_begun, _starting = [], threading.RLock()


def environment():
    """That of a fresh shell: nothing of the MPI job that the caller may run in."""
    ours = ("PMIX_", "PRTE_", "OMPI_COMM_", "OPAL_")
    keep = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    keep["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [keep.get("PYTHONPATH")])])
    return {
        **keep,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
        # ranks that wait give way to those that work
        "OMPI_MCA_mpi_yield_when_idle": "1",
        "OMP_NUM_THREADS": "1",
    }


def command(script, ranks, *words):
    """The command line of a Python script on some ranks."""
    start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    return [*start, sys.executable, str(script), *map(str, words)]


def job_of(folder, options=None, restart=None, of=None, checkpoint=False, write=False, tangent=False):
    """A job of worker.py."""
    return {"folder": str(folder), "options": options or {}, "restart": restart, "of": None if of is None else str(of),
            "checkpoint": checkpoint, "write": write, "tangent": tangent}  # fmt: skip


def begin(words, log, env):
    """A process in a session of its own."""
    with _starting:
        _begun.append(subprocess.Popen(
            words, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=env, start_new_session=True,
        ))  # fmt: skip
        return _begun[-1]


def of_session(leader):
    """Processes of a session: the launcher and all ranks."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            # PID (COMMAND) STATE PPID PGRP SESSION ...
            if entry.name.isdigit() and int((entry / "stat").read_text().rpartition(")")[2].split()[3]) == leader:
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def kill(process, known=()):
    """End all processes of a run at once; to list them takes longer than to write a checkpoint."""
    for pid in known:
        send(pid, signal.SIGSTOP)
    for pid in of_session(process.pid):
        send(pid, signal.SIGKILL)
    process.wait()


def send(pid, what):
    """Send a signal to a process, if it is still there."""
    with suppress(ProcessLookupError):
        os.kill(pid, what)


def end(process):
    """End a process and all of its session: the launcher first, which clears up behind its ranks."""
    with suppress(subprocess.TimeoutExpired):
        send(process.pid, signal.SIGTERM)
        process.wait(10)
    kill(process)


def take_along():
    """Have SIGINT and SIGTERM end the processes of runs before this one: they have sessions of their own."""

    def stop(number, frame):
        # held to the end: no thread starts another one
        _starting.acquire()
        for process in _begun:
            if process.poll() is None:
                end(process)
        os._exit(128 + number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)


def run_jobs(jobs, ranks, work):
    """Results of all jobs, in order.

    Parameters
    ----------
    jobs : list of dict
    ranks : int
    work : pathlib.Path
        A directory for the lists.

    Returns
    -------
    list of dict
        Of worker.py; `status` "crashed" or "hung" where the process did not come to its end.
    """
    def collect(job):
        return pickle.loads((Path(job["folder"]) / "result.pkl").read_bytes())

    found = supervised(HERE / "worker.py", jobs, ranks, work, collect)
    nothing = {"steps": [], "warnings": [], "cuts": []}
    return [{"status": r.split(":")[0], "text": r, **nothing} if isinstance(r, str) else r for r in found]


def supervised(script, jobs, ranks, work, collect):
    """What came out of all jobs of a script that says which it has begun and ended.

    Parameters
    ----------
    script : pathlib.Path
    jobs : list of dict
    ranks : int
    work : pathlib.Path
    collect : callable
        Makes the result of a job that has ended.

    Returns
    -------
    list
        Results; a text that begins with "crashed" or "hung" where the process did not come to its end.
    """
    results, first = [None] * len(jobs), 0
    while first < len(jobs):
        path = work / f"jobs_{ranks}_{os.getpid()}_{time.monotonic_ns()}.jsonl"
        path.write_text("".join(json.dumps(job) + "\n" for job in jobs[first:]))
        ended, status, text = _supervise(script, path, ranks)
        for k in range(first, first + ended):
            results[k] = collect(jobs[k])
        first += ended
        if first < len(jobs):
            results[first] = f"{status}: {text}"
            first += 1
    return results


def _supervise(script, path, ranks):
    """Run a list until it ends or stands still; how many jobs have ended, and how the next one did not."""
    done, log = Path(f"{path}.done"), Path(f"{path}.log")
    with open(log, "w") as stream:
        process = begin(command(script, ranks, path), stream, environment())
        size, since, status = -1, time.monotonic(), "crashed"
        while process.poll() is None:
            now = done.stat().st_size if done.exists() else 0
            if now != size:
                size, since = now, time.monotonic()
            if time.monotonic() - since > PATIENCE:
                status = "hung"
                end(process)
                break
            time.sleep(0.02)
        process.wait()
    lines = done.read_text().splitlines() if done.exists() else []
    ended = sum(line.startswith("end") for line in lines)
    return ended, status, log.read_text()[-3000:]
