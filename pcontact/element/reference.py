"""Reference cells: vertices, edges, facets and the numbering of their nodes.

Node order is VTK's (and meshio's). Simplices live on the unit simplex, tensor cells on [-1, 1]^d, wedges on the unit
triangle times [-1, 1], pyramids above the square [-1, 1]^2 with their apex at (0, 0, 1). The vertices of a facet are
listed so that the facet's own reference map gives the outward normal of the cell: in two dimensions the tangent turned
by -90 degrees (cells are counter-clockwise), in three the right-hand rule.

Lagrange shape functions of degrees 1 and 2 and their reference gradients.

Those of a serendipity cell of degree 2 are those of the complete cell, of whose middle nodes each takes its share:
N_a + sum_m w_ma N_m, with the weights of `pcontact.element.reference.middle_weights`.

Those of wedges are products of the triangle's and the segment's. Those of pyramids are rational: with w = 1 - z, in
degree 1 (w +- x) (w +- y) / (4 w) and z; in degree 2 they span the quadratic polynomials and  f, x f, y f, f^2  with
f = x y / w  (Bergot, Cohen, Durufle 2010). So they are those of triangles and quadrilaterals on the facets, and a
pyramid between hexahedra and tetrahedra leaves no gap.
"""

import functools
from dataclasses import dataclass, replace

import numpy as np

DEGREES = (1, 2)


@dataclass(frozen=True)
class Cell:
    """One reference cell.

    Attributes
    ----------
    name : str
        Key in `CELLS`.
    dim : int
        Dimension of the reference domain.
    n_vertices : int
        Number of vertices, which are nodes 0 to n_vertices - 1 at any degree.
    facet : str or None
        Name of the reference cell of the facets; None for the segment, and for wedges and pyramids, which have
        triangles and quadrilaterals: see :func:`facet_kinds`.
    facets : tuple of tuple of int
        Local vertices of each facet, ordered for the outward normal.
    edges : tuple of tuple of int
        Local vertices of each edge, in the order of the edges' degree-2 nodes.
    faces : tuple of tuple of int
        Local vertices of the quadrilateral faces of a three-dimensional cell, in the order of the faces'
        degree-2 nodes. Empty for triangles, quadrilaterals and tetrahedra, and for serendipity cells.
    complete : str or None
        Of a serendipity cell the one that has nodes in the middles of faces and of itself as well.
    whole : str or None
        Of a cell that stands for the facets of one kind of another cell, the name of that cell.
    """

    name: str
    dim: int
    n_vertices: int
    facet: str | None
    facets: tuple[tuple[int, ...], ...]
    edges: tuple[tuple[int, int], ...]
    faces: tuple[tuple[int, ...], ...]
    complete: str | None = None
    whole: str | None = None

    @property
    def is_tensor(self):
        """bool : whether the reference domain is [-1, 1]^dim."""
        return self.n_vertices == 2**self.dim

    @property
    def is_simplex(self):
        """bool : whether the reference domain is the unit simplex."""
        return self.n_vertices == self.dim + 1

    @property
    def is_wedge(self):
        """bool : whether the reference domain is that of a wedge, the unit triangle times [-1, 1]."""
        return (self.dim, self.n_vertices) == (3, 6)

    @property
    def is_pyramid(self):
        """bool : whether it is that of a pyramid, max(|x|, |y|) <= 1 - z with z >= 0."""
        return (self.dim, self.n_vertices) == (3, 5)


_TRIANGLE_EDGES = ((0, 1), (1, 2), (2, 0))
_QUADRILATERAL_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0))
_TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_HEXAHEDRON_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_HEXAHEDRON_FACES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (2, 3, 7, 6), (0, 3, 2, 1), (4, 5, 6, 7))
_TETRAHEDRON_FACETS = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
_WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_WEDGE_FACES = ((0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
_WEDGE_FACETS = ((0, 2, 1), (3, 4, 5), *_WEDGE_FACES)
_PYRAMID_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))
_PYRAMID_FACES = ((0, 3, 2, 1),)
_PYRAMID_FACETS = (*_PYRAMID_FACES, (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))


def _views(cell, kinds):
    """A cell with facets of several kinds, and for each kind a cell that has these facets alone.

    Facets keep their numbers: in the place of one of another kind stands the first of its own, which nobody asks for.
    """
    found = [cell]
    for kind, corners in kinds.items():
        own = [facet for facet in cell.facets if len(facet) == corners]
        facets = tuple(facet if len(facet) == corners else own[0] for facet in cell.facets)
        found.append(replace(cell, name=f"{cell.name}:{kind}", facet=kind, facets=facets, whole=cell.name))
    return found


# kinds of facets of wedges and pyramids, and their numbers of vertices
_COMPLETE_FACETS = {"triangle": 3, "quadrilateral": 4}
_SERENDIPITY_FACETS = {"triangle": 3, "quadrilateral8": 4}

CELLS: dict[str, Cell] = {
    cell.name: cell
    for cell in (
        Cell("segment", 1, 2, None, (), ((0, 1),), ()),
        Cell("triangle", 2, 3, "segment", _TRIANGLE_EDGES, _TRIANGLE_EDGES, ()),
        Cell("quadrilateral", 2, 4, "segment", _QUADRILATERAL_EDGES, _QUADRILATERAL_EDGES, ()),
        Cell("tetrahedron", 3, 4, "triangle", _TETRAHEDRON_FACETS, _TETRAHEDRON_EDGES, ()),
        Cell("hexahedron", 3, 8, "quadrilateral", _HEXAHEDRON_FACES, _HEXAHEDRON_EDGES, _HEXAHEDRON_FACES),
        Cell("quadrilateral8", 2, 4, "segment", _QUADRILATERAL_EDGES, _QUADRILATERAL_EDGES, (), "quadrilateral"),
        Cell("hexahedron20", 3, 8, "quadrilateral8", _HEXAHEDRON_FACES, _HEXAHEDRON_EDGES, (), "hexahedron"),
        *_views(Cell("wedge", 3, 6, None, _WEDGE_FACETS, _WEDGE_EDGES, _WEDGE_FACES), _COMPLETE_FACETS),
        *_views(Cell("pyramid", 3, 5, None, _PYRAMID_FACETS, _PYRAMID_EDGES, _PYRAMID_FACES), _COMPLETE_FACETS),
        *_views(Cell("wedge15", 3, 6, None, _WEDGE_FACETS, _WEDGE_EDGES, (), "wedge"), _SERENDIPITY_FACETS),
        *_views(Cell("pyramid13", 3, 5, None, _PYRAMID_FACETS, _PYRAMID_EDGES, (), "pyramid"), _SERENDIPITY_FACETS),
    )
}

# serendipity cells by the complete ones
SERENDIPITY = {c.complete: c.name for c in CELLS.values() if c.complete is not None and c.whole is None}

MESHIO_NAMES: dict[tuple[str, int], str] = {
    ("segment", 1): "line",
    ("segment", 2): "line3",
    ("triangle", 1): "triangle",
    ("triangle", 2): "triangle6",
    ("quadrilateral", 1): "quad",
    ("quadrilateral", 2): "quad9",
    ("tetrahedron", 1): "tetra",
    ("tetrahedron", 2): "tetra10",
    ("hexahedron", 1): "hexahedron",
    ("hexahedron", 2): "hexahedron27",
    ("quadrilateral8", 2): "quad8",
    ("hexahedron20", 2): "hexahedron20",
    ("wedge", 1): "wedge",
    ("wedge", 2): "wedge18",
    ("wedge15", 2): "wedge15",
    ("pyramid", 1): "pyramid",
    ("pyramid", 2): "pyramid14",
    ("pyramid13", 2): "pyramid13",
}

_CORNERS = np.array(
    [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
)


def _once(function):
    """A table that depends on names and degrees alone is made once; callers get copies, which are theirs to change."""
    made = functools.cache(function)

    @functools.wraps(function)
    def table(*arguments):
        return made(*arguments).copy()

    return table


def _check_degree(degree):
    if degree not in DEGREES:
        raise ValueError(f"degree {degree}: only {DEGREES} exist")


def _vertices(cell):
    """Reference coordinates of the vertices, (n_vertices, dim)."""
    if CELLS[cell].is_tensor:
        return _CORNERS[: CELLS[cell].n_vertices, : CELLS[cell].dim].astype(float)
    if CELLS[cell].is_wedge:
        ends = np.repeat([-1.0, 1.0], 3)[:, None]
        return np.hstack([np.tile(_vertices("triangle"), (2, 1)), ends])
    if CELLS[cell].is_pyramid:
        return np.vstack([np.hstack([_vertices("quadrilateral"), np.zeros((4, 1))]), [0.0, 0.0, 1.0]])
    return np.vstack([np.zeros(CELLS[cell].dim), np.eye(CELLS[cell].dim)])


def n_nodes(cell, degree):
    """Number of nodes of a cell of a degree.

    Parameters
    ----------
    cell : str
        Key in `CELLS`.
    degree : int
        1 or 2.

    Returns
    -------
    int
        For example 8 and 27 for the hexahedron.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2.
    """
    _check_degree(degree)
    reference = CELLS[cell]
    if degree == 1:
        return reference.n_vertices
    centre = reference.is_tensor and reference.dim > 1 and reference.complete is None
    return reference.n_vertices + len(reference.edges) + len(reference.faces) + centre


@_once
def reference_nodes(cell, degree):
    """Reference coordinates of the nodes.

    Parameters
    ----------
    cell : str
    degree : int

    Returns
    -------
    ndarray, (n_nodes, dim) float64
        Vertices, then the middles of edges, of quadrilateral faces and of the cell itself.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2.
    """
    vertices = _vertices(cell)
    count = n_nodes(cell, degree)
    if degree == 1:
        return vertices
    parts = [vertices, vertices[edge_nodes(cell)].mean(axis=1), vertices[face_nodes(cell)].mean(axis=1)]
    nodes = np.vstack(parts)
    centre = np.tile(vertices.mean(axis=0), (count - len(nodes), 1))
    return np.vstack([nodes, centre])


@_once
def edge_nodes(cell):
    """Local vertices of the edges.

    Parameters
    ----------
    cell : str

    Returns
    -------
    ndarray, (n_edges, 2) int64
        Row i belongs to degree-2 node n_vertices + i.
    """
    return np.array(CELLS[cell].edges, dtype=np.int64)


@_once
def face_nodes(cell):
    """Local vertices of the quadrilateral faces that carry a degree-2 node.

    Parameters
    ----------
    cell : str

    Returns
    -------
    ndarray, (n_faces, 4) int64
        Row i belongs to degree-2 node n_vertices + n_edges + i. Empty where `Cell.faces` is.
    """
    return np.array(CELLS[cell].faces, dtype=np.int64).reshape(-1, 4)


@_once
def middle_weights(cell):
    """Weights of the nodes that the middles of faces and of the cell follow in a serendipity cell of degree 2.

    Its displacements are those of the complete cell whose middle nodes follow the others,

        u(middle of a face) = 1/2 sum(u of the middles of its edges) - 1/4 sum(u of its vertices),
        u(middle of a hexahedron) = 1/4 sum(u of the middles of its edges) - 1/4 sum(u of its vertices),

    the values of the 8 and 20 shape functions there (Zienkiewicz, Taylor: The Finite Element Method, vol. 1).

    Parameters
    ----------
    cell : str
        Serendipity cell.

    Returns
    -------
    ndarray, (n_middles, n_nodes) float64
        Weights of the nodes, in the order of the further nodes of the complete cell.
    """
    complete, n = CELLS[CELLS[cell].complete], CELLS[cell].n_vertices
    edges, share = edge_nodes(cell), 0.5 if CELLS[cell].dim == 2 else 0.25
    middles, rows = n + np.arange(len(edges)), np.zeros((len(complete.faces) + complete.is_tensor, n + len(edges)))
    for row, face in zip(rows, complete.faces, strict=False):
        row[list(face)] = -0.25
        row[middles[np.isin(edges, face).all(axis=1)]] = 0.5
    if complete.is_tensor:
        rows[-1, :n], rows[-1, middles] = -0.25, share
    return rows


def facet_kinds(cell):
    """Kinds of facets of a cell.

    Parameters
    ----------
    cell : str
        A cell of dimension 2 or 3.

    Returns
    -------
    list of (str, ndarray (n,) int64)
        For each kind a name in `CELLS` under which :func:`facet_nodes`, :func:`facet_points`,
        :func:`facet_area_vectors` and `Cell.facet` are those of these facets, and their local numbers. One pair, with
        the cell's own name and all its facets, unless it is a wedge or a pyramid.
    """
    views = [view for view in CELLS.values() if view.whole == cell]
    if not views:
        return [(cell, np.arange(len(CELLS[cell].facets)))]
    sizes = np.array([len(facet) for facet in CELLS[cell].facets])
    return [(view.name, np.flatnonzero(sizes == CELLS[view.facet].n_vertices)) for view in views]


@_once
def facet_nodes(cell, degree):
    """Local node numbers of every facet, in the facet's own node order.

    Parameters
    ----------
    cell : str
        A cell of dimension 2 or 3, or one of :func:`facet_kinds`.
    degree : int

    Returns
    -------
    ndarray, (n_facets, n_facet_nodes) int64
        Ordered so that the facet's reference map gives the outward normal.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2.
    """
    _check_degree(degree)
    reference = CELLS[cell]
    if degree == 1:
        return np.array(reference.facets, dtype=np.int64)
    numbered = {
        frozenset(entity): reference.n_vertices + i
        for i, entity in enumerate(reference.edges + reference.faces)
    }
    edges = CELLS[reference.facet].edges
    rows = []
    for facet in reference.facets:
        middles = [numbered[frozenset((facet[a], facet[b]))] for a, b in edges]
        centre = [numbered[frozenset(facet)]] if reference.facet == "quadrilateral" else []
        rows.append([*facet, *middles, *centre])
    return np.array(rows, dtype=np.int64)


def facet_points(cell, xi):
    """Facet reference points mapped into the cell's reference domain.

    Parameters
    ----------
    cell : str
        A cell of dimension 2 or 3.
    xi : ndarray, (n_points, dim - 1)
        Points in the reference domain of the facets.

    Returns
    -------
    ndarray, (n_facets, n_points, dim) float64
        The same points on each facet.
    """
    origin, tangents = _facet_maps(cell)
    if not CELLS[CELLS[cell].facet].is_tensor:
        return origin[:, None] + np.einsum("fik,qk->fqi", tangents, xi)
    # the origin of a tensor facet is its vertex (-1, ...)
    return origin[:, None] + np.einsum("fik,qk->fqi", tangents, np.asarray(xi) + 1.0)


@_once
def facet_area_vectors(cell):
    """Outward area vectors of the facets on the reference cell.

    Parameters
    ----------
    cell : str
        A cell of dimension 2 or 3.

    Returns
    -------
    ndarray, (n_facets, dim) float64
        Outward normal times the ratio of the area on the reference cell to that on the facet's own domain.
    """
    _, tangents = _facet_maps(cell)
    if CELLS[cell].dim == 2:
        return np.stack([tangents[:, 1, 0], -tangents[:, 0, 0]], axis=1)
    return np.cross(tangents[:, :, 0], tangents[:, :, 1])


@functools.cache
def _facet_maps(cell):
    """First vertex (n_facets, dim) and tangents (n_facets, dim, dim - 1) of the affine maps facet -> cell."""
    facet = CELLS[CELLS[cell].facet]
    corners = _vertices(cell)[facet_nodes(cell, 1)]
    # vertices next to the first one along the facet's own axes
    along = [1, facet.n_vertices - 1][: facet.dim]
    length = 2.0 if facet.is_tensor else 1.0
    tangents = (corners[:, along] - corners[:, :1]) / length
    return corners[:, 0], np.ascontiguousarray(tangents.transpose(0, 2, 1))


# [points] Of tables that are kept: those of quadrature rules, of nodes and of all facets' rules. From: to make a table
# takes 50 microseconds, whatever it is for, and a run of some hundred unknowns wants hundreds.
FEW, TABLES = 160, 1024


def kept(function):
    """A function of cell, degree and reference points, with tables at few points kept; they are not to be changed."""

    @functools.lru_cache(maxsize=TABLES)
    def known(cell, degree, count, points):
        return function(cell, degree, np.frombuffer(points).reshape(count, -1))

    @functools.wraps(function)
    def table(cell, degree, xi):
        xi = _points(cell, xi)
        if not 0 < len(xi) <= FEW:
            return function(cell, degree, xi)
        return known(cell, degree, len(xi), xi.tobytes())

    return table


@kept
def shape(cell, degree, xi):
    """Shape functions at reference points.

    Parameters
    ----------
    cell : str
        Key in `pcontact.element.reference.CELLS`.
    degree : int
        1 or 2.
    xi : ndarray, (n_points, dim)
        Points in the reference domain.

    Returns
    -------
    ndarray, (n_points, n_nodes) float64
        Not to be changed: at few points it is kept.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2, or the points have another dimension than the cell.
    """
    if CELLS[cell].complete is not None:
        return _shared(cell, shape(CELLS[cell].complete, degree, xi))
    if CELLS[cell].is_tensor:
        return _lagrange(xi[:, None], reference_nodes(cell, degree), degree).prod(axis=2)
    nodes = reference_nodes(cell, degree)
    if CELLS[cell].is_wedge:
        column, height = _wedge_nodes(nodes, degree)
        return shape("triangle", degree, xi[:, :2])[:, column] * _lagrange(xi[:, 2:], height, degree)
    if CELLS[cell].is_pyramid:
        return _pyramid_basis(xi, degree)[0] @ _pyramid_weights(degree)
    bary = _barycentric(xi)
    if degree == 1:
        return bary
    a, b = edge_nodes(cell).T
    return np.hstack([bary * (2.0 * bary - 1.0), 4.0 * bary[:, a] * bary[:, b]])


@kept
def shape_gradient(cell, degree, xi):
    """Reference gradients of the shape functions at reference points.

    Parameters
    ----------
    cell : str
    degree : int
    xi : ndarray, (n_points, dim)

    Returns
    -------
    ndarray, (n_points, n_nodes, dim) float64
        Derivatives with respect to the reference coordinates; not to be changed.

    Raises
    ------
    ValueError
        If `degree` is neither 1 nor 2, or the points have another dimension than the cell.
    """
    if CELLS[cell].complete is not None:
        return _shared(cell, shape_gradient(CELLS[cell].complete, degree, xi))
    nodes = reference_nodes(cell, degree)
    if CELLS[cell].is_wedge:
        return _wedge_gradient(xi, *_wedge_nodes(nodes, degree), degree)
    if CELLS[cell].is_pyramid:
        return np.einsum("pmk,ma->pak", _pyramid_basis(xi, degree)[1], _pyramid_weights(degree))
    if not CELLS[cell].is_tensor:
        return _simplex_gradient(cell, degree, xi)
    values = _lagrange(xi[:, None], nodes, degree)
    slopes = _lagrange_slope(xi[:, None], nodes, degree)
    gradient = np.empty_like(values)
    for axis in range(CELLS[cell].dim):
        factors = values.copy()
        factors[:, :, axis] = slopes[:, :, axis]
        gradient[:, :, axis] = factors.prod(axis=2)
    return gradient


def _points(cell, xi):
    xi = np.asarray(xi, dtype=float)
    if xi.ndim != 2 or xi.shape[1] != CELLS[cell].dim:
        raise ValueError(f"{cell}: points of shape {xi.shape}, expected (n_points, {CELLS[cell].dim})")
    return xi


def _shared(cell, values):
    """Values (n_points, n_nodes, ...) of a serendipity cell from those of the complete one."""
    weights = middle_weights(cell)
    n = weights.shape[1]
    if values.shape[1] < n:
        return values  # degree 1: there are no middles
    return values[:, :n] + np.einsum("pm...,ma->pa...", values[:, n:], weights)


def _barycentric(xi):
    return np.hstack([1.0 - xi.sum(axis=1, keepdims=True), xi])


def _simplex_gradient(cell, degree, xi):
    dim = xi.shape[1]
    slope = np.vstack([-np.ones(dim), np.eye(dim)])
    if degree == 1:
        return np.tile(slope, (len(xi), 1, 1))
    bary = _barycentric(xi)[:, :, None]
    a, b = edge_nodes(cell).T
    edges = 4.0 * (bary[:, a] * slope[b] + bary[:, b] * slope[a])
    return np.concatenate([(4.0 * bary - 1.0) * slope, edges], axis=1)


def _wedge_nodes(nodes, degree):
    """Node of the triangle, and coordinate along the axis, of the nodes (n, 3) of a wedge."""
    triangle = reference_nodes("triangle", degree)
    column = np.abs(nodes[:, None, :2] - triangle).sum(axis=2).argmin(axis=1)
    return column, nodes[:, 2]


def _wedge_gradient(xi, column, height, degree):
    across = shape_gradient("triangle", degree, xi[:, :2])[:, column] * _lagrange(xi[:, 2:], height, degree)[:, :, None]
    along = shape("triangle", degree, xi[:, :2])[:, column] * _lagrange_slope(xi[:, 2:], height, degree)
    return np.concatenate([across, along[:, :, None]], axis=2)


def _pyramid_basis(xi, degree):
    """Functions (n, m) that span those of a pyramid, and their gradients (n, m, 3).

    At the apex, where gradients of f depend on the way, they are those on the axis.
    """
    x, y, z = xi.T
    w = 1.0 - z
    top = w <= 0.0
    u, v = (np.where(top, 0.0, coordinate / np.where(top, 1.0, w)) for coordinate in (x, y))
    one, zero = np.ones_like(x), np.zeros_like(x)
    f, df = u * v * w, np.stack([v, u, u * v], axis=1)
    values = [one, x, y, z, f]
    slopes = [np.stack(row, axis=1) for row in ((zero, zero, zero), (one, zero, zero), (zero, one, zero),
                                                (zero, zero, one))] + [df]  # fmt: skip
    if degree == 2:
        for a, b in ((1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3), (1, 4), (2, 4), (4, 4)):
            values.append(values[a] * values[b])
            slopes.append(values[a][:, None] * slopes[b] + values[b][:, None] * slopes[a])
    return np.stack(values, axis=1), np.stack(slopes, axis=1)


@functools.cache
def _pyramid_weights(degree):
    """Matrix (m, n_nodes) from the functions of `_pyramid_basis` to the shape functions."""
    # entries are multiples of 1 / 4: rounding takes the errors of the inverse away
    return np.rint(16.0 * np.linalg.inv(_pyramid_basis(reference_nodes("pyramid", degree), degree)[0])) / 16.0


def _lagrange(s, node, degree):
    """One-dimensional function that is 1 at `node` (-1, 0 or 1), at coordinates `s`; arguments broadcast."""
    if degree == 1:
        return 0.5 * (1.0 + node * s)
    return np.where(node == 0.0, 1.0 - s * s, 0.5 * s * (s + node))


def _lagrange_slope(s, node, degree):
    if degree == 1:
        return 0.5 * node + 0.0 * s
    return np.where(node == 0.0, -2.0 * s, s + 0.5 * node)
