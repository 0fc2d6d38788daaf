"""Parts of a run's fields, before they are written: bodies, facets and quadrature points of contact pairs.

Every rank has its own piece of a part; here the ranks agree on what each part holds.
"""

import os
import re
from dataclasses import dataclass, field

import numpy as np

from pcontact.io import vtu
from pcontact.runtime.errors import TOLD

# field of the bodies' points: number of the node in the mesh
NODE_NUMBER = "node_number"
GROUPS = {"bodies": "bodies", "surfaces": "surface", "points": "points"}
# characters of a contact's name in the name of a file, which may have 255 bytes: four a character at most
LONGEST = 50


@dataclass
class Piece:
    """One rank's part of a mesh with its fields.

    Parameters
    ----------
    points : ndarray (n, 2) or (n, 3)
        Coordinates in the reference state [length].
    cells : list of (str, ndarray (nc, nn))
        Blocks of cells: meshio's name of the type, nodes in VTK's order (row numbers of `points`).
    point_data : dict of str to ndarray (n,) or (n, k)
        Fields at the points.
    cell_data : dict of str to list of ndarray (nc,) or (nc, k)
        Fields of the cells: one array per block. Symmetric tensors have 6 columns XX, YY, ZZ, XY, YZ, XZ.
    """

    points: np.ndarray
    cells: list = field(default_factory=list)
    point_data: dict = field(default_factory=dict)
    cell_data: dict = field(default_factory=dict)


@dataclass
class Cloud:
    """One rank's quadrature points of a contact pair.

    Parameters
    ----------
    points : ndarray (n, 2) or (n, 3)
        Coordinates in the reference state [length].
    data : dict of str to ndarray (n,) or (n, k)
        Values at the points.
    """

    points: np.ndarray
    data: dict = field(default_factory=dict)


def on_all(comm, function, *args, root=False):
    """Call a function; what one rank raises is raised by all, so that none waits for ever. *Collective.*

    With `root` the result is that of rank 0.
    """
    result = error = None
    try:
        result = function(*args)
    except (*TOLD, ValueError) as problem:
        # what it was raised from stays on this rank
        error = (type(problem) if isinstance(problem, TOLD) else ValueError)(str(problem))
    errors = [problem for problem in comm.allgather(error) if problem is not None]
    if errors:
        raise errors[0]
    return comm.bcast(result) if root else result


def agree(comm, grids):
    """Each part's arrays and the ranks that own some of it, the same on all ranks. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    grids : dict of (str, str) to pcontact.io.vtu.Grid
        As of :func:`grids_of`.

    Returns
    -------
    dict of (str, str) to dict
        By group and name: ``file`` (a name for files), ``ranks``, ``point_data`` and ``cell_data``
        (`pcontact.io.vtu.signature` of every array).

    Raises
    ------
    ValueError
        On all ranks: their arrays differ.
    """
    gathered = comm.gather({key: _signatures(grid) for key, grid in grids.items()})
    return on_all(comm, lambda: _merged(gathered) if gathered else None, root=True)


def grids_of(bodies, surfaces, points):
    """This rank's parts in VTK's arrays.

    Parameters
    ----------
    bodies : Piece
    surfaces : dict of str to Piece
    points : dict of str to Cloud

    Returns
    -------
    dict of (str, str) to pcontact.io.vtu.Grid
        By group and name.

    Raises
    ------
    ValueError
        An array does not fit its points or cells.
    """
    grids = {("bodies", ""): grid_of(bodies, "bodies")}
    for name, piece in surfaces.items():
        grids["surfaces", name] = grid_of(piece, f"surface {name!r}")
    for name, cloud in points.items():
        # cells of one node: ParaView draws cells, not bare points
        cells = [("vertex", np.arange(len(cloud.points)).reshape(-1, 1))]
        grids["points", name] = grid_of(Piece(cloud.points, cells, cloud.data, {}), f"points of {name!r}")
    return grids


def grid_of(piece, name=""):
    """A piece in VTK's arrays; ValueError where an array does not fit."""
    points = np.asarray(piece.points, dtype=float)
    points = points if points.size else np.zeros((0, 3))
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    blocks = [(kind, np.asarray(nodes)) for kind, nodes in piece.cells]
    for kind, nodes in blocks:
        if kind not in vtu.CELL_TYPES or nodes.ndim != 2 or nodes.shape[1] != vtu.CELL_TYPES[kind][1]:
            raise ValueError(f"{name}: no cells of type {kind!r} with nodes of shape {nodes.shape}")
        if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(points):
            raise ValueError(f"{name}: cells of type {kind!r} name nodes beyond the {len(points)} points")
    counts = [len(nodes) for _, nodes in blocks]
    sizes = np.repeat([vtu.CELL_TYPES[kind][1] for kind, _ in blocks], counts)
    types = np.repeat([vtu.CELL_TYPES[kind][0] for kind, _ in blocks], counts)
    cell_data = {}
    for key, arrays in piece.cell_data.items():
        if [len(array) for array in arrays] != counts:
            raise ValueError(f"{name}: cell data {key!r} have not the lengths {counts} of the blocks")
        cell_data[key] = _columns(arrays, sum(counts), f"{name}: cell data {key!r}")
    return vtu.Grid(
        np.ascontiguousarray(points),
        np.concatenate([np.zeros(0, np.int64), *(nodes.ravel() for _, nodes in blocks)]).astype(np.int64),
        np.cumsum(sizes).astype(np.int64),
        types.astype(np.uint8),
        {key: _columns([array], len(points), f"{name}: {key!r}") for key, array in piece.point_data.items()},
        cell_data,
    )


def _columns(arrays, n, name):
    """Arrays one below the other as VTK stores them, (n,) or (n, k); vectors of the plane padded."""
    arrays = [np.asarray(array) for array in arrays]
    arrays = [array for array in arrays if len(array)] or arrays[:1] or [np.zeros(0)]
    array = vtu.storable(np.concatenate(arrays))
    if len(array) != n or array.ndim > 2:
        raise ValueError(f"{name} has shape {array.shape}, not ({n},) or ({n}, k)")
    if array.ndim == 2 and array.shape[1] in (1, 2):
        return array[:, 0].copy() if array.shape[1] == 1 else np.pad(array, ((0, 0), (0, 1)))
    return array


def _signatures(grid):
    """What the ranks must agree on: has this one points and cells, and which arrays do they carry."""
    return {
        "size": (len(grid.points), len(grid.types)),
        "point_data": {key: vtu.signature(array) for key, array in grid.point_data.items()},
        "cell_data": {key: vtu.signature(array) for key, array in grid.cell_data.items()},
    }


def _merged(gathered):
    """Rank 0: one description of each part out of all ranks'."""
    parts = {}
    keys = {key for local in gathered for key in local}
    keys = sorted(keys, key=lambda key: (list(GROUPS).index(key[0]), key[1]))
    files = file_names(keys)
    for key in keys:
        pieces = {rank: local[key] for rank, local in enumerate(gathered) if key in local}
        ranks = [rank for rank, piece in pieces.items() if piece["size"][0]]
        parts[key] = {
            "file": files[key],
            "ranks": ranks or [0],
            "point_data": _common(
                key, [(piece["size"][0], piece["point_data"]) for piece in pieces.values()]
            ),
            "cell_data": _common(key, [(piece["size"][1], piece["cell_data"]) for piece in pieces.values()]),
        }
    return parts


def _common(key, pieces):
    """The arrays of one part. Pieces that hold something must agree, an empty one need not know them."""
    filled = [arrays for size, arrays in pieces if size]
    if any(arrays != filled[0] for arrays in filled):
        raise ValueError(f"{' '.join(key)}: the ranks give different arrays: {filled}")
    arrays = filled[0] if filled else {name: kind for _, local in pieces for name, kind in local.items()}
    return dict(sorted(arrays.items()))


def file_names(keys):
    """File names of the parts: a contact's name may hold what a file name must not, and be longer."""
    names = {key: _file_name(GROUPS[key[0]] + (f"_{key[1][:LONGEST]}" if key[1] else "")) for key in keys}
    taken = list(names.values())
    return {
        key: name if taken.count(name) == 1 else f"{name}_{number}"
        for number, (key, name) in enumerate(names.items())
    }


def _file_name(name):
    """A name with letters that the locale and file systems know."""
    name = re.sub(r"[^\w.-]+", "_", name)
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        name = re.sub(r"[^\w.-]+", "_", name, flags=re.ASCII)
    return name


def fill(arrays, signatures):
    """Bring a piece's arrays to the common list and order; only an empty one can lack some."""
    given = dict(arrays)
    arrays.clear()
    for name, signature in signatures.items():
        array = given.get(name)
        arrays[name] = array if array is not None and len(array) else vtu.empty(*signature)
