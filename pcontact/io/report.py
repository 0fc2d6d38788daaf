"""report.json: what the run was and what came out; and steps.jsonl, to which every load step is added as it ends.

history.csv: a row per load step, for plotting. And the last lines of a run: what came out, what it took, where it is.
"""

import csv
import io
import json
import math
import sys
from pathlib import Path

import numpy as np

from pcontact.io.names import CHECKPOINT
from pcontact.runtime import log, process
from pcontact.runtime.files import append_text, discard, going_on, make_directory, replace_file, whole_lines
from pcontact.runtime.observer import Observer

# of report.json: one more where a key changes its meaning or goes; keys may come without that
FORMAT = 2
NAME, STEPS = "report.json", "steps.jsonl"
_AXES = "xyz"
# part of the normal force below which friction is not shown
NEGLIGIBLE = 1e-6
# facets across a contact area from which on its largest pressure is resolved. From: Hertz' pressure of cylinders and of
# a ball on a block, degree 1 and 2 (docs/tables/accuracy.md).
ACROSS = 6


def jsonable(value):
    """The same in plain JSON types. A number that is not finite becomes None: JSON has no word for it.

    Parameters
    ----------
    value : dict, list, tuple, set, ndarray, numpy or Python scalar, str, Path or None

    Returns
    -------
    dict, list, str, int, float, bool or None
    """
    if isinstance(value, dict):
        return {str(key): jsonable(part) for key, part in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return jsonable(value.tolist())
    if isinstance(value, (list, tuple)):
        return [jsonable(part) for part in value]
    if isinstance(value, (set, frozenset)):
        return sorted(jsonable(part) for part in value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)


def _line(values):
    """A line of steps.jsonl."""
    return json.dumps(jsonable(values), allow_nan=False, ensure_ascii=False) + "\n"


def read_steps(directory):
    """Load steps of a run: those of steps.jsonl, to which a run adds them; without that file those of the report.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run, also of one that has not ended, or was killed.

    Yields
    ------
    dict
    """
    report, steps = Path(directory) / NAME, Path(directory) / STEPS
    if steps.exists():
        yield from map(json.loads, whole_lines(steps))
    elif report.exists():
        yield from json.loads(report.read_text(encoding="utf-8")).get("steps", [])


def read_report(directory):
    """The report of a run with all of its load steps so far.

    Parameters
    ----------
    directory : str or Path
        See :func:`read_steps`.

    Returns
    -------
    dict
        As in report.json. Of a run that was killed, what is not about load steps is as it was when that file was
        written last.

    Raises
    ------
    OSError, ValueError
        There is none that can be read.
    """
    report = json.loads((Path(directory) / NAME).read_text(encoding="utf-8"))
    if (Path(directory) / STEPS).exists():
        report["steps"] = list(read_steps(directory))
    if report["steps"] and "estimate" in report:
        report["estimate"].update(report["steps"][-1].get("estimate", {}))
    return report


class Report:
    """The run's report. Rank 0 only.

    Parameters
    ----------
    directory : str, Path or None
        Where report.json and steps.jsonl are; None: the report stays in memory.
    resume_time : float, optional
        The run continues one whose report is there: its steps up to this time are kept.
    keep : bool
        Keep the load steps in memory.

    Attributes
    ----------
    data : dict
        What the file will hold, without the load steps: format, title, version, ranks, dofs, cells, converged, model
        (active, left_out), timing, parallel, memory. Free to be added to; numpy types are converted when it is written.
    steps : list of dict or None
        The load steps, if they are kept.

    Raises
    ------
    InputError
        What is to be continued cannot be read.
    """

    def __init__(self, directory, resume_time=None, keep=True):
        self._directory = None if directory is None else Path(directory)
        self._limit = None if resume_time is None else resume_time + 1e-10 * abs(resume_time)
        self._begun, self._stepped, self.steps = False, False, [] if keep else None
        self.data = {
            "format": FORMAT, "title": "", "version": "", "ranks": 1, "dofs": 0, "cells": 0, "converged": False,
            "model": {"active": [], "left_out": []}, "timing": {}, "parallel": {}, "memory": {},
        }  # fmt: skip
        if self._continues:
            with going_on(self._directory / (STEPS if (self._directory / STEPS).exists() else NAME)):
                for step in self._earlier():
                    if keep:
                        self.steps.append(step)

    @property
    def _continues(self):
        return self._directory is not None and self._limit is not None

    def _earlier(self):
        """Load steps of the run that this one continues."""
        return (step for step in read_steps(self._directory) if step.get("time", math.inf) <= self._limit)

    def begin(self):
        """Write the head, unless an earlier report is there: that one stays until there is a load step in its place.

        Raises
        ------
        OutputError
        """
        if self._directory is not None and not (self._directory / NAME).exists():
            self._open()

    def _open(self):
        """Write the head, and of an earlier run the steps that are kept."""
        self._begun = True
        make_directory(self._directory)
        steps = self._directory / STEPS
        if self._continues:
            replace_file(steps, map(_line, self._earlier()))
            self.write()
        else:
            # at no moment are there steps of one run under the head of another one
            discard(steps)
            self.write()
            replace_file(steps, "")

    def add_step(self, step):
        """Add a load step.

        Parameters
        ----------
        step : dict
            time, newton, krylov, cutbacks, reactions, contacts, probes, plastic.

        Raises
        ------
        OutputError
            The file is as it was.
        """
        if self.steps is not None:
            self.steps.append(step)
        if self._directory is not None:
            if not self._begun:
                self._open()
            if self._limit is None and not self._stepped:
                # a restart would go on from the run before
                discard(self._directory / CHECKPOINT)
            self._stepped = True
            append_text(self._directory / STEPS, _line(step))

    def leave(self, refused):
        """Write a report that has begun as far as it goes.

        Parameters
        ----------
        refused : bool
            The input is wrong: a report without load steps is taken away.

        Raises
        ------
        OutputError
        """
        if not self._begun:
            return
        if refused and next(read_steps(self._directory), None) is None:
            for name in (STEPS, NAME):
                discard(self._directory / name)
        else:
            self.write()

    def whole(self):
        """Return the contents of the file, with the load steps, not yet in the types of JSON."""
        return {**self.data, "steps": list(read_steps(self._directory)) if self.steps is None else self.steps}

    def write(self):
        """Write report.json, at once: a reader sees the old one or the new one.

        Raises
        ------
        OutputError
        """
        if self._directory is not None:
            if not self._begun:
                self._open()
            replace_file(self._directory / NAME, self._text())

    def _text(self):
        """The file piece by piece: the head, and a line for each load step, of which there may be many."""
        head = json.dumps(jsonable(self.data), indent=1, allow_nan=False, ensure_ascii=False)
        yield head.removesuffix("\n}") + ',\n "steps": ['
        steps, between = self._directory / STEPS, "\n  "
        for line in whole_lines(steps) if steps.exists() else ():
            yield between + line.removesuffix("\n")
            between = ",\n  "
        yield "\n ]\n}\n"


def flatten(values, prefix=""):
    """The scalars of a nested dict under names that tell where they come from. Rank 0 only.

    Parameters
    ----------
    values : dict
        Scalars, sequences of numbers and dicts of these. Sequences of up to three numbers become ``NAME_x``,
        ``NAME_y``, ``NAME_z``, longer ones ``NAME_0``, ``NAME_1``, ...; a dict's keys are joined by dots. Lists of
        dicts and of names, and the names of bodies, which the report has, are left out.
    prefix : str
        Goes before every name.

    Returns
    -------
    dict of str to scalar
    """
    scalars = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            scalars.update(flatten(value, f"{name}."))
        elif key == "body" or isinstance(value, list) and value and isinstance(value[0], (dict, str)):
            continue
        elif isinstance(value, (list, tuple, np.ndarray)) and np.ndim(value):
            suffixes = _AXES if len(value) <= len(_AXES) else range(len(value))
            parts = zip(suffixes, value, strict=False)
            scalars.update({f"{name}_{suffix}": _plain(part) for suffix, part in parts})
        else:
            scalars[name] = _plain(value)
    return scalars


def columns(rows):
    """The table as arrays.

    Parameters
    ----------
    rows : list of dict
        Steps as in the report.

    Returns
    -------
    dict of str to ndarray (n,)
        The columns of history.csv, those of the first row, in a run with phases of all; NaN where a row lacks a number.
    """
    flat = [flatten(row) for row in rows]
    names = dict.fromkeys(name for row in (flat if flat and "phase" in flat[0] else flat[:1]) for name in row)
    return {name: column([row.get(name) for row in flat]) for name in names}


def column(values):
    """Values of a column: text, or numbers, NaN where there is none."""
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    return np.array([np.nan if value is None else value for value in values])


def _plain(value):
    """A Python scalar, whose text has all the digits."""
    return value.item() if isinstance(value, (np.generic, np.ndarray)) else value


class History:
    """A table that grows by a row per step and is whole on disk after each. Rank 0 only.

    The columns are those of the first row: later rows leave empty what they lack, and what they have
    beyond is left out with a warning; in a run with phases it gets columns.

    Parameters
    ----------
    path : str or Path
        The .csv file; an earlier one is replaced with the first row.
    resume_time : float, optional
        The run continues one whose table is `path`: rows up to this time are kept, and its columns.
    """

    def __init__(self, path, resume_time=None):
        self.path = Path(path)
        self.columns, self._kept = None, []
        self._warned, self._begun = False, False
        if resume_time is not None and self.path.exists():
            with going_on(self.path):
                self._take_up(resume_time)

    def append(self, row):
        """Add a row.

        Parameters
        ----------
        row : dict
            A step as in the report: `time`, `newton`, `krylov`, `cutbacks`, `contacts`, `reactions`,
            `probes`, `plastic`; see `flatten` for the names of the columns.

        Raises
        ------
        OutputError
            The table is as it was.
        """
        row = flatten(row)
        if not self._begun:
            self._begin(row)
        beyond = [name for name in row if name not in self.columns]
        if beyond and "phase" in row:
            beyond = self._widen(beyond)
        if beyond and not self._warned:
            log.warning("%s: not in the first row's columns, left out: %s", self.path, ", ".join(beyond))
            self._warned = True
        append_text(self.path, _lines([[row.get(name, "") for name in self.columns]]))

    def _take_up(self, resume_time):
        """Read the columns, and the rows that are kept."""
        columns, *rows = list(csv.reader(whole_lines(self.path))) or [[]]
        if "time" in columns:
            column, limit = columns.index("time"), resume_time + 1e-10 * abs(resume_time)
            self.columns = columns
            self._kept = [row for row in rows if len(row) == len(columns) and float(row[column]) <= limit]

    def _widen(self, names):
        """Add columns, which the rows so far leave empty: other things act in other phases."""
        self._take_up(np.inf)
        self._kept = [[*row, *([""] * len(names))] for row in self._kept]
        self.columns = [*self.columns, *names]
        replace_file(self.path, _lines([self.columns, *self._kept]))
        self._kept = []
        return []

    def _begin(self, row):
        """Decide the columns and write the head, with the rows that are kept."""
        self.columns = self.columns or list(row)
        make_directory(self.path.parent)
        replace_file(self.path, _lines([self.columns, *self._kept]))
        self._kept, self._begun = [], True


def _lines(rows):
    """Rows as they stand in the file."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def summary(report, directory):
    """Lines about a run that has ended.

    Parameters
    ----------
    report : dict
        As in ``report.json``; its `steps` may be an iterator.
    directory : str or Path
        Where the results are.

    Returns
    -------
    list of str
    """
    count, last, most, at = 0, None, {}, {}
    for last in report["steps"]:
        count += 1
        for name, contact in last.get("contacts", {}).items():
            pressure = contact.get("max_pressure") or 0.0
            if pressure > most.get(name, -1.0):
                most[name], at[name] = pressure, contact
    if last is None:
        word = "no load step was left after the checkpoint" if report["converged"] else "no load step converged"
        return [f"{word}; the report is in {directory}"]
    seconds = report["timing"].get("total")
    took = f" in {seconds:.1f} s" if isinstance(seconds, float) else ""
    compiled = report["timing"].get("compile") or 0.0
    once = bool(took and compiled >= 0.1)
    took += f" ({compiled:.1f} s of it compiled kernels, once)" if once else ""
    memory = f", {_peak(report):.0f} MB on the largest rank" if _peak(report) else ""
    memory += f" ({report['timing'].get('kernels_mb') or 0.0:.0f} MB of it for kernels)" if memory and once else ""
    word = log.coloured("done", "green") if report["converged"] else log.coloured("ended early", "yellow")
    lines = [f"{word}: {count} load steps to time {last['time']:g}{took}{memory}"]
    for name, contact in last.get("contacts", {}).items():
        force = "force " + " ".join(f"{_number(value):.5g}" for value in contact["force"])
        if "radial_sum" in contact:
            force = (f"axial force {_number(contact['axial_force']):.5g} of the whole circumference, radial sum "
                     f"{_number(contact['radial_sum']):.5g}")  # fmt: skip
        if contact.get("normal_force") and "radial_sum" not in contact:
            force += _parts(contact)
        lines.append(f"  {name}: {force}, largest pressure {_number(contact['max_pressure']):.5g} (of all load steps "
                     f"{most[name]:.5g}), penetration {_number(contact['max_penetration']):.3g}")  # fmt: skip
    if "target" not in report.get("accuracy", {}):
        lines += _unresolved(at)
    lines += _largest(last.get("largest", {}))
    if report["warnings"]:
        count = len(report["warnings"])
        lines.append(f"  {count} warning{'s' * (count > 1)}, above and in report.json")
    lines.append(f"  results in {directory}; pictures: pcontact view {directory}")
    return lines


def _parts(contact):
    """Magnitudes of the normal force and of friction, and the centre, in brackets; nothing without contact."""
    if None in contact["centre"] or any(map(math.isnan, contact["centre"])):
        return ""
    normal, friction = (math.hypot(*contact[key]) for key in ("normal_force", "friction_force"))
    slides = f", friction {friction:.5g}" if friction > NEGLIGIBLE * normal else ""
    return f" (normal {normal:.5g}{slides}, at {' '.join(f'{_number(x):.4g}' for x in contact['centre'])})"


def _unresolved(contacts):
    """Lines on contacts, each at its largest pressure, of which few facets are closed and others are not."""
    lines = []
    for name, contact in contacts.items():
        count, space = contact.get("facets") or 0, len(contact["force"]) == 3
        across = math.sqrt(count) if space else count
        if 0 < across < ACROSS and contact["open"]:
            lines.append(
                f"  {name}: the contact area is about {across:.2g} facet{'s' * (across >= 1.05)} across: its largest "
                f"pressure is not resolved; remedy: {ACROSS} or more there, or -error 5% -error_of pressure:{name}"
            )
    return lines


_WORDS = {"equivalent_stress": "equivalent stress", "equivalent_plastic_strain": "equivalent plastic strain",
          "displacement": "displacement"}  # fmt: skip


def _largest(found):
    """Line of the largest stress, plastic strain and displacement of a load step; none without any."""
    parts = []
    for name, words in _WORDS.items():
        one = found.get(name)
        if one is not None and one["place"] is not None:
            at = ", ".join(f"{_number(x):.4g}" for x in one["place"])
            parts.append(f"{words} {_number(one['value']):.5g} in {one['body']} at ({at})")
    if found.get("displacement", {}).get("value") == 0.0:
        return ["  all displacements are 0: nothing acts at this time; are loads and motions, or their amplitudes, 0?"]
    return [f"  largest {'; '.join(parts)}"] * bool(parts)


def _number(value):
    """A number without a negative zero; what is not finite is null in JSON."""
    return math.nan if value is None else value + 0.0


def _peak(report):
    """The largest peak of a rank [MB], 0 if it is not known."""
    marks = report.get("memory", {}).values()
    return max((mark.get("peak_mb_largest") or 0.0 for mark in marks if isinstance(mark, dict)), default=0.0)


class JsonLines(Observer):
    """Observer that says every load step, cut and the end as a line of JSON on standard output. Rank 0 speaks.

    Parameters
    ----------
    speaks : bool
    """

    def __init__(self, speaks):
        self._speaks = speaks

    def _say(self, event, **values):
        if self._speaks:
            process.put(sys.stdout, json.dumps(jsonable({"event": event, **values})) + "\n")

    def step(self, step, u, record):
        """A load step that has been committed, as in ``report.json``."""
        self._say("step", number=step.number, **record)

    def cut(self, target, result):
        """A load step that is cut back."""
        self._say("cut", time=target, reason=result.reason, newton=result.newton, residual=result.residual)

    def end(self, converged):
        """The end."""
        self._say("end", converged=converged, warnings=log.warnings())


class PassLines(JsonLines):
    """The same of runs on one mesh after the other, until an error is reached: a line for every pass, too, and one end
    for all."""

    def end(self, converged):
        """That of a pass is not the end."""

    def passed(self, done):
        """A :class:`pcontact.adapt.passes.Pass`, as in ``report.json``."""
        self._say("pass", **done.report())

    def ended(self, converged, reached):
        """The end."""
        self._say("end", converged=converged, reached=reached, warnings=log.warnings())
