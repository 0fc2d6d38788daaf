"""The mesh of one rank: its cells, their nodes, its share of every physical group."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pcontact.element.reference import CELLS, facet_kinds, facet_nodes
from pcontact.mesh.plex import mesh_plex


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
    origin : pcontact.mesh.refinement.origin.Origin or None
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


def bounding_box(comm, points):
    """Corners (d,), (d,) of the box around the points of all ranks. *Collective.*"""
    d = points.shape[1]
    low = points.min(axis=0) if len(points) else np.full(d, np.inf)
    high = points.max(axis=0) if len(points) else np.full(d, -np.inf)
    boxes = np.array(comm.allgather(np.concatenate([low, high])))
    return boxes[:, :d].min(axis=0), boxes[:, d:].max(axis=0)
