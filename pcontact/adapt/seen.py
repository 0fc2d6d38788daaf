"""What the change of the solution from one mesh to a finer one says of the estimate, where theory says nothing.

With u_1 on a mesh and u_2 on a finer one, the errors e_1 and e_2 have  e_1^2 = e_2^2 + |u_2 - u_1|^2  if the solutions
are projections. Of estimates that are the same part k of the error then

    k^2 = (estimate_1^2 - estimate_2^2) / |u_2 - u_1|^2

Where bodies yield without hardening, what one cell lacks makes cells far from it flow more, or less, and this part of
the error is in no residual of theirs.
"""

import numpy as np

from pcontact import build
from pcontact.adapt.variants import solved
from pcontact.adapt.watch import at_nodes
from pcontact.estimate.goal import value
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD

# [-] Estimates over each other that count at most, and the part that counts at least. From: the difference of two that
# hardly differ says nothing.
ALIKE, LEAST = 0.8, 0.25
# [-] The error of a quantity over its change when all cells are halved. From: it becomes a quarter of what it was.
FARTHER = 4.0 / 3.0


def part_of(coarse, fine, change):
    """The part of the error that estimates are, at most 1.

    Parameters
    ----------
    coarse, fine : float
        Estimates on both meshes [sqrt(energy)].
    change : float
        Energy norm of the difference of the displacements [sqrt(energy)].
    """
    if not (coarse > 0.0 and change > 0.0):
        return 1.0
    return float(np.clip(coarse * np.sqrt(1.0 - min(fine / coarse, ALIKE) ** 2) / change, LEAST, 1.0))


def between(simulation, before, coarse):
    """The part that the last two passes have seen. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        Of the finer mesh, that has run.
    before : ndarray (n_owned, d)
        Displacement on the coarser mesh [length].
    coarse : float
        The estimate there [sqrt(energy)].
    """
    change = simulation.stepper.u.copy()
    change.setArray(change.getArray(readonly=True) - before.ravel())
    return part_of(coarse, simulation.error_estimate.last["absolute"], simulation.error_estimate.norm(change))


def left_of(error, before, change):
    """The error of a quantity that may be left: no less than that of the last mesh without what has changed since, and
    what a change may stand for.

    Parameters
    ----------
    error : float
        Estimated, and divided by the part that estimates have been seen to be.
    before, change : float
        Error that was left on the last mesh, and change of the quantity.
    """
    return max(error, before - FARTHER * change)


def on_halved(simulation, scene, options, found):
    """What is found on the mesh with all cells halved; nan where the run there does not converge. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    scene : pcontact.scene.model.Scene
        To be run.
    options : pcontact.runtime.options.Options
    found : callable
        ``found(run, record, before)`` with the simulation there, the record of its last load step and the displacement
        (n_owned, d) of `simulation`.

    Returns
    -------
    float
    """
    mesh, space = simulation.mesh, simulation.problem.space
    scene.output.estimate, scene.output.checkpoint, scene.mesh.order = True, False, space.degree
    cells = sum(len(block.nodes) for block in mesh.blocks)
    more, balance = np.full(cells, mesh.dim), Balance(*build.balance(scene, options))
    finer, fields = refine(mesh, more, [at_nodes(space, simulation.stepper.u)], balance)
    try:
        with solved(scene, simulation.comm, simulation.options.said, finer) as (run, record):
            if record is None:
                return float("nan")
            own = run.problem.space
            return found(run, record, fields[0][own.mesh_nodes[own.owned_local]])
    except TOLD:
        return float("nan")


class Seen:
    """What the meshes of a loop have shown of the estimate.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
    options : pcontact.runtime.options.Options
    """

    def __init__(self, target, settings, options):
        self._target, self._settings, self._options = target, settings, options
        # estimate (and value) and degree of the last pass, and what part of the error estimates have been seen to be
        self._before, self._part = None, 1.0

    def part(self, simulation, watch):
        """What part of the error of the displacement the estimate is: 1 but where bodies yield. *Collective.*"""
        own, degree = simulation.error_estimate.last["absolute"], simulation.problem.space.degree
        if not _yields(simulation.scene):
            return 1.0
        old, self._before, part = self._before, (own, degree), float("nan")
        if old is None or old[1] != degree:
            part = self._on_halved(simulation, lambda run, _, before: between(run, before, own))
        elif simulation.begin.at(watch.time) is not None:
            part = between(simulation, simulation.begin.at(watch.time), old[0])
        # a mesh that has changed the solution little says little
        self._part = min(self._part, part) if np.isfinite(part) else self._part
        return self._part

    def error(self, simulation, found):
        """The error of a quantity, as estimated; where bodies yield, as the last meshes show it. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run.
        found : pcontact.estimate.goal.Goal
        """
        error, degree = abs(found.error), simulation.problem.space.degree
        if not _yields(simulation.scene) or self._target.quantity == "pressure":
            return error
        old = self._before
        if old is None or old[1] != degree:
            best = self._on_halved(simulation, lambda run, record, _: value(run.problem, self._target, record,
                                                                            run.stepper.u))  # fmt: skip
            left = max(error, FARTHER * abs(best - found.value)) if np.isfinite(best) else error
            self._part = max(error / left, LEAST) if left > 0.0 else 1.0
        else:
            left = left_of(error / self._part, old[0], abs(found.value - old[2]))
        self._before = left, degree, found.value
        return left

    def _on_halved(self, simulation, found):
        simulation.close()
        result = on_halved(simulation, self._settings.scene(), self._options, found)
        if not np.isfinite(result):
            log.warning("not known: what part of the error the estimate is where bodies yield")
        return result


def _yields(scene):
    """Whether bodies may yield."""
    return any(scene.yields(body) for body in scene.bodies)
