"""Bodies that find no equilibrium at the loads of a time go on with inertia until they rest."""

from dataclasses import replace

from pcontact.runtime import log


class Snaps:
    """Leads bodies that find no equilibrium at standing loads to the next one, with inertia.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        With a snap among its features.
    energy : pcontact.stepping.energy.EnergyBalance or None
        Sums up the works of the motion.
    """

    def __init__(self, problem, energy):
        self._problem, self._snap, self._energy = problem, problem.features.snap, energy

    def __call__(self, u, begin, target, failed, attempt):
        """Lead bodies to rest. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
            The committed displacement; overwritten.
        begin, target : float
            Time of the committed displacement, and of the loads, which stand still.
        failed : pcontact.solve.convergence.NewtonResult
            Of the load step to there.
        attempt : callable
            Solves a load step to a time, from a committed displacement, into ``u``.

        Returns
        -------
        result : pcontact.solve.convergence.NewtonResult
            Of the load step in which the bodies rest again; of that which failed if they find no rest.
        before : PETSc.Vec
            The committed displacement from which it has begun.
        """
        snap, taken = self._snap, self._snap.taken.carried
        log.info("time %.6g: no equilibrium near by (%s): on with inertia, until bodies rest", target, failed.reason)
        snap.release()
        while True:
            before = u.copy()
            result = attempt(target, before)
            if not result.converged:
                before.copy(u)
                if snap.shorten():
                    continue
                snap.hold()
                reason = f"{failed.reason}; nor did bodies that move find rest ({result.reason})"
                return replace(failed, reason=reason, final=True), before
            if self._energy is not None:
                self._energy.account(u, before, begin, target)
            begin = target
            for item in self._problem.items:
                item.commit(u, target)
            if not snap.rests(result.newton):
                continue
            before, step = u.copy(), snap.hold()
            result = attempt(target, before)
            if result.converged:
                log.info("time %.6g: bodies rest after %d steps of their motion, which has taken an energy of %.6g",
                         target, snap.steps, snap.taken.carried - taken)  # fmt: skip
                return result, before
            before.copy(u)
            snap.go_on(step)
