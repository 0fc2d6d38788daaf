"""Runs on one mesh after the other, until the error is below the target or the budget is spent.

The best mesh stays as a file, with the scene that runs on it: an ordinary run of it has the same numbers.
"""

import gc
import shutil
import time as clock
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from pcontact.adapt.decide import FAILED, REACHED, SPENT, Decision, forecast
from pcontact.adapt.errors import Measures
from pcontact.adapt.mark import Refining
from pcontact.adapt.passes import Beginning, Watch, ended, line, report, said_of
from pcontact.adapt.settings import FEW, Settings
from pcontact.mesh.hdf5 import write
from pcontact.mesh.refinement.gather import gathered
from pcontact.runtime import log, profile
from pcontact.runtime.errors import TOLD, InputError, SolverError
from pcontact.runtime.files import replace_file
from pcontact.runtime.lock import reserved
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import SMALLEST
from pcontact.scene.validate import check_component
from pcontact.scene.writer import tables_of, text
from pcontact.simulation import Simulation
from pcontact.view import extra
from pcontact.view.show import draw_errors

# [meshes] That are made at most to find the one that fills the budget. From: chosen; a mesh takes little beside a run.
FITTED = 5


class Outcome(NamedTuple):
    """Outcome of a loop.

    Attributes
    ----------
    status : int
        `REACHED`, `FAILED` or `SPENT`.
    kept : object
        What the caller took of the best pass.
    failure : StepFailure, InputError or None
        Of the pass that did not converge, or could not be run.
    section : dict
        The section `accuracy` of the report of the best pass; empty where none has converged.
    """

    status: int
    kept: object
    failure: object
    section: dict


class Loop:
    """Reaches the error that a scene names.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Of :func:`pcontact.adapt.passes.wanted`.
    comm : MPI.Comm
    said : str
        Where the user gives options, for messages.
    take : callable
        ``take(simulation, converged)``: what the caller keeps of a pass that has run.
    observers : callable
        ``observers(simulation)``: further observers of a pass.
    fields : bool
        Whether these, or the caller, look at the fields of load steps.

    Attributes
    ----------
    passes : list of pcontact.adapt.passes.Pass
    best : int
        The number of the best one, from 1: the last one where the target is reached, else the one whose error is named
        least; 0 before the first.
    mesh : pcontact.mesh.mesh.Mesh
        Of the best one.

    Raises
    ------
    InputError
        On every rank.
    """

    def __init__(
        self, scene, comm=MPI.COMM_WORLD, said="command line", take=lambda *_: None, observers=lambda _: (),
        fields=False,
    ):  # fmt: skip
        self.scene, self.comm, self.said, self.target = scene, comm, said, scene.accuracy
        self._take, self._observers, self._fields, options = take, observers, fields, Options(said)
        self.passes, self.best, self.mesh = [], 0, None
        self._kept, self._records, self._section, self._said = None, None, {}, set()
        self._settings = Settings(scene, self.target, options, comm.size)
        self._refining = Refining(comm, self._settings, options)
        self._measure = Measures(self.target, self._settings)
        self._decision = Decision(self.target, self._settings, self.passes, self._refining, comm)
        self._looks_ahead, self.ahead = False, None

    def best_scene(self):
        """The scene of the best pass, as it would be run alone."""
        return self._settings.scene_of(self.passes[self.best - 1])

    def _run(self, scene, mesh, known, directory):
        """Run a scene on a mesh (None: on that of the file). *Collective.*

        Returns
        -------
        simulation : Simulation
        watch : Watch
        converged : bool
        """
        simulation = Simulation(scene, self.comm, self.said, self._refining.first if mesh is None else mesh)
        watch, simulation.newton.lasting = Watch(simulation), True
        if known is not None:
            simulation.begin = Beginning(simulation, known)
        where = None if directory is None else directory / f"pass_{len(self.passes) + 1}"
        observers = [watch, *self._observers(simulation)]
        try:
            check_component(self.scene, simulation.mesh.dim)
            # the command line reads load steps where they have been written
            keep = where is None or self._fields
            converged = simulation.run(where, observers, keep, self._where, self._fields)
        except TOLD:
            simulation.free()
            raise
        except BaseException:
            # what one rank alone meets is no reason for it to wait for the others
            simulation.close()
            raise
        return simulation, watch, converged

    def run(self, directory=None, said="command line: -o"):
        """All passes: an :class:`Outcome`; `said` is where the user names the directory of results. *Collective.*"""
        directory, self._where = None if directory is None else Path(directory), said
        if self.target.pictures:
            on_root(self.comm, extra.require)
        # objects that are there before the first pass outlive it: collections between passes need not look at them, and
        # to look through all of them once takes as long as a small pass
        gc.collect(1)
        gc.freeze()
        try:
            with profile.holding():
                return self._run_all(directory, said)
        finally:
            gc.unfreeze()

    def _run_all(self, directory, said):
        with reserved(directory, self.comm, said):
            status, failure = self._passes(directory)
            if directory is not None:
                on_root(self.comm, _tidy, directory, max(self.best, 1), len(self.passes) + 1)
                if self.passes:
                    keep(directory, self.mesh, self.best_scene(), self.scene)
                if self.target.pictures and self.passes:
                    on_root(self.comm, draw_errors, directory)
        return Outcome(status, self._kept, failure, self._section)

    def forecast(self):
        """Forecast of what the target would take, from the first one or two passes: an :class:`Outcome`, whose `kept`
        is that of the last pass. *Collective.*

        :attr:`ahead` is the forecast, None where these passes were enough or did not end.
        """
        self._looks_ahead, self._where = True, ""
        status, failure = self._passes(None)
        return Outcome(status, self._kept, failure, self._section)

    def _passes(self, directory):
        """Exit status, and the failure of the last pass or None. *Collective.*"""
        mesh = known = None
        while True:
            scene, begun = self._settings.scene(), clock.perf_counter()
            # the lines of the first one tell what is modelled, those of others the same
            terse = nullcontext() if self.target.details or not self.passes else log.terse(self._said)
            try:
                with terse:
                    simulation, watch, converged = self._run(scene, mesh, known, directory)
            except (InputError, SolverError) as error:
                # what a finer mesh is not solved with takes nothing from the passes before
                if not self.passes:
                    raise
                return self._ended(FAILED, error)
            if not converged:
                # the user has asked the first one to stop, or it has failed
                failure = None if simulation.stopped and not self.passes else simulation.failure
                if not self.passes:
                    self._kept = self._take(simulation, converged)
                simulation.free()
                return self._ended(FAILED if failure is not None or self.passes else REACHED, failure)
            if not self.passes:
                self._settings.keep_sources(simulation.problem.contacts)
            done = self._measure(simulation, watch, clock.perf_counter() - begun)
            self.passes.append(done)
            status, step = self._decision.next(simulation, watch, done)
            if status is None and self._looks_ahead:
                # trials are among the seconds of a pass
                done.seconds = clock.perf_counter() - begun
                status = self._look_ahead(done)
            if status is None:
                mesh, known, status = self._onward(simulation, watch, done, step)
            if status is not None and not self._looks_ahead:
                self._measure.finish(simulation, watch)
            done.seconds = clock.perf_counter() - begun
            log.info("%s", line(self.passes, self.target))
            self._look_at(simulation, converged, status)
            simulation.free()
            if status is not None:
                return self._ended(status, None)

    def _look_at(self, simulation, converged, status):
        """Keep a pass where it is the best one so far. *Collective.*"""
        done, number = self.passes[-1], len(self.passes)
        reached = status == REACHED and not self.target.best
        best = reached or not self.best or done.error < self.passes[self.best - 1].error
        if best:
            self.best, self.mesh, self._records = number, simulation.mesh, simulation.records
            self._tell(status)
        kept = self._take(simulation, converged)
        if best:
            self._kept = kept

    def _ended(self, status, failure):
        """Exit status and failure; the report of the best pass has all passes. *Collective.*"""
        if 0 < self.best < len(self.passes) and not self._looks_ahead:
            self._tell(status)
        if self.passes and not self._looks_ahead:
            if not self._measure.complete:
                log.warning("not known: how much of the error is that of %s", said_of("load_steps"))
            why = self._decision.why if failure is None else "the next mesh was not solved"
            log.info("%s", ended(self.passes, self.best, self.target, why))
        return status, failure

    def _onward(self, simulation, watch, done, step):
        """The next mesh, what is known on it, and None or the exit status where none fits the budget. *Collective.*"""
        degree, mesh, (plan, step) = self._settings.degree, simulation.mesh, step
        aim = SMALLEST if self.target.best else self._decision.aim
        if degree.is_open and degree.choose(done, aim, self._decision.most) == 2:
            done.next = {"unknowns": None, "mesh": None, "load_steps": self._settings.steps, "degree": 2}
            # a straight mesh is read anew, with nodes in the middles of its edges
            return (None, None, None) if mesh.degree == 1 else (mesh, watch.known, None)
        done.next = self._decision.expected(done, step)
        finer = None
        # the mesh that fills the budget best, of those whose neighbours have followed
        for _ in range(FITTED):
            made, divided = self._refining.cut(mesh, step, watch.known.fields, simulation.scene), step.divided
            unknowns = done.unknowns * made.mesh.n_nodes_total / mesh.n_nodes_total
            fits, growth = self._decision.fits(unknowns, done, step)
            if fits and (finer is None or made.mesh.n_nodes_total > finer.mesh.n_nodes_total):
                finer = made
            if growth is None:
                break
            step = plan(growth)
        if finer is None:
            return None, None, self._decision.spent()
        self._refining.whole &= not divided
        known = watch.known._replace(fields=finer.fields)
        if self._decision.tells_nothing(done):
            # bodies move otherwise: load steps that begin where they were take more iterations than others
            known = known._replace(every=False)
        return finer.mesh, known, None

    def _look_ahead(self, done):
        """`SPENT` and a forecast where it has two passes to stand on, or the second is not small; else None."""
        growing = [one for one in self.passes if one.degree == done.degree]
        # one pass does not tell which of its seconds more unknowns take
        if self._settings.degree.is_open or (len(growing) < 2 and done.next["unknowns"] < FEW):
            return None
        self.ahead = forecast(growing, self._decision.aim)
        return SPENT

    def _tell(self, status):
        """Put the section `accuracy` into the report of the best pass. *Collective.*"""
        if self._looks_ahead:
            return
        records, section = self._records, report(self.passes, self.best, self.target, status == REACHED)
        if self._settings.degree.chosen is not None:
            section["degree"] = self._settings.degree.chosen
        if self._refining.choice.made is not None:
            section["cells"] = self._refining.choice.made
        # seconds are not the same on all ranks
        self._section = section = self.comm.bcast(section)

        def write():
            data = records.report.data
            data["accuracy"] = {**data["accuracy"], **section}
            records.report.write()

        on_root(self.comm, write)


def _tidy(directory, best, last):
    """The results of the best pass take the place of those of all passes."""
    folder = directory / f"pass_{best}"
    for source in sorted(folder.rglob("*")) if folder.is_dir() else []:
        if source.is_file():
            aim = directory / source.relative_to(folder)
            aim.parent.mkdir(parents=True, exist_ok=True)
            source.replace(aim)
    for number in range(1, last + 1):
        shutil.rmtree(directory / f"pass_{number}", ignore_errors=True)


def reach(scene, comm=MPI.COMM_WORLD, directory=None, **more):
    """Run a scene until its error is reached; parameters as for :class:`Loop`. *Collective.*"""
    return Loop(replace(scene), comm, **more).run(directory)


MESH, SCENE = "adapted.h5", "adapted.toml"


def keep(directory, mesh, scene, user):
    """Write both. *Collective.*

    Parameters
    ----------
    directory : pathlib.Path
    mesh : pcontact.mesh.mesh.Mesh
    scene : pcontact.scene.model.Scene
        Of the pass on it.
    user : pcontact.scene.model.Scene
        The user's, whose output it has.
    """
    raw = gathered(mesh, directory / MESH, every=True)
    # groups by place are groups of the mesh by now
    scene = replace(scene, mesh=replace(scene.mesh, file=(directory / MESH).absolute()), output=user.output, regions=[])

    def files():
        write(directory / MESH, raw, scene.mesh.order, mesh.curved)
        try:
            tables = tables_of(scene, directory)
        except TypeError as error:
            log.warning("%s: not written: %s; -mesh %s runs the scene on the mesh", SCENE, error, directory / MESH)
            return
        head = ["The scene on its adapted mesh, with the load steps and tolerances of the best pass.",
                f"Other loads on the same mesh: pcontact run SCENE.toml -mesh {MESH}"]  # fmt: skip
        replace_file(directory / SCENE, text(tables, head))

    on_root(mesh.comm, files)
