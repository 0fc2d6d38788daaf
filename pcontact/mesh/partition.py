"""Which rank gets which cell."""

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.runtime.petsc import MPI, PETSc, has_package, reset_partitioner


def centroids(raw):
    """Mean of each cell's vertices, shape (n_cells, d)."""
    parts = [raw.points[b.nodes[:, : CELLS[b.cell].n_vertices]].mean(axis=1) for b in raw.blocks]
    return np.concatenate(parts)


def bisect(points, weights, count):
    """Weighted recursive coordinate bisection.

    Cuts the longest extent at the weighted median until there are ``count`` parts. It sees only coordinates, so cells
    of two bodies that face each other tend to share a part.

    Parameters
    ----------
    points : ndarray (n, d)
    weights : ndarray (n,)
    count : int

    Returns
    -------
    ndarray (n,) of int
        Part of each point, 0 to count - 1.
    """
    part = np.zeros(len(points), dtype=np.int64)
    todo = [(np.arange(len(points)), 0, count)]
    while todo:
        index, first, parts = todo.pop()
        part[index] = first
        if parts == 1 or len(index) == 0:
            continue
        left = parts // 2
        x = points[index]
        axis = int(np.argmax(x.max(axis=0) - x.min(axis=0)))
        # stable order on the coordinate, so that the cut does not depend on anything but the mesh
        order = index[np.argsort(x[:, axis], kind="stable")]
        total = np.cumsum(weights[order])
        # the cut nearest to the wanted share; no part goes without a point while another one has two
        cut = np.searchsorted(total - 0.5 * weights[order], total[-1] * left / parts)
        spare = len(index) - (parts - left)
        cut = int(np.clip(cut, *sorted((left, spare))))
        cut = min(max(cut, 0), len(index))
        todo.append((order[:cut], first, left))
        todo.append((order[cut:], first + left, parts - left))
    return part


def _plex_partition(comm, raw):
    """Partition by DMPlex and whatever graph partitioner PETSc has. *Collective.*"""
    dim = comm.bcast(raw.dim if comm.rank == 0 else None, root=0)
    if comm.rank == 0:
        block = raw.blocks[0]
        cell = CELLS[block.cell]
        cells = np.concatenate([b.nodes[:, : cell.n_vertices] for b in raw.blocks])
        used, cells = np.unique(cells, return_inverse=True)
        cells = cells.reshape(-1, cell.n_vertices).astype(PETSc.IntType)
        points = np.ascontiguousarray(raw.points[used])
        corners = comm.bcast(cell.n_vertices, root=0)
    else:
        corners = comm.bcast(None, root=0)
        cells, points = np.zeros((0, corners), dtype=PETSc.IntType), np.zeros((0, dim))
    n_cells = len(cells)
    dm = PETSc.DMPlex().createFromCellList(dim, cells, points, interpolate=False, comm=comm)
    # the same mesh is cut the same way, whatever this process has run before
    reset_partitioner()
    dm.getPartitioner().setFromOptions()
    start, end = dm.getChart()
    rank_of_point = np.zeros(max(end - start, 1), dtype=np.int32)
    sf = dm.distribute(overlap=0)
    n_leaves = dm.getChart()[1]
    mine = np.full(max(n_leaves, 1), comm.rank, dtype=np.int32)
    # a vertex sits on several ranks and any of them wins; a cell has one owner, and only cells are looked at
    sf.reduceBegin(MPI.INT, mine, rank_of_point, MPI.REPLACE)
    sf.reduceEnd(MPI.INT, mine, rank_of_point, MPI.REPLACE)
    sf.destroy()
    dm.destroy()
    return rank_of_point[:n_cells].astype(np.int64)


def partition(comm, raw, extra_weight):
    """Rank of every cell. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    raw : RawMesh or None
        On rank 0.
    extra_weight : ndarray (n_cells,) or None
        On rank 0: work of each cell beyond 1; None or zero: cells weigh the same.

    Returns
    -------
    ndarray (n_cells,) or None
        On rank 0.

    Notes ----- Equal weights and one cell type: DMPlex with the partitioner of this PETSc
    (``-petscpartitioner_type``). Weights, several cell types, or no graph partitioner: :func:`bisect`.
    """
    if comm.size == 1:
        return np.zeros(sum(len(b.nodes) for b in raw.blocks), dtype=np.int64)
    plain = None
    if comm.rank == 0:
        weighted = extra_weight is not None and bool(np.any(extra_weight > 0))
        plain = not weighted and len({b.cell for b in raw.blocks}) == 1
    plain = comm.bcast(plain, root=0)
    graph = any(has_package(name) for name in ("ptscotch", "parmetis", "chaco"))
    if plain and (graph or PETSc.Options().hasName("petscpartitioner_type")):
        assigned = _plex_partition(comm, raw)
        return assigned if comm.rank == 0 else None
    if comm.rank != 0:
        return None
    centres = centroids(raw)
    weights = 1.0 + (extra_weight if extra_weight is not None else np.zeros(len(centres)))
    return bisect(centres, weights, comm.size)
