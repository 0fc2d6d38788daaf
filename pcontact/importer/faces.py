"""Faces of the surfaces of a deck, where they look and how far nodes are from them."""

import numpy as np

# cosine of the angle from which faces face each other
FACING = 0.5
# nodes of a line
_LINE = 2


def surface_faces(deck, surface):
    """Faces of a surface; of one of nodes alone, the free faces whose nodes are all in it."""
    if surface.faces or not surface.nodes:
        return surface.faces
    inside = set(surface.nodes)
    return [row for row in deck.free_faces() if inside.issuperset(deck.corners(*row))]


def facing_faces(deck, nodes, others):
    """Free faces with one of some nodes, and of these those that face the other faces, on the whole."""
    against = np.mean([outward(deck, row) for row in others], axis=0)
    inside = set(nodes)
    found = [row for row in deck.free_faces() if inside & set(deck.corners(*row))]
    return [row for row in found if outward(deck, row) @ against < -FACING]


def outward(deck, row):
    """Unit normal (3,) of a face (element, local face), out of its element."""
    points = np.array([deck.nodes[n] for n in deck.corners(*row)])
    ends = points[1] - points[0]
    normal = np.array([ends[1], -ends[0], 0.0]) if len(points) == _LINE else np.cross(ends, points[-1] - points[0])
    centre = np.mean([deck.nodes[n] for n in deck.elements[row[0]][1]], axis=0)
    normal *= np.sign(normal @ (points.mean(axis=0) - centre))
    size = np.linalg.norm(normal)
    return normal / size if size > 0.0 else normal


def distances(deck, nodes, faces):
    """Distances of nodes from the nearest point of faces, (n,), whose edges are straight.

    Parameters
    ----------
    deck : Deck
    nodes : list of int
    faces : list of (int, int)

    Returns
    -------
    list of float
    """
    fans = []
    for row in faces:
        corners = np.array([deck.nodes[n] for n in deck.corners(*row)])
        # a line is a triangle whose last two vertices are the same
        fans += [corners[[0, k, min(k + 1, len(corners) - 1)]] for k in range(1, max(_LINE, len(corners) - 1))]
    fans = np.array(fans)
    return [float(_away(np.array(deck.nodes[node]), fans).min()) for node in nodes]


def _away(point, triangles):
    """Distances (n,) of a point (3,) from triangles (n, 3, 3)."""
    best = np.full(len(triangles), np.inf)
    for k in range(3):
        a, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        size = np.einsum("ni,ni->n", edge, edge)
        along = np.einsum("ni,ni->n", point - a, edge) / np.where(size > 0.0, size, 1.0)
        best = np.minimum(best, np.linalg.norm(point - a - np.clip(along, 0.0, 1.0)[:, None] * edge, axis=1))
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inside = np.linalg.norm(normal, axis=1) > 0.0
    for k in range(3):
        edge = triangles[:, (k + 1) % 3] - triangles[:, k]
        inside &= np.einsum("ni,ni->n", np.cross(edge, point - triangles[:, k]), normal) >= 0.0
    height = np.einsum("ni,ni->n", point - triangles[inside, 0], normal[inside])
    best[inside] = np.abs(height) / np.linalg.norm(normal[inside], axis=1)
    return best
