"""Fields for ParaView, in pieces of all ranks or in one file for each load step; an index holds all times together.

In the output directory::

    fields.pvd                          all times, three groups of parts: bodies, surfaces, points
                                        (the first time, step 0: the undeformed bodies)
    fields/bodies_000001.pvtu           the bodies at step 1, and
    fields/bodies_000001_0000.vtu       rank 0's piece of them
    fields/surface_NAME_000001.pvtu     the facets of one contact pair
    fields/points_NAME_000001.pvtu      the quadrature points of one contact pair

    fields.vtkhdf.series                instead: all times
    fields/step_000001.vtkhdf           all parts at step 1

Every rank has its own piece of a part (bodies, facets or quadrature points of a contact pair); the ranks agree on what
each part holds. Of VTK's HDF5 format rank 0 writes what the others hand to it, one after the other. A mesh that is the
same as in the step before is not written again: the file has links to that of the step which has it.
"""

import os
import re
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np

from pcontact.io import vtu
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import Hdf5Aside, going_on, make_directory, telling
from pcontact.runtime.parallel import aside_of_root, on_root, together, write_rows

ROOT, VERSION = "VTKHDF", (2, 1)
_MESH = ("Points", "Connectivity", "Offsets", "Types")
# field of the bodies' points: number of the node in the mesh
NODE_NUMBER = "node_number"
GROUPS = {"bodies": "bodies", "surfaces": "surface", "points": "points"}
# characters of a contact's name in the name of a file, which may have 255 bytes: four a character at most
LONGEST = 50
INDICES = {"vtu": "fields.pvd", "vtkhdf": "fields.vtkhdf.series"}
_OURS = re.compile(r"((bodies|surface_.*|points_.*)_\d{6,}(_\d{4,})?\.p?vtu|step_\d{6,}\.vtkhdf)(\.part)?")


def write_step(comm, path, grids, parts, level=0, meshes=None):
    """Write the file of a load step. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    path : pathlib.Path
    grids : dict of (str, str) to pcontact.io.vtu.Grid
        This rank's part of each, with all of its arrays.
    parts : dict of (str, str) to dict
        See :func:`pcontact.io.fields.agree`.
    level : int
        Of deflate, 0 none.
    meshes : dict of (str, str) to str, optional
        Names of files beside this one, which have the mesh of a part; those that are not there are written.

    Raises
    ------
    OutputError
        On all ranks: the file of before, if any, is still there.
    """
    def begun():
        aside = Hdf5Aside(path, summed=False)
        _typed(aside.file.create_group(ROOT, track_order=True), "MultiBlockDataSet")
        aside.file.create_group(f"{ROOT}/Assembly", track_order=True)
        return aside

    with aside_of_root(comm, begun) as aside:
        for key, name in zip(parts, _names(parts), strict=True):
            grid = grids[key]
            counts = np.array(comm.allgather((len(grid.points), len(grid.types), len(grid.connectivity))))
            arrays = _arrays(grid, counts[: comm.rank].sum(axis=0), comm.rank)
            link = (meshes or {}).get(key)
            if aside is not None:
                _head(aside.file, key, name, counts.sum(axis=0), link)
            for label, array in arrays.items():
                if link is None or label not in _MESH:
                    write_rows(comm, aside, f"{ROOT}/{name}/{label}", array, level)


def read_step(path):
    """Grids of a load step, by group and name.

    Returns
    -------
    dict of (str, str) to pcontact.io.vtu.Grid
    """
    with h5py.File(path, "r") as file:
        found = {(one.attrs["part"], one.attrs["name"]): vtu.Grid(
            one["Points"][:], one["Connectivity"][:], one["Offsets"][1:], one["Types"][:],
            *({name: array[:] for name, array in one[section].items()} for section in ("PointData", "CellData")),
        ) for label, one in file[ROOT].items() if label != "Assembly"}  # fmt: skip
    return {key: grid for key, grid in found.items() if len(grid.points)}


def _names(parts):
    """Names of parts for VTK, which has fewer characters than files have."""
    names = [re.sub(r"[^\w.-]", "_", part["file"], flags=re.ASCII) for part in parts.values()]
    return [f"{name}_{k}" if name in names[:k] else name for k, name in enumerate(names)]


def _typed(group, kind):
    group.attrs.create("Type", np.bytes_(kind))
    group.attrs.create("Version", np.array(VERSION, np.int64))
    return group


def _head(file, key, name, total, link):
    """Begin a part, with its numbers of points, cells and entries of the connectivity."""
    grid = _typed(file[ROOT].create_group(name), "UnstructuredGrid")
    grid.attrs.update({"Index": len(file[ROOT]["Assembly"]), "part": key[0], "name": key[1]})
    file[f"{ROOT}/Assembly/{name}"] = h5py.SoftLink(f"/{ROOT}/{name}")
    for label, count in zip(("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds"), total, strict=True):
        grid[label] = np.array([count], np.int64)
    for section in ("PointData", "CellData"):
        grid.create_group(section)
    for label in _MESH if link is not None else ():
        grid[label] = h5py.ExternalLink(link, f"/{ROOT}/{name}/{label}")


def _arrays(grid, before, rank):
    """Rows of one rank by their places, where points, cells and entries of other ranks come before."""
    first = np.zeros(int(rank == 0), np.int64)
    return {
        "Points": grid.points, "Connectivity": grid.connectivity + before[0],
        "Offsets": np.concatenate([first, grid.offsets + before[2]]), "Types": grid.types,
        **{f"{section}/{name.replace('/', '_')}": array
           for section, data in (("PointData", grid.point_data), ("CellData", grid.cell_data))
           for name, array in data.items()},
    }  # fmt: skip


@dataclass
class Piece:
    """One rank's part of a mesh, or points without cells, with their fields.

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
    return comm.bcast(on_root(comm, _merged, gathered))


def grids_of(bodies, surfaces, points):
    """This rank's parts in VTK's arrays.

    Parameters
    ----------
    bodies : Piece
    surfaces : dict of str to Piece
    points : dict of str to Piece
        Quadrature points, without cells.

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
        grids["points", name] = grid_of(replace(cloud, cells=cells), f"points of {name!r}")
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
    """Return what the ranks must agree on: has this one points and cells, and which arrays do they carry."""
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


class FieldWriter:
    """Writes the fields of one run, a step at a time.

    Parameters
    ----------
    directory : str or Path
        The output directory; made with the first step. Fields that an earlier run left there go then.
    comm : mpi4py.MPI.Comm
        All ranks of the run.
    resume_time : float, optional
        The run continues one whose fields are in `directory`: steps up to this time are kept.
    kind : {"vtu", "vtkhdf"}
    compression : int
        Level of deflate of ``.vtkhdf``, 1 to 9; 0: none.
    """

    def __init__(self, directory, comm, resume_time=None, kind="vtu", compression=0):
        self.directory, self.comm, self._kind, self._level = Path(directory), comm, kind, compression
        self._index = self.directory / INDICES[kind]
        self._entries = None if resume_time is None else on_root(comm, self._take_up, resume_time)
        self._began, self._more, self._meshes = False, False, {}

    def write(self, step, time, bodies, surfaces=None, points=None):
        """Write one step. *Collective.*

        A rank that owns nothing of a part gives an empty `Piece`, or leaves its key out.

        Parameters
        ----------
        step : int
            Number of the step, for the file names; 0: the undeformed bodies.
        time : float
            Time of the step.
        bodies : Piece
            The cells this rank owns.
        surfaces : dict of str to Piece
            The facets of each contact pair that this rank owns.
        points : dict of str to Piece
            The quadrature points of each contact pair that this rank owns, without cells.

        Raises
        ------
        ValueError
            On all ranks: on one of them an array does not fit its points or cells, or the
            ranks' arrays differ.
        OutputError
            On all ranks: one of them could not write.
        """
        grids = together(self.comm, grids_of, bodies, surfaces or {}, points or {})
        parts = agree(self.comm, grids)
        for key, part in parts.items():
            grid = grids.setdefault(key, vtu.no_cells())
            fill(grid.point_data, part["point_data"])
            fill(grid.cell_data, part["cell_data"])
        if not self._began:
            together(self.comm, self._begin)
            self._began = True
        if self._kind == "vtu":
            together(self.comm, self._write_pieces, step, grids, parts)
            files = {key: f"{part['file']}_{step:06d}.pvtu" for key, part in parts.items()}
        else:
            files = {None: f"step_{step:06d}.vtkhdf"}
            meshes = self._checked_meshes(grids, files[None])
            same = {key: file for key, (_, file) in meshes.items() if file != files[None]}
            write_step(self.comm, self.directory / "fields" / files[None], grids, parts, self._level, same)
            self._meshes = meshes
        together(self.comm, self._enter, time, parts, files)

    def _take_up(self, resume_time):
        """Entries of the earlier run up to a time; None if there are no fields."""
        limit, others = resume_time + 1e-10 * abs(resume_time), {*INDICES.values()} - {self._index.name}
        if not self._index.exists():
            for other in (self.directory / name for name in others):
                if other.exists():
                    raise InputError(f"{other}: found fields of the other format; allowed: the [output] format of the "
                                     "run before, or another -o")  # fmt: skip
            return None
        with going_on(self._index):
            return [entry for entry in vtu.read_index(self._index) if float(entry["timestep"]) <= limit]

    def _begin(self):
        """Make the directory, clear away what an earlier run left, keep what this run continues."""
        if self.comm.rank != 0:
            return
        if self._entries is None:
            clear(self.directory)
        make_directory(self.directory / "fields")
        vtu.write_index(self._index, self._entries or [])
        self._more = bool(self._entries)

    def _write_pieces(self, step, grids, parts):
        """This rank's file of each part of which it owns something; rank 0: the .pvtu of each part."""
        folder = self.directory / "fields"
        for key, part in parts.items():
            file = f"{part['file']}_{step:06d}"
            if self.comm.rank in part["ranks"]:
                vtu.write_vtu(folder / f"{file}_{self.comm.rank:04d}.vtu", grids[key])
            if self.comm.rank == 0:
                pieces = [f"{file}_{rank:04d}.vtu" for rank in part["ranks"]]
                vtu.write_pvtu(folder / f"{file}.pvtu", part["point_data"], part["cell_data"], pieces)

    def _checked_meshes(self, grids, file):
        """Return by part checksums of the mesh of all ranks and the file that has it, which may be an earlier one.
        *Collective.*"""
        own = {key: [zlib.crc32(array) for array in (grid.points, grid.connectivity, grid.types)]
               for key, grid in grids.items()}  # fmt: skip
        every, found = self.comm.allgather(own), {}
        for key in grids:
            now = [rank[key] for rank in every]
            before, earlier = self._meshes.get(key, (None, file))
            found[key] = now, earlier if before == now else file
        return found

    def _enter(self, time, parts, files):
        """Rank 0: enter a step into the index, which is whole after every step."""
        if self.comm.rank != 0:
            return
        entries = [{"timestep": repr(float(time)), "file": f"fields/{file}"} for file in files.values()]
        if self._kind == "vtu":
            entries = [
                {"timestep": one["timestep"], "group": group, "part": number,
                 "name": f"{group}: {name}" if name else group, "file": one["file"]}
                for number, ((group, name), one) in enumerate(zip(parts, entries, strict=True))
            ]  # fmt: skip
        vtu.add_to_index(self._index, entries, self._more)
        self._more = True


def clear(directory):
    """Take away the fields that an earlier run left, in both formats.

    Raises
    ------
    OutputError
    """
    folder = directory / "fields"
    with telling(folder):
        for name in INDICES.values():
            (directory / name).unlink(missing_ok=True)
        if folder.is_dir():
            for path in folder.iterdir():
                if _OURS.fullmatch(path.name):
                    path.unlink()
            if not any(folder.iterdir()):
                folder.rmdir()
