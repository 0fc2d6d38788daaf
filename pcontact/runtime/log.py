"""Messages of the program: log lines, the one-line error, and progress.

All lines go through one logger, ``logging.getLogger("pcontact")``. The rank is passed in, so that this module
knows nothing of MPI: rank 0 speaks, the others are silent unless asked.
"""

import logging
import os
import re
import sys
import time as clock
from contextlib import contextmanager, suppress

from tqdm import tqdm

from pcontact.runtime import process

LOGGER = logging.getLogger("pcontact")
_COLOURS, _PLAIN = {"red": "\033[31m", "green": "\033[32m", "yellow": "\033[33m"}, "\033[0m"
# colours, and control characters that are no line break
_OBEYED = re.compile(r"\033\[\d*m|[\x00-\x08\x0b-\x1f\x7f-\x9f]")
# a library leaves it to its caller's logging what is shown
LOGGER.addHandler(logging.NullHandler())
# [s] After how long without a line a file has another one. From: chosen; who reads the file later has a few lines more.
IN_FILE = 10.0
GOES_ON = {"goes_on": True}
LEVELS = {"error": logging.ERROR, "warning": logging.WARNING, "info": logging.INFO, "debug": logging.DEBUG}


class _Handler(logging.StreamHandler):
    """Writes above a progress bar, if one stands on the same terminal, instead of through it."""

    def emit(self, record):
        try:
            _put(self.stream, self.format(record) + self.terminator)
        except (OSError, ValueError) as error:
            _lost(self, error)
        except Exception:
            self.handleError(record)


def _put(stream, text):
    with tqdm.external_write_mode(file=stream, nolock=True):
        process.put(stream, text)


def _lost(handler, error):
    """Go on without the stream: results first. It is said once, on standard error and in the report."""
    handler.stream = _State.stream = process.give_up(handler.stream)
    why = getattr(error, "strerror", None) or error
    text = f"standard output cannot be written ({str(why).lower()}); the run goes on without, its results are kept"
    _State.warnings = (*_State.warnings, text)
    with suppress(OSError, ValueError):
        _put(sys.stderr, f"pcontact: warning: {text}\n")


class _Formatter(logging.Formatter):
    """Plain text; a level that is not info is named, and so is the rank when several speak."""

    def __init__(self, prefix, colours=False):
        super().__init__()
        self.prefix, self.colours = prefix, colours

    def format(self, record):
        level = "" if record.levelno in (logging.INFO, logging.DEBUG) else f"{record.levelname.lower()}: "
        text = f"{self.prefix}{level}{_visible(super().format(record))}"
        return _painted(text, "yellow") if self.colours and record.levelno >= logging.WARNING else text


def _visible(text):
    """Text that a terminal shows and does not obey, but for our colours: a name out of a file may hold anything."""
    return _OBEYED.sub(lambda found: found[0] if found[0][1:] else repr(found[0])[1:-1], text)


def _painted(text, colour):
    return f"{_COLOURS[colour]}{text}{_PLAIN}"


def _coloured(stream):
    """Return whether lines have colours: on a terminal, unless the user wants none (https://no-color.org)."""
    return process.is_terminal(stream) and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


class _State:
    """The settings of this process: whether it speaks, and where to."""

    rank = 0
    speaks = True
    stream = None
    warnings = ()


def setup(rank=0, stream=None, level="info", all_ranks=False):
    """Say where log lines go. May be called again: the last call counts.

    Parameters
    ----------
    rank : int
        Rank of this process.
    stream : file object, optional
        Where the lines go; standard output if absent.
    level : {"error", "warning", "info", "debug"}
        Lines less important than this are dropped.
    all_ranks : bool
        Every rank speaks, its lines marked with its number; otherwise rank 0 only.

    Raises
    ------
    ValueError
        The level is not one of the four.
    """
    if level not in LEVELS:
        raise ValueError(f"log level {level!r}: allowed are {', '.join(LEVELS)}")
    _State.rank, _State.stream, _State.speaks = rank, stream or sys.stdout, rank == 0 or all_ranks
    for old in list(LOGGER.handlers):
        LOGGER.removeHandler(old)
    handler = _Handler(_State.stream) if _State.speaks else logging.NullHandler()
    handler.setFormatter(_Formatter(f"[{rank}] " if all_ranks else "", _coloured(_State.stream)))
    LOGGER.addHandler(handler)
    LOGGER.setLevel(LEVELS[level])
    LOGGER.propagate = False


@contextmanager
def of_a_library(rank=0, level=None, stream=None):
    """While this lasts, the program is a library: nothing is shown unless asked, errors are exceptions.

    What :func:`setup` said counts again afterwards, and the warnings of before are there.

    Parameters
    ----------
    rank : int
        Rank of this process; only 0 speaks.
    level : {"error", "warning", "info", "debug"}, optional
        Lines as important as this are shown; None: the handlers that the caller's own logging has for the logger
        "pcontact" get them.
    stream : file object, optional
        See :func:`setup`.

    Raises
    ------
    ValueError
        The level is not one of the four.
    """
    handlers, own = list(LOGGER.handlers), (LOGGER.level, LOGGER.propagate, LOGGER.disabled)
    state = {name: getattr(_State, name) for name in ("rank", "speaks", "stream", "warnings")}
    try:
        if level is not None:
            setup(rank, stream, level)
        else:
            _State.rank, _State.stream = rank, None
            LOGGER.disabled = rank != 0
            if any(isinstance(handler, _Handler) for handler in handlers):
                # of a program in the same process
                LOGGER.handlers[:] = [handler for handler in handlers if not isinstance(handler, _Handler)]
                LOGGER.setLevel(logging.NOTSET)
                LOGGER.propagate = True
        _State.speaks, _State.warnings = False, ()
        yield
    finally:
        LOGGER.handlers[:] = handlers
        LOGGER.setLevel(own[0])
        LOGGER.propagate, LOGGER.disabled = own[1:]
        for name, value in state.items():
            setattr(_State, name, value)


@contextmanager
def quiet():
    """While this lasts, nothing is said and no warning kept: of runs that are measurements of another one."""
    off, kept = LOGGER.disabled, (_State.speaks, _State.warnings)
    try:
        LOGGER.disabled, _State.speaks = True, False
        yield
    finally:
        LOGGER.disabled = off
        _State.speaks, _State.warnings = kept


@contextmanager
def terse(said):
    """While this lasts warnings alone are shown, each text once that is not in a set, which grows by them; and that a
    long load step goes on."""

    def shown(record):
        text = record.getMessage()
        if hasattr(record, *GOES_ON):
            return True
        new = record.levelno >= logging.WARNING and text not in said
        said.update([text] * new)
        return new

    LOGGER.addFilter(shown)
    try:
        yield
    finally:
        LOGGER.removeFilter(shown)


def info(message, *args):
    """Log a line, ``message % args``."""
    LOGGER.info(message, *args)


def notice(text):
    """Log a line that a caller of the library sees, too, who would else wait in silence: on standard error."""
    if _State.stream is None and _State.rank == 0 and not LOGGER.disabled:
        heard = (handler for handler in (*LOGGER.handlers, *logging.getLogger().handlers)
                 if not isinstance(handler, logging.NullHandler))  # fmt: skip
        if not (LOGGER.isEnabledFor(logging.INFO) and any(heard)):
            with suppress(OSError, ValueError):
                process.put(sys.stderr, f"pcontact: {text}\n")
            return
    info("%s", text)


def coloured(text, colour):
    """Text that a line of :func:`info` is made of, red, green or yellow where that goes to a terminal."""
    return _painted(text, colour) if _State.stream is not None and _coloured(_State.stream) else text


def warning(message, *args):
    """Log a line marked as a warning, and keep it for the report."""
    text = message % args if args else message
    if text not in _State.warnings:
        _State.warnings = (*_State.warnings, text)
    LOGGER.warning(message, *args)


def warnings():
    """Lines of all warnings since :func:`forget_warnings`, each once."""
    return list(_State.warnings)


def forget_warnings():
    """A new run begins."""
    _State.warnings = ()


def debug(message, *args):
    """Log a line that is shown at level "debug" only."""
    LOGGER.debug(message, *args)


def error_line(message, stream=None):
    """Tell the user in one line what is wrong; on ranks that do not speak, nothing.

    Parameters
    ----------
    message : str or Exception
        What is wrong; line breaks become blanks.
    stream : file object, optional
        Where to; standard error if absent, so that it is seen when the output goes to a file.
    """
    if not _State.speaks:
        return
    mark, stream = "" if _State.rank == 0 else f"[{_State.rank}] ", stream or sys.stderr
    head = _painted("pcontact: error:", "red") if _coloured(stream) else "pcontact: error:"
    # nobody may be there to read it; the exit status says it, too
    with suppress(OSError, ValueError):
        _put(stream, f"{mark}{head} {_visible(' '.join(str(message).split()))}\n")


def finish():
    """Write what is left in the buffer of the standard output. To be called at the end of a program."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    process.give_up(sys.stdout)


class _OnTerminal:
    """What tqdm draws on a terminal; none where there is no bar."""

    _bar = None

    def close(self):
        """Take it away."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.close()
            self._bar = None


class Progress(_OnTerminal):
    """Progress of a run: a bar on a terminal, plain log lines in a file. A context manager.

    Parameters
    ----------
    total : float
        The value at which the work is done (the end time, a count); positive.
    label : str
        Stands before the numbers.
    lines : int
        In a file, about this many lines are written on the way from 0 to `total`; 0: none.

    Notes
    -----
    The work need not come in equal or whole steps. The stream is that of `setup`, without which there is no bar; only
    rank 0 shows progress, and only where it shows lines.
    """

    def __init__(self, total, label="", lines=10):
        stream, shown = _State.stream, LOGGER.isEnabledFor(logging.INFO)
        self.total, self.label, self.lines, self.value = total, label, lines, 0.0
        self._shown, self._drawn, self._said = 0, 0.0, clock.monotonic()
        if _State.rank == 0 and shown and process.is_terminal(stream):
            # before the postfix there is a comma
            form = "{desc} {percentage:3.0f}% |{bar:30}| {elapsed}, {remaining} left{postfix}"
            self._bar = tqdm(total=total, desc=label, file=stream, leave=False, bar_format=form,
                             dynamic_ncols=True)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def to(self, value, text=""):
        """Move on to `value`, between 0 and `total`, with a remark."""
        step, self.value, self._said = value - self.value, value, clock.monotonic()
        if self._bar is not None:
            try:
                self._bar.set_postfix_str(text, refresh=False)
                self._bar.update(step)
            except OSError:
                # the terminal is gone
                self._bar.disable, self._bar = True, None
            return
        if not self.lines:
            return
        # the small shift: ten steps of 0.1 are ten tenths
        reached = int(self.lines * value / self.total + 1e-9)
        if reached > self._shown and _State.rank == 0:
            self._shown = reached
            info("%s", " ".join(filter(None, [self.label, f"{100 * value / self.total:.0f} %", text])))

    def say(self, text):
        """Show a remark on the bar; in a file, if nothing was said for `IN_FILE` seconds, as a line."""
        now = clock.monotonic()
        if self._bar is not None:
            with suppress(OSError):
                self._bar.set_postfix_str(text, refresh=False)
                # no more often than tqdm draws
                if now - self._drawn > self._bar.mininterval:
                    self._bar.refresh()
                    self._drawn = now
        elif _State.rank == 0 and now - self._said >= IN_FILE:
            self._said = now
            LOGGER.info("%s", text, extra=GOES_ON)


class Line(_OnTerminal):
    """A line that changes, on a terminal; it stands below a bar that is there.

    Attributes
    ----------
    shown : bool
        Whether it is there: in a file there is none.
    """

    def __init__(self):
        stream = _State.stream if _State.stream is not None else sys.stderr
        wanted = _State.stream is None or LOGGER.isEnabledFor(logging.INFO)
        if _State.rank == 0 and wanted and not LOGGER.disabled and process.is_terminal(stream):
            self._bar = tqdm(file=stream, leave=False, bar_format="{desc}")

    @property
    def shown(self):
        return self._bar is not None

    def say(self, text):
        """Show another text."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.set_description_str(text)
