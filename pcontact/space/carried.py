"""Values at nodes, taken from the ranks that had them to those that own the nodes of another space."""

import numpy as np

from pcontact.runtime.parallel import split_by_rank


def carried(space, keys, values):
    """Values at the owned nodes of a space. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    keys : ndarray (n,)
        Numbers of nodes of the mesh file, each on one rank.
    values : ndarray (n, k)
        At these nodes.

    Returns
    -------
    ndarray (n_owned, k)
        Zero at nodes of which no rank has a value.
    """
    size, total, width = space.comm.size, max(space.mesh.n_nodes_total, 1), values.shape[1]
    sends, order = split_by_rank(keys * size // total, keys)
    heard = space.exchanger(sends, np.int64, 1)
    tables, _ = split_by_rank(keys * size // total, values)
    heard_values = space.exchanger(tables, np.float64, width)
    known = np.concatenate([np.zeros(0, dtype=np.int64), *(heard[rank].ravel() for rank in heard)])
    table = np.concatenate([np.zeros((0, width)), *(heard_values[rank] for rank in heard)])
    order = np.argsort(known)
    known, table = known[order], np.vstack([table[order], np.zeros((1, width))])

    own = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]
    sends, order = split_by_rank(own * size // total, own)
    replies = {}
    for rank, asked in space.exchanger(sends, np.int64, 1).items():
        asked = asked.ravel()
        at = np.searchsorted(known, asked)
        found = at < len(known)
        found[found] = known[at[found]] == asked[found]
        replies[rank] = table[np.where(found, at, len(known))]
    answer = space.exchanger(replies, np.float64, width)
    result = np.zeros((len(own), width))
    result[order] = np.concatenate([np.zeros((0, width)), *(answer[rank] for rank in sorted(sends))])
    return result
