"""Local means of what quadrature points hold: what of it the displacement of the source can feel."""

import numpy as np

from pcontact.runtime.jit import njit_inner


@njit_inner
def add_at_nodes(weight, nodes, facet, density, out):
    """Add weight (np, m) times density (np, d) at the nodes (nf, m) of the facet of each point to ``out`` (n, d)."""
    for p in range(len(facet)):
        for a in range(nodes.shape[1]):
            for i in range(density.shape[1]):
                out[nodes[facet[p], a], i] += weight[p, a] * density[p, i]


def patch_means(space, pairing, source, values, chosen):
    """Means of values over the patches of the nodes, interpolated to the points. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pairing : pcontact.contact.pairing.Pairing
    source : pcontact.contact.surface.SourceSurface
    values : ndarray (np, d)
    chosen : ndarray (np,) of bool
        Points that count.

    Returns
    -------
    ndarray (np, d)
        At all points.
    """
    # shape functions of degree 2 change their sign
    share = np.abs(source.shape)
    weight = share * np.where(chosen, source.jxw, 0.0)[:, None]
    sums = []
    for density in (values, np.ones_like(values)):
        local = np.zeros((len(pairing.exchange.nodes), space.dim))
        add_at_nodes(weight, pairing.cells, source.facet, density, local)
        total = space.vector()
        pairing.exchange.add(local, total)
        sums.append(pairing.exchange.gather(total))
        total.destroy()
    mean = sums[0] / np.where(sums[1] > 0.0, sums[1], 1.0)
    return np.einsum("pa,pad->pd", share, mean[pairing.cells[source.facet]]) / share.sum(axis=1)[:, None]
