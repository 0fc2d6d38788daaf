"""The whole of a distributed mesh on rank 0, as if it had been read from a file: for writers, which have one
process."""

from pathlib import Path

import numpy as np

from pcontact.mesh.distribute import load_plain
from pcontact.mesh.raw import Block, RawMesh
from pcontact.mesh.refinement.refine import refine
from pcontact.mesh.refinement.split import split
from pcontact.runtime.parallel import Exchanger


def halved_where(comm, raw, marked, path, divide=False):
    """A mesh whose marked cells are cut in 4 or 8 parts or more, and others as they have to follow. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
        Its ranks cut the cells together.
    raw : pcontact.mesh.raw.RawMesh or None
        On rank 0 the mesh.
    marked : ndarray (n_cells,) of bool or None
        On rank 0 its cells.
    path : str or pathlib.Path
        For messages.
    divide : bool
        Whether cells that are no triangles or tetrahedra are divided into these first; else all are halved.

    Returns
    -------
    pcontact.mesh.raw.RawMesh or None
        On rank 0 the new mesh.
    """
    mesh, marked = load_plain(comm, raw), comm.bcast(marked)
    ids = mesh.of_cells("ids")
    more = np.where(marked[ids], mesh.dim, 0)
    if divide:
        mesh, _, more = split(mesh, cells=more)
    return gathered(refine(mesh, more).mesh, path)


def gathered(mesh, path, every=False):
    """The whole mesh on rank 0, None elsewhere; cells and nodes by their numbers. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    path : str or pathlib.Path
        For messages.
    every : bool
        Whether straight cells keep nodes in the middles of their edges, too.

    Returns
    -------
    pcontact.mesh.raw.RawMesh or None
    """
    exchanger = Exchanger(mesh.comm)
    try:
        return _gathered(exchanger, mesh, Path(path), mesh.curved or every)
    finally:
        exchanger.free()


def _on_root(exchanger, table, dtype=np.int64):
    """Rows of all ranks, on rank 0; on others none. *Collective.*"""
    parts = exchanger({0: table} if len(table) else {}, dtype, table.shape[1])
    return np.concatenate([np.zeros((0, table.shape[1]), dtype=dtype), *parts.values()])


def _gathered(exchanger, mesh, path, every):
    degree, points = mesh.degree if every else 1, np.zeros((mesh.n_nodes_total, mesh.dim))
    numbers = _on_root(exchanger, mesh.file_nodes[:, None])[:, 0]
    places = _on_root(exchanger, mesh.points, np.float64)
    if len(numbers):
        points[numbers] = places
    tables = {}
    for block in mesh.blocks:
        nodes = block.nodes if every else mesh.geometry_nodes(block)[0]
        rows = _on_root(exchanger, np.column_stack([block.ids, mesh.file_nodes[nodes]]))
        tables.setdefault(block.cell, []).append(rows)
    tables = {cell: np.concatenate(parts) for cell, parts in tables.items()}
    tables = {cell: rows[np.argsort(rows[:, 0])] for cell, rows in tables.items()}
    groups = [{name: _on_root(exchanger, rows) for name, rows in one.items()} for one in _members(mesh)]
    if mesh.comm.rank:
        return None
    cells = sorted(tables, key=lambda cell: tables[cell][0, 0] if len(tables[cell]) else 0)
    ids = np.concatenate([tables[cell][:, 0] for cell in cells])
    place = np.empty(mesh.n_cells_total, dtype=np.int64)
    place[ids] = np.arange(len(ids))
    used = np.zeros(len(points), dtype=bool)
    for cell in cells:
        used[tables[cell][:, 1:].ravel()] = True
    number = np.cumsum(used) - 1
    raw = RawMesh(path, mesh.dim, points[used], [Block(c, degree, number[tables[c][:, 1:]]) for c in cells])
    raw.cell_groups = {name: np.sort(place[rows[:, 0]]) for name, rows in groups[0].items()}
    for name, rows in groups[1].items():
        pairs = np.unique(place[rows[:, 0]] * 8 + rows[:, 1])
        raw.facet_groups[name] = pairs // 8, pairs % 8
    raw.node_groups = {name: np.unique(number[rows[used[rows[:, 0]], 0]]) for name, rows in groups[2].items()}
    raw.edge_groups = {name: np.unique(np.sort(number[rows], axis=1), axis=0) for name, rows in groups[3].items()}
    return raw


def _members(mesh):
    """Members of groups of cells, facets (cells, local facets), nodes and edges on this rank, by their numbers."""
    ids, none = [block.ids for block in mesh.blocks], np.zeros((0, 2), np.int64)
    cells = {name: np.concatenate([own[rows] for own, rows in zip(ids, parts, strict=True)])[:, None]
             for name, parts in mesh.cell_groups.items()}  # fmt: skip
    facets = {name: np.concatenate([none, *(np.column_stack([ids[f.block][f.cells], f.local]) for f in parts)])
              for name, parts in mesh.facet_groups.items()}  # fmt: skip
    nodes = {name: mesh.file_nodes[nodes][:, None] for name, nodes in mesh.node_groups.items()}
    return cells, facets, nodes, mesh.edge_groups
