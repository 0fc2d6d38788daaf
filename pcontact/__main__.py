"""``python -m pcontact``, and the command ``pcontact``."""

import signal

# until the program can say that it was stopped: loading it takes a second or two, and a traceback says nothing
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from pcontact.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
