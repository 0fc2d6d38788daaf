"""Connected parts of a mesh, and the sense in which their cells are numbered."""

from typing import NamedTuple

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_kinds, n_nodes, reference_nodes
from pcontact.element.shape import shape_gradient
from pcontact.mesh.complete import number_rows
from pcontact.mesh.groups import facets_among
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.jit import njit

# how the determinant of a cell's map behaves: what `_senses` returns
POSITIVE, REVERSED, MIXED, FLAT = 0, 1, 2, 3


@njit
def _find(parent, node):
    """Root of a node; the path to it is halved on the way."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit
def _join(parent, vertices):
    """Join the trees of the vertices (nc, nv) of every cell; the lowest node becomes the root."""
    for cell in range(vertices.shape[0]):
        root = _find(parent, vertices[cell, 0])
        for k in range(1, vertices.shape[1]):
            other = _find(parent, vertices[cell, k])
            if other < root:
                parent[root] = other
                root = other
            else:
                parent[other] = root


@njit
def _roots(parent, nodes, roots):
    """Root of each of some nodes (n,)."""
    for k in range(nodes.shape[0]):
        roots[k] = _find(parent, nodes[k])


def label(tables, n_points):
    """Number the connected parts of cells given by their vertices.

    Parameters
    ----------
    tables : list of ndarray, (n_cells, n_vertices) int64
    n_points : int

    Returns
    -------
    ndarray, (n_cells in all tables,) int64
        Part of every cell, from 0 in the order of their first cells.
    """
    parent = np.arange(n_points, dtype=np.int64)
    for vertices in tables:
        _join(parent, np.ascontiguousarray(vertices, dtype=np.int64))
    nodes = np.concatenate([np.zeros(0, dtype=np.int64), *(vertices[:, 0] for vertices in tables)])
    roots = np.empty_like(nodes)
    _roots(parent, nodes, roots)
    _, first, part = np.unique(roots, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[part]


class Numbers(NamedTuple):
    """The connected components of a distributed mesh as they are, before bodies are joined.

    Attributes
    ----------
    names : list of str
    cells : list of ndarray (nc,)
        Component of the cells of each block.
    """

    names: list
    cells: list

    @classmethod
    def of(cls, mesh):
        """Those of a mesh."""
        return cls(list(mesh.component_names), [block.components.copy() for block in mesh.blocks])

    def give(self, mesh):
        """Let a mesh have them again."""
        mesh.n_components, mesh.component_names = len(self.names), list(self.names)
        for block, cells in zip(mesh.blocks, self.cells, strict=True):
            block.components = cells.copy()


def components(raw):
    """Connected component of every cell: cells that share a node are connected.

    Parameters
    ----------
    raw : RawMesh

    Returns
    -------
    ndarray, (n_cells,) int64
        Numbered from 0 in the order of their first cells.
    """
    return label([block.vertices for block in raw.blocks], len(raw.points))


@njit
def _ranges(points, nodes, slopes, low, high, scale):
    """Smallest and largest determinant of the map of every cell, and the rounding error to expect in it.

    points (n, d), nodes (nc, nn), slopes (nq, nn, d): reference gradients; out: low, high, scale (nc,).
    """
    d = points.shape[1]
    jacobian = np.zeros((3, 3))
    for cell in range(nodes.shape[0]):
        low[cell], high[cell] = np.inf, -np.inf
        size, far = 0.0, 0.0
        for i in range(d):
            smallest, largest = np.inf, -np.inf
            for a in range(nodes.shape[1]):
                x = points[nodes[cell, a], i]
                smallest, largest = min(smallest, x), max(largest, x)
            size = max(size, largest - smallest)
            far = max(far, abs(smallest), abs(largest))
        # a determinant is a sum of products of d lengths, each known to the rounding error of the coordinates
        scale[cell] = far * size ** (d - 1)
        for q in range(slopes.shape[0]):
            jacobian[:] = 0.0
            for a in range(nodes.shape[1]):
                for i in range(d):
                    # relative to the first node: a mesh far from the origin keeps its digits
                    x = points[nodes[cell, a], i] - points[nodes[cell, 0], i]
                    for j in range(d):
                        jacobian[i, j] += x * slopes[q, a, j]
            det = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
            if d == 3:
                det = (
                    jacobian[0, 0] * (jacobian[1, 1] * jacobian[2, 2] - jacobian[1, 2] * jacobian[2, 1])
                    - jacobian[0, 1] * (jacobian[1, 0] * jacobian[2, 2] - jacobian[1, 2] * jacobian[2, 0])
                    + jacobian[0, 2] * (jacobian[1, 0] * jacobian[2, 1] - jacobian[1, 1] * jacobian[2, 0])
                )
            low[cell], high[cell] = min(low[cell], det), max(high[cell], det)


def jacobians(points, cell, degree, nodes):
    """Smallest determinant of the map of cells (n,) at their nodes and quadrature points.

    Parameters
    ----------
    points : ndarray (n_points, d)
    cell : str
    degree : int
        Of the map.
    nodes : ndarray (n, n_nodes)
    """
    xi = np.vstack([reference_nodes(cell, degree), quadrature(cell, 2 * degree)[0]])
    if degree == 1 and CELLS[cell].is_simplex:
        xi = xi[:1]
    low, high, scale = np.empty((3, len(nodes)))
    slopes = np.ascontiguousarray(shape_gradient(cell, degree, xi))
    _ranges(np.ascontiguousarray(points), np.ascontiguousarray(nodes, dtype=np.int64), slopes, low, high, scale)
    return low


def _senses(points, block):
    """Sense of every cell of a block, from its vertices and quadrature points: (n_cells,) int64."""
    xi = np.vstack([reference_nodes(block.cell, 1), quadrature(block.cell, 2 * block.degree)[0]])
    if block.degree == 1 and CELLS[block.cell].is_simplex:
        xi = xi[:1]  # the map is affine
    low, high, scale = np.empty((3, len(block.nodes)))
    slopes = np.ascontiguousarray(shape_gradient(block.cell, block.degree, xi))
    _ranges(np.ascontiguousarray(points), np.ascontiguousarray(block.nodes), slopes, low, high, scale)
    noise = 64.0 * np.finfo(float).eps * scale
    sense = np.full(len(low), MIXED, dtype=np.int64)
    sense[low >= -noise] = POSITIVE
    sense[high <= noise] = REVERSED
    sense[(low >= -noise) & (high <= noise)] = FLAT
    return sense


def _collapsed(points, block):
    """Cells of a block (n_cells,) bool with an edge that is no longer than the rounding errors of its coordinates."""
    bad = np.zeros(len(block.nodes), dtype=bool)
    for one, other in CELLS[block.cell].edges:
        a, b = points[block.nodes[:, one]], points[block.nodes[:, other]]
        far = np.maximum(np.abs(a), np.abs(b)).max(axis=1)
        bad |= np.abs(b - a).max(axis=1) <= 64.0 * np.finfo(float).eps * far
    return bad


def mirror(cell, degree):
    """Permutation of a cell's nodes that turns its sense around.

    Parameters
    ----------
    cell : str
    degree : int

    Returns
    -------
    ndarray, (n_nodes,) int64
    """
    vertices = {3: [0, 2, 1], 4: [0, 2, 1, 3], 5: [0, 3, 2, 1, 4], 6: [0, 2, 1, 3, 5, 4], 8: [0, 3, 2, 1, 4, 7, 6, 5]}
    reference = CELLS[cell]
    swap = [0, 3, 2, 1] if cell == "quadrilateral" else vertices[reference.n_vertices]
    if degree == 1:
        return np.array(swap, dtype=np.int64)
    entities = [frozenset(entity) for entity in reference.edges + reference.faces]
    moved = [entities.index(frozenset(swap[v] for v in entity)) for entity in entities]
    order = [*swap, *(reference.n_vertices + m for m in moved)]
    return np.array([*order, *range(len(order), n_nodes(cell, degree))], dtype=np.int64)


def orient(path, points, blocks, tags):
    """Turn around the cells that are numbered in the reverse sense, and say how many; refuse bad cells.

    Parameters
    ----------
    path : Path
        For messages.
    points : ndarray, (n_points, d) float64
    blocks : list of Block
        Their nodes are changed in place.
    tags : ndarray, (n_cells,) int64
        The file's own cell numbers.

    Raises
    ------
    InputError
        Cells without volume; cells whose Jacobian changes sign; cells with an edge without length; cells that are on
        the same side of a facet as their neighbour: they are not only numbered in another sense, but folded over it.
    """
    sense = np.concatenate([_senses(points, block) for block in blocks])
    _refuse(path, points, blocks, tags, sense == FLAT, "has no volume", "cells with a volume")
    collapsed = np.concatenate([_collapsed(points, block) for block in blocks])
    what = "has an edge without length: its ends are at the same place"
    _refuse(path, points, blocks, tags, collapsed, what, "vertices apart from each other")
    what = "is inverted: its Jacobian changes sign"
    _refuse(path, points, blocks, tags, sense == MIXED, what, "cells that are not folded or twisted")
    turned = sense == REVERSED
    if not turned.any():
        return
    first = 0
    for block in blocks:
        rows = np.flatnonzero(turned[first : first + len(block.nodes)])
        block.nodes[rows] = block.nodes[rows][:, mirror(block.cell, block.degree)]
        first += len(block.nodes)
    what = "is inverted: it lies on the same side of a facet as its neighbour"
    bad = _folded(blocks, len(points), turned)
    _refuse(path, points, blocks, tags, bad, what, "cells that lie beside each other")
    log.info("%s: %d of %d cells were numbered in the opposite sense: turned", path, turned.sum(), len(turned))


def _folded(blocks, n_points, turned):
    """Cells (n,) bool that are on the same side of a facet as a neighbour.

    turned (n,): their numbering has been turned. Of two such cells the one is meant that differs from most others.
    """
    wanted, first = np.zeros(n_points, dtype=bool), 0
    for block in blocks:
        wanted[block.vertices[turned[first : first + len(block.nodes)]]] = True
        first += len(block.nodes)
    few = turned if 2 * turned.sum() <= len(turned) else ~turned
    bad = np.zeros(len(turned), dtype=bool)
    kinds = {kind for block in blocks for kind, _ in facet_kinds(block.cell)}
    for n_vertices in sorted({CELLS[CELLS[kind].facet].n_vertices for kind in kinds}):
        corners, cells, _ = facets_among(blocks, wanted, n_vertices)
        _, number = number_rows(corners, n_points)
        order = np.argsort(number, kind="stable")
        pair = np.flatnonzero(np.diff(number[order]) == 0)
        one, other = order[pair], order[pair + 1]
        # the vertex that follows the least one, going around
        lead = np.argmin(corners, axis=1)
        following = np.take_along_axis(corners, ((lead + 1) % n_vertices)[:, None], axis=1)[:, 0]
        same = following[one] == following[other] if n_vertices > 2 else lead[one] == lead[other]
        one, other = cells[one[same]], cells[other[same]]
        bad[np.where(few[other] & ~few[one], other, one)] = True
    return bad


def cell_name(points, blocks, tags, number):
    """A cell in the words of a message, such as ``cell 7 (quadrilateral at (0.5, 1.5))``.

    Parameters
    ----------
    points : ndarray, (n_points, d) float64
    blocks : list of Block
    tags : ndarray, (n_cells,) int64, or None
        The file's own cell numbers; None: numbered from 1.
    number : int

    Returns
    -------
    str
    """
    row = number
    for block in blocks:
        if row < len(block.nodes):
            break
        row -= len(block.nodes)
    centroid = ", ".join(f"{x:g}" for x in points[block.vertices[row]].mean(axis=0))
    return f"cell {number + 1 if tags is None else tags[number]} ({block.cell} at ({centroid}))"


def _refuse(path, points, blocks, tags, bad, what, allowed):
    """Raise an InputError naming the first bad cell, its centroid and the number of bad cells."""
    if bad.any():
        named = cell_name(points, blocks, tags, int(np.flatnonzero(bad)[0]))
        raise InputError(f"{path}: {named} {what} ({bad.sum()} in all); allowed: {allowed}")
