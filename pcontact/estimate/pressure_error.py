"""The error of a contact pressure in L2: how far it is from that of the stress of both bodies, averaged at nodes.

With P the pressure along the contact normal n, from the source to the target, the tractions of both bodies are

    n . sigma_S N_S = -P        on the source,
    n . sigma_T N_T = -P dA_S / dA_T        on the target, N_T and so n . N_T having the other sign,

with the outward normals N and areas dA of the bodies as they are given, as the strains are small ones. Partners are
those of surfaces that have moved: where one body is stretched along the surface more than the other, or where round
surfaces are pressed flat, a force acts on another area of the target than of the source, and not along their normals.
A disk that rests on a block had stresses of up to 3 % beside its pressures, on any mesh. The partners themselves tell
the areas, see `pcontact.estimate.tractions`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.sides import diameters
from pcontact.element.reference import facet_area_vectors, facet_nodes, shape, shape_gradient
from pcontact.estimate.goal import GoalError
from pcontact.estimate.tractions import areas, bring, source_points
from pcontact.runtime.petsc import MPI

# [-] Sizes of the target's facets over those of the source, with which a pressure's error counts for both alike. From:
# where the target is the finer one, pressures wave with its facets, and more so on finer meshes: Hertz's cylinder.
SOURCE = 2.0


def pressure_error(estimator, contact, u):
    """Distance of the contact pressure from that of the stress averaged at the nodes, in L2: a
    :class:`pcontact.estimate.goal.GoalError` with the norm of the pressure, that of its error, and the squared parts of
    the cells. *Collective.*

    Both bodies bring errors into the pressure: it is compared with the stress of the source where it is integrated, and
    with that of the target at the partners. The squares of both count by the compliance of the cells there: of two
    alike they have the mean, beside a stiff body or an obstacle the soft one counts. What is missed at a point is that
    of the cells of both sides, but of the source more, unless it is finer than the target (`SOURCE`): where it is not,
    the pressure waves with the target's cells.
    """
    space = estimator.space
    averaged = estimator.averaged_stress(space.local.gather(u))
    cells, total, norm = [np.zeros(len(block.nodes)) for block in space.mesh.blocks], 0.0, 0.0
    for pair, state in zip(contact.pairs, contact.states(u), strict=True):
        weight, pressure = state["weight"], state["pressure"]
        source = _on_source(estimator, pair, state, averaged)
        target = [] if pair.rigid else _on_partners(estimator, pair, state, source, averaged)
        own = [source.squares.sum(), source.stiff, sum(one.squares.sum() for one in target),
               sum(one.stiff for one in target), weight @ pressure**2]  # fmt: skip
        sums = space.comm.allreduce(np.array(own), op=MPI.SUM)
        # the stiffness of the other side over that of both
        stiff = sums[1] + sums[3]
        share = sums[3] / stiff if not pair.rigid and stiff > 0.0 else float(pair.rigid)
        total, norm = total + share * sums[0] + (1.0 - share) * sums[2], norm + sums[4]
        rest = source.squares if pair.rigid else np.where(pair.pairing.paired, 0.0, source.squares)
        for number, (p, rows, _) in source.points.items():
            np.add.at(cells[number], rows, share * rest[p])
        if not pair.rigid:
            _divide(estimator, target, share, cells)
    return GoalError(float(np.sqrt(norm)), float(np.sqrt(total)), cells)


class _Side(NamedTuple):
    """Error at the points on one side: on the source all of them, on the target those of a block.

    Attributes
    ----------
    points : object
        Of the source, see :func:`pcontact.estimate.tractions.source_points`; the block and cells (n,) of the target.
    squares : ndarray (n,)
        Of the points, times their area.
    stiff : float
        Stiffness of the cells over the area that is closed.
    told : ndarray (n, 3) or None
        On the target: squares of the points on the source, the part that the source has, its cells.
    """

    points: object
    squares: np.ndarray
    stiff: float
    told: np.ndarray | None = None


def _on_source(estimator, pair, state, averaged):
    """A :class:`_Side`: that of the source."""
    weight, pressure = state["weight"], state["pressure"]
    points, squares, stiff = source_points(estimator.space, pair), np.zeros(len(weight)), 0.0
    for number, (p, rows, xi) in points.items():
        own = _traction(estimator, number, rows, xi, (-state["normal"][p], pair.source.normal[p]), averaged)
        squares[p] = _squares(weight[p], pressure[p], own)
        stiff += float(weight[p] @ (pressure[p] > 0.0)) * estimator.stiffness(estimator.space.mesh.blocks[number])
    return _Side(points, squares, stiff)


def _on_partners(estimator, pair, state, source, averaged):
    """A :class:`_Side` of each block of the target. *Collective.*"""
    space, mesh, found = estimator.space, estimator.space.mesh, []
    weight, pressure = state["weight"], state["pressure"]
    acting = np.flatnonzero(pair.pairing.paired & (pressure > 0.0))
    area = areas(space, pair, acting, weight)
    ids = np.zeros(len(weight))
    for number, (p, rows, _) in source.points.items():
        ids[p] = mesh.blocks[number].ids[rows]
    size = pair.source.size[pair.source.facet]
    table = np.column_stack([state["normal"], weight, pressure, source.squares, size, ids])[acting]
    table = np.column_stack([table, area])
    for number, one in bring(space, pair, estimator.cells, acting, table).items():
        block, d = mesh.blocks[number], space.dim
        weight, pressure, squares, size, ids, area = one.table[:, d:].T
        directions = one.table[:, :d], _normals(mesh, block, one)
        own = _squares(weight, pressure, area * _traction(estimator, number, one.rows, one.xi, directions, averaged))
        x = mesh.points[block.nodes[one.rows[:, None], facet_nodes(block.cell, 1)[one.local]]]
        theirs = (SOURCE * size) ** 4
        told = np.column_stack([squares, theirs / (diameters(x) ** 4 + theirs), ids])
        found.append(_Side((number, one.rows), own, float(weight.sum()) * estimator.stiffness(block), told))
    return found


def _normals(mesh, block, partners):
    """Outward normals (n, d) of the facets of a block at partners on them."""
    table, degree = mesh.geometry_nodes(block)
    x = mesh.points[table[partners.rows]]
    slopes = np.einsum("pad,pae->pde", x, shape_gradient(block.cell, degree, partners.xi))
    own = facet_area_vectors(block.cell)[partners.local]
    normals = np.einsum("ped,pe->pd", np.linalg.inv(slopes), own)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _divide(estimator, target, share, cells):
    """Give the cells of both sides what is missed at the points that have partners. *Collective.*"""
    ids, back = [np.zeros(0, np.int64)], [np.zeros(0)]
    for (number, rows), squares, _, told in target:
        both = share * told[:, 0] + (1.0 - share) * squares
        np.add.at(cells[number], rows, (1.0 - told[:, 1]) * both)
        ids.append(told[:, 2].astype(np.int64))
        back.append(told[:, 1] * both)
    place, table = estimator.cells.deliver(np.concatenate(ids), np.concatenate(back)[:, None])
    for number in np.unique(place[:, 0]):
        some = place[:, 0] == number
        np.add.at(cells[number], place[some, 1], table[some, 0])


def _traction(estimator, number, rows, xi, directions, averaged):
    """a . sigma b (n,) of the averaged stress at points of cells of a block, with two directions a, b (n, d); 0 where
    it is less."""
    space = estimator.space
    block = space.mesh.blocks[number]
    at = shape(block.cell, space.degree_of(block), xi)
    stress = np.einsum("pn,pnij->pij", at, averaged[number][rows])
    return np.maximum(np.einsum("pi,pij,pj->p", directions[0], stress, directions[1]), 0.0)


def _squares(weight, pressure, other):
    """Squares (n,) of how far pressures are from others, times areas."""
    return weight * np.where(pressure > 0.0, pressure - other, 0.0) ** 2
