"""The bulk item of bodies with finite strain."""

import numpy as np

from pcontact.assembly.deformation import deformation_fields, deformations
from pcontact.assembly.finite_energy import stored_energy
from pcontact.assembly.finite_kernels import (
    FiniteCells,
    FiniteState,
    add_forces,
    add_sizes,
    add_tangent,
    cauchy,
    cell_work,
    commit,
)
from pcontact.assembly.geometry import chunks, hoop, n_points, points_of
from pcontact.assembly.graph import BlockRows, multiply, node_graph
from pcontact.assembly.item import LAW, Bulk
from pcontact.assembly.pattern import OwnedRows
from pcontact.assembly.solid import POINTS
from pcontact.assembly.strains import NO_RING
from pcontact.element.dilatation import components, factors, linear
from pcontact.material.hardening import yield_work
from pcontact.runtime import log
from pcontact.runtime.parallel import take_rows
from pcontact.runtime.petsc import MPI

# largest plastic strain at which the additive split is right to a few percent, in simple shear: it lacks 1.5 % of the
# shear stress at 0.4, 3 % at 0.6, 17 % at 1.2
ADDITIVE = 0.3


class FiniteBulk(Bulk):
    """Item of all bodies with finite strain: total Lagrangian, residual and tangent integrated anew for every iterate.

    Parameters
    ----------
    space : pcontact.space.space.Space
    constants : list of (float, float)
        Lame constants in small strain of each body of the scene [stress], see `pcontact.material.elastic.in_plane`.
    materials : list of pcontact.material.finite.FiniteMaterial or None
        Of each body; None for those without finite strain, which another item has. Volumetric moduli are set here.

    Attributes
    ----------
    parts : dict of int to FiniteState
        By block: all cells with finite strain.
    rowptr, columns : ndarray
        Pattern of the owned rows, global nodes.

    Notes
    -----
    *Collective.*
    """

    symmetric, extrapolates = False, True
    name = "bodies with finite strain"

    def __init__(self, space, constants, materials):
        self.space, self.constants, self.finite = space, constants, self
        self.yields = any(material is not None and material.yields for material in materials)
        self.parts = {
            number: self._state(number, materials[block.body])
            for number, block in enumerate(space.mesh.blocks)
            if materials[block.body] is not None
        }
        self._own = {number: part for number, part in self.parts.items() if part.material.yields}
        # whether a warning of the additive split may have to be given, the same on all ranks
        self._watches = any(m is not None and m.yields and not m.multiplicative for m in materials)
        rowptr, columns = node_graph([space.cells[number] for number in self.parts], space.n_local)
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self._local, self._owned, self.rowptr, self.columns = (rowptr, columns), owned, owned.rowptr, owned.columns
        nodes, self._column = np.unique(self.columns, return_inverse=True)
        self._exchange = space.exchange(nodes)
        # displacement and forces of the last residual; the tangent of a prediction, until it is asked for again
        self._forget()

    def _state(self, number, material):
        space, block = self.space, self.space.mesh.blocks[number]
        lam, mu = material.small.constants[:2]
        averaged = space.averages(block)
        # of rubber the energy of the volume change stands beside the isochoric one
        stiff = lam + 2.0 / 3.0 * mu if len(material.terms) else lam
        own, shared = stiff, 0.0
        if averaged:
            own, shared = factors(lam, mu, True, space.degree_of(block))
            own += stiff - lam
        material = material._replace(own=float(own), shared=float(shared))
        rows = len(block.nodes) if material.yields else 1
        nq, m = n_points(space, number), 6 if space.dim == 3 else 4
        return FiniteState(material, np.zeros((rows, nq, m)), np.zeros((rows, nq)))

    def cells(self, number, rows, grad, jxw, shapes):
        """Cells of a block as kernels want them.

        Parameters
        ----------
        number : int
            Block.
        rows : slice or ndarray
            Cells.
        grad : ndarray (nc, nq, nn, d)
        jxw : ndarray (nc, nq)
            Quadrature weights, with axial symmetry times 2 pi r.
        shapes : ndarray (nq, nn)
            Shape functions.

        Returns
        -------
        FiniteCells
        """
        space = self.space
        ring = hoop(space, number, rows, shapes)
        block, jxw = space.mesh.blocks[number], np.ascontiguousarray(jxw)
        basis, volume = np.zeros((*jxw.shape, 0)), jxw.sum(axis=1)
        if space.averages(block):
            at = points_of(space, number, rows) if linear(block.cell, space.degree_of(block)) else None
            basis, volume, _, _ = components(jxw, at)
        return FiniteCells(
            np.ascontiguousarray(space.cells[number][rows]), grad, jxw,
            NO_RING if ring is None else np.ascontiguousarray(ring), np.ascontiguousarray(basis), volume,
        )  # fmt: skip

    def chunks(self, parts=None):
        """Block, rows, cells and state of the chunks of all blocks, or of some."""
        for number, part in (self.parts if parts is None else parts).items():
            for rows, grad, jxw, shapes in chunks(self.space, number):
                yield number, rows, self.cells(number, rows, grad, jxw, shapes), part.of(rows)

    # -- forces and stiffness ---------------------------------------------------------------------------------------

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.rowptr, self.columns

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*

        A point that cannot be integrated leaves NaN.
        """
        at, forces = self._forces
        if at is None or not self._same(at, u):
            nodal = self.space.local.gather(u)
            local = np.zeros_like(nodal)
            for _, _, cells, state in self.chunks():
                add_forces(state, cells, nodal, cell_work(cells), local)
            forces = self.space.summed(self.space.local, local)
            # line search, convergence test and report ask for them at the same place
            self._forces = u.getArray(readonly=True).copy(), forces
        out += forces

    def _same(self, at, u):
        """Whether a displacement is the one of which the values at the owned nodes have been kept. *Collective.*"""
        return self.space.comm.allreduce(np.array_equal(at, u.getArray(readonly=True)), op=MPI.LAND)

    def _forget(self):
        """Keep nothing that was found from another state of the points."""
        self._forces, self._kept = (None, None), None

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        nodal = self.space.local.gather(u)
        local = np.zeros_like(nodal)
        for _, _, cells, state in self.chunks():
            lam, mu = state.material.small.constants[:2]
            add_sizes(abs(lam) + 2.0 * mu, cells, nodal, local)
        out += self.space.summed(self.space.local, local)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        kept, self._kept = self._kept, None
        if kept is not None and self._same(kept[0], u):
            return kept[1]
        nodal = self.space.local.gather(u)
        d = self.space.dim
        local = np.zeros((len(self._local[1]), d, d))
        blocks = BlockRows(*self._local, local)
        for _, _, cells, state in self.chunks():
            add_tangent(state, cells, nodal, cell_work(cells), blocks)
        return self._owned.sum(local)

    def predict(self, u, base, out):
        """Add the forces at ``u`` as the tangent at ``base`` says. *Collective.*

        ``u`` itself may be a place where cells are turned inside out: supports have moved there, and nothing else has.
        """
        self.residual(base, out)
        way = u.copy()
        way.axpy(-1.0, base)
        if way.norm() == 0.0:
            return
        # the tangent will be asked for once more, at the same place
        self._kept = base.getArray(readonly=True).copy(), self.tangent(base)
        y = np.empty_like(out)
        multiply(self.rowptr, self._column, self._kept[1], self._exchange.gather(way), y)
        out += y

    # -- internal variables -----------------------------------------------------------------------------------------

    def counters(self):
        """Quadrature points with internal variables."""
        return {"points": sum(part.p.size for part in self._own.values()), "work": 0}

    def commit(self, u, time):
        """Take the internal variables to a displacement. *Collective.*"""
        self._forget()
        nodal = self.space.local.gather(u)
        for _, _, cells, state in self.chunks(self._own):
            commit(state, cells, nodal, cell_work(cells))
        if self._watches:
            self._warn(time)

    def _warn(self, time):
        """Say once where the additive split is no longer accurate. *Collective.*"""
        mesh, own = self.space.mesh, [(0.0, "")]
        for number, part in self._own.items():
            largest = part.p.max(axis=1, initial=0.0)
            if len(largest) and not part.material.multiplicative:
                cell = int(np.argmax(largest))
                own.append((float(largest[cell]), mesh.component_names[mesh.blocks[number].components[cell]]))
        strain, name = max(self.space.comm.allgather(max(own)))
        if strain > ADDITIVE:
            self._watches = False
            log.warning(
                "time %g: body %s: plastic strain of %.2g with the additive split, which is for some %g at most: shear "
                "stresses fall short by some percent; remedy: split = \"multiplicative\", without kinematic hardening",
                time, name, strain, ADDITIVE,
            )  # fmt: skip

    def flowing(self, u):
        """Part of the volume that may yield which yields between the committed displacement and ``u``. *Collective.*"""
        nodal, sums = self.space.local.gather(u), np.zeros(2)
        for _, _, cells, state in self.chunks(self._own):
            trial = FiniteState(state.material, state.strain.copy(), state.p.copy())
            missed = commit(trial, cells, nodal, cell_work(cells))
            flows = np.full(trial.p.shape, True) if missed else trial.p > state.p
            sums += [np.sum(cells.jxw[flows]), np.sum(cells.jxw)]
        flowing, volume = self.space.comm.allreduce(sums, op=MPI.SUM)
        return float(flowing / volume) if volume > 0.0 else 0.0

    def memory(self):
        """Internal variables of the cells that have yielded, see :meth:`pcontact.assembly.solid.Solid.memory`."""
        tables = {}
        for number, part in self._own.items():
            rows = np.flatnonzero(part.p.any(axis=1))
            values = np.concatenate([part.strain[rows], part.p[rows][:, :, None]], axis=2)
            width = values.shape[1] * values.shape[2]
            tables[str(number)] = self.space.mesh.blocks[number].ids[rows], values.reshape(len(rows), width)
        return tables

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have: cells, by the number of their points."""
        blocks = self.space.mesh.blocks
        keys = [blocks[number].ids * POINTS + part.strain.shape[1] for number, part in self._own.items()]
        return np.concatenate([np.zeros(0, dtype=np.int64), *keys])

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave, see `pcontact.assembly.item.Item.recall`."""
        self._forget()
        part = self._own.get(int(name))
        if part is None:
            return 0
        nc, nq, m = part.strain.shape
        values = np.zeros((nc, nq * (m + 1)))
        count = take_rows(self.space.mesh.blocks[int(name)].ids, chunks, values)
        points = values.reshape(nc, nq, m + 1)
        part.strain[:], part.p[:] = points[:, :, :m], points[:, :, m]
        return count

    # -- report -----------------------------------------------------------------------------------------------------

    def _means(self, u):
        """Cauchy stress, logarithmic strain (nc, 6) and undeformed volume (nc,) of the cells of each block."""
        nodal, blocks = self.space.local.gather(u), self.space.mesh.blocks
        result = [(np.zeros((len(b.nodes), 6)), np.zeros((len(b.nodes), 6)), np.zeros(len(b.nodes))) for b in blocks]
        for number, rows, cells, state in self.chunks():
            stress, strain, volume = result[number]
            cauchy(state, cells, nodal, cell_work(cells), stress[rows], strain[rows], volume[rows])
        return result

    def stress(self, u):
        """Mean Cauchy stress over every deformed cell, and volume of the undeformed one. *Collective.*

        Returns
        -------
        list of (ndarray (nc, 6), ndarray (nc,))
            For each block; zero without finite strain. See :meth:`pcontact.assembly.solid.Solid.stress`.
        """
        return [(stress, volume) for stress, _, volume in self._means(u)]

    def log_strain(self, u):
        """Mean logarithmic strain ln V (nc, 6) over every deformed cell; zero without finite strain. *Collective.*"""
        return [strain for _, strain, _ in self._means(u)]

    def fields(self, u):
        """See :func:`pcontact.assembly.deformation.deformation_fields`. *Collective.*"""
        return deformation_fields(self.space, self.space.local.gather(u), self.log_strain(u))

    def deformations(self, u):
        """See :func:`pcontact.assembly.deformation.deformations`. *Collective.*"""
        return deformations(self.space, self.fields(u), self.parts)

    def energies(self, u):
        """See :meth:`pcontact.assembly.item.Bulk.energies`: of the state that goes with ``u``. *Collective.*"""
        nodal, own = self.space.local.gather(u), np.zeros(2)
        for _, _, cells, state in self.chunks():
            stored, p = np.zeros(cells.jxw.shape), np.zeros(cells.jxw.shape)
            stored_energy(state, cells, nodal, cell_work(cells), stored, p)
            own[0] += np.sum(cells.jxw * stored)
            if state.material.yields:
                own[1] += np.sum(cells.jxw * yield_work(state.material.small.curve, p))
        stored, plastic = self.space.comm.allreduce(own, op=MPI.SUM)
        return float(stored), float(plastic)

    def plastic_strain(self):
        """Mean equivalent plastic strain (nc,) of the cells of each block; None where nothing may yield."""
        if not self.yields:
            return None
        result = [np.zeros(len(cells)) for cells in self.space.cells]
        for number, rows, cells, state in self.chunks(self._own):
            result[number][rows] = np.sum(cells.jxw * state.p, axis=1) / cells.volume
        return result

    def plasticity(self):
        """Largest equivalent plastic strain, and volume that has yielded [length^d]. *Collective.*"""
        largest, volume = 0.0, 0.0
        for _, _, cells, state in self.chunks(self._own):
            largest = max(largest, float(np.max(state.p, initial=0.0)))
            volume += float(np.sum(cells.jxw[state.p > 0.0]))
        comm = self.space.comm
        return comm.allreduce(largest, op=MPI.MAX), comm.allreduce(volume, op=MPI.SUM)
