"""Partition of cells over the ranks.

Which facets of source surfaces may have a partner: they are the work of contact, which the partition spreads.

How far nodes are from the ends of their body, in cells, along which long and bent bodies are cut across; and from
the place where its cells are densest, around which few cells are cut.

Distances are whole numbers, found by all ranks together, and do not depend on which rank has which cell.
"""

import numpy as np

from pcontact.mesh.bisection import MOMENT_BITS, UNIT, Cells, bisect, moments, reduced
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.plex import least_told, owners, parts_of, plex
from pcontact.mesh.raw import numbered
from pcontact.mesh.slices import Corners
from pcontact.runtime.declared import OPTIONS
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI, PETSC_GRAPHS, PETSc, has_package, reset_partitioner

# boxes of the lattice along the longest side of a target, at most
LATTICE = 64
# part of the extent of the smaller surface that a partner is looked for in, unless the user says how far
REACH = 0.15
# ends of each connected component from which distances are taken
ENDS = 2
# numbers of cells are below 2^NUMBER
NUMBER = 40
# the level of a node that has not been reached
FAR = np.int64(2**20)
# work of a cell in a mesh of several types; those that it has are taken relative to the least
WORK = {"triangle": 1.0, "quadrilateral": 2.0, "tetrahedron": 1.0, "hexahedron": 5.0,
        "quadrilateral8": 2.0, "hexahedron20": 5.0, "wedge": 3.0, "wedge15": 3.0, "pyramid": 2.0,
        "pyramid13": 2.0}  # fmt: skip
# work of a contact facet in units of a cell's
WEIGHT = OPTIONS["partition_weight"].default
# more is no different
HEAVY = 1e6


@njit
def _occupy(first, last, shape, out):
    """Mark boxes (flat, `out`) of a lattice from first (n, d) to last (n, d); the third direction may be missing."""
    for k in range(first.shape[0]):
        for i in range(first[k, 0], last[k, 0] + 1):
            for j in range(first[k, 1], last[k, 1] + 1):
                for m in range(first[k, 2], last[k, 2] + 1):
                    out[(i * shape[1] + j) * shape[2] + m] = 1


@njit
def _widen(shape, occupied, radius, out):
    """Mark all boxes whose centres are within a radius (in boxes) of that of an occupied one."""
    reach = int(np.ceil(radius))
    for i in range(shape[0]):
        for j in range(shape[1]):
            for m in range(shape[2]):
                if occupied[(i * shape[1] + j) * shape[2] + m] == 0:
                    continue
                for a in range(max(i - reach, 0), min(i + reach, shape[0] - 1) + 1):
                    for b in range(max(j - reach, 0), min(j + reach, shape[1] - 1) + 1):
                        for c in range(max(m - reach, 0), min(m + reach, shape[2] - 1) + 1):
                            if (a - i) ** 2 + (b - j) ** 2 + (c - m) ** 2 <= radius * radius:
                                out[(a * shape[1] + b) * shape[2] + c] = 1


def _close(comm, source, target, radius):
    """Return whether the means of source facets are near a target facet, on a lattice of boxes. *Collective.*

    source, target : low, high, mean (n, d) of facets. radius [length], or None.
    """
    low, high = bounding_box(comm, *target[:2])
    if not np.all(np.isfinite(low)):
        return np.zeros(len(source[2]), dtype=bool)
    if radius is None:
        around = bounding_box(comm, *source[:2])
        if not np.all(np.isfinite(around[0])):
            return np.zeros(0, dtype=bool)
        radius = REACH * min(np.linalg.norm(high - low), np.linalg.norm(around[1] - around[0]))
    d = len(low)
    low, span = low - radius, high - low + 2.0 * radius
    size = max(float(span.max()) / LATTICE, np.finfo(float).tiny)
    shape = np.ones(3, dtype=np.int64)
    shape[:d] = np.minimum(np.floor(span / size), LATTICE - 1).astype(np.int64) + 1

    def place(x):
        out = np.zeros((len(x), 3), dtype=np.int64)
        out[:, :d] = np.floor((x - low) / size)
        return out

    occupied, near = np.zeros((2, int(shape.prod())), dtype=np.uint8)
    top = shape - 1
    _occupy(np.clip(place(target[0]), 0, top), np.clip(place(target[1]), 0, top), shape, occupied)
    # half the diagonals of two boxes
    _widen(shape, reduced(comm, occupied, MPI.MAX), radius / size + np.sqrt(d), near)
    at = place(source[2])
    inside = np.all((at >= 0) & (at <= top), axis=1)
    at = np.clip(at, 0, top)
    return inside & (near[(at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]] > 0)


def contact_facets(piece, corners, pairs):
    """Facets of every cell of a slice that may have a partner. *Collective.*

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
    corners : pcontact.mesh.slices.Corners
    pairs : list of (str, str or None, float or None)
        Source, target (None: an obstacle, which all facets may meet; the source itself: all facets, too), and search
        radius [length] (None: a part of the extent of the smaller surface).

    Returns
    -------
    ndarray (n,) of int64
    """
    count = np.zeros(len(piece.ids), dtype=np.int64)
    for source, target, radius in pairs:
        rows, local = piece.facet_groups[source]
        if target is not None and target != source:
            boxes = [corners.boxes(*piece.facet_groups[name]) for name in (source, target)]
            rows = rows[_close(piece.comm, *boxes, radius)]
        np.add.at(count, rows, 1)
    return count


@njit
def _cells_of_nodes(table, n_nodes):
    """Cells around every node: offsets (n_nodes + 1,), cells."""
    offsets = np.zeros(n_nodes + 2, dtype=np.int64)
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            offsets[table[c, v] + 2] += 1
    for k in range(n_nodes):
        offsets[k + 2] += offsets[k + 1]
    cells = np.empty(table.size, dtype=np.int32)
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            node = table[c, v]
            cells[offsets[node + 1]] = c
            offsets[node + 1] += 1
    return offsets[:-1], cells


@njit
def _spread(table, offsets, cells, expanded, level, waiting, start):
    """Lower the levels of nodes to one more than those of nodes with a common cell, beginning at some nodes.

    expanded (n_cells,): level from which a cell was last seen. waiting (n_nodes,) bool: in the queue.
    """
    size = level.shape[0] + 1
    queue = np.empty(size, dtype=np.int64)
    first, end = 0, 0
    for node in start:
        if not waiting[node]:
            waiting[node] = True
            queue[end] = node
            end += 1
    while first != end:
        node = queue[first]
        first = (first + 1) % size
        waiting[node] = False
        here = level[node]
        for at in range(offsets[node], offsets[node + 1]):
            c = cells[at]
            if expanded[c] <= here:
                continue
            expanded[c] = here
            for v in range(table.shape[1]):
                other = table[c, v]
                if level[other] > here + 1:
                    level[other] = here + 1
                    if not waiting[other]:
                        waiting[other] = True
                        queue[end] = other
                        end = (end + 1) % size


@njit
def _radii(points, table, component, middles, out):
    """Distance of the vertices of cells from the middle of their component."""
    for c in range(table.shape[0]):
        for v in range(table.shape[1]):
            total = 0.0
            for i in range(middles.shape[1]):
                total += (points[table[c, v], i] - middles[component[c], i]) ** 2
            out[table[c, v]] = np.sqrt(total)


class CellDistances:
    """Distances of the nodes of the cells of this rank.

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
    nodes : ndarray (n_nodes,)
        Places of the nodes, ascending.
    tables : list of ndarray (n, k)
        Vertices of the cells, by their positions in ``nodes``, for every block.
    """

    def __init__(self, piece, nodes, tables):
        self.comm = piece.comm
        width = max(table.shape[1] for table in tables)
        if len(tables) == 1:
            self._table = np.ascontiguousarray(tables[0])
        else:
            # a vertex twice does no harm
            padded = [table[:, np.minimum(np.arange(width), table.shape[1] - 1)] for table in tables]
            self._table = np.concatenate(padded)
        self._n_nodes = len(nodes)
        self._around = _cells_of_nodes(self._table, len(nodes))
        self._ids, self._component, self._count = piece.ids, piece.component, piece.n_components
        alone = self.comm.allreduce(int(len(self._ids) > 0)) <= 1
        self._sf = None if alone else owners(self.comm, nodes, piece.n_nodes_total)

    def _ends(self, distance):
        """One cell (rows of those of this rank) of every component: the farthest, the first of them. *Collective.*"""
        key = (distance << NUMBER) + (2**NUMBER - 1 - self._ids)
        best = np.full(self._count, -1, dtype=np.int64)
        np.maximum.at(best, self._component, key)
        return np.flatnonzero(reduced(self.comm, best, MPI.MAX)[self._component] == key)

    def _from(self, rows):
        """Levels (n_nodes,) of all nodes, 0 at those of some cells. *Collective.*

        Every rank goes as far as it can by itself; nodes of several ranks then have the least of their levels, until
        none is lowered any more.
        """
        n = self._n_nodes
        level, expanded = np.full(n, FAR), np.full(len(self._ids), FAR)
        waiting = np.zeros(n, dtype=bool)
        start = np.unique(self._table[rows])
        level[start] = 0
        while True:
            _spread(self._table, *self._around, expanded, level, waiting, start)
            if self._sf is None:
                return level
            least = least_told(self._sf, level)
            start = np.flatnonzero(least < level)
            start, level = start[np.argsort(least[start], kind="stable")], least
            if not self.comm.allreduce(len(start)):
                return level

    def radii(self, points, centres, box):
        """Distances (n_nodes,) [length] from the middle of the component, which is where most cells are. *Collective.*

        Parameters
        ----------
        points : ndarray (n_nodes, d)
        centres : ndarray (n, d)
            Of the cells.
        box : ndarray (d,), ndarray (d,)
            Around all of them.
        """
        low, span = box[0], float(np.max(box[1] - box[0])) or 1.0
        d = points.shape[1]
        sums = np.zeros((self._count, 1 + d + d * d), dtype=np.int64)
        moments(self._component, ((centres - low) * (2**MOMENT_BITS / span)).astype(np.int64), sums)
        sums = reduced(self.comm, sums, MPI.SUM)
        middles = low + sums[:, 1 : 1 + d] / np.maximum(sums[:, :1], 1) * (span / 2**MOMENT_BITS)
        out = np.zeros(len(points))
        _radii(points, self._table, self._component, middles, out)
        return out

    def __call__(self):
        """Distances (n_nodes, ENDS) from ends of the components, each far from those before. *Collective.*"""
        zero = np.zeros(len(self._ids), dtype=np.int64)
        level = self._from(self._ends(zero))
        levels, least = [], None
        for _ in range(ENDS):
            near = level if least is None else least
            level = self._from(self._ends(near[self._table].sum(axis=1) if len(self._table) else zero))
            levels.append(level)
            least = level if least is None else np.minimum(least, level)
        return np.column_stack(levels)


def _by_graph(piece):
    """Rank of every cell of the slice, by the PetscPartitioner of a DMPlex of the slices. *Collective.*"""
    comm, corners = piece.comm, Corners(piece)
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
    for block, own in numbered(piece.blocks):
        cell[own] = WORK[block.cell] / least
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


def partition(piece, pairs=(), weight=WEIGHT, method="bisection"):
    """Rank of every cell of a slice. *Collective.*

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
    pairs : list of (str, str or None, float or None)
        Contact pairs, see :func:`pcontact.mesh.partition.contact_facets`.
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
        return _by_graph(piece)
    return by_bisection(piece, pairs, weight, comm.size)


def by_bisection(piece, pairs, weight, count):
    """Part, 0 to ``count`` - 1, of every cell of a slice; see :func:`partition`. *Collective.*"""
    corners = Corners(piece)
    facets = np.zeros(len(piece.ids), dtype=np.int64)
    if weight > 0.0 and pairs:
        facets = contact_facets(piece, corners, pairs)
    _add_depths(piece, corners)
    work = _work(piece, facets, weight)
    cells = Cells(piece.comm, corners.centres, piece.ids, work, facets, corners, weight * UNIT, piece.dim)
    return bisect(cells, count)
