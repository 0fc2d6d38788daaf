"""On which curve or surface of a geometry the facets and edges of a mesh lie.

Curves and surfaces of a geometry that gmsh reads, and the points on them that are nearest to others.
"""

import importlib
import os
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes
from pcontact.mesh.mesh import bounding_box, mixed
from pcontact.mesh.msh import apart
from pcontact.mesh.refinement.numbering import Neighbours, values_by_key
from pcontact.mesh.topology import outer_facets
from pcontact.runtime import log, process
from pcontact.runtime.errors import InputError, coordinates, input_error
from pcontact.runtime.files import GEOMETRIES
from pcontact.runtime.parallel import Exchanger, rows_of, together
from pcontact.runtime.petsc import MPI

# kinds of curves and surfaces that cells of degree 1 follow by themselves, as gmsh calls them
FLAT = ("Line", "Plane")
# [-] Room around the box of a curve or surface, over its diagonal. From: gmsh's boxes are those of samples of it where
# its own kernel made it.
ROOM = 0.05
# [-] How far a vertex on the boundary may be from the geometry, over the size of the mesh. From: some programs write
# coordinates with six digits.
NEAR = 1e-5
# [-] Differences of distances that tell one curve or surface from another, over that. From: rounding in geometries.
APART = 1e-3
# [-] Ratio of the sizes of geometry and mesh from which on it is worth a word. From: chosen.
UNLIKE = 1.02
# no curve or surface; and, of an edge, that its facets lie on several
NONE, BETWEEN = -1, -2


class Drawing:
    """A geometry, as long as it is open; see :func:`opened`.

    Parameters
    ----------
    model : module
        gmsh.model
    dim : int
        Of the mesh.

    Attributes
    ----------
    boundary, curves : range
        Numbers of the curves (plane meshes) or surfaces (meshes in space) that bound bodies; in space, numbers of
        curves.
    entities : list of (int, int)
        Dimension and gmsh's tag, by number.
    flat : ndarray (n,) of bool
        Straight lines and planes.
    low, high : ndarray (n, 3)
        Corners of boxes around them [length].
    """

    def __init__(self, model, dim):
        self._model, self.entities = model, [(dim - 1, tag) for _, tag in model.getEntities(dim - 1)]
        self.boundary = range(len(self.entities))
        if dim == 3:
            self.entities += [(1, tag) for _, tag in model.getEntities(1)]
        self.curves = range(len(self.boundary), len(self.entities))
        self.flat = np.array([model.getType(*one) in FLAT for one in self.entities], dtype=bool)
        boxes = np.reshape([model.getBoundingBox(*one) for one in self.entities], (-1, 6))
        room = ROOM * np.linalg.norm(boxes[:, 3:] - boxes[:, :3], axis=1)[:, None]
        self.low, self.high = boxes[:, :3] - room, boxes[:, 3:] + room

    @property
    def size(self):
        """float : diagonal of the box around everything [length]."""
        box = np.array(self._model.getBoundingBox(-1, -1))
        return float(np.linalg.norm(box[3:] - box[:3]))

    def closest(self, number, points):
        """The points of a curve or surface that are nearest to others.

        Parameters
        ----------
        number : int
        points : ndarray (n, d)

        Returns
        -------
        places : ndarray (n, d)
        distances : ndarray (n,)
            Infinite where the curve is a single point.
        """
        if not len(points):
            return np.array(points), np.zeros(0)
        full = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
        try:
            found = np.reshape(self._model.getClosestPoint(*self.entities[number], full.ravel())[0], (-1, 3))
        except Exception:  # gmsh knows no other class; the seam of a sphere ends in points that are curves to it
            return np.array(points), np.full(len(points), np.inf)
        return found[:, : points.shape[1]].copy(), np.linalg.norm(found - full, axis=1)

    def contains(self, number, point):
        """Return whether a point (d,) of the carrier of a curve or surface is within its ends or edges."""
        full = np.zeros(3)
        full[: len(point)] = point
        return self._model.isInside(*self.entities[number], full) > 0


@contextmanager
def opened(path, dim):
    """A geometry, for meshes of a dimension. Serial.

    Parameters
    ----------
    path : pathlib.Path
    dim : int

    Yields
    ------
    Drawing

    Raises
    ------
    InputError
        What is wrong with the file, in a few words.
    """
    try:
        # no run without a geometry waits for it
        gmsh = importlib.import_module("gmsh")
    except (ImportError, OSError):  # not installed, or a system library that it needs is missing
        raise InputError("without the Python package gmsh") from None
    # somebody who calls the program from Python may have gmsh open, with models of his own
    before = gmsh.model.getCurrent() if gmsh.isInitialized() else None
    if before is None:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        process.take_back()
    terminal = gmsh.option.getNumber("General.Terminal")
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        try:
            with _silent(), apart(path) as file:
                gmsh.open(str(file))
        except Exception as error:  # gmsh knows no other class
            raise InputError(f"a file that gmsh cannot read: {' '.join(str(error).split())}") from None
        drawing = Drawing(gmsh.model, dim)
        if not drawing.entities:
            raise InputError(f"a file without {'curves' if dim == 2 else 'surfaces'}")
        yield drawing
    finally:
        if before is None:
            gmsh.finalize()
        else:
            gmsh.option.setNumber("General.Terminal", terminal)
            gmsh.model.remove()
            if before in gmsh.model.list():
                gmsh.model.setCurrent(before)


@contextmanager
def _silent():
    """Keep what a library prints off the standard output: readers of STEP files say there what they do not like."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


@dataclass
class Belonging:
    """Edges and facets of the cells of this rank that lie on curves and surfaces which are not straight.

    Attributes
    ----------
    path : pathlib.Path
        Of the geometry.
    scene : str
        The scene's file, for messages.
    within : float
        How far vertices may be from it [length].
    keys : ndarray (n,) uint64
        Ascending. Of edges and facets: sums of the mixed numbers of their vertices.
    numbers : ndarray (n,) int64
        Curve or surface of each, see :class:`pcontact.mesh.geometry.belonging.Drawing`.
    """

    path: Path
    scene: str
    within: float
    keys: np.ndarray
    numbers: np.ndarray

    def find(self, keys):
        """Curves or surfaces (n,) of edges and facets with keys (n,) uint64; `NONE` where there is none."""
        if not len(self.keys):
            return np.full(len(keys), NONE)
        at = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[at] == keys, self.numbers[at], NONE)


class _Boundary:
    """The boundary of the bodies, as far as this rank has it. *Collective.*

    Attributes
    ----------
    facets : list of (ndarray (n, n_vertices), ndarray (n, d))
        Local nodes of the vertices of facets of a kind, and a point in the middle of each [length].
    edges : ndarray (n, 2)
        In space: local nodes of the vertices of their edges, each once.
    middles : ndarray (n, d)
        A point in the middle of each.
    vertices : ndarray (n,)
        Local nodes of all vertices, ascending.
    required : ndarray (n,) of bool
        Those on the outer boundary: facets between bodies need not be on the geometry.
    """

    def __init__(self, mesh, exchanger):
        self.mesh, self.facets, edges = mesh, [], []
        outer, every = outer_facets(mesh, exchanger), None
        if mesh.comm.allreduce(max((block.body for block in mesh.blocks), default=0), op=MPI.MAX) > 0:
            every = outer_facets(mesh, exchanger, of_bodies=True)
        marks = np.zeros((2, len(mesh.points)), dtype=bool)
        for mark, some in ((1, outer), (0, outer if every is None else every)):
            for one in some:
                marks[mark, mesh.facet_nodes(one)[:, : CELLS[one.kind].n_vertices]] = True
        for one in outer if every is None else every:
            nodes, n = mesh.facet_nodes(one), CELLS[one.kind].n_vertices
            pairs = edge_nodes(one.kind) if mesh.dim == 3 else np.array([[0, 1]])
            between = nodes[:, n : n + len(pairs)] if mesh.curved else nodes[:, pairs]
            halves = mesh.points[between] if mesh.curved else mesh.points[between].mean(axis=2)
            self.facets.append((nodes[:, :n], halves.mean(axis=1)))
            edges.append((nodes[:, pairs].reshape(-1, 2), halves.reshape(-1, mesh.dim)))
        self.edges, self.middles = np.zeros((0, 2), dtype=np.int64), np.zeros((0, mesh.dim))
        if mesh.dim == 3 and edges:
            self.edges, self.middles = (np.concatenate(parts) for parts in zip(*edges, strict=True))
            _, first = np.unique(np.sort(self.edges, axis=1), axis=0, return_index=True)
            self.edges, self.middles = self.edges[first], self.middles[first]
        self.vertices = np.flatnonzero(marks[0])
        self.required = marks[1, self.vertices]


def _on(drawing, numbers, points, within):
    """Return by curve or surface the points (rows) that lie on it, and how far they are from it."""
    full = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    found = {}
    for number in numbers:
        low, high = drawing.low[number] - within, drawing.high[number] + within
        rows = np.flatnonzero(((full >= low) & (full <= high)).all(axis=1))
        distance = drawing.closest(number, points[rows])[1]
        found[number] = rows[distance <= within], distance[distance <= within]
    return found


def _chosen(drawing, found, boundary, tables, centres, within):
    """Curves or surfaces (n,) that have all vertices of facets or edges (n, k), `NONE` where none has them."""
    rows, numbers, far, off = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)], [np.zeros(0)]
    places = np.searchsorted(boundary.vertices, tables)
    for number, (on, distance) in found.items():
        apart = np.full(len(boundary.vertices), np.inf)
        apart[on] = distance
        worst = apart[places].max(axis=1, initial=0.0)
        inside = np.flatnonzero(np.isfinite(worst))
        rows.append(inside)
        numbers.append(np.full(len(inside), number))
        far.append(np.rint(worst[inside] / (APART * within)))
        off.append(drawing.closest(number, centres[inside])[1])
    rows, numbers, far, off = (np.concatenate(parts) for parts in (rows, numbers, far, off))
    # a carrier may go on beyond the edges of a surface, and meet vertices of another one there; of surfaces that lie on
    # each other, as those of two bodies, any one does
    outside, least, most = np.zeros(len(rows), dtype=bool), np.full(len(tables), np.inf), np.zeros(len(tables))
    np.minimum.at(least, rows, off)
    np.maximum.at(most, rows, off)
    for k in np.flatnonzero((most - least)[rows] > APART * within):
        place = drawing.closest(numbers[k], centres[rows[k]][None])[0][0]
        outside[k] = not drawing.contains(numbers[k], place)
    order = np.lexsort((numbers, off, far, outside, rows))
    result = np.full(len(tables), NONE)
    first = np.unique(rows[order], return_index=True)[1]
    result[rows[order][first]] = numbers[order][first]
    return result


class _Found(NamedTuple):
    """Findings of one rank: curves or surfaces of the facets, curves of the edges; which curves and surfaces are
    straight; number of facets that have none though all of their vertices do; rows of vertices that are on nothing, how
    far the first of them is from the geometry, and how large that is."""

    facets: list
    edges: np.ndarray
    flat: np.ndarray
    across: int
    off: np.ndarray
    distance: float
    size: float


def _look(path, boundary, within):
    """Compare the boundary of this rank with the geometry."""
    mesh = boundary.mesh
    with opened(path, mesh.dim) as drawing:
        points = mesh.points[boundary.vertices]
        on = _on(drawing, drawing.boundary, points, within)
        lies = np.zeros(len(mesh.points), dtype=bool)
        for rows, _ in on.values():
            lies[boundary.vertices[rows]] = True
        off, distance = np.flatnonzero(boundary.required & ~lies[boundary.vertices]), np.inf
        # the same one on any number of ranks, as far as one can tell
        off = off[np.argsort(mesh.file_nodes[boundary.vertices[off]])]
        if len(off):
            distance = min(drawing.closest(k, points[off[:1]])[1][0] for k in drawing.boundary)
        facets = [_chosen(drawing, on, boundary, *some, within) for some in boundary.facets]
        across = sum(int(np.count_nonzero(lies[nodes].all(axis=1) & (numbers == NONE)))
                     for (nodes, _), numbers in zip(boundary.facets, facets, strict=True))  # fmt: skip
        on = _on(drawing, drawing.curves, points, within)
        edges = _chosen(drawing, on, boundary, boundary.edges, boundary.middles, within)
        return _Found(facets, edges, np.append(drawing.flat, False), across, off, distance, drawing.size)


def _require(boundary, found, within, say):
    """Raise an error where vertices are not on the geometry. *Collective.*"""
    mesh, first = boundary.mesh, None
    if len(found.off):
        node = boundary.vertices[found.off[0]]
        first = int(mesh.file_nodes[node]), mesh.points[node], float(found.distance)
    firsts = [one for one in mesh.comm.allgather(first) if one is not None]
    if not firsts:
        return
    nodes = [mesh.file_nodes[boundary.vertices[rows]] for rows in (found.off, np.flatnonzero(boundary.required))]
    off, all_ = (len(np.unique(np.concatenate(mesh.comm.allgather(one)))) for one in nodes)
    _, x, distance = min(firsts, key=lambda one: one[0])
    low, high = bounding_box(mesh.comm, mesh.points)
    size = max(mesh.comm.allgather(found.size))
    ratio = float(np.linalg.norm(high - low)) / size if size > 0.0 else 1.0
    words = f"whose curves or surfaces are not where {off} of {all_} vertices of the boundary are: the first one, at " \
            f"{coordinates(x)}, is {distance:.2g} from them"
    if not 1.0 / UNLIKE < ratio < UNLIKE:
        words += f"; the mesh is {ratio:.4g} times as large"
    raise say(words, f"the geometry that the mesh was made of, in its units, within {within:.2g}")


def _edges(exchanger, boundary, found, keys):
    """Curves and surfaces of the edges of facets in space, where these lie on the same one or meet. *Collective.*

    Returns
    -------
    ndarray (n,) of int
        `NONE` where facets of several surfaces meet, and not on a curve.
    """
    pairs, numbers = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for (table, _), own in zip(boundary.facets, found.facets, strict=True):
        local = edge_nodes("triangle" if table.shape[1] == 3 else "quadrilateral")
        pairs.append(table[:, local].reshape(-1, 2))
        numbers.append(np.repeat(own, len(local)))
    numbers = np.concatenate(numbers)
    marks = keys[np.concatenate(pairs)].sum(axis=1, dtype=np.uint64)

    def common(table):
        _, first, place = np.unique(table[:, 0], return_index=True, return_inverse=True)
        low, high = np.full(len(first), np.iinfo(np.int64).max), np.full(len(first), np.iinfo(np.int64).min)
        np.minimum.at(low, place.ravel(), table[:, 1])
        np.maximum.at(high, place.ravel(), table[:, 1])
        return np.where(low == high, low, BETWEEN)[place.ravel(), None]

    home = (marks % np.uint64(exchanger.comm.size)).astype(np.int64)
    answer = exchanger.ask(home, np.column_stack([marks.view(np.int64), numbers]), common)[:, 0]
    own = keys[boundary.edges].sum(axis=1, dtype=np.uint64)
    surface = answer[rows_of(marks, own)]
    return np.where(surface == BETWEEN, found.edges, surface)


def _spread(exchanger, mesh, keys, marks, numbers):
    """With edges (n,) that this rank knows, those that lie in its cells and others know. *Collective.*"""
    if exchanger.comm.size == 1:
        return marks, numbers
    shared = Neighbours(exchanger, mesh.file_nodes, mesh.n_nodes_total).shared > 0
    wanted = [np.zeros(0, dtype=np.uint64)]
    for block in mesh.blocks:
        pairs = block.nodes[:, edge_nodes(block.cell)].reshape(-1, 2)
        wanted.append(keys[pairs[shared[pairs].all(axis=1)]].sum(axis=1, dtype=np.uint64))
    wanted = np.unique(np.concatenate(wanted))
    known, values = values_by_key(exchanger, marks, numbers[:, None], wanted)
    more = known & ~np.isin(wanted, marks)
    return np.concatenate([marks, wanted[more]]), np.concatenate([numbers, values[more, 0]])


def belonging(mesh, path, scene, strict=True):
    """Find out on which curves and surfaces the boundary of a mesh lies. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    path : pathlib.Path
        Of the geometry.
    scene : str
        For messages.
    strict : bool
        Whether vertices that are not on the geometry are an error, and facets that lie across its curves are told of.

    Returns
    -------
    Belonging

    Raises
    ------
    InputError
        On every rank.
    """
    def say(found, allowed):
        return input_error(scene, "mesh.geometry", f"{str(path)!r}, {found}", allowed)

    def look():
        try:
            return _look(path, boundary, within)
        except InputError as error:
            raise say(str(error), f"a file of gmsh ({', '.join(GEOMETRIES)})") from None

    exchanger = Exchanger(mesh.comm)
    try:
        boundary = _Boundary(mesh, exchanger)
        low, high = bounding_box(mesh.comm, mesh.points)
        within = NEAR * float(np.linalg.norm(high - low))
        found = together(mesh.comm, look)
        if strict:
            _require(boundary, found, within, say)
        keys = mixed(mesh.file_nodes)
        marks = [keys[table].sum(axis=1, dtype=np.uint64) for table, _ in boundary.facets]
        numbers = list(found.facets)
        if mesh.dim == 3:
            marks.append(keys[boundary.edges].sum(axis=1, dtype=np.uint64))
            numbers.append(_edges(exchanger, boundary, found, keys))
        marks = np.concatenate([np.zeros(0, np.uint64), *marks])
        numbers = np.concatenate([np.zeros(0, np.int64), *numbers])
        across = mesh.comm.allreduce(found.across)
        kept = ~found.flat[numbers] & (numbers != NONE)
        marks, numbers = _spread(exchanger, mesh, keys, marks[kept], numbers[kept])
    finally:
        exchanger.free()
    if across and strict:
        log.warning("%s: %d facets of the mesh lie across its edges: new nodes on them stay there", path, across)
    marks, first = np.unique(marks, return_index=True)
    return Belonging(path, scene, within, marks, numbers[first])
