"""What can go wrong, by whose hand."""


class InputError(Exception):
    """The input is wrong: one line for the user, exit status 2.

    Parameters
    ----------
    message : str
        One line naming the file, the key (group, cell), what was found and what is allowed.
    """

    status = 2


class OutputError(Exception):
    """Output cannot be written, or another run writes there: one line for the user, exit status 3.

    What was written before is whole.

    Parameters
    ----------
    message : str
        One line naming the file and the reason.
    """

    status = 3


# what ends a program with one line, the same on every rank
TOLD = (InputError, OutputError)


class StepFailure(Exception):
    """A load step did not converge even at the smallest step: exit status 1."""
