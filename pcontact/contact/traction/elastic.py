"""The traction of a source of linear elasticity."""

from typing import NamedTuple

import numpy as np

from pcontact.contact.points import no_excess
from pcontact.runtime.jit import njit, njit_inner


class CellPoints(NamedTuple):
    """Points (np) on facets, of which the stress of the cell is asked for.

    Attributes
    ----------
    grad : ndarray (np, nn, d)
        Shape gradients of the cell [1/length].
    volumetric : ndarray (np, nn, d)
        Volumetric operator P, lam G in plane strain [stress/length].
    mu : ndarray (np,)
        Shear modulus [stress].
    normal : ndarray (np, d)
        Outward normal n_X of the facet.
    """

    grad: np.ndarray
    volumetric: np.ndarray
    mu: np.ndarray
    normal: np.ndarray


@njit
def fill_rows(points, cells, axes, factor, first, out):
    """Derivative of the components of the elastic boundary traction along directions e_k, at some points.

    Parameters
    ----------
    points : ndarray (n,)
        Those whose rows of ``out`` are written.
    cells : CellPoints
    axes : ndarray (1 or np, m, d)
        The directions.
    factor : ndarray (np,)
        What the traction is multiplied with.
    first : int
        Column of ``out`` with the first node of the cells.
    out : ndarray (np, nr, m, d)
        (n_X . e_k) P_a + mu ((G_a . n_X) e_k + (G_a . e_k) n_X) [stress/length].
    """
    grad, volumetric, normal, last = cells.grad, cells.volumetric, cells.normal, len(axes) - 1
    d = grad.shape[2]
    for n in range(len(points)):
        p = points[n]
        shear, e = factor[p] * cells.mu[p], axes[min(p, last)]
        for k in range(axes.shape[1]):
            cosine = 0.0
            for i in range(d):
                cosine += factor[p] * normal[p, i] * e[k, i]
            for a in range(grad.shape[1]):
                along_x, along_e = 0.0, 0.0
                for i in range(d):
                    along_x += grad[p, a, i] * normal[p, i]
                    along_e += grad[p, a, i] * e[k, i]
                for i in range(d):
                    out[p, first + a, k, i] = cosine * volumetric[p, a, i] + shear * (
                        along_x * e[k, i] + along_e * normal[p, i]
                    )


@njit_inner
def tractions(u, source, wanted, out):
    """Boundary traction t = sigma(u) n_X (np, d) [stress] of linear elasticity, sigma = (P . u) I + 2 mu eps.

    Parameters
    ----------
    u : ndarray (n, d)
    source : pcontact.contact.points.SourcePoints
    wanted : ndarray (np,) of bool
        The others get zero.
    out : ndarray (np, d)
    """
    facet, cells, grad, normal = source.facet, source.cells, source.grad, source.normal
    d = u.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        for i in range(d):
            out[p, i] = 0.0
        if not wanted[p]:
            continue
        bulk = 0.0
        for a in range(grad.shape[1]):
            node, along, across = cells[f, a], 0.0, 0.0
            for i in range(d):
                bulk += source.volumetric[p, a, i] * u[node, i]
                along += grad[p, a, i] * normal[p, i]
                across += u[node, i] * normal[p, i]
            for i in range(d):
                out[p, i] += source.mu[f] * (along * u[node, i] + across * grad[p, a, i])
        for i in range(d):
            out[p, i] += bulk * normal[p, i]


class ElasticTraction:
    """t = sigma(u) n_X of linear elasticity; zero where the operators of the source have width 0.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface

    Attributes
    ----------
    consistent : bool
        Whether the adjoint operator is the derivative of the traction, with its excess.
    jumps : bool
        Whether the adjoint operator jumps where cells yield.
    symmetric : bool
        Whether the derivative of the traction is its adjoint operator.
    """

    consistent = jumps = False
    symmetric = True

    def __init__(self, source):
        self.source = source

    def elastic(self, values, p, wanted):
        """The elastic part of the traction (np, d) at values (n, d), of the points that are wanted (np,)."""
        out = np.empty_like(self.source.x)
        tractions(values, p.source, wanted, out)
        return out

    def linear(self, values, p, wanted):
        """What is linear in the displacement, (np, d) at values (n, d), of the points that are wanted (np,)."""
        return self.elastic(values, p, wanted)

    def add_excess(self, values, p, traction):
        """Add what is in excess of linear elasticity to tractions (np, d)."""

    def add_normal_excess(self, values, p, traction):
        """The same along the contact normals (np,)."""

    def excess(self, values, p):
        """What it adds to the derivative of the traction, a :class:`pcontact.contact.points.Excess`."""
        return no_excess(self.source.shape.shape[1], self.source.x.shape[1])

    def add_adjoint(self, values, p, weights, out):
        """Add the excess of a consistent adjoint operator, tested with vectors (np, d), to nodal forces (n, d)."""

    def add_curvature(self, values, p, weights, blocks):
        """Add the derivative of :meth:`add_adjoint` at constant weights; returns how many entries had no place."""
        return 0
