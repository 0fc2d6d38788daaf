"""Any mesh made one of triangles or tetrahedra, on any number of ranks.

A quadrilateral face is cut along its shorter diagonal; where both are about as long, along the one through the vertex
that is first in the direction `ALONG`. Both are known to all cells that have the face, whatever their kind, so they
meet; and a lattice becomes the regular one of Kuhn and Freudenthal, whose cells keep their shapes when they are cut.
(With the second rule alone, by the numbers of nodes, every cell can be divided without a new vertex: Dompierre and
others 1999; but skew cells become flat ones.) What divides a cell, once its faces are cut, is looked up in
`pcontact.mesh.refinement.split`: the division whose worst tetrahedron is best.

Nodes of the mesh stay where they are. In the middles of diagonals are the nodes of faces and cells where the mesh has
these, else new ones: on curved cells where their shape functions say, on straight ones between the ends. Values of
fields at new nodes are those of the shape functions.

Quadrilaterals, hexahedra, wedges and pyramids divided into triangles and tetrahedra with the same vertices.

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

from pcontact.element.reference import CELLS, edge_nodes, n_nodes, reference_nodes, shape, shape_gradient
from pcontact.mesh.distribute import deal
from pcontact.mesh.geometry.moving import put_on
from pcontact.mesh.mesh import Mesh, mixed
from pcontact.mesh.refinement.numbering import Part, sliced
from pcontact.mesh.refinement.refine import Balance, carried_over
from pcontact.mesh.refinement.simplices import middle_keys
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import Exchanger

# [-] Least volume of a tetrahedron in a reference cell. From: flat ones have zero, others at least 1/3.
FLAT = 1e-9
# [-] Squared length of the longer diagonal of a face over that of the shorter one, up to which they are alike. From:
# chosen; cells of lattices that are a little skew are still divided alike.
ALIKE = 1.2
# [-] A direction that no edge is square to, nor the diagonal of a lattice's cell. From: powers of the golden ratio.
ALONG = np.array([1.0, 0.6180339887498949, 0.3819660112501051])
# [-] Quality of a division with a vertex in the middle over that of others, above which it is taken. From: chosen; it
# has twice the cells.
BETTER = 2.0
# Keys of nodes that one cell alone has: places in a cell at most.
MOST = 64


class Division(NamedTuple):
    """Division of a cell.

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
    """Places of nodes of the simplices in a cell: its own nodes, then those that it lacks.

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
    """Return whether two orders of the same vertices have the same sense."""
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


class Divided(NamedTuple):
    """A divided mesh.

    Attributes
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    fields : list of ndarray (n_nodes, k)
        Values at its nodes on this rank.
    cells : ndarray (n_cells,) int64
        Values of the cells that its cells are parts of.
    """

    mesh: Mesh
    fields: list
    cells: np.ndarray


def split(mesh, fields=(), balance=None, degree=None, cells=None):
    """A mesh of triangles or tetrahedra in place of one of any cells. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        It is left as it is.
    fields : sequence of ndarray (n_nodes, k) float64
        Values at the nodes of this rank.
    balance : pcontact.mesh.refinement.refine.Balance, optional
    degree : int, optional
        Of the layout of the nodes, at least; the cells stay straight where they are.
    cells : ndarray (n_cells,) int64, optional
        Values of the cells of this rank, all blocks one after the other.

    Returns
    -------
    Divided
        The same on any number of ranks, but for the spread of the cells; of groups, bodies and components the mesh has
        what there was. It is a base of its own.

    Raises
    ------
    InputError
        Some simplices of curved cells would fold over.
    """
    exchanger = Exchanger(mesh.comm)
    try:
        with profile.phase("distribute"):
            n = sum(len(block.nodes) for block in mesh.blocks)
            cells = np.zeros(n, dtype=np.int64) if cells is None else np.asarray(cells, dtype=np.int64)
            divided = _Split(mesh, fields, max(mesh.degree, degree or 1))
            wrong = divided.folded()
            if wrong:
                simplices = "triangles" if mesh.dim == 2 else "tetrahedra"
                raise InputError(f"found {wrong} curved cells whose {simplices} would fold over; allowed: cells that "
                                 "are less curved, so smaller ones")  # fmt: skip
            new = deal(divided.slice(exchanger, cells), *(balance or Balance()))
    finally:
        exchanger.free()
    values = new.cell_values[:, 0].copy()
    refined = carried_over(new, mesh, None, [np.shape(field)[1] for field in fields])
    if mesh.belongs is not None:
        put_on(refined.mesh, mesh.belongs.path, mesh.belongs.scene, strict=False)
    return Divided(refined.mesh, refined.fields, values)


def folded(mesh):
    """Number of the curved cells of a mesh of which :func:`split` would make simplices that fold over. *Collective.*"""
    return _Split(mesh, (), mesh.degree).folded()


class _Split:
    """One mesh on its way.

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    fields : sequence of ndarray (n_nodes, k)
    degree : int
        Of the new layout.
    """

    def __init__(self, mesh, fields, degree):
        self._mesh, self._degree = mesh, degree
        self._cell = "triangle" if mesh.dim == 2 else "tetrahedron"
        self._key = mixed(mesh.file_nodes)
        self._known = np.column_stack([mesh.points, *fields]).astype(float)
        self._parts = []
        for number, block in enumerate(mesh.blocks):
            self._parts += self._divided(number, block)

    def folded(self):
        """Number of the curved cells whose simplices fold over. *Collective.*"""
        mesh, wrong = self._mesh, 0
        if not mesh.curved:
            return 0
        slopes = shape_gradient(self._cell, 2, Places(self._cell, 2, 2).at)
        for part in self._parts:
            x = part.values[:, part.table, : mesh.dim]
            jacobians = np.linalg.det(np.einsum("ctni,qnj->ctqij", x, slopes))
            wrong += int((jacobians.min(axis=(1, 2), initial=np.inf) <= 0.0).sum())
        return mesh.comm.allreduce(wrong)

    def slice(self, exchanger, cells):
        """The new mesh, in slices, with values (n_cells,) of the cells. *Collective.*"""
        simplex = CELLS[self._cell]
        width = simplex.n_vertices + (len(simplex.edges) if self._degree == 2 else 0)
        return sliced(exchanger, self._mesh, self._parts, [(self._cell, width)], self._degree, self._known.shape[1],
                      cells=cells)  # fmt: skip

    def _divided(self, number, block):
        """The parts of a block: list of Part."""
        mesh, places = self._mesh, Places(block.cell, self._mesh.degree, self._degree)
        whole = CELLS[block.cell].complete or block.cell
        # the last division has a vertex in the middle
        middle = CELLS[whole].dim == 3 and not (CELLS[whole].is_simplex or CELLS[whole].is_pyramid)
        x = mesh.points[block.nodes[:, : places.vertices]]
        choice = self._choices(places, block, x)
        weights, parts = shape(block.cell, mesh.degree, places.at), []
        old = np.where(np.arange(len(places.at)) < places.own, np.arange(len(places.at)), -1)
        edges = [((a, b), [p for p, *ends in places.edges if ends == [a, b]], [(a, b)])
                 for a, b in edge_nodes(block.cell).tolist()]  # fmt: skip
        for chosen in np.unique(choice):
            rows = np.flatnonzero(choice == chosen)
            some = divisions(whole, int(chosen))
            best = _best(some, x[rows], middle)
            for k in np.unique(best):
                own = rows[best == k]
                nodes = block.nodes[own]
                table = places.table(some[k], self._degree)
                values = self._values(places, nodes, weights, table)
                if not mesh.curved and len(own):
                    self._straighten(block.cell, places, table, values)
                keys = self._keys(places, nodes, block.ids[own], int(chosen))
                parts.append(Part(number, own, table, some[k].facets, edges, old, values, keys))
        return parts

    def _choices(self, places, block, x):
        """Bits of the diagonals of the faces of cells (n,)."""
        choice, numbers = np.zeros(len(x), dtype=np.int64), self._mesh.file_nodes[block.nodes]
        # sums in a fixed order: both cells of a face find the same
        along = _summed(x * ALONG[: x.shape[2]])
        for f, face in enumerate(places.quadrilaterals):
            one, other = (_summed((x[:, face[i]] - x[:, face[i + 2]]) ** 2) for i in (0, 1))
            order = np.lexsort((numbers[:, face], along[:, face]), axis=1)
            second = np.where(other * ALIKE < one, True, np.where(one * ALIKE < other, False, order[:, 0] % 2 == 1))
            choice |= second.astype(np.int64) << f
        return choice

    def _values(self, places, nodes, weights, table):
        """Values (n, n_places, m) at all places of cells."""
        known = self._known[nodes]
        values = np.zeros((len(nodes), len(places.at), known.shape[2]))
        values[:, : places.own] = known
        for p in range(places.own, len(places.at)):
            # one term after the other: the same sum for any number of cells
            for v in np.flatnonzero(weights[p]):
                values[:, p] += weights[p, v] * known[:, v]
        return values

    def _straighten(self, cell, places, table, values):
        """Put nodes of straight cells in the middles of what they are the middles of, with the fields there to first
        order."""
        d = self._mesh.dim
        x, vertices = values[:, :, :d], table[:, : d + 1]
        before = x.copy()
        if places.middle is not None:
            x[:, places.middle] = _mean(x, range(places.vertices))
        if self._degree == 2:
            simplex = edge_nodes(self._cell)
            for a, b in np.unique(np.sort(vertices[:, simplex].reshape(-1, 2), axis=1), axis=0):
                x[:, places.pairs[int(a), int(b)]] = _mean(x, (a, b))
        if values.shape[2] > d:
            slopes = shape_gradient(cell, self._mesh.degree, places.at)
            own = np.concatenate([before, values[:, :, d:]], axis=2)[:, : places.own]
            for p in np.flatnonzero((x != before).any(axis=(0, 2))):
                slope = np.einsum("cai,aj->cij", own, slopes[p])
                step = np.linalg.solve(slope[:, :d], (x[:, p] - before[:, p])[:, :, None])
                values[:, p, d:] += np.matmul(slope[:, d:], step)[..., 0]

    def _keys(self, places, nodes, ids, choice):
        """Keys (n, n_places) of the nodes at all places of cells."""
        keys = np.empty((len(nodes), len(places.at)), dtype=np.uint64)
        keys[:, : places.own] = self._key[nodes]
        for p in range(places.own, len(places.at)):
            keys[:, p] = mixed(self._mesh.n_nodes_total + MOST * ids + p)
        shared = [*places.edges]
        for p, f in places.faces:
            face = places.quadrilaterals[f]
            shared.append((p, *(face[1::2] if choice >> f & 1 else face[::2])))
        for p, a, b in shared:
            keys[:, p] = middle_keys(keys[:, a], keys[:, b])
        return keys


def _best(some, x, middle):
    """The division (n,) of each cell, of those that its faces allow; ``middle``: the last one has a vertex there."""
    if len(some) == 1:
        return np.zeros(len(x), dtype=np.int64)
    x = np.concatenate([x, _mean(x, range(x.shape[1]))[:, None]], axis=1)
    quality = np.stack([_quality(x[:, one.vertices]) for one in some])
    if middle:
        quality[-1] = np.where(quality[-1] > 0.0, quality[-1] / BETTER, quality[-1])
    return quality.argmax(axis=0)


def _quality(x):
    """Least volume^(2/3) over the mean square of the edges of the tetrahedra (n, k, 4, 3) of cells (n,)."""
    a, b, c = (x[:, :, i] - x[:, :, 0] for i in (1, 2, 3))
    volume = _summed(a * np.cross(b, c))
    squares = sum(_summed((x[:, :, i] - x[:, :, j]) ** 2) for i in range(4) for j in range(i))
    return (np.sign(volume) * np.abs(volume) ** (2.0 / 3.0) / squares).min(axis=1)


def _summed(x):
    """Sum over the last axis, term by term."""
    total = x[..., 0].copy()
    for i in range(1, x.shape[-1]):
        total += x[..., i]
    return total


def _mean(x, columns):
    """Mean of columns of x (n, m, d), term by term."""
    columns = sorted(columns)
    total = x[:, columns[0]].copy()
    for k in columns[1:]:
        total += x[:, k]
    return total / len(columns)
