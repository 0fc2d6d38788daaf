"""The standard streams, which may be closed, full, or read by somebody who has stopped."""

import io
import os
import sys
from contextlib import suppress
from pathlib import Path

# that give the ranks on their machine terminals
_LAUNCHERS = ("mpirun", "mpiexec", "orterun", "orted", "prterun", "prte", "prted")


def reserve():
    """Put something in the place of standard streams that are closed.

    The next file to be opened would take their numbers, and what libraries print would end up in it.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # the lowest free number is this one
            os.open(os.devnull, os.O_RDWR)
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w", closefd=False, encoding="utf-8"))


def put(stream, text):
    """Write text and have it gone; characters that the stream does not know are written as numbers.

    Parameters
    ----------
    stream : file object
    text : str

    Raises
    ------
    OSError, ValueError
        The stream does not take it, or is closed.
    """
    try:
        stream.write(text)
    except UnicodeEncodeError:
        code = stream.encoding or "ascii"
        stream.write(text.encode(code, "backslashreplace").decode(code))
    stream.flush()


def is_terminal(stream):
    """Whether somebody may be looking at it; on a rank of Open MPI, at that of mpirun."""
    try:
        if not stream.isatty():
            return False
    except (AttributeError, ValueError):
        return False
    # one that is no file says itself what it is; what /proc does not tell is not known
    with suppress(OSError, ValueError):
        return _seen(stream.fileno())
    return True


def _seen(number):
    """Whether what is written to a terminal gets to one: Open MPI gives a rank one of its own, and passes on, to a file
    or through ssh, what comes there. The process that has its other end is among those that this one descends from."""
    process = os.getppid()
    mine = f"tty-index:\t{os.minor(os.fstat(number).st_rdev)}\n"
    while process > 1:
        folder = Path("/proc", str(process))
        # its name, which may have blanks and brackets, is followed by its state and its parent
        before, _, after = (folder / "stat").read_text().rpartition(")")
        if before.partition("(")[2] in _LAUNCHERS:
            infos = (folder / "fdinfo").iterdir()
            if any(mine in text for text in map(_text, infos)):
                kind = os.stat(folder / "fd" / str(number)).st_rdev
                # terminals, unlike files and pipes, are devices, and so is /dev/null
                return os.major(kind) not in (0, os.major(os.stat(os.devnull).st_rdev))
        process = int(after.split()[1])
    return True


def _text(path):
    """What a file of /proc says; nothing if it has gone."""
    try:
        return path.read_text()
    except OSError:
        return ""


def give_up(stream):
    """A stream that takes all that a broken one should have taken, and what libraries print to it.

    Parameters
    ----------
    stream : file object

    Returns
    -------
    file object
    """
    try:
        number = stream.fileno()
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, number)
        os.close(null)
        return stream
    except (OSError, ValueError, io.UnsupportedOperation):
        return open(os.devnull, "w", encoding="utf-8")
