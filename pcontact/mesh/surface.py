"""Surfaces without cells: facets of a mesh file, joined by their nodes and turned one way."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact.mesh.groups import KINDS
from pcontact.mesh.reader import read_file
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.messages import input_error, listed, unknown_name

# [extent of the surface] Nodes that are nearer are one: files of surfaces alone may have those of each facet. From: the
# six digits of single precision, in which such files are written.
SAME = 1e-6
# rows of a facet's nodes in the other direction, by its number of corners; of degree 1 the first ones
REVERSED = {2: [1, 0, 2], 3: [0, 2, 1, 5, 4, 3], 4: [0, 3, 2, 1, 7, 6, 5, 4, 8]}
CORNERS = {"segment": 2, "triangle": 3, "quadrilateral": 4}
WIDTH = 9  # most nodes of a facet


class FacetSurface(NamedTuple):
    """A surface of facets, which face one way.

    Attributes
    ----------
    points : ndarray (n, d)
        [length]
    nodes : ndarray (nf, 9)
        Of each facet in VTK's order; short rows are filled up with the first one.
    kinds : list of (str, int)
        Cell and degree of each facet.
    """

    points: np.ndarray
    nodes: np.ndarray
    kinds: list


def read_surface(path, dim, region, where):
    """Read a surface, serially.

    Parameters
    ----------
    path : str or pathlib.Path
    dim : int
        Of the space, 2 or 3.
    region : str or None
        Group of facets; None: all of them.
    where : (str, str)
        Scene and key of the obstacle, for messages.

    Returns
    -------
    FacetSurface
        Normals of closed parts look outwards; those of an open one to where that of its first facet looks in the file,
        by the right hand, in the plane to the right of the line.

    Raises
    ------
    InputError
        No such file, group, or facets; facets of which more than two meet, or which cannot face one way.
    """
    file = read_file(Path(path))
    tables = [(k, one) for k, one in enumerate(file.tables) if one.dim == dim - 1 and one.kind in KINDS]
    if region is not None:
        rows = dict(file.groups.get((dim - 1, region), []))
        if not rows:
            names = sorted(name for kind, name in file.groups if kind == dim - 1)
            found = unknown_name(region, "no such group of facets", names)
            raise input_error(where[0], f"{where[1]}.region", found, listed(names) or "a file with groups of facets")
        tables = [(k, replace(table, nodes=table.nodes[np.unique(rows[k])])) for k, table in tables if k in rows]
    if not any(len(table.nodes) for _, table in tables):
        what = "triangles and quadrilaterals" if dim == 3 else "segments"
        raise input_error(where[0], f"{where[1]}.file", f"{path}, without facets", f"a file with {what}")
    kinds, nodes = [], []
    for _, table in tables:
        kinds += [KINDS[table.kind]] * len(table.nodes)
        nodes.append(_filled(table, file))
    points, nodes = _joined(file.points[:, :dim], np.vstack(nodes))
    if not np.isfinite(points).all():
        raise input_error(where[0], f"{where[1]}.file", f"{path}, with a node that is no place", "finite numbers")
    corners = np.array([CORNERS[cell] for cell, _ in kinds])
    neighbour, agrees = _neighbours(points, nodes, corners, (path, *where))
    sign, part = np.zeros(len(nodes), dtype=np.int64), np.full(len(nodes), -1, dtype=np.int64)
    wrong = _spread(neighbour, agrees, sign, part)
    if wrong >= 0:
        place = ", ".join(f"{c:g}" for c in points[nodes[wrong, 0]])
        found = f"{path}, whose facets at ({place}) face both ways at once"
        raise input_error(where[0], f"{where[1]}.file", found, "a surface with two sides")
    _outwards(points, nodes, corners, neighbour, sign, part)
    for count in REVERSED:
        turned = (corners == count) & (sign < 0)
        nodes[turned] = _reversed(nodes[turned], count)
    return FacetSurface(points, nodes, kinds)


def _filled(table, file):
    """Nodes (n, 9) of a table; eight-node quadrilaterals get their middles, which are added to the points."""
    nodes = table.nodes
    if table.kind == "quad8":
        weights = np.array([-0.25] * 4 + [0.5] * 4)
        middles = np.einsum("i,nid->nd", weights, file.points[nodes])
        nodes = np.column_stack([nodes, len(file.points) + np.arange(len(nodes))])
        file.points = np.vstack([file.points, middles])
    return np.column_stack([nodes, np.repeat(nodes[:, :1], WIDTH - nodes.shape[1], axis=1)])


def _joined(points, nodes):
    """Points that the facets have, those in the same place once."""
    used, nodes = np.unique(nodes, return_inverse=True)
    nodes, points = nodes.reshape(-1, WIDTH), points[used]
    cells = np.round((points - points.min(axis=0)) / (SAME * max(np.ptp(points, axis=0).max(), 1e-300)))
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return points[first], number.ravel()[nodes]


def _neighbours(points, nodes, corners, where):
    """Facet beside each side (nf, 4), -1 for none, and whether both face one way there: side i of facets in space is
    the edge from corner i to the next one, in the plane it is end i."""
    n, dim = len(nodes), points.shape[1]
    facet, side, ends, way = [], [], [], []
    for count in np.unique(corners):
        rows = np.flatnonzero(corners == count)
        for i in range(count):
            a, b = nodes[rows, i], nodes[rows, (i + 1) % count]
            # in the plane facets meet at nodes, one where it begins, the other where it ends
            pair = np.sort(np.column_stack([a, b]), axis=1) if dim == 3 else np.column_stack([a, a])
            facet.append(rows)
            side.append(np.full(len(rows), i))
            ends.append(pair)
            way.append((a < b) if dim == 3 else np.full(len(rows), i == 0))
    facet, side, ends, way = (np.concatenate(one) for one in (facet, side, ends, way))
    order = np.lexsort((facet, ends[:, 1], ends[:, 0]))
    same = np.all(ends[order[1:]] == ends[order[:-1]], axis=1)
    if np.any(same[1:] & same[:-1]):
        at = order[np.flatnonzero(same[1:] & same[:-1])[0]]
        count = int(np.sum(np.all(ends == ends[at], axis=1)))
        place = ", ".join(f"{c:g}" for c in points[ends[at]].mean(axis=0))
        found = f"{count} facets of {where[0]} that meet at ({place})"
        raise input_error(where[1], f"{where[2]}.file", found, "a surface, of which no more than two meet")
    neighbour, agrees = np.full((n, 4), -1, dtype=np.int64), np.ones((n, 4), dtype=bool)
    first, second = order[:-1][same], order[1:][same]
    neighbour[facet[first], side[first]], neighbour[facet[second], side[second]] = facet[second], facet[first]
    agrees[facet[first], side[first]] = agrees[facet[second], side[second]] = way[first] != way[second]
    return neighbour, agrees


@njit_exact
def _spread(neighbour, agrees, sign, part):
    """Write to sign (nf,) which facets face the way of the first one of their part, and the number of the part;
    returns a facet that cannot, or -1."""
    n, stack, count = len(sign), np.empty(len(sign), dtype=np.int64), 0
    for seed in range(n):
        if part[seed] >= 0:
            continue
        sign[seed], part[seed], stack[0], depth = 1, count, seed, 1
        while depth > 0:
            depth -= 1
            facet = stack[depth]
            for i in range(neighbour.shape[1]):
                other = neighbour[facet, i]
                if other < 0:
                    continue
                wanted = sign[facet] if agrees[facet, i] else -sign[facet]
                if part[other] >= 0:
                    if sign[other] != wanted:
                        return other
                    continue
                sign[other], part[other] = wanted, count
                stack[depth] = other
                depth += 1
        count += 1
    return -1


def _outwards(points, nodes, corners, neighbour, sign, part):
    """Turn closed parts so that they look outwards, in place: by the volume, or the area, that they enclose."""
    sides = np.arange(4)[None] < corners[:, None]
    is_open = np.bincount(part, np.any(sides & (neighbour < 0), axis=1)) > 0.0
    x = points[nodes[:, :4]] - points.mean(axis=0)
    if points.shape[1] == 2:
        content = x[:, 0, 0] * x[:, 1, 1] - x[:, 0, 1] * x[:, 1, 0]
    else:
        content = np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2]))
        last = np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 2], x[:, 3]))
        content = content + np.where(corners == 4, last, 0.0)
    inside_out = ~is_open & (np.bincount(part, sign * content) < 0.0)
    sign[inside_out[part]] *= -1


def _reversed(nodes, count):
    """Nodes (n, 9) of facets with some corners in the other direction."""
    out = nodes.copy()
    order = REVERSED[count]
    out[:, : len(order)] = nodes[:, order]
    # where a row has no middle nodes, it is filled up with its first node
    short = nodes[:, count] == nodes[:, 0]
    out[short] = nodes[short][:, [*order[:count], *[order[0]] * (WIDTH - count)]]
    out[~short, len(order) :] = out[~short, :1]
    return out

