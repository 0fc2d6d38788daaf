"""Messages of the compilation of kernels, and what it takes."""

import gc
import resource
import threading
import time as clock
from contextlib import contextmanager
from pathlib import Path

from pcontact.runtime import log

# [s] How often the line of a terminal changes, and after how long a file has another one. From: chosen; somebody who
# looks at it sees that it goes on, and who reads the file later has a few lines more.
ON_TERMINAL, IN_FILE = 0.5, 10.0

# [-] Numbers of new objects after which Python looks for cycles, while kernels are compiled. From: scenes in the plane:
# with its own, 700, it spends 12 % of a compilation on that, with these 7 %, for 16 MB.
CYCLES = 20_000, 10, 10


class _State:
    """Of this process: seconds, bytes and kernels so far; whether one is compiled, since when; what was said."""

    seconds, bytes, kernels, busy, start, said, told_at, teller = 0.0, 0, 0, False, 0.0, False, 0.0, None


def seconds():
    """Seconds that this process has compiled kernels so far, or waited for another one that did."""
    return _State.seconds


def memory():
    """Return the growth of this process so far where it compiled or loaded kernels [byte]."""
    return _State.bytes


def resident():
    """Present resident set of this process [byte]; 0 if the system does not say it."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return 0


def missed(folder):
    """A kernel is compiled, and kept in a folder (None: it is not kept). It is said once."""
    if not _State.said:
        _State.said = True
        kept = "" if folder is None else f", the first run of this kind on this machine; they are kept in {folder}"
        log.notice(f"compiling kernels{kept}")
    _State.kernels += 1
    if _State.busy and _State.teller is None:
        _State.teller = _Teller()


class _Teller(threading.Thread):
    """Says that it goes on while this process is busy: a kernel takes up to ten seconds, without a word of Python."""

    def __init__(self):
        super().__init__(daemon=True)
        self._line, self._end = log.Line(), threading.Event()
        self._say()
        self.start()

    def run(self):
        """Tell until the end."""
        while not self._end.wait(ON_TERMINAL):
            self._say()

    def _say(self):
        took = _State.seconds + clock.perf_counter() - _State.start
        text = f"compiling kernels: {_State.kernels} in {took:.0f} s"
        self._line.say(text)
        if not self._line.shown and took - _State.told_at >= IN_FILE:
            _State.told_at = took
            log.info("%s", text)

    def close(self):
        """Say no more."""
        self._end.set()
        self.join()
        self._line.close()


@contextmanager
def timed():
    """Count the seconds inside, if kernels are compiled there, and the bytes."""
    if _State.busy:
        yield
        return
    _State.start, _State.busy, own, before = clock.perf_counter(), True, gc.get_threshold(), resident()
    gc.set_threshold(*CYCLES)
    try:
        yield
    finally:
        _State.busy = False
        gc.set_threshold(*own)
        _State.bytes += resident() - before
        if _State.teller is not None:
            _State.seconds += clock.perf_counter() - _State.start
            _State.teller.close()
            _State.teller = None
