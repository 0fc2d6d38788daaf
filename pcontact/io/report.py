"""report.json: what the run was and what came out, rewritten after every step."""

import json
import math
from pathlib import Path

import numpy as np

from pcontact.runtime.files import going_on, make_directory, replace_file

# of report.json: one more where a key changes its meaning or goes; keys may come without that
FORMAT = 2


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


class Report:
    """The run's report. Rank 0 only.

    Parameters
    ----------
    path : str, Path or None
        The .json file; None: the report stays in memory.
    resume_time : float, optional
        The run continues one whose report is `path`: its steps up to this time are kept.

    Attributes
    ----------
    data : dict
        What the file will hold: format, title, version, ranks, dofs, cells, converged, model (active, left_out),
        steps, timing, parallel, memory. Free to be added to; numpy types are converted when it is written.
    """

    def __init__(self, path, resume_time=None):
        self.path, self._begun = None if path is None else Path(path), False
        self.data = {
            "format": FORMAT, "title": "", "version": "", "ranks": 1, "dofs": 0, "cells": 0, "converged": False,
            "model": {"active": [], "left_out": []}, "steps": [], "timing": {}, "parallel": {}, "memory": {},
        }  # fmt: skip
        if resume_time is not None and self.path is not None and self.path.exists():
            limit = resume_time + 1e-10 * abs(resume_time)
            with going_on(self.path):
                steps = json.loads(self.path.read_text(encoding="utf-8")).get("steps", [])
                self.data["steps"] = [step for step in steps if step.get("time", math.inf) <= limit]

    def add_step(self, step):
        """Append a step and write the file.

        Parameters
        ----------
        step : dict
            time, newton, krylov, cutbacks, reactions, contacts, probes, plastic.
        """
        self.data["steps"].append(step)
        self.write()

    def write(self):
        """Write the file, at once: a reader sees the old one or the new one.

        Raises
        ------
        OutputError
        """
        if self.path is None:
            return
        if not self._begun:
            make_directory(self.path.parent)
            self._begun = True
        text = json.dumps(jsonable(self.data), indent=1, allow_nan=False, ensure_ascii=False)
        replace_file(self.path, text + "\n")
