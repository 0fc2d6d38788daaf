"""Edges of what is closed, in space: toward them a contact pressure goes like the root of the distance.

So the squared error of a cell that such an edge crosses falls with h^3, where h is its size: with h^2 of all cells that
it crosses, which are 1 / h many. In the plane it is h^2 of few cells, and they become smaller than others by
themselves. In space they are cut as those on edges are toward which the displacement is singular, see
`pcontact.adapt.edges`, and those beside them follow.

The edge lies where facets have points that are closed and others that are open: along the straight line at which the
linear function is zero that is nearest to 1 at closed points and -1 at others. Facets of the target have those of the
points whose partners are on them.
"""

from typing import NamedTuple

import numpy as np

from pcontact.adapt.edges import NAME, Edges, of_tetrahedra, space_vertices, vertex_sizes, vertices_of
from pcontact.element.reference import CELLS
from pcontact.element.shape import shape
from pcontact.estimate.tractions import Cells, bring, source_facets
from pcontact.mesh.refinement.numbering import tree_points
from pcontact.mesh.refinement.refine import Rise
from pcontact.runtime.petsc import MPI

# [-] Power of the squared error of a pressure that goes like the root of the distance to an edge. From: above; Hertz's
# ball, 3.1.
POWER = 3.0
# [-] Part of the squares that cells have at the edge, from which on they are cut for it. From: as `edges.SOME`.
SOME = 0.33


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
    """Cells, facets in them and ends of the edge, as of :class:`Front`, of the facets that have some points.

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    first : ndarray (n_blocks + 1,)
        Cells before those of a block.
    points : tuple of ndarray
        Block, cell, local facet of each (n,), place (n, 3), whether it is closed, and area.
    """
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
    """Values (nf, 3) at the corners of triangles of the linear functions that are nearest to values at points.

    Parameters
    ----------
    facet : ndarray (n,) of int
        Triangle of each point.
    corners : ndarray (nf, 3, 3)
        [length]
    x, values, weight : ndarray (n, 3), (n,), (n,)
    """
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


def look(space, front, smooth):
    """What cells have to do with the edge of what is closed. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of tetrahedra.
    front : Front
    smooth : ndarray (n_cells,)
        2 p + 3 of the cells.

    Returns
    -------
    pcontact.adapt.edges.Edges or None
        None where there is none, or where it has little of the squares.
    """
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
