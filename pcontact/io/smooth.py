"""Fields of cells averaged at the nodes."""

import numpy as np


class NodeMeans:
    """Volume-weighted means of the cells around every node, in each body for itself and over all ranks.

    Bodies that share nodes keep their own values there: the nodes are doubled.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Attributes
    ----------
    nodes : ndarray (n,)
        Local space node of every point that has means; each node once, in order, where bodies do not share any.
    cells : list of ndarray (nc, nn)
        For each block, points in place of local nodes.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, space):
        self._space = space
        self._layers, n_layers = _layers(space)
        self._point = np.full((n_layers, space.n_local), -1, dtype=np.int64)
        for layer, table in zip(self._layers, space.cells, strict=True):
            self._point[layer[:, None], table] = 0
        self._used = self._point == 0
        self._point[self._used] = np.arange(self._used.sum())
        self.nodes = np.nonzero(self._used)[1]
        tables = zip(self._layers, space.cells, strict=True)
        self.cells = [self._point[layer[:, None], table] for layer, table in tables]

    def __call__(self, fields, volumes):
        """Means of cell fields. *Collective.*

        Parameters
        ----------
        fields : dict of str to list of ndarray (nc,) or (nc, k)
            One array per block; the same names and k on every rank.
        volumes : list of ndarray (nc,)
            Volumes of the cells.

        Returns
        -------
        dict of str to ndarray (n,) or (n, k)
            At the points.
        """
        means, volume = {}, self._sums([v[:, None] for v in volumes])[:, 0]
        for name, blocks in fields.items():
            columns = [block if block.ndim == 2 else block[:, None] for block in blocks]
            mean = self._sums([v[:, None] * c for v, c in zip(volumes, columns, strict=True)]) / volume[:, None]
            means[name] = mean if any(block.ndim == 2 for block in blocks) else mean[:, 0]
        return means

    def _sums(self, blocks):
        """Sums (n, k) over the cells around the points, of values (nc, k)."""
        space, d = self._space, self._space.dim
        k = max((block.shape[1] for block in blocks), default=0)
        out = np.empty((len(self.nodes), k))
        for layer, used in enumerate(self._used):
            place = self._point[layer, used]
            # vectors have d values per node: a few columns at a time
            for first in range(0, k, d):
                local = self._local([block[:, first : first + d] for block in blocks], layer)
                width = min(d, k - first)
                out[place, first : first + width] = space.together(local)[used, :width]
        return out

    def _local(self, blocks, layer):
        """This rank's sums (n_local, d) of the cells of a layer."""
        space = self._space
        local = np.zeros((space.n_local, space.dim))
        for block, layers, table in zip(blocks, self._layers, space.cells, strict=True):
            rows = layers == layer
            nodes = table[rows].ravel()
            for column in range(block.shape[1]):
                values = np.repeat(block[rows, column], table.shape[1])
                local[:, column] += np.bincount(nodes, values, minlength=space.n_local)
        return local


def _layers(space):
    """Layer (nc,) of the cells of each block, and the number of layers. *Collective.*

    Bodies of one connected component may share nodes: each has its own layer.
    """
    blocks = space.mesh.blocks
    mine = {(int(c), block.body) for block in blocks for c in np.unique(block.components)}
    pairs = sorted(set().union(*space.comm.allgather(mine)))
    first = {component: number for number, (component, _) in reversed(list(enumerate(pairs)))}
    layer = {(component, body): number - first[component] for number, (component, body) in enumerate(pairs)}
    layers = []
    for block in blocks:
        table = np.zeros(space.mesh.n_components, dtype=np.int64)
        for component in np.unique(block.components).tolist():
            table[component] = layer[component, block.body]
        layers.append(table[block.components])
    return layers, max(layer.values(), default=0) + 1
