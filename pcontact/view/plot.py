"""Curves of a run's history: forces over time or travel, pressures, works."""

import csv
import difflib
import json
from contextlib import contextmanager
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from pcontact.runtime.errors import InputError
from pcontact.runtime.files import whole_lines
from pcontact.view.colours import DPI, PALE, STYLE, save


def table(directory):
    """The columns of ``history.csv``.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.

    Returns
    -------
    dict of str to ndarray (n,)
        What is no number is NaN.

    Raises
    ------
    InputError
    """
    path = Path(directory) / "history.csv"
    if not path.is_file():
        raise InputError(f"{directory}: found no history.csv in it; allowed: the output directory of a run")
    head, *rows = csv.reader(whole_lines(path))

    def number(word):
        try:
            return float(word)
        except ValueError:
            return float("nan")

    return {name: np.array([number(row[k]) for row in rows]) for k, name in enumerate(head)}


def plot(directory, names, output=None, size=(1000, 700)):
    """Draw columns of the history over another one.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    names : sequence of str
        Names of columns: the one across, then those upward; with one name it is drawn over the time.
    output : str or Path, optional
        DIRECTORY/Y_over_X.png if absent.
    size : tuple of int
        Width and height in pixels.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        There is no such column; the message lists all.
    OutputError
        The file cannot be written.
    """
    columns = table(directory)
    across, *upward = names if len(names) > 1 else ("time", *names)
    for name in (across, *upward):
        if name not in columns:
            near = difflib.get_close_matches(name, columns, 1)
            hint = f"; the nearest is {near[0]!r}" if near else ""
            raise InputError(f"{directory}: no column {name!r}; allowed: {', '.join(columns)}{hint}")
    output = Path(output or Path(directory) / f"{'_'.join(upward)}_over_{across}.png".replace("/", "_"))
    output = output if output.suffix else output.with_suffix(".png")
    with _chart(output, size) as axes:
        for name in upward:
            axes.plot(columns[across], columns[name], "o-", ms=3, lw=1.2, label=name)
        axes.set_xlabel(across)
        if len(upward) == 1:
            axes.set_ylabel(upward[0])
        else:
            axes.legend(frameon=False)
    return output


def plot_errors(directory, output, size=(1000, 700)):
    """Draw the errors of all meshes of a run that was to reach one, over their unknowns.

    Parameters
    ----------
    directory : str or Path
        The output directory of the run.
    output : str or Path
    size : tuple of int
        Width and height in pixels.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    section = json.loads((Path(directory) / "report.json").read_text(encoding="utf-8"))["accuracy"]
    passes, target = section["passes"], section["target"]
    with _chart(Path(output), size) as axes:
        unknowns = [one["unknowns"] for one in passes]
        axes.loglog(unknowns, [one["error"] for one in passes], "o-", ms=4, lw=1.2, label="named")
        axes.loglog(unknowns, [one["estimate"] for one in passes], "s:", ms=3, lw=1.0, mfc="none", label="estimate")
        axes.axhline(target["error"], color=PALE, lw=0.8, ls="--", label="target")
        axes.set(xlabel="unknowns", ylabel=f"relative error of {target['of']}")
        axes.legend(frameon=False)


@contextmanager
def _chart(output, size):
    """Axes of a figure of some pixels, which is written at the end."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI, layout="constrained")
        axes = figure.subplots()
        yield axes
        axes.grid(lw=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    save(figure, output)
