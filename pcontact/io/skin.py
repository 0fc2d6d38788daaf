"""Triangles to be drawn: the cells of a surface, the skin of a solid, its section with a plane."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, edge_nodes, facet_nodes, reference_nodes

_CELLS = {name: key for key, name in MESHIO_NAMES.items()}
_HEXAHEDRON = np.array([(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)])
_OTHERS = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])


@dataclass
class Triangles:
    """Triangles that stand for polygons of a mesh.

    Parameters
    ----------
    nodes : ndarray of int64 (nt, 3)
        Points of each triangle.
    owner : ndarray of int64 (nt,)
        The cell it belongs to, counted over all blocks.
    edges : ndarray of int64 (nt, 3)
        1: the side from corner k to corner k + 1 is an edge of the mesh; 0: it only divides a polygon; 2: so does it,
        but corner k is on an edge, of which no side belongs to the triangle.
    """

    nodes: np.ndarray
    owner: np.ndarray
    edges: np.ndarray


@dataclass
class Section:
    """Where a plane cuts the cells; its points lie on lines between two nodes.

    Parameters
    ----------
    ends : ndarray of int64 (n, 2)
        The two nodes.
    weight : ndarray (n,)
        How far from the first to the second, 0 to 1.
    triangles : Triangles
        Their nodes count the points of the section.
    """

    ends: np.ndarray
    weight: np.ndarray
    triangles: Triangles

    def interpolate(self, values):
        """Values at the points of the section.

        Parameters
        ----------
        values : ndarray (n_nodes,) or (n_nodes, k)
            Values at the nodes.

        Returns
        -------
        ndarray (n,) or (n, k)
        """
        weight = self.weight.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - weight) * values[self.ends[:, 0]] + weight * values[self.ends[:, 1]]


def _triangle_table(cell, degree):
    """Triangles of a plane cell (n, 3), and their sides (n, 3) as in `Triangles`."""
    if cell == "triangle":
        table = np.array([(0, 1, 2)] if degree == 1 else [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])
    elif degree == 1:
        table = np.array([(0, 1, 2), (0, 2, 3)])
    elif cell == "quadrilateral8":
        table = np.array([(0, 4, 7), (1, 5, 4), (2, 6, 5), (3, 7, 6), (4, 5, 6), (4, 6, 7)])
    else:
        # divided from the corners to the centre, so that each triangle has its part of an edge
        table = np.array([(k, m, 8) for k, m in zip((0, 4, 1, 5, 2, 6, 3, 7), (4, 1, 5, 2, 6, 3, 7, 0), strict=True)])
    ends, middle = edge_nodes(cell), CELLS[cell].n_vertices
    lines = (
        [{a, b} for a, b in ends]
        if degree == 1
        else [{e, middle + i} for i, ab in enumerate(ends) for e in ab]
    )
    edges = np.array([[int({row[k], row[(k + 1) % 3]} in lines) for k in range(3)] for row in table.tolist()])
    edges[~edges.any(axis=1)] = 2
    return table, edges


def _tetrahedron_table(cell, degree):
    """Tetrahedra of a solid cell (n, 4), and which of the faces opposite their corners are on its surface."""
    if cell == "tetrahedron":
        corners = [(0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3)]
        inside = [(6, 8, 4, 5), (6, 8, 5, 9), (6, 8, 9, 7), (6, 8, 7, 4)]
        table = np.array([(0, 1, 2, 3)] if degree == 1 else corners + inside)
    elif degree == 1:
        table = _HEXAHEDRON
    elif cell == "hexahedron20":
        table = _without_middles(cell)
    else:
        nodes = {
            tuple(node): i for i, node in enumerate(np.rint(reference_nodes(cell, 2)).astype(int).tolist())
        }
        corners = np.rint((reference_nodes(cell, 1) + 1) / 2).astype(int)
        eighths = [
            [nodes[tuple(corner)] for corner in corners + first] for first in product((-1, 0), repeat=3)
        ]
        table = np.array(eighths)[:, _HEXAHEDRON].reshape(-1, 4)
    facets = [set(facet) for facet in facet_nodes(cell, degree).tolist()]
    return table, np.array(
        [[any(set(row[_OTHERS[k]]) <= facet for facet in facets) for k in range(4)] for row in table]
    )


def _without_middles(cell):
    """Tetrahedra (n, 4) of a hexahedron of 20 nodes: its corners cut off, and what is left divided from a node."""
    edges, first = CELLS[cell].edges, CELLS[cell].n_vertices
    at_corner = [[first + k for k, edge in enumerate(edges) if corner in edge] for corner in range(first)]
    sides = facet_nodes(cell, 2)[:, 4:]
    polygons = [*at_corner, *sides[:, [0, 1, 2]].tolist(), *sides[:, [0, 2, 3]].tolist()]
    whole = [*at_corner, *sides.tolist()]
    # a polygon of the rest that has the node, or is half of one that has, is divided by it already
    apex = first
    off = [set(polygon) for polygon in whole if apex not in polygon]
    fan = [(apex, *polygon) for polygon in polygons if any(set(polygon) <= one for one in off)]
    table = np.array([(corner, *three) for corner, three in enumerate(at_corner)] + fan)
    at = reference_nodes(cell, 2)[table]
    turned = np.linalg.det(at[:, 1:] - at[:, :1]) < 0.0
    table[turned] = table[turned][:, [0, 1, 3, 2]]
    return table


TRIANGLES = {(c, p): _triangle_table(c, p) for c in ("triangle", "quadrilateral") for p in (1, 2)}
TRIANGLES["quadrilateral8", 2] = _triangle_table("quadrilateral8", 2)
TETRAHEDRA = {(c, p): _tetrahedron_table(c, p) for c in ("tetrahedron", "hexahedron") for p in (1, 2)}
TETRAHEDRA["hexahedron20", 2] = _tetrahedron_table("hexahedron20", 2)


def _blocks(piece, dim):
    """Blocks of cells of a dimension: cell, degree, number of the first, nodes (nc, nn)."""
    first = 0
    for name, nodes in piece.cells:
        cell, degree = _CELLS.get(name, (None, 0))
        if cell and CELLS[cell].dim == dim and len(nodes):
            yield cell, degree, first, np.asarray(nodes)
        first += len(nodes)


def dimension(piece):
    """The highest dimension of the cells that can be drawn, 0 if there are none.

    Parameters
    ----------
    piece : Piece

    Returns
    -------
    int
    """
    return max((dim for dim in (1, 2, 3) if any(True for _ in _blocks(piece, dim))), default=0)


def _split(cell, degree, nodes, owner):
    """The triangles of plane cells."""
    table, edges = TRIANGLES[cell, degree]
    return nodes[:, table].reshape(-1, 3), np.repeat(owner, len(table)), np.tile(edges, (len(nodes), 1))


def _joined(parts):
    """One `Triangles` of several parts; they may be none."""
    empty = (np.zeros((0, 3), np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.int64))
    return Triangles(*(np.concatenate(arrays) for arrays in zip(empty, *parts, strict=True)))


def surface(piece):
    """The plane cells of a mesh.

    Parameters
    ----------
    piece : Piece

    Returns
    -------
    Triangles
    """
    return _joined(
        _split(cell, degree, nodes, first + np.arange(len(nodes)))
        for cell, degree, first, nodes in _blocks(piece, 2)
    )


def lines(piece):
    """The cells of dimension 1: contact surfaces of plane bodies.

    Parameters
    ----------
    piece : Piece

    Returns
    -------
    nodes : ndarray of int64 (n, 2)
        Ends of straight lines.
    owner : ndarray of int64 (n,)
        The cell each belongs to.
    """
    nodes, owners = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    for _, degree, first, cells in _blocks(piece, 1):
        table = np.array([(0, 1)] if degree == 1 else [(0, 2), (2, 1)])
        nodes.append(cells[:, table].reshape(-1, 2))
        owners.append(np.repeat(first + np.arange(len(cells)), len(table)))
    return np.concatenate(nodes), np.concatenate(owners)


def skin(piece):
    """The facets of solid cells that belong to one cell only.

    Parameters
    ----------
    piece : Piece

    Returns
    -------
    Triangles
        Turned outward (right-hand rule).
    """
    # a facet is known by the sum of its corners' random 64 bit numbers, in whatever order the cells list them
    mark = np.random.default_rng(1).integers(0, 2**64, len(piece.points), dtype=np.uint64)
    groups, keys = [], []
    for cell, degree, first, nodes in _blocks(piece, 3):
        table = facet_nodes(cell, degree)
        facets = nodes[:, table].reshape(-1, table.shape[1])
        owner = np.repeat(first + np.arange(len(nodes)), len(table))
        keys.append(mark[facets[:, : CELLS[CELLS[cell].facet].n_vertices]].sum(axis=1))
        groups.append((CELLS[cell].facet, degree, facets, owner))
    if not groups:
        return _joined([])
    _, inverse, counts = np.unique(np.concatenate(keys), return_inverse=True, return_counts=True)
    single = np.split(counts[inverse] == 1, np.cumsum([len(key) for key in keys])[:-1])
    return _joined(
        _split(facet, degree, facets[outer], owner[outer])
        for (facet, degree, facets, owner), outer in zip(groups, single, strict=True)
    )


def section(piece, distance):
    """The plane figure in which a plane cuts solid cells.

    Each cell is cut as tetrahedra between its nodes, so that the cut is plane inside curved cells too.

    Parameters
    ----------
    piece : Piece
    distance : ndarray (n,)
        Signed distance of each point from the plane [length].

    Returns
    -------
    Section
    """
    ends, parts = [], []
    for cell, degree, first, nodes in _blocks(piece, 3):
        cut = np.flatnonzero(np.ptp((distance[nodes] > 0).astype(np.int8), axis=1))
        table, faces = TETRAHEDRA[cell, degree]
        tets = nodes[cut][:, table].reshape(-1, 4)
        owner, faces = np.repeat(first + cut, len(table)), np.tile(faces, (len(cut), 1))
        above = distance[tets] > 0
        count = above.sum(axis=1)
        for alone in (1, 3):
            rows = np.flatnonzero(count == alone)
            corner = np.argmax(above[rows] == (alone == 1), axis=1)
            order = np.column_stack([corner, _OTHERS[corner]])
            _cut(ends, parts, *_ordered(tets, faces, rows, order), owner[rows], alone=True)
        rows = np.flatnonzero(count == 2)
        order = np.argsort(~above[rows], axis=1, kind="stable")
        _cut(ends, parts, *_ordered(tets, faces, rows, order), owner[rows], alone=False)
    ends = np.concatenate([np.zeros((0, 2), np.int64), *ends])
    triangles = _joined(parts)
    triangles.nodes = np.arange(3 * len(triangles.owner)).reshape(-1, 3)
    low, high = distance[ends[:, 0]], distance[ends[:, 1]]
    return Section(ends, low / np.where(low == high, 1, low - high), triangles)


def _ordered(tets, faces, rows, order):
    """The chosen tetrahedra with their corners (and the faces opposite them) in another order."""
    return np.take_along_axis(tets[rows], order, 1), np.take_along_axis(faces[rows], order, 1)


def _cut(ends, parts, tets, faces, owner, alone):
    """Add the triangles in which tetrahedra are cut.

    Corners a | b c d: the points on ab, ac, ad. Corners a b | c d: those on ac, ad, bd, bc, as two triangles.
    The line between two of these points lies in the face opposite the corner that neither of them touches.
    """
    no = np.zeros(len(tets), dtype=bool)
    if alone:
        figures = [(((0, 1), (0, 2), (0, 3)), (faces[:, 3], faces[:, 1], faces[:, 2]))]
    else:
        figures = [
            (((0, 2), (0, 3), (1, 3)), (faces[:, 1], faces[:, 2], no)),
            (((0, 2), (1, 3), (1, 2)), (no, faces[:, 0], faces[:, 3])),
        ]
    for pairs, edges in figures:
        ends.append(tets[:, np.array(pairs)].reshape(-1, 2))
        parts.append((np.zeros((len(tets), 3), np.int64), owner, np.column_stack(edges).astype(np.int64)))
