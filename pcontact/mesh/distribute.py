"""From the raw mesh on rank 0 to one :class:`Mesh` per rank."""

from collections.abc import Iterable

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.mesh import CellBlock, Facets, Mesh
from pcontact.mesh.partition import partition
from pcontact.runtime import profile


def _morton(points):
    """Order of points (n, d) along a Z curve: neighbours in space become neighbours in memory."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    d = points.shape[1]
    low, high = points.min(axis=0), points.max(axis=0)
    bits = 62 // d if d == 2 else 20
    span = np.where(high > low, high - low, 1.0)
    cells = ((points - low) / span * (2**bits - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(bits):
        for axis in range(d):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(bit * d + axis)
    return np.argsort(key, kind="stable")


def _cell_tables(raw, body_of_cell):
    """(cell name, body) of every block to make, the same on all ranks, and the block of every cell."""
    kinds, block_of_cell, first = [], [], 0
    for block in raw.blocks:
        bodies = body_of_cell[first : first + len(block.nodes)]
        first += len(block.nodes)
        numbers = np.empty(len(bodies), dtype=np.int64)
        for body in np.unique(bodies):
            key = (block.cell, int(body))
            if key not in kinds:
                kinds.append(key)
            numbers[bodies == body] = kinds.index(key)
        block_of_cell.append(numbers)
    return kinds, np.concatenate(block_of_cell)


def _pieces(raw, body_of_cell, component, rank_of_cell, size):
    """What each rank is to get, one dictionary after the other (on rank 0): only one of them is in memory at a time."""
    kinds, block_of_cell = _cell_tables(raw, body_of_cell)
    offsets = np.cumsum([0] + [len(b.nodes) for b in raw.blocks])
    sorted_cells = []
    for block, first in zip(raw.blocks, offsets[:-1], strict=True):
        ids = np.arange(first, first + len(block.nodes))
        for number in np.unique(block_of_cell[ids]):
            chosen = ids[block_of_cell[ids] == number]
            sorted_cells.append((block, first, number, *_by_rank(chosen, rank_of_cell, size)))
    facets = {name: (*group, *_by_rank(group[0], rank_of_cell, size)[1:]) for name, group in raw.facet_groups.items()}
    groups = {name: _by_rank(cells, rank_of_cell, size) for name, cells in raw.cell_groups.items()}
    del block_of_cell
    for rank in range(size):
        blocks = [[] for _ in kinds]
        for block, first, number, chosen, order, cuts in sorted_cells:
            part = chosen[order[cuts[rank] : cuts[rank + 1]]]
            blocks[number].append((block.nodes[part - first], part, component[part]))
        piece = {"kinds": kinds, "facets": {}, "cells": {}}
        for name, (cells, local, order, cuts) in facets.items():
            mine = order[cuts[rank] : cuts[rank + 1]]
            piece["facets"][name] = cells[mine], local[mine]
        for name, (cells, order, cuts) in groups.items():
            piece["cells"][name] = cells[order[cuts[rank] : cuts[rank + 1]]]
        piece["blocks"] = [_join(parts, *kind, raw) for parts, kind in zip(blocks, kinds, strict=True)]
        nodes = np.unique(np.concatenate([b[0].ravel() for b in piece["blocks"]]))
        piece["nodes"], piece["points"] = nodes, raw.points[nodes]
        piece["node_groups"] = {name: group[np.isin(group, nodes)] for name, group in raw.node_groups.items()}
        yield piece


def _by_rank(cells, rank_of_cell, size):
    """Cells, the order that sorts them by rank (and keeps them in order within), where each rank begins in it."""
    ranks = rank_of_cell[cells]
    order = np.argsort(ranks, kind="stable")
    return cells, order, np.searchsorted(ranks[order], np.arange(size + 1))


def _join(parts, cell, body, raw):
    width = next(b.nodes.shape[1] for b in raw.blocks if b.cell == cell)
    nodes = [p[0] for p in parts] or [np.zeros((0, width), dtype=np.int64)]
    ids = [p[1] for p in parts] or [np.zeros(0, dtype=np.int64)]
    components = [p[2] for p in parts] or [np.zeros(0, dtype=np.int64)]
    return np.concatenate(nodes), np.concatenate(ids), np.concatenate(components)


def _build_blocks(piece, points):
    """Blocks with local node numbers; cells along a Z curve, nodes in the order in which cells meet them."""
    blocks, seen = [], []
    for (cell, body), (nodes, ids, components) in zip(piece["kinds"], piece["blocks"], strict=True):
        local = np.searchsorted(piece["nodes"], nodes)
        centre = points[local[:, : CELLS[cell].n_vertices]].mean(axis=1) if len(local) else np.zeros((0, 1))
        order = _morton(centre)
        blocks.append(CellBlock(cell, body, local[order], ids[order], components[order]))
        seen.append(local[order].ravel())
    nodes, first = np.unique(np.concatenate(seen), return_index=True)
    order = nodes[np.argsort(first, kind="stable")]
    new = np.empty(len(order), dtype=np.int64)
    new[order] = np.arange(len(order))
    for block in blocks:
        block.nodes = np.ascontiguousarray(new[block.nodes])
    return blocks, order, new


def _locate(blocks, ids):
    """Block and row of global cell ids that are on this rank."""
    every = np.concatenate([b.ids for b in blocks])
    number = np.concatenate([np.full(len(b.ids), k) for k, b in enumerate(blocks)])
    row = np.concatenate([np.arange(len(b.ids)) for b in blocks])
    order = np.argsort(every, kind="stable")
    at = order[np.searchsorted(every, ids, sorter=order)] if len(ids) else np.zeros(0, dtype=np.int64)
    return number[at], row[at]


def _deal(comm, raw, curved, body_of_cell, component, ranks):
    """The piece of this rank. *Collective.*"""
    if comm.rank != 0:
        return comm.recv(source=0)
    head = {
        "dim": raw.dim,
        "degree": raw.blocks[0].degree,
        "curved": bool(curved),
        "n_nodes_total": len(raw.points),
        "n_cells_total": len(body_of_cell),
        "n_components": int(component.max()) + 1 if len(component) else 0,
    }
    own = None
    for rank, piece in enumerate(_pieces(raw, body_of_cell, component, ranks, comm.size)):
        piece["head"] = head
        if rank == 0:
            own = piece
        else:
            comm.send(piece, dest=rank)
            profile.sent(1, _size(piece))
    return own


def _size(piece):
    """Bytes of the arrays in nested dictionaries, lists and tuples."""
    if isinstance(piece, np.ndarray):
        return piece.nbytes
    if isinstance(piece, dict):
        piece = piece.values()
    return sum(_size(part) for part in piece) if isinstance(piece, Iterable) and not isinstance(piece, str) else 0


def distribute(comm, raw, curved, body_of_cell, component, extra_weight=None):
    """Partition the raw mesh and give every rank its part. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    raw : RawMesh or None
        On rank 0: all blocks of one degree.
    curved : bool or None
        On rank 0: whether the geometry is of second order.
    body_of_cell, component : ndarray (n_cells,) or None
        On rank 0: body number in the scene, and connected component.
    extra_weight : ndarray (n_cells,), optional
        On rank 0: see :func:`pcontact.mesh.partition.partition`.

    Returns
    -------
    Mesh
    """
    ranks = partition(comm, raw, extra_weight)
    piece = _deal(comm, raw, curved, body_of_cell, component, ranks)
    blocks, order, new = _build_blocks(piece, piece["points"])
    mesh = Mesh(
        comm=comm,
        points=np.ascontiguousarray(piece["points"][order]),
        file_nodes=piece["nodes"][order],
        blocks=blocks,
        **piece["head"],
    )
    for name, (cells, local) in piece["facets"].items():
        number, row = _locate(blocks, cells)
        mesh.facet_groups[name] = [
            Facets(k, row[number == k], local[number == k]) for k in range(len(blocks)) if np.any(number == k)
        ]
    for name, cells in piece["cells"].items():
        number, row = _locate(blocks, cells)
        mesh.cell_groups[name] = [row[number == k] for k in range(len(blocks))]
    for name, group in piece["node_groups"].items():
        mesh.node_groups[name] = new[np.searchsorted(piece["nodes"], group)]
    return mesh
