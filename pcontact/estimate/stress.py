"""Stress at any points of cells: of the elastic displacement, and of cells that have yielded.

Local problems are softer in cells that have yielded. Where a point yields, a small change of the stress goes with a
large one of the strain. The error of the displacement is that of the whole history of flow, not that of one load step:
the moduli are those that bring a virgin point to the strain of now in one step (deformation theory), secant moduli,
sigma_dev = 2 mu_s eps_dev with

    mu_s / mu = 1 - |eps_p| / |eps_dev|

They are those of elasticity where nothing has yielded, and positive where the tangent of perfect plasticity is not.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import rule_degree, some_cells
from pcontact.assembly.strains import cell_points
from pcontact.contact.traction.small import extrapolation
from pcontact.element.dilatation import Mean, factors, hoop_operator, mean_dilatation
from pcontact.element.reference import n_nodes, shape
from pcontact.estimate.points import slopes, stresses
from pcontact.material.elastic import HALF


class Softening(NamedTuple):
    """Loss by yielding of the stiffness of nc cells.

    Attributes
    ----------
    part : ndarray (nc, nq)
        Of `moduli`, at the bulk's own points; 0 where they have not yielded.
    moduli : ndarray (m, m)
        Those that flow acts on, Mandel components [stress].
    near : ndarray (np,)
        The bulk's own point that is nearest to each point of the local problems.
    """

    part: np.ndarray
    moduli: np.ndarray
    near: np.ndarray


def softening(space, bulk, number, rows, nodal, xi):
    """A :class:`Softening` of some cells of a block under a displacement (n_local, d), after the load step has been
    committed, at points (np, d) of the local problems in the reference cell."""
    nodes, state = space.cells[number][rows], getattr(bulk, "states", {}).get(number)
    some = np.zeros(0, dtype=np.int64) if state is None else np.flatnonzero(state.p[rows].any(axis=1))
    if not len(some):
        return Softening(np.zeros((len(nodes), 1)), np.zeros((0, 0)), np.zeros(len(xi), dtype=np.int64))
    cells = np.arange(len(space.cells[number]))[rows][some]
    grad, ring, points = some_cells(space, number, cells)
    places, shape = cell_points(np.ascontiguousarray(nodes[some]), grad, ring), grad.shape[:2]
    excess, (strain, _) = state.stress(cells, places, nodal, virgin=True).excess, state.at(cells, places, nodal)
    moduli = state.material.moduli(strain.shape[1])
    # the excess of a virgin point is along the strain: what is taken away is a part of the work of the strain
    work = np.einsum("nk,kl,nl->n", strain, moduli, strain)
    part = np.zeros((len(nodes), shape[1]))
    part[some] = (-np.einsum("nk,nk->n", excess, strain) / np.where(work > 0.0, work, 1.0)).reshape(shape)
    near = np.argmin(np.sum((xi[:, None] - points[None]) ** 2, axis=2), axis=1)
    return Softening(part, moduli, near)


def mean_flow(blocks, bulk):
    """Mean accumulated plastic strain (n_cells,) of the cells of this rank, block after block; 0 where bodies do not
    yield."""
    states = getattr(bulk, "states", {})
    means = [states[k].p.mean(axis=1) if k in states else np.zeros(len(b.nodes)) for k, b in enumerate(blocks)]
    return np.concatenate([np.zeros(0), *means])


class Retained:
    """Part in the plastic strain of cells of the errors that they have had in load steps.

    The plastic strain of a load step is as wrong as the displacement is then, and is added to what there is: cells keep
    the mean of their errors over their flow. The edge of a contact that moves over a cell makes its error large in a
    single load step, the larger the finer these are: with the largest errors instead, those of a ball pressed into
    metal (2,444 unknowns) become 2.5 times as large from 20 to 120 load steps, with their means 1.3 times, and more
    load steps ask for finer meshes without an end.

    Parameters
    ----------
    count : int
        Cells of this rank.
    """

    def __init__(self, count):
        self._work, self._flow = np.zeros(count), np.zeros(count)

    def after(self, errors, flow):
        """It, (n_cells,) [sqrt(energy)], after one more load step with errors of the displacement [sqrt(energy)] and an
        accumulated plastic strain at its end."""
        self._work += errors * (flow - self._flow)
        self._flow = flow
        return np.divide(self._work, flow, out=np.zeros(len(flow)), where=flow > 0.0)


# rows and columns of Mandel components; the third entry is across the plane in two dimensions
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
# points whose stiffness is turned at once
PART = 2**14


def own_nodes(space, number):
    """Nodes (nc, nn) of the cells of a block that the degree of its body has: of degree 1 the vertices."""
    block = space.mesh.blocks[number]
    return space.cells[number][:, : n_nodes(block.cell, space.degree_of(block))]


class BlockStress:
    """Stress of some cells of a block under a displacement.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.solid.Solid
        After the load step has been committed: cells that yield do so in the state at its end.
    number : int
        Block.
    rows : slice or ndarray (nc,) of int
        Cells.
    nodal : ndarray (n_local, d)
    found : dict, optional
        Of the displacement: what is found of cells that have yielded, for others that ask for the same.

    Attributes
    ----------
    u : ndarray (nc, nn, d)
        Displacement at the nodes of the cells.
    """

    def __init__(self, space, bulk, number, rows, nodal, found=None):
        block = space.mesh.blocks[number]
        self.space, self.block, self.degree = space, block, space.degree_of(block)
        law = bulk.materials[block.body]
        self.lam, self.mu = law.constants
        self.u = nodal[own_nodes(space, number)[rows]]
        self._table, self._geometry = space.mesh.geometry_nodes(block)
        self._number, self._rows = number, rows
        averaged = space.averages(block)
        self.own, shared = factors(self.lam, self.mu, averaged, self.degree)
        self.shared = None
        if averaged:
            x, order = np.ascontiguousarray(self._x()), rule_degree(space, block, self._geometry)
            mean = mean_dilatation(block.cell, x, self._geometry, self.degree, order, space.axisymmetric)
            # the displacement stands for nodes and directions: a single "node" of one direction
            mean = Mean(mean.centre, np.einsum("cbad,cad->cb", mean.slopes, self.u)[:, :, None, None])
            self.shared = mean.times(np.full(len(x), shared))
        self._law = law if law.anisotropic else None
        self._heat = bulk.heat if bulk.heat is not None and bulk.heat.heated(number) else None
        state = getattr(bulk, "states", {}).get(number)
        self.excess = None
        if state is not None:
            found, key = {} if found is None else found, (number, *rows.indices(len(block.nodes))[:2])
            if key not in found:
                found[key] = _excess(space, state, number, rows, nodal)
            self.excess = found[key]

    def __call__(self, grad, values, radius, xi):
        """Stress at points.

        Parameters
        ----------
        grad : ndarray (nc, nq, nn, d)
            Physical shape gradients [1/length].
        values : ndarray (nq, nn)
            Shape functions.
        radius : ndarray (nc, nq) or None
            With axial symmetry.
        xi : ndarray (nq, d)
            The points in the reference cell.

        Returns
        -------
        stress : ndarray (nc, nq, d, d)
        around : ndarray (nc, nq) or None
            Hoop stress with axial symmetry.
        """
        d = grad.shape[3]
        if radius is None and self.shared is None and self._law is None:
            stress, around = np.empty((*grad.shape[:2], d, d)), None
            stresses(self.u, grad, self.own, self.mu, stress)
        else:
            stress, around = self._of_strain(grad, values, radius, xi)
        if self._heat is not None:
            around = self._take_heat(stress, around, xi)
        if self.excess is not None:
            excess, points = self.excess
            key = "extrapolation", self._number, xi.tobytes()
            matrix, = self.space.kept(
                key, lambda: (extrapolation(self.block.cell, self.space.degree, points, xi),)
            )
            around = _add_excess(np.matmul(matrix, excess), stress, around)
        return stress, around

    def _of_strain(self, grad, values, radius, xi):
        """The same of elastic bodies, whatever their law."""
        d = grad.shape[3]
        slope = np.empty((*grad.shape[:2], d, d))
        slopes(self.u, grad, slope)
        trace, ring = np.einsum("cqii->cq", slope), None
        if radius is not None:
            ring = np.einsum("cqa,ca->cq", hoop_operator(values, radius), self.u[:, :, 0])
            trace = trace + ring
        volumetric = self.own * trace
        if self.shared is not None:
            volumetric = volumetric + self.shared.at(self._places(xi))[:, :, 0, 0]
        stress = self.mu * (slope + slope.transpose(0, 1, 3, 2))
        for k in range(d):
            stress[:, :, k, k] += volumetric
        around = None if ring is None else volumetric + 2.0 * self.mu * ring
        if self._law is not None:
            around = _add_excess(self._deviation(slope, ring, xi), stress, around)
        return stress, around

    def _x(self):
        """Geometry nodes (nc, ng, d) of the cells [length]."""
        return self.space.mesh.points[self._table[self._rows]]

    def _places(self, xi):
        """Points (nc, nq, d) of the cells [length]."""
        return shape(self.block.cell, self._geometry, xi) @ self._x()

    def _take_heat(self, stress, around, xi):
        """Take the stress off that heated cells have at zero strain; returns the hoop stress."""
        rows, points = np.arange(len(self.block.nodes))[self._rows], self._places(xi)
        return _add_excess(-self._heat.on_cells(self._number, rows, np.arange(len(rows)), points), stress, around)

    def _deviation(self, slope, ring, xi):
        """C_dev : eps (nc, nq, m), see `pcontact.material.orthotropic`."""
        law = self._law
        strain = mandel(slope, ring, law.size)
        if law.uniform:
            return strain @ law.deviation(np.zeros((1, slope.shape[3])))[0]
        points = self._places(xi).reshape(-1, slope.shape[3])
        flat, out = strain.reshape(len(points), law.size), np.empty((len(points), law.size))
        for first in range(0, len(points), PART):
            some = slice(first, first + PART)
            out[some] = np.einsum("pmn,pn->pm", law.deviation(points[some]), flat[some])
        return out.reshape(strain.shape)


def mandel(slope, ring, m):
    """Mandel strains (nc, nq, m) of displacement gradients (nc, nq, d, d) and hoop strains (nc, nq), None for none."""
    strain = np.zeros((*slope.shape[:2], m))
    for k, (i, j) in enumerate(PLACES[:m]):
        if j < slope.shape[3]:
            strain[:, :, k] = slope[:, :, i, j] if i == j else HALF * (slope[:, :, i, j] + slope[:, :, j, i])
    if ring is not None:
        strain[:, :, 2] = ring
    return strain


def _excess(space, state, number, rows, nodal):
    """Excess (nc, nq, m) over elasticity at the bulk's own points, and these points (nq, d)."""
    grad, ring, xi = some_cells(space, number, rows)
    found = state.stress(rows, cell_points(space.cells[number][rows], grad, ring), nodal)
    return found.excess.reshape(*grad.shape[:2], found.excess.shape[1]), xi


def _add_excess(excess, stress, around):
    """Add Mandel components (nc, nq, m) to tensors; returns the hoop stress."""
    d = stress.shape[2]
    for k in range(excess.shape[2]):
        i, j = PLACES[k]
        if max(i, j) < d:
            value = excess[:, :, k] * (1.0 if i == j else HALF)
            stress[:, :, i, j] += value
            if i != j:
                stress[:, :, j, i] += value
        elif around is not None:
            around = around + excess[:, :, k]
    return around
