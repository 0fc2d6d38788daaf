"""Drawing of cells: segments, edges and middles of facets, as arrays."""

import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, facet_kinds, facet_nodes
from pcontact.io.fields import Piece

_CELLS = {name: key for key, name in MESHIO_NAMES.items()}


def blocks(piece, dim):
    """Blocks of cells of a dimension.

    Parameters
    ----------
    piece : Piece
    dim : int

    Yields
    ------
    cell, degree, first, nodes : str, int, int, ndarray (nc, nn)
        Kind and degree, the number of the first among all cells, and their nodes.
    """
    first = 0
    for name, nodes in piece.cells:
        cell, degree = _CELLS.get(name, (None, 0))
        if cell and CELLS[cell].dim == dim and len(nodes):
            yield cell, degree, first, np.asarray(nodes)
        first += len(nodes)


def dimension(piece):
    """The highest dimension of the cells that can be drawn, 0 if there are none."""
    return max((dim for dim in (1, 2, 3) if any(True for _ in blocks(piece, dim))), default=0)


def segments(piece):
    """The cells of dimension 1, contact surfaces of plane bodies, as straight lines.

    Returns
    -------
    nodes : ndarray of int64 (n, 2)
        Their ends, in the direction of the cells.
    owner : ndarray of int64 (n,)
        The cell each belongs to.
    """
    nodes, owners = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    for _, degree, first, cells in blocks(piece, 1):
        table = np.array([(0, 1)] if degree == 1 else [(0, 2), (2, 1)])
        nodes.append(cells[:, table].reshape(-1, 2))
        owners.append(np.repeat(first + np.arange(len(cells)), len(table)))
    return np.concatenate(nodes), np.concatenate(owners)


def middles(piece, positions):
    """Middles and area vectors of plane cells, by their corners.

    Returns
    -------
    middle, area : ndarray (n, 3)
    owner : ndarray of int64 (n,)
        The cell each belongs to.
    """
    middle, area, owner = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for cell, _, first, nodes in blocks(piece, 2):
        corners = positions[nodes[:, : CELLS[cell].n_vertices]]
        across = corners[:, 1:] - corners[:, :1]
        middle.append(corners.mean(axis=1))
        area.append(np.cross(across[:, :-1], across[:, 1:]).sum(axis=1) / 2)
        owner.append(first + np.arange(len(nodes)))
    return np.concatenate(middle), np.concatenate(area), np.concatenate(owner)


def edges(piece):
    """Edges of the plane cells, each once.

    Returns
    -------
    ndarray of int64
        Of each the number of its nodes, 2 or 3, and these in their order: as VTK lists lines.
    """
    lines = []
    for cell, degree, _, nodes in blocks(piece, 2):
        n = CELLS[cell].n_vertices
        first, last = nodes[:, :n], np.roll(nodes[:, :n], -1, axis=1)
        row = [first, last] if degree == 1 else [first, nodes[:, n : 2 * n], last]
        row = np.stack(row, axis=2).reshape(-1, len(row))
        ends = np.sort(row[:, [0, -1]], axis=1)
        _, once = np.unique(ends, axis=0, return_index=True)
        lines.append(np.column_stack([np.full(len(once), row.shape[1]), row[once]]).ravel())
    return np.concatenate([np.zeros(0, np.int64), *lines])


def cut_facets(piece, distance):
    """All facets of the solid cells that a plane goes through.

    Parameters
    ----------
    piece : Piece
    distance : ndarray (n_points,)
        From the plane.

    Returns
    -------
    Piece
        Without fields.
    """
    found = []
    for cell, degree, _, nodes in blocks(piece, 3):
        near = (distance[nodes].min(axis=1) <= 0) & (distance[nodes].max(axis=1) >= 0)
        for kind, rows in facet_kinds(cell):
            name = MESHIO_NAMES[CELLS[kind].facet, degree]
            found += [(name, nodes[near][:, facet]) for facet in facet_nodes(kind, degree)[rows]]
    return Piece(piece.points, found)


def apart(piece):
    """The same bodies without nodes in common, so that means at the nodes stay in their body.

    Parameters
    ----------
    piece : Piece
        With the cell data `body`, or without.

    Returns
    -------
    Piece
    """
    if not piece.cell_data.get("body"):
        return piece
    n = len(piece.points)
    keys = [nodes + n * np.asarray(body, dtype=np.int64)[:, None]
            for (_, nodes), body in zip(piece.cells, piece.cell_data["body"], strict=True)]  # fmt: skip
    every, inverse = np.unique(np.concatenate([key.ravel() for key in keys]), return_inverse=True)
    ends = np.cumsum([key.size for key in keys])[:-1]
    tables = [part.reshape(key.shape) for part, key in zip(np.split(inverse.ravel(), ends), keys, strict=True)]
    node = every % n
    return Piece(
        piece.points[node],
        [(name, table) for (name, _), table in zip(piece.cells, tables, strict=True)],
        {name: np.asarray(array)[node] for name, array in piece.point_data.items()},
        piece.cell_data,
    )


def arc_length(nodes, points):
    """Chain segments and measure along them.

    Parameters
    ----------
    nodes : ndarray of int64 (n, 2)
        Their ends; where one ends the next one begins, or they are chained anyhow.
    points : ndarray (n_points, 3)

    Returns
    -------
    order : ndarray of int64 (n,)
        The segments one after the other; chains that are apart follow each other.
    length : ndarray (n, 2)
        The arc length at their ends as they are passed [length].
    turned : ndarray of bool (n,)
        Passed from the second end to the first one.
    """
    at = {}
    for row, ends in enumerate(nodes.tolist()):
        for end in ends:
            at.setdefault(end, []).append(row)
    free, order, turned = set(range(len(nodes))), [], []
    # chains begin at ends; what is left are closed ones
    starts = [row for node in sorted(at) if len(at[node]) == 1 for row in at[node]] + list(range(len(nodes)))
    for start in starts:
        if start not in free:
            continue
        row = start
        node = next((end for end in nodes[row].tolist() if len(at[end]) == 1), int(nodes[row, 0]))
        while row is not None:
            free.discard(row)
            order.append(row)
            turned.append(int(nodes[row, 1]) == node)
            node = int(nodes[row].sum()) - node
            row = next((other for other in at[node] if other in free), None)
    order, turned = np.array(order, dtype=np.int64), np.array(turned, dtype=bool)
    size = np.linalg.norm(np.diff(points[nodes[order]], axis=1)[:, 0], axis=1)
    end = np.cumsum(size)
    return order, np.column_stack([end - size, end]), turned
