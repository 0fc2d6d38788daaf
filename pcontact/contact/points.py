"""The two sides of a contact pair as kernels take them: tuples of arrays."""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit


class SourcePoints(NamedTuple):
    """Quadrature points (np) of a source with nf facets, whose parent cells have nn nodes.

    Attributes
    ----------
    facet : ndarray (np,)
        Facet of each point.
    cells : ndarray (nf, nn)
        Nodes of the parent cells, numbers into the values (n, d) that the kernels are given.
    shape : ndarray (np, nn)
        Shape functions of the parent cell.
    jxw : ndarray (np,)
        Quadrature weight times area element [length^(d-1)].
    normal : ndarray (np, d)
        Outward normal of the facet.
    grad, volumetric : ndarray (np, nn, d)
        Shape gradients [1/length] and volumetric operator [stress/length]; of width 0 where the source has no traction.
    mu : ndarray (nf,)
        Shear modulus [stress].
    """

    facet: np.ndarray
    cells: np.ndarray
    shape: np.ndarray
    jxw: np.ndarray
    normal: np.ndarray
    grad: np.ndarray
    volumetric: np.ndarray
    mu: np.ndarray


class PartnerPoints(NamedTuple):
    """Partners of the points of a source, on facets with m nodes; of width 0 for a rigid obstacle.

    Attributes
    ----------
    nodes : ndarray (np, nt)
        Nodes of the partner's facet, and of its cell where that has a part in the traction, numbers into the values
        that the kernels are given.
    shape : ndarray (np, m)
        Shape functions there, of the nodes of the facet, the first ones.
    normal : ndarray (np, d)
        Contact normal, from source to target.
    gap0 : ndarray (np,)
        Gap at zero displacement of the frozen linear gap [length].
    """

    nodes: np.ndarray
    shape: np.ndarray
    normal: np.ndarray
    gap0: np.ndarray


class TractionOperator(NamedTuple):
    """Derivative of the traction at the points, in the m directions in which tractions count.

    Attributes
    ----------
    axes : ndarray (1 or np, m, d)
        Unit vectors, the same for all points where there is one row.
    normal : ndarray (np, m)
        Contact normals along them.
    rows : ndarray (np, nr, m, d)
        By displacements of the nodes of the parent cell, then those of the partner; nr may be 0, or lack the latter
        [stress/length].
    width : ndarray (np,)
        How many of these nodes have something to say, or would have.
    """

    axes: np.ndarray
    normal: np.ndarray
    rows: np.ndarray
    width: np.ndarray


class Excess(NamedTuple):
    """Addend of the derivative of the traction in cells that yield, or are orthotropic.

    See `pcontact.contact.traction`.

    Attributes
    ----------
    at : ndarray (np,)
        Row of each point in ``rows``, -1 where the cell is elastic and isotropic; of length 0 where all cells are.
    rows : ndarray (n, nn or nr, m, d)
        In the directions of a `TractionOperator`, by displacements of as many of its nodes [stress/length].
    adjoint : int
        The adjoint operator has the rows from this one on, too.
    """

    at: np.ndarray
    rows: np.ndarray
    adjoint: int


def no_excess(n_nodes, d):
    """The :class:`Excess` of cells of n_nodes nodes that cannot yield."""
    return Excess(np.zeros(0, dtype=np.int64), np.zeros((0, n_nodes, d, d)), 0)


@njit
def interpolate(values, cells, facet, shape, out):
    """Nodal values (n, d) at the points: out (np, d)."""
    d = values.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        for i in range(d):
            out[p, i] = 0.0
        for a in range(shape.shape[1]):
            node = cells[f, a]
            for i in range(d):
                out[p, i] += shape[p, a] * values[node, i]
