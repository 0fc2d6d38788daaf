"""Errors, by whose hand they are, and the one line that says so."""

import difflib
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence

KINDS = ((type(None), "nothing"), (bool, "a boolean"), (int, "an integer"), (float, "a number"),
         (str, "a string"), (list, "a list"), (tuple, "a list"), (dict, "a table"))  # fmt: skip
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80
_SHORT.maxlist = _SHORT.maxtuple = 8
_NAMES = 30  # more names than this do not help to find the right one
# a terminal obeys them, and neither XML nor HDF5 nor a line of a table can hold them all
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")


# files that stand for what a program has in memory -> what messages call them
_IN_MEMORY: dict[str, str] = {}
# what the command line has set in scenes: (file, key path without names) -> the option
_SAID: dict[tuple[str, str], str] = {}
_NAME = re.compile(r"(?<=\]) \(.*?\)(?=\.|$)")


class InputError(Exception):
    """The input is wrong: one line for the user, exit status 2.

    Parameters
    ----------
    message : str
        One line naming the file, the key (group, cell), what was found and what is allowed.
    """

    status = 2

    def __init__(self, message: str) -> None:
        for path, name in _IN_MEMORY.items():
            message = message.replace(path, name)
        super().__init__(message)


class OutputError(Exception):
    """Output cannot be written, or another run writes there: one line for the user, exit status 3.

    What was written before is whole.

    Parameters
    ----------
    message : str
        One line naming the file and the reason.
    """

    status = 3


class SolverError(Exception):
    """PETSc could not go on with a linear system: one line for the user, exit status 1.

    Parameters
    ----------
    message : str
        One line: where PETSc ended, what it says, and what else there is to try.
    """

    status = 1


class NoPetsc(ImportError):
    """petsc4py or mpi4py is not there, or does not fit: one line for the user, exit status 2.

    Parameters
    ----------
    message : str
        One line: what is wrong, and where a petsc4py is to be had.
    """

    status = 2


# what ends a program with one line, the same on every rank
TOLD = (InputError, OutputError, SolverError)


class StepFailure(Exception):
    """A load step did not converge even at the smallest step: exit status 1."""


class NotConverged(StepFailure):
    """The same, told to who runs a scene from Python.

    Parameters
    ----------
    message : str
        One line: which load step, how far Newton's method got, where the residual is largest.
    run : pcontact.api.Run
        The run up to the last load step that converged.
    """

    def __init__(self, message, run):
        super().__init__(message)
        self.run = run


class Stopped(Exception):
    """An observer ends the run after a load step that has been committed and written."""


def call_in_messages(path: str, name: str) -> None:
    """Enter what messages call a file that stands for what a program has in memory."""
    _IN_MEMORY[path] = name


def set_elsewhere(file: str, options: Mapping[str, str]) -> None:
    """Enter what has said the keys of a file, by their paths: messages about these name it instead of the file."""
    for old in [old for old in _SAID if old[0] == file]:
        del _SAID[old]
    _SAID.update({(file, _NAME.sub("", path)): option for path, option in options.items()})


def _origin(file, key):
    """Return the beginning of a message: file and key path, or the option that has set the key."""
    path = _NAME.sub("", key)
    for (of, place), option in _SAID.items():
        if of == file and (path + ".").startswith(place + "."):
            return option + (f": {key}" if path != place else "")
    return f"{file}: {key}"


def input_error(file: str, key: str, found: str, allowed: str) -> InputError:
    """The error to raise: file, key path, what was found, what is allowed, in one line."""
    line = f"{_origin(file, key)}: found {found}; allowed: {allowed}"
    return InputError("".join(c if c.isprintable() else repr(c)[1:-1] for c in line))


def kind(value: object) -> str:
    """Return the sort of a value in the words of a scene file."""
    return next(
        (name for cls, name in KINDS if isinstance(value, cls)), f"a value of type {type(value).__name__}"
    )


def shown(value: object) -> str:
    """Sort and value, shortened to fit a line."""
    if value is None or isinstance(value, dict):
        return kind(value)
    try:
        text = _SHORT.repr(value)
    except ValueError:  # an integer beyond Python's limit of digits
        return f"{kind(value)} too long to show"
    return f"{kind(value)} {text.lower() if isinstance(value, bool) else text}"


def cut(text: str) -> str:
    """Text in quotation marks, shortened to fit a line."""
    return _SHORT.repr(text)


def closeness(name: str, known: str) -> float:
    """Likeness of two names from 0 to 1, whatever their case."""
    return difflib.SequenceMatcher(None, name.lower(), known.lower()).ratio()


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most like `name`, None when there are no names."""
    return max(known, key=lambda other: closeness(name, other), default=None)


def nearby(name: str, known: Iterable[str], show: Callable[[str], str] = repr) -> str:
    """The end of a message: the known name that is much like `name`, empty where there is none."""
    return "".join(f"; the nearest is {show(near)}" for near in difflib.get_close_matches(name, known, 1))


def unknown_name(name: str, what: str, known: Iterable[str]) -> str:
    """The "found" part for a name that is not among the known ones."""
    best = nearest(name, known)
    return f"{name!r}, {what}" + ("" if best is None else f", the nearest is {best!r}")


def listed(names: Iterable[str]) -> str:
    """Names in order, cut where the list gets long."""
    names = sorted(names)
    rest = f", ... ({len(names) - _NAMES} more)" if len(names) > _NAMES else ""
    return ", ".join(names[:_NAMES]) + rest if names else "(there are none)"


def coordinates(point: Iterable[float]) -> str:
    """A point, or a vector, by its coordinates."""
    return f"({', '.join(f'{c:g}' for c in point)})"


def counted(names: Sequence[str]) -> str:
    """Names, each once, and how often where several bodies have the same."""
    count = {name: names.count(name) for name in dict.fromkeys(names)}
    return ", ".join(f"{name} ({n} times)" if n > 1 else name for name, n in count.items())
