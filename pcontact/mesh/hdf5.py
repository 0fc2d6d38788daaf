"""The form that `pcontact convert` writes and runs read: a mesh of any format, checked and ordered, as one HDF5 file.

Every rank reads a part, and no rank has the whole mesh.

The layout is described in docs/files.md.
"""

from bisect import bisect_left
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from pcontact.element.reference import CELLS, SERENDIPITY, n_nodes
from pcontact.mesh.mesh import as_met, z_order
from pcontact.mesh.plex import is_petsc_file
from pcontact.mesh.raw import facet_multiplicity, raised, say_lost
from pcontact.mesh.read import read_mesh
from pcontact.mesh.slices import MeshSlice, SliceBlock
from pcontact.mesh.topology import components
from pcontact.runtime.errors import InputError, coordinates
from pcontact.runtime.files import Damaged, Hdf5Aside, reading, verify
from pcontact.runtime.parallel import together

FORMAT, VERSION = "pcontact mesh", 1
SUFFIX = ".h5"
MADE = "a file made by pcontact convert"
DAMAGED = f"found a damaged file ({{reason}}); allowed: {MADE}"


def _small(numbers):
    """Whole numbers in 32 bits where these do."""
    numbers = np.asarray(numbers)
    fits = numbers.size == 0 or (-(2**31) <= numbers.min() and numbers.max() < 2**31)
    return numbers.astype(np.int32) if fits else numbers.astype(np.int64)


def _inverse(order):
    out = np.empty(len(order), dtype=np.int64)
    out[order] = np.arange(len(order))
    return out


def _ordered(raw):
    """Cells along a Z curve, block by block, and nodes as they meet them.

    Returns
    -------
    tables : list of ndarray
        Nodes by their places in the file.
    cells, nodes : ndarray
        Numbers in ``raw`` of the cells and nodes in the order of the file.
    """
    tables, cells = [], []
    for block, first in zip(raw.blocks, raw.offsets[:-1], strict=True):
        order = z_order(raw.points[block.nodes[:, : CELLS[block.cell].n_vertices]].mean(axis=1))
        tables.append(np.ascontiguousarray(block.nodes[order]))
        cells.append(first + order)
    nodes, _ = as_met(tables, len(raw.points))
    return tables, np.concatenate(cells), nodes


def _write_groups(file, raw, cell_at, node_at):
    """Groups by the places of their cells and nodes, ascending."""

    def make(kind, number, name, **columns):
        group = file.create_group(f"groups/{kind}/{number}")
        group.attrs["name"] = name
        for key, values in columns.items():
            group.create_dataset(key, data=values)

    for kind in ("cells", "facets", "nodes", "edges"):
        file.create_group(f"groups/{kind}")
    for k, (name, cells) in enumerate(raw.cell_groups.items()):
        make("cells", k, name, cells=_small(np.sort(cell_at[cells])))
    for k, (name, (cells, local)) in enumerate(raw.facet_groups.items()):
        order = np.lexsort((local, cell_at[cells]))
        between = facet_multiplicity(raw, cells, local) > 1
        make("facets", k, name, cells=_small(cell_at[cells][order]), local=local[order].astype(np.int8),
             between=between[order].astype(np.int8))  # fmt: skip
    for k, (name, nodes) in enumerate(raw.node_groups.items()):
        make("nodes", k, name, nodes=_small(np.sort(node_at[nodes])))
    for k, (name, edges) in enumerate(raw.edge_groups.items()):
        make("edges", k, name, nodes=_small(node_at[edges]))
    for k, (name, why) in enumerate(raw.lost.items()):
        make("lost", k, name)
        file[f"groups/lost/{k}"].attrs["found"] = why


def _write(file, raw, curved):
    component = components(raw)
    tables, cells, nodes = _ordered(raw)
    file.attrs.update(
        format=FORMAT, version=VERSION, dim=raw.dim, degree=raw.blocks[0].degree, curved=int(curved),
        components=int(component.max()) + 1, cells=len(cells), nodes=len(nodes), source=raw.path.name, checksums=1,
    )  # fmt: skip
    file.create_dataset("points", data=raw.points[nodes])
    file.create_dataset("node_ids", data=_small(nodes))
    file.create_dataset("cells/ids", data=_small(cells))
    tags = np.arange(1, len(cells) + 1) if raw.tags is None else raw.tags
    file.create_dataset("cells/tags", data=_small(tags[cells]))
    file.create_dataset("cells/components", data=_small(component[cells]))
    for k, (block, table) in enumerate(zip(raw.blocks, tables, strict=True)):
        file.create_dataset(f"blocks/{k}", data=_small(table)).attrs["cell"] = block.cell
    _write_groups(file, raw, _inverse(cells), _inverse(nodes))
    # the last thing to be written: a file without it is cut short
    file.attrs["complete"] = 1


def mesh_sizes(raw):
    """Return the contents of a mesh in the words of a message."""
    kinds = ", ".join(f"{len(block.nodes)} cells ({block.cell})" for block in raw.blocks)
    groups = len({*raw.cell_groups, *raw.facet_groups, *raw.node_groups})
    return f"{len(raw.points)} nodes, {kinds}, degree {raw.blocks[0].degree}, {groups} groups"


def convert(path, target=None, order=1, writer=None):
    """Read a mesh, check it, and write it as HDF5.

    Parameters
    ----------
    path : str or pathlib.Path
    target : str or pathlib.Path, optional
        Beside the mesh if absent.
    order : int
        2: cells are completed to degree 2, for a displacement of that degree.
    writer : callable, optional
        Absent: :func:`write`.

    Returns
    -------
    target : pathlib.Path
    raw : RawMesh
        What was written.

    Raises
    ------
    InputError, OutputError
    """
    path = Path(path)
    target = path.with_suffix(SUFFIX) if target is None else Path(target)
    if target.suffix.lower() != SUFFIX:
        raise InputError(f"command line: -o: found {str(target)!r}; allowed: a name that ends with {SUFFIX}")
    if path.suffix.lower() == SUFFIX and (target.resolve() == path.resolve() or not is_petsc_file(path)):
        raise InputError(f"{path}: found a file that ends with {SUFFIX}; allowed: the mesh that it was made from")
    raw = read_mesh(path)
    say_lost(path, raw.lost)
    return target, (writer or write)(target, raw, order)


def write(target, raw, order=1, curved=None):
    """Write a mesh that has been read, and return it as it was written; parameters as of :func:`convert`, and whether
    its cells are curved: absent, as those of a file of degree 2."""
    raw, by_degree = raised(raw, order)
    aside = Hdf5Aside(target, "-o")
    try:
        _write(aside.file, raw, by_degree if curved is None else curved)
        aside.place()
    finally:
        aside.discard()
    return raw


def is_converted(path):
    """Return whether a mesh is a converted one, by its name and as it is none of PETSc's."""
    return Path(path).suffix.lower() == SUFFIX and not is_petsc_file(path)


@dataclass
class Summary:
    """Mesh as a scene is checked against it: sizes of the groups in place of their members.

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
    parts : pcontact.mesh.parts.PartMesh, optional
        Where groups can be made by place.
    """

    path: Path
    dim: int
    points: np.ndarray
    cell_groups: dict
    facet_groups: dict
    node_groups: dict
    common: dict
    lost: dict
    parts: object = None


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
        Groups that cannot be used, and why, see `pcontact.mesh.raw.RawMesh`.

    Raises
    ------
    InputError
        On every rank. The constructor is *Collective*.
    """

    def __init__(self, comm, path, order, serendipity=False):
        self.comm, self.path, self._cells = comm, Path(path), SERENDIPITY if serendipity else {}
        # each rank a part of the file, before HDF5 makes anything of what it finds
        summed = together(comm, self._verify)
        self.held = self.piece = together(comm, self._read, order, summed)

    def _verify(self):
        """Return whether the file has checksums, which this rank's part of it meets."""
        try:
            return verify(self.path, self.comm.rank, self.comm.size)
        except Damaged as error:
            raise self._damaged(error) from None
        except OSError:
            # that it cannot be read is told when it is opened
            return False

    def _damaged(self, reason):
        return InputError(f"{self.path}: {DAMAGED.format(reason=reason)}")

    def _read(self, order, summed):
        with _open(self.path) as file:
            # files of earlier versions of the program have none
            if "checksums" in file.attrs and not summed:
                raise self._damaged("without its checksums")
            with reading(self.path, DAMAGED):
                return self._slice(file, order)

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
        """Return what a scene is checked against. *Collective.*

        Parameters
        ----------
        pairs : list of (str, str or None, float or None)
            Source and target surfaces.

        Returns
        -------
        Summary
        """
        comm, x = self.comm, self.held.points
        kept = np.zeros(len(x), dtype=bool)
        if len(x):
            kept = x[:, 0] < 0.0
            kept[[*np.argmin(x, axis=0), *np.argmax(x, axis=0)]] = True
        common, groups = {}, self.held.facet_groups
        for source, target, _ in pairs:
            if target not in (None, source) and source in groups and target in groups:
                a, b = (rows * 8 + local for rows, local in (groups[source], groups[target]))
                common[source, target] = comm.allreduce(len(np.intersect1d(a, b)))
        points = np.concatenate(comm.allgather(x[kept]))
        return Summary(self.path, self.held.dim, points, *self._sizes.values(), common, self.lost)

    def named(self, row):
        """A cell of this rank in the words of a message."""
        number = int(np.searchsorted(self.piece.starts, row, side="right")) - 1
        block = self.piece.blocks[number]
        vertices = block.nodes[row - self.piece.starts[number], : CELLS[block.cell].n_vertices]
        with _open(self.path) as file:
            order = np.argsort(vertices)
            centre = file["points"][vertices[order]].mean(axis=0)
            tag = file["cells/tags"][self._first + row]
        return f"cell {tag} ({block.cell} at {coordinates(centre)})"
