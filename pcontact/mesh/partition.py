"""Which rank gets which cell."""

import numpy as np

from pcontact.mesh.bisection import UNIT, Cells, bisect
from pcontact.mesh.cell_distances import CellDistances
from pcontact.mesh.contact_weights import contact_facets
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.plex import owners, parts_of, plex
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


def _by_graph(exchanger, piece):
    """Rank of every cell of the slice, by the PetscPartitioner of a DMPlex of the slices. *Collective.*"""
    comm, corners = piece.comm, Corners(piece, exchanger)
    sf = owners(comm, corners.nodes, piece.n_nodes_total, len(piece.ids))
    cells = [(block.cell, table) for block, table in zip(piece.blocks, corners.tables, strict=True)]
    dm = plex(comm, piece.dim, cells, corners.points, sf)
    # PETSc makes the graph of a mesh on several ranks from its faces
    dm.interpolate()
    # the same mesh is cut the same way, whatever this process has run before
    reset_partitioner()
    dm.getPartitioner().setFromOptions()
    ranks = parts_of(dm)
    dm.destroy()
    return ranks


def _work(piece, facets, weight):
    """Work (n,) of the cells of a slice in whole numbers of `UNIT`."""
    cell = np.empty(len(piece.ids))
    least = min(WORK[block.cell] for block in piece.blocks)
    for block, first in zip(piece.blocks, piece.starts[:-1], strict=True):
        cell[first : first + len(block.nodes)] = WORK[block.cell] / least
    # sums of whole numbers of 64 bits are exact
    return np.round(UNIT * (cell + min(weight, HEAVY) * facets)).astype(np.int64)


def _add_depths(piece, corners):
    """Distances from the ends and middles of the bodies as further coordinates of the cells. *Collective.*"""
    depths = CellDistances(piece, corners.nodes, corners.tables)
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
        Planes that weigh cells and contact, see :mod:`pcontact.mesh.bisection`; or the partitioner of a DMPlex
        (``-petscpartitioner_type``; the first graph partitioner of this PETSc), by which all cells weigh the same.

    Returns
    -------
    ndarray (n,) of int64

    Notes
    -----
    A PETSc without graph partitioner leaves the mesh to bisection, unless the user names a partitioner.
    """
    comm = piece.comm
    if comm.size == 1:
        return np.zeros(len(piece.ids), dtype=np.int64)
    known = any(has_package(name) for name in PETSC_GRAPHS) or PETSc.Options().hasName("petscpartitioner_type")
    if method == "graph" and known:
        return _by_graph(exchanger, piece)
    return by_bisection(exchanger, piece, pairs, weight, comm.size)


def by_bisection(exchanger, piece, pairs, weight, count):
    """Part, 0 to ``count`` - 1, of every cell of a slice; see :func:`partition`. *Collective.*"""
    corners = Corners(piece, exchanger)
    facets = np.zeros(len(piece.ids), dtype=np.int64)
    if weight > 0.0 and pairs:
        facets = contact_facets(piece, corners, pairs)
    _add_depths(piece, corners)
    work = _work(piece, facets, weight)
    cells = Cells(piece.comm, corners.centres, piece.ids, work, facets, corners, weight * UNIT, piece.dim)
    return bisect(cells, count)
