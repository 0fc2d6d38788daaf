"""The next mesh of triangles or tetrahedra: cells cut in halves, displacements interpolated. On rank 0."""

from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.element.reference import CELLS, n_nodes
from pcontact.element.shape import shape
from pcontact.mesh.complete import complete
from pcontact.mesh.groups import RawMesh
from pcontact.mesh.reader import read_mesh
from pcontact.mesh.refine import SIMPLEX, as_raw, refine
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root


class Next(NamedTuple):
    """A mesh, and what was known on the last one.

    Attributes
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    fields : list of ndarray (n, k)
        At its nodes.
    """

    mesh: object
    fields: list


class Meshes:
    """Meshes of a scene, each made from the last one.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Valid.
    comm : MPI.Comm
    options : pcontact.runtime.options.Options

    Raises
    ------
    InputError
        Cells that cannot be cut; on every rank.
    """

    def __init__(self, scene, comm, options):
        self._scene, self._comm, self._options = scene, comm, options
        self._raw = on_root(comm, self._read)

    def _read(self):
        path = self._scene.mesh_path
        if path.suffix.lower() == ".h5":
            raise InputError(f"{path}: found a converted mesh; allowed with -error: the mesh that it was made from")
        raw = read_mesh(path)
        wrong = sorted({block.cell for block in raw.blocks} - set(SIMPLEX.values()))
        if wrong:
            raise InputError(f"{path}: found {', '.join(wrong)} cells; allowed with -error: triangles, tetrahedra")
        return raw

    def refined(self, scene, mesh, more, fields):
        """The next mesh. *Collective.*

        Parameters
        ----------
        scene : pcontact.scene.model.Scene
            That has been run on the last one.
        mesh : pcontact.mesh.mesh.Mesh
            The last one.
        more : ndarray (n_cells,) of int
            How many times each cell of this rank, block after block, is to be bisected at least.
        fields : sequence of ndarray (n_nodes, k)
            At the nodes of this rank.

        Returns
        -------
        Next
        """
        ids = np.concatenate([np.zeros(0, np.int64), *(block.ids for block in mesh.blocks)])
        more = _on_root(self._comm, ids, np.asarray(more, dtype=np.int64)[:, None], mesh.n_cells_total)
        values = [_on_root(self._comm, mesh.file_nodes, field, mesh.n_nodes_total) for field in fields]
        values = on_root(self._comm, self._cut, mesh.degree, None if more is None else more[:, 0], values)
        raw = self._raw or RawMesh(self._scene.mesh_path, mesh.dim, np.zeros((0, mesh.dim)), [])
        result = build.read(scene, self._comm, self._options, raw)
        values = self._comm.bcast(values)
        return Next(result, [value[result.file_nodes] for value in values])

    def _cut(self, degree, more, values):
        """Cut the mesh until no cell is to be cut any more; fields on the new one."""
        d = self._raw.dim
        while more.max(initial=0) > 0:
            old = self._raw
            found = refine(old, more >= d, more > 0)
            self._raw = as_raw(found, old.path)
            values = [_interpolated(old, self._raw, found, degree, value) for value in values]
            size = np.abs(np.linalg.det(found.place)) if len(found.place) else np.zeros(0)
            more = more[found.parent] + np.rint(np.log2(size)).astype(np.int64)
        return values


def _on_root(comm, numbers, values, total):
    """A table (total, k) of all rows (n, k) by their numbers, on rank 0. *Collective.*"""
    parts = comm.gather((numbers, values))
    if parts is None:
        return None
    table = np.zeros((total, values.shape[1]), dtype=values.dtype)
    for rows, own in parts:
        table[rows] = own
    return table


def _nodes(raw, degree):
    """All cells (n, n_nodes) with the nodes of a degree, and the number of these nodes."""
    layout = complete(raw, degree) if degree == 2 else raw
    cells = np.concatenate([block.nodes for block in layout.blocks])
    return cells[:, : n_nodes(SIMPLEX[raw.dim], degree)], len(layout.points)


def _interpolated(old, new, found, degree, values):
    """Values (n, k) of a field of a degree at the nodes of the new mesh."""
    kind = SIMPLEX[old.dim]
    before, after = _nodes(old, degree)[0], _nodes(new, degree)
    at = found.place
    if degree == 2:
        at = np.concatenate([at, np.stack([at[:, list(e)].mean(axis=1) for e in CELLS[kind].edges], axis=1)], axis=1)
    weights = shape(kind, degree, at.reshape(-1, at.shape[2])[:, 1:]).reshape(*at.shape[:2], -1)
    result = np.empty((after[1], values.shape[1]))
    result[after[0]] = np.matmul(weights, values[before[found.parent]])
    return result
