"""The outer surface of all bodies: the facets that one cell alone has."""

import numpy as np

from pcontact.element.reference import facet_kinds, facet_nodes
from pcontact.mesh.mesh import Facets
from pcontact.runtime.jit import njit


def mixed(numbers):
    """Numbers (n,) as 64 bits that look like random ones (S. Vigna's splitmix64)."""
    z = np.asarray(numbers).astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def once(keys):
    """Which of some keys (n,) are there once: ndarray (n,) of bool.

    Keys are random numbers already: each goes to the place of a table that its last bits name, or to the next that is
    free. That takes a tenth of the time of sorting.
    """
    keys = np.ascontiguousarray(keys).view(np.uint64)
    single = np.ones(len(keys), dtype=np.bool_)
    # two places for each key at least; -1 is free
    table = np.full(2 << max(len(keys), 1).bit_length(), -1, dtype=np.int64)
    _mark_repeated(keys, table, single)
    return single


@njit
def _mark_repeated(keys, table, single):
    last = len(table) - 1
    for k in range(len(keys)):
        place = np.int64(keys[k] & np.uint64(last))
        while table[place] >= 0 and keys[table[place]] != keys[k]:
            place = (place + 1) & last
        if table[place] < 0:
            table[place] = k
        else:
            single[table[place]] = False
            single[k] = False


def outer_facets(mesh, exchanger, of_bodies=False):
    """Facets of this rank's cells that no other cell of any rank has. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    exchanger : pcontact.runtime.parallel.Exchanger
    of_bodies : bool
        Those that no other cell of the same body has: with them facets that two bodies share, for either of them.

    Returns
    -------
    list of Facets

    Notes
    -----
    A facet is known by the sum of its vertices' mixed numbers: no sorting, and 64 bits are enough for billions of
    facets. What is single on this rank is asked for at the rank that its key falls to; that is the surface of the part,
    not its volume.
    """
    keys, owners = [np.zeros(0, dtype=np.uint64)], []
    for number, block in enumerate(mesh.blocks):
        for kind, rows in facet_kinds(block.cell):
            table = facet_nodes(kind, 1)[rows]
            with np.errstate(over="ignore"):
                marks = mixed(mesh.file_nodes)[block.nodes[:, table]].sum(axis=2)
            if of_bodies:
                marks ^= mixed(np.array([block.body]))
            keys.append(marks.ravel())
            owners.append((number, kind, rows, len(marks)))
    keys = np.concatenate(keys)
    outer = once(keys)
    chosen = np.flatnonzero(outer)
    outer[chosen] = _nowhere_else(exchanger, keys[chosen])
    result, first = [], 0
    for number, kind, rows, n_cells in owners:
        part = outer[first : first + n_cells * len(rows)].reshape(n_cells, len(rows))
        first += part.size
        cells, local = np.nonzero(part)
        if len(cells):
            result.append(Facets(number, kind, cells, rows[local]))
    return result


def _nowhere_else(exchanger, keys):
    """Which of some keys (n,) no other rank has. *Collective.*"""
    home = (keys % np.uint64(exchanger.comm.size)).astype(np.int64)
    single = exchanger.ask(home, keys.view(np.int64)[:, None], lambda rows: once(rows[:, 0])[:, None].astype(np.int64))
    return single[:, 0] > 0
