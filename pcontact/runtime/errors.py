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
