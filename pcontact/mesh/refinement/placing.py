"""Places of the nodes of refined meshes whose scene names a geometry.

The trees of cells stand on the mesh of the file: which edges are longest is decided there, so that what becomes of a
cell still depends on the cell alone. At the end new nodes on edges and facets that lie on a curve or surface come onto
it, in the order in which they came to be: a node starts where its parents, which have come there before, put it, and
goes to the nearest point. Other new nodes follow their parents by the shape functions of degree 2, also where cells are
straight: the first ways bend the cells of the file, and later ones, which are shorter with every cut, change them
little. So cells of any size stay valid where those of the file do.

A node belongs to the smallest vertex, edge or facet of the base that it lies in: the vertices of the base that it is
between tell.
"""

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.geometry.belonging import NONE
from pcontact.mesh.geometry.moving import Kin, moved
from pcontact.mesh.refinement.keys import middle_key, vertex_keys
from pcontact.mesh.refinement.keys import place as find
from pcontact.mesh.refinement.simplices import BASE, HALF, LINEAR
from pcontact.runtime.jit import njit_exact, njit_inline


@njit_inline
def _join(between, n, other):
    """Put the vertices that a node is between to those of another one."""
    for i in range(between.shape[1]):
        v = between[other, i]
        if v < 0:
            return
        for j in range(between.shape[1]):
            if between[n, j] == v:
                break
            if between[n, j] < 0:
                between[n, j] = v
                break


@njit_exact
def _with_faces(kind, parents, key, table, out):
    """Parents (n, 5) of nodes of cells of degree 1 as those of degree 2 have them, from the ends of the edges in whose
    middles they are."""
    keys, values = table
    for s in range(kind.shape[0]):
        a, b = parents[s, 0], parents[s, 1]
        out[s, 0], out[s, 1] = a, b
        if kind[s] == HALF:
            # b is the middle of an edge that ends in a
            out[s, 2] = parents[b, 1] if parents[b, 0] == a else parents[b, 0]
        elif kind[s] != BASE:
            # a is the middle of the edge across from b
            out[s, 0], out[s, 1], out[s, 2] = parents[a, 0], parents[a, 1], a
            for k in range(2):
                out[s, 3 + k] = values[find(keys, values, middle_key(key[parents[a, k]], key[b]))]


@njit_exact
def _trace(kind, parents, first, between, generation):
    """For nodes in the order in which they came to be: vertices of the base (n, d + 1) that each is between, and its
    generation (n,), 0 for nodes of the base, whose number is below `first`."""
    for s in range(kind.shape[0]):
        if parents[s, 0] < 0:
            between[s, 0] = s
            continue
        last = 0
        for k in range(2 if kind[s] == BASE else 3 if kind[s] == HALF else 5):
            last = max(last, generation[parents[s, k]])
            # middles of sides are between no others than the ends
            if kind[s] != HALF or k < 2:
                _join(between, s, parents[s, k])
        generation[s] = last + 1 if s >= first else 0


@njit_exact
def _follow(nodes, kind, parents, steps):
    """Steps of nodes from those of their parents, by the formulas of `pcontact.mesh.refinement.simplices`."""
    p = parents
    for s in nodes:
        for i in range(steps.shape[1]):
            if kind[s] == BASE:
                steps[s, i] = 0.5 * (steps[p[s, 0], i] + steps[p[s, 1], i])
            elif kind[s] == HALF:
                steps[s, i] = 0.375 * steps[p[s, 0], i] + 0.75 * steps[p[s, 1], i] - 0.125 * steps[p[s, 2], i]
            else:
                ends, sides = steps[p[s, 0], i] + steps[p[s, 1], i], steps[p[s, 3], i] + steps[p[s, 4], i]
                steps[s, i] = -0.125 * ends + 0.25 * steps[p[s, 2], i] + 0.5 * sides


def placed(base, forest):
    """Places (n, d) of the nodes of a forest on the geometry of its base. *Collective.*"""
    nodes, n, first, straight = forest.nodes, forest.n_nodes, forest.base_nodes, forest.rule == LINEAR
    kind, parents, key = nodes.kind[:n], nodes.parents[:n], nodes.key[:n]
    if straight:
        parents = np.full((n, 5), -1, dtype=np.int32)
        _with_faces(kind, nodes.parents[:n], key, forest.table, parents)
    between, generation = np.full((n, base.dim + 1), -1, dtype=np.int32), np.zeros(n, dtype=np.int32)
    _trace(kind, parents, first, between, generation)
    # the last one, zero, is that of no vertex
    marks = np.append(nodes.key[:first], np.uint64(0))
    numbers = base.belongs.find(marks[between].sum(axis=1, dtype=np.uint64))
    numbers[:first] = NONE
    order = np.argsort(generation, kind="stable")
    generations = np.split(order, np.cumsum(np.bincount(generation))[:-1])[1:]

    def follow(some, steps):
        _follow(some, kind, parents, steps)

    def parents_of(flags):
        result, rows = np.zeros_like(flags), np.flatnonzero(flags[first:]) + first
        count = np.where(kind[rows] == BASE, 2, np.where(kind[rows] == HALF, 3, 5))
        result[parents[rows][np.arange(5) < count[:, None]]] = True
        return result

    vertices, middles = forest.cells.vertices[: forest.n_cells], forest.cells.middles[: forest.n_cells]
    table = vertices if straight else np.column_stack([vertices, middles])
    cells = [(forest.cell, 1 if straight else 2, table)]
    return moved(base.comm, base.belongs, Kin(nodes.points[:n], key, numbers, generations, follow, parents_of, cells))


def halves_placed(mesh, parts, place, keys, points):
    """Places (n, d) of the nodes of a mesh whose cells are halved, all alike, on the geometry of it. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        That is halved.
    parts : list
        Of each block, see `pcontact.mesh.refinement.regular`.
    place : ndarray (m,)
        Nodes of the parts of all cells, one after the other.
    keys : ndarray (n,) uint64
    points : ndarray (n, d)
        Where the cells of now put the nodes [length].
    """
    marks, numbers = np.empty(len(mesh.points), dtype=np.uint64), np.full(len(points), NONE)
    vertex_keys(mesh.file_nodes, marks)
    cells, end = [], 0
    for block, part in zip(mesh.blocks, parts, strict=True):
        size = len(block.nodes) * part.count * part.width
        own = place[end : end + size].reshape(len(block.nodes), part.count * part.width)
        end += size
        for side in (*CELLS[block.cell].edges, *(CELLS[block.cell].facets if mesh.dim == 3 else ())):
            inside = part.steps[:, list(side)]
            # of those between some of these vertices, others have been met before
            between = (inside > 0).all(axis=1) & (inside.sum(axis=1) == part.steps.sum(axis=1)) & (part.old < 0)
            found = mesh.belongs.find(marks[block.nodes[:, list(side)]].sum(axis=1, dtype=np.uint64))
            numbers[own[:, between]] = found[:, None]
        nodes = own.reshape(-1, part.width)
        degree = 2 if mesh.curved else 1
        cells.append((block.cell, degree, nodes if mesh.curved else nodes[:, : CELLS[block.cell].n_vertices]))
    new = np.flatnonzero(numbers != NONE)

    def follow(nodes, steps):
        """Nodes follow cells that have moved before."""

    return moved(mesh.comm, mesh.belongs, Kin(points, keys, numbers, [new], follow, np.zeros_like, cells))
