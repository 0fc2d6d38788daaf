"""What PETSc is started with; said before `pcontact.runtime.petsc` is imported. Neither PETSc nor MPI."""

import os
import sys

# names of what MPI puts into the environment of the processes that it starts
_STARTED = ("PMIX_", "PMI_", "PRTE_", "ORTE_", "OPAL_", "OMPI_COMM_", "OMPI_APP_", "OMPI_MCA_ess", "OMPI_MCA_orte",
            "OMPI_MCA_pmix")  # fmt: skip

# what Open MPI, PMIx and PMI call the number of a process
_RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")


class _State:
    """Whether this process is another program's, which has a command line of its own."""

    library = False


def as_library():
    """The command line is the caller's: PETSc does not see it."""
    _State.library = True


def is_library():
    """Whether :func:`as_library` was called."""
    return _State.library


def words():
    """The words that PETSc is started with, the name of the program first.

    Returns
    -------
    list of str
        Of the command line; its first word alone in a test runner, whose options are its own.
    """
    if _State.library:
        return ["pcontact"]
    # bytes that Python could not read as text are none for petsc4py either
    line = [os.fsencode(word).decode("utf-8", "replace") for word in sys.argv]
    # a `.petscrc` in the working directory may be that of somebody's scene, and has PETSc run programs
    skipped = ["-skip_petscrc"] if "-no_code" in line else []
    return line[:1] if "pytest" in sys.modules else line + skipped


def is_first():
    """Whether this process is the first one of those that MPI has started together, by what it says of it before it is
    loaded; True for one that nobody has."""
    return next((os.environ[name] for name in _RANKS if name in os.environ), "0") == "0"


def environment_outside():
    """The environment of this process without what MPI put there when it started: an mpirun that is called from here
    would take itself for a part of it.

    Returns
    -------
    dict of str to str
    """
    return {name: value for name, value in os.environ.items() if not name.startswith(_STARTED)}
