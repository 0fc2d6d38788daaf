"""Edges and faces numbered, and their middle nodes: cells raised to degree 2, serendipity cells filled up."""

from dataclasses import replace

import numpy as np

from pcontact.element.reference import CELLS, SERENDIPITY, edge_nodes, face_nodes, n_nodes
from pcontact.runtime.jit import njit


@njit
def _number_rows(rows, bound, number, first):
    """Number equal rows alike: rows with the same first entry are compared with each other.

    rows (n, k), entries of the first column below `bound`; out: number (n,), first (n,), of which
    the leading part is used. Returns the count of distinct rows.
    """
    start = np.zeros(bound + 1, dtype=np.int64)
    for i in range(rows.shape[0]):
        start[rows[i, 0] + 1] += 1
    for v in range(bound):
        start[v + 1] += start[v]
    cursor = start[:-1].copy()
    order = np.empty(rows.shape[0], dtype=np.int64)
    for i in range(rows.shape[0]):
        order[cursor[rows[i, 0]]] = i
        cursor[rows[i, 0]] += 1
    count = 0
    for v in range(bound):
        base = count
        for at in range(start[v], start[v + 1]):
            i = order[at]
            match = count
            for c in range(base, count):
                same = True
                for k in range(1, rows.shape[1]):
                    if rows[i, k] != rows[first[c], k]:
                        same = False
                        break
                if same:
                    match = c
                    break
            if match == count:
                first[count] = i
                count += 1
            number[i] = match
    return count


@njit
def _sort_rows(rows):
    """Sort every row (n, k) in place, by insertion: rows are short."""
    for i in range(rows.shape[0]):
        for a in range(1, rows.shape[1]):
            value, b = rows[i, a], a
            while b > 0 and rows[i, b - 1] > value:
                rows[i, b] = rows[i, b - 1]
                b -= 1
            rows[i, b] = value


def sorted_rows(rows):
    """A copy of rows (n, k) of node numbers with every row sorted."""
    rows = np.array(rows, dtype=np.int64, order="C")
    _sort_rows(rows)
    return rows


def number_rows(rows, bound):
    """Number rows of node numbers so that rows with the same members, in any order, get the same number.

    Parameters
    ----------
    rows : ndarray, (n, k) int64
        Entries from 0 to `bound` - 1.
    bound : int

    Returns
    -------
    first : ndarray, (n_distinct,) int64
        First row of each number.
    number : ndarray, (n,) int64
    """
    number, first = np.empty((2, len(rows)), dtype=np.int64)
    rows = sorted_rows(rows)
    count = _number_rows(rows, bound, number, first)
    return first[:count], number


def complete(raw, degree):
    """Raise all cells to a degree.

    New nodes lie at the centres of edges, quadrilateral faces and cells and are shared between neighbours; a
    neighbour that has such a node already keeps it. Existing nodes keep their numbers.

    Parameters
    ----------
    raw : RawMesh
    degree : int
        1 or 2. Cells are never lowered: with 1 the mesh is returned as it is.

    Returns
    -------
    RawMesh
        At degree 2 all blocks are of degree 2, and groups of edges contain the edges' middle nodes.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2.
    """
    if degree not in (1, 2):
        raise ValueError(f"degree {degree}: only 1 and 2 exist")
    if degree == 1 or all(block.degree == 2 for block in raw.blocks):
        return raw
    blocks = [replace(block, degree=2, nodes=with_gaps(block.cell, block.nodes)) for block in raw.blocks]
    points, pairs, middles = fill(raw.points, blocks)
    groups = dict(raw.node_groups)
    for name, edges in raw.edge_groups.items():
        first, number = number_rows(np.concatenate([pairs, edges]), len(raw.points))
        edge = first[number[len(pairs) :]]
        groups[name] = np.union1d(groups[name], middles[edge[edge < len(pairs)]])
    return replace(raw, points=points, blocks=blocks, node_groups=groups)


def without_middles(raw):
    """Take the nodes in the middles of faces and cells out of quadrilaterals and hexahedra of degree 2.

    Parameters
    ----------
    raw : RawMesh
        Of degree 2.

    Returns
    -------
    RawMesh
        With serendipity cells; the mesh as it is if it has none to take them from.
    """
    if not any(block.cell in SERENDIPITY for block in raw.blocks):
        return raw
    blocks, used = [], np.zeros(len(raw.points), dtype=bool)
    for block in raw.blocks:
        cell = SERENDIPITY.get(block.cell, block.cell)
        blocks.append(replace(block, cell=cell, nodes=block.nodes[:, : n_nodes(cell, 2)]))
        used[blocks[-1].nodes] = True
    number = np.cumsum(used) - 1
    for block in blocks:
        block.nodes = number[block.nodes]
    groups = {name: number[nodes[used[nodes]]] for name, nodes in raw.node_groups.items()}
    edges = {name: number[ends] for name, ends in raw.edge_groups.items()}
    return replace(raw, points=raw.points[used], blocks=blocks, node_groups=groups, edge_groups=edges)


def with_gaps(cell, nodes):
    """Connectivity (n, m) widened to that of the degree-2 cell; -1 where there is no node yet."""
    wide = np.full((len(nodes), n_nodes(cell, 2)), -1, dtype=np.int64)
    wide[:, : nodes.shape[1]] = nodes
    return wide


def fill(points, blocks):
    """Give every gap in the connectivity of degree-2 cells a node.

    Edges get their midpoint. Faces and cells get the point where the serendipity interpolation of their
    boundary puts their centre: ``-1/4 sum(vertices) + 1/2 sum(edge nodes)`` on a quadrilateral (8 nodes),
    ``-1/4 sum(vertices) + 1/4 sum(edge nodes)`` in a hexahedron (20 nodes); with straight edges that is the
    mean of the vertices.

    Parameters
    ----------
    points : ndarray, (n_points, d) float64
    blocks : list of Block
        Of degree 2; -1 marks a gap. Their nodes are filled in place.

    Returns
    -------
    points : ndarray, (n_points + n_new, d) float64
    pairs : ndarray, (n_edges, 2) int64
        Vertices of the edges.
    middles : ndarray, (n_edges,) int64
        Middle node of each.
    """
    n_old = len(points)
    edges = [block.nodes[:, edge_nodes(block.cell)] for block in blocks]
    pairs = np.concatenate([e.reshape(-1, 2) for e in edges])
    first, number = number_rows(pairs, n_old)
    middles, fresh = _number(blocks, "edges", first, number, n_old)
    points = np.concatenate([points, points[pairs[fresh]].mean(axis=1)])
    points = _fill_faces(points, blocks, n_old)
    return _fill_centres(points, blocks), pairs[first], middles


def _columns(cell, what):
    """Columns of the middle nodes of the edges or of the faces in the connectivity of the degree-2 cell."""
    first = CELLS[cell].n_vertices
    if what == "edges":
        return slice(first, first + len(CELLS[cell].edges))
    first += len(CELLS[cell].edges)
    return slice(first, first + len(CELLS[cell].faces))


def _number(blocks, what, first, number, start):
    """Number the edges or faces that have no node from `start`, and write the numbers into the blocks.

    first, number: what `number_rows` says of the entities of all cells. Returns the node of every distinct
    entity and, for each new node, a position where its entity occurs.
    """
    columns = [_columns(block.cell, what) for block in blocks]
    known = np.concatenate([block.nodes[:, c].ravel() for block, c in zip(blocks, columns, strict=True)])
    nodes = np.full(len(first), -1, dtype=np.int64)
    has = known >= 0
    nodes[number[has]] = known[has]
    new = np.flatnonzero(nodes < 0)
    nodes[new] = start + np.arange(len(new))
    known = np.where(has, known, nodes[number])
    at = 0
    for block, c in zip(blocks, columns, strict=True):
        part = block.nodes[:, c]
        block.nodes[:, c] = known[at : at + part.size].reshape(part.shape)
        at += part.size
    return nodes, first[new]


def _face_edges(cell):
    """Columns of the middle nodes of the edges of every quadrilateral face, (n_faces, 4)."""
    reference = CELLS[cell]
    edges = [(reference.n_vertices + k, set(edge)) for k, edge in enumerate(reference.edges)]
    rows = [[column for column, edge in edges if edge <= set(face)] for face in reference.faces]
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


def _fill_faces(points, blocks, n_old):
    """Nodes at the centres of the faces of hexahedra."""
    blocks = [block for block in blocks if CELLS[block.cell].faces]
    if not any(np.any(block.nodes[:, _columns(block.cell, "faces")] < 0) for block in blocks):
        return points
    corners = np.concatenate([block.nodes[:, face_nodes(block.cell)].reshape(-1, 4) for block in blocks])
    middles = np.concatenate([block.nodes[:, _face_edges(block.cell)].reshape(-1, 4) for block in blocks])
    _, fresh = _number(blocks, "faces", *number_rows(corners, n_old), len(points))
    return np.concatenate([points, _quadrilateral_centre(points, corners[fresh], middles[fresh])])


def _quadrilateral_centre(points, corners, middles):
    return 0.5 * points[middles].sum(axis=1) - 0.25 * points[corners].sum(axis=1)


def _fill_centres(points, blocks):
    """Nodes inside quadrilaterals and hexahedra, not shared with anyone."""
    for block in blocks:
        reference = CELLS[block.cell]
        if not reference.is_tensor:
            continue
        rows = np.flatnonzero(block.nodes[:, -1] < 0)
        corners, middles = block.vertices[rows], block.nodes[rows, _columns(block.cell, "edges")]
        if reference.dim == 2:
            centres = _quadrilateral_centre(points, corners, middles)
        else:
            centres = 0.25 * (points[middles].sum(axis=1) - points[corners].sum(axis=1))
        block.nodes[rows, -1] = len(points) + np.arange(len(rows))
        points = np.concatenate([points, centres])
    return points
