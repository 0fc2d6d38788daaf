"""Signals: what the caller wants ignored stays so, and a run that is stopped says so in one line.

No file is ever half written, so that a process may end at any moment: nothing has to be unwound, neither through
Python nor through PETSc. What is worth a moment before says so (:func:`last_words`).
"""

import os
import signal
import threading
from contextlib import contextmanager

from pcontact.runtime.files import discard_all

# those that ask for the end
STOPS = (signal.SIGINT, signal.SIGTERM)
# those that PETSc and gmsh take for themselves when they start, whatever the caller wants: nohup has SIGHUP ignored,
# Python SIGPIPE, for it gets an error instead where nobody reads
TAKEN = (signal.SIGHUP, signal.SIGPIPE, *STOPS)
# what is done before the process ends
_last = []


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
