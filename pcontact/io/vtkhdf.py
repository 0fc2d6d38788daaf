"""A load step in VTK's HDF5 format: bodies, facets and points of all ranks in one file, which VTK and ParaView read.

Rank 0 writes what the others hand to it, one after the other. A mesh that is the same as in the step before is not
written again: the file has links to that of the step which has it.
"""

import re

import h5py
import numpy as np

from pcontact.io import vtu
from pcontact.runtime.files import Hdf5Aside
from pcontact.runtime.parallel import aside_of_root, write_rows

ROOT, VERSION = "VTKHDF", (2, 1)
_MESH = ("Points", "Connectivity", "Offsets", "Types")


def write_step(comm, path, grids, parts, level=0, meshes=None):
    """Write the file of a load step. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    path : pathlib.Path
    grids : dict of (str, str) to pcontact.io.vtu.Grid
        This rank's part of each, with all of its arrays.
    parts : dict of (str, str) to dict
        See :func:`pcontact.io.parts.agree`.
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
