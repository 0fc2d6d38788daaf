"""Reading of what `pcontact convert` writes: every rank takes a part, and no rank has the whole mesh."""

from bisect import bisect_left
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from pcontact.element.reference import CELLS, SERENDIPITY, n_nodes
from pcontact.mesh.hdf5_writer import FORMAT, SUFFIX, VERSION
from pcontact.mesh.plex_reader import is_petsc_file
from pcontact.mesh.slices import MeshSlice, SliceBlock
from pcontact.runtime.checksum import Damaged, verify
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import together

MADE = "a file made by pcontact convert"


def is_converted(path):
    """Whether a mesh is a converted one, by its name and as it is none of PETSc's."""
    return Path(path).suffix.lower() == SUFFIX and not is_petsc_file(path)


@dataclass
class Summary:
    """What a scene is checked against: sizes of the groups in place of their members.

    Attributes
    ----------
    path : pathlib.Path
    dim : int
    points : ndarray (n, d)
        Those with the least and the largest coordinates of every rank, and all with x < 0.
    cell_groups, facet_groups, node_groups : dict of str to int
    common : dict of (str, str) to int
        Facets that two surfaces have both.
    lost : dict of str to str
        Groups that cannot be used, and why.
    """

    path: Path
    dim: int
    points: np.ndarray
    cell_groups: dict
    facet_groups: dict
    node_groups: dict
    common: dict
    lost: dict


def _open(path):
    try:
        with open(path, "rb"):
            pass
        file = h5py.File(path, "r")
    except OSError as error:
        plain = (error.strerror or "").lower()
        if "truncated" in str(error):
            raise InputError(f"{path}: found a file that is cut short; allowed: {MADE}, all of it") from None
        found = plain if plain and "signature" not in str(error) else "a file that is not HDF5"
        raise InputError(f"{path}: found {found}; allowed: {MADE}") from None
    kind, version = file.attrs.get("format"), file.attrs.get("version")
    message = None
    if kind != FORMAT:
        message = "found HDF5 of another kind"
    elif version != VERSION:
        message = f"found version {version} of the format; allowed: version {VERSION}, convert the mesh again"
    elif "complete" not in file.attrs:
        message = "found a file that is cut short"
    if message is not None:
        file.close()
        raise InputError(f"{path}: {message}" + ("" if "allowed" in message else f"; allowed: {MADE}"))
    return file


def _share(total, comm):
    """First of each rank's share (size + 1,), as even as can be."""
    return np.arange(comm.size + 1, dtype=np.int64) * total // comm.size


def _groups(file, kind, column):
    """Name, group and number of entries of all groups of a kind."""
    groups = file[f"groups/{kind}"]
    for k in range(len(groups)):
        group = groups[str(k)]
        yield group.attrs["name"], group, len(group[column])


def _members(group, column, first, end):
    """Rows of a group whose (ascending) entries are from first to end - 1, as a slice."""
    return slice(bisect_left(group[column], first), bisect_left(group[column], end))


class ConvertedMesh:
    """A converted mesh, of which this rank has a slice.

    Parameters
    ----------
    comm : MPI.Comm
    path : str or pathlib.Path
    order : int or None
        Degree of the displacement; None: that of the mesh.
    serendipity : bool
        Quadrilaterals and hexahedra of degree 2 have no nodes in the middles of faces and cells.

    Attributes
    ----------
    piece : MeshSlice
        Without bodies.
    lost : dict of str to str
        Groups that cannot be used, and why, see `pcontact.mesh.groups.RawMesh`.

    Raises
    ------
    InputError
        On every rank. The constructor is *Collective*.
    """

    def __init__(self, comm, path, order, serendipity=False):
        self.comm, self.path, self._cells = comm, Path(path), SERENDIPITY if serendipity else {}
        # each rank a part of the file, before HDF5 makes anything of what it finds
        summed = together(comm, self._verify)
        self.piece = together(comm, self._read, order, summed)

    def _verify(self):
        """Whether the file has checksums, which this rank's part of it meets."""
        try:
            return verify(self.path, self.comm.rank, self.comm.size)
        except Damaged as error:
            raise self._damaged(error) from None
        except OSError:
            # that it cannot be read is told when it is opened
            return False

    def _damaged(self, reason):
        return InputError(f"{self.path}: found a damaged file ({' '.join(str(reason).split())}); allowed: {MADE}")

    def _read(self, order, summed):
        with _open(self.path) as file:
            # files of earlier versions of the program have none
            if "checksums" in file.attrs and not summed:
                raise self._damaged("without its checksums")
            try:
                return self._slice(file, order)
            except InputError:
                raise
            except Exception as error:  # HDF5 has many words for what it cannot read
                raise self._damaged(error) from None

    def _slice(self, file, order):
        comm, head = self.comm, file.attrs
        if order == 2 and head["degree"] == 1:
            raise InputError(
                f"{self.path}: found cells of degree 1 and a displacement of degree 2; "
                f"allowed: order 1, or a file made by pcontact convert --order 2"
            )
        degree = order if order is not None and not head["curved"] else int(head["degree"])
        starts, shares = _share(int(head["cells"]), comm), _share(int(head["nodes"]), comm)
        self._first, end = int(starts[comm.rank]), int(starts[comm.rank + 1])
        low, high = int(shares[comm.rank]), int(shares[comm.rank + 1])
        blocks, at = [], 0
        for k in range(len(file["blocks"])):
            table = file[f"blocks/{k}"]
            cell = self._cells.get(table.attrs["cell"], table.attrs["cell"])
            a, b = (min(max(x - at, 0), len(table)) for x in (self._first, end))
            blocks.append(SliceBlock(cell, table[a:b, : n_nodes(cell, degree)].astype(np.int64)))
            at += len(table)
        cells = file["cells"]
        piece = MeshSlice(
            comm, self.path, int(head["dim"]), degree, bool(head["curved"]), blocks,
            cells["ids"][self._first : end].astype(np.int64), np.zeros(end - self._first, dtype=np.int64),
            cells["components"][self._first : end].astype(np.int64), file["points"][low:high], shares,
            int(head["nodes"]), int(head["cells"]), int(head["components"]),
            node_ids=file["node_ids"][low:high].astype(np.int64),
        )  # fmt: skip
        self._read_groups(file, piece, end, low, high)
        return piece

    def _read_groups(self, file, piece, end, low, high):
        self._sizes, self.between = {"cells": {}, "facets": {}, "nodes": {}}, {}
        for name, group, size in _groups(file, "cells", "cells"):
            mine = _members(group, "cells", self._first, end)
            piece.cell_groups[name] = group["cells"][mine].astype(np.int64) - self._first
            self._sizes["cells"][name] = size
        for name, group, size in _groups(file, "facets", "cells"):
            mine = _members(group, "cells", self._first, end)
            rows = group["cells"][mine].astype(np.int64) - self._first
            piece.facet_groups[name] = rows, group["local"][mine].astype(np.int64)
            self.between[name] = group["between"][mine] > 0
            self._sizes["facets"][name] = size
        self.lost = {g.attrs["name"]: g.attrs["found"] for g in file.get("groups/lost", {}).values()}
        for name, group, size in _groups(file, "nodes", "nodes"):
            mine = _members(group, "nodes", low, high)
            piece.node_groups[name] = group["nodes"][mine].astype(np.int64) - low
            self._sizes["nodes"][name] = size
        for name, group, size in _groups(file, "edges", "nodes"):
            mine = slice(*(size * (self.comm.rank + k) // self.comm.size for k in range(2)))
            ends, number = np.unique(group["nodes"][mine], return_inverse=True)
            ids = file["node_ids"][ends] if len(ends) else ends
            piece.edge_groups[name] = np.asarray(ids).astype(np.int64)[number.reshape(-1, 2)]

    def summary(self, pairs):
        """What a scene is checked against. *Collective.*

        Parameters
        ----------
        pairs : list of (str, str or None, float or None)
            Source and target surfaces.

        Returns
        -------
        Summary
        """
        comm, x = self.comm, self.piece.points
        kept = np.zeros(len(x), dtype=bool)
        if len(x):
            kept = x[:, 0] < 0.0
            kept[[np.argmin(x[:, 0]), np.argmax(x[:, 0])]] = True
        common, groups = {}, self.piece.facet_groups
        for source, target, _ in pairs:
            if target not in (None, source) and source in groups and target in groups:
                a, b = (rows * 8 + local for rows, local in (groups[source], groups[target]))
                common[source, target] = comm.allreduce(len(np.intersect1d(a, b)))
        points = np.concatenate(comm.allgather(x[kept]))
        return Summary(self.path, self.piece.dim, points, *self._sizes.values(), common, self.lost)

    def named(self, row):
        """A cell of this rank in the words of a message."""
        number = int(np.searchsorted(self.piece.starts, row, side="right")) - 1
        block = self.piece.blocks[number]
        vertices = block.nodes[row - self.piece.starts[number], : CELLS[block.cell].n_vertices]
        with _open(self.path) as file:
            order = np.argsort(vertices)
            centre = file["points"][vertices[order]].mean(axis=0)
            tag = file["cells/tags"][self._first + row]
        return f"cell {tag} ({block.cell} at ({', '.join(f'{x:g}' for x in centre)}))"
