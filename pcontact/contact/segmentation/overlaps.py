"""Source facets in space cut along the edges of the target facets they face, see `.pieces`.

The corners of target facets, of all ranks, are moved along the normal of a source facet onto it, and the polygons that
they make there are clipped: neighbours share their corners, so that what they cover fits together to rounding. Edges
are straight in the facet's reference domain; where facets are curved, or far apart and not parallel, the partner
changes a little beside the cut, by a length of second order. Facets that face no target nearby keep their rule.
"""

from functools import cached_property

import numpy as np

from pcontact.contact.search.partners import route
from pcontact.contact.search.tree import build_tree, meeting
from pcontact.contact.segmentation.clipping import Polygons, Tiles, clip, tile
from pcontact.contact.surface.facet_maps import SQUARE_CORNERS, TRIANGLE_CORNERS, facet_boxes
from pcontact.element.reference import facet_nodes
from pcontact.element.shape import shape, shape_gradient
from pcontact.runtime.parallel import Asked

# how far along its normal a facet looks for those it is cut by, over its extent
REACH = 2.0
# margin of the boxes for curved facets, over their extent, and of what is seen of target facets, over the width
MARGIN = 0.05
# cosine of the angle of a target facet that is not yet seen edge-on
EDGE_ON = 0.02
# difference of distances and areas that rounding may make, over the extent and in the reference domain
ALIKE = 1e-8
# twice the area by which a polygon may be concave: rounding [square of the extent, reference area]
BENT = 1e-12
# Newton iterations, of which curved facets need a few
ITERATIONS = 12
# corners of the kinds of `pcontact.contact.surface.facet_maps`
KIND_CORNERS = np.array([2, 2, 3, 3, 4, 4, 4])


class _Frames:
    """Source facets of one part: nodes (n, m, 3), centre, unit normal and two tangents (n, 3), extent (n,).

    The extent is the largest distance between two nodes; ``body`` (n,) are the connected bodies.
    """

    def __init__(self, space, facets):
        mesh, block = space.mesh, space.mesh.blocks[facets.block]
        table, self.degree = mesh.geometry_nodes(block)
        self.kind, self.body = facets.kind, block.components[facets.cells]
        nodes = table[facets.cells[:, None], facet_nodes(facets.cell, self.degree)[facets.local]]
        self.nodes = mesh.points[nodes]
        centre = _corners(self.kind).mean(axis=0, keepdims=True)
        self.centre = np.einsum("a,nai->ni", shape(self.kind, self.degree, centre)[0], self.nodes)
        slope = np.einsum("ak,nai->nik", shape_gradient(self.kind, self.degree, centre)[0], self.nodes)
        normal = np.cross(slope[:, :, 0], slope[:, :, 1])
        self.normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        first = slope[:, :, 0] / np.linalg.norm(slope[:, :, 0], axis=1)[:, None]
        self.tangents = np.stack([first, np.cross(self.normal, first)], axis=1)
        self.extent = np.linalg.norm(self.nodes[:, :, None] - self.nodes[:, None], axis=3).max(axis=(1, 2))

    def boxes(self):
        """Boxes around the facets and what they may face: two arrays (n, 3)."""
        way = REACH * self.extent[:, None] * self.normal
        ends = np.concatenate([self.nodes + way[:, None], self.nodes - way[:, None]], axis=1)
        margin = MARGIN * self.extent[:, None]
        return ends.min(axis=1) - margin, ends.max(axis=1) + margin

    def beside(self, rows, y):
        """Points y (n, m, 3) beside facets ``rows`` (n,), in these facets' planes: (n, m, 2), over their extents."""
        away = (y - self.centre[rows][:, None]) / self.extent[rows][:, None, None]
        return np.einsum("nki,nmi->nmk", self.tangents[rows], away)

    @cached_property
    def borders(self):
        """Lines (n, e, 2, 2) in the planes of the facets, two points each, which have the facets on their left."""
        every = self.beside(np.arange(len(self.nodes)), self.nodes)
        n = len(_corners(self.kind))
        start, way = every[:, :n], np.roll(every[:, :n], -1, axis=1) - every[:, :n]
        out = np.stack([way[:, :, 1], -way[:, :, 0]], axis=2) / np.linalg.norm(way, axis=2)[:, :, None]
        height = np.einsum("nek,neak->nea", out, every[:, None] - start[:, :, None])
        bulge, depth = height.max(axis=2), -height.min(axis=2)
        start = start + (bulge + MARGIN * depth)[:, :, None] * out
        return np.stack([start, start + way], axis=2)

    def inverse(self, rows, y):
        """Reference points (n, 2) of facets ``rows`` (n,) whose places are points y (n, 2) of their planes."""
        flat = self.beside(rows, self.nodes[rows])
        xi = np.tile(_corners(self.kind).mean(axis=0), (len(rows), 1))
        for _ in range(1 if self.kind == "triangle" and self.degree == 1 else ITERATIONS):
            miss = y - np.einsum("pa,pak->pk", shape(self.kind, self.degree, xi), flat)
            slope = np.einsum("pai,pak->pki", shape_gradient(self.kind, self.degree, xi), flat)
            det = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
            with np.errstate(all="ignore"):
                xi = xi + np.column_stack([
                    (slope[:, 1, 1] * miss[:, 0] - slope[:, 0, 1] * miss[:, 1]) / det,
                    (slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]) / det,
                ])  # fmt: skip
        return xi


def _corners(kind):
    """Vertices (n, 2) of the reference domain, counter-clockwise."""
    return TRIANGLE_CORNERS if kind == "triangle" else SQUARE_CORNERS


def _faced(space, target, low, high):
    """Target facets of all ranks whose boxes meet those of this rank's source facets. *Collective.*

    Returns
    -------
    row : ndarray (n,)
        Number of the box.
    number, count, body : ndarray (n,)
        Global number of the facet, how many corners it has, and its connected body.
    corners : ndarray (n, 4, 3)
        Padded.
    """
    boxes = facet_boxes(target.x, target.kinds)
    tree = build_tree(*boxes)
    half = 0.5 * np.linalg.norm(high - low, axis=1)
    ranks, away = route(space.comm, *boxes, 0.5 * (low + high), float(np.max(half, initial=0.0)))
    box, k = np.nonzero((away <= half).T)
    asked = Asked(space.exchanger, ranks[k], np.column_stack([low[box], high[box]]))
    query, facet = meeting(tree, asked.rows[:, :3], asked.rows[:, 3:])
    corners = target.x[facet][:, [0, 1, 2, 3 if target.x.shape[1] > 3 else 2]].reshape(-1, 12)
    numbers = target.ids[facet], KIND_CORNERS[target.kinds[facet]], target.components[facet]
    row, heard = asked.reply_some(query, np.column_stack([*numbers, corners]))
    return box[row], *heard[:, :3].astype(np.int64).T, heard[:, 3:].reshape(-1, 4, 3)


def _convex(polygons, corners):
    """Polygons (n, k, 2) with their numbers of corners as convex ones: rows, polygons and corners of these.

    Vertices beyond the corners repeat one of them.
    """
    k = polygons.shape[1]
    place = np.arange(k)
    rows = np.arange(len(polygons))[:, None]
    after, before = (place + 1) % corners[:, None], (place - 1) % corners[:, None]
    ahead, behind = polygons[rows, after] - polygons, polygons - polygons[rows, before]
    turn = behind[:, :, 0] * ahead[:, :, 1] - behind[:, :, 1] * ahead[:, :, 0]
    turn[place >= corners[:, None]] = np.inf
    bent = np.any(turn < -BENT, axis=1)
    rows = np.flatnonzero(~bent)
    found = [(rows, polygons[rows], corners[rows])]
    # all triangles begin at the corner that turns the other way
    start = np.argmin(turn, axis=1)
    for second in range(1, k - 1):
        rows = np.flatnonzero(bent & (corners >= second + 2))
        chosen = (start[rows, None] + np.minimum(place, 2) + (place > 0) * (second - 1)) % corners[rows, None]
        found.append((rows, polygons[rows[:, None], chosen], np.full(len(rows), 3)))
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))


def _ranking(frames, row, away, centre, polygons):
    """Keys (n,) by which polygons of a facet are ordered, the last one first: nearness, then size and place.

    Numbers that rounding errors may tell apart are equal.
    """
    scale = ALIKE * frames.extent[row]
    aside = np.linalg.norm(centre - frames.centre[row], axis=1)
    x, y = np.moveaxis(polygons.vertices - polygons.vertices[:, :1], 2, 0)
    size = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return np.rint(aside / scale), np.rint(-size / ALIKE), np.rint(away / scale)


def _polygons(target, frames, row, number, count, body, corners):
    """Polygons of source facets that target facets cover: first (nf + 1,), and their polygons."""
    centre = np.where((count == 3)[:, None], corners[:, :3].mean(axis=1), corners.mean(axis=1))
    ahead = np.einsum("ni,ni->n", centre - frames.centre[row], frames.normal[row])
    away = np.abs(ahead)
    diagonals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    diagonals[count == 3] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[count == 3]
    facing = np.einsum("ni,ni->n", diagonals, frames.normal[row])
    kept = (facing < -EDGE_ON * np.linalg.norm(diagonals, axis=1)) & (away <= REACH * frames.extent[row])
    kept &= target.may_meet(frames.body[row], body, ahead)
    row, number, count, corners, away = row[kept], number[kept], count[kept], corners[kept], away[kept]
    # seen from the source they run the other way round
    back = np.where((count == 3)[:, None], [2, 1, 0, 0], [3, 2, 1, 0])
    flat = frames.beside(row, np.take_along_axis(corners, back[:, :, None], axis=1))
    which, flat, count = _convex(flat, count)
    lines = frames.borders[row[which]]
    room = flat.shape[1] + lines.shape[1]
    clipped = Polygons(np.zeros((len(which), room, 2)), np.zeros(len(which), dtype=np.int64))
    clip(Polygons(flat, count), lines, clipped)
    left = np.flatnonzero(clipped.corners)
    count, which = clipped.corners[left], which[left]
    place = np.arange(room)
    polygon, corner = np.nonzero(place < count[:, None])
    xi = np.zeros((len(left), room, 2))
    xi[polygon, corner] = frames.inverse(row[which[polygon]], clipped.vertices[left[polygon], corner])
    rows, polygons, count = _convex(xi[np.arange(len(left))[:, None], place * (place < count[:, None])], count)
    which = which[rows]
    kept = np.all(np.isfinite(polygons), axis=(1, 2))
    which, polygons = which[kept], Polygons(np.ascontiguousarray(polygons[kept]), count[kept])
    keys = _ranking(frames, row[which], away[which], centre[which], polygons)
    order = np.lexsort((number[which], *keys, row[which]))
    first = np.searchsorted(row[which][order], np.arange(len(frames.centre) + 1))
    return first, Polygons(*(values[order] for values in polygons))


def tiles(space, parts, target):
    """Tiles of the source facets of this rank which face a target nearby. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Three-dimensional.
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    target : pcontact.contact.surface.sides.TargetSurface

    Returns
    -------
    part, row : ndarray (n,)
        Part, and row in it, of each tile's facet.
    kinds : ndarray (n,)
        3: a triangle, 4: a parallelogram.
    vertices : ndarray (n, 3, 2)
        In the facet's reference domain: a vertex and its two neighbours.
    """
    every = [_Frames(space, facets) for facets in parts]
    boxes = [frames.boxes() for frames in every] or [(np.zeros((0, 3)), np.zeros((0, 3)))]
    faced = _faced(space, target, *(np.concatenate(side) for side in zip(*boxes, strict=True)))
    none = np.zeros(0, dtype=np.int64)
    found, begin = [(none, none, none, np.zeros((0, 3, 2)))], 0
    for k, frames in enumerate(every):
        end = begin + len(frames.centre)
        own = (faced[0] >= begin) & (faced[0] < end)
        arguments = (
            _corners(frames.kind), *_polygons(target, frames, faced[0][own] - begin, *(a[own] for a in faced[1:])),
            np.zeros(len(frames.centre), dtype=bool),
        )  # fmt: skip
        begin, room = end, tile(*arguments, Tiles(none, none, np.zeros((0, 3, 2))))
        cut = Tiles(np.zeros(room, np.int64), np.zeros(room, np.int64), np.zeros((room, 3, 2)))
        tile(*arguments, cut)
        found.append((np.full(room, k), *cut))
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))
