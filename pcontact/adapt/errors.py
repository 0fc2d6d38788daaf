"""Errors that a pass names, and which cells they come from."""

from copy import copy

import numpy as np

from pcontact.adapt.effectivity import Effectivity, unseen
from pcontact.adapt.passes import Pass
from pcontact.adapt.secondary import Runs, Secondary
from pcontact.adapt.settings import FACETS, NOTICED, THIRD
from pcontact.element.reference import CELLS
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI, PETSc

# [-] Of the displacements, or of the forces, that there are: a quantity below is zero but for rounding. From: chosen.
ZERO = 1e-9


class Measures:
    """Measures the errors of passes, of one thing or several: a pass says what the one with the largest error says.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
    """

    def __init__(self, target, settings):
        runs, self._settings = Runs(target), settings
        self._each = [Measure(one, settings, runs) for one in target.each]

    def __call__(self, simulation, watch, seconds):
        """Errors that a pass has shown; parameters as of :class:`Measure`. *Collective.*"""
        watches = [watch] + [copy(watch) for _ in self._each[1:]]
        found = [measure(simulation, own, seconds) for measure, own in zip(self._each, watches, strict=True)]
        for measure, own in zip(self._each, watches, strict=True):
            measure.sum_up(simulation, own)
        done = max(found, key=lambda one: one.error)
        if len(found) > 1:
            # a cell is refined for what it has most of, in parts of the squared error that is to be left
            sums = simulation.comm.allreduce(np.array([own.squares.sum() for own in watches]), op=MPI.SUM)
            shares = [(one.parts["mesh"] / self._settings.goal) ** (2.0 / one.power) / (total or 1.0)
                      for one, total in zip(found, sums, strict=True)]  # fmt: skip
            watch.squares = np.max([share * one.squares for share, one in zip(shares, watches, strict=True)], axis=0)
            done.each, done.trials = found, sum(one.trials for one in found)
            done.confirmed = all(one.confirmed for one in found)
        return done

    @property
    def complete(self):
        """Return True if the errors that the mesh has no part in are known."""
        return all(one.complete for one in self._each)

    def finish(self, simulation, watch):
        """Measure the errors that the mesh has no part in where no pass has been near the target. *Collective.*"""
        for one in self._each:
            one.finish(simulation, watch)


class Measure:
    """Measures the errors of passes, of one thing.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
    runs : pcontact.adapt.secondary.Runs, optional
        See :class:`pcontact.adapt.secondary.Secondary`.
    """

    def __init__(self, target, settings, runs=None):
        self._target, self._settings, self._passes = target, settings, []
        self._secondary, self._effectivity = Secondary(target, settings, runs), Effectivity(target)
        self._last = None

    def __call__(self, simulation, watch, seconds):
        """Errors that the mesh of a pass has shown; the rest is that of :meth:`sum_up`. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run.
        watch : pcontact.adapt.passes.Watch
            Its squares become those of the error that is named.
        seconds : float
            That it has taken.

        Returns
        -------
        pcontact.adapt.passes.Pass
        """
        space, mesh, comm = simulation.problem.space, simulation.mesh, simulation.comm
        norm, confirmed, floor = watch.norm if watch.norm > 0.0 else 1.0, True, 0.0
        estimate, size, found, likely, part = watch.absolute / norm, norm, None, 0.0, 1.0
        beside = {"algebraic": watch.algebraic / norm}
        loads, forces = simulation.error_estimate.of_loads(watch.time, 0.5 * NOTICED * self._settings.goal * norm)
        beside["loads"] = loads / norm
        if self._target.quantity == "energy":
            part, known = self._effectivity.part(simulation, watch, norm * self._of_other_steps())
            estimate /= part
        else:
            found = simulation.error_estimate.of_quantity(
                self._target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            known, size = self._effectivity.of_quantity(mesh.dim), self._size(simulation, watch, found.value)
            error, likely = self._effectivity.error(simulation, found)
            found = found._replace(error=error)
            estimate = abs(found.error) / size
            watch.squares = self._indicators(simulation, watch, found)
            if self._target.quantity != "pressure":
                beside = {"algebraic": abs(found.algebraic) / size, "loads": abs(found.loads) / size}
                if not self._passes:
                    # contributions cancel by chance, and either estimate may be as much of its error as meshes show
                    # that none has been compared with
                    floor, least = found.bound / size, unseen(space).least
                    confirmed = floor <= least**2 * self._settings.goal and not simulation.scene.plastic
                # where nothing touches what it is of, neither knows anything: it may be all of it
                floor = floor if found.bound > 0.0 else 1.0
        times = simulation.times()
        done = Pass(
            unknowns=space.n_dofs, cells=mesh.n_cells_total, degree=space.degree, estimate=estimate, known=known,
            parts={"mesh": max(estimate / known.least, floor), **beside}, steps=self._settings.steps,
            seconds=seconds, solve=times["solve"], memory=times["peak_memory_mb"] * 2.0**20,
            entries=simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"],
            part=part, of=self._target.of, confirmed=confirmed,
        )  # fmt: skip
        self._add_loads(comm, watch, forces, done.parts)
        if self._effectivity.unforeseen:
            # the mesh before is not the better one because its error was not seen there
            change, left = self._effectivity.unforeseen / size, done.parts["mesh"]
            self._passes[-1].at_least(np.hypot(change, left) if self._target.quantity == "energy" else change + left)
        self._last = found, likely, size
        self._passes.append(done)
        return done

    @property
    def complete(self):
        """Return True if the errors that the mesh has no part in are known."""
        return self._secondary.known

    def finish(self, simulation, watch):
        """Measure the errors that the mesh has no part in where no pass has been near the target. *Collective.*"""
        if not self.complete:
            before, done = set(self._passes[-1].parts), self._passes[-1]
            self.sum_up(simulation, watch, True)
            others = {name: found for name, found in done.parts.items() if name not in before}
            for one in self._passes[:-1]:
                one.parts = one.parts | others
                one.error, one.expected = one.error + sum(others.values()), one.expected + sum(others.values())

    def sum_up(self, simulation, watch, last=False):
        """Add the errors of the last pass that the mesh has no part in, and enter the sum. *Collective.*"""
        (found, likely, size), done = self._last, self._passes[-1]
        others, toward = self._secondary.parts(simulation, watch, done, size, last)
        done.parts |= others
        self._add_facets(simulation, watch, done.parts)
        done.error = sum(done.parts.values())
        if found is not None:
            done.quantity = self._quantity(found, likely, toward * size)
            if self._effectivity.told:
                done.quantity["told_by"] = self._effectivity.told
            found = found._replace(error=likely)
        done.expected = self._expected(done, found, toward, size)

    def _size(self, simulation, watch, value):
        """Divisor of errors of a quantity: its size, but not that of rounding errors where it is zero.
        *Collective.*"""
        if self._target.quantity == "pressure":
            return abs(value) or 1.0
        scale = simulation.stepper.u.norm(PETSc.NormType.NORM_INFINITY)
        if self._target.quantity != "displacement":
            # twice the strain energy over it: forces there are, if not their sum
            scale = watch.norm**2 / scale if scale > 0.0 else 0.0
        if abs(value) < ZERO * scale and not self._passes:
            log.warning("%s is zero but for rounding: its errors are named over %.3g", self._target.of, ZERO * scale)
        return max(abs(value), ZERO * scale) or 1.0

    def _expected(self, done, found, toward, size):
        """The error that a pass expects, relative: not the largest that there may be.

        What waves in the cells is at right angles to what facets change: squares of both norms add up. Changes of a
        number have signs, and cancel; that of facets adds up by its square.
        """
        parts = done.parts
        facets = sum(parts.get(name, 0.0) for name in FACETS if name in self._settings.staying)
        if found is None or self._target.quantity == "pressure":
            return float(np.hypot(done.estimate, facets)) + done.error - parts["mesh"] - facets
        return float(np.hypot((found.error + found.loads + found.algebraic) / size + toward, facets))

    def _of_other_steps(self):
        """Errors of the load steps of this pass and the last one together, relative; 0 where these are the same."""
        if not self._passes or self._passes[-1].steps == self._settings.steps:
            return 0.0
        return float(np.hypot(*map(self._secondary.of_steps, (self._passes[-1].steps, self._settings.steps))))

    def _indicators(self, simulation, watch, found):
        """Parts of cells in the error of a quantity, where that is what the mesh is refined for. *Collective.*"""
        own = np.concatenate([np.zeros(0), *found.cells])
        if self._target.quantity != "pressure" and (simulation.scene.plastic or found.bound == 0.0):
            # the dual problem knows the last load step alone, or nothing
            return watch.squares
        if self._target.quantity != "pressure":
            return np.abs(own)
        # the pressure is that of cells on the contact, and depends on the stress of all others: as much as they have in
        # the energy norm, but no more than the contact itself
        pressure, others = own / (found.value**2 or 1.0), watch.squares / (watch.norm**2 or 1.0)
        sums = simulation.comm.allreduce(np.array([pressure.sum(), others.sum()]), op=MPI.SUM)
        return pressure + min(sums[0] / (sums[1] or 1.0), 1.0) * others

    def _add_loads(self, comm, watch, forces, parts):
        """Let the indicators have cells whose loads are integrated badly, by their share. *Collective.*"""
        if parts["loads"] <= THIRD * self._settings.goal:
            return
        _add(comm, watch, np.concatenate([np.zeros(0), *forces]), parts["loads"], parts["mesh"])

    def _add_facets(self, simulation, watch, parts):
        """Let the indicators have cells whose facets come nearer to the geometry when they are cut, by their share:
        what a facet is off is of the degree of the cells, and so falls as their squares do. *Collective.*"""
        large = sum(parts.get(name, 0.0) for name in FACETS)
        if self._settings.staying or large <= THIRD * self._settings.goal:
            return
        mesh, own = simulation.mesh, np.zeros(len(watch.squares))
        first = np.cumsum([0] + [len(block.nodes) for block in mesh.blocks])
        contacts = [one for one in simulation.scene.contacts if not one.tied]
        for name in sorted({name for one in contacts for name in (one.source, one.target)} & set(mesh.facet_groups)):
            for some in mesh.facet_groups[name]:
                x = mesh.points[mesh.facet_nodes(some)[:, : CELLS[some.kind].n_vertices]]
                size = np.linalg.norm(x - x[:, :1], axis=2).max(axis=1)
                np.add.at(own, first[some.block] + some.cells, size ** ((4.0 if mesh.curved else 2.0) + mesh.dim))
        _add(simulation.comm, watch, own, large, parts["mesh"])

    def _quantity(self, found, likely, toward):
        """Value of a quantity, and what it is extrapolated to, with an uncertainty. `likely`: the error of the mesh as
        it is expected, `toward`: what settings beside the mesh change, with signs."""
        if self._target.quantity == "pressure":
            return {"value": found.value, "error": found.error}
        best = found.value + likely + found.loads + found.algebraic + toward
        # what is left of the estimate's own error; and, once there are two, by how much such values differ
        others = [abs(one.quantity["extrapolated"] - best) for one in self._passes[-2:-1]]
        unsure = max([0.5 * (abs(found.error) + abs(toward)), *others])
        return {"value": found.value, "error": found.error, "extrapolated": best, "uncertainty": unsure}


def _add(comm, watch, own, part, mesh):
    """Add to the squares of cells what they have in a part of the error beside that of the mesh. *Collective.*"""
    sums = comm.allreduce(np.array([own.sum(), watch.squares.sum()]), op=MPI.SUM)
    ratio = (part / mesh) ** 2 if mesh > 0.0 else 1.0
    watch.squares = watch.squares + ratio * (sums[1] or 1.0) / (sums[0] or 1.0) * own
