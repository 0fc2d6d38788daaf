"""The process: standard streams, which may be closed, full, or read by somebody who has stopped; signals; what PETSc is
started with, which is said before `pcontact.runtime.petsc` is imported. Neither PETSc nor MPI.

What the caller wants ignored stays so, and a run that is stopped says so in one line.

No file is ever half written, so that a process may end at any moment: nothing has to be unwound, neither through
Python nor through PETSc. What is worth a moment before says so (:func:`last_words`).
"""

import io
import os
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

from pcontact.runtime.files import discard_all

# that give the ranks on their machine terminals
_LAUNCHERS = ("mpirun", "mpiexec", "orterun", "orted", "prterun", "prte", "prted")
# those that ask for the end
STOPS = (signal.SIGINT, signal.SIGTERM)
# those that PETSc and gmsh take for themselves when they start, whatever the caller wants: nohup has SIGHUP ignored,
# Python SIGPIPE, for it gets an error instead where nobody reads
TAKEN = (signal.SIGHUP, signal.SIGPIPE, *STOPS)
# what is done before the process ends
_last = []
# names of what MPI puts into the environment of the processes that it starts
_STARTED = ("PMIX_", "PMI_", "PRTE_", "ORTE_", "OPAL_", "OMPI_COMM_", "OMPI_APP_", "OMPI_MCA_ess", "OMPI_MCA_orte",
            "OMPI_MCA_pmix")  # fmt: skip

# what Open MPI, PMIx and PMI call the number of a process
_RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")


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
    """Return whether somebody may be looking at it; on a rank of Open MPI, at that of mpirun."""
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
    """Tell whether what is written to a terminal gets to one: Open MPI gives a rank one of its own, and passes on,
    to a file or through ssh, what comes there. The process that has its other end is among those that this one
    descends from."""
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
    """Read a file of /proc; nothing if it has gone."""
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


def take_back():
    """Have the signals go again where Python knows that they should. To be called after a library has started."""
    if threading.current_thread() is threading.main_thread():
        for number in TAKEN:
            handler = signal.getsignal(number)
            if handler is not None:
                signal.signal(number, handler)


@contextmanager
def last_words(function):
    """While this lasts, a function is called before SIGINT or SIGTERM end the process.

    Parameters
    ----------
    function : callable
        Without parameters; it may be called amid all that this process does otherwise, and must not wait for others.
    """
    _last.append(function)
    try:
        yield
    finally:
        _last.remove(function)


@contextmanager
def stopping(speaks):
    """While this lasts, SIGINT and SIGTERM end the process with one line and status 130 or 143.

    That happens as soon as the compiled code returns that is running; at the latest at the next Krylov iteration.

    Parameters
    ----------
    speaks : bool
        Whether this rank writes the line.
    """

    def stop(number, frame):
        for function in _last:
            function()
        discard_all()
        if speaks:
            name = signal.Signals(number).name
            line = f"pcontact: error: stopped by {name}; what was written before is whole\n"
            try:
                # the stream may be in use where the signal came
                os.write(2, line.encode())
            except OSError:
                pass
        os._exit(128 + number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.signal(n, stop) for n in STOPS if signal.getsignal(n) != signal.SIG_IGN}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: a handler that is not Python's
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


class _State:
    """State of this process: another program's, which has a command line of its own."""

    library = False


def as_library():
    """The command line is the caller's: PETSc does not see it."""
    _State.library = True


def is_library():
    """Return whether :func:`as_library` was called."""
    return _State.library


def petsc_words():
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
    """Tell whether this process is the first one of those that MPI has started together, by what it says of it before
    it is loaded; True for one that nobody has."""
    return next((os.environ[name] for name in _RANKS if name in os.environ), "0") == "0"


def environment_outside():
    """The environment of this process without what MPI put there when it started: an mpirun that is called from here
    would take itself for a part of it.

    Returns
    -------
    dict of str to str
    """
    return {name: value for name, value in os.environ.items() if not name.startswith(_STARTED)}
