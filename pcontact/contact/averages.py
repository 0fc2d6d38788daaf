"""Local means of what quadrature points hold: what of it the displacement of the source can feel."""

import numpy as np


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
    nodes = pairing.cells[source.facet]
    # shape functions of degree 2 change their sign
    share = np.abs(source.shape)
    weight = share * np.where(chosen, source.jxw, 0.0)[:, None]
    sums = []
    for density in (values, np.ones_like(values)):
        local = np.zeros((len(pairing.exchange.nodes), space.dim))
        np.add.at(local, nodes, weight[:, :, None] * density[:, None, :])
        total = space.vector()
        pairing.exchange.add(local, total)
        sums.append(pairing.exchange.gather(total))
        total.destroy()
    mean = sums[0] / np.where(sums[1] > 0.0, sums[1], 1.0)
    return np.einsum("pa,pad->pd", share, mean[nodes]) / share.sum(axis=1)[:, None]
