"""Fields for ParaView: every rank writes its own piece, rank 0 the few lines that hold them together.

In the output directory::

    fields.pvd                          all times, three groups of parts: bodies, surfaces, points
                                        (the first time, step 0: the undeformed bodies)
    fields/bodies_000001.pvtu           the bodies at step 1, and
    fields/bodies_000001_0000.vtu       rank 0's piece of them
    fields/surface_NAME_000001.pvtu     the facets of one contact pair
    fields/points_NAME_000001.pvtu      the quadrature points of one contact pair
"""

import re
from pathlib import Path

from pcontact.io import vtu
from pcontact.io.parts import agree, fill, grids_of, on_all
from pcontact.io.vtkhdf import NAME
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import going_on, make_directory, telling
from pcontact.runtime.parallel import on_root

INDEX = "fields.pvd"
_OURS = re.compile(r"(bodies|surface_.*|points_.*)_\d{6,}(_\d{4,})?\.p?vtu(\.part)?")


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
    """

    def __init__(self, directory, comm, resume_time=None):
        self.directory = Path(directory)
        self.comm = comm
        if resume_time is not None:
            on_root(comm, other_format, self.directory, INDEX, NAME)
        self._kept = None if resume_time is None else on_root(comm, self._take_up, resume_time)
        self._began = False

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
        if not self._began:
            on_all(self.comm, self._begin)
            self._began = True
        on_all(self.comm, self._write_pieces, step, grids, parts)
        on_all(self.comm, self._write_index, step, time, parts)

    def _take_up(self, resume_time):
        """Entries of the earlier run up to a time; None if there are no fields."""
        index, limit = self.directory / INDEX, resume_time + 1e-10 * abs(resume_time)
        if not index.exists():
            return None
        with going_on(index):
            return [entry for entry in vtu.read_pvd(index) if float(entry["timestep"]) <= limit]

    def _begin(self):
        """Make the directory, clear away what an earlier run left, keep what this run continues."""
        if self.comm.rank != 0:
            return
        if self._kept is None:
            clear(self.directory)
        make_directory(self.directory / "fields")
        vtu.write_pvd(self.directory / INDEX, self._kept or [])

    def _write_pieces(self, step, grids, parts):
        """This rank's file of each part of which it owns something."""
        for key, part in parts.items():
            if self.comm.rank in part["ranks"]:
                grid = grids.get(key) or vtu.no_cells()
                fill(grid.point_data, part["point_data"])
                fill(grid.cell_data, part["cell_data"])
                file = f"{part['file']}_{step:06d}_{self.comm.rank:04d}.vtu"
                vtu.write_vtu(self.directory / "fields" / file, grid)

    def _write_index(self, step, time, parts):
        """Rank 0: the .pvtu of each part, then the collection, which is whole after every step."""
        if self.comm.rank != 0:
            return
        entries = []
        for number, ((group, name), part) in enumerate(parts.items()):
            file = f"{part['file']}_{step:06d}"
            vtu.write_pvtu(
                self.directory / "fields" / f"{file}.pvtu", part["point_data"], part["cell_data"],
                [f"{file}_{rank:04d}.vtu" for rank in part["ranks"]],
            )  # fmt: skip
            entries.append({
                "timestep": repr(float(time)), "group": group, "part": number,
                "name": f"{group}: {name}" if name else group, "file": f"fields/{file}.pvtu",
            })  # fmt: skip
        vtu.add_to_pvd(self.directory / INDEX, entries)


def clear(directory):
    """Take away the fields that an earlier run left, in both formats.

    Raises
    ------
    OutputError
    """
    folder = directory / "fields"
    with telling(folder):
        for name in (INDEX, NAME, f"{NAME}.redo"):
            (directory / name).unlink(missing_ok=True)
        if folder.is_dir():
            for path in folder.iterdir():
                if _OURS.fullmatch(path.name):
                    path.unlink()
            if not any(folder.iterdir()):
                folder.rmdir()


def other_format(directory, ours, theirs):
    """Refuse to go on with fields of the other format, of which a reader would find both.

    Raises
    ------
    InputError
    """
    if (directory / theirs).exists() and not (directory / ours).exists():
        raise InputError(
            f"{directory / theirs}: found fields of the other format; allowed: the [output] format of the run before, "
            "or another -o"
        )
