"""The standard streams, which may be closed, full, or read by somebody who has stopped."""

import io
import os
import sys


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
    """Whether somebody may be looking at it."""
    try:
        return stream.isatty()
    except (AttributeError, ValueError):
        return False


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
