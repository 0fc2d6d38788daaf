"""The layout of ``fields.vtkhdf``: all fields of a run in VTK's HDF5 format, with its series of times. Serial.

Format: "VTKHDF format specification" in VTK's documentation, version 2.1. The file has several unstructured grids, one
for the bodies and two for each contact pair (facets, quadrature points). A grid is of one part, in which the ranks
follow each other: VTK keeps parts of the load step before where there are fewer of them. Rows of all load steps follow
each other, too; the index, ``Steps``, says where those of a load step begin, so that a mesh that stays as it is stands
there once. The times stand beside the grids, too, which VTK 9.7 asks for and
VTK 9.4 does not bear.
"""

import re
from typing import NamedTuple

import h5py
import numpy as np

from pcontact.io import vtu
from pcontact.runtime import log

NAME, ROOT, VERSION = "fields.vtkhdf", "VTKHDF", (2, 1)
# from this version on HDF5 says where chunks are
TELLS = (1, 10, 5)
CHUNK = 1 << 22  # [bytes] of a chunk of rows at most, which HDF5 reads and compresses as one
FEW = 64  # [rows] of a chunk of the index, which has one or some per load step
_COUNTS = ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")
_BEGINS = ("PointOffsets", "CellOffsets", "ConnectivityIdOffsets")
_MESH = {"Points": (np.float64, 3), "Connectivity": (np.int64, 1), "Offsets": (np.int64, 1), "Types": (np.uint8, 1)}
# kinds of arrays, and which of the counts their rows have
_DATA = {"PointData": 0, "CellData": 1}
_NOTHING = (0, 0, 0)


class Room(NamedTuple):
    """New rows of a dataset, to be filled.

    Attributes
    ----------
    path : str
        Of the dataset in the file.
    key : (str, str)
        Group and name of the part of the fields.
    label : str
        ``Points``, ``Offsets``, ``PointData/NAME``, ...
    first : int
        The first of the rows.
    kind : (str, int)
        Type and columns.
    chunk : int
        Rows of a chunk.
    places : dict of int to int
        By its number, where a chunk begins in the file [bytes]; empty where only HDF5 can write, as it compresses.
    """

    path: str
    key: tuple
    label: str
    first: int
    kind: tuple
    chunk: int
    places: dict


class Series:
    """The file, open to be written or read.

    Parameters
    ----------
    file : h5py.File
    level : int
        Of compression of new datasets; 0: none, and HDF5 makes room for rows before they are written.
    """

    def __init__(self, file, level=0):
        self._level = level
        if ROOT not in file:
            root = file.create_group(ROOT, track_order=True)
            _typed(root, "MultiBlockDataSet")
            root.create_group("Assembly", track_order=True)
            root.create_group("Steps").attrs["NSteps"] = 0
            _index(root["Steps"], "Values", np.float64)
        self._root, self._steps = file[ROOT], file[ROOT]["Steps"]
        self.grids = {_key(one): one for name, one in self._root.items() if name not in ("Assembly", "Steps")}

    @property
    def times(self):
        """Times of all load steps (n_steps,)."""
        return self._steps["Values"][:]

    @property
    def begins(self):
        """Whether the first of them is that of the undeformed bodies."""
        return bool(self._steps.attrs.get("Undeformed", False))

    # -- writing ----------------------------------------------------------------------------------------------------

    def keep(self, count):
        """Keep the first load steps alone."""
        for grid in self.grids.values():
            steps, ends = grid["Steps"], _ends(grid, count)
            for label, rows in ends.items():
                grid[label].resize(rows, 0)
            steps.visititems(lambda _, one: one.resize(count, 0) if isinstance(one, h5py.Dataset) else None)
            steps.attrs["NSteps"] = count
        self._steps["Values"].resize(count, 0)
        self._steps.attrs["NSteps"] = count

    def add(self, step, time, parts, counts, changed):
        """Enter a load step, and make room for its rows.

        Parameters
        ----------
        step : int
            Its number; 0: the undeformed bodies.
        time : float
        parts : dict of (str, str) to dict
            See :func:`pcontact.io.parts.agree`.
        counts : dict of (str, str) to ndarray (3,)
            Points, cells and length of the connectivity of each grid.
        changed : set of (str, str)
            Grids whose mesh is not that of the load step before.

        Returns
        -------
        list of Room
        """
        before, rooms = self.times, []
        for key in parts:
            if key not in self.grids:
                self._new(key, before, list(parts), parts[key]["file"], counts[key])
        for key, grid in self.grids.items():
            if key in parts:
                rooms += self._step(grid, time, parts[key], counts[key], key in changed)
            else:
                # of a contact that acts in other phases
                self._nothing(grid, time)
        _append(self._steps["Values"], [time])
        if step == 0:
            self._steps.attrs["Undeformed"] = True
        self._steps.attrs["NSteps"] = len(before) + 1
        return rooms

    def _new(self, key, before, keys, file, total):
        """A grid; in the load steps before it is empty."""
        name = re.sub(r"[^\w.-]", "_", file, flags=re.ASCII)
        name = f"{name}_{keys.index(key)}" if name in self._root else name
        grid = self.grids[key] = self._root.create_group(name)
        _typed(grid, "UnstructuredGrid")
        grid.attrs.update({"Index": len(self.grids) - 1, "part": key[0], "name": key[1]})
        self._root[f"Assembly/{name}"] = h5py.SoftLink(f"/{ROOT}/{name}")
        for section in (*_DATA, "Steps", *(f"Steps/{section}Offsets" for section in _DATA)):
            grid.create_group(section)
        grid["Steps"].attrs["NSteps"] = 0
        for label in _COUNTS:
            _index(grid, label)
        for label, (kind, width) in _MESH.items():
            self._dataset(grid, label, np.dtype(kind), width, np.max(total))
        for time in before:
            self._nothing(grid, time)

    def _nothing(self, grid, time):
        """A load step without points."""
        self._enter(grid, time, _NOTHING, True)
        offsets = grid["Offsets"]
        offsets.resize(len(offsets) + 1, 0)
        offsets[-1] = 0
        for section in _DATA:
            for name, dataset in grid[section].items():
                _append(_index(grid, f"Steps/{section}Offsets/{name}"), [len(dataset)])

    def _step(self, grid, time, part, total, changed):
        """A load step of a grid: its :class:`Room` s."""
        rooms, steps = [], int(grid["Steps"].attrs["NSteps"])
        changed = changed or steps == 0
        if changed:
            rows = {"Points": total[0], "Connectivity": total[2], "Offsets": total[1] + 1, "Types": total[1]}
            rooms += [self._room(grid, label, rows[label]) for label in _MESH]
        for (section, which), arrays in zip(_DATA.items(), (part["point_data"], part["cell_data"]), strict=True):
            for name, kind in arrays.items():
                self._array(grid, f"{section}/{_place(name)}", kind, total[which], steps)
            for name in grid[section]:
                label = f"{section}/{name}"
                _append(_index(grid, f"Steps/{section}Offsets/{name}"), [len(grid[label])])
                rooms.append(self._room(grid, label, total[which]))
        self._enter(grid, time, total, changed)
        return rooms

    def _array(self, grid, label, kind, rows, steps):
        """The dataset of an array, if it is not there yet: with the first load step that has rows."""
        if label in grid:
            return
        section, _, name = label.partition("/")
        if steps and any(_numbers(grid, step)[_DATA[section]] for step in range(steps)):
            log.warning("%s: %s is not in the first load step, and left out", NAME, name)
            return
        self._dataset(grid, label, vtu.DTYPES[kind[0]], kind[1], rows)
        _append(_index(grid, f"Steps/{section}Offsets/{name}"), np.zeros(steps, np.int64))

    def _dataset(self, grid, label, dtype, width, rows):
        """A dataset of no rows, in chunks of about those of a load step."""
        chunk = max(1, min(max(int(rows), FEW), CHUNK // (dtype.itemsize * width)))
        shape, most, chunks = (0,), (h5py.h5s.UNLIMITED,), (chunk,)
        if width > 1:
            shape, most, chunks = (0, width), (h5py.h5s.UNLIMITED, width), (chunk, width)
        how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        how.set_chunk(chunks)
        how.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        if self._level:
            how.set_deflate(self._level)
        else:
            how.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        space, kind = h5py.h5s.create_simple(shape, most), h5py.h5t.py_create(dtype)
        h5py.h5d.create(grid.id, label.encode(), kind, space, how)

    def _room(self, grid, label, rows):
        """Make a dataset longer."""
        dataset = grid[label]
        first, chunk, places = len(dataset), dataset.chunks[0], {}
        dataset.resize(first + int(rows), 0)
        if rows and dataset.compression is None and h5py.version.hdf5_version_tuple >= TELLS:
            rest = (0,) * (dataset.ndim - 1)
            for number in range(first // chunk, (first + int(rows) - 1) // chunk + 1):
                places[number] = dataset.id.get_chunk_info_by_coord((number * chunk, *rest)).byte_offset
        width = dataset.shape[1] if dataset.ndim > 1 else 1
        return Room(dataset.name, _key(grid), label, first, (dataset.dtype.str, width), chunk, places)

    def _enter(self, grid, time, counts, changed):
        """What the index has of a load step: how many rows, and where they begin."""
        steps, n = grid["Steps"], int(grid["Steps"].attrs["NSteps"])
        if changed:
            begin = [len(grid[_COUNTS[0]]), *(int(np.sum(grid[label])) for label in _COUNTS)]
            for label, count in zip(_COUNTS, counts, strict=True):
                _append(grid[label], [count])
        else:
            begin = [int(steps[label][n - 1]) for label in ("PartOffsets", *_BEGINS)]
        for label, value in zip(("PartOffsets", *_BEGINS, "NumberOfParts"), (*begin, 1), strict=True):
            _append(_index(steps, label), [value])
        _append(_index(steps, "Values", np.float64), [time])
        steps.attrs["NSteps"] = n + 1

    # -- reading ------------------------------------------------------------------------------------------------------

    def read(self, step):
        """The grids of a load step that have points.

        Parameters
        ----------
        step : int
            From 0.

        Returns
        -------
        dict of (str, str) to pcontact.io.vtu.Grid
        """
        return {key: _read(grid, step) for key, grid in self.grids.items() if _numbers(grid, step)[0]}


def _key(grid):
    """Group and name of the part that a grid is of."""
    return str(grid.attrs["part"]), str(grid.attrs["name"])


def _place(name):
    """A name of an array as one of a dataset."""
    return name.replace("/", "_")


def _typed(group, kind):
    group.attrs.create("Type", np.bytes_(kind))
    group.attrs.create("Version", np.array(VERSION, np.int64))


def _index(group, label, dtype=np.int64):
    """A small dataset of numbers, made where it is not there."""
    if label not in group:
        group.create_dataset(label, (0,), dtype, maxshape=(None,), chunks=(FEW,))
    return group[label]


def _append(dataset, values):
    first = len(dataset)
    dataset.resize(first + len(values), 0)
    if len(values):
        dataset[first:] = values


def _numbers(grid, step):
    """Points, cells and length of the connectivity of a load step (3,)."""
    part = int(grid["Steps/PartOffsets"][step])
    return np.array([int(grid[label][part]) for label in _COUNTS])


def _ends(grid, count):
    """Rows of all datasets that the first load steps need."""
    ends = dict.fromkeys([*_COUNTS, *_MESH, *(f"{part}/{name}" for part in _DATA for name in grid[part])], 0)
    for step in range(count):
        total, steps = _numbers(grid, step), grid["Steps"]
        parts, begin = int(steps["PartOffsets"][step]) + 1, [int(steps[label][step]) for label in _BEGINS]
        found = dict.fromkeys(_COUNTS, parts)
        found |= dict(zip(("Points", "Types", "Connectivity"), begin + total, strict=True))
        found["Offsets"] = found["Types"] + parts
        for section, which in _DATA.items():
            for name in grid[section]:
                found[f"{section}/{name}"] = steps[f"{section}Offsets/{name}"][step] + total[which]
        ends = {label: max(rows, int(found[label])) for label, rows in ends.items()}
    return {label: rows for label, rows in ends.items() if label in grid}


def _read(grid, step):
    """A grid at a load step, as :class:`pcontact.io.vtu.Grid`."""
    total, steps, data = _numbers(grid, step), grid["Steps"], {}
    part, (point, cell, node) = int(steps["PartOffsets"][step]), (int(steps[label][step]) for label in _BEGINS)
    for section, which in _DATA.items():
        first = {name: int(steps[f"{section}Offsets/{name}"][step]) for name in grid[section]}
        data[section] = {name: one[first[name] : first[name] + total[which]] for name, one in grid[section].items()}
    # one more entry of offsets than cells in each load step, the first 0
    ends = grid["Offsets"][cell + part + 1 : cell + part + 1 + total[1]]
    return vtu.Grid(
        grid["Points"][point : point + total[0]], grid["Connectivity"][node : node + total[2]], ends,
        grid["Types"][cell : cell + total[1]], data["PointData"], data["CellData"],
    )  # fmt: skip
