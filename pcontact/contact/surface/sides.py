"""The two sides of a contact pair on one rank: quadrature points of the source, facets of the target.

Facets of other ranks around those of this one.

Whether a projection is held at an edge, and on which side of the surface a point is there, is decided by all facets
that share the edge. A rank that knows the neighbours of its facets decides as if it had the whole surface, so that
partners do not depend on the ranks.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from pcontact.assembly.geometry import rule_degree
from pcontact.contact.points import SourcePoints
from pcontact.contact.surface.facet_maps import KIND, padded
from pcontact.element.dilatation import Dilatation, Mean, dilatation, factors, hoop_operator, mean_dilatation
from pcontact.element.geometry import facet_geometry
from pcontact.element.quadrature import quadrature, reduced_gradients
from pcontact.element.reference import (
    CELLS,
    facet_area_vectors,
    facet_nodes,
    facet_points,
    reference_nodes,
    shape,
    shape_gradient,
)
from pcontact.element.trace import trace_constant
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI


class Rim:
    """Facets of other ranks that share a node with one of this rank's, and the plan that brings their coordinates.

    Parameters
    ----------
    space : pcontact.space.space.Space
    nodes : ndarray (nf, m)
        Global nodes of this rank's facets.
    kinds, ids : ndarray (nf,)
        As of `pcontact.contact.surface.sides.TargetSurface`.
    x : ndarray (nf, n, d)
        Reference coordinates [length], of the same width on all ranks.
    table : ndarray (nf, k), optional
        What else is to be known of them, of the same width on all ranks.

    Attributes
    ----------
    kinds, ids, x, table
        Of the facets of other ranks.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, space, nodes, kinds, ids, x, table=None):
        self._exchanger = space.exchanger
        shared = neighbours(space, nodes)
        table = np.zeros((len(kinds), 0)) if table is None else table
        self._rows = {rank: np.flatnonzero(np.isin(nodes, there).any(axis=1)) for rank, there in shared.items()}
        statics = np.column_stack([kinds, ids, table]).astype(float)
        columns = self._bring(statics)
        self.kinds, self.ids = (np.ascontiguousarray(columns[:, k].astype(np.int64)) for k in (0, 1))
        self.table = columns[:, 2:]
        self.x = self.gather(x)

    def _bring(self, values):
        """Rows (n, columns) of the rim out of those of all ranks' surfaces (nf, columns). *Collective.*"""
        sends = {rank: values[rows] for rank, rows in self._rows.items()}
        received = self._exchanger(sends, np.float64, values.shape[1])
        return np.concatenate([np.zeros((0, values.shape[1])), *received.values()])

    def gather(self, x_facets):
        """Coordinates (n, m, d) of the rim's facets. *Collective.*"""
        shape = x_facets.shape[1:]
        return self._bring(x_facets.reshape(len(x_facets), shape[0] * shape[1])).reshape(-1, *shape)


def neighbours(space, nodes):
    """Other ranks whose facets have nodes of these (nf, m), and which, by rank. *Collective.*"""
    mine = np.unique(nodes)
    pairs = space.exchanger.sharers(space.numbering.owner(mine), mine)
    return split_by_rank(pairs[:, 1], pairs[:, 0])[0]


def tangents_of(normal):
    """Orthonormal tangents (np, d - 1, d) of unit normals (np, d): (t_y, -t_x) and t_1 x t_2 are the normal."""
    if normal.shape[1] == 2:
        return np.stack([-normal[:, 1], normal[:, 0]], axis=1)[:, None]
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(axis, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=1)


# facets per cell at most: global facet number = cell number * FACETS + local facet
FACETS = 6
# points per facet at most
POINTS = 1 << 20


@dataclass
class SourceSurface:
    """Quadrature points of the source facets of one rank.

    Attributes
    ----------
    cells : ndarray (nf, nn)
        Local space nodes of the parent cells; short rows are padded with their first node and zero shape functions.
    facet_ids : ndarray (nf,)
        Global facet numbers.
    facet : ndarray (np,)
        Facet of each quadrature point.
    x, normal : ndarray (np, d)
        Reference position [length] and outward unit normal.
    jxw : ndarray (np,)
        Quadrature weight times area element, with axial symmetry times 2 pi r.
    shape : ndarray (np, nn)
        Shape functions of the parent cell.
    grad : ndarray (np, nn, d)
        Their physical gradients, of which the strain is made [1/length].
    mu : ndarray (nf,)
        Shear modulus of the parent cells [stress].
    own : ndarray (nf,)
        Factor of the dilatation operator at the point in the volumetric operator [stress].
    shared : pcontact.element.dilatation.Mean or None
        What the mean dilatation of the parent cells adds to it, of facets (nf,) [stress].
    trace : ndarray (nf,)
        Constant of the trace inequality of the parent cell, times the number of its facets in the surface
        [stress/length].
    shear : ndarray (nf,)
        Part of it that tangential tractions need, see `pcontact.contact.formulation.methods`; 1 where nothing asks.
    size : ndarray (nf,)
        Diameter of the facets [length].
    components : ndarray (nf,)
        Connected component of the parent cell.
    axisymmetric : bool
    slope : ndarray (np, nn, d) or None
        Where cells have reduced integration, the gradients as they are, for the deformed surface [1/length].
    volumetric : ndarray (np, nn, d)
        Volumetric operator P, see `pcontact.element.dilatation` [stress/length]; follows from the others.
    """

    cells: np.ndarray
    facet_ids: np.ndarray
    facet: np.ndarray
    x: np.ndarray
    normal: np.ndarray
    jxw: np.ndarray
    shape: np.ndarray
    grad: np.ndarray
    mu: np.ndarray
    own: np.ndarray
    shared: Mean | None
    trace: np.ndarray
    shear: np.ndarray
    size: np.ndarray
    components: np.ndarray
    axisymmetric: bool = False
    slope: np.ndarray | None = None
    volumetric: np.ndarray = field(init=False)

    def __post_init__(self):
        hoop = hoop_operator(self.shape, self.x[:, 0]) if self.axisymmetric else None
        self.volumetric = self.own[self.facet][:, None, None] * dilatation(self.grad, hoop)
        if self.shared is not None:
            self.volumetric += self.shared.at(self.x[:, None], self.facet)[:, 0]

    def mute(self, facets):
        """The same surface, some facets (nf,) of which have no traction, as in the penalty method."""
        kept = ~facets
        shared = None if self.shared is None else self.shared.times(kept)
        return replace(self, mu=self.mu * kept, own=self.own * kept, shared=shared)

    def numbered(self, cells):
        """The points for kernels, whose values have the nodes (nf, nn) of the parent cells by other numbers."""
        return SourcePoints(self.facet, cells, self.shape, self.jxw, self.normal, self.grad, self.volumetric, self.mu)

    def point_keys(self):
        """Numbers (np,) of the points, the same on any ranks. The points of a facet come one after the other."""
        first = np.searchsorted(self.facet, self.facet)
        return self.facet_ids[self.facet] * POINTS + np.arange(len(self.facet)) - first


def default_quadrature(facet, degree):
    """Quadrature degree on whole source facets: enough points that the edges of the target's are resolved.

    On triangles of degree 1 seven points: twelve change no error of Hertz contact in a norm by more than a hundredth
    (`drivers/studies/tradeoff.py --cases hertz3d`), and take 1.7 times as long to search and to evaluate.

    Parameters
    ----------
    facet : str
    degree : int
        Of the displacement.
    """
    if facet == "triangle":
        return 5 if degree == 1 else 8
    return 2 * degree + 5


def diameters(x):
    """Largest distance (nf,) between two of the nodes (nf, n, d) of facets [length]."""
    return np.linalg.norm(x[:, :, None] - x[:, None], axis=3).max(axis=(1, 2), initial=0.0)


def _moments(x):
    """Length or area (nf,) of facets (nf, n, d) as their corners have them, and its first and second moment.

    Of a quadrilateral the mean of its halvings along both diagonals.
    """
    n, d = x.shape[1:]
    several = {2: [((0, 1), 1.0)], 3: [((0, 1, 2), 1.0)]}.get(n, [
        (three, 0.5) for three in ((0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3))
    ])  # fmt: skip
    out = np.zeros((len(x), d + 2))
    for corners, share in several:
        y, k = x[:, corners], len(corners)
        a, b = y[:, 1] - y[:, 0], y[:, -1] - y[:, 0]
        aa, ab, bb = (np.einsum("fi,fi->f", *two) for two in ((a, a), (a, b), (b, b)))
        size = share * (np.sqrt(aa) if k == 2 else 0.5 * np.sqrt(np.maximum(aa * bb - ab**2, 0.0)))
        total = y.sum(axis=1)
        second = (np.sum(y**2, axis=(1, 2)) + np.sum(total**2, axis=1)) / (k * (k + 1))
        out += size[:, None] * np.column_stack([np.ones(len(x)), total / k, second])
    return out


def extents(space, name, bodies=False):
    """Extent of a facet group, or of the part of each connected component in it. *Collective.*

    The length of a straight line that is as wide spread: sqrt(12) times the root of the mean square of the distance
    from the middle. It is the diagonal of a square, about that of a box, and depends neither on directions nor, but for
    curved facets, on the mesh.

    Returns
    -------
    ndarray (n,)
        [length]; without facets 0.
    """
    mesh, comm, parts = space.mesh, space.comm, []
    for facets in mesh.facet_groups.get(name, []):
        block = mesh.blocks[facets.block]
        corners = mesh.facet_nodes(facets)[:, : CELLS[facets.kind].n_vertices]
        body = block.components[facets.cells] if bodies else np.zeros(len(corners), dtype=np.int64)
        parts.append((mesh.points[corners], body))
    sums = np.zeros((mesh.n_components if bodies else 1, space.dim + 2))
    # the second moment about the middle, not about a far origin
    middle = np.zeros((len(sums), space.dim))
    for _ in range(2):
        sums[:] = 0.0
        for x, body in parts:
            np.add.at(sums, body, _moments(x - middle[body][:, None]))
        total = comm.allreduce(sums, op=MPI.SUM)
        size = np.maximum(total[:, :1], np.finfo(float).tiny)
        middle = middle + total[:, 1:-1] / size
    spread = (total[:, -1:] - np.sum(total[:, 1:-1] ** 2, axis=1, keepdims=True) / size) / size
    return np.sqrt(12.0 * np.maximum(spread[:, 0], 0.0))


def _pad(array, width):
    missing = width - array.shape[1]
    if missing == 0:
        return array
    return np.concatenate([array, np.zeros((array.shape[0], missing, *array.shape[2:]))], axis=1)


def _part(space, facets, constants, quadrature_degree, orthotropic, sticks):
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    table, geometry_degree = mesh.geometry_nodes(block)
    degree = quadrature_degree or default_quadrature(facets.kind, space.degree)
    xi, weights = quadrature(facets.kind, degree)
    coordinates = np.ascontiguousarray(mesh.points[table[facets.cells]])
    local = np.ascontiguousarray(facets.local, dtype=np.int64)
    at = facet_geometry(facets.cell, coordinates, local, geometry_degree, space.degree, xi, weights)
    lam, mu = constants[block.body]
    averaged, shared = space.averages(block), None
    own, factor = factors(lam, mu, averaged, space.degree_of(block))
    if averaged:
        order = rule_degree(space, block, geometry_degree)
        shared = mean_dilatation(block.cell, coordinates, geometry_degree, space.degree, order, space.axisymmetric,
                                 space.degree_of(block))  # fmt: skip
        shared = shared.times(np.full(len(coordinates), factor))
    law, grad = orthotropic.get(block.body), at.gradients
    shear = _shear(lam, mu, law, at) if sticks else None
    kind = Dilatation(space.axisymmetric, averaged, space.reduces(block), law, shear)
    if kind.reduced:
        grad = reduced_gradients(block.cell, coordinates, geometry_degree, facet_points(facets.cell, xi)[local])
    nf, nq = at.jxw.shape
    return {
        "cells": space.cells[facets.block][facets.cells],
        "facet_ids": block.ids[facets.cells] * FACETS + local,
        "facet": np.repeat(np.arange(nf), nq),
        "x": at.points.reshape(nf * nq, -1),
        "normal": at.normals.reshape(nf * nq, -1),
        "jxw": (at.jxw * space.circumference(at.points)).ravel(),
        "shape": at.shape.reshape(nf * nq, -1),
        "grad": grad.reshape(nf * nq, -1, mesh.dim),
        "slope": at.gradients.reshape(nf * nq, -1, mesh.dim) if kind.reduced else None,
        "mu": np.full(nf, mu),
        "own": np.full(nf, own),
        "shared": shared,
        "trace": trace_constant(
            facets.cell, coordinates, local, geometry_degree, space.degree_of(block), lam, mu, kind
        ),
        "shear": np.ones(nf) if shear is None else shear,
        "size": diameters(mesh.points[mesh.facet_nodes(facets)]),
        "components": block.components[facets.cells],
    }


def at_places(space, facets, rows, s):
    """Points s (n, d - 1) of facets `rows` of one part: position, normal, area element, shape functions, gradients, and
    those of which the strain is made."""
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    table, degree = mesh.geometry_nodes(block)
    local = facets.local[rows]
    xi = np.empty((len(s), space.dim))
    for side in np.unique(local):
        xi[local == side] = facet_points(facets.cell, s[local == side])[side]
    x = mesh.points[table[facets.cells[rows]]]
    jacobian = np.einsum("pai,paj->pij", x, shape_gradient(block.cell, degree, xi))
    # Nanson's formula: n dA = det J J^-T N dA_ref
    inverse = np.linalg.inv(jacobian)
    vector = np.einsum("p,pji,pj->pi", np.linalg.det(jacobian), inverse, facet_area_vectors(facets.cell)[local])
    area = np.linalg.norm(vector, axis=1)
    grad = np.einsum("paj,pji->pai", shape_gradient(block.cell, space.degree, xi), inverse)
    position = np.einsum("pa,pai->pi", shape(block.cell, degree, xi), x)
    strain = reduced_gradients(block.cell, x, degree, xi[:, None])[:, 0] if space.reduces(block) else grad
    return position, vector / area[:, None], area, shape(block.cell, space.degree, xi), grad, strain


def _shear(lam, mu, law, at):
    """Part of the trace constant of facets that tangential tractions need, (nf,), the largest of their points."""
    nf, nq, d = at.normals.shape
    if law is None:
        return np.full(nf, min(1.0, 4.0 * mu / (lam + 2.0 * mu)))
    return law.shear(at.points.reshape(-1, d), at.normals.reshape(-1, d)).reshape(nf, nq).max(axis=1)


def source_surface(space, name, constants, quadrature_degree=None, orthotropic=None, sticks=False):
    """Quadrature points of a facet group.

    Parameters
    ----------
    space : pcontact.space.space.Space
    name : str
        Facet group.
    constants : list of (float, float)
        Lame constants of each body.
    quadrature_degree : int, optional
    orthotropic : dict of int to pcontact.material.orthotropic.Orthotropic, optional
        By body, elasticity of which the constants are the nearest isotropic ones.
    sticks : bool, optional
        Whether the trace constant is that of points which stick by ``shear`` of it.

    Returns
    -------
    SourceSurface
    """
    d = space.dim
    arguments = constants, quadrature_degree, orthotropic or {}, sticks
    parts = [_part(space, f, *arguments) for f in space.mesh.facet_groups.get(name, [])]
    if not parts:
        empty = np.zeros
        return SourceSurface(
            empty((0, d + 1), np.int64), empty(0, np.int64), empty(0, np.int64), empty((0, d)), empty((0, d)),
            empty(0), empty((0, d + 1)), empty((0, d + 1, d)), empty(0), empty(0), None, empty(0), empty(0), empty(0),
            empty(0, np.int64), space.axisymmetric,
        )  # fmt: skip
    width = max(p["cells"].shape[1] for p in parts)
    reduced = any(p["slope"] is not None for p in parts)
    first = 0
    for p in parts:
        p["facet"] = p["facet"] + first
        first += len(p["cells"])
        p["cells"] = padded(p["cells"], width)
        p["shape"], p["grad"] = _pad(p["shape"], width), _pad(p["grad"], width)
        if reduced:
            p["slope"] = p["grad"] if p["slope"] is None else _pad(p["slope"], width)
    shared = _joined([p.pop("shared") for p in parts], [p["cells"].shape for p in parts], d)
    keys = [key for key in parts[0] if reduced or key != "slope"]
    joined = {key: np.ascontiguousarray(np.concatenate([p[key] for p in parts])) for key in keys}
    # a cell's energy bounds the traction on all its facets of the surface together
    _, place, count = np.unique(joined["facet_ids"] // FACETS, return_inverse=True, return_counts=True)
    joined["trace"] *= count[place]
    return SourceSurface(**joined, shared=shared, axisymmetric=space.axisymmetric)


def _joined(parts, shapes, d):
    """Mean dilatation of all facets, zero for those that have none; None if no facet has one."""
    if all(part is None for part in parts):
        return None
    shape = max(p.slopes.shape[1] for p in parts if p is not None), max(columns for _, columns in shapes), d
    centre, slopes = [], []
    for part, (rows, _) in zip(parts, shapes, strict=True):
        centre.append(np.zeros((rows, d)))
        slopes.append(np.zeros((rows, *shape)))
        if part is not None:
            centre[-1][:] = part.centre
            slopes[-1][:, : part.slopes.shape[1], : part.slopes.shape[2]] = part.slopes
    return Mean(np.concatenate(centre), np.concatenate(slopes))


@dataclass
class TargetSurface:
    """Facets of the target side of one rank.

    Attributes
    ----------
    kinds : ndarray (nf,)
        Facet kinds of :mod:`pcontact.contact.surface.facet_maps` of the geometry that is searched.
    ids : ndarray (nf,)
        Global facet numbers.
    x : ndarray (nf, n, d)
        Reference coordinates [length] of the nodes of these kinds, padded with the first one.
    carry : list of (slice, ndarray, str)
        For each block: rows, table that evaluates the displacement at these nodes, facet name.
    nodes : ndarray (nf, m)
        Local space nodes of the facets, padded.
    components : ndarray (nf,)
    degree : int
        Of the displacement.
    smooth : pcontact.contact.surface.smooth_geometry.SmoothSurface or None
        What searches are to tell of; on all ranks or on none.
    rim : pcontact.contact.surface.sides.Rim or None
        Facets of other ranks around those of this one; None on one rank.
    """

    kinds: np.ndarray
    ids: np.ndarray
    x: np.ndarray
    carry: list
    nodes: np.ndarray
    components: np.ndarray
    degree: int
    smooth: object = None
    rim: Rim | None = None

    # what points on the surface itself tell about themselves, see `pcontact.contact.search.self_contact`
    about = None

    def seen_from(self, facet, x):
        """The surface as points of another one see it."""
        return self

    def around(self, x_facets):
        """Return what is searched: deformed coordinates, kinds, numbers, which may be partners, nodes. *Collective.*

        The rim decides with the others whether a projection is held at an edge, as if all facets were on one rank, but
        holds no partner itself. Without the nodes there are no cones of normals (`pcontact.contact.search.tree`):
        where a surface meets another one, the search tries fewer than two facets per point, and cones would cost more
        than they save.
        """
        if self.rim is None:
            return x_facets, self.kinds, self.ids, None, None
        x, n = np.ascontiguousarray(np.concatenate([x_facets, self.rim.gather(x_facets)])), len(x_facets)
        kinds, ids = np.concatenate([self.kinds, self.rim.kinds]), np.concatenate([self.ids, self.rim.ids])
        return x, kinds, ids, np.arange(len(x)) < n, None

    def may_meet(self, own, other, ahead):
        """Return whether facets of bodies ``other`` (n,) may be partners of source facets of bodies ``own`` (n,).

        Parameters
        ----------
        own, other : ndarray (n,)
            Connected bodies.
        ahead : ndarray (n,)
            How far ahead of the source facet the other one is, along its normal [length].

        Returns
        -------
        ndarray (n,) of bool
        """
        return np.ones(len(own), dtype=bool)

    def bodies(self):
        """Bodies of the facets of :meth:`around` whose own points pass them by; None: there are none."""
        return None

    def exclusion(self, tree):
        """See :class:`pcontact.contact.search.exclusion.Exclusion`; None: no point is on the surface."""
        return None

    def deformed(self, nodal, origin=0.0):
        """Coordinates (nf, n, d), relative to an origin (d,), of the facets under nodal displacements (n_local, d)."""
        x = self.x - origin
        for rows, table, _ in self.carry:
            x[rows, : len(table)] += np.einsum("na,fad->fnd", table, nodal[self.nodes[rows, : table.shape[1]]])
        return x

    def shape(self, facets, xi):
        """Shape functions (n, m) of the space's facet nodes at reference points (n, d - 1) of facets (n,)."""
        out = np.zeros((len(facets), self.nodes.shape[1]))
        for rows, table, name in self.carry:
            chosen = np.flatnonzero((facets >= rows.start) & (facets < rows.stop))
            if len(chosen):
                out[chosen, : table.shape[1]] = shape(name, self.degree, xi[chosen])
        return out


def components_of(space, name):
    """Connected components that a group of facets belongs to. *Collective.*"""
    mesh = space.mesh
    own = {int(k) for f in mesh.facet_groups.get(name, []) for k in np.unique(mesh.blocks[f.block].components[f.cells])}
    return set().union(*space.comm.allgather(own))


def target_surface(space, name, rim=True):
    """Facets of a facet group, ready to be searched. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    name : str
    rim : bool
        Whether the facets of other ranks around those of this one are to be known.

    Returns
    -------
    TargetSurface
    """
    return surface_of(space, space.mesh.facet_groups.get(name, []), rim)


def surface_of(space, groups, rim=True):
    """The same of facets: a list of pcontact.mesh.mesh.Facets. *Collective.*"""
    surface = _facets(space, groups)
    if not rim or space.comm.size == 1:
        return surface
    x, nodes = (_widened(space, table) for table in (surface.x, surface.nodes))
    return replace(surface, x=x, nodes=nodes, rim=Rim(space, space.nodes[nodes], surface.kinds, surface.ids, x))


def _widened(space, table):
    """A table (nf, n, ...) of nodes of facets padded to the largest width of all ranks. *Collective.*"""
    return np.ascontiguousarray(padded(table, space.comm.allreduce(table.shape[1], op=MPI.MAX)))


def _facets(space, groups):
    """The facets of this rank."""
    mesh, d = space.mesh, space.dim
    layout_degree = max(2 if mesh.curved else 1, space.degree)
    kinds, ids, places, nodes, components, carry, first = [], [], [], [], [], [], 0
    for facets in groups:
        block = mesh.blocks[facets.block]
        kind = facets.kind
        rows = slice(first, first + len(facets.cells))
        first = rows.stop
        table = facet_nodes(facets.cell, layout_degree)
        places.append(mesh.points[block.nodes[facets.cells[:, None], table[facets.local]]])
        # what is searched has the nodes in the middles of its facets
        searched = CELLS[kind].complete or kind
        at = reference_nodes(searched, layout_degree)
        if searched != kind:
            places[-1] = shape(kind, layout_degree, at) @ places[-1]
        own = facet_nodes(facets.cell, space.degree)
        nodes.append(space.cells[facets.block][facets.cells[:, None], own[facets.local]])
        kinds.append(np.full(len(facets.cells), KIND[searched, layout_degree], dtype=np.int64))
        ids.append(block.ids[facets.cells] * FACETS + facets.local)
        components.append(block.components[facets.cells])
        carry.append((rows, shape(kind, space.degree, at), kind))
    if not nodes:
        none = np.zeros(0, dtype=np.int64)
        return TargetSurface(none, none, np.zeros((0, d, d)), [], np.zeros((0, d), np.int64), none, space.degree)
    width, own_width = max(x.shape[1] for x in places), max(t.shape[1] for t in nodes)
    return TargetSurface(
        np.concatenate(kinds),
        np.concatenate(ids).astype(np.int64),
        np.ascontiguousarray(np.concatenate([padded(x, width) for x in places])),
        carry,
        np.ascontiguousarray(np.concatenate([padded(t, own_width) for t in nodes])),
        np.concatenate(components),
        space.degree,
    )
