"""All cells of a mesh halved: quadrilaterals and triangles in 4, hexahedra in 8 parts, on any number of ranks.

A new node is known by the sum of the mixed numbers of the vertices of its cell, each times its bilinear (trilinear,
barycentric) shape function in steps of 1/64: those of vertices that are not on an edge or face vanish there, so the
cells that share it agree. Values that cells compute for a shared node may differ by rounding: those of the cell with
the lowest number count, on any number of ranks.
"""

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes
from pcontact.element.shape import shape
from pcontact.mesh.refinement.keys import vertex_keys
from pcontact.mesh.refinement.numbering import among, distinct, facets_of_parts, first_numbers, number_nodes
from pcontact.mesh.refinement.placing import halves_placed
from pcontact.mesh.slices import COLUMN, MeshSlice, SliceBlock, bits

HALVED = ("triangle", "quadrilateral", "hexahedron")
# steps of the shape functions of vertices: quarters of an edge in three directions
STEPS = 64


def children(cell):
    """Vertices (n_children, n_vertices, d) of the parts of a reference cell."""
    vertices = reference_nodes(cell, 1)
    if CELLS[cell].is_tensor:
        return 0.5 * (vertices[None] + vertices[:, None])
    a, b, c = vertices
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])


class _Parts:
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
        for a, b in CELLS[cell].edges:
            self.edges.append(np.flatnonzero(vertex[:, a] + vertex[:, b] > 1.0 - 1e-9))
        pairs = np.array(CELLS[cell].edges)
        pairs = (self.width * np.arange(self.count)[:, None, None] + pairs).reshape(-1, 2)
        self.pieces = [pairs[np.isin(pairs, on_it).all(axis=1)] for on_it in self.edges]

    @staticmethod
    def _facets(cell, corners):
        """By facet of the cell: part and local facet (n, 2) that lie on it."""
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
    d, ids = mesh.dim, np.concatenate([block.ids for block in mesh.blocks])
    key = np.empty(len(mesh.points), dtype=np.uint64)
    vertex_keys(mesh.file_nodes, key)
    groups = bits(list(mesh.node_groups), mesh.node_groups, len(mesh.points))
    known = np.column_stack([mesh.points, *fields])
    parts = [_Parts(block.cell, mesh.degree) for block in mesh.blocks]
    keys, numbers, owners, values, members = [], [], [], [], []
    for block, part in zip(mesh.blocks, parts, strict=True):
        nodes, n = block.nodes, len(block.nodes)
        vertices = nodes[:, : CELLS[block.cell].n_vertices]
        with np.errstate(over="ignore"):
            keys.append((key[vertices][:, None] * part.steps).sum(axis=2, dtype=np.uint64).ravel())
        numbers.append(np.where(part.old >= 0, mesh.file_nodes[nodes][:, part.old], -1).ravel())
        owners.append(np.repeat(block.ids, part.count * part.width))
        values.append(np.einsum("pn,cnk->cpk", part.values, known[nodes]).reshape(-1, known.shape[1]))
        own = np.where((part.old >= 0)[:, None], groups[nodes][:, part.old], 0)
        _join_edges(mesh, block, part, own)
        members.append(own.reshape(n * part.count * part.width, groups.shape[1]))
    keys, numbers, owners = (np.concatenate(rows) for rows in (keys, numbers, owners))
    chosen, place = distinct(keys, owners)
    values, members = np.concatenate(values)[chosen], np.concatenate(members)[chosen]
    if mesh.belongs is not None:
        values[:, :d] = halves_placed(mesh, parts, place, keys[chosen], values[:, :d])
    values = values.view(np.int64)
    rows = np.column_stack([owners[chosen], values, members])
    home, new_ids = number_nodes(exchanger, mesh, numbers[chosen], keys[chosen], rows)
    at = home.places[:, 0][place]
    tables, end = [], 0
    for block, part in zip(mesh.blocks, parts, strict=True):
        size = len(block.nodes) * part.count * part.width
        tables.append(SliceBlock(block.cell, at[end : end + size].reshape(-1, part.width)))
        end += size
    counts = np.concatenate([np.full(len(b.nodes), p.count) for b, p in zip(mesh.blocks, parts, strict=True)])
    start, n_cells = first_numbers(exchanger, mesh, ids, counts)
    row = np.repeat(np.arange(len(ids)), counts)
    begin = np.cumsum(counts) - counts
    table = home.table[:, 1:]
    points = np.ascontiguousarray(table[:, : known.shape[1]]).view(np.float64)
    piece = MeshSlice(
        mesh.comm, None, d, mesh.degree, mesh.curved, tables, start[row] + np.arange(len(row)) - begin[row],
        np.concatenate([np.full(len(b.nodes), b.body) for b in mesh.blocks])[row],
        np.concatenate([b.components for b in mesh.blocks])[row], np.ascontiguousarray(points[:, :d]), home.starts,
        home.total, n_cells, mesh.n_components, node_ids=home.numbers,
        node_values=np.ascontiguousarray(points[:, d:]).view(np.int64),
    )  # fmt: skip
    _name(mesh, piece, parts, row, begin, table[:, known.shape[1] :])
    _name_edges(mesh, piece, parts, new_ids[place])
    return piece, [np.shape(field)[1] for field in fields]


def _join_edges(mesh, block, part, own):
    """Put nodes on edges of groups into these: bits ``own`` (n_cells, n_places, m)."""
    names = list(mesh.node_groups)
    for name, edges in mesh.edge_groups.items():
        column, bit = divmod(names.index(name), COLUMN)
        for e, places in enumerate(part.edges):
            inside = _on_edge(mesh, block, e, edges)
            own[np.ix_(inside, places, [column])] |= np.int64(1) << np.int64(bit)


def _on_edge(mesh, block, e, edges):
    """Cells (n,) bool whose local edge e is one of some edges (m, 2), by the numbers of the vertices."""
    ends = mesh.file_nodes[block.nodes[:, list(CELLS[block.cell].edges[e])]]
    return among(ends, edges, mesh.n_nodes_total)


def _name_edges(mesh, piece, parts, numbers):
    """Fill the groups of edges of the slice, by the numbers of all places of nodes in all parts of cells."""
    for name, edges in mesh.edge_groups.items():
        found, first = [np.zeros((0, 2), dtype=np.int64)], 0
        for block, part in zip(mesh.blocks, parts, strict=True):
            own = numbers[first : first + len(block.nodes) * part.count * part.width]
            own = own.reshape(len(block.nodes), part.count * part.width)
            for e, pairs in enumerate(part.pieces):
                found.append(own[_on_edge(mesh, block, e, edges)][:, pairs].reshape(-1, 2))
            first += own.size
        piece.edge_groups[name] = np.concatenate(found)


def _name(mesh, piece, parts, row, begin, members):
    """Fill the groups of the slice; begin (n_cells,): first row of the parts of each cell."""
    starts = np.cumsum([0] + [len(block.nodes) for block in mesh.blocks])
    piece.name_as(mesh, row, members)
    none = np.zeros((0, 2), dtype=np.int64)
    for name, facets in mesh.facet_groups.items():
        found = [none]
        for one in facets:
            for local, on_it in enumerate(parts[one.block].facets):
                cells = begin[starts[one.block] + one.cells[one.local == local]]
                found.append(facets_of_parts(cells, on_it))
        piece.facet_groups[name] = tuple(np.concatenate(found).T)
