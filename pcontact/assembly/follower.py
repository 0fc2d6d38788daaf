"""The item of a pressure that follows the surface it acts on.

Pressure on deformed facets: forces and their derivative at the places of the nodes.

A facet has the tangents t_i = x,i of its deformed surface at a point, and c = (t_y, -t_x) in the plane, t_1 x t_2 in
space: the outward normal times the deformed area per reference area. With a pressure p > 0 in compression

    R_a = p int N_a c,    K_ab = p int N_a dc/du_b;

with axial symmetry c is 2 pi r times that of the plane, r the deformed radius.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.matrix import OwnedRows
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_nodes, shape, shape_gradient
from pcontact.runtime.jit import njit, njit_inner
from pcontact.runtime.parallel import together


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


@njit_inner
def _tangents(facets, u, f, q, t):
    """Write the present tangents (d - 1, d) at a point of a facet; its present radius."""
    d, radius = u.shape[1], facets.radius[f, q]
    for i in range(d - 1):
        for j in range(d):
            t[i, j] = facets.tangents[f, q, i, j]
    for a in range(facets.nodes.shape[1]):
        node = facets.nodes[f, a]
        radius += facets.shape[q, a] * u[node, 0]
        for i in range(d - 1):
            for j in range(d):
                t[i, j] += facets.slope[q, a, i] * u[node, j]
    return radius


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
            radius = _tangents(facets, u, f, q, t)
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
            radius = _tangents(facets, u, f, q, t)
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


# [-] Difference of two works that rounding errors explain, over the sum of all terms of the tangent. From: far above
# eps, far below what a rim that moves adds.
ROUNDING = 1e-10
# [-] Random displacements, over the mean length of facets. From: chosen; a rim moves, and no facet turns over.
SLIGHT = 0.05


def _facets(space, facets, among):
    """The facets of one block, and their quadrature points (nf, nq, d); nodes by their places among some, ascending."""
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    kind, (table, degree) = facets.kind, mesh.geometry_nodes(block)
    # exact: c has the degree of one shape function and a tangent, in space of one more tangent, in a ring of a radius
    xi, weights = quadrature(kind, 3 * max(space.degree, degree) - 1)
    nodes = table[facets.cells[:, None], facet_nodes(facets.cell, degree)[facets.local]]
    points = mesh.points[nodes]
    return Facets(
        np.searchsorted(among, space.facet_nodes(facets)),
        np.einsum("qa,fa->fq", shape(kind, degree, xi), points[:, :, 0]),
        np.einsum("qai,faj->fqij", shape_gradient(kind, degree, xi), points),
        shape(kind, space.degree, xi), np.ascontiguousarray(shape_gradient(kind, space.degree, xi)),
        np.tile(weights, (len(nodes), 1)),
    ), np.einsum("qa,fad->fqd", shape(kind, degree, xi), points)  # fmt: skip


class FollowerPressure(Item):
    """A pressure on the deformed surface, along its normal there.

    Parameters
    ----------
    space : pcontact.space.space.Space
    region : str
        Group of facets.
    pressure : pcontact.scene.functions.Prescribed
        At factor 1, positive in compression [stress], a function of the undeformed place.
    amplitude : pcontact.scene.amplitude.Amplitude
    fixed : ndarray (n_local, d)
        Flags of prescribed components.
    name : str

    Notes
    -----
    The constructor is *Collective*. The work that a pressure does on its way is that of the volume which the surface
    sweeps, and the tangent is symmetric, but for what the rim of the surface sweeps: where supports leave it nothing,
    or only ways within planes that it lies in.
    """

    def __init__(self, space, region, pressure, amplitude, fixed, name):
        self.space, self.name, self._pressure, self._amplitude = space, name, pressure, amplitude
        self._factor, self._ring, self._time = 0.0, space.axisymmetric, None
        groups = space.mesh.facet_groups.get(region, [])
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(space.facet_nodes(f).ravel() for f in groups)]))
        facets = [_facets(space, facets, nodes) for facets in groups]
        self._parts, self._points = [part for part, _ in facets], [points for _, points in facets]
        self._weights = [part.weights for part in self._parts]
        self._nodes = space.exchange(space.nodes[nodes])
        self._local = node_graph([part.nodes for part in self._parts], len(nodes))
        self._owned = OwnedRows(space.numbering, space.exchanger, space.nodes[nodes], *self._local)
        # that of a pressure that differs from place to place is not that of the volume swept alone
        self.symmetric = not pressure.varies and self._is_symmetric(nodes, fixed[nodes])
        if not pressure.varies:
            self._weigh(0.0)

    def _weigh(self, time):
        """The pressure at the points, at a time. *Collective* with expressions."""
        def at(points):
            return self._pressure(points.reshape(-1, points.shape[2]), time).reshape(points.shape[:2])

        if self._pressure.varies:
            values = together(self.space.comm, lambda: [at(points) for points in self._points])
        else:
            values = [at(points) for points in self._points]
        self._parts = [part._replace(weights=weights * value)
                       for part, weights, value in zip(self._parts, self._weights, values, strict=True)]  # fmt: skip

    def _is_symmetric(self, nodes, fixed):
        """Return whether two random displacements do the same work on each other's forces, at a third. *Collective.*"""
        space = self.space
        numbers = space.mesh.file_nodes[space.mesh_nodes[nodes]].astype(float)
        # the same on all ranks
        first, second, at = (
            np.where(fixed, 0.0, np.sin(np.multiply.outer(numbers + k, 12.9898 * np.arange(1, space.dim + 1) + k)))
            for k in (1.0, 2.0, 3.0)
        )
        lengths = np.concatenate([np.zeros(0), *(np.linalg.norm(p.tangents, axis=-1).ravel() for p in self._parts)])
        total, count = space.comm.allreduce(np.array([lengths.sum(), len(lengths)]))
        values = self._stiffness(SLIGHT * total / max(count, 1.0) * at, 1.0)
        rows = np.repeat(np.arange(len(nodes)), np.diff(self._local[0]))
        columns = self._local[1]
        terms = [np.einsum("ni,nij,nj->n", a[rows], values, b[columns]) for a, b in ((first, second), (second, first))]
        own = np.array([terms[0].sum(), terms[1].sum(), np.abs(values).sum()])
        one, other, size = space.comm.allreduce(own)
        return bool(abs(one - other) <= ROUNDING * size)

    def _stiffness(self, u, pressure):
        """Values on the local pattern at a displacement (n, d) of the nodes."""
        d = self.space.dim
        values = np.zeros((len(self._local[1]), d, d))
        for part in self._parts:
            add_stiffness(part, u, pressure, self._ring, *self._local, values)
        return values

    def _forces(self, u, out, sign, absolute=False):
        moved = self._nodes.gather(u)
        forces = np.zeros(moved.shape)
        for part in self._parts:
            add_forces(part, moved, self._factor, self._ring, absolute, forces)
        out += sign * self.space.summed(self._nodes, forces)

    def detect(self, u, time, motion=0.0, ahead=None):
        """The pressure is that of the end of the load step."""
        self._factor = float(self._amplitude.factor(time))
        if self._pressure.varies and time != self._time:
            self._weigh(time)
            self._time = time

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self._owned.rowptr, self._owned.columns

    def residual(self, u, out, rule=LAW):
        """Add the forces of the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        self._forces(u, out, 1.0)

    def external(self, u, out):
        """Add the forces of the pressure at ``u`` to ``out`` (n_owned, d). *Collective.*"""
        self._forces(u, out, -1.0)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of the forces to ``out`` (n_owned, d). *Collective.*"""
        self._forces(u, out, 1.0, True)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on the pattern. *Collective.*"""
        return self._owned.sum(self._stiffness(self._nodes.gather(u), self._factor))
