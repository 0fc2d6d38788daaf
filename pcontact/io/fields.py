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
"""

import re
import zlib
from pathlib import Path

from pcontact.io import vtu
from pcontact.io.parts import agree, fill, grids_of, on_all
from pcontact.io.vtkhdf import write_step
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import going_on, make_directory, telling
from pcontact.runtime.parallel import on_root

INDICES = {"vtu": "fields.pvd", "vtkhdf": "fields.vtkhdf.series"}
_OURS = re.compile(r"((bodies|surface_.*|points_.*)_\d{6,}(_\d{4,})?\.p?vtu|step_\d{6,}\.vtkhdf)(\.part)?")


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

        A rank that owns nothing of a part gives an empty `Piece` or `Cloud`, or leaves its key out.

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
        points : dict of str to Cloud
            The quadrature points of each contact pair that this rank owns.

        Raises
        ------
        ValueError
            On all ranks: on one of them an array does not fit its points or cells, or the
            ranks' arrays differ.
        OutputError
            On all ranks: one of them could not write.
        """
        grids = on_all(self.comm, grids_of, bodies, surfaces or {}, points or {})
        parts = agree(self.comm, grids)
        for key, part in parts.items():
            grid = grids.setdefault(key, vtu.no_cells())
            fill(grid.point_data, part["point_data"])
            fill(grid.cell_data, part["cell_data"])
        if not self._began:
            on_all(self.comm, self._begin)
            self._began = True
        if self._kind == "vtu":
            on_all(self.comm, self._write_pieces, step, grids, parts)
            files = {key: f"{part['file']}_{step:06d}.pvtu" for key, part in parts.items()}
        else:
            files = {None: f"step_{step:06d}.vtkhdf"}
            meshes = self._checked_meshes(grids, files[None])
            same = {key: file for key, (_, file) in meshes.items() if file != files[None]}
            write_step(self.comm, self.directory / "fields" / files[None], grids, parts, self._level, same)
            self._meshes = meshes
        on_all(self.comm, self._enter, time, parts, files)

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
        """By part, checksums of the mesh of all ranks and the file that has it, which may be an earlier one.
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
