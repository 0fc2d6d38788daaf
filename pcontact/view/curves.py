"""Curves: a run's history, forces over time or travel, pressures, works; and values of contact surfaces over a
coordinate, or over the arc length, unrolled.
"""

import csv
import json
from contextlib import contextmanager
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from pcontact.runtime.errors import InputError, nearby
from pcontact.runtime.files import whole_lines
from pcontact.view import camera, cells
from pcontact.view.colours import DPI, INK, PALE, STYLE, save

CURVED = 1.05  # length of a surface over that of its chord from which on it is unrolled


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
            allowed = f"{', '.join(columns)}{nearby(name, columns)}"
            raise InputError(f"{directory}: no column {name!r}; allowed: {allowed}")
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


def _chains(stage):
    """Of each pair of plane bodies: segments in order, their ends (n, 2, 3), arc lengths and values (n, 2)."""
    for name, values in stage.quantity.values.items():
        nodes, owner = cells.segments(stage.result.surfaces[name])
        if not len(nodes):
            continue
        # the arc length is that of the undeformed surface: it is the same in all load steps
        values = values if stage.quantity.at == "point" else values[owner]
        yield _chain(stage, nodes, stage.result.surfaces[name].points, stage.surfaces[name], values)


def _section(stage):
    """The same of solids: where the plane that cuts them open at the contact meets the surface of the leading pair."""
    from pcontact.view import shapes

    if stage.patch is None:
        return
    name = stage.leading()
    normal, _, _ = camera.cut_open(stage.patch, stage.positions)
    origin = (stage.patch.points.min(axis=0) + stage.patch.points.max(axis=0)) / 2
    values = stage.quantity.values[name]
    flat = shapes.grid(stage.result.surfaces[name], stage.surfaces[name], values, stage.quantity.at)
    # a plane through nodes would meet edges only: a little beside them it meets facets
    origin = origin + 1e-6 * np.ptp(stage.positions, axis=0).max() * normal
    line = flat.slice(normal=normal, origin=origin)
    if not line.n_cells:
        return
    line = line.clean(tolerance=1e-9, lines_to_points=False)
    nodes = np.asarray(line.lines).reshape(-1, 3)[:, 1:]
    places = np.asarray(line.points)
    yield _chain(stage, nodes, places, places.astype(float), np.asarray(line[shapes.VALUE]))


def _chain(stage, nodes, points, places, values):
    """Segments (n, 2) of nodes in order, with the arc length of their points: what :func:`chains` has of them."""
    order, length, turned = cells.arc_length(nodes, points)
    ends = places[nodes[order]]
    shown = values[nodes[order]] if stage.quantity.at == "point" else np.repeat(values[order, None], 2, 1)
    ends[turned], shown = ends[turned, ::-1], np.where(turned[:, None], shown[:, ::-1], shown)
    return ends, length, shown


def chains(stage):
    """Contact surfaces of plane bodies, or sections of those of solids, as chains of segments.

    Parameters
    ----------
    stage : pcontact.view.picture.Stage

    Returns
    -------
    list of (ndarray (n, 2, 3), ndarray (n, 2), ndarray (n, 2))
        Ends as they are drawn, arc lengths and values at them.
    """
    return list(_section(stage) if stage.solid else _chains(stage))


def touching(stage):
    """Points of the contact surfaces that are under pressure; all if there is no pressure.

    Returns
    -------
    ndarray (n, 3)
    """
    if stage.solid:
        return np.zeros((0, 3)) if stage.patch is None else stage.patch.points
    return camera.touched(stage.result.surfaces, stage.surfaces)[1]


def is_curved(stage):
    """Tell whether a surface of plane bodies under pressure is longer than its chord, so that it is unrolled."""
    if stage.solid:
        return False
    points = touching(stage)
    for ends, arc, _ in chains(stage):
        near = np.isin(ends.reshape(-1, 3), points).all(axis=1).reshape(-1, 2).all(axis=1)
        length = np.linalg.norm(np.diff(ends[near], axis=1)[:, 0], axis=1).sum()
        # parts that are far from each other along the surface, as in self contact, would be two needles
        if near.any() and np.ptp(arc[near]) < 2 * length > 2 * CURVED * np.ptp(ends[near].reshape(-1, 3), axis=0).max():
            return True
    return False


def draw(axes, stage, unrolled):
    """Values over a coordinate, or over the arc length.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    stage : pcontact.view.picture.Stage
    unrolled : bool
    """
    quantity, found = stage.quantity, chains(stage)
    if unrolled or stage.solid:
        found = [(length, values) for _, length, values in found]
        name, window = "arc length", None
        under = [np.array(length)[(values > 0).any(axis=1)] for length, values in found]
        under = [part for part in under if len(part)]
        if under and stage.none_if_open:
            low, high = min(part.min() for part in under), max(part.max() for part in under)
            border, end = 0.5 * (high - low), max(length.max() for length, _ in found)
            window = max(low - border, 0.0), min(high + border, end)
    else:
        pieces = {name: stage.result.surfaces[name] for name in quantity.values}
        axis, window = camera.along(pieces, stage.surfaces)
        found, name = [(ends[..., axis], values) for ends, _, values in found], "xy"[axis]
    for place, values in found:
        bars = np.stack([place, values], axis=2)
        feet = np.stack([place[:, ::-1], np.zeros_like(values)], axis=2)
        colours = stage.colours.rgb(values.mean(axis=1))
        axes.add_collection(PolyCollection(np.concatenate([bars, feet], axis=1), facecolors=colours, lw=0))
        axes.add_collection(LineCollection(bars, colors=INK, linewidths=1.1))
    axes.autoscale_view()
    if window is not None and window[1] > window[0]:
        axes.set_xlim(*window)
    if stage.colours.kinds:
        axes.set_yticks(stage.colours.kinds, labels=map(quantity.word, stage.colours.kinds))
    axes.set_xlabel(name)
    axes.set_ylabel(quantity.label)
    axes.spines[["top", "right"]].set_visible(False)


def on_bodies(axes, stage):
    """The contact surfaces of plane bodies as coloured lines upon these."""
    for ends, _, values in chains(stage):
        colours = stage.colours.rgb(values.mean(axis=1))
        shown = (values > 0).any(axis=1) | (not stage.none_if_open)
        for width, colour in ((5.0, INK), (3.5, colours[shown])):
            axes.add_collection(
                LineCollection(ends[shown, :, :2], colors=colour, linewidths=width, capstyle="projecting")
            )
