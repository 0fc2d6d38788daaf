"""Meshes of tetrahedra with all edges halved: millions of cells out of a mesh that gmsh can still make."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gmsh
import meshio
import numpy as np

from .tools import logger

_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
# of a tetrahedron with vertices 0-3 and middles 4-9 of its edges: the four corners, then the octahedron between them,
# cut along the diagonal from the middle of edge 0-2 to that of edge 1-3
_EIGHT = np.array(
    [[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3], [4, 5, 6, 8], [4, 7, 5, 8], [5, 6, 8, 9], [5, 8, 7, 9]]
)
# even orders of the vertices; the diagonal named above is then that of the edges 0-2 and 1-3, 0-1 and 2-3, 0-3 and 1-2
_TURNS = np.array([[0, 1, 2, 3], [0, 3, 1, 2], [0, 2, 3, 1]])
# of a triangle with vertices 0-2 and middles of the edges 0-1, 1-2, 2-0
_FOUR = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


class _Middles:
    """Numbers of the middles of edges: pairs of nodes as one sorted list of keys."""

    def __init__(self, cells: np.ndarray, count: int):
        self.count = count
        keys = self._keys(cells[:, _EDGES].reshape(-1, 2))
        self.keys = np.unique(keys)
        self.pairs = np.column_stack([self.keys // count, self.keys % count])

    def _keys(self, pairs: np.ndarray) -> np.ndarray:
        return pairs.min(axis=1) * self.count + pairs.max(axis=1)

    def __call__(self, pairs: np.ndarray) -> np.ndarray:
        return self.count + np.searchsorted(self.keys, self._keys(pairs.reshape(-1, 2))).reshape(pairs.shape[:-1])


def _turned(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Cells with their vertices in such an order that the shortest diagonal of the octahedron is the one to cut along.

    Cut along any other one, the four parts of the octahedron are flatter than the cell.
    """
    orders = cells[:, _TURNS]
    x = points[orders]
    diagonals = np.linalg.norm(x[:, :, 0] + x[:, :, 2] - x[:, :, 1] - x[:, :, 3], axis=2)
    return orders[np.arange(len(cells)), diagonals.argmin(axis=1)]


def halve(points: np.ndarray, cells: np.ndarray, facets: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, ...]:
    """Halve all edges of a mesh: eight cells, four facets, two edges out of each.

    Parameters
    ----------
    points : (n, 3)
    cells : (nc, 4), tetrahedra
    facets : (nf, 3), triangles among their faces
    edges : (ne, 2), edges among theirs

    Returns
    -------
    points, cells, facets, edges :
        Old nodes keep their numbers. The parts of cell k are cells 8 k to 8 k + 7, and so on. The octahedron between
        the corners of a cell is cut along its shortest diagonal.
    """
    cells = _turned(points, cells)
    middle = _Middles(cells, len(points))
    wide = np.hstack([cells, middle(cells[:, _EDGES])])
    flat = np.hstack([facets, middle(facets[:, [[0, 1], [1, 2], [2, 0]]])])
    bent = np.hstack([edges, middle(edges[:, None])])
    return (
        np.concatenate([points, points[middle.pairs].mean(axis=1)]), wide[:, _EIGHT].reshape(-1, 4),
        flat[:, _FOUR].reshape(-1, 3), bent[:, [[0, 2], [2, 1]]].reshape(-1, 2),
    )  # fmt: skip


def _elements(dim: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Node tags (n, width) and group (n,) of the elements of a dimension that are in a group."""
    tables, numbers = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)]
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            for nodes in gmsh.model.mesh.getElements(dim, entity)[2]:
                tables.append(np.reshape(nodes, (-1, width)).astype(np.int64))
                numbers.append(np.full(len(tables[-1]), tag))
    return np.concatenate(tables), np.concatenate(numbers)


def write_halved(path: str | Path, times: int, onto: Callable[[np.ndarray], np.ndarray], curved: str) -> Path:
    """Write gmsh's current model of tetrahedra with all edges halved.

    Parameters
    ----------
    path : file to write, in gmsh's format 2.2
    times : how often
    onto : puts points (n, 3) on the curved surface
    curved : group of facets whose new nodes go there
    """
    tags, x, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    points, tags = x.reshape(-1, 3)[order], tags[order].astype(np.int64)
    tables, groups = zip(*(_elements(dim, width) for dim, width in ((3, 4), (2, 3), (1, 2), (0, 1))), strict=True)
    cells, facets, edges, vertices = (np.searchsorted(tags, table) for table in tables)
    groups, names = list(groups), {}
    for dim, tag in gmsh.model.getPhysicalGroups():
        names[gmsh.model.getPhysicalName(dim, tag)] = np.array([tag, dim])
    for _ in range(times):
        old = len(points)
        points, cells, facets, edges = halve(points, cells, facets, edges)
        groups = [np.repeat(group, count) for group, count in zip(groups, (8, 4, 2, 1), strict=True)]
        skin = np.unique(facets[groups[1] == names[curved][0]])
        skin = skin[skin >= old]
        points[skin] = onto(points[skin])
    kinds = zip(("tetra", "triangle", "line", "vertex"), (cells, facets, edges, vertices), groups, strict=True)
    blocks = [(kind, table, group) for kind, table, group in kinds if len(table)]
    data = [group for _, _, group in blocks]
    mesh = meshio.Mesh(
        points, [(kind, table) for kind, table, _ in blocks],
        cell_data={"gmsh:physical": data, "gmsh:geometrical": data}, field_data=names,
    )  # fmt: skip
    path = Path(path)
    meshio.write(path, mesh, file_format="gmsh22", binary=True)
    logger.info("%s: %d nodes, %d tetrahedra", path, len(points), len(cells))
    return path
