"""The traction of a source of linear elasticity."""

import numpy as np

from pcontact.contact.points import no_excess
from pcontact.runtime.jit import njit, njit_inner


@njit
def traction_operator(points, grad, volumetric, facet, mu, normal_x, normal, out):
    """b (np, nn, d) of some points: derivative of the normal component of the elastic boundary traction.

    Parameters
    ----------
    points : ndarray (n,)
        Those whose rows of ``out`` are written.
    grad : ndarray (np, nn, d)
        Shape gradients of the parent cell [1/length].
    volumetric : ndarray (np, nn, d)
        Volumetric operator P of the parent cell, lam G in plane strain [stress/length].
    facet : ndarray (np,)
    mu : ndarray (nf,)
        Shear modulus [stress].
    normal_x : ndarray (np, d)
        Outward normal of the source facet.
    normal : ndarray (np, d)
        Contact normal.
    out : ndarray (np, nn, d)
        (n_X . n) P_a + mu ((G_a . n_X) n + (G_a . n) n_X) [stress/length].
    """
    d = grad.shape[2]
    for k in range(len(points)):
        p = points[k]
        shear = mu[facet[p]]
        cosine = 0.0
        for i in range(d):
            cosine += normal_x[p, i] * normal[p, i]
        for a in range(grad.shape[1]):
            along_x = 0.0
            along_n = 0.0
            for i in range(d):
                along_x += grad[p, a, i] * normal_x[p, i]
                along_n += grad[p, a, i] * normal[p, i]
            for i in range(d):
                out[p, a, i] = cosine * volumetric[p, a, i] + shear * (
                    along_x * normal[p, i] + along_n * normal_x[p, i]
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

    def normal_operator(self, normal, last):
        """Operator of the normal traction (np, nn, d); most normals are as they were: of obstacles, without partner.

        Parameters
        ----------
        normal : ndarray (np, d)
            Contact normals.
        last : pcontact.contact.pairing.Pairing or None
            Of the last search, whose operator is overwritten.
        """
        source = self.source
        if last is None:
            b, turned = np.empty_like(source.grad), np.arange(len(normal))
        else:
            b, turned = last.b, np.flatnonzero((normal != last.normal).any(axis=1))
        traction_operator(turned, source.grad, source.volumetric, source.facet, source.mu, source.normal, normal, b)
        return b

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
