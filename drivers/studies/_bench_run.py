"""Runs the scenes of a job with the pcontact of a tree, and writes the report of the last one.

    mpirun -n N python -P drivers/studies/_bench_run.py JOB.json

A process of its own for `drivers.studies._against`, which has both revisions run it: it knows of pcontact what any
revision has, the scenes as tables and `pcontact.run`.
"""

import json
import sys
from pathlib import Path

job = json.loads(Path(sys.argv[1]).read_text())
sys.path.insert(0, job["tree"])

from mpi4py import MPI  # noqa: E402

import pcontact as pc  # noqa: E402

# all but the last on a small mesh: kernels compile, or load, outside the clock
for scene in job["scenes"]:
    run = pc.run(scene, job["options"])
if MPI.COMM_WORLD.rank == 0:
    Path(job["report"]).write_text(json.dumps(run.report))
