"""Quadrilaterals, hexahedra, wedges and pyramids divided into triangles and tetrahedra with the same vertices.

Each quadrilateral face has one of two diagonals. Once these are chosen, a cell has none, one or several divisions into
tetrahedra that add no vertex; a cube has 74 with all diagonals together (De Loera, Rambau, Santos, Triangulations,
2010). They are found by search: the open facet that is first gets each vertex on its inner side in turn, and facets of
opposite sense vanish. What has no open facet left covers the cell once, as all its tetrahedra have positive volumes.
Two of the eight choices of diagonals of a wedge, and some of a hexahedron, have no such division; there, and where the
cells would become too flat, a vertex in the middle of the cell does.
"""

from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, n_nodes, reference_nodes

# [-] Least volume of a tetrahedron in a reference cell. From: flat ones have zero, others at least 1/3.
FLAT = 1e-9


class Division(NamedTuple):
    """How a cell is divided.

    Attributes
    ----------
    vertices : ndarray (k, d + 1)
        Places of the vertices of each simplex, see :class:`Places`.
    facets : list of ndarray (m, 2)
        By facet of the cell: simplices and their local facets that lie on it.
    """

    vertices: np.ndarray
    facets: list


class Places:
    """Where nodes of the simplices may be in a cell: its own nodes, then those that it lacks.

    Parameters
    ----------
    cell : str
    given, degree : int
        Of the layout of its nodes, and of that of the simplices.

    Attributes
    ----------
    vertices, own : int
        Number of its vertices, and of its own nodes.
    at : ndarray (n, d)
        In the reference cell.
    pairs : dict of (int, int) to int
        Place of the node in the middle of two others, a < b.
    edges : list of (int, int, int)
        Places of the middles of edges that it lacks, and their ends.
    faces : list of (int, int)
        Places of the middles of quadrilateral faces that it lacks, and the numbers of these.
    quadrilaterals : ndarray (n_faces, 4)
        Vertices of its quadrilateral faces; of a quadrilateral its own.
    middle : int or None
        Place of the middle of the cell; None in simplices.
    """

    def __init__(self, cell, given, degree):
        known = CELLS[cell]
        vertices, nodes = known.n_vertices, reference_nodes(cell, given)
        self.vertices, self.own, at = vertices, len(nodes), [nodes]
        self.quadrilaterals = _quadrilaterals(cell)
        corners = reference_nodes(cell, 1)
        self._count, self.pairs, self.edges, self.faces, self.middle = len(nodes), {}, [], [], None
        for e, (a, b) in enumerate(edge_nodes(cell)) if degree == 2 else ():
            place = vertices + e if given == 2 else self._new(at, corners[[a, b]])
            self.pairs[min(a, b), max(a, b)] = place
            if given == 1:
                self.edges.append((place, a, b))
        if known.is_simplex:
            self.at = np.vstack(at)
            return
        complete = given == 2 and known.complete is None
        plane = known.dim == 2
        first = vertices + len(known.edges)
        if known.is_tensor and complete:
            self.middle = n_nodes(cell, 2) - 1
        elif not plane or degree == 2:
            self.middle = self._new(at, corners)
        if degree == 2:
            for f, face in enumerate(self.quadrilaterals):
                place = self.middle if plane else first + f if complete else self._new(at, corners[face])
                if not plane and not complete:
                    self.faces.append((place, f))
                for i, j in (face[[0, 2]], face[[1, 3]]):
                    self.pairs[min(i, j), max(i, j)] = place
        if degree == 2 and not plane:
            for a, b in combinations(range(vertices), 2):
                # two vertices without an edge or face in common are opposite ones of a hexahedron
                self.pairs.setdefault((a, b), self.middle)
            for a in range(vertices):
                ends = np.array([corners[a], corners.mean(axis=0)])
                self.pairs[min(a, self.middle), max(a, self.middle)] = self._new(at, ends)
        self.at = np.vstack(at)

    def _new(self, at, corners):
        at.append(corners.mean(axis=0)[None])
        self._count += 1
        return self._count - 1

    def table(self, division, degree):
        """Places (k, n_nodes) of the nodes of the simplices of a division."""
        vertices = division.vertices
        if self.middle is not None:
            vertices = np.where(vertices == self.vertices, self.middle, vertices)
        if degree == 1:
            return vertices
        simplex = edge_nodes("triangle" if vertices.shape[1] == 3 else "tetrahedron")
        ends = np.sort(vertices[:, simplex], axis=2)
        middles = [[self.pairs[int(a), int(b)] for a, b in row] for row in ends]
        return np.column_stack([vertices, np.array(middles)])


def _quadrilaterals(cell):
    known = CELLS[cell]
    if known.dim == 2:
        return np.arange(4)[None] if known.n_vertices == 4 else np.zeros((0, 4), dtype=np.int64)
    return np.array([facet for facet in known.facets if len(facet) == 4], dtype=np.int64).reshape(-1, 4)


@cache
def divisions(cell, choice):
    """The divisions of a cell whose faces have certain diagonals.

    Parameters
    ----------
    cell : str
        Key in `pcontact.element.reference.CELLS`, of a complete cell of dimension 2 or 3.
    choice : int
        Bit f: whether the diagonal of face f, see :attr:`Places.quadrilaterals`, joins its vertices 1 and 3.

    Returns
    -------
    list of Division
        In space the last one, of others than tetrahedra and pyramids, has a vertex in the middle, whose number is that
        of the vertices.
    """
    known = CELLS[cell]
    if known.is_simplex:
        return [_division(cell, [tuple(range(known.dim + 1))])]
    if known.dim == 2:
        return [_division(cell, [(0, 1, 3), (1, 2, 3)] if choice else [(0, 1, 2), (0, 2, 3)])]
    outside, found = _outside(cell, choice), []
    edges = {frozenset(pair) for a, b, c in outside for pair in ((a, b), (b, c), (c, a))}
    faces = [set(facet) for facet in known.facets]
    # edges of tetrahedra on the surface are those of its triangles, others go through the cell
    allowed = {frozenset(pair) for pair in combinations(range(known.n_vertices), 2)
               if frozenset(pair) in edges or not any(set(pair) <= face for face in faces)}  # fmt: skip
    _search(reference_nodes(cell, 1), allowed, outside, [], found)
    unique = sorted({tuple(sorted(tuple(sorted(one)) for one in some)): some for some in found}.items())
    result = [_division(cell, some) for _, some in unique]
    if not known.is_pyramid:
        result.append(_division(cell, [(a, c, b, known.n_vertices) for a, b, c in outside]))
    return result


def _outside(cell, choice):
    """Triangles of the surface of a cell, outward."""
    result, face = [], 0
    for facet in CELLS[cell].facets:
        if len(facet) == 3:
            result.append(facet)
            continue
        a, b, c, d = facet
        result += [(a, b, d), (b, c, d)] if choice >> face & 1 else [(a, b, c), (a, c, d)]
        face += 1
    return result


def _search(points, allowed, open_, tets, found):
    """Add all ways to fill what the facets (a, b, c), outward, enclose, with tetrahedra of edges that are allowed."""
    if not open_:
        found.append(list(tets))
        return
    a, b, c = open_[0]
    for d in range(len(points)):
        tet = (a, c, b, d)
        if any(frozenset((d, v)) not in allowed for v in (a, b, c)) or _volume(points, tet) <= FLAT:
            continue
        rest, fits = list(open_), True
        for facet in ((a, b, c), (a, d, b), (b, d, c), (c, d, a)):
            same = [one for one in rest if set(one) == set(facet)]
            if not same:
                rest.append((facet[0], facet[2], facet[1]))
            elif _turned(same[0], facet):
                rest.remove(same[0])
            else:
                # two tetrahedra on the same side of a facet
                fits = False
        if fits and _left(points, rest) >= -FLAT:
            _search(points, allowed, rest, [*tets, tet], found)


def _turned(one, other):
    """Whether two orders of the same vertices have the same sense."""
    k = other.index(one[0])
    return one == (*other[k:], *other[:k])


def _volume(points, tet):
    """Six times the volume."""
    x = points[list(tet)]
    return float(np.linalg.det(x[1:] - x[0]))


def _left(points, facets):
    """Six times the volume that facets, outward, enclose."""
    return float(sum(np.linalg.det(points[list(facet)]) for facet in facets))


def _division(cell, simplices):
    """With the facets of the simplices on those of the cell."""
    simplex = "triangle" if CELLS[cell].dim == 2 else "tetrahedron"
    local = CELLS[simplex].facets if CELLS[cell].dim == 3 else CELLS[simplex].edges
    facets = []
    for facet in CELLS[cell].facets:
        rows = [(k, f) for k, one in enumerate(simplices) for f, some in enumerate(local)
                if {one[v] for v in some} <= set(facet)]  # fmt: skip
        facets.append(np.array(rows, dtype=np.int64).reshape(-1, 2))
    return Division(np.array(simplices, dtype=np.int64), facets)
