"""Triangles and tetrahedra cut in halves where a mesh is to be finer; groups go along.

Cells are halved at their longest marked edge until none of their edges is marked. Edges are compared by length and, for
equal lengths, by the numbers of their ends, so two cells cut the face they share in the same way. Before that marks
spread: a cell with a marked edge has its longest edge marked, too, and so has a face, which keeps angles from
degenerating (Rivara 1984; Plaza and Carey 2000).
"""

import itertools
from dataclasses import dataclass, field

import numpy as np

from pcontact.element.reference import edge_nodes
from pcontact.element.shape import shape
from pcontact.mesh.groups import Block, RawMesh, facet_vertices, find_facets
from pcontact.runtime.errors import InputError

SIMPLEX = {1: "segment", 2: "triangle", 3: "tetrahedron"}


@dataclass
class Refined:
    """A mesh of triangles or tetrahedra whose cells come from those of another one.

    Attributes
    ----------
    dim, degree : int
        2 or 3; of the geometry.
    points : ndarray (n, dim)
    nodes : ndarray (n_cells, n_nodes)
        VTK order.
    parent : ndarray (n_cells,)
        Cell that it is a part of.
    place : ndarray (n_cells, dim + 1, dim + 1)
        Barycentric coordinates of its vertices there.
    groups : dict of int to (ndarray (m, n_nodes), dict of str to ndarray (m,) of bool)
        By dimension: elements, and which of them belong to a group; those of the full dimension are the cells.
    """

    dim: int
    degree: int
    points: np.ndarray
    nodes: np.ndarray
    parent: np.ndarray
    place: np.ndarray
    groups: dict = field(default_factory=dict)


class _Edges:
    """Edges of all cells: keys, their order by length, marks."""

    def __init__(self, points, cells):
        self._n, self.points = len(points), points
        pairs = np.concatenate([cells[:, list(pair)] for pair in itertools.combinations(range(cells.shape[1]), 2)])
        self.keys, first = np.unique(self.key(pairs), return_index=True)
        self.ends = np.sort(pairs[first], axis=1)
        # lengths that differ by rounding only are equal: the numbers of the ends decide, on both sides alike
        length = np.linalg.norm(points[self.ends[:, 0]] - points[self.ends[:, 1]], axis=1)
        unit = 1e-9 * max(float(length.max(initial=0.0)), 1e-300)
        self.rank = np.empty(len(self.keys), dtype=np.int64)
        self.rank[np.lexsort((self.keys, np.rint(length / unit)))] = np.arange(len(self.keys))
        self.marked = np.zeros(len(self.keys), dtype=bool)

    def key(self, pairs):
        """One number for each pair (n, 2) of vertices."""
        return pairs.min(axis=1) * self._n + pairs.max(axis=1)

    def find(self, cells):
        """Edges (nc, m) of simplices (nc, k + 1)."""
        pairs = list(itertools.combinations(range(cells.shape[1]), 2))
        return np.stack([np.searchsorted(self.keys, self.key(cells[:, list(pair)])) for pair in pairs], axis=1)

    def spread(self, simplices):
        """Mark the longest edge of simplices with a marked edge, until nothing changes."""
        tables = [self.find(cells) for cells in simplices]
        longest = [np.take_along_axis(t, self.rank[t].argmax(axis=1)[:, None], axis=1)[:, 0] for t in tables]
        while True:
            before = self.marked.sum()
            for table, edge in zip(tables, longest, strict=True):
                self.marked[edge[self.marked[table].any(axis=1)]] = True
            if self.marked.sum() == before:
                return

    def number(self):
        """Give marked edges the numbers of their new middles."""
        chosen = np.flatnonzero(self.marked)
        self.cut, self.cut_rank = self.keys[chosen], self.rank[chosen]
        self.middle = self._n + np.arange(len(chosen))

    def halve(self, cells):
        """Halve simplices (nc, k + 1) until no edge is marked.

        Returns
        -------
        cells : ndarray (m, k + 1)
        parent : ndarray (m,)
        place : ndarray (m, k + 1, k + 1)
        """
        n, k = cells.shape
        done, todo = [], (cells, np.arange(n), np.tile(np.eye(k), (n, 1, 1)))
        pairs = np.array(list(itertools.combinations(range(k), 2)))
        while len(todo[0]):
            cells, parent, place = todo
            rank = np.full((len(cells), len(pairs)), -1, dtype=np.int64)
            middle = np.zeros_like(rank)
            for column, (a, b) in enumerate(pairs):
                both = cells[:, [a, b]]
                key = np.where(both.max(axis=1) < self._n, self.key(both), -1)
                at = np.minimum(np.searchsorted(self.cut, key), max(len(self.cut) - 1, 0))
                hit = self.cut[at] == key if len(self.cut) else np.zeros(len(key), dtype=bool)
                rank[hit, column], middle[hit, column] = self.cut_rank[at[hit]], self.middle[at[hit]]
            column = rank.argmax(axis=1)
            whole = rank.max(axis=1) < 0
            done.append((cells[whole], parent[whole], place[whole]))
            rows = np.flatnonzero(~whole)
            new, ends = middle[rows, column[rows]], pairs[column[rows]]
            halves = []
            for side in range(2):
                child, where = cells[rows].copy(), place[rows].copy()
                each = np.arange(len(rows))
                where[each, ends[:, side]] = 0.5 * (where[each, ends[:, 0]] + where[each, ends[:, 1]])
                child[each, ends[:, side]] = new
                halves.append((child, parent[rows], where))
            todo = tuple(np.concatenate(parts) for parts in zip(*halves, strict=True))
        return tuple(np.concatenate(parts) for parts in zip(*done, strict=True))


def _cells(raw):
    """All cells (n, n_nodes) of one kind, and their degree."""
    kind = SIMPLEX[raw.dim]
    wrong = sorted({block.cell for block in raw.blocks} - {kind})
    if wrong:
        raise InputError(
            f"{raw.path}: found cells that cannot be halved ({', '.join(wrong)}); allowed: {kind} cells, or "
            "-geometry FILE.geo to make a new mesh"
        )
    degrees = {block.degree for block in raw.blocks}
    if len(degrees) > 1:
        raise InputError(f"{raw.path}: found cells of degree 1 and 2; allowed: cells of one degree")
    return np.concatenate([block.nodes for block in raw.blocks]), degrees.pop()


def refine(raw, marked):
    """Refine marked cells, and others as far as they have to follow.

    Parameters
    ----------
    raw : pcontact.mesh.groups.RawMesh
    marked : ndarray (n_cells,) of bool
        All edges of these cells are halved: a triangle becomes four or more, a tetrahedron eight or more.

    Returns
    -------
    Refined
        With the geometry of the mesh: cells of degree 2 stay parts of the curved ones they come from.

    Raises
    ------
    InputError
        Cells that are no simplices.
    """
    nodes, degree = _cells(raw)
    kind, d = SIMPLEX[raw.dim], raw.dim
    cells = nodes[:, : d + 1]
    edges = _Edges(raw.points, cells)
    edges.marked[edges.find(cells[marked])] = True
    faces = [cells[:, list(face)] for face in itertools.combinations(range(d + 1), 3)] if d == 3 else []
    edges.spread([*faces, cells])
    edges.number()
    new, parent, place = edges.halve(cells)
    points = np.concatenate([raw.points, np.empty((len(edges.middle), d))])
    at = shape(kind, degree, place.reshape(-1, d + 1)[:, 1:]).reshape(len(new), d + 1, -1)
    created = new >= len(raw.points)
    points[new[created]] = np.einsum("cva,cad->cvd", at, raw.points[nodes[parent]])[created]
    groups = {d: (new, {name: np.isin(parent, ids) for name, ids in raw.cell_groups.items()})}
    for dim, elements, members in _lower(raw):
        if dim > 0:
            elements, origin, _ = edges.halve(elements)
            members = {name: flags[origin] for name, flags in members.items()}
        groups[dim] = elements, members
    refined = Refined(d, degree, points, new, parent, place, groups)
    if degree == 2:
        _raise_degree(refined, raw.points[nodes[parent]])
    return _compact(refined)


def _lower(raw):
    """Elements of the groups of lower dimension: dimension, vertices (m, dim + 1), group -> flags (m,)."""
    d = raw.dim
    tables = {d - 1: {}, 1: dict(raw.edge_groups) if d == 3 else {}, 0: {}}
    for name, (ids, local) in raw.facet_groups.items():
        rows = [np.zeros((0, d), np.int64), *(vertices for _, vertices in facet_vertices(raw, ids, local))]
        tables[d - 1][name] = np.concatenate(rows)
    for name, members in raw.node_groups.items():
        if name not in raw.edge_groups:
            tables[0][name] = members[:, None]
    for dim, groups in tables.items():
        if not groups:
            continue
        every = np.concatenate(list(groups.values()))
        _, first, number = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_inverse=True)
        flags, start = {}, 0
        for name, elements in groups.items():
            flags[name] = np.zeros(len(first), dtype=bool)
            flags[name][number[start : start + len(elements)]] = True
            start += len(elements)
        yield dim, every[first], flags


def _raise_degree(refined, corners):
    """Give cells and elements of groups nodes at the middles of their edges, on the cells they come from."""
    d, n = refined.dim, len(refined.points)
    pairs = edge_nodes(SIMPLEX[d])
    cells = refined.nodes
    ends = np.sort(cells[:, pairs].reshape(-1, 2), axis=1)
    keys, first, number = np.unique(ends[:, 0] * n + ends[:, 1], return_index=True, return_inverse=True)
    middle = refined.place[:, pairs].mean(axis=2).reshape(-1, d + 1)[:, 1:]
    values = shape(SIMPLEX[d], 2, middle[first])
    refined.points = np.concatenate([refined.points, np.einsum("ea,ead->ed", values, corners[first // len(pairs)])])
    refined.nodes = np.hstack([cells, n + number.reshape(len(cells), -1)])
    for dim, (elements, flags) in list(refined.groups.items()):
        if dim == 0:
            continue
        ends = np.sort(elements[:, edge_nodes(SIMPLEX[dim])].reshape(-1, 2), axis=1)
        new = n + np.searchsorted(keys, ends[:, 0] * n + ends[:, 1])
        refined.groups[dim] = np.hstack([elements, new.reshape(len(elements), -1)]), flags


def _compact(refined):
    """Leave out points that are no nodes any more."""
    used, number = np.unique(refined.nodes, return_inverse=True)
    place = np.full(len(refined.points), -1, dtype=np.int64)
    place[used] = np.arange(len(used))
    refined.points, refined.nodes = refined.points[used], number.reshape(refined.nodes.shape)
    refined.groups = {dim: (place[elements], flags) for dim, (elements, flags) in refined.groups.items()}
    return refined


def as_raw(refined, path):
    """A refined mesh as one that has been read.

    Parameters
    ----------
    refined : Refined
    path : pathlib.Path
        For messages.

    Returns
    -------
    pcontact.mesh.groups.RawMesh
        With the numbers of cells and points that `refined` has.
    """
    d = refined.dim
    raw = RawMesh(path, d, refined.points, [Block(SIMPLEX[d], refined.degree, refined.nodes)])
    for dim, (elements, flags) in refined.groups.items():
        for name, chosen in flags.items():
            corners = elements[chosen][:, : dim + 1]
            if dim == d:
                raw.cell_groups[name] = np.flatnonzero(chosen)
            elif dim == d - 1:
                cells, local, _ = find_facets(raw.blocks, len(raw.points), corners)
                order = np.lexsort((local, cells))
                raw.facet_groups[name] = cells[order], local[order]
            else:
                raw.node_groups[name] = np.unique(elements[chosen])
                if dim == 1:
                    raw.edge_groups[name] = np.unique(np.sort(corners, axis=1), axis=0)
    return raw
