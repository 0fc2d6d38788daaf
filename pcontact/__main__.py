"""``python -m pcontact``, and the command ``pcontact``."""

import signal

# until the program can say that it was stopped: loading it takes a second or two, and a traceback says nothing
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import sys  # noqa: E402
from importlib import import_module  # noqa: E402

from pcontact.runtime import log, process  # noqa: E402
from pcontact.runtime.errors import InputError, NoPetsc  # noqa: E402
from pcontact.usage import answer, parse  # noqa: E402


def main(arguments=None):
    """Entry point of ``pcontact``; what says only how it is called loads no solver."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        command, about, _ = parse(arguments)
    except InputError:
        # told below, as all that is wrong
        command, about = None, None
    process.reserve()
    # of several processes the first one speaks
    log.setup(0 if process.is_first() else 1)
    if (words := answer(command, about)) is not None:
        log.info("%s", words)
        log.finish()
        return
    try:
        program = import_module("pcontact.cli")
    except NoPetsc as error:
        log.error_line(error)
        sys.exit(error.status)
    program.main(arguments)


if __name__ == "__main__":
    main()
