"""Goes through the program's command line again and again in one process (per rank): ``python mutate_worker.py JOBS``.

JOBS has one JSON object per line: `folder`, `words`, `options`. Standard output and error of every rank go to files
in the folder, out.0, err.0, ..., the exit statuses of the ranks to status.json.
"""

import json
import os
import sys
from pathlib import Path

from pcontact.cli import main as program
from pcontact.runtime.petsc import MPI, PETSc

WORLD = MPI.COMM_WORLD


def execute(job):
    """Exit status of one command line on this rank. *Collective.*"""
    options = PETSc.Options()
    for name, value in job["options"].items():
        options.setValue(name, value)
    try:
        program(job["words"])
    except SystemExit as end:
        return end.code
    finally:
        for name in options.getAll():
            options.delValue(name)


def main(path):
    """All jobs of a file."""
    kept = os.dup(1), os.dup(2)
    for number, line in enumerate(Path(path).read_text().splitlines()):
        job = json.loads(line)
        if WORLD.rank == 0:
            with open(f"{path}.done", "a") as stream:
                stream.write(f"begin {number}\n")
        os.chdir(job["folder"])
        for which, name in enumerate(("out", "err"), 1):
            target = os.open(f"{name}.{WORLD.rank}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(target, which)
            os.close(target)
        status = execute(job)
        sys.stdout.flush()
        sys.stderr.flush()
        for which, old in enumerate(kept, 1):
            os.dup2(old, which)
        statuses = WORLD.gather(status)
        if WORLD.rank == 0:
            Path("status.json").write_text(json.dumps(statuses))
            with open(f"{path}.done", "a") as stream:
                stream.write(f"end {number}\n")
        WORLD.Barrier()


if __name__ == "__main__":
    main(sys.argv[1])
