"""Boundary facets that lie on each other though nothing says that they should.

Where the cells of a mesh do not meet facet to facet (hanging nodes), or where nodes were not merged, the facets between
them belong to one cell each: they are boundary, free of traction, and the body has a cut that nobody wanted. The cut
cannot be seen in the nodes and cells, but its two sides lie on each other and look at each other. So do surfaces in
contact; those the scene names, or the mesh at least has a group for them.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.partners import route
from pcontact.contact.search.tree import build_tree, meeting
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.topology import outer_facets
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.parallel import Asked
from pcontact.runtime.petsc import MPI

# what two facets on each other are: surfaces of two bodies without contact, a cut of one body at which a group of the
# mesh ends, another cut of one body
APART, NAMED, CUT = 1, 2, 3
# largest distance of two facets that lie on each other, as a part of the smaller of the facet's length and its cell's
# depth, and in units of the rounding error of the coordinates
NEAR, ROUNDING = 1e-4, 64.0 * np.finfo(float).eps
# cosine of the angle between the normals of facets that look at each other, at most
FACING = -0.99
# the same of straight facets on a curved surface, and their distance in units of the one above: a coarse facet is then
# known by fine ones that end at all its vertices
CURVED, WIDE = -0.9, 1e3
# places that a message names
PLACES = 3


class Boundary(NamedTuple):
    """Facets of the boundary of this rank's cells.

    Attributes
    ----------
    x : (n, 2, 2) or (n, 4, 3) float64
        Vertices [length] in order; of a triangle the last one twice.
    normal : (n, d) float64
        Unit vectors, outward.
    near : (n,) float64
        How far from it something lies on the facet [length].
    component : (n,) int64
        Connected body.
    named : (n,) int64
        1: a group of facets of the mesh has it.
    """

    x: np.ndarray
    normal: np.ndarray
    near: np.ndarray
    component: np.ndarray
    named: np.ndarray


class Unjoined(NamedTuple):
    """Result of :func:`unjoined`, the same on every rank.

    Attributes
    ----------
    doubled, hanging : int
        Facets inside one body: those that have the vertices of the one that they lie on, and others.
    places : list of str
        Centres of the first of these facets [length], as in a message.
    bodies : list of (int, int)
        Connected bodies that touch without contact.
    named : int
        Facets inside one body of which there is a group in the mesh.
    """

    doubled: int
    hanging: int
    places: list
    bodies: list
    named: int


def unjoined(mesh, exchanger, used, apart):
    """Find boundary facets that lie on each other. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    exchanger : pcontact.runtime.parallel.Exchanger
    used : collection of str
        Groups of facets that are meant to be boundary: contact surfaces, loads, supports.
    apart : bool
        Whether facets of different connected bodies count.

    Returns
    -------
    Unjoined
    """
    own = _boundary(mesh, outer_facets(mesh, exchanger), used)
    kind, other, spanned = _ask(mesh.comm, exchanger, own)
    kind[spanned & (kind < 2 * CUT)] = 2 * CUT
    found = np.column_stack([kind, other, own.component])
    doubled = _total(mesh.comm, kind == 2 * CUT + 1)
    hanging = _total(mesh.comm, kind == 2 * CUT)
    cut = _centres(own.x[kind >= 2 * CUT])
    # the same places whatever the partition; both sides of a cut may have the same
    cut = np.concatenate(mesh.comm.allgather(cut[np.lexsort(cut.T[::-1])][: 2 * PLACES]))
    places = dict.fromkeys(f"({', '.join(f'{c:.6g}' for c in x)})" for x in cut[np.lexsort(cut.T[::-1])])
    pairs = found[kind // 2 == APART][:, 1:] if apart else found[:0, 1:]
    pairs = np.concatenate(mesh.comm.allgather(np.unique(np.sort(pairs, axis=1), axis=0)))
    bodies = [tuple(pair) for pair in np.unique(pairs, axis=0).tolist()]
    return Unjoined(doubled, hanging, list(places)[:PLACES], bodies, _total(mesh.comm, kind // 2 == NAMED))


def _total(comm, flags):
    return comm.allreduce(int(np.count_nonzero(flags)), op=MPI.SUM)


def _centres(x):
    """Means (n, d) of the vertices (n, k, d) of facets."""
    if x.shape[2] == 2:
        return x.mean(axis=1)
    triangle = np.all(x[:, 3] == x[:, 2], axis=1)
    return np.where(triangle[:, None], x[:, :3].mean(axis=1), x.mean(axis=1))


def _boundary(mesh, outer, used):
    """Boundary facets of this rank that no used group has."""
    d, width = mesh.dim, 2 if mesh.dim == 2 else 4
    far = max((float(np.abs(corner).max()) for corner in bounding_box(mesh.comm, mesh.points)), default=0.0)
    members = {number: np.zeros((0, 2), dtype=np.int64) for number in range(len(mesh.blocks))}
    marked = {True: members, False: dict(members)}
    for name, parts in mesh.facet_groups.items():
        for facets in parts:
            own = marked[name in used]
            own[facets.block] = np.vstack([own[facets.block], np.column_stack([facets.cells, facets.local])])
    none = np.zeros(0, dtype=np.int64)
    parts = [(np.zeros((0, width, d)), np.zeros((0, d)), np.zeros(0), none, none)]
    for facets in outer:
        block = mesh.blocks[facets.block]
        key = facets.cells * 8 + facets.local
        said, named = (np.isin(key, marked[which][facets.block] @ [8, 1]) for which in (True, False))
        cells, local, named = facets.cells[~said], facets.local[~said], named[~said]
        x = mesh.points[block.nodes[cells[:, None], facet_nodes(facets.cell, 1)[local]]]
        # the last vertex of a triangle twice
        x = x[:, np.minimum(np.arange(width), x.shape[1] - 1)]
        edges = np.roll(x, -1, axis=1) - x
        if d == 2:
            normal = edges[:, 0, ::-1] * [1.0, -1.0]
        else:
            normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
            normal = np.where((x[:, 3] == x[:, 2]).all(axis=1)[:, None], np.cross(edges[:, 0], edges[:, 1]), normal)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), np.finfo(float).tiny)[:, None]
        corners = mesh.points[block.nodes[cells, : CELLS[block.cell].n_vertices]] - x[:, :1]
        depth = np.abs(np.einsum("cvd,cd->cv", corners, normal)).max(axis=1, initial=0.0)
        size = np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0)
        near = NEAR * np.minimum(size, depth) + ROUNDING * far
        parts.append((x, normal, near, block.components[cells], named.astype(np.int64)))
    return Boundary(*(np.ascontiguousarray(np.concatenate(column)) for column in zip(*parts, strict=True)))


def _ask(comm, exchanger, own):
    """For each facet what it lies on, twice one of the words above plus 1 if vertices are the same, and which body.

    *Collective.* The centre of a facet is inside the one that it lies on; if that one is smaller, its centre is
    inside the first. Third, whether facets that it is near to end at all its vertices.
    """
    n, width, d = own.x.shape
    low, high, centre = own.x.min(axis=1), own.x.max(axis=1), _centres(own.x)
    ranks, away = route(comm, low, high, centre, WIDE * float(np.max(own.near, initial=0.0)))
    k, rows = np.nonzero(away <= WIDE * own.near)
    table = np.column_stack([own.x.reshape(n, width * d), own.normal, own.near, own.component, own.named])
    asked = Asked(exchanger, ranks[k], table[rows])
    x, normal, numbers = np.split(asked.rows, [width * d, width * d + d], axis=1)
    near, component, named = (np.ascontiguousarray(column) for column in numbers.T)
    query = Boundary(np.ascontiguousarray(x).reshape(-1, width, d), np.ascontiguousarray(normal), near,
                     component.astype(np.int64), named.astype(np.int64))  # fmt: skip
    touched, answers, centre = np.zeros((n, width), np.bool_), np.zeros((len(x), 2), np.int64), _centres(query.x)
    reach = WIDE * near[:, None]
    _lie_on(*meeting(build_tree(low, high), centre - reach, centre + reach), own, query, centre, touched, answers)
    kind, other = np.zeros((2, n), dtype=np.int64)
    found = asked.reply(answers)
    np.maximum.at(kind, rows, found[:, 0])
    # of several ranks the first one
    best = np.flatnonzero(found[:, 0] == kind[rows])[::-1]
    other[rows[best]] = found[best, 1]
    return kind, other, touched.all(axis=1)


@njit_exact
def _inside(p, x, normal, near):
    """Return True if a point (d,) is on a facet with vertices (k, d), to a distance."""
    d = p.shape[0]
    away = 0.0
    for i in range(d):
        away += (p[i] - x[0, i]) * normal[i]
    if abs(away) > near:
        return False
    for v in range(x.shape[0]):
        w = (v + 1) % x.shape[0]
        if d == 2:
            # along the facet, from either end
            length, along = 0.0, 0.0
            for i in range(2):
                length += (x[w, i] - x[v, i]) ** 2
                along += (x[w, i] - x[v, i]) * (p[i] - x[v, i])
            if along < -near * np.sqrt(length):
                return False
            continue
        a0, a1, a2 = x[w, 0] - x[v, 0], x[w, 1] - x[v, 1], x[w, 2] - x[v, 2]
        b0, b1, b2 = p[0] - x[v, 0], p[1] - x[v, 1], p[2] - x[v, 2]
        side = normal[0] * (a1 * b2 - a2 * b1) + normal[1] * (a2 * b0 - a0 * b2) + normal[2] * (a0 * b1 - a1 * b0)
        if side < -near * np.sqrt(a0 * a0 + a1 * a1 + a2 * a2):
            return False
    return True


@njit_exact
def _touch(x, y, near, touched):
    """Mark the vertices of a facet (k, d) that are where one of another facet is, to a distance; how many are."""
    count = 0
    for v in range(x.shape[0]):
        found = False
        for w in range(y.shape[0]):
            away = 0.0
            for i in range(x.shape[1]):
                away += (x[v, i] - y[w, i]) ** 2
            found = found or away <= near * near
        touched[v] = touched[v] or found
        count += found
    return count


@njit_exact
def _lie_on(asking, near, own, query, centres, touched, out):
    """For facets that are asked about (`query`) what they lie on, among facets ``near`` (m,) to those `asking` (m,).

    centres (n, d): of the facets asked about; touched (n_facets, k): vertices of this rank's facets at which facets
    near to them end; out (n, 2): see `_ask`.
    """
    width = query.x.shape[1]
    vertices = np.zeros(width, dtype=np.bool_)
    for k in range(len(asking)):
        q, f = asking[k], near[k]
        cosine = 0.0
        for i in range(centres.shape[1]):
            cosine += query.normal[q, i] * own.normal[f, i]
        close = min(query.near[q], own.near[f])
        if cosine > CURVED or not _inside(centres[q], own.x[f], own.normal[f], WIDE * close):
            continue
        kind = APART
        if own.component[f] == query.component[q]:
            kind = NAMED if own.named[f] + query.named[q] > 0 else CUT
        if kind == CUT:
            _touch(own.x[f], query.x[q], close, touched[f])
        if cosine > FACING or not _inside(centres[q], own.x[f], own.normal[f], close):
            continue
        kind = 2 * kind + (_touch(query.x[q], own.x[f], close, vertices) == width)
        if kind > out[q, 0]:
            out[q, 0], out[q, 1] = kind, own.component[f]
