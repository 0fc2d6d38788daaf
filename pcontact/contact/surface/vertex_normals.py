"""Normals at the corners of straight facets, of the smooth surface that the facets stand for.

Facets that meet at an edge belong to one smooth surface where they turn by no more than `EDGE`, and the surface goes on
turning on one side at least: an edge between two flat faces is an edge, however blunt. Corners of facets around a
vertex that hang together by smooth edges share a normal. It is that of a quadratic height function, fitted by least
squares to the vertices of two layers of facets around (the osculating jet of Cazals and Pouget 2005): of second order
in the mesh size, on irregular meshes and at the border of the surface, too. Where the fit leaves much of the heights
(the tip of a cone), the facets keep their own normals. Means of the facets' normals cost a tenth of that; with the
weights of Max (1999) they are exact on a sphere, of first order on other surfaces, and wrong at the border.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.sides import diameters, tangents_of
from pcontact.mesh.topology import merged

# largest angle between the normals of two facets of a smooth surface [rad]
EDGE = np.deg2rad(40.0)
# angle from which on they are not one plane, far above rounding [rad]
FLAT = 1e-6
# how many times as much as anywhere else on two facets, in the same sense, a smooth surface turns at the edge between
# them at most; and in the other sense, as diagonals do that are not the best ones
ISOLATED, SLIGHT = 4.0, 0.5
# angle between curved facets that belong to one smooth surface, as a part of what they turn themselves, at most. A
# twentieth on arcs of 45 degrees
BLUNT = 0.25
# part of the heights (root of mean squares) that a fit may leave
UNFIT = 0.25
# vertices that are fitted at a time
CHUNK = 4096
# eigenvalues of the normal equations below this part of the largest count as zero: directions without points
RANK = 1e-7


class Facets(NamedTuple):
    """Straight facets, sorted by their global numbers.

    Attributes
    ----------
    ids : ndarray (nf,)
        Global numbers.
    count : ndarray (nf,)
        Vertices of each: 2, 3 or 4.
    nodes : ndarray (nf, m)
        Global numbers of the vertices in outward order; m = 2 in the plane, 4 in space. Triangles repeat the first.
    x : ndarray (nf, m, d)
        Their coordinates [length].
    own : ndarray (nf, m, d) or None
        Of curved facets: the normals at their vertices.
    mid : ndarray (nf, m, d) or None
        Of curved facets in space: the normals in the middle of their edges, from each vertex to the next one.
    """

    ids: np.ndarray
    count: np.ndarray
    nodes: np.ndarray
    x: np.ndarray
    own: np.ndarray | None = None
    mid: np.ndarray | None = None


def facet_normals(facets):
    """Unit normals (nf, d); of a warped quadrilateral that of its middle."""
    x = facets.x - facets.x[:, :1]
    if x.shape[2] == 2:
        normal = np.column_stack([x[:, 1, 1], -x[:, 1, 0]])
    else:
        # the fourth corner of a triangle is its first
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    return _unit(normal)


def _unit(v):
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0.0, length, 1.0)


def _slots(facets):
    """Corners (n, k) of facets that make an edge, in the plane a vertex: facet (n,), corners, key (n,) of the edge."""
    m = facets.nodes.shape[1]
    if m == 2:
        rows = np.repeat(np.arange(len(facets.ids)), 2)
        corner = np.tile([0, 1], len(facets.ids))[:, None]
        return rows, corner, facets.nodes[rows, corner[:, 0]]
    rows = np.repeat(np.arange(len(facets.ids)), 4)
    first = np.tile(np.arange(4), len(facets.ids))
    real = first < facets.count[rows]
    rows, first = rows[real], first[real]
    corner = np.column_stack([first, (first + 1) % facets.count[rows]])
    ends = np.sort(np.take_along_axis(facets.nodes[rows], corner, axis=1), axis=1)
    return rows, corner, ends[:, 0] * (int(np.max(ends, initial=0)) + 1) + ends[:, 1]


def _turns(facets, normal, rows, key):
    """Pairs (n, 2) of slots that share an edge, and the angle (n,) there [rad], positive where it is convex."""
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    first = first[count == 2]
    pairs = np.column_stack([order[first], order[first + 1]])
    f, g = rows[pairs].T
    corners = np.arange(facets.nodes.shape[1])[None, :, None] < facets.count[:, None, None]
    centre = np.sum(np.where(corners, facets.x, 0.0), axis=1) / facets.count[:, None]
    change = normal[g] - normal[f]
    angle = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(change, axis=1), 0.0, 1.0))
    return pairs, np.copysign(angle, np.einsum("nd,nd->n", change, centre[g] - centre[f]))


def _beside(turn, facet):
    """Largest turn (n,) at another edge of the two facets (n, 2) of every edge, from the turns (n,) there."""
    n = int(np.max(facet, initial=-1)) + 1
    largest, second = np.zeros(n), np.zeros(n)
    both = np.repeat(turn[:, None], 2, axis=1)
    np.maximum.at(largest, facet, both)
    top = both == largest[facet]
    np.maximum.at(second, facet[~top], both[~top])
    # facets with two equal largest turns have as large a second one
    second = np.where(np.bincount(facet[top], minlength=n) > 1, largest, second)
    return np.where(top, second[facet], largest[facet]).max(axis=1, initial=0.0)


def _smooth(facet, angle):
    """Flags of the edges (n,) between facets (n, 2) that belong to a smooth surface."""
    size, convex = np.abs(angle), angle > 0.0
    along = np.where(convex, _beside(size * convex, facet), _beside(size * ~convex, facet))
    goes_on = (size <= ISOLATED * along) | (size <= SLIGHT * _beside(size, facet))
    return (size <= FLAT) | ((size <= EDGE) & goes_on)


def _fans(facets, rows, corner, pairs):
    """Number (nf, m) of the smooth vertex of every corner, from pairs (n, 2) of slots that share a smooth edge."""
    nf, m = facets.nodes.shape
    (a, b), links = pairs.T, []
    for i in range(corner.shape[1]):
        one = rows[a] * m + corner[a, i]
        for j in range(corner.shape[1]):
            other = rows[b] * m + corner[b, j]
            same = facets.nodes.ravel()[one] == facets.nodes.ravel()[other]
            links.append(np.column_stack([one, other])[same])
    label = merged(nf * m, np.concatenate(links)).reshape(nf, m)
    # the fourth corner of a triangle is its first
    label = np.where(np.arange(m) < facets.count[:, None], label, label[:, :1])
    _, number = np.unique(label, return_inverse=True)
    return number.reshape(nf, m)


def _facets_of(vertex, corners):
    """Facets of every vertex: where each begins (n + 1,), and their rows, from the vertices (nf, m) of the facets."""
    facet, _ = np.nonzero(corners)
    at = vertex[corners]
    order = np.argsort(at, kind="stable")
    return np.searchsorted(at[order], np.arange(int(np.max(vertex, initial=-1)) + 2)), facet[order]


def _around(vertex, x, chosen, table):
    """Pairs (n, 2): chosen vertices, and the vertices of two layers of facets (nf, m) around each; sorted."""
    n, (start, facet) = len(x), table
    pairs = np.column_stack([chosen] * 2)
    for _ in range(2):
        count = (start[1:] - start[:-1])[pairs[:, 1]]
        first = np.cumsum(count) - count
        place = np.arange(count.sum()) - np.repeat(first, count) + np.repeat(start[pairs[:, 1]], count)
        touched = vertex[facet[place]]
        ends = np.repeat(pairs[:, 0], count)
        key = np.unique((ends[:, None] * n + touched).ravel())
        pairs = np.column_stack([key // n, key % n])
    # what an edge makes of one vertex is in one place
    return pairs[(x[pairs[:, 0]] != x[pairs[:, 1]]).any(axis=1)]


def _fit(pairs, x, frame_normal):
    """Normals (n, d) of the height functions at the vertices that pairs begin with, and whether each fits.

    Parameters
    ----------
    pairs : ndarray (p, 2)
        Vertex and neighbour, sorted by vertex.
    x : ndarray (v, d)
        Coordinates of the vertices.
    frame_normal : ndarray (v, d)
        Heights are along it.

    Returns
    -------
    vertex, normal, good
    """
    vertex, first = np.unique(pairs[:, 0], return_index=True)
    place = np.repeat(np.arange(len(vertex)), np.diff([*first, len(pairs)]))
    frame = tangents_of(frame_normal[vertex])
    offset = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(offset, axis=1)
    scale = np.add.reduceat(length, first) / np.diff([*first, len(pairs)])
    offset, length = offset / scale[place, None], length / scale[place]
    height = np.einsum("pd,pd->p", offset, frame_normal[pairs[:, 0]])
    s = np.einsum("pkd,pd->pk", frame[place], offset)
    columns = [s, 0.5 * s**2] if s.shape[1] == 1 else [s, 0.5 * s**2, s[:, :1] * s[:, 1:]]
    # slopes to the neighbours: the near ones count most
    a, z = np.concatenate(columns, axis=1) / length[:, None], height / length
    matrix = np.add.reduceat(a[:, :, None] * a[:, None, :], first, axis=0)
    right = np.add.reduceat(a * z[:, None], first, axis=0)
    solution = np.einsum("vij,vj->vi", np.linalg.pinv(matrix, rcond=RANK, hermitian=True), right)
    left = np.add.reduceat((z - np.einsum("pi,pi->p", a, solution[place])) ** 2, first)
    good = left <= UNFIT**2 * np.add.reduceat(z**2, first)
    normal = frame_normal[vertex] - np.einsum("vk,vkd->vd", solution[:, : s.shape[1]], frame)
    return vertex, _unit(normal), good


def _mean_normals(facets, own, vertex, corners):
    """Means (n, d) of the facets' normals (nf, m, d) around every vertex."""
    m, d = facets.x.shape[1:]
    n = int(np.max(vertex, initial=-1)) + 1
    if d == 2:
        weight = 1.0 / np.linalg.norm(facets.x[:, 1] - facets.x[:, 0], axis=1)[:, None].repeat(2, axis=1)
    else:
        corner, rows = np.arange(m)[None, :], np.arange(len(vertex))[:, None]
        after = facets.x[rows, (corner + 1) % facets.count[:, None]] - facets.x
        before = facets.x[rows, (corner - 1) % facets.count[:, None]] - facets.x
        lengths = np.sum(after**2, axis=2) * np.sum(before**2, axis=2)
        weight = np.linalg.norm(np.cross(after, before), axis=2) / np.where(lengths > 0.0, lengths, 1.0)
    mean = np.zeros((n, d))
    np.add.at(mean, vertex[corners], (weight[:, :, None] * own)[corners])
    return _unit(mean)


def _turning(rows, corner, pairs, smooth, angle):
    """Slots (n,) of edges where the surface turns, and of those beside them where it ends."""
    turning = pairs[smooth & (np.abs(angle) > FLAT)]
    turns, ends = np.zeros(int(np.max(rows, initial=-1)) + 1, dtype=bool), np.ones(len(rows), dtype=bool)
    turns[rows[turning]], ends[pairs[smooth]] = True, False
    ends &= turns[rows]
    ends[turning] = True
    return np.flatnonzero(ends)


def corner_normals(facets, wanted, fitted=True):
    """Normals of the smooth surface at the corners of facets.

    Parameters
    ----------
    facets : Facets
        With three layers of neighbours around those that are wanted.
    wanted : ndarray (nf,) of bool
    fitted : bool
        Whether they are fitted or means.

    Returns
    -------
    normals : ndarray (n, m, d)
        Of the wanted facets, in their order; where the surface is flat or has an edge, those of the facets themselves.
    bent : ndarray (n,) of bool
        Facets with a corner whose normal is not their own.
    """
    normal = facet_normals(facets)
    m, d = facets.x.shape[1:]
    own = np.repeat(normal[:, None], m, axis=1)
    rows, corner, key = _slots(facets)
    pairs, angle = _turns(facets, normal, rows, key)
    smooth = _smooth(rows[pairs], angle)
    slots = _turning(rows, corner, pairs, smooth, angle)
    if not len(slots):
        return own[wanted], np.zeros(int(wanted.sum()), dtype=bool)
    vertex = _fans(facets, rows, corner, pairs[smooth])
    corners = np.arange(m)[None, :] < facets.count[:, None]
    n = int(vertex.max()) + 1
    x, chosen, needed = np.zeros((n, d)), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    x[vertex] = facets.x
    chosen[vertex[rows[slots, None], corner[slots]]], needed[vertex[wanted]] = True, True
    chosen = np.flatnonzero(chosen & needed)
    values, good = _mean_normals(facets, own, vertex, corners), np.zeros(n, dtype=bool)
    good[chosen] = True
    table = _facets_of(vertex, corners)
    for first in range(0, len(chosen) if fitted else 0, CHUNK):
        some = chosen[first : first + CHUNK]
        fits = _fit(_around(vertex, x, some, table), x, values)
        good[some] = False
        good[fits[0]], values[fits[0]] = fits[2], fits[1]
    result = np.where(good[vertex][:, :, None], values[vertex], own)
    return result[wanted], good[vertex].any(axis=1)[wanted]


def _kinks(facets, rows, corner, pairs):
    """Largest angle (n,) between the normals of the two curved facets at the ends of the edges that they share."""
    (a, b), largest = pairs.T, np.zeros(len(pairs))
    for i in range(corner.shape[1]):
        for j in range(corner.shape[1]):
            one, other = (rows[a], corner[a, i]), (rows[b], corner[b, j])
            change = np.linalg.norm(facets.own[one] - facets.own[other], axis=1)
            np.maximum(largest, change, out=largest, where=facets.nodes[one] == facets.nodes[other])
    return largest


def sharpness(facets):
    """Largest angle (nf,) [rad] by which facets turn away from others at edges that they share."""
    rows, corner, key = _slots(facets)
    pairs, angle = _turns(facets, facet_normals(facets), rows, key)
    size = np.abs(angle) if facets.own is None else _kinks(facets, rows, corner, pairs)
    largest = np.zeros(len(facets.ids))
    np.maximum.at(largest, rows[pairs], np.where(angle > 0.0, size, 0.0)[:, None])
    return largest


def curved_normals(facets, wanted):
    """Normals of the smooth surface at the corners of curved facets: means of their own, which hardly differ.

    Parameters
    ----------
    facets : Facets
        With their own normals, and a layer of neighbours around those that are wanted.
    wanted : ndarray (nf,) of bool

    Returns
    -------
    normals : ndarray (n, m, d)
        Of the wanted facets, in their order.
    border : ndarray (n, m) of bool
        Corners at which the surface ends or has an edge: across it their normal says nothing.
    bent : ndarray (n,) of bool
        Facets with a normal that is not their own.
    mid : ndarray (n, m, d) or None
        Normals in the middle of their edges, nan where the surface ends there.
    """
    m = facets.x.shape[1]
    rows, corner, key = _slots(facets)
    pairs, _ = _turns(facets, facet_normals(facets), rows, key)
    # between its own normals, of length 1
    turns = diameters(facets.own)[rows[pairs]].max(axis=1, initial=0.0)
    smooth = _kinks(facets, rows, corner, pairs) <= FLAT + BLUNT * turns
    vertex = _fans(facets, rows, corner, pairs[smooth])
    values = _mean_normals(facets, facets.own, vertex, np.arange(m)[None, :] < facets.count[:, None])
    alone = np.ones(len(rows), dtype=bool)
    alone[pairs[smooth]] = False
    border = np.zeros(len(values), dtype=bool)
    border[vertex[rows[alone, None], corner[alone]]] = True
    normals = values[vertex]
    bent = (np.abs(normals - facets.own) > FLAT).any(axis=(1, 2))
    return normals[wanted], border[vertex][wanted], bent[wanted], _mids(facets, rows, corner, pairs[smooth], wanted)


def _mids(facets, rows, corner, pairs, wanted):
    """See :func:`curved_normals`: means of both facets of an edge."""
    if facets.mid is None:
        return None
    mid, places = np.full_like(facets.mid, np.nan), (rows[pairs], corner[pairs, 0])
    mid[places] = _unit(facets.mid[places].sum(axis=1))[:, None]
    return mid[wanted]
