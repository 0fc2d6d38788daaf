"""Numbers of nodes and cells that do not depend on the ranks: every node has a home, known by its number or key."""

from typing import NamedTuple

import numpy as np

from pcontact.mesh.refinement.keys import home_of_key


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
