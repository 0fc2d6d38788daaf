"""What to do where petsc4py or mpi4py cannot be loaded.

petsc4py is no dependency of the wheel: it must fit the PETSc, the MPI and the numpy of the machine.
"""

import glob
import re

import numpy as np

from pcontact.runtime.errors import NoPetsc

# where Debian and Ubuntu have the one that is on no Python's way
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


def no_petsc(error):
    """The error that says so.

    Parameters
    ----------
    error : Exception
        Of the import.

    Returns
    -------
    NoPetsc
    """
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    if re.search(r"numpy|multiarray|_ARRAY_API", str(error)):
        # compiled code that was built with numpy 2 runs with numpy 1, too, but not the other way round
        remedy = "pip install 'numpy<2'" if np.lib.NumpyVersion(np.__version__) >= "2.0.0" else "pip install -U numpy"
        return NoPetsc(f"petsc4py was built for another numpy than {np.__version__}, which is here ({reason}); "
                       f"remedy: {remedy}")  # fmt: skip
    found = sorted(glob.glob(f"{_DEBIAN}/petsc4py"))
    debian = "apt-get install python3-petsc4py-real python3-mpi4py"
    if found:
        debian = f"/usr/bin/python3 with PYTHONPATH={found[-1].rpartition('/')[0]}"
    return NoPetsc(
        f"no petsc4py and mpi4py that work ({reason}); remedy, one of: Debian, Ubuntu: {debian}; "
        "conda: conda install -c conda-forge petsc4py mpi4py; spack: spack load py-petsc4py py-mpi4py; PETSc of your "
        "own, PETSC_DIR set: pip install mpi4py && pip install --no-build-isolation petsc4py==<version of that PETSc>"
    )
