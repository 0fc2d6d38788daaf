"""Numbers of nodes and cells that do not depend on the ranks: every node has a home, known by its number or key.

Which other ranks have a node, and what ranks tell each other of the edges they cut.

What a refined mesh remembers of the mesh it was made from, and how the base hears of it to be refined again.

The slice of a mesh whose cells are divided, each for itself: nodes with the same key are one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.mesh.mesh import mixed
from pcontact.mesh.raw import distinct
from pcontact.mesh.refinement.simplices import home_of_key
from pcontact.mesh.slices import COLUMN, MeshSlice, SliceBlock, bits
from pcontact.runtime.parallel import rows_of

# bits of a node; further neighbours have the last one together
BITS = 64


class Numbers(NamedTuple):
    """Nodes as their home ranks keep them, and where the nodes of this rank have their places."""

    table: np.ndarray
    numbers: np.ndarray
    starts: np.ndarray
    places: np.ndarray
    total: int


def number_nodes(exchanger, base, numbers, keys, rows, fewer=False):
    """Give nodes numbers that do not depend on the ranks: those of the base keep theirs, others follow in the order
    of keys. Where the new mesh may have ``fewer`` of the base, those that are left are numbered in their order.

    numbers (n,): of the base, or -1. rows (n, k) int64: what goes with them; of equal ones the row whose first
    entry is the least counts. *Collective.*
    """
    comm, size = exchanger.comm, exchanger.comm.size
    n_base = base.n_nodes_total
    old = numbers >= 0
    home = np.where(old, numbers * size // n_base, home_of_key(keys, size))
    # nodes of the base before all others, in the order of their numbers; then by keys, without their sign
    name = np.where(old, numbers, keys.view(np.int64) ^ np.int64(-(2**63)))
    found = None

    def answer(table):
        nonlocal found
        found, index = _numbered(comm, table, n_base, fewer)
        return np.column_stack([found.starts[comm.rank] + index, found.numbers[index]])

    places = exchanger.ask(home, np.column_stack([~old, name, rows]), answer)
    return found._replace(places=places), places[:, 1]


def _numbered(comm, table, n_base, fewer):
    """Nodes of the rows (n, k) that came to a home, and which of them each is (n,). *Collective.*"""
    chosen, index = distinct(table[:, 0], table[:, 1], ties=table[:, 2:3].T)
    ordered = table[chosen]
    counts = np.array(comm.allgather((int(np.sum(ordered[:, 0] == 0)), len(ordered))), dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(counts[:, 1])])
    fresh, kept = np.cumsum(counts[:, 1] - counts[:, 0]), np.cumsum(counts[:, 0])
    ids = np.where(ordered[:, 0] == 0, ordered[:, 1], 0)
    new = ordered[:, 0] == 1
    if fewer:
        ids[~new] = kept[comm.rank] - (~new).sum() + np.arange((~new).sum())
    elif kept[-1] != n_base:
        raise ValueError("nodes of the base that no cell has")
    ids[new] = kept[-1] + (fresh[comm.rank] - new.sum()) + np.arange(new.sum())
    return Numbers(ordered[:, 2:], ids, starts, None, int(starts[-1])), index


def first_numbers(exchanger, base, ids, counts):
    """First new number of the cells that come from cells of the base with numbers ids (n,), and how many there are.
    *Collective.*
    """
    comm, size, n = exchanger.comm, exchanger.comm.size, max(base.n_cells_total, 1)

    def answer(table):
        by_id, first = np.argsort(table[:, 0]), np.empty(len(table), dtype=np.int64)
        first[by_id] = np.cumsum(table[by_id, 1]) - table[by_id, 1]
        return (first + (comm.exscan(int(table[:, 1].sum())) or 0))[:, None]

    out = exchanger.ask(ids * size // n, np.column_stack([ids, counts]), answer)[:, 0]
    return out, comm.allreduce(int(np.sum(counts)))


def among(ends, edges, n):
    """Tell which pairs (m, 2) of numbers below n are among others (k, 2), in any order."""
    return np.isin(ends.min(axis=1) * n + ends.max(axis=1), edges.min(axis=1) * n + edges.max(axis=1))


class Part(NamedTuple):
    """Cells of a block that are divided alike, and the nodes of what they are divided into.

    Attributes
    ----------
    block : int
    rows : ndarray (n,)
        In the block.
    table : ndarray (k, n_nodes)
        Places of the nodes of the new cells.
    facets : list of ndarray (m, 2)
        By facet of the cell: new cells and their facets that lie on it.
    edges : list of (pair, list, list of pairs)
        Of the cell: its vertices, new places on it, and places of the vertices of the edges that it is divided into.
    old : ndarray (n_places,)
        Node of the cell in the same place, or -1.
    values : ndarray (n, n_places, m)
        Coordinates, and fields, at the places.
    keys : ndarray (n, n_places) uint64
        Of the nodes there.
    """

    block: int
    rows: np.ndarray
    table: np.ndarray
    facets: list
    edges: list
    old: np.ndarray
    values: np.ndarray
    keys: np.ndarray


def sliced(exchanger, mesh, parts, layout, degree, width, move=None, cells=None):
    """The mesh whose cells are divided, in slices whose nodes have the values of the parts. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    mesh : pcontact.mesh.mesh.Mesh
    parts : list of Part
        Of all cells of this rank.
    layout : list of (str, int)
        New blocks: cell, and the number of its nodes; one for each of the mesh, or one for all.
    degree : int
        Of the layout of the nodes.
    width : int
        Of the values of the parts.
    move : callable, optional
        ``move(place, keys, points)``: where nodes (n,) are in place of points (n, d); place (m,) has those of the parts
        of all cells, one after the other.
    cells : ndarray (n_cells,) int64, optional
        Values of the cells, which their parts have.
    """
    d, used, groups = mesh.dim, [np.unique(part.table) for part in parts], bits(mesh.node_groups, len(mesh.points))
    names = list(mesh.node_groups)
    empty = [np.zeros(0, np.uint64), *np.zeros((2, 0), np.int64), np.zeros((0, width)), groups[:0]]
    columns = [[one] for one in empty]
    for part, some in zip(parts, used, strict=True):
        block = mesh.blocks[part.block]
        nodes, there = block.nodes[part.rows], part.old >= 0
        own = np.where(there[:, None], groups[nodes][:, part.old], 0)
        for name, edges in mesh.edge_groups.items():
            column, bit = divmod(names.index(name), COLUMN)
            for pair, places, _ in part.edges:
                own[np.ix_(_on_edge(mesh, nodes, pair, edges), places, [column])] |= np.int64(1) << np.int64(bit)
        found = (part.keys, np.where(there, mesh.file_nodes[nodes][:, part.old], -1),
                 np.broadcast_to(block.ids[part.rows, None], part.keys.shape), part.values, own)  # fmt: skip
        for rows, one, none in zip(columns, found, empty, strict=True):
            rows.append(one[:, some].reshape(len(part.rows) * len(some), *none.shape[1:]))
    keys, numbers, owners, values, members = (np.concatenate(rows) for rows in columns)
    chosen, place = distinct(keys, ties=(owners,))
    values = values[chosen]
    if move is not None:
        values[:, :d] = move(place, keys[chosen], values[:, :d])
    rows = np.column_stack([owners[chosen], values.view(np.int64), members[chosen]])
    home, new_ids = number_nodes(exchanger, mesh, numbers[chosen], keys[chosen], rows, fewer=True)

    starts, end, first = mesh.starts, 0, 0
    none = np.zeros(0, np.int64)
    tables, row, child, own_ids = [[np.zeros((0, n), np.int64)] for _, n in layout], [none], [none], []
    counts, begin, kind = np.zeros((3, starts[-1]), dtype=np.int64)
    for k, (part, some) in enumerate(zip(parts, used, strict=True)):
        size, of_mesh, count = len(part.rows) * len(some), starts[part.block] + part.rows, len(part.table)
        own, end = place[end : end + size].reshape(len(part.rows), len(some)), end + size
        own_ids.append(new_ids[own])
        new = home.places[:, 0][own[:, np.searchsorted(some, part.table)]]
        tables[part.block if len(layout) > 1 else 0].append(new.reshape(-1, part.table.shape[1]))
        counts[of_mesh], kind[of_mesh], begin[of_mesh] = count, k, first + count * np.arange(len(of_mesh))
        first += count * len(of_mesh)
        row.append(np.repeat(of_mesh, count))
        child.append(np.tile(np.arange(count), len(of_mesh)))
    row, child = np.concatenate(row), np.concatenate(child)
    start, n_cells = first_numbers(exchanger, mesh, mesh.of_cells("ids"), counts)
    table = home.table[:, 1:]
    real = np.ascontiguousarray(table[:, :width]).view(np.float64)
    piece = MeshSlice(
        mesh.comm, None, d, degree, mesh.curved,
        [SliceBlock(cell, np.concatenate(some)) for (cell, _), some in zip(layout, tables, strict=True)],
        start[row] + child, mesh.of_cells("body")[row], mesh.of_cells("components")[row],
        np.ascontiguousarray(real[:, :d]), home.starts, home.total, n_cells, mesh.n_components, node_ids=home.numbers,
        node_values=np.ascontiguousarray(real[:, d:]).view(np.int64),
        cell_values=None if cells is None else cells[row][:, None],
    )  # fmt: skip
    piece.name_as(mesh, row, table[:, width:])
    for name, facets in mesh.facet_groups.items():
        found = [np.zeros((0, 2), dtype=np.int64)]
        for one in facets:
            of_mesh = starts[one.block] + one.cells
            for k, local in np.unique(np.column_stack([kind[of_mesh], one.local]), axis=0).tolist():
                on_it = parts[k].facets[local]
                some = begin[of_mesh[(kind[of_mesh] == k) & (one.local == local)]]
                at = np.empty((len(some), len(on_it), 2), dtype=np.int64)
                at[:, :, 0], at[:, :, 1] = some[:, None] + on_it[:, 0], on_it[:, 1]
                found.append(at.reshape(-1, 2))
        piece.facet_groups[name] = tuple(np.concatenate(found).T)
    for name, edges in mesh.edge_groups.items():
        found = [np.zeros((0, 2), dtype=np.int64)]
        for part, some, ids in zip(parts, used, own_ids, strict=True):
            nodes = mesh.blocks[part.block].nodes[part.rows]
            for pair, _, inner in part.edges:
                ends = ids[_on_edge(mesh, nodes, pair, edges)][:, np.searchsorted(some, np.array(inner))]
                found.append(ends.reshape(-1, 2))
        piece.edge_groups[name] = np.concatenate(found)
    return piece


def _on_edge(mesh, nodes, pair, edges):
    """Tell which cells (n, n_nodes) have an edge, by local vertices, that is among some (m, 2), by their numbers."""
    return among(mesh.file_nodes[nodes[:, list(pair)]], edges, mesh.n_nodes_total)


class Neighbours:
    """The ranks that share nodes with this one. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    numbers : ndarray (n,)
        Of the nodes of this rank.
    n_total : int
        Numbers are below it.

    Attributes
    ----------
    ranks : ndarray
        Ascending.
    shared : ndarray (n,) uint64
        Bits of the neighbours that have a node.
    """

    def __init__(self, exchanger, numbers, n_total):
        self._exchanger = exchanger
        size = exchanger.comm.size
        self.shared = np.zeros(len(numbers), dtype=np.uint64)
        self.ranks = np.zeros(0, dtype=np.int64)
        if size == 1:
            return
        rows = exchanger.sharers(numbers * size // max(n_total, 1), numbers)
        self.ranks = np.unique(rows[:, 1])
        bit = np.minimum(np.searchsorted(self.ranks, rows[:, 1]), BITS - 1).astype(np.uint64)
        np.bitwise_or.at(self.shared, rows_of(numbers, rows[:, 0]), np.uint64(1) << bit)

    def tell(self, keys, shared):
        """Send keys (n,) uint64 to the neighbours whose bits are set; those that came, in one array. *Collective.*"""
        sends = {}
        for k, rank in enumerate(self.ranks):
            wanted = (shared >> np.uint64(min(k, BITS - 1))) & np.uint64(1) == 1
            if wanted.any():
                sends[int(rank)] = keys[wanted].view(np.int64)
        heard = self._exchanger(sends, np.int64, 1)
        return np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in heard.values())]).view(np.uint64)


@dataclass
class Origin:
    """Origin of the cells and nodes of a refined mesh; of this rank's, all blocks one after the other.

    Attributes
    ----------
    base : pcontact.mesh.mesh.Mesh
        The mesh of the file, dealt in another way.
    cells : ndarray (n_cells,) int64
        Numbers of the cells of the base.
    path : ndarray (n_cells,) uint64
    level : ndarray (n_cells,) int64
        See `pcontact.mesh.refinement.simplices` and `pcontact.mesh.refinement.numbering`.
    keys : ndarray (n_nodes,) uint64
        Of the nodes, see `pcontact.mesh.refinement.simplices`.
    """

    base: object
    cells: np.ndarray
    path: np.ndarray
    level: np.ndarray
    keys: np.ndarray


def first_origin(base):
    """The origin of a mesh that has not been refined."""
    cells = base.of_cells("ids")
    zero = np.zeros(len(cells), dtype=np.int64)
    return Origin(base, cells, zero.view(np.uint64), zero, mixed(base.file_nodes))


def to_base(exchanger, base, cells, table):
    """Rows of a table that belong to cells of the base, on the ranks that have these. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    base : pcontact.mesh.mesh.Mesh
    cells : ndarray (n,) int64
        Numbers of cells of the base.
    table : ndarray (n, k) int64

    Returns
    -------
    rows : ndarray (m,)
        Of the cells of the base here, all blocks one after the other; ascending.
    table : ndarray (m, k) int64
    """
    size, n = exchanger.comm.size, max(base.n_cells_total, 1)
    own = base.of_cells("ids")
    # a third rank knows who has a cell
    known = exchanger.deliver(own * size // n, np.column_stack([own, np.full(len(own), exchanger.comm.rank)]))
    rows = exchanger.deliver(cells * size // n, np.column_stack([cells, table]))
    rows = exchanger.deliver(known[rows_of(known[:, 0], rows[:, 0]), 1], rows)
    at = rows_of(own, rows[:, 0])
    order = np.argsort(at, kind="stable")
    return at[order], rows[order, 1:]


def values_by_key(exchanger, keys, values, wanted):
    """Values of nodes that are known on any rank. *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    keys, values : ndarray (n,) uint64, (n, k) int64
        What this rank knows.
    wanted : ndarray (m,) uint64

    Returns
    -------
    known : ndarray (m,) of bool
    values : ndarray (m, k) int64
    """
    homes = (home_of_key(some, exchanger.comm.size) for some in (keys, wanted))
    return exchanger.look_up((next(homes), keys.view(np.int64)), values, (next(homes), wanted.view(np.int64)))
