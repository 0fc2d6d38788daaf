"""The smooth surfaces that facets stand for, and what they change in the gap.

The facets of a mesh of degree 1 are chords of a curved body. Between two bodies whose surfaces conform, chords that do
not match leave gaps and overlaps, and the pressure closes them: it is wrong by about gamma times these gaps, however
small the mesh makes the error of the displacement. With vertex normals N_i (`pcontact.contact.surface.vertex_normals`)
the smooth surface stands off a facet, at the point with linear shape functions w_i, by

    d = delta m,   delta = 1/2 sum_{i<j} w_i w_j (N_j - N_i) . (X_j - X_i),   m = sum_i w_i N_i / | sum_i w_i N_i |,

the error of linear interpolation, exactly where the surface is quadratic, and continuous over the edges of facets. The
gap between the smooth surfaces is g + n . (d_target - d_source), a number that does not depend on the displacement.
Cells, displacement, normals and quadrature stay as they are.

The facets of a mesh of degree 2 are much closer to a curved body, but an interference is small, too. They meet at
small angles. With the tangent T of an edge between vertices i and j of a facet and the facet's own normals n_i, the
smooth surface rises off it with the slope g_i = -(T . N_i) / (n_i . N_i) at i. What vanishes at both ends and in the
middle and has these slopes is

    4 w_i w_j (a s + b s^2),   s = w_j - w_i,   a = -(g_i + g_j) / 4,   b = (g_i - g_j) / 4,

again the leading error of the interpolation where the surface is a circle, and the sum over edges takes the place of
delta. Inside of quadrilaterals in space that is an interpolation of the heights above their edges. On triangles a
polynomial of degree 4 is left that vanishes at the edges, w_1 w_2 w_3 sum_i c_i w_i. It takes the slopes across the
edges, in their middles, to those of the mean normals of both facets, and the sum is the one polynomial of degree 4 with
these heights and slopes at vertices and middles: the leading error of the interpolation of any surface.
"""

import numpy as np

from pcontact.contact.law import OPEN
from pcontact.contact.surface.facet_maps import padded
from pcontact.contact.surface.sides import FACETS, neighbours
from pcontact.contact.surface.vertex_normals import (
    EDGE,
    FLAT,
    Facets,
    corner_normals,
    curved_normals,
    facet_normals,
    sharpness,
)
from pcontact.element.reference import CELLS, facet_nodes, n_nodes, reference_nodes, shape
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime.petsc import MPI

# layers of facets of other ranks: two that the fits see, one that tells whether edges of these are smooth
LAYERS = 3
# bend of the gap between the smooth surfaces along a facet, as a part of their own, below which they conform: circles
# with radii within a factor of 1.4
CONFORMING = 0.3
# part of the pressure that straight facets may put wrong without a word, and what helps
WRONG = 0.1
SMOOTH = "a mesh of degree 2, or smooth_geometry = true"
# square of the extent of points across a facet, as a part of that along it, that counts as none
FLATNESS = 1e-6
# bend of a facet, as a part of its coordinates, that may be rounding
ROUNDING = 1e-12


class SmoothSurface:
    """Facets of one rank of a group, with the normals of the smooth surface at their vertices.

    Parameters
    ----------
    facets : pcontact.contact.surface.vertex_normals.Facets
        Of this rank, in the order of the group.
    normals : ndarray (nf, m, d)
    middles : ndarray (nf, m, m, d), optional
        Of curved facets: the nodes in the middle of their edges, by the vertices at the ends; nan elsewhere.
    border : ndarray (nf, m) of bool, optional
        Of curved facets: vertices at which the surface ends. What comes from there has the slope that makes it as even
        as a circle.
    mid : ndarray (nf, m, d), optional
        Of curved facets in space: normals in the middle of edges, see
        `pcontact.contact.surface.vertex_normals.curved_normals`.
    """

    def __init__(self, facets, normals, middles=None, border=None, mid=None):
        self.normals = normals
        i, j = np.triu_indices(normals.shape[1], 1)
        self._pairs, self._bend, self._inside = (i, j), None, None
        if middles is None:
            turn, side = normals[:, j] - normals[:, i], facets.x[:, j] - facets.x[:, i]
            self._height = 0.5 * np.einsum("fkd,fkd->fk", turn, side)
            return
        first, last, middle = facets.x[:, i], facets.x[:, j], middles[:, i, j]
        slopes = [
            -np.einsum("fkd,fkd->fk", tangent, normals[:, k])
            / np.einsum("fkd,fkd->fk", facets.own[:, k], normals[:, k])
            for tangent, k in ((-1.5 * first + 2.0 * middle - 0.5 * last, i),
                               (0.5 * first - 2.0 * middle + 1.5 * last, j))
        ]  # fmt: skip
        ends = border[:, i] & ~border[:, j], border[:, j] & ~border[:, i]
        slopes = [np.where(ends[0], -slopes[1], slopes[0]), np.where(ends[1], -slopes[0], slopes[1])]
        self._height = np.nan_to_num(-(slopes[0] + slopes[1]))
        self._bend = np.nan_to_num(slopes[0] - slopes[1])
        if mid is not None:
            self._inside = self._bubbles(facets, middles, mid)

    def _bubbles(self, facets, middles, mid):
        """Coefficients (nf, 3) of what is left inside of triangles."""
        columns = {pair: k for k, pair in enumerate(zip(*(one.tolist() for one in self._pairs), strict=True))}
        left, x = np.full((len(facets.x), 3), np.nan), facets.x
        for k in range(3):
            # across the edge from i to j, from its middle toward the third vertex
            i, j = (k + 1) % 3, (k + 2) % 3
            across = _across(x, middles, i, j, k)
            own = facets.mid[:, i]
            slope = -np.einsum("fd,fd->f", across, mid[:, i]) / np.einsum("fd,fd->f", own, mid[:, i])
            for a in (i, j):
                pair = (min(a, k), max(a, k))
                s = -0.5 if pair == (a, k) else 0.5
                slope -= 0.5 * s * (self._height[:, columns[pair]] + s * self._bend[:, columns[pair]])
            left[:, k] = 8.0 * slope
        known = np.isfinite(left)
        mean = np.where(known, left, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        # where the surface ends the others are all that is known
        left = np.where(known, left, mean[:, None])
        return np.where((facets.count == 3)[:, None], 0.5 * (left.sum(axis=1, keepdims=True) - 2.0 * left), 0.0)

    def offset(self, facet, weights):
        """Distance of the smooth surface from points on facets.

        Parameters
        ----------
        facet : ndarray (n,)
        weights : ndarray (n, m)
            Linear shape functions of the facets' vertices at the points.

        Returns
        -------
        ndarray (n, d)
            [length]
        """
        i, j = self._pairs
        heights = self._height[facet]
        if self._bend is not None:
            along = weights[:, j] - weights[:, i]
            heights = along * (heights + along * self._bend[facet])
        height = np.einsum("nk,nk->n", weights[:, i] * weights[:, j], heights)
        if self._inside is not None:
            some = weights[:, :3]
            height += some.prod(axis=1) * np.einsum("nk,nk->n", some, self._inside[facet])
        normal = np.einsum("nm,nmd->nd", weights, self.normals[facet])
        return (height / np.linalg.norm(normal, axis=1))[:, None] * normal

    def at_target(self, target, facet, xi):
        """The same at reference points xi (n, d - 1) of the facets (n,) of a target surface."""
        weights = np.zeros((len(facet), self.normals.shape[1]))
        for rows, _, name in target.carry:
            chosen = np.flatnonzero((facet >= rows.start) & (facet < rows.stop))
            if len(chosen):
                values = shape(name, 1, xi[chosen])
                weights[chosen, : values.shape[1]] = values
        return self.offset(facet, weights)

    def at_source(self, space, name, source):
        """The same (np, d) at the quadrature points of a source surface on the group of this name."""
        weights = np.zeros((len(source.facet), self.normals.shape[1]))
        for facets, which in space.mesh.facets_of(name):
            cell = space.mesh.blocks[facets.block].cell
            points = np.flatnonzero((source.facet >= which.start) & (source.facet < which.stop))
            local = facets.local[source.facet[points] - which.start]
            # shape functions of the cell reproduce its linear ones
            linear = shape(cell, 1, reference_nodes(cell, space.degree))
            values = source.shape[points, : n_nodes(cell, space.degree)] @ linear
            values = np.take_along_axis(values, facet_nodes(facets.cell, 1)[local], axis=1)
            weights[points, : values.shape[1]] = values
        return self.offset(source.facet, weights)


def _middles(space, name):
    """Nodes (nf, m, m, d) in the middle of the edges of a group's curved facets, by the vertices at the ends; nan where
    there is no edge."""
    mesh, m = space.mesh, 2 if space.dim == 2 else 4
    parts = [np.zeros((0, m, m, space.dim))]
    for facets in mesh.facet_groups.get(name, []):
        nodes, kind = mesh.facet_nodes(facets), CELLS[facets.kind]
        middles = np.full((len(nodes), m, m, space.dim), np.nan)
        for k, (a, b) in enumerate(kind.edges):
            middles[:, a, b] = middles[:, b, a] = mesh.points[nodes[:, kind.n_vertices + k]]
        parts.append(middles)
    return np.concatenate(parts)


def _across(x, middles, i, j, k):
    """Derivative (nf, d) of triangles of degree 2, in the middle of the edge from i to j toward the vertex k, per
    shape function of that."""
    return (-0.5 * (x[:, i] + x[:, j]) - 2.0 * middles[:, i, j] - x[:, k]
            + 2.0 * (middles[:, i, k] + middles[:, j, k]))  # fmt: skip


def mid_normals(x, count, middles):
    """Unit normals (nf, m, d) of curved triangles in the middle of their edges; parameters as of :func:`own_normals`;
    nan of quadrilaterals."""
    normals = np.full_like(x, np.nan)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        normal = np.cross(x[:, j] - x[:, i], _across(x, middles, i, j, k))
        normals[:, i] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    normals[count != 3] = np.nan
    return normals


def own_normals(x, count, middles):
    """Unit normals (nf, m, d) at the vertices of curved facets.

    Parameters
    ----------
    x : ndarray (nf, m, d)
        Vertices, see :class:`pcontact.contact.surface.vertex_normals.Facets`.
    count : ndarray (nf,)
        Of them.
    middles : ndarray (nf, m, m, d)
        See :class:`SmoothSurface`.
    """
    rows, m = np.arange(len(x)), x.shape[1]
    normals = np.zeros_like(x)
    for k in range(m):
        # the fourth corner of a triangle is its first
        at = np.where(k < count, k, 0)
        ends = ((at + 1) % count, (at - 1) % count)
        after, before = (2.0 * middles[rows, at, e] - 0.5 * x[rows, e] - 1.5 * x[rows, at] for e in ends)
        if m > 2:
            normal = np.cross(after, before)
        else:
            way = after if k == 0 else -after
            normal = np.column_stack([way[:, 1], -way[:, 0]])
        normals[:, k] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return normals


def _own_facets(space, name):
    """Facets of this rank of a group, in its order."""
    mesh, d = space.mesh, space.dim
    m, parts = 2 if d == 2 else 4, [([], [], np.zeros((0, 2 if d == 2 else 4), dtype=np.int64))]
    for facets in mesh.facet_groups.get(name, []):
        block = mesh.blocks[facets.block]
        nodes = block.nodes[facets.cells[:, None], facet_nodes(facets.cell, 1)[facets.local]]
        count = np.full(len(nodes), nodes.shape[1])
        parts.append((block.ids[facets.cells] * FACETS + facets.local, count, padded(nodes, m)))
    ids, count, nodes = (np.concatenate(columns).astype(np.int64) for columns in zip(*parts, strict=True))
    return Facets(ids, count, space.nodes[space.of_mesh[nodes]], mesh.points[nodes])


def _with_neighbours(space, own):
    """The facets and `LAYERS` layers of those of other ranks around them, sorted by number. *Collective.*"""
    m, d = own.x.shape[1:]
    columns = [own.ids, own.count, own.nodes, own.x.reshape(len(own.ids), m * d)]
    columns += [one.reshape(len(own.ids), m * d) for one in (own.own, own.mid) if one is not None]
    table = np.column_stack(columns).astype(float)
    known = table
    for _ in range(LAYERS if space.comm.size > 1 else 0):
        shared = neighbours(space, known[:, 2 : 2 + m].astype(np.int64))
        sends = {rank: table[np.isin(own.nodes, nodes).any(axis=1)] for rank, nodes in shared.items()}
        received = space.exchanger(sends, np.float64, table.shape[1])
        known = np.concatenate([known, *received.values()])
        known = known[np.unique(known[:, 0], return_index=True)[1]]
    known = known[np.argsort(known[:, 0])]
    ids, count = known[:, 0].astype(np.int64), known[:, 1].astype(np.int64)
    # without facets their number does not follow from the size
    parts = known[:, 2 + m :].reshape(len(known), (known.shape[1] - 2 - m) // (m * d), m, d).swapaxes(0, 1)
    return Facets(ids, count, known[:, 2 : 2 + m].astype(np.int64), *parts)


def _is_plane(comm, normals):
    """Return True if facets of all ranks have one normal. *Collective.*"""
    low, high = bounding_box(comm, normals)
    return not np.any(high - low > 0.5 * FLAT)


def _facets_of(space, name):
    """Facets of this rank of a group, curved ones with their normals, and the middles of these. *Collective.*"""
    own = _own_facets(space, name)
    if not space.mesh.curved:
        return own, None
    middles = _middles(space, name)
    own = own._replace(own=own_normals(own.x, own.count, middles))
    return own._replace(mid=mid_normals(own.x, own.count, middles)) if space.dim == 3 else own, middles


def beside_corners(space, name):
    """Flags of the facets of this rank (nf,) of a group with convex edges, in the plane vertices, of more than `EDGE`.
    *Collective.*"""
    own = _facets_of(space, name)[0]
    every = _with_neighbours(space, own)
    return np.isin(own.ids, every.ids[sharpness(every) > EDGE])


def has_corner(space, name):
    """Return True if a surface has convex edges, in the plane vertices, of more than `EDGE`. *Collective.*"""
    return space.comm.allreduce(bool(beside_corners(space, name).any()), op=MPI.LOR)


def smooth_surface(space, name, fitted):
    """The smooth surface that the facets of a group stand for. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    name : str
        Facet group.
    fitted : bool
        See `pcontact.contact.surface.vertex_normals.corner_normals`.

    Returns
    -------
    SmoothSurface or None
        None where the facets are what they stand for: all of them flat, or curved ones that are to be taken so.
    """
    if space.mesh.curved and not fitted:
        return None
    own, middles = _facets_of(space, name)
    if _is_plane(space.comm, facet_normals(own)):
        return None
    every = _with_neighbours(space, own)
    order = np.argsort(own.ids)
    normals, bent = np.empty_like(own.x), np.empty(len(order), dtype=bool)
    wanted, border = np.isin(every.ids, own.ids), np.empty(own.x.shape[:2], dtype=bool)
    mid = None if own.mid is None else np.empty_like(own.mid)
    if space.mesh.curved:
        normals[order], border[order], bent[order], found = curved_normals(every, wanted)
        if mid is not None:
            mid[order] = found
    else:
        normals[order], bent[order] = corner_normals(every, wanted, fitted)
    if not space.comm.allreduce(bool(bent.any()), op=MPI.LOR):
        return None
    return SmoothSurface(own, normals, middles, border, mid)


class Chords:
    """Error of straight facets in the gap of a pair: taken off, or measured where that is not asked for.

    Facets do harm where surfaces conform, and the pressure has to close the gaps of the chords. Bodies that are bent
    against each other (Hertz) flatten where they touch, and their facets with them. A facet counts as conforming where
    the gap between the smooth surfaces bends along it by less than `CONFORMING` of what the surfaces do.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    source : pcontact.contact.surface.sides.SourceSurface
    target : pcontact.contact.surface.sides.TargetSurface or None
        None: an obstacle. Its ``smooth`` is set while searches are to tell of it.
    surfaces : (SmoothSurface or None, SmoothSurface or None)
        Of source and target.

    Attributes
    ----------
    applied : bool
        Whether the gap is that between the smooth surfaces.
    error : ndarray (np,)
        Unless it is applied: gap between the facets less that between the smooth surfaces [length] in the search that
        first finds partners, on facets that conform to the target; 0 on others.
    conforms : ndarray (np,) of bool
        Points of these facets.
    """

    def __init__(self, space, contact, source, target, surfaces):
        self._comm, self._target = space.comm, target
        self._points = source.x, source.jxw, source.facet
        self.applied, self._adjusts = contact.smooth_geometry, contact.interference == "adjust"
        own, other = surfaces
        self._offset = np.zeros_like(source.x) if own is None else own.at_source(space, contact.source, source)
        self.error, self.conforms = np.zeros(len(source.x)), np.zeros(len(source.x), dtype=bool)
        self._measured = False
        if target is not None:
            target.smooth = other

    def __call__(self, gap, normal, paired, offset=None):
        """The gap (np,) from that between the facets. *Collective.*

        Parameters
        ----------
        gap : ndarray (np,)
        normal : ndarray (np, d)
            Of contact, from source to target.
        paired : ndarray (np,) of bool
        offset : ndarray (np, d), optional
            Of the target's smooth surface at the partners.
        """
        if self._measured:
            return gap
        heights = [np.where(paired, np.einsum("pd,pd->p", normal, self._offset), 0.0), np.zeros(len(gap))]
        if offset is not None:
            heights[1] = np.where(paired, np.einsum("pd,pd->p", normal, offset), 0.0)
        if self.applied:
            return gap + (heights[1] - heights[0])
        if self._comm.allreduce(bool(paired.any()), op=MPI.LOR):
            self._measure(gap, paired, *heights)
        return gap

    def _measure(self, gap, paired, own, other):
        """Keep the error of the facets that conform; searches need tell no more."""
        (x, weight, facet), error = self._points, own - other
        bends = [_bent(x, weight * paired, facet, value) for value in (gap - error, own, other)]
        scale = np.zeros(len(bends[0]))
        np.maximum.at(scale, facet, np.abs(x).max(axis=1, initial=0.0))
        surfaces = np.maximum(*bends[1:])
        if self._adjusts:
            # an overlap of the chords is taken as the unloaded state, too
            error = np.maximum(gap, 0.0) - np.maximum(gap - error, 0.0)
        self.conforms = paired & ((bends[0] < CONFORMING * surfaces) & (surfaces > ROUNDING * scale))[facet]
        self.error, self._measured = np.where(self.conforms, error, 0.0), True
        self._points = self._offset = None
        if self._target is not None:
            self._target.smooth = None


def _bent(x, weight, facet, value):
    """Distance of values (np,) at points x (np, d) of facets (np,) from linear ones: root of mean squares (nf,)."""
    n, d = int(np.max(facet, initial=-1)) + 1, x.shape[1]

    def summed(values):
        return np.bincount(facet, weight * values, minlength=n)

    total = np.maximum(summed(np.ones(len(value))), np.finfo(float).tiny)
    x = x - np.column_stack([summed(column) / total for column in x.T])[facet]
    value = value - (summed(value) / total)[facet]
    matrix = np.reshape([summed(x[:, i] * x[:, j]) for i in range(d) for j in range(d)], (d, d, n)).transpose(2, 0, 1)
    right = np.column_stack([summed(value * column) for column in x.T])
    # the direction across a facet has no points
    slope = np.einsum("fij,fj->fi", np.linalg.pinv(matrix, rcond=FLATNESS, hermitian=True), right)
    rest = value - np.einsum("pd,pd->p", x, slope[facet])
    return np.sqrt(summed(rest**2) / total)


def _measures(items):
    """Return True if the items of a contact measure what their facets do."""
    return all(item.search.chords is not None and not item.search.chords.applied for item in items)


def _wrong(items, weights):
    """Integral of the square of the pressure that the chords make, and of 1, over points with weights. *Collective.*

    Nitsche's method answers a gap that the shape functions cannot follow with gamma times it. The mean gap, a small
    interference, is left out.
    """
    sums = np.zeros(4)
    for item, weight in zip(items, weights, strict=True):
        stiff = weight * item.method.gamma**2
        error = item.search.chords.error
        sums += [stiff @ error**2, stiff @ error, stiff.sum(), weight.sum()]
    square, first, stiff, area = items[0].space.comm.allreduce(sums, op=MPI.SUM)
    return max(square - first**2 / stiff, 0.0) if stiff > 0.0 else 0.0, area


def facet_error(items, states):
    """Estimated error of the contact pressure by straight facets. *Collective.*

    Parameters
    ----------
    items : list of pcontact.contact.pair.ContactPair
        The halves of a contact.
    states : list of dict
        Of each, see :meth:`pcontact.contact.pair.ContactPair.state`.

    Returns
    -------
    dict
        ``facet_error``, root of mean squares over the closed points, over their mean pressure (the chords' peaks make
        that of squares larger); empty where facets do nothing to the gap.
    """
    if not _measures(items):
        return {}
    closed = [np.where(state["status"] > OPEN, state["weight"], 0.0) for state in states]
    conforming = [weight * item.search.chords.conforms for item, weight in zip(items, closed, strict=True)]
    wrong, _ = _wrong(items, conforming)
    own = sum(np.array([w @ s["pressure"], w.sum()]) for w, s in zip(closed, states, strict=True))
    force, area = items[0].space.comm.allreduce(own, op=MPI.SUM)
    return {"facet_error": float(np.sqrt(wrong * area) / force) if force > 0.0 else 0.0}


def facet_pressure(items):
    """Pressure that the gaps between straight facets make where surfaces conform, before anything is solved.
    *Collective.*

    Parameters
    ----------
    items : list of pcontact.contact.pair.ContactPair
        The halves of a contact, after a search.

    Returns
    -------
    pressure : float
        Root of mean squares [stress]; 0 where nothing conforms, or the facets are what they stand for.
    gap : float
        Largest gap or overlap of the chords [length].
    """
    if not _measures(items):
        return 0.0, 0.0
    wrong, area = _wrong(items, [item.source.jxw * item.search.chords.conforms for item in items])
    largest = max(float(np.max(np.abs(item.search.chords.error), initial=0.0)) for item in items)
    largest = items[0].space.comm.allreduce(largest, op=MPI.MAX)
    return float(np.sqrt(wrong / area)) if area > 0.0 else 0.0, largest
