"""One run: scene -> mesh -> space -> items -> stepper -> observers."""

import difflib
import gc
import time as clock
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

import pcontact
from pcontact import build
from pcontact.io.checkpoint import Checkpoint, remembering
from pcontact.io.cost_report import CostReport
from pcontact.io.counters import Counters
from pcontact.io.error_estimate import ErrorEstimate, label
from pcontact.io.identity import Identity
from pcontact.io.observers import FacetErrors, Fields, Records, SmallStrain, Terminal
from pcontact.io.restart import ANYWAY, read_checkpoint
from pcontact.io.snapshot import Snapshot
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime import log, profile
from pcontact.runtime.errors import TOLD, StepFailure, Stopped
from pcontact.runtime.jit import CALLS, tell_uncached
from pcontact.runtime.lock import reserved
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, free_garbage
from pcontact.runtime.presets import Choice
from pcontact.scene import describe
from pcontact.scene.amplitude import drive
from pcontact.solve.newton import Newton
from pcontact.space.modes import near_null_space
from pcontact.stepping.loose import LooseBodies
from pcontact.stepping.partner_update import partner_update
from pcontact.stepping.record import Recorder
from pcontact.stepping.schedule import Control, Schedule
from pcontact.stepping.search_update import search_update
from pcontact.stepping.stepper import Stages, Stepper
from pcontact.stepping.uzawa import uzawa


class Simulation:
    """Everything that a scene needs to run, built and ready.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        It is left as it is.
    comm : MPI.Comm, optional
    said : str
        Where the user gives options, for messages.

    Attributes
    ----------
    failure : StepFailure or None
        Why the run ended early, if a load step did not converge.
    stopped : bool
        Whether an observer ended it.
    records, snapshot : pcontact.io.observers.Records, pcontact.io.snapshot.Snapshot or None
        Report and history, and the fields of the last load step that converged, of a run that was asked for them.

    Raises
    ------
    InputError
        On every rank.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, scene, comm=MPI.COMM_WORLD, said="command line"):
        self.start = clock.perf_counter()
        self.timing = dict.fromkeys(("search", "assembly", "linear", "solve", "output"), 0.0)
        self.comm, self.options, self.profile, self.calls = comm, Options(said), profile.Profile(), CALLS.copy()
        self.failure, self.stopped, self.records, self.snapshot = None, False, None, None
        self.problem = self.newton = None
        self.restart = self.options.get("restart")
        self.anyway = self.options.get(ANYWAY)
        try:
            with profile.recording(self.profile):
                self._set_up(scene)
        except TOLD:
            self.free()
            raise
        except BaseException:
            # what this scene entered is not for the next one
            self.close()
            raise
        self.timing["setup"] = clock.perf_counter() - self.start

    def _set_up(self, scene):
        # several runs of one process have their own peaks; what earlier ones left is freed first
        free_garbage(self.comm)
        log.forget_warnings()
        tell_uncached()
        profile.forget_peak()
        profile.mark("start")
        self.accuracy = Choice()
        self.scene = build.override(scene, self.options, self.accuracy)
        self.mesh = build.read(self.scene, self.comm, self.options)
        self.scene.mesh.order = self.accuracy.order(self.scene.mesh.order, self.mesh.curved)
        with profile.phase("set_up"):
            self._assemble()
        profile.mark("set_up")

    def _assemble(self):
        self.problem, colours, motions = build.assemble(self.scene, self.mesh)
        self.floating = {k: len(rows) for k, rows in motions.items()}
        self.costs, self.counters = CostReport(self.profile, self.problem), Counters(self.problem, self.calls)
        # slip of Coulomb's law makes the tangent unsymmetric for every theta; that of Tresca's does not. Where a source
        # yields, the traction's derivative is not the adjoint operator, that of elasticity. Without a traction of the
        # source there is nothing unsymmetric but the slip
        symmetric = all(item.symmetric for item in self.problem.items)
        modes = near_null_space(self.problem.space, colours, None, self.problem.followers)
        self.accuracy.propose(self.options, self.problem.linear)
        turns = self.problem.extrapolates
        modes_at = partial(near_null_space, self.problem.space, colours) if turns else None
        self.newton = Newton(self.problem, self.options, symmetric, modes, self.timing, motions, modes_at)
        self.settle = uzawa(self.problem.contacts, self.newton, self.options)
        self.renew = partner_update(self.problem, self.newton)
        if self.renew is None:
            self.renew = search_update(self.problem, self.newton, self.options)
        meets = motions and not self.problem.linear
        self.rest = LooseBodies(self.problem, motions) if meets else None

    def run(self, directory=None, observers=(), keep=False, said="command line: -o"):
        """All load steps. *Collective.*

        Parameters
        ----------
        directory : str or pathlib.Path, optional
            Where results go; absent: nothing is written.
        observers : sequence
            Further observers, see :class:`pcontact.runtime.observer.Observer`; they come last.
        keep : bool
            Keep report, history and the fields of the last load step in memory.
        said : str
            Where the user names the directory, for messages.

        Returns
        -------
        bool
            Whether all steps converged, to the end of the run.

        Raises
        ------
        InputError, OutputError
            On every rank; see :func:`pcontact.runtime.lock.reserved`, too.
        """
        with profile.recording(self.profile), reserved(directory, self.comm, said):
            return self._run(directory, observers, keep)

    def _run(self, directory, observers, keep):
        scene, space = self.scene, self.problem.space
        identity = resumed = None
        if self.restart is not None or (directory is not None and scene.output.checkpoint):
            identity = Identity.of(scene, space, remembering(self.problem.parts))
        if self.restart is not None:
            resumed = read_checkpoint(self.restart, space, identity, self.anyway)
        since = None if resumed is None else resumed.time
        obstacles = [contact.obstacle for contact in scene.contacts if contact.obstacle is not None]
        moved = [*scene.displacements, *scene.loads, *scene.temperatures, *scene.couplings, *obstacles]
        stops = [t for one in moved for t, _ in (one.amplitude or [])]
        control = Control(scene.steps.longest_step, self.problem.angle)
        schedule = Schedule(scene.steps.end, scene.steps.count, scene.steps.smallest_step, stops, control)
        watch = [Terminal(scene.steps.end, build.yielding_volume(scene, space)), *observers]
        estimate = ErrorEstimate(self.problem, scene, self.newton) if scene.output.estimate else None
        self.error_estimate = estimate
        recorder = Recorder(self.problem, scene.output.probes, [body.region for body in scene.bodies])
        carriers = {"largest_force": recorder, "direct": self.newton}
        if estimate is not None:
            carriers["largest_energy"] = estimate
        if self.problem.viscous is not None:
            carriers |= {"viscous_work": self.problem.viscous.taken, "stress_work": self.problem.viscous.stressed}
        output, writes = scene.output, directory is not None
        directory = Path(directory) if writes else None
        if keep or (writes and output.fields):
            self.snapshot = Snapshot(self.problem, self.timing, output.smooth, estimate)
        if writes or keep:
            if writes and output.checkpoint:
                first = None if resumed is None else resumed.first
                items, every = self.problem.parts, output.checkpoint_every
                watch.insert(0, Checkpoint(directory, space, items, schedule, every, identity, first, carriers))
            self.records = Records(directory, self.comm, self._head(), self._costs, since)
            watch.insert(0, self.records)
            if writes and output.fields:
                watch.insert(0, Fields(directory, self.snapshot, self.comm, self.timing, since))
        if self.snapshot is not None:
            watch.insert(0, self.snapshot)
        if estimate is not None:
            watch.insert(0, estimate)
        # the report has the warnings of those before it
        watch[:0] = [FacetErrors(self.problem.contacts), SmallStrain()]
        self._announce()
        low, high = bounding_box(self.comm, space.mesh.points)
        places = np.array(list(product(*zip(low, high, strict=True))) + [0.5 * (low + high)])
        stages = Stages(self.renew, self.settle, self.rest)
        self.stepper = Stepper(
            self.problem, self.newton, schedule, watch, recorder, self.timing, drive(scene, places), stages
        )  # fmt: skip
        if resumed is not None:
            self.stepper.resume(
                resumed.number, resumed.time, resumed.first, resumed.size, resumed.values, resumed.last
            )
            resumed.recall(self.comm, self.problem.parts)
            for name, one in carriers.items():
                one.carried = resumed.carried.get(name, 0.0)
            log.info("restart from %s at time %g after %d steps", self.restart, resumed.time, resumed.number)
        converged = True
        try:
            self.stepper.run()
        except StepFailure as failure:
            converged, self.failure = False, failure
            log.error_line(failure)
        except Stopped:
            converged, self.stopped = False, True
        for observer in watch:
            observer.end(converged)
        self.costs.announce()
        return converged

    def close(self):
        """Take what this run entered back out of the options database, for the next scene."""
        self.options.withdraw()

    def unused(self, ours=()):
        """Lines about options that the user gave and nothing asked for.

        Parameters
        ----------
        ours : sequence of str
            Names that somebody else has dealt with.
        """
        # a default that found no use (of a preconditioner that the user replaced) is not the user's mistake
        lines = []
        for name in self.options.unused([*ours, *self.newton.applied, *self.accuracy.chosen]):
            near = difflib.get_close_matches(name, self.options.known, 1)
            lines.append(f"option -{name} was not used" + (f"; the nearest is -{near[0]}" if near else ""))
        return lines

    def free(self):
        """Give what the run has of PETSc and MPI back: it cannot go on. *Collective.*

        Python alone does not: SNES keeps the problem, whose matrices it solves with, and communicators are nobody's.
        """
        self.close()
        if self.problem is None:
            return
        if self.newton is not None:
            self.newton.free()
        self.problem.space.exchanger.free()
        self.problem = self.newton = self.stepper = self.settle = self.renew = self.rest = None
        self.costs = self.counters = self.records = self.error_estimate = self.mesh = None
        gc.collect()
        free_garbage(self.comm)

    def describe(self):
        """What is modelled and what is left out, see :func:`pcontact.scene.describe`. *Collective.*"""
        return describe(self.scene, self.mesh.dim, build.averaged_bodies(self.scene, self.problem.space))

    def _head(self):
        active, left_out = self.describe()
        estimate = {"estimate": {"label": label(self.scene)}} if self.scene.output.estimate else {}
        return {
            **estimate,
            "mesh": str(Path(self.scene.mesh_path).resolve()),
            "title": self.scene.title,
            "version": pcontact.__version__,
            "ranks": self.comm.size,
            "dofs": self.problem.space.n_dofs,
            "cells": self.mesh.n_cells_total,
            "accuracy": self.accuracy.report(),
            "model": {"active": active, "left_out": left_out},
            "solver": self.newton.solver,
        }

    def _announce(self):
        head = self._head()
        log.info("pcontact %s: %s", head["version"], head["title"] or "untitled")
        log.info("%d unknowns, %d cells, %d ranks", head["dofs"], head["cells"], head["ranks"])
        for line in self.accuracy.lines():
            log.info("%s", line)
        log.info("modelled: %s", "; ".join(head["model"]["active"]))
        log.info("left out: %s", ", ".join(head["model"]["left_out"]))
        solver = head["solver"]
        log.info(
            "linear solver: %s + %s, %d rigid modes, tangent %ssymmetric, filter %s, set-up %s",
            solver["krylov"], solver["preconditioner"], solver["rigid_modes"], "" if solver["symmetric"] else "not ",
            solver["filter"], "kept while it serves" if solver["reused"] else "always new",
        )  # fmt: skip

    def _costs(self):
        costs = {"timing": self.times(), "parallel": self.costs.parallel(), "memory": self.costs.memory()}
        return {**costs, "counters": self.counters()}

    def times(self):
        """Timing block of the report: the slowest rank's seconds, memory summed over ranks. *Collective.*"""
        own = {**self.timing, "total": clock.perf_counter() - self.start}
        names = sorted(own)
        slowest, _ = profile.largest_and_sum(self.comm, names, own)
        memory = self.comm.allreduce(profile.memory()[0] / 1024.0**2)
        return {**slowest, "phases": self.costs.phases(), "peak_memory_mb": memory}
