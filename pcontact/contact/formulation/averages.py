"""Local means of what quadrature points hold: what of it the displacements of the bodies can feel.

The mean of a node is that of the points around it, weighted with their areas and with the size of its shape function. A
point takes the mean of the nodes around it, weighted with that size. Weights are positive and add up to one: what is
uniform is kept, nothing grows, and what changes from point to point is taken away.
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit_inner


@njit_inner
def add_at_nodes(weight, nodes, facet, density, out):
    """Add weight (np, m) times density (np, d) at the nodes (nf, m) of the facet of each point to ``out`` (n, d)."""
    for p in range(len(facet)):
        for a in range(nodes.shape[1]):
            for i in range(density.shape[1]):
                out[nodes[facet[p], a], i] += weight[p, a] * density[p, i]


class Acting(NamedTuple):
    """Values that act at the points of a source.

    Attributes
    ----------
    pairing : pcontact.contact.pair.Pairing
    source : pcontact.contact.surface.sides.SourceSurface
    values : ndarray (np, d)
    chosen : ndarray (np,) of bool
        Points that count.
    target_shape : ndarray (np, m)
        Shape functions of the partners' facets where the partners are.
    """

    pairing: object
    source: object
    values: np.ndarray
    chosen: np.ndarray
    target_shape: np.ndarray


class _Around(NamedTuple):
    """Nodes around the points: share (np, m) of each, nodes (n, m), the row (np,) of ``nodes`` of each point, and
    whether what acts at a point acts there (1.0) or its reaction (-1.0).
    """

    share: np.ndarray
    nodes: np.ndarray
    row: np.ndarray
    sign: float


def _around(part, both):
    """The nodes of the source around the points of an :class:`Acting` and, of `both` sides, those of the target."""
    pairing, source = part.pairing, part.source
    # shape functions of degree 2 change their sign
    sides = [_Around(np.abs(source.shape), pairing.cells, source.facet, 1.0)]
    if both:
        sides.append(_Around(np.abs(part.target_shape), pairing.targets, np.arange(len(source.facet)), -1.0))
    return sides


def _at_nodes(space, parts, arounds):
    """Means at the nodes of all parts, a distributed vector. *Collective.*"""
    sums, weights = space.vector(), space.vector()
    for part, sides in zip(parts, arounds, strict=True):
        area = np.where(part.chosen, part.source.jxw, 0.0)[:, None]
        for total, density in ((sums, part.values), (weights, None)):
            local = np.zeros((len(part.pairing.exchange.nodes), space.dim))
            for share, nodes, row, sign in sides:
                values = np.ones_like(part.values) if density is None else sign * density
                add_at_nodes(area * share, nodes, row, values, local)
            part.pairing.exchange.add(local, total)
    weight = weights.getArray(readonly=True)
    sums.setArray(sums.getArray(readonly=True) / np.where(weight > 0.0, weight, 1.0))
    weights.destroy()
    return sums


def local_means(space, parts, both=False):
    """Means of values over the patches of the nodes, interpolated to the points. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of Acting
        One, or the two halves of unbiased contact.
    both : bool
        Whether each point counts on both sides, at the nodes of its source with its value and at those of its partner's
        facet with the negative one, and takes the mean of the two.

    Returns
    -------
    list of ndarray (np, d)
        For each part at all points; where `both`, they have a meaning at points with a partner.
    """
    arounds = [_around(part, both) for part in parts]
    total, means = _at_nodes(space, parts, arounds), []
    for part, sides in zip(parts, arounds, strict=True):
        nodal, mean = part.pairing.exchange.gather(total), np.zeros_like(part.values)
        for share, nodes, row, sign in sides:
            whole = share.sum(axis=1)
            own = np.einsum("pa,pad->pd", share, nodal[nodes[row]])
            mean += sign / len(sides) * own / np.where(whole > 0.0, whole, 1.0)[:, None]
        means.append(mean)
    total.destroy()
    return means


def patch_means(space, pairing, source, values, chosen):
    """Means of values (np, d) of a source of which some points (np,) are chosen, see :func:`local_means`. *Collective.*

    Returns
    -------
    ndarray (np, d)
        At all points.
    """
    return local_means(space, [Acting(pairing, source, values, chosen, pairing.target_shape)])[0]
