"""Parts of a mesh by PETSc's graph partitioners with weights, which petsc4py does not pass on."""

import ctypes

import numpy as np

from pcontact.element.reference import facet_nodes
from pcontact.mesh.plex import taken_parts
from pcontact.mesh.slices import MeshSlice
from pcontact.runtime.petsc import PETSc, call, handle, reset_partitioner, version


def neighbours(piece: MeshSlice) -> tuple[np.ndarray, np.ndarray]:
    """The graph of the cells that share a facet: offsets (n + 1,) and neighbours (m,), of PETSc's integers."""
    rows, corners = [], []
    for block, first in zip(piece.blocks, piece.starts[:-1], strict=True):
        local = facet_nodes(block.cell, 1)
        table = np.sort(block.nodes[:, local], axis=2)
        rows.append(np.repeat(first + np.arange(len(block.nodes)), len(local)))
        corners.append(table.reshape(-1, local.shape[1]))
    rows, corners = np.concatenate(rows), np.concatenate(corners)
    order = np.lexsort(corners.T)
    same = np.flatnonzero(np.all(corners[order[1:]] == corners[order[:-1]], axis=1))
    a, b = rows[order[same]], rows[order[same + 1]]
    pairs = np.concatenate([np.column_stack([a, b]), np.column_stack([b, a])])
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    offsets = np.searchsorted(pairs[:, 0], np.arange(len(piece.ids) + 1))
    return offsets.astype(PETSc.IntType), np.ascontiguousarray(pairs[:, 1], dtype=PETSc.IntType)


def graph_parts(piece: MeshSlice, count: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Part of every cell by the partitioner that ``-petscpartitioner_type`` says, PT-Scotch by default.

    Parameters
    ----------
    piece : MeshSlice
        On one rank.
    count : int
        Parts.
    weights : ndarray (n,) of int, optional
        Of the cells; all alike if absent.
    """
    comm, n = piece.comm, len(piece.ids)
    offsets, columns = neighbours(piece)
    section, found = PETSc.Section().create(comm), PETSc.Section().create(comm)
    section.setChart(0, n)
    for cell, weight in enumerate(np.ones(n, dtype=int) if weights is None else weights):
        section.setDof(cell, int(weight))
    section.setUp()
    partitioner = PETSc.Partitioner().create(comm)
    partitioner.setType("ptscotch")
    reset_partitioner()
    partitioner.setFromOptions()
    partitioner.setUp()
    cells, sections = ctypes.c_void_p(), [handle(section)] if version < (3, 21) else [handle(section), None]
    call("PetscPartitionerPartition", handle(partitioner), count, n, offsets, columns, *sections, None, handle(found),
         ctypes.byref(cells))  # fmt: skip
    result = taken_parts(found, cells, n)
    for thing in (section, partitioner):
        thing.destroy()
    return result
