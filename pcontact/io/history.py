"""history.csv: a row per load step, for plotting."""

import csv
import io
from pathlib import Path

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.files import append_text, going_on, make_directory, replace_file, whole_lines

_AXES = "xyz"


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
    return {name: _column([row.get(name) for row in flat]) for name in names}


def _column(values):
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
