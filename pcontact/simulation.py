"""One run: scene -> mesh -> space -> items -> stepper -> observers."""

import gc
import time as clock
from contextlib import nullcontext
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

import pcontact
from pcontact import build
from pcontact.assembly.phases import borne_by, equilibrium, extend
from pcontact.io.checkpoint import ANYWAY, Checkpoint, Identity, checkpoint_time, read_checkpoint, remembering
from pcontact.io.costs import CostReport, Counters
from pcontact.io.error_estimate import ErrorEstimate, label
from pcontact.io.names import STATUS, forces_of
from pcontact.io.observers import ContactErrors, Fields, OpenContacts, Records, SmallStrain, Terminal
from pcontact.io.snapshot import Snapshot
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.plex import view
from pcontact.mesh.topology import Numbers
from pcontact.runtime import jit, log, process, profile
from pcontact.runtime.errors import TOLD, StepFailure, Stopped, nearby
from pcontact.runtime.lock import reserved
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, free_garbage
from pcontact.runtime.presets import Choice
from pcontact.scene.amplitude import corners, drive
from pcontact.scene.describe import describe
from pcontact.scene.phases import closing, come_and_go, phase_at, scene_of, spans
from pcontact.scene.validate import check_degrees
from pcontact.solve.newton import Newton
from pcontact.solve.vibration import frequencies
from pcontact.space.modes import near_null_space
from pcontact.space.space import carried
from pcontact.stepping.energy import EnergyBalance
from pcontact.stepping.load_step import load_steps
from pcontact.stepping.loose import LooseBodies
from pcontact.stepping.record import Recorder
from pcontact.stepping.schedule import Control, Schedule
from pcontact.stepping.snaps import Snaps
from pcontact.stepping.stepper import Stages, Stepper


class Lasting(NamedTuple):
    """Observers that watch all phases of a run.

    Attributes
    ----------
    warners : list of pcontact.runtime.observer.Observer
        That come before the report, which has their warnings.
    writer : pcontact.io.observers.Fields or None
    last : list of pcontact.runtime.observer.Observer
        That come after report and checkpoint.
    fields : bool
        Whether the fields of load steps are taken.
    """

    warners: list
    writer: object
    last: list
    fields: bool


class Kept(NamedTuple):
    """State of the last phase that the next one needs, on this rank.

    Attributes
    ----------
    values : ndarray (n_owned, d)
        Committed displacement [length].
    memory : dict of str to dict
        What the parts of the problem remember, by their names, see :meth:`pcontact.assembly.item.Item.memory`.
    borne : ndarray (n_owned, d)
        Forces of supports, groups and sections, see :func:`pcontact.assembly.phases.borne_by`.
    origins : dict of int to ndarray (n_owned, d)
        See :class:`pcontact.assembly.phases.Release`.
    keys : ndarray (n_owned,)
        Numbers of the nodes.
    """

    values: np.ndarray
    memory: dict
    borne: np.ndarray
    origins: dict
    keys: np.ndarray

    @classmethod
    def of(cls, problem, u, time):
        """That of a problem at its committed displacement and time. *Collective.*"""
        values = problem.space.of_owned(u).copy()
        # that begins anew
        parts = [part for part in remembering(problem.parts) if part is not problem.features.release]
        memory = {part.name: part.memory() for part in parts}
        origins = {} if problem.features.release is None else problem.features.release.origins
        return cls(values, memory, borne_by(problem, u, time), origins, problem.space.keys)

    def moved(self, space):
        """The same on the nodes of another space, and flags (n_owned,) of those that it has beyond. *Collective.*"""
        tables = [np.ones((len(self.keys), 1)), self.values, self.borne, *self.origins.values()]
        there, values, borne, *origins = (carried(space, self.keys, table) for table in tables)
        origins = dict(zip(self.origins, origins, strict=True))
        kept = self._replace(values=values, borne=borne, origins=origins, keys=space.keys)
        return kept, there[:, 0] == 0.0

    def recall(self, problem):
        """Give it to the parts of another problem that have the same names."""
        for part in remembering(problem.parts):
            for name, rows in self.memory.get(part.name, {}).items():
                part.recall(name, [rows])


class Simulation:
    """Everything that a scene needs to run, built and ready.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        It is left as it is.
    comm : MPI.Comm, optional
    said : str
        Where the user gives options, for messages.
    mesh : pcontact.mesh.mesh.Mesh or callable, optional
        That the scene is to be run on, or what makes it, from the scene with all options; absent: it is read from the
        scene's file.
    items : sequence of callable
        From the space to further items of the problem, which the scene does not know.

    Attributes
    ----------
    failure : StepFailure or None
        Why the run ended early, if a load step did not converge.
    stopped : bool
        Whether an observer ended it.
    begin : callable, optional
        Where the bodies are expected at the end of load steps, see :class:`pcontact.stepping.stepper.Stages`.
    every : bool
        Whether observers are told of every load step, see :class:`pcontact.stepping.stepper.Stepper`.
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

    def __init__(self, scene, comm=MPI.COMM_WORLD, said="command line", mesh=None, items=()):
        self.start, self._kernels = clock.perf_counter(), (jit.seconds(), jit.memory())
        self.timing = dict.fromkeys(("search", "assembly", "linear", "solve", "output"), 0.0)
        self.comm, self.options, self.profile, self.calls = comm, Options(said), profile.Profile(), jit.CALLS.copy()
        self.failure, self.stopped, self.records, self.snapshot, self.begin = None, False, None, None, None
        self.problem, self.newton, self.energy, self.every = None, None, None, True
        self._items = tuple(items)
        self.restart = self.options.get("restart")
        self.anyway = self.options.get(ANYWAY)
        try:
            with profile.recording(self.profile):
                self._set_up(scene, mesh)
        except TOLD:
            self.free()
            raise
        except BaseException:
            # what this scene entered is not for the next one
            self.close()
            raise
        self.timing["setup"] = clock.perf_counter() - self.start

    def _set_up(self, scene, mesh):
        # several runs of one process have their own peaks; what earlier ones left is freed first
        free_garbage(self.comm)
        log.forget_warnings()
        jit.tell_uncached()
        profile.forget_peak()
        profile.mark("start")
        self.accuracy = Choice()
        self.scene = build.override(scene, self.options, self.accuracy)
        # a library says what was not used to who calls it
        for line in () if process.is_library() else self.options.strange():
            log.warning("%s", line)
        if mesh is None or callable(mesh):
            self.mesh = build.read(self.scene, self.comm, self.options) if mesh is None else mesh(self.scene)
        else:
            self.mesh = mesh
        view(self.mesh)
        self.scene.mesh.order = self.accuracy.order(self.scene.mesh.order, self.mesh.degree)
        check_degrees(self.scene)
        steps = self.scene.steps
        steps.count = self.accuracy.steps(steps.count, self.scene.remembers, self.options.given("steps_count"))
        self.spans, self.number = spans(self.scene), 0
        if self.spans and self.restart is not None:
            self.number = phase_at(self.scene, checkpoint_time(self.restart, self.comm))
        self._components = Numbers.of(self.mesh) if self.spans else None
        self._changing = come_and_go(self.scene)
        if self._changing:
            build.check_present(self.scene, self.mesh)
        with profile.phase("set_up"):
            self._assemble()
        profile.spare()
        profile.mark("set_up")

    def _assemble(self):
        """The problem of the present phase, or of the run, and what solves it. *Collective.*"""
        # what acts in the phase
        self.part = closing(self.scene, self.number)
        span = self.spans[self.number] if self.number > 0 else None
        mesh = self.mesh
        if self._changing:
            self.part, mesh = build.present(self.part, mesh)
        stabilises = "stabilisation" not in (self.options.get("newton_without") or ())
        self.problem, colours, motions = build.assemble(self.part, mesh, span, self._items, stabilises)
        self.energy = None
        if self.scene.output.energy:
            self.energy = EnergyBalance(self.problem, self._parts()[:-1], self._changing)
        self.floating = {k: len(rows) for k, rows in motions.items()}
        self.costs = CostReport(self.profile, self.problem)
        self.counters = Counters(self.problem.space, self.remembering, self.calls)
        # slip of Coulomb's law makes the tangent unsymmetric for every theta; that of Tresca's does not. Where a source
        # yields, the traction's derivative is not the adjoint operator, that of elasticity. Without a traction of the
        # source there is nothing unsymmetric but the slip
        symmetric = all(item.symmetric for item in self.problem.items)
        modes = near_null_space(self.problem.space, colours, None, self.problem.conditions.followers)
        self.accuracy.propose(self.options, self.problem.linear)
        turns = self.problem.bulk.extrapolates
        modes_at = partial(near_null_space, self.problem.space, colours) if turns else None
        self.newton = Newton(self.problem, self.options, symmetric, modes, self.timing, motions, modes_at)
        self.solve = load_steps(self.problem, self.newton, self.options)
        meets = motions and not self.problem.linear
        self.rest = LooseBodies(self.problem, motions) if meets else None

    def run(self, directory=None, observers=(), keep=False, said="command line: -o", fields=True):
        """All load steps. *Collective.*

        Parameters
        ----------
        directory : str or pathlib.Path, optional
            Where results go; absent: nothing is written.
        observers : sequence
            Further observers, see :class:`pcontact.runtime.observer.Observer`; they come last.
        keep : bool
            Keep report, load steps and the fields of the last one in memory.
        said : str
            Where the user names the directory, for messages.
        fields : bool
            False: without the fields, unless they are written.

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
            return self._run(directory, observers, keep, fields)

    def _run(self, directory, observers, keep, fields):
        resumed, writes = None, directory is not None
        directory = Path(directory) if writes else None
        self._identity = None
        if self.restart is not None or (writes and self.scene.output.checkpoint):
            self._identity = Identity.of(self._parts(), self.problem.space, remembering(self.remembering))
        if self.restart is not None:
            resumed = read_checkpoint(self.restart, self.problem.space, self._identity, self.anyway)
        lasting = self._lasting(directory, observers, (keep, fields), None if resumed is None else resumed.time)
        self._announce()
        self._prepare(lasting, directory, None if resumed is None else resumed.first)
        if resumed is not None:
            if self._changing and self.problem.features.release is not None:
                # where bodies have begun is where their contacts look for partners first
                resumed.recall(self.comm, [self.problem.features.release])
            self.stepper.resume(
                resumed.number, resumed.time, resumed.first, resumed.size, resumed.values, resumed.last
            )
            resumed.recall(self.comm, self.remembering)
            if self._changing and self.problem.features.release is not None:
                self.problem.features.release.free_strains(self.problem.bulk)
            self._carry(resumed.carried)
            log.info("restart from %s at time %g after %d steps", self.restart, resumed.time, resumed.number)
        with nullcontext() if self.records is None else self.records.kept():
            converged = self._solve(lasting, directory)
            for observer in self._watch:
                observer.end(converged)
        self.costs.announce()
        return converged

    def _solve(self, lasting, directory):
        """The load steps of all phases; whether they converged, to the end of the run. *Collective.*"""
        try:
            self.stepper.run()
            while self.number + 1 < len(self.spans):
                self._go_on(lasting, directory)
                self.stepper.run()
        except StepFailure as failure:
            self.failure = failure
            log.error_line(failure)
        except Stopped:
            self.stopped = True
        return self.failure is None and not self.stopped

    @property
    def remembering(self):
        """Parts of the problem that are counted and that checkpoints have, the energies among them."""
        return [*self.problem.parts, *([] if self.energy is None else [self.energy])]

    def _parts(self):
        """The scenes of the phases up to the present one, by what they are called; the scene of a run without any."""
        return [scene_of(self.scene, number) for number in range(self.number + 1)] if self.spans else [self.scene]

    def _lasting(self, directory, observers, kept, since):
        """The observers of the whole run, and whether fields are taken: a :class:`Lasting`. *Collective.*"""
        scene, writes = self.scene, directory is not None
        end = self.spans[-1].end if self.spans else scene.steps.end
        fields = None
        if writes and scene.output.fields:
            fields = Fields(directory, self.comm, self.timing, scene.output, since)
        if writes or kept[0]:
            self.records = Records(directory, self.comm, self._head(), self._costs, since, kept[0])
        terminal = Terminal(end, build.yielding_volume(scene, self.problem.space))
        warners = [SmallStrain()]
        if since is None:
            # self contact and contact of all surfaces stand by; a run that goes on does not know what was before
            warners.append(OpenContacts([one for one in scene.contacts if not one.all and one.source != one.target]))
        return Lasting(warners, fields, [terminal, *observers], all(kept) or fields is not None)

    def _schedule(self):
        part, begin = self.part, self.spans[self.number].begin if self.spans else 0.0
        steps, control = part.steps, Control(part.steps.longest_step, self.problem.angle)
        return Schedule(steps.end, steps.count, steps.smallest_step, corners(part), control, begin, corners(part, True))

    def _prepare(self, lasting, directory, first):
        """Schedule, observers and stepper of the present phase, or of the run. *Collective.*"""
        scene, space, output = self.part, self.problem.space, self.part.output
        schedule = self._schedule()
        estimate = ErrorEstimate(self.problem, scene, self.newton) if output.estimate else None
        self.error_estimate = estimate
        name = self.spans[self.number].name if self.spans else None
        absent = [body.region for body in scene.bodies if body.absent] if self._changing else None
        bodies = [body.region for body in scene.bodies]
        recorder = Recorder(self.problem, output.probes, bodies, name, absent, self.energy, self.newton)
        features = self.problem.features
        viscous, snap = features.viscous, features.snap
        carriers = {
            "largest_force": recorder, "direct": self.newton, "acting": self.newton.convergence,
            "largest_energy": estimate, "partners": self.solve if self.solve.items else None,
            "viscous_work": viscous and viscous.taken, "stress_work": viscous and viscous.stressed,
            "snaps": snap and snap.taken, "fastest": features.inertia,
            **(self.energy.carried if self.energy is not None else {}), **recorder.relieved,
        }  # fmt: skip
        self._carriers = {name: one for name, one in carriers.items() if one is not None}
        if lasting.fields:
            self.snapshot = Snapshot(self.problem, self.timing, output.smooth, estimate)
        checkpoint = None
        if directory is not None and output.checkpoint:
            checkpoint = Checkpoint(directory, space, self.remembering, schedule, output.checkpoint_every,
                                    self._identity, first, self._carriers)  # fmt: skip
        # what serves a load step serves the next, unless another run has to repeat it; what turns has new modes
        if checkpoint is None and self.restart is None and not self.problem.bulk.extrapolates:
            self.newton.lasting = True
        writer = lasting.writer
        if writer is not None:
            writer.snapshot = self.snapshot
        # the report has the warnings of those before it
        watch = [ContactErrors(self.problem.contacts), *lasting.warners, estimate, self.snapshot, writer, self.records,
                 checkpoint, *lasting.last]  # fmt: skip
        self._watch = [one for one in watch if one is not None]
        low, high = bounding_box(self.comm, space.mesh.points)
        places = np.array(list(product(*zip(low, high, strict=True))) + [0.5 * (low + high)])
        through = None if snap is None else Snaps(self.problem, self.energy)
        stages = Stages(self.begin, self.solve, self.rest, self.energy, through)
        self.stepper = Stepper(
            self.problem, self.newton, schedule, self._watch, recorder, self.timing, drive(scene, places), stages
        )  # fmt: skip
        self.stepper.every = self.every
        self.newton.tell(self.stepper.iterate)

    def _go_on(self, lasting, directory):
        """Begin the next phase where the last one has ended. *Collective.*"""
        stepper, carried = self.stepper, {name: one.carried for name, one in self._carriers.items()}
        state = Kept.of(self.problem, stepper.u, self.spans[self.number].end)
        held = self.energy.held(stepper.u) if self._changing and self.energy is not None else None
        # of the observers of one phase, those of facets have the last word
        self._watch[0].end(True)
        self._let_go()
        self.options.withdraw()
        self.options.propose(self.scene.petsc)
        self._components.give(self.mesh)
        self.number += 1
        span = self.spans[self.number]
        log.info("phase %s: from time %g to %g", *span)
        with profile.phase("set_up"):
            self._assemble()
        if self._identity is not None:
            self._identity = Identity.of(self._parts(), self.problem.space, remembering(self.remembering))
        self._prepare(lasting, directory, stepper.first)
        schedule, release = self.stepper.schedule, self.problem.features.release
        if self._changing:
            state, fresh = state.moved(self.problem.space)
            extend(self.problem, state.values, fresh, span.begin)
            # bodies that begin do so where their nodes are now
            release.origins = {number: state.values.copy() if number == self.number else state.origins[number]
                               for number in release.begun}  # fmt: skip
        self.stepper.resume(stepper.number, span.begin, stepper.first, schedule.size, state.values)
        state.recall(self.problem)
        self._warn_of_untied(span)
        if self._changing:
            release.free_strains(self.problem.bulk)
        self._carry(carried)
        release.start(self.problem, self.stepper.u, state.borne)
        if held is not None:
            self.energy.part_with(held, self.stepper.u)
        if self.energy is not None:
            self.energy.begin(self.stepper.u)

    def _carry(self, carried):
        """Have parts of the run go on with the numbers that they carried, by their names."""
        for name, one in self._carriers.items():
            one.carried = carried.get(name, 0.0)

    def _warn_of_untied(self, span):
        """Say of the contacts that a phase ties which ones were nowhere closed before: these are open all the phase.
        *Collective.*"""
        for one in self.problem.contacts:
            closed = self.comm.allreduce(int(one.closed.sum()))
            if one.contact.held and not closed:
                log.warning("phase %s: contact %s has no point that is closed at time %g: tied = [%r] ties nothing",
                            span.name, one.name, span.begin, one.name)  # fmt: skip

    def modes(self, count):
        """Modes of small free vibrations about the state that the run has come to. *Collective.*

        Parameters
        ----------
        count : int

        Returns
        -------
        squares : ndarray (n,)
            Of the angular frequencies, see :func:`pcontact.solve.vibration.frequencies`.
        shapes : list of ndarray (n_owned, d)
        """
        problem, u = self.problem, self.stepper.u
        # partners and status are those of the state
        equilibrium(problem, u, self.stepper.schedule.time)
        return frequencies(problem, build.mass_of(self.part, problem.space, problem.conditions.groups), u, count)

    def close(self):
        """Take what this run entered back out of the options database, for the next scene."""
        self.options.withdraw()

    def unused(self, ours=(), others=()):
        """Lines about options that the user gave and nothing asked for.

        Parameters
        ----------
        ours : sequence of str
            Names that somebody else has dealt with.
        others : sequence of str
            Names that there are beside those which this run has asked for.
        """
        # a default that found no use (of a preconditioner that the user replaced) is not the user's mistake
        known, ours = {*self.options.known, *others}, [*ours, *self.newton.applied, *self.accuracy.chosen]
        # a library has said nothing of what nobody knows, see `_set_up`
        lines = self.options.strange() if process.is_library() else []
        left = self.options.unused([*ours, *self.options.told])
        return lines + [f"option -{name} was not used{nearby(name, known, '-{}'.format)}" for name in left]

    def free(self):
        """Give what the run has of PETSc and MPI back: it cannot go on. *Collective.*

        Python alone does not: SNES keeps the problem, whose matrices it solves with, and communicators are nobody's.
        """
        self.close()
        if self.problem is None:
            return
        self._let_go()
        self._watch = self._carriers = None
        self.costs = self.counters = self.records = self.error_estimate = self.mesh = None
        gc.collect()
        free_garbage(self.comm)

    def _let_go(self):
        """Give back what the present phase has of PETSc and MPI. *Collective.*"""
        if self.newton is not None:
            self.newton.free()
        self.problem.space.exchanger.free()
        self.problem = self.newton = self.stepper = self.solve = self.rest = self.energy = None

    def describe(self):
        """Describe what is modelled and what is left out, see :func:`pcontact.scene.describe`. *Collective.*"""
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
            "forces": forces_of(self.scene.mesh.kinematics, self.mesh.dim),
            "status": list(STATUS),
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
        own = {**self.timing, "total": clock.perf_counter() - self.start,
               "compile": jit.seconds() - self._kernels[0],
               "kernels_mb": (jit.memory() - self._kernels[1]) / 1024.0**2}  # fmt: skip
        names = sorted(own)
        slowest, _ = profile.largest_and_sum(self.comm, names, own)
        memory = self.comm.allreduce(profile.memory()[0] / 1024.0**2)
        return {**slowest, "phases": self.costs.phases(), "peak_memory_mb": memory}
