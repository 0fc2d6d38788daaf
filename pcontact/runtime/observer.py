"""Observers of a run, from load step to load step."""


class Observer:
    """Told of every load step; a subclass writes the methods that it has something to do in."""

    def step(self, step, u, record):
        """A load step has converged. *Collective.*

        Parameters
        ----------
        step : pcontact.stepping.stepper.Step
        u : PETSc.Vec
            The displacement at its end.
        record : dict
            Its scalars, as in ``report.json``; later observers see what this one adds.
        """

    def cut(self, target, result):
        """A load step to a time has failed and will be tried again, shorter.

        Parameters
        ----------
        target : float
        result : pcontact.solve.convergence.NewtonResult
        """

    def iterate(self, number, target, norms):
        """Newton's method has come to an iterate.

        Parameters
        ----------
        number : int
            Of the load step.
        target : float
            Time at which it ends.
        norms : list of float
            Of the residual, so far [force].
        """

    def end(self, converged):
        """The run has ended, and whether all of its load steps converged. *Collective.*"""
