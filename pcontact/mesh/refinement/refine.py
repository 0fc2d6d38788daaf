"""From a mesh and what is wanted of its cells to a finer or coarser one, with fields, spread over the ranks anew.

All cells of a mesh halved: quadrilaterals and triangles in 4, hexahedra in 8 parts, on any number of ranks.

A new node is known by the sum of the mixed numbers of the vertices of its cell, each times its bilinear (trilinear,
barycentric) shape function in steps of 1/64: those of vertices that are not on an edge or face vanish there, so the
cells that share it agree. Values that cells compute for a shared node may differ by rounding: those of the cell with
the lowest number count, on any number of ranks.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes, shape
from pcontact.mesh.distribute import deal
from pcontact.mesh.geometry.belonging import belonging
from pcontact.mesh.geometry.moving import halves_placed, placed
from pcontact.mesh.mesh import Mesh, mixed
from pcontact.mesh.partition import WEIGHT
from pcontact.mesh.refinement.numbering import (
    Neighbours,
    Origin,
    Part,
    first_numbers,
    first_origin,
    number_nodes,
    sliced,
    to_base,
    values_by_key,
)
from pcontact.mesh.refinement.simplices import BASE, LINEAR, WISHED, Forest, Wishes, interpolate, opposite
from pcontact.mesh.slices import COLUMN, MeshSlice, SliceBlock, bits, has_bit
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import Exchanger, rows_of, together
from pcontact.runtime.petsc import MPI

HALVED = ("triangle", "quadrilateral", "hexahedron")
# steps of the shape functions of vertices: quarters of an edge in three directions
STEPS = 64
SIMPLICES = ("triangle", "tetrahedron")


def children(cell):
    """Vertices (n_children, n_vertices, d) of the parts of a reference cell."""
    vertices = reference_nodes(cell, 1)
    if CELLS[cell].is_tensor:
        return 0.5 * (vertices[None] + vertices[:, None])
    a, b, c = vertices
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])


class _Halves:
    """The parts of the cells of a kind: where their nodes are, and which facets and edges of the cell they have."""

    def __init__(self, cell, degree):
        corners = children(cell)
        at = np.einsum("nv,cvd->cnd", shape(cell, 1, reference_nodes(cell, degree)), corners)
        self.count, self.width = at.shape[:2]
        flat = at.reshape(-1, at.shape[2])
        self.values = shape(cell, degree, flat)
        vertex = shape(cell, 1, flat)
        self.steps = np.rint(STEPS * vertex).astype(np.int64).astype(np.uint64)
        # node of the cell in the same place, or -1
        same = np.abs(self.values - 1.0) < 1e-9
        self.old = np.where(same.any(axis=1), same.argmax(axis=1), -1)
        self.facets, self.edges = self._facets(cell, corners), []
        pairs = (self.width * np.arange(self.count)[:, None, None] + np.array(CELLS[cell].edges)).reshape(-1, 2)
        for edge in CELLS[cell].edges:
            on_it = np.flatnonzero(vertex[:, list(edge)].sum(axis=1) > 1.0 - 1e-9)
            self.edges.append((edge, on_it, pairs[np.isin(pairs, on_it).all(axis=1)]))

    @staticmethod
    def _facets(cell, corners):
        """Return by facet of the cell part and local facet (n, 2) that lie on it."""
        weights = [shape(cell, 1, corners[:, list(f)].mean(axis=1)) for f in CELLS[cell].facets]
        result = []
        for facet in CELLS[cell].facets:
            rows = [np.argwhere(w[:, list(facet)].sum(axis=1) > 1.0 - 1e-9) for w in weights]
            result.append(np.concatenate([np.insert(r, 1, k, axis=1) for k, r in enumerate(rows)]))
        return result


def halved(exchanger, mesh, fields):
    """A mesh whose cells are halved, in slices whose nodes have the values of fields; and the widths of these.
    *Collective.*

    Parameters
    ----------
    exchanger : pcontact.runtime.parallel.Exchanger
    mesh : pcontact.mesh.mesh.Mesh
        Of cells in `HALVED`.
    fields : sequence of ndarray (n_nodes, k)

    Returns
    -------
    pcontact.mesh.slices.MeshSlice, list of int
    """
    known, key = np.column_stack([mesh.points, *fields]), mixed(mesh.file_nodes)
    kinds, parts = [_Halves(block.cell, mesh.degree) for block in mesh.blocks], []
    for number, (block, kind) in enumerate(zip(mesh.blocks, kinds, strict=True)):
        vertices = key[block.nodes[:, : CELLS[block.cell].n_vertices]]
        keys = (vertices[:, None] * kind.steps).sum(axis=2, dtype=np.uint64)
        values = np.einsum("pn,cnk->cpk", kind.values, known[block.nodes])
        table = np.arange(kind.count * kind.width).reshape(kind.count, kind.width)
        rows = np.arange(len(block.nodes))
        parts.append(Part(number, rows, table, kind.facets, kind.edges, kind.old, values, keys))
    move = None if mesh.belongs is None else partial(halves_placed, mesh, kinds)
    layout = [(block.cell, kind.width) for block, kind in zip(mesh.blocks, kinds, strict=True)]
    piece = sliced(exchanger, mesh, parts, layout, mesh.degree, known.shape[1], move)
    return piece, [np.shape(field)[1] for field in fields]


class Balance(NamedTuple):
    """Balance by which the new mesh is spread over the ranks, see :func:`pcontact.mesh.partition.partition`.

    Attributes
    ----------
    pairs : list of (str, str or None, float or None)
    weight : float
    method : str
    """

    pairs: list = ()
    weight: float = WEIGHT
    method: str = "bisection"


class Refined(NamedTuple):
    """A refined mesh.

    Attributes
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    fields : list of ndarray (n_nodes, k)
        Values at its nodes on this rank.
    """

    mesh: Mesh
    fields: list


def refine(mesh, more, fields=(), balance=None):
    """Cut cells that are wanted smaller and join those that are wanted larger. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        Of a file, or refined.
    more : ndarray (n_cells,) int
        By how many cuts the cells of this rank, all blocks one after the other, are to be smaller: one halves a cell,
        ``mesh.dim`` halve its edges; up to `WISHED` of a cell of the file. Below zero: it may be larger by so many.
        Cells become larger where all those wish it that come from the same one.
    fields : sequence of ndarray (n_nodes, k) float64
        Values at the nodes of this rank, interpolated with the shape functions of the layout of the nodes.
    balance : Balance, optional

    Returns
    -------
    Refined
        The same on any number of ranks, but for the spread of the cells.

    Raises
    ------
    InputError
    """
    exchanger = Exchanger(mesh.comm)
    try:
        with profile.phase("distribute"):
            more, origin = np.asarray(more, dtype=np.int64), mesh.origin or first_origin(mesh)
            regular = any(block.cell not in SIMPLICES for block in origin.base.blocks)
            if regular:
                _check_kinds(mesh)
                if mesh.comm.allreduce(int(more.max(initial=0)), op=MPI.MAX) <= 0:
                    return Refined(mesh, [np.array(field, dtype=float) for field in fields])
                piece, widths = halved(exchanger, mesh, fields)
            else:
                piece, widths = _grown(exchanger, mesh, origin, more, fields)
            new = deal(piece, *(balance or Balance()))
            if regular and mesh.belongs is not None:
                new.belongs = belonging(new, mesh.belongs.path, mesh.belongs.scene, strict=False)
    finally:
        exchanger.free()
    return carried_over(new, mesh, None if regular else origin.base, widths)


def _check_kinds(mesh):
    wrong = sorted({block.cell for block in mesh.blocks} - set(HALVED))
    if wrong:
        raise InputError(
            f"found cells that cannot be cut ({', '.join(wrong)}); allowed: meshes of {', '.join(SIMPLICES)} or of "
            f"{', '.join(HALVED)} cells"
        )


def carried_over(new, mesh, base, widths):
    """The new mesh with its origin and names, and its fields."""
    new.component_names = list(mesh.component_names)
    new.n_components = mesh.n_components
    first = 0
    if base is not None:
        first = 1
        cells, keys = new.cell_values, new.node_values[:, 0].copy().view(np.uint64)
        new.origin = Origin(base, cells[:, 0].copy(), cells[:, 1].copy().view(np.uint64), cells[:, 2].copy(), keys)
    values = np.ascontiguousarray(new.node_values[:, first:]).view(np.float64)
    parts = [part.copy() for part in np.split(values, np.cumsum(widths)[:-1], axis=1)] if widths else []
    new.cell_values = new.node_values = None
    return Refined(new, parts)


def _grown(exchanger, mesh, origin, more, fields):
    """The new mesh in slices, and the widths of the fields that go with its nodes. *Collective.*"""
    base = origin.base
    kinds = {block.cell for block in base.blocks}
    wishes, spans = _wishes(exchanger, mesh, origin, more)
    columns = bits(base.node_groups, len(base.points))
    forest = Forest(base, kinds.pop(), columns, _edges(base))
    forest.cells.wishes[: len(spans)] = spans
    facets = _mark_facets(base, forest)
    _close(exchanger, base, forest, wishes)
    widths = [np.shape(field)[1] for field in fields]
    values, points = _carried(exchanger, mesh, origin, forest, fields), forest.nodes.points[: forest.n_nodes]
    if base.belongs is not None:
        points = placed(base, forest)
    return _sliced(exchanger, base, forest, facets, points, values), widths


def _wishes(exchanger, mesh, origin, more):
    """Wishes for the cells of the base here, sorted, and first and last + 1 of each of its cells (n, 2).
    *Collective.*"""
    base = origin.base
    n = sum(len(block.nodes) for block in base.blocks)
    wanted = np.clip(origin.level + more, 0, WISHED)
    table = np.column_stack([origin.path.view(np.int64), origin.level, wanted])
    rows = np.arange(n)
    if mesh is not base:
        rows, table = to_base(exchanger, base, origin.cells, table)
    path = np.ascontiguousarray(table[:, 0]).view(np.uint64)
    order = np.lexsort((path, rows))
    ends = np.searchsorted(rows[order], np.arange(n + 1))
    wishes = Wishes(path[order], table[order, 1].astype(np.int32), table[order, 2].astype(np.int32))
    return wishes, np.column_stack([ends[:-1], ends[1:]])


def _edges(base):
    """Edges of groups: local vertices (n, 2), and the column and bit of the group among those of nodes."""
    result = []
    for k, name in enumerate(base.node_groups):
        edges = base.edge_groups.get(name, np.zeros((0, 2), dtype=np.int64))
        if len(edges):
            result.append((rows_of(base.file_nodes, edges), *divmod(k, COLUMN)))
    return result


def _mark_facets(base, forest):
    """Number the facets of the base that are in groups, for the cells that have them; bits (n, m) of the groups."""
    starts = base.starts
    local_vertex = np.argsort(opposite(forest.cell))
    d1 = len(local_vertex)
    places = {}
    for name, parts in base.facet_groups.items():
        rows = [(starts[part.block] + part.cells) * d1 + local_vertex[part.local] for part in parts]
        places[name] = np.concatenate([np.zeros(0, dtype=np.int64), *rows])
    every = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *places.values()]))
    forest.cells.facets[every // d1, every % d1] = np.arange(len(every))
    return bits({name: np.searchsorted(every, rows) for name, rows in places.items()}, len(every))


def _close(exchanger, base, forest, wishes):
    """Cut what is due on all ranks. *Collective.*"""
    neighbours = Neighbours(exchanger, base.file_nodes, base.n_nodes_total)
    forest.share(neighbours.shared)
    news = True
    while news:
        told = together(base.comm, forest.grow, wishes)
        nodes, news = forest.nodes, 0
        if exchanger.comm.size > 1:
            ends = nodes.shared[told]
            news = base.comm.allreduce(forest.take_in(neighbours.tell(nodes.key[told], ends)))


def _carried(exchanger, mesh, origin, forest, fields):
    """Values (n, k) float64 of all fields at all nodes of the forest. *Collective.*"""
    n, nodes = forest.n_nodes, forest.nodes
    width = sum(np.shape(field)[1] for field in fields)
    values = np.zeros((n, width))
    if not width:
        return values
    old = np.ascontiguousarray(np.column_stack(fields), dtype=np.float64)
    known = np.zeros(n, dtype=bool)
    if mesh is origin.base:
        known[: forest.base_nodes], values[: forest.base_nodes] = True, old
    else:
        known[:], found = values_by_key(exchanger, origin.keys, old.view(np.int64), nodes.key[:n])
        values[:] = np.ascontiguousarray(found).view(np.float64)
    # the values of nodes of degree 1 are those between the ends of the edges in whose middles they are
    kind = np.full_like(nodes.kind, BASE) if forest.rule == LINEAR else nodes.kind
    interpolate(np.flatnonzero(~known), kind, nodes.parents, values)
    return values


def _sliced(exchanger, base, forest, facet_bits, points, values):
    """The forest's cells as slices of a mesh. *Collective.*"""
    n, nodes = forest.n_nodes, forest.nodes
    cells = [array[: forest.n_cells] for array in forest.cells]
    order = np.lexsort((cells[3], cells[2]))
    vertices, middles, row, path, level, facets, _ = (array[order] for array in cells)
    table = vertices if base.degree == 1 else np.column_stack([vertices, middles])
    used = np.zeros(n, dtype=bool)
    used[table.ravel()] = True
    chosen = np.flatnonzero(used)
    numbers = np.where(chosen < forest.base_nodes, 0, -1)
    numbers[numbers == 0] = base.file_nodes[chosen[numbers == 0]]
    keys = nodes.key[chosen]
    d, width = base.dim, nodes.groups.shape[1]
    rows = np.column_stack([points[chosen].view(np.int64), nodes.groups[chosen], keys.view(np.int64),
                            values[chosen].view(np.int64)])  # fmt: skip
    home, new_ids = number_nodes(exchanger, base, numbers, keys, rows)
    at = np.full(n, -1, dtype=np.int64)
    at[chosen] = home.places[:, 0]
    number_of = np.full(n, -1, dtype=np.int64)
    number_of[chosen] = new_ids
    base_ids = base.of_cells("ids")
    counts = np.bincount(row, minlength=len(base_ids))
    first, n_cells = first_numbers(exchanger, base, base_ids, counts)
    ids = first[row] + np.arange(len(row)) - (np.cumsum(counts) - counts)[row]
    ends = np.searchsorted(row, base.starts)
    points = np.ascontiguousarray(home.table[:, :d]).view(np.float64)
    node_bits = home.table[:, d : d + width]
    piece = MeshSlice(
        base.comm, None, d, base.degree, base.curved,
        [SliceBlock(block.cell, at[table[a:b]]) for block, a, b in zip(base.blocks, ends[:-1], ends[1:], strict=True)],
        ids, base.of_cells("body")[row], base.of_cells("components")[row], points, home.starts, home.total, n_cells,
        base.n_components, node_ids=home.numbers,
        cell_values=np.column_stack([base_ids[row], path.view(np.int64), level]),
        node_values=np.ascontiguousarray(home.table[:, d + width :]),
    )  # fmt: skip
    piece.name_as(base, row, node_bits)
    where, vertex = np.nonzero(facets >= 0)
    of_base, local = facets[where, vertex], opposite(forest.cell)[vertex]
    for k, name in enumerate(base.facet_groups):
        inside = has_bit(facet_bits, k)[of_base]
        piece.facet_groups[name] = where[inside], local[inside]
    piece.edge_groups = _edge_groups(base, forest, vertices, middles, number_of)
    return piece


def _edge_groups(base, forest, vertices, middles, number_of):
    """Edges of groups by the numbers of their vertices."""
    result, names = {}, list(base.node_groups)
    for name in base.edge_groups:
        inside = has_bit(forest.nodes.groups, names.index(name))[middles]
        row, edge = np.nonzero(inside)
        ends = np.take_along_axis(vertices[row], forest.edges[edge], axis=1)
        result[name] = number_of[ends]
    return result
