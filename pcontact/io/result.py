"""A run's fields read back: the pieces of all ranks in one mesh."""

import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcontact.io import vtu
from pcontact.io.fields import INDICES, NODE_NUMBER, Piece, read_step
from pcontact.mesh.raw import distinct
from pcontact.runtime.errors import InputError


@dataclass
class Result:
    """The fields of one step.

    Parameters
    ----------
    directory : Path
        Where they were read.
    time : float
        Time of the step.
    times : list of float
        Times of all load steps that are there.
    bodies : Piece
        All bodies; points (n, 3), those that ranks share are joined.
    surfaces : dict of str to Piece
        The facets of each contact pair.
    points : dict of str to Piece
        The quadrature points of each contact pair.
    """

    directory: Path
    time: float
    times: list
    bodies: Piece
    surfaces: dict
    points: dict


def load_result(directory, step=-1):
    """Read the fields of one step. Serial.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    step : int
        Which of the load steps that are there, from 1; negative numbers count from the last one; 0: the undeformed
        bodies.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        There are no fields, no such step, or a file is missing or damaged.
    """
    directory = Path(directory)
    index = next((path for path in map(directory.joinpath, INDICES.values()) if path.exists()), None)
    if not directory.is_dir():
        raise InputError(f"{directory}: no such directory")
    if index is None:
        found = " or ".join(INDICES.values())
        raise InputError(f"{directory}: no {found} in it; was the run made with fields = true?")
    try:
        times, begins, number, grids = _read(index, step)
    # a damaged XML file gives a SyntaxError, a damaged piece or HDF5 file any of the others
    except (OSError, ValueError, SyntaxError, KeyError, AttributeError, RuntimeError, zlib.error) as problem:
        raise InputError(f"{index}: the fields cannot be read: {problem}") from problem
    time = times[number]
    bodies = [join_points(_piece(grid)) for (group, _), grid in grids.items() if group == "bodies"]
    surfaces = {name: _piece(grid) for (group, name), grid in grids.items() if group == "surfaces"}
    clouds = {name: Piece(grid.points, [], grid.point_data)
              for (group, name), grid in grids.items() if group == "points"}  # fmt: skip
    return Result(directory, time, times[begins:], bodies[0] if bodies else Piece(np.zeros((0, 3))), surfaces, clouds)


def has_fields(directory):
    """Return whether a run has left fields in a directory."""
    return any((Path(directory) / name).exists() for name in INDICES.values())


def _number(index, step, times, begins):
    """Return the number of a step among the times, from 0. The first of them may be that of the undeformed bodies."""
    count = len(times) - begins
    if abs(step) > count or step == 0 and not begins:
        allowed = f"1 to {count}, or -1 (the last) to {-count}{'; 0: undeformed' if begins else ''}"
        raise InputError(f"{index}: no step {step}; allowed: {allowed}")
    return step - 1 + begins if step > 0 else 0 if step == 0 else len(times) + step


def _read(index, step):
    """All times, whether the first is that of the undeformed bodies, the number of the step, and its grids by group
    and name."""
    entries = vtu.read_index(index)
    times = sorted({float(entry["timestep"]) for entry in entries})
    begins = any(Path(entry["file"]).stem.endswith("_000000") for entry in entries)
    number = _number(index, step, times, begins)
    entries = [entry for entry in entries if float(entry["timestep"]) == times[number]]
    if index.suffix != ".pvd":
        return times, begins, number, read_step(index.parent / entries[0]["file"])
    return times, begins, number, {
        (entry["group"], entry["name"].partition(": ")[2]): _whole(index.parent / entry["file"]) for entry in entries
    }


def _whole(path):
    """All pieces of a part one after the other."""
    grids = [vtu.read_vtu(piece) for piece in vtu.read_pvtu(path)]
    n_points = np.cumsum([0] + [len(grid.points) for grid in grids])
    n_nodes = np.cumsum([0] + [len(grid.connectivity) for grid in grids])
    return vtu.Grid(
        np.concatenate([grid.points for grid in grids]),
        np.concatenate([grid.connectivity + start for grid, start in zip(grids, n_points, strict=False)]),
        np.concatenate([grid.offsets + start for grid, start in zip(grids, n_nodes, strict=False)]),
        np.concatenate([grid.types for grid in grids]),
        {name: np.concatenate([grid.point_data[name] for grid in grids]) for name in grids[0].point_data},
        {name: np.concatenate([grid.cell_data[name] for grid in grids]) for name in grids[0].cell_data},
    )


def _piece(grid):
    """Blocks of cells by type, out of VTK's arrays."""
    cells, rows = [], []
    for number in np.unique(grid.types):
        name, n_nodes = vtu.CELL_NAMES[int(number)]
        rows.append(np.flatnonzero(grid.types == number))
        cells.append((name, grid.connectivity[grid.offsets[rows[-1], None] - n_nodes + np.arange(n_nodes)]))
    cell_data = {name: [array[row] for row in rows] for name, array in grid.cell_data.items()}
    return Piece(grid.points, cells, grid.point_data, cell_data)


def join_points(piece):
    """Give the points that ranks share one number again, so that facets between ranks are inside a body.

    Points are the same if they have the same number (point data `node_number`, which is taken away) and are of the same
    body (cell data `body`). Bodies that touch, and the two sides of a crack, have nodes of their own in the same place.

    Parameters
    ----------
    piece : Piece
        Points (n, 3) with doubles. Without numbers of nodes, as in fields of older versions, points of a body in the
        same place are taken to be the same.

    Returns
    -------
    Piece
    """
    points, data = piece.points, dict(piece.point_data)
    numbers = data.pop(NODE_NUMBER, None)
    if not len(points):
        return replace(piece, point_data=data)
    body = np.full(len(points), -1)
    for (_, nodes), values in zip(piece.cells, piece.cell_data.get("body", []), strict=False):
        body[nodes] = values[:, None]
    if numbers is None:
        # coordinates to 1e-9 of the size: two ranks may have rounded a midside node differently
        unit = 1e-9 * max(np.ptp(points, axis=0).max(), np.finfo(float).tiny)
        numbers = np.rint((points - points.min(axis=0)) / unit).astype(np.int64)
    first, number = distinct(body, *np.atleast_2d(numbers.T)[::-1])
    return Piece(
        points[first],
        [(name, number[nodes]) for name, nodes in piece.cells],
        {name: array[first] for name, array in data.items()},
        piece.cell_data,
    )
