"""Pressure on deformed facets: forces and their derivative at the places of the nodes.

A facet has the tangents t_i = x,i of its deformed surface at a point, and c = (t_y, -t_x) in the plane, t_1 x t_2 in
space: the outward normal times the deformed area per reference area. With a pressure p > 0 in compression

    R_a = p int N_a c,    K_ab = p int N_a dc/du_b;

with axial symmetry c is 2 pi r times that of the plane, r the deformed radius.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.runtime.jit import njit


class Facets(NamedTuple):
    """Facets of one kind and their quadrature points.

    Attributes
    ----------
    nodes : ndarray (nf, nn) int64
    radius : ndarray (nf, nq)
        Reference radius with axial symmetry [length].
    tangents : ndarray (nf, nq, d - 1, d)
        X,i of the reference surface [length].
    shape : ndarray (nq, nn)
    slope : ndarray (nq, nn, d - 1)
        Shape functions of the displacement on the facet, and their reference gradients.
    weights : ndarray (nf, nq)
        Of the quadrature, times what the pressure is there at factor 1 [stress].
    """

    nodes: np.ndarray
    radius: np.ndarray
    tangents: np.ndarray
    shape: np.ndarray
    slope: np.ndarray
    weights: np.ndarray


@njit
def add_forces(facets, u, pressure, ring, absolute, out):
    """Add the forces of facets to their nodes.

    Parameters
    ----------
    facets : Facets
    u : ndarray (n, d)
        Displacement of the nodes [length].
    pressure : float
        Factor of the pressure.
    ring : bool
        With axial symmetry.
    absolute : bool
        Magnitudes of the terms instead.
    out : ndarray (n, d)
        Added in place [force].
    """
    d = u.shape[1]
    c, t = np.zeros(d), np.zeros((d - 1, d))
    for f in range(facets.nodes.shape[0]):
        for q in range(facets.weights.shape[1]):
            radius = facets.radius[f, q]
            for i in range(d - 1):
                for j in range(d):
                    t[i, j] = facets.tangents[f, q, i, j]
            for a in range(facets.nodes.shape[1]):
                node = facets.nodes[f, a]
                radius += facets.shape[q, a] * u[node, 0]
                for i in range(d - 1):
                    for j in range(d):
                        t[i, j] += facets.slope[q, a, i] * u[node, j]
            if d == 2:
                c[0], c[1] = t[0, 1], -t[0, 0]
            else:
                for j in range(3):
                    k, m = (j + 1) % 3, (j + 2) % 3
                    c[j] = t[0, k] * t[1, m] - t[0, m] * t[1, k]
            weight = pressure * facets.weights[f, q] * (2.0 * np.pi * radius if ring else 1.0)
            for a in range(facets.nodes.shape[1]):
                for j in range(d):
                    term = weight * facets.shape[q, a] * c[j]
                    out[facets.nodes[f, a], j] += abs(term) if absolute else term


@njit
def add_stiffness(facets, u, pressure, ring, rowptr, columns, values):
    """Add the derivative of :func:`add_forces` to block rows.

    Parameters
    ----------
    facets, u, pressure, ring : see :func:`add_forces`
    rowptr, columns : ndarray
        Pattern over the nodes.
    values : ndarray (nnz, d, d)
        Added in place [force / length].
    """
    d, nn = u.shape[1], facets.nodes.shape[1]
    t, block = np.zeros((d - 1, d)), np.zeros((d, d))
    for f in range(facets.nodes.shape[0]):
        for q in range(facets.weights.shape[1]):
            radius = facets.radius[f, q]
            for i in range(d - 1):
                for j in range(d):
                    t[i, j] = facets.tangents[f, q, i, j]
            for a in range(nn):
                node = facets.nodes[f, a]
                radius += facets.shape[q, a] * u[node, 0]
                for i in range(d - 1):
                    for j in range(d):
                        t[i, j] += facets.slope[q, a, i] * u[node, j]
            weight = pressure * facets.weights[f, q]
            for b in range(nn):
                block[:, :] = 0.0
                if d == 2:
                    size = facets.slope[q, b, 0] * (2.0 * np.pi * radius if ring else 1.0)
                    block[0, 1], block[1, 0] = size, -size
                    if ring:
                        block[0, 0] += 2.0 * np.pi * facets.shape[q, b] * t[0, 1]
                        block[1, 0] -= 2.0 * np.pi * facets.shape[q, b] * t[0, 0]
                else:
                    # dc = N_b,1 du x t_2 + N_b,2 t_1 x du = w x du
                    for j in range(3):
                        k, m = (j + 1) % 3, (j + 2) % 3
                        w = facets.slope[q, b, 1] * t[0, j] - facets.slope[q, b, 0] * t[1, j]
                        block[m, k] = w
                        block[k, m] = -w
                for a in range(nn):
                    row = facets.nodes[f, a]
                    place = find(columns, rowptr[row], rowptr[row + 1], facets.nodes[f, b])
                    for i in range(d):
                        for j in range(d):
                            values[place, i, j] += weight * facets.shape[q, a] * block[i, j]
