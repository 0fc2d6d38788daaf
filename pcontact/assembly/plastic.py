"""The bulk item of scenes in which a body may yield."""

import numpy as np

from pcontact.assembly.bulk import ElasticBulk
from pcontact.assembly.geometry import chunks, hoop, keep, n_points
from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.assembly.item import LAW
from pcontact.assembly.pattern import OwnedRows, positions
from pcontact.assembly.plastic_kernels import CellPoints, PlasticState, add_forces, add_tangent, commit, excess_at
from pcontact.material.hardening import yield_work
from pcontact.material.mandel import HALF, moduli_of
from pcontact.material.plastic import VonMises
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

POINTS = 1 << 10  # of a cell at most
NO_RING = np.zeros((0, 0, 0))


class PlasticBulk(ElasticBulk):
    """Item of all bodies, where some may yield.

    Forces and stiffness are those of :class:`ElasticBulk` and, in the cells of bodies that may yield, the excess of the
    stress over linear elasticity. Only these cells have internal variables. Residual and tangent are functions of the
    displacement and the committed state.

    Parameters
    ----------
    space : pcontact.space.space.Space
    constants : list of (float, float)
        See :class:`ElasticBulk`.
    materials : list of (ndarray (3,), ndarray (k, 3)) or None
        Constants and hardening curve of each body (`pcontact.material.plastic`); None for elastic bodies.
    orthotropic : dict, optional
        See :class:`ElasticBulk`.

    Attributes
    ----------
    states : dict of int to PlasticState
        By block.

    Notes
    -----
    *Collective.*
    """

    changes = yields = True
    name = "bodies that may yield"

    def __init__(self, space, constants, materials, orthotropic=None):
        super().__init__(space, constants, orthotropic)
        self.states = {}
        for number, block in enumerate(space.mesh.blocks):
            if materials[block.body] is not None:
                self.states[number] = self._virgin(number, *materials[block.body])
                # residuals, tangents and estimates ask for the same again in every iteration
                keep(space, number)
        rowptr, columns = node_graph([space.cells[number] for number in self.states], space.n_local)
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self._pattern, self._owned = (rowptr, columns), owned
        self._place = positions(owned.rowptr, owned.columns, self.rowptr, self.columns)

    def _virgin(self, number, constants, curve):
        space = self.space
        nc, m = len(space.cells[number]), 6 if space.dim == 3 else 4
        nq, plane_stress = n_points(space, number), space.kinematics == "plane_stress"
        return PlasticState(VonMises(constants, curve, plane_stress), np.zeros((nc, nq, m)), np.zeros((nc, nq)))

    def _chunks(self):
        """Block, cells, points, weights and state of the chunks of all cells that may yield."""
        space = self.space
        for number, state in self.states.items():
            for rows, grad, jxw, shapes in chunks(space, number):
                ring = hoop(space, number, rows, shapes)
                ring = NO_RING if ring is None else np.ascontiguousarray(ring)
                points = CellPoints(space.cells[number][rows], grad, ring)
                yield number, rows, points, np.ascontiguousarray(jxw), state.of(rows)

    def _forces(self, u, absolute):
        nodal = self.space.local.gather(u)
        local = np.zeros_like(nodal)
        for number, _, points, jxw, state in self._chunks():
            add_forces(points, jxw, state, self.moved(nodal, number), absolute, local)
        return self.space.summed(self.space.local, local)

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*

        A point that cannot be integrated leaves NaN.
        """
        super().residual(u, out)
        out += self._forces(u, False)

    def predict(self, u, committed, out):
        """Add the forces of bodies that go from the committed displacement to ``u`` without yielding. *Collective.*"""
        super().residual(u, out)
        out += self._forces(committed, False)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        super().add_magnitude(u, out)
        out += self._forces(u, True)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        nodal = self.space.local.gather(u)
        d = self.space.dim
        local, count = np.zeros((len(self._pattern[1]), d, d)), 0
        blocks = BlockRows(*self._pattern, local)
        for number, _, points, jxw, state in self._chunks():
            count += add_tangent(points, jxw, state, self.moved(nodal, number), blocks)
        if not self.space.comm.allreduce(count, op=MPI.SUM):
            return self.values
        values = self.values.copy()
        values[self._place] += self._owned.sum(local)
        return values

    def commit(self, u, time):
        """Take the internal variables to a displacement. *Collective.*"""
        nodal = self.space.local.gather(u)
        for number, _, points, _, state in self._chunks():
            commit(points, state, self.moved(nodal, number))

    def flowing(self, u):
        """Part of the volume that may yield which yields between the committed displacement and ``u``. *Collective.*"""
        nodal, sums = self.space.local.gather(u), np.zeros(2)
        for number, _, points, jxw, state in self._chunks():
            trial = PlasticState(state.material, state.strain.copy(), state.p.copy())
            commit(points, trial, self.moved(nodal, number))
            sums += [np.sum(jxw[~(trial.p <= state.p)]), np.sum(jxw)]
        flowing, volume = self.space.comm.allreduce(sums, op=MPI.SUM)
        return float(flowing / volume) if volume > 0.0 else 0.0

    def memory(self):
        """Internal variables of the cells that have yielded, for a checkpoint.

        Returns
        -------
        dict of str to (ndarray (n,), ndarray (n, nq (m + 1)))
            By block: cell numbers; plastic strain and equivalent plastic strain of their points.
        """
        tables = {}
        for number, state in self.states.items():
            rows = np.flatnonzero(state.p.any(axis=1))
            values = np.concatenate([state.strain[rows], state.p[rows][:, :, None]], axis=2)
            width = values.shape[1] * values.shape[2]
            tables[str(number)] = self.space.mesh.blocks[number].ids[rows], values.reshape(len(rows), width)
        return tables

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have: cells, by the number of their points."""
        blocks = self.space.mesh.blocks
        keys = [blocks[number].ids * POINTS + state.strain.shape[1] for number, state in self.states.items()]
        return np.concatenate([np.zeros(0, dtype=np.int64), *keys])

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave, see `pcontact.assembly.item.Item.recall`."""
        state = self.states.get(int(name))
        if state is None:
            return 0
        nc, nq, m = state.strain.shape
        values = np.zeros((nc, nq * (m + 1)))
        count = take_rows(self.space.mesh.blocks[int(name)].ids, chunks, values)
        points = values.reshape(nc, nq, m + 1)
        state.strain[:], state.p[:] = points[:, :, :m], points[:, :, m]
        return count

    def excess(self, nodal):
        """Excess of the stress over elasticity at the cells' own points, under a displacement (n_local, d).

        Returns
        -------
        dict of int to ndarray (nc, nq, m)
            By block; of blocks that do not yield there is none.
        """
        found = {number: np.zeros(state.strain.shape) for number, state in self.states.items()}
        for number, rows, points, _, state in self._chunks():
            m = state.strain.shape[2]
            excess_at(points, state, nodal, False, found[number][rows], np.zeros((0, 0, m, m)))
        return found

    # -- report -------------------------------------------------------------------------------------------------

    def stress(self, u):
        """Mean stress and volume of every cell, see :meth:`ElasticBulk.stress`. *Collective.*"""
        result = super().stress(u)
        nodal = self.space.local.gather(u)
        for number, rows, points, jxw, state in self._chunks():
            m = state.strain.shape[2]
            excess = np.zeros(state.strain.shape)
            excess_at(points, state, self.moved(nodal, number), False, excess, np.zeros((0, 0, m, m)))
            mean = np.einsum("cq,cqm->cm", jxw, excess) / jxw.sum(axis=1)[:, None]
            mean[:, 3:] *= HALF
            result[number][0][rows, :m] += mean
        return result

    def energies(self, u):
        """See :meth:`pcontact.assembly.item.Bulk.energies`. *Collective.*

        Stored are 1/2 eps_e C eps_e and what Prager's back stress stores, 1/2 (2/3 Hk) eps_p eps_p; dissipated is the
        integral of the yield stress over the equivalent plastic strain. With the excess s = -C eps_p of the stress over
        C eps the first is 1/2 eps C eps + eps s - 1/2 eps_p s.
        """
        elastic, _ = super().energies(u)
        nodal = self.space.local.gather(u)
        own = np.zeros(2)
        for number, _, points, jxw, state in self._chunks():
            m, moved, forces = state.strain.shape[2], self.moved(nodal, number), np.zeros_like(nodal)
            excess = np.zeros(state.strain.shape)
            excess_at(points, state, moved, False, excess, np.zeros((0, 0, m, m)))
            add_forces(points, jxw, state, moved, False, forces)
            own[0] += np.sum(forces * moved)
            across = state.strain.copy()
            if state.material.plane_stress:
                # plastic flow keeps the volume
                across[:, :, 2] = -across[:, :, 0] - across[:, :, 1]
            back = moduli_of(state.material.constants, False)[2]
            stored = back * np.sum(across**2, axis=2) - np.sum(state.strain * excess, axis=2)
            own += [0.5 * np.sum(jxw * stored), np.sum(jxw * yield_work(state.material.curve, state.p))]
        added, dissipated = self.space.comm.allreduce(own, op=MPI.SUM)
        return elastic + float(added), float(dissipated)

    def plastic_strain(self):
        """Mean equivalent plastic strain of every cell.

        Returns
        -------
        list of ndarray (nc,)
            For each block.
        """
        result = [np.zeros(len(cells)) for cells in self.space.cells]
        for number, rows, _, jxw, state in self._chunks():
            result[number][rows] = np.sum(jxw * state.p, axis=1) / jxw.sum(axis=1)
        return result

    def plasticity(self):
        """How far bodies have yielded. *Collective.*

        Returns
        -------
        largest : float
            Equivalent plastic strain.
        volume : float
            Of the points that have yielded [length^d, with axial symmetry length^3].
        """
        largest, volume = 0.0, 0.0
        for _, _, _, jxw, state in self._chunks():
            largest = max(largest, float(np.max(state.p, initial=0.0)))
            volume += float(np.sum(jxw[state.p > 0.0]))
        comm = self.space.comm
        return comm.allreduce(largest, op=MPI.MAX), comm.allreduce(volume, op=MPI.SUM)
