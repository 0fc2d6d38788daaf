"""Runs in memory: a function call, its load steps, and what the caller's function says of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcontact.adapt.loop import Loop
from pcontact.adapt.passes import wanted
from pcontact.api.fields import Fields
from pcontact.api.results import Run
from pcontact.api.scenes import scene_of
from pcontact.api.tables import shown
from pcontact.assembly.item import Item
from pcontact.io.report import jsonable
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD, InputError, NotConverged, Stopped
from pcontact.runtime.observer import Observer
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, own_options
from pcontact.scene import model
from pcontact.simulation import Simulation


def run(
    scene: model.Scene | Mapping[str, Any] | str | Path,
    options: Mapping[str, Any] | str | None = None,
    on_step: Callable[[Step], object] | None = None,
    output: str | Path | None = None,
    comm: Any = None,
    level: str | None = None,
    check: bool = True,
    items: Sequence[Callable[[Any], Item]] = (),
) -> Run:
    """Run a scene. *Collective* on the ranks of `comm`.

    Parameters
    ----------
    scene : Scene, str, pathlib.Path or dict
        A file is read, a dict is taken as by :func:`from_dict`. It is left as it is.
    options : dict or str, optional
        Options of this run, of pcontact and of PETSc: ``{"snes_rtol": 1e-10}`` or ``"-snes_rtol 1e-10"``. They win over
        the scene. Those of the process (``PETSC_OPTIONS``, ``petsc4py.init``) are neither used nor changed.
    on_step : callable, optional
        Called with a :class:`Step` after each load step, when it has been committed and written, on every rank. False
        ends the run, if any rank returns it; :attr:`Step.next_size` is the length of the next load step.
    output : str or pathlib.Path, optional
        Directory for what the command line writes; absent: nothing is written.
    comm : MPI.Comm, optional
        Absent: all ranks.
    level : {"error", "warning", "info", "debug"}, optional
        Lines as important as this are shown on standard output. Absent: none, unless the caller's own logging takes
        them from the logger "pcontact".
    check : bool
        Raise NotConverged where a load step does not converge; otherwise the run is returned as far as it got.
    items : sequence of callable
        Parts of the problem of the caller's own: each makes an :class:`pcontact.Item` of the space, on every rank, at
        the beginning of the run and of each of its phases.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        The scene, the mesh or an option is wrong; on every rank.
    OutputError
        A file cannot be written; on every rank.
    NotConverged
        A load step did not converge; its attribute ``run`` is the run up to the last one that did.
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def observers(simulation: Any) -> list[Observer]:
        return [] if on_step is None else [_Caller(on_step, simulation)]

    with log.of_a_library(comm.rank, level), own_options():
        Options("options").give(options or {})
        scene = scene_of(scene)
        aimed = wanted(scene, Options("options"))
        if aimed is not None and items:
            raise InputError("run: found items in a run that reaches an error; allowed: one of the two")
        try:
            if aimed is not None:
                result, failure = _reach(aimed, comm, observers, output)
            else:
                result, failure = _run(Simulation(scene, comm, "options", items=items), observers, output)
        except _OnStepFailed as error:
            raise error.own from None
    if comm.rank == 0:
        for text in result.unused:
            warnings.warn(text, UserWarning, stacklevel=2)
    if failure is not None and check:
        raise NotConverged(str(failure), result) from None
    return result


def _run(
    simulation: Any, observers: Callable[[Any], list[Observer]], output: str | Path | None
) -> tuple[Run, Exception | None]:
    """The result and the failure of a simulation, which is freed. *Collective.*"""
    together = simulation.comm.size == 1
    try:
        converged = simulation.run(output, observers(simulation), keep=True, said="output")
        result, failure = Run.of(simulation, converged), simulation.failure
        together = True
    except (*TOLD, _OnStepFailed):
        together = True
        raise
    finally:
        # what one rank alone meets is no reason for it to wait for the others
        if together:
            simulation.free()
    return result, failure


def _reach(
    scene: model.Scene, comm: Any, observers: Callable[[Any], list[Observer]], output: str | Path | None
) -> tuple[Run, Exception | None]:
    """The result and the failure of the runs that reach an error. *Collective.*"""

    outcome = Loop(scene, comm, "options", Run.of, observers, fields=True).run(output, "output")
    outcome.kept.report["accuracy"].update(jsonable(outcome.section))
    return outcome.kept, outcome.failure


class _OnStepFailed(Exception):
    """The caller's function failed on some rank; `own` is what this rank raises."""

    def __init__(self, own: BaseException) -> None:
        super().__init__()
        self.own = own


class _Caller(Observer):
    """Observer that calls the caller's function."""

    def __init__(self, function: Callable[[Step], object], simulation: Any) -> None:
        self._function, self._simulation = function, simulation

    def step(self, step: Any, u: Any, record: Any) -> None:
        """Call it, and have all ranks do the same afterwards. *Collective.*"""
        comm, error, stops, schedule = self._simulation.comm, None, False, self._simulation.stepper.schedule
        told_step = Step(step, record, self._simulation)
        try:
            stops = self._function(told_step) is False
            if told_step.next_size != schedule.size:
                schedule.wish(told_step.next_size)
        # an exit or an interrupt of one rank alone, too: the others would wait for it
        except BaseException as problem:
            error = problem
        why = None if error is None else f"{type(error).__name__}: {error}"
        told = comm.allgather((stops, why, schedule.size))
        failed = [(rank, text) for rank, (_, text, _) in enumerate(told) if text is not None]
        if failed:
            rank, text = failed[0]
            raise _OnStepFailed(error or RuntimeError(f"on_step failed on rank {rank}: {text}"))
        if any(one for one, _, _ in told):
            raise Stopped
        smallest = min(size for _, _, size in told)
        if smallest != schedule.size:
            schedule.wish(smallest)


class Step:
    """A load step that has been committed.

    Attributes
    ----------
    number : int
        From 1.
    time : float
        At its end.
    newton, krylov, cutbacks : int
        Iterations of the solve that converged, and attempts before it that did not.
    report : dict
        As in ``report.json``: reactions, contacts (force, area, largest pressure, ...), probes, ...; the same on every
        rank.
    next_size : float
        Length of the next load step [time], which may be set; the smallest that any rank sets counts. It may be longer
        than planned; loads and supports are met at their corners, and the end of the run at its time, in any case.
    """

    def __init__(self, step: Any, record: Any, simulation: Any) -> None:
        self.number, self.time, self.report = step.number, step.time, jsonable(record)
        self.newton, self.krylov, self.cutbacks = step.newton, step.krylov, step.cutbacks
        self._taken = simulation.snapshot.taken
        self._fields: Fields | None = None
        self._comm = simulation.comm
        self.next_size: float = simulation.stepper.schedule.size

    def __repr__(self) -> str:
        words = ", ".join(f"{name} {shown(one['force'])}" for name, one in self.report["contacts"].items())
        return f"<Step {self.number}: time {self.time:g}, {self.newton} iterations; forces: {words or 'no contact'}>"

    def fields(self) -> Fields:
        """The fields at its end, this rank's part: :class:`Fields`."""
        if self._fields is None:
            self._fields = Fields.of(self._taken)
        return self._fields

    def gather(self, everywhere: bool = False) -> Fields | None:
        """The fields of all ranks, see :meth:`Run.gather`. *Collective.*"""
        return self.fields().gather(self._comm, everywhere)
