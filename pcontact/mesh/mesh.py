"""The mesh of one rank: its cells, their nodes, its share of every physical group.

Orders that keep neighbours in space together in memory: cells along a Z curve, nodes as the cells meet them.

Digest of a mesh: numbers that tell two meshes apart, the same on any number of ranks and however cells are dealt.

Every row (a cell with its nodes, a node with its coordinates, a member of a group) has a hash, and a digest is the sum
of the hashes modulo 2^64.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pcontact.element.reference import CELLS, facet_kinds, facet_nodes
from pcontact.mesh.plex import mesh_plex
from pcontact.runtime.jit import njit, njit_exact
from pcontact.runtime.petsc import MPI

FACETS = 64  # more than a cell has
CELL, FACET, NODE = range(3)  # members of groups
# the numbers are in checkpoints
KINDS = {"hexahedron": 0, "quadrilateral": 1, "segment": 2, "tetrahedron": 3, "triangle": 4, "quadrilateral8": 5,
         "hexahedron20": 6, "wedge": 7, "wedge15": 8, "pyramid": 9, "pyramid13": 10}  # fmt: skip


@dataclass
class CellBlock:
    """Cells of one type in one body.

    Attributes
    ----------
    cell : str
        Name in :data:`pcontact.element.reference.CELLS`.
    body : int
        Number of the body in the scene.
    nodes : ndarray (n_cells, n_nodes)
        Local node numbers, VTK order.
    ids : ndarray (n_cells,)
        Global cell numbers, ascending order not implied.
    components : ndarray (n_cells,)
        Number of the connected component of the whole mesh that the cell is in.
    """

    cell: str
    body: int
    nodes: np.ndarray
    ids: np.ndarray
    components: np.ndarray


@dataclass
class Facets:
    """Facets of one kind of one block: a part of a physical group.

    Attributes
    ----------
    block : int
    cell : str
        Name in :data:`pcontact.element.reference.CELLS` under which their tables stand, see
        :func:`pcontact.element.reference.facet_kinds`; that of the block unless its cells are wedges or pyramids.
    cells : ndarray (n,)
        Row in the block.
    local : ndarray (n,)
        Local facet number in the cell.
    """

    block: int
    cell: str
    cells: np.ndarray
    local: np.ndarray

    @classmethod
    def of(cls, number, block, cells, local):
        """Facets (n,) of a block, by the kinds that they have: list of Facets."""
        found = []
        for kind, rows in facet_kinds(block.cell):
            own = np.isin(local, rows)
            if own.any():
                found.append(cls(number, kind, cells[own], local[own]))
        return found

    @property
    def kind(self):
        """str : the reference cell of the facets."""
        return CELLS[self.cell].facet


@dataclass
class Mesh:
    """One rank's part of the mesh.

    Attributes
    ----------
    comm : MPI.Comm
    dim : int
    degree : int
        Degree of the node layout of the cells, the larger one of geometry and displacement.
    curved : bool
        Whether the geometry is of second order.
    points : ndarray (n_nodes, dim)
        Coordinates [length] of the nodes of this rank's cells.
    file_nodes : ndarray (n_nodes,)
        Node numbers that all ranks agree on.
    n_nodes_total, n_cells_total : int
    blocks : list of CellBlock
    facet_groups : dict of str to list of Facets
    node_groups : dict of str to ndarray
        Local node numbers.
    edge_groups : dict of str to ndarray (m, 2)
        Vertices of the edges of groups, as ``file_nodes``; of the edges that this rank may have.
    cell_groups : dict of str to list of ndarray
        Rows of each block.
    n_components : int
        Connected components of the whole mesh.
    component_names : list of str
        For messages: the body (or bodies) that a component belongs to.
    origin : pcontact.mesh.refinement.numbering.Origin or None
        What a refined mesh was made from.
    belongs : pcontact.mesh.geometry.belonging.Belonging or None
        On which curves and surfaces of a geometry its boundary lies, where the scene names one; of a mesh of simplices
        that was refined, that of its base counts.
    cell_values, node_values : ndarray (n_cells, k), (n_nodes, k) int64, or None
        What came with the slices, see `pcontact.mesh.slices.MeshSlice`; all blocks one after the other.
    pieces : dict
        Of source facets that runs on this mesh have cut, see `pcontact.contact.segmentation.pieces`.
    dm : PETSc.DMPlex
        Its cells and vertices, see :mod:`pcontact.mesh.plex`. *Collective* when it is asked for first.
    """

    comm: object
    dim: int
    degree: int
    curved: bool
    points: np.ndarray
    file_nodes: np.ndarray
    n_nodes_total: int
    n_cells_total: int
    blocks: list
    facet_groups: dict = field(default_factory=dict)
    node_groups: dict = field(default_factory=dict)
    edge_groups: dict = field(default_factory=dict)
    cell_groups: dict = field(default_factory=dict)
    n_components: int = 1
    component_names: list = field(default_factory=list)
    origin: object = None
    belongs: object = None
    cell_values: np.ndarray | None = None
    node_values: np.ndarray | None = None
    pieces: dict = field(init=False, default_factory=dict, repr=False, compare=False)

    @property
    def starts(self):
        """ndarray (n_blocks + 1,) : row of the first cell of every block, all of them one after the other."""
        return np.cumsum([0] + [len(block.nodes) for block in self.blocks])

    def facets_of(self, name):
        """Facets of a group, by block and kind, and which of them they are (a slice): all are one after the other."""
        first = 0
        for facets in self.facet_groups.get(name, []):
            yield facets, slice(first, first + len(facets.cells))
            first += len(facets.cells)

    def of_cells(self, name):
        """Return what blocks know of their cells (n_cells,), by its name: numbers, bodies, components."""
        parts = [np.broadcast_to(getattr(block, name), len(block.nodes)) for block in self.blocks]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])

    @cached_property
    def dm(self):
        return mesh_plex(self)

    def geometry_nodes(self, block):
        """Node table of the cells' geometry: all nodes when curved, else the vertices, and its degree."""
        if self.curved:
            return block.nodes, 2
        return np.ascontiguousarray(block.nodes[:, : CELLS[block.cell].n_vertices]), 1

    def facet_nodes(self, facets):
        """Local node numbers (n, n_facet_nodes) of facets, all nodes of the layout, outward order."""
        block = self.blocks[facets.block]
        table = facet_nodes(facets.cell, self.degree)
        return block.nodes[facets.cells[:, None], table[facets.local]]

    def region_nodes(self, name):
        """Local nodes of a region of any kind that this rank's own groups show (unique, sorted).

        Nodes on the border of another rank's facets may be missing: the space completes the list.
        """
        parts = [np.zeros(0, dtype=np.int64)]
        if name in self.node_groups:
            parts.append(self.node_groups[name])
        for facets in self.facet_groups.get(name, []):
            parts.append(self.facet_nodes(facets).ravel())
        for block, rows in zip(self.blocks, self.cell_groups.get(name, []), strict=False):
            parts.append(block.nodes[rows].ravel())
        return np.unique(np.concatenate(parts))


def size_of(mesh):
    """Diagonal of the bounding box [length]. *Collective.*"""
    low, high = bounding_box(mesh.comm, mesh.points)
    return float(np.linalg.norm(high - low))


def bounding_box(comm, points, others=None):
    """Corners (d,), (d,) of the box around the points of all ranks, or around boxes from points to others.
    *Collective.*"""
    d = points.shape[1]
    low = points.min(axis=0, initial=np.inf)
    high = (points if others is None else others).max(axis=0, initial=-np.inf)
    boxes = np.array(comm.allgather(np.concatenate([low, high])))
    return boxes[:, :d].min(axis=0), boxes[:, d:].max(axis=0)


@njit_exact
def _interleave(points, low, span, bits, out):
    """Bits of the positions (n, d) in a box, taken from the directions in turn."""
    d = points.shape[1]
    top = 2.0**bits - 1.0
    for k in range(points.shape[0]):
        key = np.uint64(0)
        for axis in range(d):
            place = np.uint64((points[k, axis] - low[axis]) / span[axis] * top)
            for bit in range(bits):
                key |= ((place >> np.uint64(bit)) & np.uint64(1)) << np.uint64(bit * d + axis)
        out[k] = key


def z_order(points):
    """Order (n,) of points (n, d) along a Z curve; that of the points where they coincide."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    d = points.shape[1]
    low, high = points.min(axis=0), points.max(axis=0)
    keys = np.empty(len(points), dtype=np.uint64)
    _interleave(np.ascontiguousarray(points), low, np.where(high > low, high - low, 1.0), 31 if d == 2 else 20, keys)
    return np.argsort(keys, kind="stable")


@njit
def _meet(table, number, order, count):
    """Number the entries of a table (n, k) as they come, and put these numbers into it."""
    for row in range(table.shape[0]):
        for column in range(table.shape[1]):
            node = table[row, column]
            if number[node] < 0:
                number[node] = count
                order[count] = node
                count += 1
            table[row, column] = number[node]
    return count


def as_met(tables, n):
    """Number nodes from 0 to ``n`` - 1 in the order in which tables meet them; nodes that none has are left out.

    Parameters
    ----------
    tables : list of ndarray (m, k) int64
        C-contiguous; changed in place.
    n : int

    Returns
    -------
    order : ndarray
        Old numbers in the new order.
    number : ndarray (n,)
        New numbers; -1 for nodes that are left out.
    """
    number, order = np.full(n, -1, dtype=np.int64), np.empty(n, dtype=np.int64)
    count = 0
    for table in tables:
        count = _meet(table, number, order, count)
    return order[:count], number


def scattered(z):
    """Unsigned numbers of 64 bits as such that look like random ones (SplitMix64: Steele, Lea, Flood 2014)."""
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def mixed(numbers):
    """Whole numbers (n,) :func:`scattered`."""
    return scattered(np.asarray(numbers).astype(np.uint64))


def hashes(*columns):
    """Hashes (n,) uint64 of rows.

    Parameters
    ----------
    columns : ndarray (n,) or (n, k)
        Whole numbers, or floats: 0.0 and -0.0 are the same.
    """
    columns = [column if column.ndim == 2 else column[:, None] for column in columns]
    h = np.full(len(columns[0]), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for table in columns:
        for k in range(table.shape[1]):
            column = table[:, k] + 0.0 if table.dtype.kind == "f" else table[:, k].astype(np.int64)
            h = scattered(h + column.view(np.uint64))
    return h


def total(comm, h):
    """Sum of hashes (n,) of all ranks, as text. *Collective.*"""
    sums = np.array([np.sum(h, dtype=np.uint64)], dtype=np.uint64)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    return f"{int(sums[0]):016x}"


def mesh_digest(mesh, owned, names):
    """Digest of what a run takes from a mesh. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    owned : ndarray
        Local nodes, each on one rank only.
    names : iterable of str
        Groups that the run uses, the same on all ranks.

    Returns
    -------
    dict of str to str
        ``points``, ``cells`` and, for every group, ``groups.NAME``.
    """
    comm = mesh.comm
    digest = dict(zip(("points", "cells"), _parts(mesh), strict=True))
    digest["cells"] += ", curved" if mesh.curved else ""
    mine = np.zeros(len(mesh.points), dtype=bool)
    mine[owned] = True
    for name in sorted(set(names)):
        digest[f"groups.{name}"] = total(comm, _group(mesh, mine, name))
    return digest


def _parts(mesh):
    """Digests of the points and of the cells. *Collective.*"""
    # a node counts once for every cell that it is in: ranks share nodes, but no cells
    count, cells = np.zeros(len(mesh.points), dtype=np.uint64), [np.zeros(0, dtype=np.uint64)]
    for block in mesh.blocks:
        count += np.bincount(block.nodes.ravel(), minlength=len(count)).astype(np.uint64)
        kind = np.full(len(block.ids), KINDS[block.cell])
        cells.append(hashes(kind, block.ids, mesh.file_nodes[block.nodes]))
    points = count * hashes(mesh.file_nodes, mesh.points)
    return total(mesh.comm, points), total(mesh.comm, np.concatenate(cells))


def _group(mesh, mine, name):
    """Hashes of the members of a group on this rank: cells, facets and nodes of that name."""
    parts = [np.zeros(0, dtype=np.uint64)]
    for block, rows in zip(mesh.blocks, mesh.cell_groups.get(name, []), strict=False):
        parts.append(hashes(np.full(len(rows), CELL), block.ids[rows]))
    for facets in mesh.facet_groups.get(name, []):
        ids = mesh.blocks[facets.block].ids[facets.cells] * FACETS + facets.local
        parts.append(hashes(np.full(len(ids), FACET), ids))
    nodes = mesh.node_groups.get(name, np.zeros(0, dtype=np.int64))
    nodes = nodes[mine[nodes]]
    parts.append(hashes(np.full(len(nodes), NODE), mesh.file_nodes[nodes]))
    return np.concatenate(parts)
