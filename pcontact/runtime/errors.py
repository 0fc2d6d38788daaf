"""What can go wrong, by whose hand."""


class InputError(Exception):
    """The input is wrong: one line for the user, exit status 2.

    Parameters
    ----------
    message : str
        One line naming the file, the key (group, cell), what was found and what is allowed.
    """


class StepFailure(Exception):
    """A load step did not converge even at the smallest step: exit status 1."""
