"""What is said of the compilation of kernels, and what it takes."""

import time as clock
from contextlib import contextmanager

from pcontact.runtime import log


class _State:
    """Of this process: seconds and kernels so far; whether something is being compiled, and was said."""

    seconds, kernels, busy, missed, said, count = 0.0, 0, False, False, False, None


def seconds():
    """Seconds that this process has compiled kernels so far, or waited for another one that did."""
    return _State.seconds


def missed(folder):
    """A kernel is compiled, and kept in a folder (None: it is not kept). It is said once."""
    if not _State.said:
        _State.said = True
        kept = "" if folder is None else f", the first run of this kind on this machine; they are kept in {folder}"
        log.notice(f"compiling kernels{kept}")
    _State.kernels += 1
    if _State.busy:
        _State.missed = True
        _State.count = _State.count or log.Count("compiling kernels")
        _State.count.to(_State.kernels)


@contextmanager
def timed():
    """Count the seconds inside, if kernels are compiled there."""
    if _State.busy:
        yield
        return
    start, _State.busy, _State.missed = clock.perf_counter(), True, False
    try:
        yield
    finally:
        _State.busy = False
        if _State.missed:
            _State.seconds += clock.perf_counter() - start
            _State.count.close()
            _State.count = None
