"""Edges in space toward which the solution is singular, told as points are in `pcontact.adapt.singularities`.

Around an edge where the displacement goes like r^a with the distance r, the squared error of the cells that touch it
falls with h^(2 a + 1), where h is their size; around others with h^(2 p + 3). Two meshes tell the power at vertices of
sharp edges of the bodies, and of edges where groups of facets end, as under the edge of a punch. Where it is low at
both ends of a piece of such an edge, the piece is singular.

Cells are as long across an edge as along it. So each halving of those that touch it doubles their number, and the cells
around them follow: `pcontact.adapt.mark` has what that costs. Pieces that meet share what the cells around them have,
as the smallest cells make their neighbours as small.

Toward edges of what is closed a contact pressure goes like the root of the distance. So the squared error of a cell
that such an edge crosses falls with h^3, where h is its size: with h^2 of all cells that it crosses, which are 1 / h
many. In the plane it is h^2 of few cells, and they become smaller than others by
themselves. In space they are cut as those on edges are toward which the displacement is singular, and those beside
them follow.

The edge lies where facets have points that are closed and others that are open: along the straight line at which the
linear function is zero that is nearest to 1 at closed points and -1 at others. Facets of the target have those of the
points whose partners are on them.
"""

import zlib
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes, shape
from pcontact.estimate.tractions import Cells, bring, source_facets
from pcontact.mesh.refinement.numbering import marks, tree_points
from pcontact.mesh.refinement.refine import Rise
from pcontact.mesh.topology import outer_facets
from pcontact.runtime.petsc import MPI

# [-] Sizes of cells of the last mesh over those of now, from which on the power is told. From: chosen;
# closures alone make cells that much smaller.
FINER = 1.5
# [-] The largest power of an edge, and the least that is taken. From: a = 1, with which cells that become smaller
# toward the edge gain nothing on others, and a = 1/2 of cracks and stiff punches; on coarse meshes squares fall less.
LARGEST, LEAST = 3.0, 2.0
# [-] Cosine of the angle between facets from which on an edge is sharp: 25 degrees. From: as in the plane, and more
# for facets whose edges are no chords.
TURN = 0.9
# [-] Part of the squared estimate that cells on edges have, from which on they explain how it has fallen; and below
# which they are not cut for it. From: chosen; a stiff cube on a block, 0.63 to 0.93, and shells with curved facets that
# no mesh follows, 0.20, where powers are low on all of the contact.
MOST, SOME = 0.5, 0.33
# [-] Power of squares whose sum tells the largest of them. From: eight of one size then are a third more.
LARGE = 8
NAME = "tetrahedron"


class Pieces(NamedTuple):
    """Pieces of singular edges, edges of cells, of all ranks.

    Attributes
    ----------
    ends : ndarray (n, 2) of int
        Numbers of the nodes that all ranks agree on.
    points : ndarray (n, 2, 3)
        [length]
    """

    ends: np.ndarray
    points: np.ndarray


class Edges(NamedTuple):
    """Relation of the cells of this rank to singular edges.

    Attributes
    ----------
    touches : ndarray (n_cells,) of int
        2: it has a piece of an edge, 1: a vertex of one, 0: nothing.
    power : ndarray (n_cells,)
        With which the squares around its vertices there fall; 2 p + 3 where it has none.
    on : ndarray (n_cells, 4) of bool
        Its vertices that are on an edge.
    rise : pcontact.mesh.refinement.refine.Rise
        Toward the edge; its limits are 0.
    """

    touches: np.ndarray
    power: np.ndarray
    on: np.ndarray
    rise: Rise

    def shared(self, space, squares):
        """Squares (n_cells,) of cells that touch edges: the mean of those that have pieces of them with a vertex in
        common; of others their own. *Collective.*"""
        vertices, sums = space_vertices(space), np.zeros((space.n_local, space.dim))
        has = self.touches == 2
        rows, corners = np.nonzero(has[:, None] & self.on)
        for column, values in enumerate((squares[rows], np.ones(len(rows)))):
            sums[:, column] = np.bincount(vertices[rows, corners], values, space.n_local)
        sums, counts, _ = space.together(sums).T
        some = self.on & (counts[vertices] > 0.0)
        means = np.where(some, sums[vertices] / np.maximum(counts[vertices], 1.0), 0.0)
        return np.where(some.any(axis=1), means.sum(axis=1) / np.maximum(some.sum(axis=1), 1), squares)


def of_tetrahedra(space):
    """Return True if all cells of a mesh are tetrahedra. *Collective.*"""
    own = {block.cell for block in space.mesh.blocks if len(block.nodes)}
    return set().union(*space.comm.allgather(own)) == {NAME}


def space_vertices(space):
    """Vertices (n_cells, 4) of all tetrahedra of this rank, among the nodes of a space."""
    return np.concatenate([np.zeros((0, 4), np.int64), *(cells[:, :4] for cells in space.cells)])


def vertices_of(mesh):
    """Vertices (n_cells, d + 1) of all simplices of this rank, block after block."""
    count = mesh.dim + 1
    return np.concatenate([np.zeros((0, count), np.int64), *(block.nodes[:, :count] for block in mesh.blocks)])


def vertex_sizes(points):
    """Lengths (n,) that go with the sizes of tetrahedra with vertices (n, 4, 3)."""
    return np.cbrt(np.abs(np.linalg.det(points[:, 1:] - points[:, :1])))


def around_vertices(space, squares):
    """What there is around the vertices of a mesh of tetrahedra, (n_nodes, 4) for all nodes of the mesh of this rank,
    from the squared estimates of its cells: the largest square, the size of cells, a mark of the node that no
    interpolation gives, and room for a power; zeros where the node is no vertex. *Collective.*"""
    mesh, vertices, sums = space.mesh, space_vertices(space), np.zeros((space.n_local, space.dim))
    volumes = vertex_sizes(mesh.points[vertices_of(mesh)]) ** 3
    # nearly the largest one: how many cells there are around a vertex differs from mesh to mesh
    highest = space.comm.allreduce(float(np.max(squares, initial=0.0)), op=MPI.MAX) or 1.0
    for column, values in enumerate(((squares / highest) ** LARGE, volumes, volumes**2)):
        sums[:, column] = np.bincount(vertices.ravel(), np.repeat(values, 4), space.n_local)
    own, volume, square = space.together(sums).T
    found, vertex = np.zeros((len(mesh.points), 4)), volume > 0.0
    rows = space.mesh_nodes[vertex]
    found[rows, 0] = highest * own[vertex] ** (1.0 / LARGE)
    found[rows, 1] = np.cbrt(square[vertex] / volume[vertex])
    found[rows, 2] = marks(mesh)[rows]
    return found


def with_middles(mesh, found):
    """Values (n_nodes, k) at vertices, and at nodes in the middles of edges the means of the ends; changed."""
    if mesh.degree == 2:
        ends = edge_nodes(NAME)
        for block in mesh.blocks:
            found[block.nodes[:, 4:10]] = found[block.nodes[:, ends]].mean(axis=2)
    return found


def powers(now, before):
    """Power (n_nodes,) with which squares around nodes have fallen where an edge may be singular, 0 where there is
    none, and whether it is a node of the last mesh, too: others may have the power of a neighbour.

    `now` and `before` (n_nodes, 4) are those of :func:`around_vertices`, on this mesh and on the last one, `before`
    interpolated, with the powers there.
    """
    told = (now[:, :2] > 0.0).all(axis=1) & (before[:, :2] > 0.0).all(axis=1)
    told[told] = before[told, 1] > FINER * now[told, 1]
    surely = now[:, 2] == before[:, 2]
    power = np.where(surely & (before[:, 3] >= LEAST), before[:, 3], 0.0)
    fallen, finer = (before[told, k] / now[told, k] for k in range(2))
    own = np.log(fallen) / np.log(finer)
    power[told] = np.where(own < LARGEST, np.clip(own, LEAST, LARGEST), 0.0)
    return power, surely


def pieces(space, power, surely):
    """Pieces of sharp edges, and of edges where groups of facets end, between nodes that have a power (n_nodes,); see
    :func:`powers`. *Collective.*"""
    mesh, rows = space.mesh, [np.zeros((0, 14))]
    groups = [np.zeros((len(block.nodes), len(CELLS[NAME].facets))) for block in mesh.blocks]
    for name, parts in mesh.facet_groups.items():
        for part in parts:
            groups[part.block][part.cells, part.local] += zlib.crc32(name.encode())
    points = tree_points(mesh)
    for facets in outer_facets(mesh, space.exchanger):
        nodes, body = mesh.facet_nodes(facets)[:, :3], mesh.blocks[facets.block].body
        x = mesh.points[nodes]
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        mark = groups[facets.block][facets.cells, facets.local] + 0.5 * body
        for one, other in ((0, 1), (1, 2), (2, 0)):
            ends = nodes[:, [one, other]]
            some = (power[ends] > 0.0).all(axis=1)
            ends = np.where(np.diff(mesh.file_nodes[ends[some]], axis=1) > 0, ends[some], ends[some][:, ::-1])
            rows.append(np.column_stack([mesh.file_nodes[ends], normal[some], mark[some], points[ends].reshape(-1, 6),
                                         surely[ends]]))  # fmt: skip
    every = np.concatenate(space.comm.allgather(np.concatenate(rows)))
    every = every[np.lexsort((every[:, 1], every[:, 0]))]
    first = np.flatnonzero((every[1:, :2] != every[:-1, :2]).any(axis=1)) + 1
    first = np.append(0, first)[: len(every)]
    count = np.diff(np.append(first, len(every)))
    one, other = every[first], every[first + np.minimum(count, 2) - 1]
    alike = (count == 2) & (np.sum(one[:, 2:5] * other[:, 2:5], axis=1) > TURN) & (one[:, 5] == other[:, 5])
    kept = one[~alike]
    # new nodes count between others: at an end of the edge they have the power of their neighbour
    while True:
        nodes, index, count = np.unique(kept[:, :2], return_inverse=True, return_counts=True)
        loose = ((count[index.reshape(-1, 2)] == 1) & (kept[:, 12:] == 0.0)).any(axis=1)
        if not loose.any():
            return Pieces(kept[:, :2].astype(np.int64), kept[:, 6:12].reshape(-1, 2, 3))
        kept = kept[~loose]


def touching(space, found, power, smooth):
    """Relation of cells to pieces of edges.

    Parameters
    ----------
    space : pcontact.space.space.Space
    found : Pieces
    power : ndarray (n_nodes,)
        Of :func:`powers`.
    smooth : ndarray (n_cells,)
        2 p + 3 of the cells.

    Returns
    -------
    Edges
    """
    mesh, vertices = space.mesh, vertices_of(space.mesh)
    nodes, index = np.unique(found.ends, return_inverse=True)
    index = index.reshape(-1, 2)
    order = np.argsort(mesh.file_nodes)
    at = np.full(len(mesh.points), -1, dtype=np.int64)
    place = np.searchsorted(nodes, mesh.file_nodes[order])
    same = place < len(nodes)
    same[same] = nodes[place[same]] == mesh.file_nodes[order[same]]
    at[order[same]] = place[same]
    of_cell = at[vertices]
    on = of_cell >= 0
    toward, along = np.zeros((len(vertices), 3)), np.zeros((len(vertices), 3))
    touches = on.any(axis=1).astype(np.int64)
    rows = np.flatnonzero(touches)
    toward[rows] = tree_points(mesh)[vertices[rows, on[rows].argmax(axis=1)]]
    codes = index.min(axis=1) * len(nodes) + index.max(axis=1)
    by_code = np.argsort(codes)
    for one, other in edge_nodes(NAME)[::-1]:
        rows = np.flatnonzero(on[:, one] & on[:, other])
        low, high = np.sort(of_cell[rows][:, [one, other]], axis=1).T
        place = np.searchsorted(codes[by_code], low * len(nodes) + high)
        same = place < len(codes)
        same[same] = codes[by_code[place[same]]] == (low * len(nodes) + high)[same]
        rows, which = rows[same], by_code[place[same]]
        touches[rows] = 2
        toward[rows] = found.points[which, 0]
        along[rows] = found.points[which, 1] - found.points[which, 0]
    count = np.maximum(on.sum(axis=1), 1)
    own = np.where(touches > 0, np.where(on, power[vertices], 0.0).sum(axis=1) / count, smooth)
    rise = Rise(np.where(touches > 0, space.dim * (1.0 - own / smooth), 0.0), toward, along,
                vertex_sizes(tree_points(mesh)[vertices]), np.zeros(len(vertices)))  # fmt: skip
    return Edges(touches, own, on, rise)


def look(space, squares, before, smooth):
    """Edges as a mesh of tetrahedra tells them, from squared estimates of cells, what the last mesh has told (n_nodes,
    4), interpolated, or None, and 2 p + 3 of the cells. *Collective.*

    Returns :class:`Edges` or None, what is to be interpolated for the next mesh, and whether cells on edges have most
    of the squared estimate.
    """
    now, edges, most = around_vertices(space, squares), None, False
    if before is not None:
        power, surely = powers(now, before)
        some = space.comm.allreduce(bool((power > 0.0).any()), op=MPI.LOR)
        found = pieces(space, power, surely) if some else None
        if found is not None and len(found.ends):
            edges = touching(space, found, power, smooth)
            on = np.isin(space.mesh.file_nodes, found.ends)
            now[on, 3] = power[on]
            own = np.array([squares[edges.touches > 0].sum(), squares.sum()])
            have, total = space.comm.allreduce(own, op=MPI.SUM)
            most, edges = bool(have >= MOST * total), edges if have >= SOME * total else None
    return edges, with_middles(space.mesh, now), most


# [-] Power of the squared error of a pressure that goes like the root of the distance to an edge. From: above; Hertz's
# ball, 3.1.
POWER = 3.0


class Front(NamedTuple):
    """Cells of this rank that the edge crosses.

    Attributes
    ----------
    cells, local : ndarray (n,) of int
        The cells, counted block after block, and their facets.
    ends : ndarray (n, 2, 3)
        Ends of the edge in the facet, barycentric; the same where it is a point.
    squares : ndarray (n_cells,) or None
        That all cells are cut for.
    """

    cells: np.ndarray
    local: np.ndarray
    ends: np.ndarray
    squares: np.ndarray | None = None


def front_of(space, contact, u, squares):
    """The edges of what is closed of a contact on tetrahedra. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.contact.report.ContactReport
    u : PETSc.Vec
    squares : ndarray (n_cells,)

    Returns
    -------
    Front or None
        None where there are other cells.
    """
    if not of_tetrahedra(space):
        return None
    found = [(*np.zeros((2, 0), np.int64), np.zeros((0, 2, 3)))]
    cells = Cells(space, sorted({pair.contact.target for pair in contact.pairs if not pair.rigid}))
    first = np.cumsum([0] + [len(block.nodes) for block in space.mesh.blocks])
    for pair, state in zip(contact.pairs, contact.states(u), strict=True):
        closed, weight, paired = state["pressure"] > 0.0, state["weight"], np.flatnonzero(pair.pairing.paired)
        place = source_facets(space, pair.contact.source)[pair.source.facet]
        points = place[:, 0], place[:, 1], place[:, 2], pair.source.x, closed, weight
        found.append(_crossed(space.mesh, first, points))
        if pair.rigid:
            continue
        table = np.column_stack([closed, weight])[paired]
        for number, one in bring(space, pair, cells, paired, table).items():
            block = space.mesh.blocks[number]
            nodes, degree = space.mesh.geometry_nodes(block)
            x = np.einsum("pa,pad->pd", shape(block.cell, degree, one.xi), space.mesh.points[nodes[one.rows]])
            blocks = np.full(len(one.rows), number)
            points = blocks, one.rows, one.local, x, one.table[:, 0] > 0.5, one.table[:, 1]
            found.append(_crossed(space.mesh, first, points))
    return Front(*(np.concatenate(parts) for parts in zip(*found, strict=True)), squares)


def _crossed(mesh, first, points):
    """Cells, facets in them and ends of the edge, as of :class:`Front`, of the facets that have some points. `first`:
    cells before those of a block; `points`: block, cell, local facet of each (n,), place (n, 3), whether it is closed,
    and area."""
    block, cell, local, x, closed, weight = points
    table, index = np.unique(np.column_stack([block, cell, local]).astype(np.int64), axis=0, return_inverse=True)
    index = index.ravel()
    sums = [np.bincount(index, weight * some, minlength=len(table)) for some in (closed, ~closed)]
    crossed = (sums[0] > 0.0) & (sums[1] > 0.0)
    some = crossed[index]
    facet, table = (np.cumsum(crossed) - 1)[index[some]], table[crossed]
    corners = np.array([facet[:3] for facet in CELLS[NAME].facets])[table[:, 2]]
    nodes = np.zeros((len(table), 3), dtype=np.int64)
    for number in np.unique(table[:, 0]):
        rows = table[:, 0] == number
        nodes[rows] = mesh.blocks[number].nodes[table[rows, 1][:, None], corners[rows]]
    values = at_corners(facet, mesh.points[nodes], x[some], np.where(closed, 1.0, -1.0)[some], weight[some])
    return first[table[:, 0]] + table[:, 1], table[:, 2], zero_line(values)


def at_corners(facet, corners, x, values, weight):
    """Values (nf, 3) at the corners (nf, 3, 3) of triangles of the linear functions that are nearest to values (n,) at
    points `x` (n, 3) with weights (n,), each of a facet."""
    sides = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.pinv(sides.transpose(0, 2, 1))
    at = np.einsum("pkd,pd->pk", inverse[facet], x - corners[facet, 0])
    terms, count = np.column_stack([1.0 - at.sum(axis=1), at]), len(corners)
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, facet, weight[:, None, None] * terms[:, :, None] * terms[:, None, :])
    np.add.at(right, facet, (weight * values)[:, None] * terms)
    # few points have the smallest function
    return np.einsum("fij,fj->fi", np.linalg.pinv(matrix, hermitian=True), right)


def zero_line(values):
    """Barycentric ends (n, 2, 3) of where linear functions with values (n, 3) at the corners of triangles are zero; the
    corner with the smallest value, twice, where they are not."""
    ends = np.repeat(np.eye(3)[np.abs(values).argmin(axis=1)][:, None], 2, axis=1)
    positive = values > 0.0
    # the corner that stands alone, and the sides that meet there
    alone = np.where(positive.sum(axis=1) == 1, positive.argmax(axis=1), (~positive).argmax(axis=1))
    rows = np.flatnonzero(positive.any(axis=1) & ~positive.all(axis=1))
    for k in range(2):
        one, other = alone[rows], (alone[rows] + 1 + k) % 3
        part = values[rows, one] / (values[rows, one] - values[rows, other])
        ends[rows, k] = 0.0
        ends[rows, k, one], ends[rows, k, other] = 1.0 - part, part
    return ends


def look_at_front(space, front, smooth):
    """Relation of cells (2 p + 3 of each in `smooth`) to a :class:`Front`; None where there is none, or where it has
    little of the squares. *Collective.*"""
    vertices = vertices_of(space.mesh)
    corners = np.array([facet[:3] for facet in CELLS[NAME].facets])[front.local]
    own = space_vertices(space)
    on = space.flag(np.unique(own[front.cells[:, None], corners]))[own]
    touches = on.any(axis=1).astype(np.int64)
    touches[front.cells] = 2
    have = np.array([front.squares[touches > 0].sum(), front.squares.sum()])
    have, total = space.comm.allreduce(have, op=MPI.SUM)
    if not 0.0 < SOME * total <= have:
        return None
    points = tree_points(space.mesh)
    toward, along = np.zeros((2, len(vertices), 3))
    rows = np.flatnonzero(touches == 1)
    toward[rows] = points[vertices[rows, on[rows].argmax(axis=1)]]
    ends = np.matmul(front.ends, points[vertices[front.cells[:, None], corners]])
    toward[front.cells], along[front.cells] = ends[:, 0], ends[:, 1] - ends[:, 0]
    power = np.where(touches > 0, POWER, smooth)
    rise = Rise(space.dim * (1.0 - power / smooth), toward, along, vertex_sizes(points[vertices]),
                np.zeros(len(vertices)))  # fmt: skip
    return Edges(touches, power, on, rise)
