"""Numbers of nodes and cells that do not depend on the ranks: every node has a home, known by its number or key.

Which other ranks have a node, and what ranks tell each other of the edges they cut.

What a refined mesh remembers of the mesh it was made from, and how the base hears of it to be refined again.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcontact.mesh.refinement.simplices import home_of_key, vertex_keys
from pcontact.runtime.parallel import split_by_rank

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
    by_name = np.lexsort((*table[:, 2:3].T, table[:, 1], table[:, 0]))
    ordered = table[by_name]
    first = np.ones(len(table), dtype=bool)
    first[1:] = np.any(ordered[1:, :2] != ordered[:-1, :2], axis=1)
    index = np.empty(len(table), dtype=np.int64)
    index[by_name] = np.cumsum(first) - 1
    ordered = ordered[first]
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


def distinct(keys, owners):
    """Which of equal keys (n,) counts, that of the least owner (n,): places (m,) of those; and among them that of each
    key (n,)."""
    order = np.lexsort((owners, keys))
    first = np.ones(len(keys), dtype=bool)
    first[1:] = keys[order][1:] != keys[order][:-1]
    place = np.empty(len(keys), dtype=np.int64)
    place[order] = np.cumsum(first) - 1
    return order[first], place


def among(ends, edges, n):
    """Which pairs (m, 2) of numbers below n are among others (k, 2), in any order."""
    return np.isin(ends.min(axis=1) * n + ends.max(axis=1), edges.min(axis=1) * n + edges.max(axis=1))


def facets_of_parts(first, on_it):
    """Facets (n k, 2) of the parts of cells, by the rows of the parts and their local facets.

    Parameters
    ----------
    first : ndarray (n,) of int
        Row of the first part of each cell.
    on_it : ndarray (k, 2) of int
        Parts of a cell and their facets that lie on one of its own.
    """
    found = np.empty((len(first), len(on_it), 2), dtype=np.int64)
    found[:, :, 0], found[:, :, 1] = first[:, None] + on_it[:, 0], on_it[:, 1]
    return found.reshape(-1, 2)


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
        sends, _ = split_by_rank(numbers * size // max(n_total, 1), numbers)
        heard = exchanger(sends, np.int64, 1)
        told = exchanger(_several(heard), np.int64, 2)
        rows = np.concatenate([np.zeros((0, 2), dtype=np.int64), *told.values()])
        self.ranks = np.unique(rows[:, 1])
        bit = np.minimum(np.searchsorted(self.ranks, rows[:, 1]), BITS - 1).astype(np.uint64)
        order = np.argsort(numbers, kind="stable")
        at = order[np.searchsorted(numbers, rows[:, 0], sorter=order)]
        np.bitwise_or.at(self.shared, at, np.uint64(1) << bit)

    def tell(self, keys, shared):
        """Send keys (n,) uint64 to the neighbours whose bits are set; those that came, in one array. *Collective.*"""
        sends = {}
        for k, rank in enumerate(self.ranks):
            wanted = (shared >> np.uint64(min(k, BITS - 1))) & np.uint64(1) == 1
            if wanted.any():
                sends[int(rank)] = keys[wanted].view(np.int64)
        heard = self._exchanger(sends, np.int64, 1)
        return np.concatenate([np.zeros(0, np.int64), *(part.ravel() for part in heard.values())]).view(np.uint64)


def _several(heard):
    """Of numbers that several ranks have: number and other rank, for each of them."""
    if not heard:
        return {}
    numbers = np.concatenate([part.ravel() for part in heard.values()])
    ranks = np.concatenate([np.full(len(part), rank) for rank, part in heard.items()])
    order = np.lexsort((ranks, numbers))
    numbers, ranks = numbers[order], ranks[order]
    _, first, counts = np.unique(numbers, return_index=True, return_counts=True)
    rows = [np.zeros((0, 3), dtype=np.int64)]
    for count in np.unique(counts[counts > 1]):
        at = first[counts == count][:, None] + np.arange(count)
        for i in range(count):
            for j in range(count):
                if i != j:
                    rows.append(np.column_stack([ranks[at[:, i]], numbers[at[:, i]], ranks[at[:, j]]]))
    rows = np.concatenate(rows)
    return split_by_rank(rows[:, 0], rows[:, 1:])[0]


@dataclass
class Origin:
    """Where the cells and nodes of a refined mesh come from; of this rank's, all blocks one after the other.

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
    places : ndarray (n_nodes, d) or None
        Where the nodes are in the tree of cells [length]; None: where they are in the mesh.
    """

    base: object
    cells: np.ndarray
    path: np.ndarray
    level: np.ndarray
    keys: np.ndarray
    places: np.ndarray | None = None


def tree_points(mesh):
    """Where the nodes (n, d) of a mesh are in the tree of its cells, which a geometry does not bend [length]."""
    return mesh.points if mesh.origin is None or mesh.origin.places is None else mesh.origin.places


def marks(mesh):
    """A number (n_nodes,) between 0 and 1 of each node, the same on all meshes of one base."""
    keys = np.empty(len(mesh.points), dtype=np.uint64)
    if mesh.origin is None:
        vertex_keys(mesh.file_nodes, keys)
    else:
        keys[:] = mesh.origin.keys
    return (keys >> np.uint64(11)).astype(float) * 2.0**-53


def first_origin(base, keys):
    """The origin of a mesh that has not been refined."""
    cells = np.concatenate([block.ids for block in base.blocks])
    zero = np.zeros(len(cells), dtype=np.int64)
    return Origin(base, cells, zero.view(np.uint64), zero, keys)


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
    own = np.concatenate([np.zeros(0, dtype=np.int64), *(block.ids for block in base.blocks)])
    # a third rank knows who has a cell
    known = exchanger.deliver(own * size // n, np.column_stack([own, np.full(len(own), exchanger.comm.rank)]))
    rows = exchanger.deliver(cells * size // n, np.column_stack([cells, table]))
    order = np.argsort(known[:, 0])
    to = known[order[np.searchsorted(known[:, 0], rows[:, 0], sorter=order)], 1] if len(rows) else rows[:, 0]
    rows = exchanger.deliver(to, rows)
    order = np.argsort(own)
    at = order[np.searchsorted(own, rows[:, 0], sorter=order)] if len(rows) else rows[:, 0]
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
