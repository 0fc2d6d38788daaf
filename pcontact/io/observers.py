"""Observers of a run: terminal, history, report, fields."""

import math
import time as clock
from contextlib import contextmanager, suppress

from pcontact.contact.surface.smooth_geometry import SMOOTH, WRONG, facet_pressure
from pcontact.io.fields import FieldWriter
from pcontact.io.report import History, Report
from pcontact.runtime import log
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.process import last_words

# [-] Part by which small strain may put results wrong without a word. From: chosen; a strain of 4 %, or a turn by 11.5
# degrees, of a whole body.
ENOUGH = 0.02
OUTWARD = "the normal of an obstacle points to where the bodies may be"
# [-] Such a part from which on the units may be wrong. From: chosen; a strain of 20 %, which few bodies are to have.
FAR, UNITS = 0.1, "; if so much is not meant: lengths, moduli and loads in units that belong together"
# Residuals that the bar shows. From: chosen, the width of a terminal.
SHOWN = 6
# [-] Part of the contact pressure that the stress of the cells may lack without a word. From: what is left where a disk
# touches on as much as a facet of the coarser side, over 112 disks on blocks.
UNRESOLVED = 0.25
# [-] So many times the error of the first word is worth another one at the end of the run. From: chosen.
MUCH = 2.0
# [-] report.json is written anew when the run has so many times the load steps that it has had then: what is written of
# it, all in all, is some nine times the last one. From: chosen.
GROWTH = 1.125


class Terminal(Observer):
    """One line per load step, and why a step was cut; on a terminal a bar below, with the residuals as they fall.

    Parameters
    ----------
    end : float
        Time at which the run ends.
    volume : float
        Of the bodies that may yield; 0 without any [length^d].
    """

    def __init__(self, end, volume=0.0):
        # in a file the lines of the load steps say how far the run is
        self._progress, self._volume = log.Progress(end, "load", lines=0), volume

    def step(self, step, u, record):
        """Print the step."""
        parts = [
            f"step {step.number}  time {step.time:.6g}  newton {step.newton}  krylov {step.krylov}  "
            f"residual {step.residual:.2e}  imbalance {record['imbalance']:.1e}"
        ]
        if "uzawa" in record:
            parts.append(f"multipliers: {record['uzawa']['updates']} updates, change {record['uzawa']['change']:.1e}")
        if self._volume > 0.0:
            plastic = record["plastic"]
            part, strain = plastic["yielded_volume"] / self._volume, plastic["max_equivalent_strain"]
            parts.append(f"yielded {100.0 * part:.1f} % (max strain {strain:.4g})")
        if "kinetic" in record.get("energy", {}):
            energy = record["energy"]
            parts.append(f"energy: kinetic {energy['kinetic']:.6g} stored {energy['stored']:.6g} "
                         f"integrator {energy['numerical']:.3g} defect {energy['defect']:.1e}")  # fmt: skip
        if "estimate" in record:
            parts.append(f"error {100.0 * record['estimate']['relative']:.3g} %")
        for name, c in record["contacts"].items():
            at = " ".join(f"{v + 0.0:.4g}" for v in c["deepest"])
            parts.append(
                f"{name}: open {c['open']} stick {c['stick']} slip {c['slip']} flipped {c['flipped']}  "
                f"penetration {c['max_penetration']:.3e} at ({at})  pressure {c['max_pressure'] + 0.0:.6g}  "
                f"force {' '.join(f'{v + 0.0:.6g}' for v in c['force'])}"
            )
        log.info("%s", " | ".join(parts))
        self._progress.to(step.time)

    def iterate(self, number, target, norms):
        """Show on the bar how the residual falls."""
        falling = " ".join(f"{norm:.0e}" for norm in norms[-SHOWN:])
        self._progress.say(f"step {number} to {target:.6g}, residual {falling}")

    def cut(self, target, result):
        """Print why."""
        log.info(
            "step to time %.6g cut back: %s after %d iterations, residual %.3e from %.3e%s%s",
            target, result.reason, result.newton, result.residual, result.initial,
            "; " if result.detail else "", result.detail,
        )  # fmt: skip

    def end(self, converged):
        """Take the bar away."""
        self._progress.close()


class ContactErrors(Observer):
    """Warns, at the end of the run, of pairs whose straight facets put the pressure wrong, or whose cells are too large
    for it.

    Parameters
    ----------
    contacts : list of pcontact.contact.report.ContactReport
    """

    def __init__(self, contacts):
        self._contacts, self._worst = contacts, {}

    def step(self, step, u, record):
        """Keep the step with the largest pressure of each pair: under a small one any gap is large."""
        for name, pair in record["contacts"].items():
            if pair["max_pressure"] > self._worst.get(name, (0.0,))[0]:
                errors = (pair.get(key, 0.0) for key in ("facet_error", "unresolved"))
                self._worst[name] = pair["max_pressure"], *errors, step.time

    def end(self, converged):
        """Warn. *Collective.*"""
        for contact in self._contacts:
            _, error, unresolved, time = self._worst.get(contact.name, (0.0, 0.0, 0.0, 0.0))
            if error > WRONG:
                _, gap = facet_pressure(contact.pairs)
                log.warning(
                    "contact %s: gaps of up to %.2g between straight facets of curved surfaces that conform put the "
                    "pressure wrong by %s (in L2, time %g): they are %.2g times what it does to a layer of cells; "
                    "remedy: %s",
                    contact.name, gap, "100 % or more" if error > 1.0 else f"about {100.0 * error:.0f} %", time, error,
                    SMOOTH,
                )  # fmt: skip
            elif unresolved > UNRESOLVED:
                log.warning(
                    "contact %s: the stress of the cells has %.0f %% of the contact pressure only (time %g): bodies "
                    "touch on about a facet or less, or stiff cells take the shape of soft ones; pressures are wrong, "
                    "and bodies enter each other by what is missing; remedy: smaller cells where they touch",
                    contact.name, 100.0 * max(1.0 - unresolved, 0.0), time,
                )  # fmt: skip


class SmallStrain(Observer):
    """Warns of bodies that are strained or turned beyond small strain: as it happens, and at the end how far."""

    def __init__(self):
        self._told, self._worst = {}, {}

    def step(self, step, u, record):
        """Warn of each body once, and keep the worst step of each."""
        for name, found in record.get("small_strain", {}).items():
            if found["error"] > self._worst.get(name, (0.0,))[0]:
                self._worst[name] = found["error"], step.time, found
            if found["error"] > ENOUGH and name not in self._told:
                self._told[name] = found["error"]
                self._warn(name, step.time, found)

    def end(self, converged):
        """Warn again where it has become much worse."""
        for name, (error, time, found) in self._worst.items():
            if name in self._told and error > MUCH * self._told[name]:
                self._warn(name, time, found)

    def _warn(self, name, time, found):
        error, at = found["error"], " ".join(f"{v + 0.0:.4g}" for v in found["place"])
        log.warning(
            "time %g: body %s goes beyond small strain: a strain of %.2g and a rotation by %.2g degrees in the mean, "
            "most at (%s), put %s wrong by %s; remedy: strain = \"finite\"%s",
            time, name, found["strain"], found["rotation"], at,
            "forces, for what rotations make of lengths," if error == found["stiffening"] else "results",
            "100 % or more" if error > 1.0 else f"about {100.0 * error:.2g} %", UNITS if error > FAR else "",
        )  # fmt: skip


class OpenContacts(Observer):
    """Warns, at the end of the run, of contacts that nothing has ever closed.

    Parameters
    ----------
    contacts : sequence of pcontact.scene.model.Contact
        Those that are meant to close.
    """

    def __init__(self, contacts):
        self._open = dict.fromkeys((one.name for one in contacts), (math.inf, 0.0))
        self._rigid = {one.name for one in contacts if one.obstacle is not None}

    def step(self, step, u, record):
        """Keep where a contact came nearest, and forget those that are closed."""
        for name, contact in record["contacts"].items():
            if contact["stick"] + contact["slip"] > 0:
                self._open.pop(name, None)
            elif name in self._open and contact["least_gap"] is not None:
                self._open[name] = min(self._open[name], (contact["least_gap"], step.time))

    def end(self, converged):
        """Warn."""
        for name, (gap, time) in self._open.items() if converged else ():
            near = f"the least gap was {gap:.3g}, at time {time:g}" if gap < math.inf else "no point had a partner"
            log.warning(
                "contact %s: open at all points in all load steps: %s. Do loads and motions close it? Are source and "
                "target the surfaces that meet, within search_radius?%s", name, near,
                f" {OUTWARD.capitalize()}." if name in self._rigid else "",
            )  # fmt: skip


class Records(Observer):
    """The report and the history, on rank 0: history.csv, steps.jsonl and report.json, or in memory alone.

    Every load step is added to the first two. All of report.json is written at the beginning and at the end, and
    between them as the number of load steps grows (`GROWTH`).

    Parameters
    ----------
    directory : pathlib.Path or None
        None: nothing is written.
    comm : MPI.Comm
    head : dict
        First entries of the report.
    finish : callable
        Returns the blocks of the report on what the run has cost: timing, parallel, memory. *Collective.*
    resume_time : float, optional
        Rows of an earlier run up to this time are kept.
    keep : bool
        Keep the load steps in memory.

    Attributes
    ----------
    report : pcontact.io.report.Report or None
        On rank 0.

    Raises
    ------
    InputError
        On every rank: files of the earlier run cannot be read.
    """

    def __init__(self, directory, comm, head, finish, resume_time=None, keep=True):
        self._comm, self._finish, self._history, self.report = comm, finish, None, None
        # in memory nobody reads what it has cost so far
        self._next = math.inf if directory is None else 0.0
        on_root(comm, self._open, directory, head, resume_time, keep)

    def _open(self, directory, head, resume_time, keep):
        if directory is not None:
            self._history = History(directory / "history.csv", resume_time)
        self.report = Report(directory, resume_time, keep)
        self.report.data.update(head)

    @contextmanager
    def kept(self):
        """While this lasts there is a report, and whatever ends the run leaves it with all load steps. *Collective.*

        Raises
        ------
        OutputError
            On every rank.
        """
        on_root(self._comm, lambda: self.report.begin())
        with last_words(self._leave):
            try:
                yield
            except BaseException as error:
                self._leave(isinstance(error, InputError))
                raise

    def _leave(self, refused=False):
        """Write the report as far as it goes: other ranks may not be there any more."""
        if self.report is not None:
            self.report.data["warnings"] = log.warnings()
            with suppress(OutputError):
                self.report.leave(refused)

    def _write(self, entries):
        self.report.data.update(entries, warnings=log.warnings())
        self.report.write()

    def step(self, step, u, record):
        """Add the load step. *Collective.*

        Raises
        ------
        OutputError
            On every rank.
        """
        on_root(self._comm, self._add, record)
        if step.number >= self._next:
            self._next = GROWTH * step.number
            on_root(self._comm, self._write, self._finish())

    def _add(self, record):
        if self._history is not None:
            self._history.append(record)
        if "estimate" in record:
            self.report.data["estimate"].update(record["estimate"])
        self.report.add_step(record)

    def end(self, converged):
        """Write the verdict. *Collective.*

        Raises
        ------
        OutputError
            On every rank.
        """
        on_root(self._comm, self._write, {"converged": converged, **self._finish()})

    def data(self):
        """Return the contents of the report, on every rank. *Collective.*

        Returns
        -------
        dict
            See :class:`pcontact.io.report.Report`; not yet in the types of JSON.
        """
        return self._comm.bcast(None if self.report is None else self.report.whole())


class Fields(Observer):
    """Fields of the undeformed bodies, where the first load step begins, and of every step, for ParaView.

    Parameters
    ----------
    directory : pathlib.Path
    comm : MPI.Comm
    timing : dict
        ``output`` seconds are added.
    output : pcontact.scene.model.Output
        Format and compression.
    resume_time : float, optional
        Steps of an earlier run up to this time are kept.

    Attributes
    ----------
    snapshot : pcontact.io.snapshot.Snapshot
        Observer that has taken the fields of the step before.
    """

    def __init__(self, directory, comm, timing, output, resume_time=None):
        self._writer = FieldWriter(directory, comm, resume_time, output.format, output.compression)
        self.snapshot, self._timing = None, timing

    def step(self, step, u, record):
        """Write the step. *Collective.*"""
        start, taken = clock.perf_counter(), self.snapshot.taken
        if step.number == 1:
            begin = self.snapshot.undeformed()
            self._writer.write(0, step.begin, begin.bodies, begin.surfaces, begin.points)
        self._writer.write(step.number, step.time, taken.bodies, taken.surfaces, taken.points)
        self._timing["output"] += clock.perf_counter() - start
