"""Which rank gets which cell."""

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.bisection import UNIT, Cells, bisect
from pcontact.mesh.cell_distances import CellDistances
from pcontact.mesh.contact_weights import contact_facets
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.slices import Corners
from pcontact.runtime.declared import OPTIONS
from pcontact.runtime.petsc import MPI, PETSC_GRAPHS, PETSc, has_package, reset_partitioner

# work of a cell in a mesh of several types; those that it has are taken relative to the least
WORK = {"triangle": 1.0, "quadrilateral": 2.0, "tetrahedron": 1.0, "hexahedron": 5.0,
        "quadrilateral8": 2.0, "hexahedron20": 5.0, "wedge": 3.0, "wedge15": 3.0, "pyramid": 2.0,
        "pyramid13": 2.0}  # fmt: skip
# work of a contact facet in units of a cell's
WEIGHT = OPTIONS["partition_weight"].default
# more is no different
HEAVY = 1e6


def _gathered(exchanger, piece):
    """Vertices (n, k) of all cells by their places in the file, on rank 0; none elsewhere. *Collective.*"""
    sends = {0: piece.blocks[0].nodes[:, : CELLS[piece.blocks[0].cell].n_vertices]}
    for block in piece.blocks[1:]:
        sends[0] = np.concatenate([sends[0], block.nodes[:, : sends[0].shape[1]]])
    width = sends[0].shape[1]
    parts = exchanger(sends if len(sends[0]) else {}, np.int64, width)
    return np.concatenate([np.zeros((0, width), dtype=np.int64), *parts.values()])


def _graph(comm, dim, cells):
    """Rank of all cells, on rank 0, by DMPlex and whatever graph partitioner PETSc has. *Collective.*

    cells (n, k): vertices, on rank 0; none elsewhere.
    """
    used, numbers = np.unique(cells, return_inverse=True)
    numbers = numbers.reshape(cells.shape).astype(PETSc.IntType)
    points = np.zeros((len(used), dim))
    dm = PETSc.DMPlex().createFromCellList(dim, numbers, points, interpolate=False, comm=comm)
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
    return rank_of_point[: len(cells)].astype(np.int64)


def _by_graph(exchanger, piece):
    """Rank of every cell of the slice, by a graph partitioner on rank 0. *Collective.*"""
    comm = piece.comm
    ranks = _graph(comm, piece.dim, _gathered(exchanger, piece))
    counts = comm.gather(len(piece.ids), root=0)
    sends = {}
    if comm.rank == 0:
        ends = np.cumsum(counts)
        sends = {r: part for r, part in enumerate(np.split(ranks, ends[:-1])) if len(part)}
    received = exchanger(sends, np.int64, 1)
    return received[0].ravel() if received else np.zeros(0, dtype=np.int64)


def _work(piece, facets, weight):
    """Work (n,) of the cells of a slice in whole numbers of `UNIT`."""
    cell = np.empty(len(piece.ids))
    least = min(WORK[block.cell] for block in piece.blocks)
    for block, first in zip(piece.blocks, piece.starts[:-1], strict=True):
        cell[first : first + len(block.nodes)] = WORK[block.cell] / least
    # sums of whole numbers of 64 bits are exact
    return np.round(UNIT * (cell + min(weight, HEAVY) * facets)).astype(np.int64)


def _add_depths(exchanger, piece, corners):
    """Distances from the ends and middles of the bodies as further coordinates of the cells. *Collective.*"""
    depths = CellDistances(exchanger, piece, corners.nodes, corners.tables)
    box = bounding_box(piece.comm, corners.centres)
    levels = depths().astype(float)
    most = piece.comm.allreduce(float(levels.max(initial=0.0)), op=MPI.MAX)
    # as long as the box, so that a tilt means the same in all of them
    levels *= float(np.max(box[1] - box[0])) / max(most, 1.0)
    corners.extend(np.column_stack([levels, depths.radii(corners.points, corners.centres, box)]))


def partition(exchanger, piece, pairs=(), weight=WEIGHT, method="bisection"):
    """Rank of every cell of a slice. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    piece : pcontact.mesh.slices.MeshSlice
    pairs : list of (str, str or None, float or None)
        Contact pairs, see :func:`pcontact.mesh.contact_weights.contact_facets`.
    weight : float
        Work of a contact facet in units of a cell's; 0: contact does not weigh and need not be spread evenly.
    method : {"bisection", "graph"}
        Planes that weigh cells and contact, see :mod:`pcontact.mesh.bisection`; or DMPlex with the graph partitioner of
        this PETSc (``-petscpartitioner_type``) on rank 0, by which all cells weigh the same.

    Returns
    -------
    ndarray (n,) of int64

    Notes
    -----
    Several cell types, or a PETSc without graph partitioner, are left to bisection.
    """
    comm = piece.comm
    if comm.size == 1:
        return np.zeros(len(piece.ids), dtype=np.int64)
    one = len({block.cell for block in piece.blocks}) == 1
    known = any(has_package(name) for name in PETSC_GRAPHS) or PETSc.Options().hasName("petscpartitioner_type")
    if method == "graph" and one and known:
        return _by_graph(exchanger, piece)
    return by_bisection(exchanger, piece, pairs, weight, comm.size)


def by_bisection(exchanger, piece, pairs, weight, count):
    """Part, 0 to ``count`` - 1, of every cell of a slice; see :func:`partition`. *Collective.*"""
    corners = Corners(piece, exchanger)
    facets = np.zeros(len(piece.ids), dtype=np.int64)
    if weight > 0.0 and pairs:
        facets = contact_facets(piece, corners, pairs)
    _add_depths(exchanger, piece, corners)
    work = _work(piece, facets, weight)
    cells = Cells(piece.comm, corners.centres, piece.ids, work, facets, corners, weight * UNIT, piece.dim)
    return bisect(cells, count)
