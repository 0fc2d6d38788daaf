"""Findings of one run for the loop: the estimates of all load steps, and where the bodies were at their ends."""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import reference_nodes, shape
from pcontact.runtime.observer import Observer

# [bytes] What a rank keeps of the displacements of load steps for the next mesh. From: chosen; a ball pressed into
# metal at 5 % has 167 load steps of 11,020 unknowns, 15 MB.
ROOM = 2**26
# [-] Part of the time by which two ends of load steps may differ. From: rounding.
SAME_TIME = 1e-9


class Known(NamedTuple):
    """Places of the bodies, at all nodes of a mesh of this rank.

    Attributes
    ----------
    times : list of float
        Ends of load steps.
    fields : list of ndarray (n_nodes, d)
        Displacements then [length].
    every : bool
        Whether these are all load steps.
    """

    times: list
    fields: list
    every: bool = True

    def moved(self, function):
        """The same on another mesh: ``function(fields)`` takes a list of fields there."""
        return self._replace(fields=function(self.fields))


class Watch(Observer):
    """Observer of one run: what its load steps say.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation

    Attributes
    ----------
    times, fields
        As of :class:`Known`; where there is no room for all of them, of every other load step, or fewer, but always the
        last.
    squares : ndarray (n_cells,)
        Largest squared estimates of the cells of this rank over the load steps, block after block [energy].
    absolute, norm, algebraic : float
        Largest of the load steps [sqrt(energy)].
    record, time, unbalanced : dict, float, ndarray (n_owned, d)
        Of the last load step; forces that the solver has left unbalanced.
    """

    def __init__(self, simulation):
        self._simulation, self.times, self.fields, self._every = simulation, [], [], True
        self.squares, self.absolute, self.norm, self.algebraic = None, 0.0, 0.0, 0.0
        self.record, self.time, self.unbalanced = None, 0.0, None
        # the same on every rank
        space = simulation.problem.space
        self._most = max(ROOM * space.comm.size // (8 * space.n_dofs), 1)

    @property
    def known(self):
        """Knowledge for another run."""
        return Known(self.times, self.fields, self._every)

    def step(self, step, u, record):
        """Take what the load step says. *Collective.*"""
        estimate = self._simulation.error_estimate
        self.times.append(step.time)
        self.fields.append(at_nodes(self._simulation.problem.space, u))
        if len(self.times) > self._most:
            # counted from the end: what bodies do between two of them is a straight line for the next mesh
            self.times, self.fields, self._every = self.times[::-2][::-1], self.fields[::-2][::-1], False
        self.record, self.time, self.unbalanced = record, step.time, step.unbalanced
        self.squares = estimate.squares
        self.absolute = max(self.absolute, estimate.over_steps)
        self.algebraic = max(self.algebraic, estimate.last["algebraic"])
        self.norm = max(self.norm, estimate.last["energy_norm"])


def at_nodes(space, u):
    """A displacement (n_nodes, d) at all nodes of the mesh of this rank, whatever its degree. *Collective.*"""
    nodal, mesh = space.local.gather(u), space.mesh
    values = np.zeros((len(mesh.points), space.dim))
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        weights = shape(block.cell, space.degree, reference_nodes(block.cell, mesh.degree))
        values[block.nodes] = np.matmul(weights, nodal[cells])
    return values


class Beginning:
    """Expected places of the bodies, for :class:`pcontact.stepping.stepper.Stages`: they move on as on the last mesh.

    Where something remembers what has happened, the displacement of the other mesh itself is farther from the solution
    than that of the last load step: friction and plastic flow of the two meshes differ by more than they change in a
    load step. Where only some load steps are known, the way between them is no straight line, and the bodies are
    expected where they go on by themselves.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That begins there.
    known : Known
        At the nodes of its mesh.
    """

    def __init__(self, simulation, known):
        space = simulation.problem.space
        rows = space.mesh_nodes[space.owned_local]
        self._simulation, self._times, self._every = simulation, np.array([0.0, *known.times]), known.every
        self._fields = [np.zeros((len(rows), space.dim)), *(field[rows] for field in known.fields)]

    def __call__(self, time):
        """The displacement (n_owned, d) at the end of a load step; None where that of the last mesh is not known."""
        stepper = self._simulation.stepper
        if not self._every:
            return None
        before, then = self.at(stepper.schedule.time), self.at(time)
        if before is None or then is None:
            return None
        return stepper.u.getArray(readonly=True).reshape(then.shape) + (then - before)

    def at(self, time):
        """The displacement of the last mesh; between ends of load steps the mean."""
        after = int(np.searchsorted(self._times, time * (1.0 - SAME_TIME)))
        if after == len(self._times):
            return None
        if after == 0:
            return self._fields[0]
        begin, end = self._times[after - 1 : after + 1]
        part = min((time - begin) / (end - begin), 1.0)
        return part * self._fields[after] + (1.0 - part) * self._fields[after - 1]
