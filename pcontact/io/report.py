"""report.json: what the run was and what came out; and steps.jsonl, to which every load step is added as it ends."""

import json
import math
from pathlib import Path

import numpy as np

from pcontact.runtime.files import append_text, discard, going_on, make_directory, replace_file, whole_lines

# of report.json: one more where a key changes its meaning or goes; keys may come without that
FORMAT = 2
NAME, STEPS = "report.json", "steps.jsonl"


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
        self._begun, self.steps = False, [] if keep else None
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
        """What the file holds, with the load steps, not yet in the types of JSON."""
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
