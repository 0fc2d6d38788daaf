"""Structured meshes computed with numpy: patches of cells on a lattice of points, joined, swept, put into gmsh.

A patch is an array of points on a lattice (with the points of degree 2 in between where the order is 2), so that
curved bodies get their points from closed formulas. Simplices are cut from the same lattice; every face of a cell is
cut alike in neighbouring cells of one patch, and of one sweep, but not of two patches in space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations

import gmsh
import numpy as np

_FAMILY = {
    "segment": "Line",
    "triangle": "Triangle",
    "quadrilateral": "Quadrangle",
    "tetrahedron": "Tetrahedron",
    "hexahedron": "Hexahedron",
}
_DIM = {"segment": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
_SIMPLEX = ("triangle", "tetrahedron")
_SWEPT = {"triangle": "tetrahedron", "quadrilateral": "hexahedron"}
_FACET = {"triangle": "segment", "quadrilateral": "segment", "tetrahedron": "triangle", "hexahedron": "quadrilateral"}
# Vertices of the facets, outward.
_FACETS = {
    "triangle": [[0, 1], [1, 2], [2, 0]],
    "quadrilateral": [[0, 1], [1, 2], [2, 3], [3, 0]],
    "tetrahedron": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    "hexahedron": [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]],
}
_CORNERS = {  # of the tensor cells, in [0, 1]^d
    "segment": np.array([[0], [1]]),
    "quadrilateral": np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
    "hexahedron": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
}
# The three tetrahedra of a prism, as (vertex of the triangle, 0 below or 1 above); vertices sorted counter-clockwise.
_PRISM = [
    [(0, 0), (1, 0), (2, 0), (2, 1)],
    [(0, 0), (1, 0), (2, 1), (1, 1)],
    [(0, 0), (1, 1), (2, 1), (0, 1)],
]


@dataclass(frozen=True)
class Grid:
    """Cells of one kind, 0-based node numbers in gmsh's order.

    Attributes
    ----------
    cell : name of the cell
    order : 1 or 2
    points : (n, 3) array
    cells : (n_cells, nodes of a cell) array
    groups : facets by name, each (n_facets, nodes of a facet), the vertices first, outward
    """

    cell: str
    order: int
    points: np.ndarray
    cells: np.ndarray
    groups: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return _DIM[self.cell]


def _kind(cell: str, order: int) -> tuple[int, int]:
    """gmsh's type of a cell and its number of nodes."""
    kind = gmsh.model.mesh.getElementType(_FAMILY[cell], order)
    return kind, gmsh.model.mesh.getElementProperties(kind)[3]


def _weights(cell: str, order: int) -> np.ndarray:
    """The nodes of a cell as means of its vertices: weights (nodes, vertices)."""
    kind, count = _kind(cell, order)
    x = np.reshape(gmsh.model.mesh.getElementProperties(kind)[4], (count, -1))
    if cell in _SIMPLEX:
        return np.column_stack([1.0 - x.sum(axis=1), x])
    x, corners = 0.5 * (1.0 + x), _CORNERS[cell]
    return np.prod(np.where(corners == 1, x[:, None], 1.0 - x[:, None]), axis=2)


def _find(rows: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Number of the row of `table` (n, k) that equals each of `rows` (m, k)."""
    distance = np.abs(rows[:, None] - table[None]).max(axis=2)
    assert np.all(distance.min(axis=1) < 1e-12)
    return distance.argmin(axis=1)


def graded(n: int, ratio: float = 1.0) -> np.ndarray:
    """Ends (n + 1,) in [0, 1] of n intervals that grow geometrically; the last one is `ratio` times the first."""
    size = ratio ** (np.arange(n) / max(n - 1, 1))
    return np.concatenate([[0.0], np.cumsum(size) / size.sum()])


def refined(ends: np.ndarray, order: int) -> np.ndarray:
    """The ends of intervals with the middles between them where the order is 2."""
    if order == 1:
        return ends
    return np.interp(np.arange(2 * len(ends) - 1), 2 * np.arange(len(ends)), ends)


def _cuts(cell: str) -> list[np.ndarray]:
    """The cells of this kind that make up a unit square or cube: corners (vertices, dim) of each."""
    if cell not in _SIMPLEX:
        return [_CORNERS[cell]]
    dim, cuts = _DIM[cell], []
    for axes in permutations(range(dim)):
        path = np.vstack([np.zeros(dim, int), np.cumsum(np.eye(dim, dtype=int)[list(axes)], axis=0)])
        if np.linalg.det(path[1:]) < 0:
            path[[1, 2]] = path[[2, 1]]
        cuts.append(path)
    return cuts


def lattice(points: np.ndarray, order: int, cell: str) -> Grid:
    """The cells of a patch.

    Parameters
    ----------
    points : (order * n_1 + 1, ..., order * n_d + 1, 3)
        Points of the lattice; a left-handed one is turned round.
    order, cell :
        Degree of the geometry and name of the cell.
    """
    shape, dim = np.array(points.shape[:-1]), _DIM[cell]
    first = (0,) * dim
    edges = [points[tuple(np.eye(dim, dtype=int)[k])] - points[first] for k in range(dim)]
    if np.linalg.det(np.array(edges)[:, :dim]) < 0:
        points = points[::-1]
    corner = order * np.stack(np.meshgrid(*[np.arange((n - 1) // order) for n in shape], indexing="ij"), axis=-1)
    cells = []
    for cut in _cuts(cell):
        offsets = np.rint(order * _weights(cell, order) @ cut).astype(int)
        index = corner.reshape(-1, 1, dim) + offsets
        cells.append(np.ravel_multi_index(tuple(np.moveaxis(index, 2, 0)), shape))
    return Grid(cell, order, points.reshape(-1, 3), np.concatenate(cells))


def join(grids: Sequence[Grid]) -> Grid:
    """One grid of several, whose points are the same where they coincide (the groups are lost)."""
    points = np.concatenate([grid.points for grid in grids])
    start = np.cumsum([0, *(len(grid.points) for grid in grids)])
    cells = np.concatenate([grid.cells + first for grid, first in zip(grids, start[:-1], strict=True)])
    # An odd unit, so that no coordinate a person would choose lies half way between two of its multiples.
    unit = 1.2345678e-8 * np.ptp(points, axis=0).max()
    _, kept, number = np.unique(np.rint(points / unit).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    return Grid(grids[0].cell, grids[0].order, points[kept], number.reshape(-1)[cells])


def facets(grid: Grid) -> np.ndarray:
    """Nodes (n_cells * facets of a cell, nodes of a facet) of all facets of all cells, outward."""
    weights, facet = _weights(grid.cell, grid.order), _FACET[grid.cell]
    local = []
    for vertices in _FACETS[grid.cell]:
        rows = _weights(facet, grid.order) @ np.eye(weights.shape[1])[vertices]
        local.append(_find(rows, weights))
    return grid.cells[:, np.array(local)].reshape(-1, len(local[0]))


def _vertices(grid: Grid, found: np.ndarray) -> np.ndarray:
    return found[:, : len(_FACETS[grid.cell][0])]


def boundary(grid: Grid) -> np.ndarray:
    """The facets that belong to one cell only."""
    found = facets(grid)
    _, first, count = np.unique(np.sort(_vertices(grid, found), axis=1), axis=0, return_index=True, return_counts=True)
    return found[np.sort(first[count == 1])]


def name_boundary(grid: Grid, rest: str | None = None, **where: Callable[[np.ndarray], np.ndarray]) -> Grid:
    """Sort the boundary into groups.

    Parameters
    ----------
    grid : the cells
    rest : name of what no condition takes
    where : for every group a condition on the nodes x (n_facets, nodes of a facet, 3) of facets, which answers for
        every node or for every facet; a facet is in when all its nodes are, and in the first of several groups
    """
    groups, left = _sorted_out(grid, boundary(grid), where)
    if rest is not None:
        groups[rest] = left
    return replace(grid, groups={**grid.groups, **groups})


def split_group(grid: Grid, name: str, **where: Callable[[np.ndarray], np.ndarray]) -> Grid:
    """Move those facets of a group that meet a condition (see `name_boundary`) into groups of their own."""
    groups, left = _sorted_out(grid, grid.groups[name], where)
    return replace(grid, groups={**grid.groups, **groups, name: left})


def _sorted_out(grid: Grid, left: np.ndarray, where: dict) -> tuple[dict[str, np.ndarray], np.ndarray]:
    groups = {}
    for name, condition in where.items():
        inside = np.asarray(condition(grid.points[left]))
        inside = inside.all(axis=1) if inside.ndim == 2 else inside
        groups[name], left = left[inside], left[~inside]
    return groups, left


def name_inside(grid: Grid, name: str, condition: Callable[[np.ndarray], np.ndarray]) -> Grid:
    """Name all facets whose nodes fulfil a condition (see `name_boundary`), also those between two cells, each once."""
    found = facets(grid)
    found = found[np.asarray(condition(grid.points[found])).all(axis=1)]
    _, first = np.unique(np.sort(_vertices(grid, found), axis=1), axis=0, return_index=True)
    return replace(grid, groups={**grid.groups, name: found[np.sort(first)]})


def near(axis: int, value: float, tolerance: float = 1e-9) -> Callable[[np.ndarray], np.ndarray]:
    """Condition for `name_boundary`: the coordinate has this value."""
    return lambda x: np.abs(x[..., axis] - value) < tolerance


def _pairs(cell: str, order: int) -> np.ndarray:
    """The two vertices (nodes, 2) between which every node of a cell lies (the same twice for a vertex)."""
    weights = _weights(cell, order)
    first = weights.argmax(axis=1)
    last = weights.shape[1] - 1 - weights[:, ::-1].argmax(axis=1)
    return np.column_stack([first, last])


def _prisms(flat: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the plane mesh and levels (cells, nodes) of the tetrahedra above every triangle.

    A prism is cut along the numbers of its vertices, so that neighbours agree on the cut of the side between them.
    """
    table = np.zeros((3, 3), int)
    for node, (a, b) in enumerate(_pairs("triangle", flat.order)):
        table[a, b] = table[b, a] = node
    rank = np.argsort(flat.cells[:, :3], axis=1)
    odd = np.linalg.det(np.eye(3)[rank]) < 0
    pairs, nodes, levels = _pairs("tetrahedron", flat.order), [], []
    for tetrahedron in _PRISM:
        for turned, chosen in ((False, ~odd), (True, odd)):
            vertex, level = np.array([tetrahedron[k] for k in ((0, 2, 1, 3) if turned else (0, 1, 2, 3))]).T
            ends = rank[chosen][:, vertex[pairs]]  # (cells, nodes, 2)
            local = table[ends[..., 0], ends[..., 1]]
            nodes.append(np.take_along_axis(flat.cells[chosen], local, axis=1))
            levels.append(np.tile(level[pairs].sum(axis=1) * flat.order // 2, (chosen.sum(), 1)))
    return np.concatenate(nodes), np.concatenate(levels)


def _bricks(flat: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the plane mesh and levels (cells, nodes) of the hexahedra above every quadrilateral."""
    weights = _weights("hexahedron", flat.order)
    local = _find(weights[:, :4] + weights[:, 4:], _weights("quadrilateral", flat.order))
    level = np.rint(flat.order * weights[:, 4:].sum(axis=1)).astype(int)
    nodes = flat.cells[:, local]
    return nodes, np.tile(level, (len(nodes), 1))


def sweep(
    flat: Grid,
    layers: int,
    place: Callable[[np.ndarray, np.ndarray], np.ndarray],
    start: str | None = None,
    end: str | None = None,
) -> Grid:
    """Sweep a plane grid along a path: quadrilaterals become hexahedra, triangles tetrahedra.

    Parameters
    ----------
    flat : the plane grid; its groups become the groups of the faces swept by them
    layers : cells along the path
    place : puts the points x (n, 2) of the section at the parameters s (m,), from 0 to 1, into space: (m, n, 3)
    start, end : names of the first and the last section, which may be the same
    """
    n, order = len(flat.points), flat.order
    points = place(flat.points[:, :2], np.linspace(0.0, 1.0, order * layers + 1)).reshape(-1, 3)
    nodes, levels = _prisms(flat) if flat.cell in _SIMPLEX else _bricks(flat)
    level = levels + order * np.arange(layers)[:, None, None]
    cells = (nodes + n * level).reshape(-1, nodes.shape[1])
    grid = Grid(_SWEPT[flat.cell], order, points, cells)
    outside = boundary(grid)
    vertices = _vertices(grid, outside)
    layer, base = np.divmod(vertices, n)
    groups, low, high = {}, base.min(axis=1), base.max(axis=1)
    side = np.all((base == low[:, None]) | (base == high[:, None]), axis=1)
    for name, found in flat.groups.items():
        ends = np.sort(found[:, :2], axis=1)
        groups[name] = outside[side & np.isin(low * n + high, ends[:, 0] * n + ends[:, 1])]
    for name, last in ((start, 0), (end, order * layers)):
        if name is not None:
            found = outside[~side & np.all(layer == last, axis=1)]
            groups[name] = np.concatenate([groups[name], found]) if name in groups else found
    return replace(grid, groups=groups)


def upright(length: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """For `sweep`: straight up from z = 0 to z = length."""

    def place(x: np.ndarray, s: np.ndarray) -> np.ndarray:
        points = np.empty((len(s), len(x), 3))
        points[..., :2], points[..., 2] = x, length * s[:, None]
        return points

    return place


def take(cell: str, order: int, body: Sequence[int], groups: dict[str, Sequence[int]]) -> Grid:
    """The plane mesh of the model's surfaces `body`, with groups of curves, as a grid."""

    def elements(dim: int, tags: Sequence[int], kind: str) -> np.ndarray:
        code, count = _kind(kind, order)
        found = [gmsh.model.mesh.getElementsByType(code, tag)[1].reshape(-1, count) for tag in tags]
        return np.concatenate(found).astype(int)

    cells = elements(2, body, cell)
    tags, number = np.unique(cells, return_inverse=True)
    known, points, _ = gmsh.model.mesh.getNodes()
    position = np.argsort(known)[np.searchsorted(np.sort(known), tags)]
    named = {name: np.searchsorted(tags, elements(1, curves, "segment")) for name, curves in groups.items()}
    return Grid(cell, order, points.reshape(-1, 3)[position], number.reshape(cells.shape), named)


def add(grid: Grid) -> tuple[int, dict[str, int]]:
    """Put a grid into the gmsh model as entities without geometry (after meshing what has one).

    Returns
    -------
    (int, dict)
        Tag of the body, and of the entity of every group of facets.
    """
    mesh, dim = gmsh.model.mesh, grid.dim
    first = int(mesh.getMaxNodeTag()) + 1
    body = gmsh.model.addDiscreteEntity(dim)
    mesh.addNodes(dim, body, first + np.arange(len(grid.points)), grid.points.ravel())
    mesh.addElementsByType(body, _kind(grid.cell, grid.order)[0], [], (first + grid.cells).ravel())
    tags = {}
    for name, found in grid.groups.items():
        if not len(found):
            continue
        tags[name] = gmsh.model.addDiscreteEntity(dim - 1)
        kind = _kind(_FACET[grid.cell], grid.order)[0]
        mesh.addElementsByType(tags[name], kind, [], (first + found).ravel())
    return body, tags


def add_vertex(grid: Grid, place: Sequence[float]) -> int:
    """Put the node of a grid that is nearest to a place into the model as an entity of its own, after :func:`add` of
    this grid, the last one; its tag."""
    mesh = gmsh.model.mesh
    node = int(mesh.getMaxNodeTag()) - len(grid.points) + 1
    node += int(np.linalg.norm(grid.points - np.asarray(place), axis=1).argmin())
    vertex = gmsh.model.addDiscreteEntity(0)
    mesh.addElementsByType(vertex, 15, [], [node])
    return vertex
