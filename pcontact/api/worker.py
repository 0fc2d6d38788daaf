"""A case of a study in a process of its own: ``python -m pcontact.api.worker SCENE ROW``, both pickled."""

import pickle
import sys
from pathlib import Path

from pcontact.api.study import _case
from pcontact.runtime.petsc import MPI

if __name__ == "__main__":
    given, found = map(Path, sys.argv[1:])
    row = _case(*pickle.loads(given.read_bytes()))
    if MPI.COMM_WORLD.rank == 0:
        found.write_bytes(pickle.dumps(row))
