"""Fields of a run in one file, ``fields.vtkhdf``, written by all ranks.

Rank 0 alone talks to HDF5 and makes room for rows; all ranks write them there at the same time, by MPI. So no parallel
HDF5 is needed, a rank that cannot write is heard by all, and the file on disk is whole at any moment
(:class:`pcontact.runtime.files.Hdf5Grown`). Rows that are compressed are handed to rank 0, whose HDF5 does that.
"""

import zlib
from pathlib import Path

import numpy as np

from pcontact.io import vtu
from pcontact.io.fields import INDEX, clear, other_format
from pcontact.io.parts import agree, fill, grids_of, on_all
from pcontact.io.vtkhdf import NAME, Series
from pcontact.runtime.errors import OutputError
from pcontact.runtime.files import Hdf5Grown, going_on, make_directory
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI


class HdfWriter:
    """Writes the fields of one run into one file, a load step at a time.

    Parameters
    ----------
    directory : str or pathlib.Path
        The output directory; made with the first load step. Fields that an earlier run left there go then.
    comm : MPI.Comm
    resume_time : float, optional
        The run continues one whose fields are in `directory`: load steps up to this time are kept.
    compression : int
        Level of deflate, 1 to 9; 0: none.
    """

    def __init__(self, directory, comm, resume_time=None, compression=0):
        self.path, self.comm, self._level = Path(directory) / NAME, comm, compression
        if resume_time is not None:
            on_root(comm, other_format, Path(directory), NAME, INDEX)
        self._resume, self._begun, self._meshes = resume_time, False, {}

    def write(self, step, time, bodies, surfaces=None, points=None):
        """Write one load step. *Collective.*

        Parameters and errors are those of :meth:`pcontact.io.fields.FieldWriter.write`.
        """
        grids = on_all(self.comm, grids_of, bodies, surfaces or {}, points or {})
        parts = agree(self.comm, grids)
        for key, part in parts.items():
            grid = grids.setdefault(key, vtu.no_cells())
            fill(grid.point_data, part["point_data"])
            fill(grid.cell_data, part["cell_data"])
        counts, changed = self._compare(grids, parts)
        aside = on_all(self.comm, self._open)
        try:
            total = {key: rows.sum(axis=0) for key, rows in counts.items()}
            rooms = on_all(self.comm, self._enter, aside, step, time, parts, total, changed, root=True)
            jobs = [(room, *self._rows(room, grids[room.key], counts[room.key])) for room in rooms]
            # a file of the run before may be compressed, whatever this run says
            if self.comm.size > 1 and all(room.places or not rows.any() for room, _, rows in jobs):
                self._write_rows(aside, jobs)
            else:
                self._hand_over(aside, jobs)
            on_all(self.comm, _place, aside)
            self._begun = True
        finally:
            if aside is not None:
                aside.discard()

    def _compare(self, grids, parts):
        """Points, cells and length of the connectivity (n_ranks, 3) of each grid, and the set of those whose mesh has
        changed. *Collective.*"""
        own, fresh, meshes = {}, set(), {}
        for key in parts:
            grid = grids[key]
            own[key] = len(grid.points), len(grid.types), len(grid.connectivity)
            meshes[key] = own[key], *map(zlib.crc32, (grid.points, grid.connectivity, grid.types))
            if self._meshes.get(key) != meshes[key]:
                fresh.add(key)
        # a contact that does not act in a load step has its mesh written again afterwards
        self._meshes = meshes
        gathered = self.comm.allgather((own, fresh))
        counts = {key: np.array([one[key] for one, _ in gathered]) for key in parts}
        return counts, set().union(*(one for _, one in gathered))

    def _open(self):
        """The file, on rank 0."""
        if self.comm.rank != 0:
            return None
        make_directory(self.path.parent)
        if not self._begun and self._resume is None:
            clear(self.path.parent)
        if self._begun or self._resume is None or not self.path.exists():
            return Hdf5Grown(self.path, not self._begun)
        with going_on(self.path):
            aside = Hdf5Grown(self.path, False)
            try:
                series = Series(aside.file)
                series.keep(int(np.sum(series.times <= self._resume + 1e-10 * abs(self._resume))))
                # in its place before all ranks write into chunks of which it has changed the rest
                aside.place()
            finally:
                aside.discard()
        return Hdf5Grown(self.path, False)

    def _enter(self, aside, *entry):
        """Make room for a load step: list of :class:`pcontact.io.vtkhdf.Room`."""
        return None if aside is None else Series(aside.file, self._level).add(*entry)

    def _rows(self, room, grid, counts):
        """What this rank has for a room (n, k) or (n,), and how many rows each rank has (n_ranks,)."""
        section, _, name = room.label.partition("/")
        which = {"Points": 0, "PointData": 0, "Connectivity": 2}.get(section, 1)
        rows, before = counts[:, which].copy(), counts[: self.comm.rank].sum(axis=0)
        if section == "Offsets":
            rows[0] += 1
            array = grid.offsets + before[2]
            array = array if self.comm.rank else np.concatenate([np.zeros(1, np.int64), array])
        elif section == "Connectivity":
            array = grid.connectivity + before[0]
        elif name:
            data = grid.point_data if section == "PointData" else grid.cell_data
            array = {key.replace("/", "_"): values for key, values in data.items()}.get(name)
        else:
            array = getattr(grid, section.lower())
        dtype, width = np.dtype(room.kind[0]), room.kind[1]
        if array is None:
            # an array that later load steps do not have
            size = (rows[self.comm.rank], width) if width > 1 else rows[self.comm.rank]
            array = np.full(size, np.nan if dtype.kind == "f" else 0)
        return np.ascontiguousarray(array, dtype=dtype), rows

    def _hand_over(self, aside, jobs):
        """Ranks hand their rows to rank 0 in turn: memory for one more rank's rows is enough. *Collective.*"""
        comm = self.comm
        for room, array, rows in jobs:
            if comm.rank != 0:
                if rows[comm.rank]:
                    comm.recv(source=0)
                    comm.Send(array, dest=0)
                continue
            dataset, first = aside.file[room.path], room.first
            for rank in np.flatnonzero(rows).tolist():
                if rank > 0:
                    array = np.empty((rows[rank], *array.shape[1:]), array.dtype)
                    comm.send(None, dest=rank)
                    comm.Recv(array, source=rank)
                # what fails is told when the file is put in place; until then the other ranks have to be heard
                if not aside.failed:
                    dataset[first : first + len(array)] = array
                first += len(array)

    def _write_rows(self, aside, jobs):
        """All ranks write their rows into the room that was made for them. *Collective.*"""
        comm, why = self.comm, None
        path = comm.bcast(str(aside.written) if aside is not None else None)
        stream = on_all(comm, _opened, comm, path)
        try:
            for room, array, rows in jobs:
                if rows[comm.rank]:
                    _write_into(stream, room, array, room.first + int(rows[: comm.rank].sum()))
        except MPI.Exception as error:
            why = error
        # whoever has failed, these are collective
        try:
            stream.Sync()
        except MPI.Exception as error:
            why = why or error
        stream.Close()
        on_all(comm, _raise, why, self.path)


def _opened(comm, path):
    try:
        return MPI.File.Open(comm, path, MPI.MODE_WRONLY)
    except MPI.Exception as error:
        raise _told(path, error) from error


def _write_into(stream, room, array, first):
    """Rows into the chunks that have room for them."""
    size, done = array.nbytes // len(array), 0
    while done < len(array):
        number, at = divmod(first + done, room.chunk)
        n = min(room.chunk - at, len(array) - done)
        status = MPI.Status()
        stream.Write_at(room.places[number] + at * size, array[done : done + n], status)
        if status.Get_count(MPI.BYTE) != n * size:
            raise MPI.Exception(MPI.ERR_NO_SPACE)
        done += n


def _raise(why, path):
    if why is not None:
        raise _told(path, why)


def _told(path, error):
    text = " ".join(error.Get_error_string().split()).lower()
    return OutputError(f"{path}: cannot be written ({text}); what was written before is whole")


def _place(aside):
    if aside is not None:
        aside.place()
