"""What a refined mesh remembers of the mesh it was made from, and how the base hears of it to be refined again."""

from dataclasses import dataclass

import numpy as np

from pcontact.mesh.refinement.keys import home_of_key, vertex_keys


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
        See `pcontact.mesh.refinement.simplices` and `pcontact.mesh.refinement.grids`.
    keys : ndarray (n_nodes,) uint64
        Of the nodes, see `pcontact.mesh.refinement.keys`.
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
