"""What can go wrong, by whose hand."""

import tempfile
from pathlib import Path


class InputError(Exception):
    """The input is wrong: one line for the user, exit status 2.

    Parameters
    ----------
    message : str
        One line naming the file, the key (group, cell), what was found and what is allowed.
    """

    status = 2


class OutputError(Exception):
    """Output cannot be written, or another run writes there: one line for the user, exit status 3.

    What was written before is whole.

    Parameters
    ----------
    message : str
        One line naming the file and the reason.
    """

    status = 3


# what ends a program with one line, the same on every rank
TOLD = (InputError, OutputError)


class StepFailure(Exception):
    """A load step did not converge even at the smallest step: exit status 1."""


def require_writable(directory):
    """Refuse an output directory before a run that would find out at its first step. Nothing is left behind.

    Parameters
    ----------
    directory : str or pathlib.Path
        It need not exist yet.

    Raises
    ------
    InputError
    """
    path = Path(directory).absolute()
    existing = path
    try:
        existing = next(folder for folder in (path, *path.parents) if folder.exists())
        # a trial tells more than permissions do, which root does not need and a full disk does not show
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise InputError(
            f"command line: -o {directory}: found {existing}: {error.strerror.lower()}; "
            "allowed: a directory that can be made and written to"
        ) from None
