"""Shape gradients of a block's cells, a chunk of cells at a time."""

from typing import NamedTuple

import numpy as np

from pcontact.element.dilatation import hoop_operator
from pcontact.element.geometry import cell_geometry
from pcontact.element.quadrature import DEGREE, quadrature
from pcontact.element.reference import CELLS, shape

CHUNK = 8192


def bulk_degree(cell, degree, geometry_degree, axisymmetric=False):
    """Quadrature degree that integrates the stiffness: exact on straight simplices, full Gauss on others.

    With axial symmetry the weight r and the hoop strain u_r / r come in: simplices take two degrees more.
    """
    simplex = CELLS[cell].is_simplex
    if not simplex:
        return 2 * degree if geometry_degree == 1 else 2 * max(degree, 2)
    return (max(2 * (degree - 1), 0) if geometry_degree == 1 else 4) + 2 * axisymmetric


def rule_degree(space, block, geometry_degree):
    """Quadrature degree of the integrals over the cells of a block."""
    if space.reduces(block):
        return DEGREE
    return bulk_degree(block.cell, space.degree, geometry_degree, space.axisymmetric)


def _rule(space, number):
    """Node table and degree of the geometry, quadrature points and weights of a block's cells."""
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, geometry_degree = mesh.geometry_nodes(block)
    degree = rule_degree(space, block, geometry_degree)
    return table, geometry_degree, *quadrature(block.cell, degree)


def _radius(space, number, rows):
    table, geometry_degree, xi, _ = _rule(space, number)
    return space.mesh.points[table[rows], 0] @ shape(space.mesh.blocks[number].cell, geometry_degree, xi).T


def points_of(space, number, rows):
    """Quadrature points (nc, nq, d) of some cells of a block [length]."""
    table, geometry_degree, xi, _ = _rule(space, number)
    return shape(space.mesh.blocks[number].cell, geometry_degree, xi) @ space.mesh.points[table[rows]]


def n_points(space, number):
    """Number of quadrature points of a block's cells."""
    return len(_rule(space, number)[3])


class Cells(NamedTuple):
    """Geometry of all cells of a block, see :func:`keep`.

    Attributes
    ----------
    grad, jxw : ndarray
        See :func:`chunks`.
    ring : ndarray or None
        See :func:`hoop`.
    """

    grad: np.ndarray
    jxw: np.ndarray
    ring: np.ndarray | None


def keep(space, number):
    """Have :func:`chunks`, :func:`some_cells` and :func:`hoop` make what they give of a block only once, where there is
    room for it."""
    mesh, every = space.mesh, np.arange(len(space.mesh.blocks[number].nodes))
    points, nodes = n_points(space, number), space.cells[number].shape[1]
    if len(every) * points * (nodes * (mesh.dim + space.axisymmetric) + 1) * 8 > space.kept.room:
        return
    grad, jxw, values, _ = some_cells_weighted(space, number, every)
    space.kept.keep(("cells", number), Cells(grad, jxw, hoop(space, number, every, values)))


def some_cells(space, number, rows):
    """Gradients (n, nq, nn, d) and N / r (n, nq, nn) of some cells of a block, and the points (nq, d) of the rule.

    N / r is None without axial symmetry.
    """
    grad, _, values, xi = some_cells_weighted(space, number, rows)
    return grad, hoop(space, number, rows, values), xi


def some_cells_weighted(space, number, rows):
    """Gradients (n, nq, nn, d) and quadrature weights (n, nq) of some cells of a block, as of :func:`chunks`, shape
    functions (nq, nn), and the points (nq, d) of the rule."""
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, geometry_degree, xi, weights = _rule(space, number)
    known = space.kept.get(("cells", number))
    if known is not None:
        return known.grad[rows], known.jxw[rows], shape(block.cell, space.degree, xi), xi
    grad, jxw, _ = cell_geometry(block.cell, mesh.points[table[rows]], geometry_degree, space.degree, xi, weights)
    if space.axisymmetric:
        jxw *= 2.0 * np.pi * _radius(space, number, rows)
    return grad, jxw, shape(block.cell, space.degree, xi), xi


def hoop(space, number, rows, values):
    """N / r (nc, nq, nn) of cells with axial symmetry, where u_r N / r is the hoop strain; None without [1/length].

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.
    rows : slice or ndarray
        Cells.
    values : ndarray (nq, nn)
        Shape functions at the points of :func:`chunks`.
    """
    if not space.axisymmetric:
        return None
    known = space.kept.get(("cells", number))
    return known.ring[rows] if known is not None else hoop_operator(values, _radius(space, number, rows))


def chunks(space, number):
    """Iterate over chunks of a block's cells with their gradients.

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.

    Yields
    ------
    rows : slice
    grad : ndarray (nc, nq, nn, d)
        Physical shape gradients [1/length]. To be read only, as all others.
    jxw : ndarray (nc, nq)
        Quadrature weight times Jacobian, with axial symmetry times 2 pi r.
    values : ndarray (nq, nn)
        Shape functions.
    """
    n = len(space.mesh.blocks[number].nodes)
    for first in range(0, n, CHUNK):
        rows = slice(first, min(first + CHUNK, n))
        grad, jxw, values, _ = some_cells_weighted(space, number, rows)
        yield rows, grad, jxw, values
