"""The bulk item of elastic bodies: integrated once, a sparse product ever after."""

import numpy as np

from pcontact.assembly.distortion import distortions
from pcontact.assembly.geometry import chunks, hoop, points_of
from pcontact.assembly.graph import find, multiply, node_graph
from pcontact.assembly.item import LAW, Bulk
from pcontact.assembly.orthotropic import add_block, add_stress
from pcontact.assembly.pattern import OwnedRows
from pcontact.element.dilatation import linear, squares
from pcontact.material.elastic import mean_stress
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI


@njit
def add_stiffness(grad, jxw, cells, lam, mu, rowptr, columns, values):
    """Add the elastic stiffness of cells to block rows.

    Parameters
    ----------
    grad : ndarray (nc, nq, nn, d)
    jxw : ndarray (nc, nq)
    cells : ndarray (nc, nn)
        Local nodes.
    lam, mu : float
        Lame constants [stress].
    rowptr, columns : ndarray
        Local pattern.
    values : ndarray (nnz, d, d)
        K[a, b] = int lam Ga (x) Gb + mu (Gb (x) Ga + (Ga . Gb) I), added in place.
    """
    nq, nn, d = grad.shape[1], grad.shape[2], grad.shape[3]
    block = np.zeros((d, d))
    for c in range(cells.shape[0]):
        for a in range(nn):
            for b in range(a, nn):
                block[:, :] = 0.0
                for q in range(nq):
                    w = jxw[c, q]
                    dot = 0.0
                    for i in range(d):
                        dot += grad[c, q, a, i] * grad[c, q, b, i]
                    for i in range(d):
                        block[i, i] += w * mu * dot
                        for j in range(d):
                            block[i, j] += w * (
                                lam * grad[c, q, a, i] * grad[c, q, b, j]
                                + mu * grad[c, q, a, j] * grad[c, q, b, i]
                            )
                row, column = cells[c, a], cells[c, b]
                k = find(columns, rowptr[row], rowptr[row + 1], column)
                for i in range(d):
                    for j in range(d):
                        values[k, i, j] += block[i, j]
                if a != b:
                    k = find(columns, rowptr[column], rowptr[column + 1], row)
                    for i in range(d):
                        for j in range(d):
                            values[k, i, j] += block[j, i]


@njit
def add_squares(operators, weights, cells, rowptr, columns, values):
    """Add sum_m w_m A_m (x) A_m of cells to block rows, see `pcontact.element.dilatation.squares`.

    Parameters
    ----------
    operators : ndarray (nc, m, nn, d)
    weights : ndarray (nc, m)
    cells : ndarray (nc, nn)
        Local nodes.
    rowptr, columns : ndarray
        Local pattern.
    values : ndarray (nnz, d, d)
        Added in place.
    """
    nm, nn, d = operators.shape[1], operators.shape[2], operators.shape[3]
    for c in range(cells.shape[0]):
        for a in range(nn):
            row = cells[c, a]
            for b in range(nn):
                k = find(columns, rowptr[row], rowptr[row + 1], cells[c, b])
                for i in range(d):
                    for j in range(d):
                        value = 0.0
                        for m in range(nm):
                            value += weights[c, m] * operators[c, m, a, i] * operators[c, m, b, j]
                        values[k, i, j] += value


class ElasticBulk(Bulk):
    """Item of all elastic bodies.

    Parameters
    ----------
    space : pcontact.space.space.Space
    constants : list of (float, float)
        Lame constants of each body of the scene [stress], see `pcontact.material.elastic.in_plane` for plane stress.
    orthotropic : dict of int to pcontact.material.orthotropic.Orthotropic, optional
        By body, what is to be added to the stiffness of its constants.

    Attributes
    ----------
    rowptr, columns : ndarray
        Pattern of the owned rows, global nodes.
    values : ndarray (nnz, d, d)
        Stiffness [stress * length^(d-2)].

    Notes
    -----
    *Collective.*
    """

    changes = False

    def __init__(self, space, constants, orthotropic=None):
        self.space, self.constants, self.orthotropic = space, constants, orthotropic or {}
        rowptr, columns = node_graph(space.cells, space.n_local)
        local = np.zeros((len(columns), space.dim, space.dim))
        for number in range(len(space.mesh.blocks)):
            self._add_block(number, rowptr, columns, local)
        self.origins, self._free_forces, self._free_energy = {}, None, 0.0
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self.rowptr, self.columns = owned.rowptr, owned.columns
        self.values = owned.sum(local)
        nodes, self._column = np.unique(self.columns, return_inverse=True)
        self._exchange = space.exchange(nodes)

    def _add_block(self, number, rowptr, columns, local):
        """Add the stiffness of the cells of a block to block rows of local nodes."""
        space, block = self.space, self.space.mesh.blocks[number]
        (lam, mu), averaged = self.constants[block.body], space.averages(block)
        plain = not (averaged or space.axisymmetric)
        for rows, grad, jxw, shapes in chunks(space, number):
            cells = space.cells[number][rows]
            add_stiffness(grad, jxw, cells, lam if plain else 0.0, mu, rowptr, columns, local)
            if not plain:
                ring = hoop(space, number, rows, shapes)
                at = points_of(space, number, rows) if averaged and linear(block.cell, space.degree_of(block)) else None
                parts = squares(grad, jxw, ring, averaged, space.degree_of(block), lam, mu, at)
                add_squares(*parts, cells, rowptr, columns, local)
        if block.body in self.orthotropic:
            add_block(space, number, self.orthotropic[block.body], rowptr, columns, local)

    def count_from(self, origins):
        """See :meth:`pcontact.assembly.item.Bulk.count_from`. *Collective.*"""
        self.origins, self._free_forces, self._free_energy = origins, None, 0.0
        if not origins:
            return
        space, energy = self.space, 0.0
        forces = np.zeros((space.n_local, space.dim))
        for number, origin in origins.items():
            rowptr, columns = node_graph([space.cells[number]], space.n_local)
            local, own = np.zeros((len(columns), space.dim, space.dim)), np.zeros_like(forces)
            self._add_block(number, rowptr, columns, local)
            multiply(rowptr, columns, local, origin, own)
            forces += own
            energy += 0.5 * float(np.sum(origin * own))
        self._free_forces = space.summed(space.local, forces)
        self._free_energy = space.comm.allreduce(energy, op=MPI.SUM)

    def moved(self, nodal, number):
        """Displacement (n_local, d) of which a block has the strain."""
        return nodal - self.origins[number] if number in self.origins else nodal

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.rowptr, self.columns

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        y = np.empty_like(out)
        multiply(self.rowptr, self._column, self.values, self._exchange.gather(u), y)
        out += y if self._free_forces is None else y - self._free_forces

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        y = np.empty_like(out)
        multiply(self.rowptr, self._column, np.abs(self.values), np.abs(self._exchange.gather(u)), y)
        out += y if self._free_forces is None else y + np.abs(self._free_forces)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`."""
        return self.values

    def energies(self, u):
        """See :meth:`pcontact.assembly.item.Bulk.energies`: half of (u - u0) K (u - u0). *Collective.*"""
        forces = np.zeros((self.space.n_owned, self.space.dim))
        ElasticBulk.residual(self, u, forces)
        if self._free_forces is not None:
            forces -= self._free_forces
        own = 0.5 * float(np.sum(forces * u.getArray(readonly=True).reshape(forces.shape)))
        return self.space.comm.allreduce(own, op=MPI.SUM) + self._free_energy, 0.0

    def distortions(self, u, held):
        """See :func:`pcontact.assembly.distortion.distortions`. *Collective.*"""
        return distortions(self, u, held)

    def stress(self, u):
        """Mean stress of every cell. *Collective.*

        Returns
        -------
        list of (ndarray (nc, 6), ndarray (nc,))
            For each block stress (XX, YY, ZZ, XY, YZ, XZ) and volume. With axial symmetry XX is the radial, YY the
            axial, ZZ the hoop stress, and the volume that of the whole ring.
        """
        nodal = self.space.local.gather(u)
        result = []
        for number, block in enumerate(self.space.mesh.blocks):
            lam, mu = self.constants[block.body]
            stress, volume = np.zeros((len(block.nodes), 6)), np.zeros(len(block.nodes))
            moved = self.moved(nodal, number)
            for rows, grad, jxw, shapes in chunks(self.space, number):
                cells = self.space.cells[number][rows]
                mean_stress(grad, jxw, moved, cells, lam, mu, stress[rows], volume[rows])
                ring = hoop(self.space, number, rows, shapes)
                if ring is not None:
                    strain = np.einsum("cq,cqa,ca->c", jxw, ring, moved[cells, 0]) / volume[rows]
                    stress[rows, :3] += lam * strain[:, None]
                    stress[rows, 2] += 2.0 * mu * strain
            if block.body in self.orthotropic:
                add_stress(self.space, number, self.orthotropic[block.body], moved, stress)
            if self.space.kinematics == "plane_stress":
                stress[:, 2] = 0.0
            result.append((stress, volume))
        return result
