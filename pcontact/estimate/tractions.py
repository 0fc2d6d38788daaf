"""Contact tractions as forces at points of cells: on the source where they are integrated, and on the target.

Areas that forces of contact act on are those of the bodies as they are given, as the strains are small ones, but
partners are those of surfaces that have moved: where one body is stretched along the surface more than the other, or
where round surfaces are pressed flat, a force acts on another area of the target than of the source. The partners
themselves tell it: on a facet of the source their places are taken as a linear function of those of its points.
"""

from dataclasses import dataclass

import numpy as np

from pcontact.contact.surface.sides import FACETS
from pcontact.element.geometry import facet_geometry
from pcontact.element.reference import CELLS, facet_nodes, facet_points, reference_nodes
from pcontact.estimate.facets import facet_rule
from pcontact.runtime.parallel import split_by_rank


def areas(space, pair, some, weight):
    """Area of the target over that of the source at some points of a pair, which have partners, from the areas of all
    points on the source; 1 where those of a facet do not tell. *Collective.*"""
    pairing, source = pair.pairing, pair.source
    places = space.vector()
    places.setArray(space.points[space.owned_local].ravel())
    nodes = pairing.exchange.gather(places)[pairing.targets]
    places.destroy()
    x, y = source.x[some], np.einsum("pa,pad->pd", pairing.target_shape[some], nodes[some])
    facets, facet = np.unique(source.facet[some], return_inverse=True)
    ratio = stretched(facet, len(facets), weight[some], x, y)[facet]
    return ratio * y[:, 0] / x[:, 0] if space.axisymmetric else ratio


def stretched(facet, count, weight, x, y):
    """Areas (count,) of what becomes of facets, over their own: of the linear function of their points that is nearest;
    1 where points do not tell. Points `x` (n, d), with weights, of facets (n,), become `y`."""
    d = x.shape[1]
    whole = np.bincount(facet, weight, minlength=count)
    middle = [np.stack([np.bincount(facet, weight * row, minlength=count) for row in some.T], axis=1) / whole[:, None]
              for some in (x, y)]  # fmt: skip
    x, y = x - middle[0][facet], y - middle[1][facet]
    own, both = np.zeros((2, count, d, d))
    np.add.at(own, facet, weight[:, None, None] * x[:, :, None] * x[:, None, :])
    np.add.at(both, facet, weight[:, None, None] * y[:, :, None] * x[:, None, :])
    # directions in which points are spread, the last ones most: along the facet
    spread, along = np.linalg.eigh(own)
    spread, along = spread[:, 1:], along[:, :, 1:]
    # points on a line tell no area
    told = spread[:, 0] > np.sqrt(np.finfo(float).eps) * spread[:, -1]
    slopes = np.matmul(both, along) / np.where(told[:, None], spread, 1.0)[:, None, :]
    squares = np.matmul(slopes.transpose(0, 2, 1), slopes)
    area = np.sqrt(np.maximum(np.linalg.det(squares), 0.0))
    return np.where(told & (area > 0.0), area, 1.0)


# least part of a facet that has partners, for it to be taken as covered
COVERED = 0.7


@dataclass
class PointForces:
    """Forces at points of one block's cells.

    Attributes
    ----------
    rows : ndarray (n,)
        Cells.
    xi : ndarray (n, d)
        Reference coordinates.
    force, normal : ndarray (n, d)
        [force], and the direction of contact.
    """

    rows: np.ndarray
    xi: np.ndarray
    force: np.ndarray
    normal: np.ndarray


def source_facets(space, name):
    """Block, cell and local number (n, 3) of the facets of a group, in the order of a source surface."""
    parts = [
        np.column_stack([np.full(len(f.cells), f.block), f.cells, f.local])
        for f in space.mesh.facet_groups.get(name, [])
    ]
    return np.concatenate([np.zeros((0, 3), np.int64), *parts])


def source_points(space, pair):
    """Places of the points of the source of a pair.

    Returns
    -------
    dict of int to (ndarray (n,), ndarray (n,), ndarray (n, d))
        By block: numbers of points, their cells, and their reference coordinates there.
    """
    source, result = pair.source, {}
    place = source_facets(space, pair.contact.source)[source.facet]
    for number in np.unique(place[:, 0]):
        points = np.flatnonzero(place[:, 0] == number)
        rows = place[points, 1]
        reference = reference_nodes(space.mesh.blocks[number].cell, space.degree)
        # columns of the source may be some nodes of the cell only, in any order
        own = space.cells[number][rows][:, :, None] == source.cells[source.facet[points]][:, None, :]
        xi = np.einsum("pa,pad->pd", source.shape[points], reference[np.argmax(own, axis=1)])
        result[int(number)] = points, rows, xi
    return result


def on_source(space, pair, state):
    """Forces of a pair in a state on its source: a dict of :class:`PointForces` by block."""
    result = {}
    for number, (p, rows, xi) in source_points(space, pair).items():
        force = state["traction"][p, : space.dim] * state["weight"][p, None]
        result[number] = PointForces(rows, xi, force, pair.source.normal[p])
    return result


class Cells:
    """Places of cells: on which rank, and where there.

    Parameters
    ----------
    space : pcontact.space.space.Space
    names : sequence of str
        Facet groups whose parent cells may be asked for.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, names):
        self.space = space
        facets = np.concatenate([np.zeros((0, 3), np.int64), *(source_facets(space, name) for name in names)])
        place = np.unique(facets[:, :2], axis=0)
        ids = np.array([space.mesh.blocks[b].ids[c] for b, c in place], dtype=np.int64)
        order = np.argsort(ids)
        self._ids, self._place = ids[order], place[order]
        if space.comm.size == 1:
            return
        sends, _ = split_by_rank(self._home(self._ids), self._ids)
        told = space.exchanger(sends, np.int64, 1)
        ids = np.concatenate([np.zeros(0, np.int64), *(t.ravel() for t in told.values())])
        ranks = np.concatenate([np.zeros(0, np.int64), *(np.full(len(t), r) for r, t in told.items())])
        order = np.argsort(ids)
        self._known, self._rank = ids[order], ranks[order]

    def _home(self, ids):
        return ids * self.space.comm.size // self.space.mesh.n_cells_total

    def deliver(self, ids, table):
        """Block and row (m, 2) of cells here, and rows of a table (n, k) that are brought to the ranks that have the
        cells (n,). *Collective.*"""
        space = self.space
        if space.comm.size > 1:
            width = table.shape[1] + 1
            rows = np.column_stack([ids, table])
            sends, _ = split_by_rank(self._home(ids), rows)
            rows = np.concatenate([np.zeros((0, width)), *space.exchanger(sends, np.float64, width).values()])
            owner = self._rank[np.searchsorted(self._known, rows[:, 0].astype(np.int64))]
            sends, _ = split_by_rank(owner, rows)
            rows = np.concatenate([np.zeros((0, width)), *space.exchanger(sends, np.float64, width).values()])
            ids, table = rows[:, 0].astype(np.int64), rows[:, 1:]
        return self._place[np.searchsorted(self._ids, ids)], table


@dataclass
class Brought:
    """Message of the points of a source to the cells of one block in which their partners are.

    Attributes
    ----------
    rows, local : ndarray (n,)
        Cells, and facets in them.
    shape : ndarray (n, k)
        Shape functions of the facet's nodes at the partner.
    xi : ndarray (n, d)
        Its reference coordinates in the cell.
    table : ndarray (n, m)
        What is told.
    """

    rows: np.ndarray
    local: np.ndarray
    shape: np.ndarray
    xi: np.ndarray
    table: np.ndarray


def bring(space, pair, cells, points, table):
    """Bring a row of a table (n, m) of each of some points (n,) of a source, which have partners, to the cell of its
    partner: a dict of :class:`Brought` by block. *Collective.*"""
    p, width, result = pair.pairing, 3 if space.dim == 2 else 9, {}
    shape = np.zeros((len(points), width))
    shape[:, : p.target_shape.shape[1]] = p.target_shape[points]
    ids = p.ids[points]
    place, rows = cells.deliver(ids // FACETS, np.column_stack([ids % FACETS, shape, table]))
    local = rows[:, 0].astype(np.int64)
    for number in np.unique(place[:, 0]):
        n, kind = np.flatnonzero(place[:, 0] == number), space.mesh.blocks[number].cell
        nodes = facet_nodes(kind, space.degree)[local[n]]
        at = rows[n, 1 : 1 + nodes.shape[1]]
        xi = np.einsum("pa,pad->pd", at, reference_nodes(kind, space.degree)[nodes])
        result[int(number)] = Brought(place[n, 1], local[n], at, xi, rows[n, 1 + width :])
    return result


def on_target(space, pair, state, cells, part=1.0, normal=None):
    """Forces of a pair in a state on its target, brought to the ranks of the target's cells: a dict of
    :class:`PointForces` by block. `part` is what the weights of the points make of an area, 1/2 for unbiased contact;
    `normal` (np, d) goes with the forces, the contact normals where it is absent. *Collective.*"""
    p, d = pair.pairing, space.dim
    normal = p.normal if normal is None else normal
    # in space points without a force count, too: they tell how much of a facet has partners
    acting = np.flatnonzero(p.paired if d == 3 else p.paired & state["traction"].any(axis=1))
    weight = state["weight"][acting]
    force = -state["traction"][acting, :d] * weight[:, None]
    area = weight if d == 2 else weight * areas(space, pair, acting, state["weight"])
    table, result = np.column_stack([area / part, force, normal[acting]]), {}
    for number, brought in bring(space, pair, cells, acting, table).items():
        area, force, normal = brought.table[:, 0], brought.table[:, 1 : 1 + d], brought.table[:, 1 + d :]
        forces = PointForces(brought.rows, brought.xi, force, normal)
        if d == 3:
            at = brought.shape @ reference_nodes(CELLS[space.mesh.blocks[number].cell].facet, space.degree)
            forces = _fitted(space, number, brought.local, at, area, forces, part)
        result[number] = forces
    return result


def _powers(xi, degree):
    """Monomials (n, k) up to a total degree at facet points (n, 2), those of lower degree first."""
    pairs = [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]
    return np.stack([xi[:, 0] ** i * xi[:, 1] ** j for i, j in pairs], axis=1)


def _fit(own, facet, count, weight, values):
    """Coefficients (nf, k, m) of the polynomials nearest to values (n, m) at the points of each facet.

    Of a degree with at most half as many coefficients as the facet has points.
    """
    k, nf = own.shape[1], len(count)
    kept = np.arange(k) < np.where(count >= 12, 6, np.where(count >= 6, 3, 1))[:, None]
    own = own * kept[facet]
    matrix, right = np.zeros((nf, k, k)), np.zeros((nf, k, values.shape[1]))
    np.add.at(matrix, facet, weight[:, None, None] * own[:, :, None] * own[:, None, :])
    np.add.at(right, facet, weight[:, None, None] * own[:, :, None] * values[:, None, :])
    # points in a line, and points without weight, leave coefficients open: the smallest ones are taken
    size = np.bincount(facet, weight, minlength=nf)[:, None]
    matrix[:, np.arange(k), np.arange(k)] += np.where(kept & (size > 0.0), 1e-10 * size, 1.0)
    return np.linalg.solve(matrix, right)


def _fitted(space, number, local, xi, weight, forces, part):
    """Forces that facets with partners all over get from the polynomial nearest to the traction at the points, whose
    areas on the target are weights (n,).

    The points are a quadrature rule of the source's facets, and a poor one on those of another mesh: as forces at
    points a uniform traction would look like a rough one.
    """
    block = space.mesh.blocks[number]
    facets, inverse, count = np.unique(forces.rows * FACETS + local, return_inverse=True, return_counts=True)
    cells, sides = np.divmod(facets, FACETS)
    table, geometry_degree = space.mesh.geometry_nodes(block)
    points, w = facet_rule(block.cell, space.degree)
    x = np.ascontiguousarray(space.mesh.points[table[cells]])
    at = facet_geometry(block.cell, x, sides, geometry_degree, space.degree, points, w)
    area, have = at.jxw.sum(axis=1), np.bincount(inverse, weight, minlength=len(facets))
    covered = (have > COVERED * area) & (have < area / COVERED)
    rest = ~covered[inverse]
    traction = forces.force / (part * weight)[:, None]
    fit = _fit(_powers(xi, space.degree_of(block)), inverse, count, weight, traction)[covered]
    smooth = part * at.jxw[covered][:, :, None] * np.matmul(_powers(points, space.degree_of(block)), fit)
    on_cell = facet_points(block.cell, points)[sides[covered]]
    return PointForces(
        np.concatenate([forces.rows[rest], np.repeat(cells[covered], len(points))]),
        np.concatenate([forces.xi[rest], on_cell.reshape(-1, 3)]),
        np.concatenate([forces.force[rest], smooth.reshape(-1, 3)]),
        np.concatenate([forces.normal[rest], -at.normals[covered].reshape(-1, 3)]),
    )
