"""A mesh on its way from a file to the ranks that own its cells: every rank holds some of it, or rank 0 everything."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, facet_kinds, facet_nodes
from pcontact.mesh.plex import told
from pcontact.mesh.raw import Block, RawMesh
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI, PETSc

# groups per column of bits
COLUMN = 62
_NONE = np.zeros(0, dtype=np.int64)
# groups of a mesh, without members
GROUPS = {"cell_groups": _NONE, "facet_groups": (_NONE, _NONE), "node_groups": _NONE,
          "edge_groups": _NONE.reshape(0, 2)}  # fmt: skip


@dataclass
class SliceBlock:
    """Cells of one type, a contiguous part of those in the file.

    Attributes
    ----------
    cell : str
    nodes : ndarray (n, n_nodes) int64
        Places of the nodes in the file.
    """

    cell: str
    nodes: np.ndarray


@dataclass
class MeshSlice:
    """Slice of a mesh that one rank holds before it is dealt.

    The rows of all blocks together are the *rows* of the slice. Cells and nodes have a place in the file and a number,
    by which the program knows them; the places are in the order of the rows and ranks.

    Attributes
    ----------
    comm : MPI.Comm
    path : pathlib.Path
    dim, degree : int
    curved : bool
    blocks : list of SliceBlock
        The same types on every rank, in the same order.
    ids : ndarray (n,) int64
        Numbers of the cells.
    body, component : ndarray (n,) int64
    points : ndarray (n_points, dim)
        Coordinates [length] of some nodes.
    point_starts : ndarray (size + 1,) int64
        Places of the nodes that each rank has.
    n_nodes_total, n_cells_total, n_components : int
    node_ids : ndarray (n_points,) int64, optional
        Numbers of these nodes; their places if absent (on all ranks).
    cell_groups : dict of str to ndarray
        Rows.
    facet_groups : dict of str to (ndarray, ndarray)
        Rows and local facet numbers.
    node_groups : dict of str to ndarray
        Rows of ``points``.
    edge_groups : dict of str to ndarray (m, 2)
        Numbers of the vertices of the edges of groups, on any rank; the same names on every rank.
    cell_values : ndarray (n, k) int64, optional
        What else is known of the cells and goes with them; on all ranks or none.
    node_values : ndarray (n_points, k) int64, optional
        The same of the nodes.
    """

    comm: object
    path: Path
    dim: int
    degree: int
    curved: bool
    blocks: list
    ids: np.ndarray
    body: np.ndarray
    component: np.ndarray
    points: np.ndarray
    point_starts: np.ndarray
    n_nodes_total: int
    n_cells_total: int
    n_components: int
    node_ids: np.ndarray | None = None
    cell_groups: dict = field(default_factory=dict)
    facet_groups: dict = field(default_factory=dict)
    node_groups: dict = field(default_factory=dict)
    edge_groups: dict = field(default_factory=dict)
    cell_values: np.ndarray | None = None
    node_values: np.ndarray | None = None

    @property
    def starts(self):
        """ndarray (n_blocks + 1,) : first row of every block."""
        return np.cumsum([0] + [len(block.nodes) for block in self.blocks])

    def name_as(self, mesh, row, members):
        """Fill the groups of cells and nodes with what the cells and nodes of a mesh have become.

        Parameters
        ----------
        mesh : pcontact.mesh.mesh.Mesh
            Whose groups they are.
        row : ndarray (n,)
            The cell of this rank, all blocks one after the other, that each row comes from.
        members : ndarray (n_points, m)
            Of the nodes, see :func:`bits`.
        """
        starts = mesh.starts
        for name, chosen in mesh.cell_groups.items():
            inside = np.zeros(starts[-1], dtype=bool)
            for first, rows in zip(starts, chosen, strict=False):
                inside[first + rows] = True
            self.cell_groups[name] = np.flatnonzero(inside[row])
        for k, name in enumerate(mesh.node_groups):
            self.node_groups[name] = np.flatnonzero(has_bit(members, k))


def level(comm, raw):
    """What this rank has of a mesh (None: nothing), with the blocks and groups that any rank has. *Collective.*"""
    own = raw and (raw.path, raw.dim, [(block.cell, block.degree, block.nodes.shape[1]) for block in raw.blocks],
                   {kind: list(getattr(raw, kind)) for kind in GROUPS}, raw.lost)  # fmt: skip
    heads = [head for head in comm.allgather(own) if head]
    path, dim, kinds = heads[0][:3]
    if heads[1:]:
        # one block of each, on all ranks in this order
        kinds = sorted(set().union(*(head[2] for head in heads)), key=lambda kind: kind[2])
        there = {block.cell: block for block in raw.blocks} if raw else {}
        blocks = [there.get(cell) for cell, _, _ in kinds]
    else:
        blocks = raw.blocks if raw else [None] * len(kinds)
    blocks = [block or Block(cell, degree, np.zeros((0, n), dtype=np.int64))
              for block, (cell, degree, n) in zip(blocks, kinds, strict=True)]  # fmt: skip
    lost, groups = {name: why for head in heads for name, why in head[4].items()}, {}
    for kind, none in GROUPS.items():
        names = dict.fromkeys(name for head in heads for name in head[3][kind]
                              if kind != "facet_groups" or name not in lost)  # fmt: skip
        groups[kind] = {name: getattr(raw, kind).get(name, none) if raw else none for name in names}
    points, tags = (raw.points, raw.tags) if raw else (np.zeros((0, dim)), None)
    return RawMesh(path, dim, points, blocks, **groups, tags=tags, lost=lost)


def whole(comm, raw, curved, component):
    """The slices of a mesh of which every rank has the cells and nodes that it has read, rank 0 all. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    raw : pcontact.mesh.raw.RawMesh or None
        All blocks of one degree; None: this rank has nothing.
    curved : bool or None
        Whether the geometry is of second order, where there is a mesh.
    component : ndarray (n_cells,) or None
        Connected component of each cell.

    Returns
    -------
    MeshSlice
        Of one body.
    """
    raw, component = level(comm, raw), _NONE if component is None else component
    starts, n = np.cumsum([0, *comm.allgather(len(raw.points))]), len(component)
    return MeshSlice(
        comm, raw.path, raw.dim, raw.blocks[0].degree, comm.allreduce(bool(curved), op=MPI.LOR),
        [SliceBlock(block.cell, block.nodes) for block in raw.blocks], (comm.exscan(n) or 0) + np.arange(n),
        np.zeros(n, dtype=np.int64), component, raw.points, starts, int(starts[-1]), comm.allreduce(n),
        comm.allreduce(int(component.max(initial=-1)) + 1, op=MPI.MAX),
        **{kind: getattr(raw, kind) for kind in GROUPS},
    )  # fmt: skip


def nodes_of(tables, n_total):
    """Nodes in some tables (n, k), ascending, each once."""
    count = sum(table.size for table in tables)
    if 8 * count < n_total:
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(t.ravel() for t in tables)]))
    # a flag per node is small against the tables
    flags = np.zeros(n_total, dtype=np.bool_)
    for table in tables:
        flags[table] = True
    return np.flatnonzero(flags)


def places(nodes, tables, n_total):
    """Tables with positions in ``nodes`` (ascending) in place of nodes."""
    count = sum(table.size for table in tables)
    if 8 * count < n_total:
        return [np.searchsorted(nodes, table) for table in tables]
    if len(nodes) == n_total:
        return tables
    number = np.empty(n_total, dtype=np.int64)
    number[nodes] = np.arange(len(nodes))
    return [number[table] for table in tables]


def fetch(comm, starts, values, nodes):
    """Values of nodes, from the ranks that have them. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    starts : ndarray (size + 1,)
        See `MeshSlice.point_starts`.
    values : ndarray (n_points, k)
        Of the nodes that this rank has.
    nodes : ndarray (n,)
        Places, ascending.

    Returns
    -------
    ndarray (n, k)
    """
    if comm.size == 1:
        return values if len(nodes) == len(values) else values[nodes]
    sf, remote = PETSc.SF().create(comm=comm), np.empty((len(nodes), 2), dtype=PETSc.IntType)
    remote[:, 0] = np.searchsorted(starts, nodes, side="right") - 1
    remote[:, 1] = nodes - starts[remote[:, 0]]
    sf.setGraph(len(values), None, remote)
    found = told(sf, values, np.empty((len(nodes), values.shape[1]), dtype=values.dtype))
    sf.destroy()
    return found


class Corners:
    """Vertices of the cells of a slice. *Collective.*

    Attributes
    ----------
    centres : ndarray (n, d)
        Means of the vertices.
    nodes : ndarray (n_nodes,)
        Places of the vertices, ascending.
    points : ndarray (n_nodes, d)
        Their coordinates, and what was added by `extend`.
    tables : list of ndarray
        Vertices of the cells of every block, by their positions in ``nodes``.
    """

    def __init__(self, piece):
        tables = [b.nodes[:, : CELLS[b.cell].n_vertices] for b in piece.blocks]
        self.nodes = nodes_of(tables, piece.n_nodes_total)
        self.points = fetch(piece.comm, piece.point_starts, piece.points, self.nodes)
        self.tables = places(self.nodes, tables, piece.n_nodes_total)
        self._starts, self._cells, self._dim = piece.starts, piece.blocks, piece.dim
        self._average()

    def _average(self):
        self.centres = np.empty((self._starts[-1], self.points.shape[1]))
        for table, first in zip(self.tables, self._starts[:-1], strict=True):
            means(self.points, np.ascontiguousarray(table), self.centres[first : first + len(table)])

    def extend(self, more):
        """Take values (n_nodes, k) of the vertices for further coordinates."""
        self.points = np.column_stack([self.points, more])
        self._average()

    def _by_block(self, rows):
        number = np.searchsorted(self._starts, rows, side="right") - 1
        for k, table in enumerate(self.tables):
            chosen = np.flatnonzero(number == k)
            yield k, chosen, table, rows[chosen] - self._starts[k]

    def __call__(self, rows):
        """Coordinates (n, k, d) of the vertices of cells; the last is repeated where a cell has fewer than others."""
        width = max((table.shape[1] for table in self.tables), default=1)
        out = np.empty((len(rows), width, self.points.shape[1]))
        for _, chosen, table, own in self._by_block(rows):
            wide = np.minimum(np.arange(width), table.shape[1] - 1)
            out[chosen] = self.points[table[own][:, wide]]
        return out

    def boxes(self, rows, local):
        """Corners (n, d), (n, d) of the boxes around facets, and the means (n, d) of their vertices."""
        points = self.points[:, : self._dim]
        low, high, mean = np.empty((3, len(rows), self._dim))
        for k, chosen, table, own in self._by_block(rows):
            for kind, numbers in facet_kinds(self._cells[k].cell):
                some = np.isin(local[chosen], numbers)
                at = chosen[some]
                x = points[np.take_along_axis(table[own[some]], facet_nodes(kind, 1)[local[at]], axis=1)]
                if len(at):
                    low[at], high[at], mean[at] = x.min(axis=1), x.max(axis=1), x.mean(axis=1)
        return low, high, mean


@njit_exact
def means(points, table, out):
    """Means (n, d) of the points of every row of a table (n, k)."""
    for c in range(table.shape[0]):
        for i in range(points.shape[1]):
            total = 0.0
            for v in range(table.shape[1]):
                total += points[table[c, v], i]
            out[c, i] = total / table.shape[1]


def bits(groups, n):
    """Columns (n, k) int64 that say which of the groups (rows, by name) something is in."""
    out = np.zeros((n, -(-len(groups) // COLUMN)), dtype=np.int64)
    for k, rows in enumerate(groups.values()):
        out[rows, k // COLUMN] |= np.int64(1) << np.int64(k % COLUMN)
    return out


def has_bit(columns, k):
    """Return whether group k is in the columns (n, m) of :func:`bits`."""
    return (columns[:, k // COLUMN] >> np.int64(k % COLUMN)) & 1 == 1


def rounds(comm, n, most):
    """Slices of n rows, at most so many at a time, equally many on all ranks. *Collective.*"""
    count = comm.allreduce(-(-n // most), op=MPI.MAX)
    return [slice(k * most, min((k + 1) * most, n)) for k in range(count)]


def to_owners(exchanger, ranks, table, width, most=1 << 19):
    """Rows of a table (n, width) int64 on the ranks they go to. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    ranks : ndarray (n,)
    table : callable
        Rows of the table for a slice: only a part of the table is in memory at a time.
    width : int
    most : int
        Rows of a part.

    Returns
    -------
    ndarray (m, width)
    """
    comm = exchanger.comm
    counts = np.bincount(ranks, minlength=comm.size)
    comm.Allreduce(MPI.IN_PLACE, counts, op=MPI.SUM)
    received, end = np.empty((counts[comm.rank], width), dtype=np.int64), 0
    for part in rounds(comm, len(ranks), most):
        sends, _ = split_by_rank(ranks[part], table(part))
        for rows in exchanger(sends, np.int64, width).values():
            received[end : end + len(rows)] = rows
            end += len(rows)
    return received
