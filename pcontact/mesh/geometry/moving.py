"""New nodes come onto the geometry, as far as the cells around them stay valid.

Places of the nodes of refined meshes whose scene names a geometry.

The trees of cells stand on the mesh of the file: which edges are longest is decided there, so that what becomes of a
cell still depends on the cell alone. At the end new nodes on edges and facets that lie on a curve or surface come onto
it, in the order in which they came to be: a node starts where its parents, which have come there before, put it, and
goes to the nearest point. Other new nodes follow their parents by the shape functions of degree 2, also where cells are
straight: the first ways bend the cells of the file, and later ones, which are shorter with every cut, change them
little. So cells of any size stay valid where those of the file do.

A node belongs to the smallest vertex, edge or facet of the base that it lies in: the vertices of the base that it is
between tell.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, face_nodes
from pcontact.mesh.geometry.belonging import NONE, belonging, opened
from pcontact.mesh.mesh import mixed
from pcontact.mesh.refinement.simplices import BASE, HALF, LINEAR, interpolate, middle_key
from pcontact.mesh.refinement.simplices import place as find
from pcontact.mesh.topology import jacobians
from pcontact.runtime import log
from pcontact.runtime.jit import njit_exact, njit_inline
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI

# [-] Least Jacobian of a cell after its nodes have come onto the geometry, over what it was before. From: chosen.
LEAST = 0.1
# [-] Part of their way below which nodes stay where they are.
SHORTEST = 0.25
# [-] Steps, over coordinates, that are rounding: nodes of symmetry planes keep their zeros.
ROUNDING = 1e-14


class Kin(NamedTuple):
    """Nodes that are to come onto a geometry, and how others follow them.

    Attributes
    ----------
    points : ndarray (n, d)
        Where nodes are when none has moved [length].
    keys : ndarray (n,) uint64
        By which all ranks know them.
    numbers : ndarray (n,)
        Curve or surface that a node is to come onto; `NONE` of others.
    generations : list of ndarray
        Nodes whose place follows from that of nodes of generations before.
    follow : callable
        ``follow(nodes, steps)`` : puts the steps (n, d) of nodes there by what they follow.
    parents : callable
        ``parents(flags)`` : marks (n,) the nodes that marked ones follow.
    cells : list of (str, int, ndarray (n, n_nodes))
        Kind, degree and nodes of the cells that are to stay valid.
    beyond : float
        Distance up to which nodes are on the geometry as they are [length].
    """

    points: np.ndarray
    keys: np.ndarray
    numbers: np.ndarray
    generations: list
    follow: object
    parents: object
    cells: list
    beyond: float = 0.0


class _Steps:
    """The steps of nodes onto the geometry, with the places that have been looked up before."""

    def __init__(self, kin, belongs):
        self._kin, self._belongs = kin, belongs
        self._from, self._places = np.full_like(kin.points, np.nan), np.zeros_like(kin.points)

    def __call__(self, share):
        """Steps (n, d) where nodes go parts (n,) of their own ways."""
        steps = np.zeros_like(self._kin.points)
        if (self._kin.numbers != NONE).any():
            with opened(self._belongs.path, steps.shape[1]) as drawing:
                self._walk(drawing, share, steps)
        return steps

    def _walk(self, drawing, share, steps):
        kin = self._kin
        for nodes in kin.generations:
            kin.follow(nodes, steps)
            own = nodes[(kin.numbers[nodes] != NONE) & (share[nodes] > 0.0)]
            here = kin.points[own] + steps[own]
            self._look_up(drawing, own, here)
            way = self._places[own] - here
            way[np.abs(way) <= ROUNDING * np.abs(here).max(axis=1, initial=0.0)[:, None]] = 0.0
            way[np.linalg.norm(way, axis=1) <= kin.beyond] = 0.0
            steps[own] += share[own, None] * way

    def _look_up(self, drawing, own, here):
        new = (self._from[own] != here).any(axis=1)
        own, here = own[new], here[new]
        self._from[own] = here
        for number in np.unique(self._kin.numbers[own]):
            rows = self._kin.numbers[own] == number
            self._places[own[rows]] = drawing.closest(int(number), here[rows])[0]


def moved(comm, belongs, kin):
    """Nodes on the geometry, as far as cells stay valid. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    belongs : pcontact.mesh.geometry.belonging.Belonging
    kin : Kin

    Returns
    -------
    ndarray (n, d)
        Places of all nodes [length]: bit by bit the same on all ranks that have them.
    """
    if not comm.allreduce(bool((kin.numbers != NONE).any()), op=MPI.LOR):
        return kin.points
    least = [LEAST * jacobians(kin.points, *cells) for cells in kin.cells]
    share, steps_of = np.ones(len(kin.points)), _Steps(kin, belongs)
    while True:
        steps = together(comm, steps_of, share)
        points = np.where(steps != 0.0, kin.points + steps, kin.points)
        late = _held_back(comm, kin, points, least, share)
        if late is None:
            break
        share[late] = np.where(share[late] > SHORTEST, 0.5 * share[late], 0.0)
    _tell(comm, belongs, kin, share)
    return points


def _held_back(comm, kin, points, least, share):
    """Nodes (n,) bool that must not go as far, for cells that are not valid; None where all are. *Collective.*"""
    can = (kin.numbers != NONE) & (share > 0.0)
    late, lost = np.zeros((2, len(points)), dtype=bool)
    for (cell, degree, nodes), low in zip(kin.cells, least, strict=True):
        bad = nodes[jacobians(points, cell, degree, nodes) < low]
        some = can[bad].any(axis=1)
        late[bad[some]] = True
        lost[bad[~some]] = True
    # where the nodes of a cell have not moved by themselves, it is due to those they follow
    while lost.any() and not (lost & can).any():
        before = lost.sum()
        lost |= kin.parents(lost)
        if lost.sum() == before:
            break
    late = (late | lost) & can
    every = np.concatenate(comm.allgather(kin.keys[late]))
    return np.isin(kin.keys, every) & can if len(every) else None


def _tell(comm, belongs, kin, share):
    """Say how many nodes have not come onto the geometry. *Collective.*"""
    short = share < 1.0
    keys = np.unique(np.concatenate(comm.allgather(kin.keys[short])))
    if len(keys):
        log.warning("%s: %d new nodes stay off its curves and surfaces, where cells would become flat or folded; "
                    "remedy: smaller cells, or layers as thick as the arcs of cells are deep", belongs.path, len(keys))


def _middles_moved(mesh, belongs):
    """Bring the nodes in the middles of edges, of a mesh of a file, onto the geometry. *Collective.*

    Those of curved cells stay unless they are away from it; straight cells become curved.

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        Its points are changed, and whether it is curved.
    belongs : pcontact.mesh.geometry.belonging.Belonging
    """
    if mesh.degree == 1:
        return
    marks, numbers = mixed(mesh.file_nodes), np.full(len(mesh.points), NONE)
    links, cells = [[], [], []], []
    for block in mesh.blocks:
        nodes, edges, faces = block.nodes, edge_nodes(block.cell), face_nodes(block.cell)
        n = CELLS[block.cell].n_vertices
        halves, faced = nodes[:, n : n + len(edges)], nodes[:, n + len(edges) : n + len(edges) + len(faces)]
        numbers[halves] = belongs.find(marks[nodes[:, edges]].sum(axis=2, dtype=np.uint64))
        links[0].append((halves.ravel(), np.zeros((halves.size, 0), dtype=np.int64), 0.0))
        for k, face in enumerate(faces):
            if mesh.dim == 3:
                numbers[faced[:, k]] = belongs.find(marks[nodes[:, face]].sum(axis=1, dtype=np.uint64))
            links[1].append((faced[:, k], halves[:, np.isin(edges, face).all(axis=1)], 0.5))
        for centre in nodes[:, n + len(edges) + len(faces) :].T:
            links[2].append((centre, halves, 0.5 if mesh.dim == 2 else 0.25))
        near = (numbers[nodes] != NONE).any(axis=1)
        cells.append((block.cell, 2, nodes[near]))

    def follow(nodes, steps):
        # the generation that these nodes are
        for own, sources, weight in links[next(k for k, one in enumerate(generations) if one is nodes)]:
            steps[own] = weight * steps[sources].sum(axis=1)

    def parents(flags):
        result = np.zeros_like(flags)
        for own, sources, _ in (link for some in links for link in some):
            result[sources[flags[own]]] = True
        return result

    generations = [np.unique(np.concatenate([np.zeros(0, np.int64), *(one[0] for one in some)])) for some in links]
    beyond = belongs.within if mesh.curved else 0.0
    points = moved(mesh.comm, belongs, Kin(mesh.points, marks, numbers, generations, follow, parents, cells, beyond))
    way = np.linalg.norm(points - mesh.points, axis=1)
    far = mesh.comm.allreduce(float(way.max(initial=0.0)), op=MPI.MAX)
    if far > 0.0 and mesh.curved:
        log.info("%s: nodes in the middles of edges were up to %.3g away from it: moved onto it", belongs.path, far)
    mesh.points, mesh.curved = points, mesh.curved or far > 0.0


def put_on(mesh, path, scene, strict=True):
    """Find out on which curves and surfaces of a geometry the boundary of a mesh of a file lies, and bring the nodes in
    the middles of edges there. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        Its points may be changed, and whether it is curved.
    path : pathlib.Path
        Of the geometry.
    scene : str
        For messages: the scene's file.
    strict : bool
        See :func:`pcontact.mesh.geometry.belonging.belonging`.

    Raises
    ------
    InputError
        On every rank: the geometry cannot be read, or the mesh is not on it.
    """
    mesh.belongs = belonging(mesh, path, scene, strict)
    _middles_moved(mesh, mesh.belongs)


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
        interpolate(some, kind, parents, steps)

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
        Of each block, see `pcontact.mesh.refinement.refine`.
    place : ndarray (m,)
        Nodes of the parts of all cells, one after the other.
    keys : ndarray (n,) uint64
    points : ndarray (n, d)
        Where the cells of now put the nodes [length].
    """
    marks, numbers = mixed(mesh.file_nodes), np.full(len(points), NONE)
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
