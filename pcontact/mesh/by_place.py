"""Groups of a mesh by where their members are."""

import numpy as np

from pcontact.element.reference import edge_nodes
from pcontact.mesh.raw import facet_vertices, facets_of_nodes, numbered


def cells_by_place(raw, test, within=None):
    """Cells whose middle a test takes.

    Parameters
    ----------
    raw : RawMesh
    test : callable
        From places (n, d) [length] and outward unit normals (n, d), or None, to (n,) bool.
    within : ndarray (m,) of int, optional
        Cells to choose from; absent: all.

    Returns
    -------
    ndarray (n,) int64
        Ascending.
    """
    middles = np.concatenate([raw.points[block.vertices].mean(axis=1) for block in raw.blocks])
    chosen = np.flatnonzero(test(middles, None))
    return chosen if within is None else np.intersect1d(chosen, within)


def facets_by_place(raw, test, within=None):
    """Facets of the boundary of which a test takes all vertices.

    Parameters
    ----------
    raw, test, within
        As of :func:`cells_by_place`: facets of the cells that are given. Normals are those in the middle of the facet.

    Returns
    -------
    cells, local_facets : ndarray (n,) int64
    """
    cells, local = facets_of_nodes(raw, np.arange(len(raw.points)))
    if within is not None:
        own = np.isin(cells, within)
        cells, local = cells[own], local[own]
    middles = np.concatenate([raw.points[block.vertices].mean(axis=1) for block in raw.blocks])[cells]
    chosen = np.zeros(len(cells), dtype=bool)
    for rows, vertices in facet_vertices(raw, cells, local):
        x = raw.points[vertices]
        normal = _normals(x, x.mean(axis=1) - middles[rows])
        taken = test(x.reshape(-1, raw.dim), np.repeat(normal, x.shape[1], axis=0))
        chosen[rows] = taken.reshape(len(x), -1).all(axis=1)
    return cells[chosen], local[chosen]


def nodes_by_place(raw, test, within=None):
    """Nodes that a test takes.

    Parameters
    ----------
    raw, test, within
        As of :func:`cells_by_place`: nodes of the cells that are given.

    Returns
    -------
    nodes : ndarray (n,) int64
        Ascending.
    edges : ndarray (m, 2) int64
        Vertices of edges both ends and the middle of which are taken: nodes that come there belong to the group.
    """
    nodes, edges = [], []
    chosen = np.ones(raw.offsets[-1], dtype=bool) if within is None else np.isin(np.arange(raw.offsets[-1]), within)
    for block, rows in numbered(raw.blocks):
        own = block.nodes[chosen[rows]]
        nodes.append(own.ravel())
        edges.append(np.sort(own[:, edge_nodes(block.cell)].reshape(-1, 2), axis=1))
    nodes, edges = np.unique(np.concatenate(nodes)), np.unique(np.concatenate(edges), axis=0)
    nodes = nodes[test(raw.points[nodes], None)]
    edges = edges[np.isin(edges, nodes).all(axis=1)]
    return nodes, edges[test(raw.points[edges].mean(axis=1), None)]


def _normals(x, outward):
    """Unit normals (n, d) of facets with vertices (n, k, d), on the side of given vectors (n, d)."""
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        normal = np.column_stack([along[:, 1], -along[:, 0]])
    else:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, -1] - x[:, 0])
    side = np.sign(np.einsum("nd,nd->n", normal, outward))
    return normal * (side / np.linalg.norm(normal, axis=1))[:, None]


BY_PLACE = {"cells": cells_by_place, "facets": facets_by_place, "nodes": nodes_by_place}
