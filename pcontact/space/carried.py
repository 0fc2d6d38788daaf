"""Values at nodes, taken from the ranks that had them to those that own the nodes of another space."""

import numpy as np


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
    size, total = space.comm.size, max(space.mesh.n_nodes_total, 1)
    own = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.int64)
    known, found = space.exchanger.look_up((keys * size // total, keys), bits, (own * size // total, own))
    return np.where(known[:, None], np.ascontiguousarray(found).view(np.float64), 0.0)
