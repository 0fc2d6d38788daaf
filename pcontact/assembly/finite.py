"""The items of bodies with finite strain, and of scenes in which others have small strain: the sum of two."""

import numpy as np

from pcontact.assembly.finite_kernels import (
    FiniteCells,
    FiniteState,
    add_forces,
    add_sizes,
    add_tangent,
    cauchy,
    cell_work,
    commit,
    stored_energy,
)
from pcontact.assembly.geometry import chunks, hoop, keep, n_points, points_of
from pcontact.assembly.graph import BlockRows, Product, node_graph
from pcontact.assembly.item import LAW
from pcontact.assembly.matrix import OwnedRows, positions
from pcontact.assembly.measures import deformation_fields, deformations, mean_gradients
from pcontact.assembly.solid import BlockStates, Bulk, Solid
from pcontact.assembly.strains import NO_RING
from pcontact.element.dilatation import components, factors, linear
from pcontact.material.elastic import Elastic
from pcontact.material.hardening import yield_work
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI

# largest plastic strain at which the additive split is right to a few percent, in simple shear: it lacks 1.5 % of the
# shear stress at 0.4, 3 % at 0.6, 17 % at 1.2
ADDITIVE = 0.3


class FiniteStates(BlockStates):
    """Cells of a block with finite strain, and their internal variables where they may yield.

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.
    material : pcontact.material.finite.FiniteMaterial
        Its volumetric moduli are set here.
    """

    def __init__(self, space, number, material):
        block, (lam, mu) = space.mesh.blocks[number], material.small.constants[:2]
        averaged = space.averages(block)
        # of rubber the energy of the volume change stands beside the isochoric one
        stiff = lam + 2.0 / 3.0 * mu if len(material.terms) else lam
        own, shared = stiff, 0.0
        if averaged:
            own, shared = factors(lam, mu, True, space.degree_of(block))
            own += stiff - lam
        self.space, self.number, self.material = space, number, material._replace(own=float(own), shared=float(shared))
        rows, m = len(block.nodes) if material.yields else 1, 6 if space.dim == 3 else 4
        self.values = np.zeros((rows, n_points(space, number), m + 1))

    def of(self, rows):
        """A `FiniteState` of some cells, a copy."""
        return self._state(self.values[rows] if self.material.yields else self.values)

    def _state(self, values):
        return FiniteState(self.material, np.ascontiguousarray(values[..., :-1]), np.ascontiguousarray(values[..., -1]))

    def cells(self, rows, grad, jxw, shapes):
        """Cells as kernels want them.

        Parameters
        ----------
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
        space, number = self.space, self.number
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

    def chunks(self):
        """See :meth:`BlockStates.chunks`."""
        for rows, grad, jxw, shapes in chunks(self.space, self.number):
            cells = self.cells(rows, grad, jxw, shapes)
            yield rows, cells, cells.jxw

    def advance(self, rows, cells, nodal, values):
        """See :meth:`BlockStates.advance`."""
        state = self._state(values)
        missed = commit(state, cells, nodal, cell_work(cells))
        values[..., :-1], values[..., -1] = state.strain, state.p
        return missed


class FiniteSolid(Bulk):
    """Item of all bodies with finite strain: total Lagrangian, residual and tangent integrated anew for every iterate.

    Parameters
    ----------
    space : pcontact.space.space.Space
    constants : list of (float, float)
        Lame constants in small strain of each body of the scene [stress], see `pcontact.material.elastic.in_plane`.
    materials : list of pcontact.material.finite.FiniteMaterial or None
        Of each body; None for those without finite strain, which another item has.

    Attributes
    ----------
    parts : dict of int to FiniteStates
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
            number: FiniteStates(space, number, materials[block.body])
            for number, block in enumerate(space.mesh.blocks)
            if materials[block.body] is not None
        }
        for number in self.parts:
            keep(space, number)
        # whether a warning of the additive split may have to be given, the same on all ranks
        self._watches = any(m is not None and m.yields and not m.multiplicative for m in materials)
        rowptr, columns = node_graph([space.cells[number] for number in self.parts], space.n_local)
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self._local, self._owned, self.rowptr, self.columns = (rowptr, columns), owned, owned.rowptr, owned.columns
        self._product = Product(space, self.rowptr, self.columns)
        # displacement and forces of the last residual; the tangent of a prediction, until it is asked for again
        self._forget()

    @property
    def states_of_blocks(self):
        """Internal variables of the blocks that may yield."""
        return {number: part for number, part in self.parts.items() if part.material.yields}

    def chunks(self):
        """Block, rows, cells and state of the chunks of all blocks."""
        for number, part in self.parts.items():
            for rows, cells, _ in part.chunks():
                yield number, rows, cells, part.of(rows)

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
            self._averages = None, None
            nodal = self.space.local.gather(u)
            local = np.zeros_like(nodal)
            for _, _, cells, state in self.chunks():
                add_forces(state, cells, nodal, cell_work(cells), local)
            forces = self.space.summed(self.space.local, local)
            # line search, convergence test and report ask for them at the same place
            self._forces = u.getArray(readonly=True).copy(), forces
        out += forces

    def _same(self, at, u):
        """Return whether a displacement is the one of which the values at the owned nodes have been kept.
        *Collective.*"""
        return self.space.comm.allreduce(np.array_equal(at, u.getArray(readonly=True)), op=MPI.LAND)

    def _forget(self):
        """Keep nothing that was found from another state of the points."""
        self._forces, self._kept, self._averages = (None, None), None, (None, None)

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
        out += self._product(self._kept[1], way)

    # -- internal variables -----------------------------------------------------------------------------------------

    def commit(self, u, time):
        """See :meth:`Bulk.commit`. *Collective.*"""
        self._forget()
        super().commit(u, time)
        if self._watches:
            self._warn(time)

    def recall(self, name, chunks):
        """See :meth:`Bulk.recall`."""
        self._forget()
        return super().recall(name, chunks)

    def _warn(self, time):
        """Say once where the additive split is no longer accurate. *Collective.*"""
        mesh, own = self.space.mesh, [(0.0, "")]
        for number, part in self.states_of_blocks.items():
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

    # -- report -----------------------------------------------------------------------------------------------------

    def _means(self, u):
        """Cauchy stress, logarithmic strain (nc, 6) and undeformed volume (nc,) of the cells of each block, not to be
        changed: the report asks for them several times. *Collective.*"""
        at, result = self._averages
        if at is not None and self._same(at, u):
            return result
        nodal, blocks = self.space.local.gather(u), self.space.mesh.blocks
        result = [(np.zeros((len(b.nodes), 6)), np.zeros((len(b.nodes), 6)), np.zeros(len(b.nodes))) for b in blocks]
        for number, rows, cells, state in self.chunks():
            stress, strain, volume = result[number]
            cauchy(state, cells, nodal, cell_work(cells), stress[rows], strain[rows], volume[rows])
        self._averages = u.getArray(readonly=True).copy(), result
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
        """See :func:`pcontact.assembly.measures.deformation_fields`. *Collective.*"""
        return deformation_fields(self.space, self.space.local.gather(u), self.log_strain(u))

    def deformations(self, u):
        """See :func:`pcontact.assembly.measures.deformations`. *Collective.*"""
        return deformations(self.space, self.fields(u), self.parts)

    def energies(self, u):
        """See :meth:`pcontact.assembly.solid.Bulk.energies`: of the state that goes with ``u``. *Collective.*"""
        nodal, own = self.space.local.gather(u), np.zeros(2)
        for _, _, cells, state in self.chunks():
            stored, p = np.zeros(cells.jxw.shape), np.zeros(cells.jxw.shape)
            stored_energy(state, cells, nodal, cell_work(cells), stored, p)
            own[0] += np.sum(cells.jxw * stored)
            if state.material.yields:
                own[1] += np.sum(cells.jxw * yield_work(state.material.small.curve, p))
        stored, plastic = self.space.comm.allreduce(own, op=MPI.SUM)
        return float(stored), float(plastic)


class MixedSolid(Bulk):
    """Item of all bodies, of which some have finite strain.

    Parameters
    ----------
    space : pcontact.space.space.Space
    laws : list of pcontact.material.elastic.Elastic
        Of small strain, of each body of the scene.
    finite : list of pcontact.material.finite.FiniteMaterial or None
        See :class:`FiniteSolid`; None for bodies without finite strain.

    Attributes
    ----------
    small : Solid
        In which bodies with finite strain have no stiffness.
    finite : FiniteSolid

    Notes
    -----
    *Collective.*
    """

    symmetric, extrapolates = False, True

    def __init__(self, space, laws, finite):
        self.space, self.constants = space, [law.constants for law in laws]
        nothing = Elastic(0.0, 0.0)
        self.small = Solid(space, [nothing if other else law for law, other in zip(laws, finite, strict=True)])
        self.finite = FiniteSolid(space, self.constants, finite)
        self.yields, self.states = self.small.yields or self.finite.yields, self.small.states
        self.parts, self.origins = self.finite.parts, {}
        self._place = positions(*self.finite.pattern(), *self.small.pattern())

    def count_from(self, origins):
        """See :meth:`pcontact.assembly.solid.Bulk.count_from`: of blocks without finite strain. *Collective.*"""
        self.origins = origins
        self.small.count_from(origins)

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.small.pattern()

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        self.small.residual(u, out)
        self.finite.residual(u, out)

    def detect(self, u, time, motion=0.0, ahead=None):
        """See :meth:`pcontact.assembly.solid.Solid.detect`. *Collective.*"""
        self.small.detect(u, time)

    def predict(self, u, base, out):
        """Add the forces at ``u`` as those of each kind of body are predicted from ``base``. *Collective.*"""
        self.small.predict(u, base, out)
        self.finite.predict(u, base, out)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        self.small.add_magnitude(u, out)
        self.finite.add_magnitude(u, out)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        values = self.small.tangent(u).copy()
        values[self._place] += self.finite.tangent(u)
        return values

    def commit(self, u, time):
        """Take the internal variables to a displacement. *Collective.*"""
        self.small.commit(u, time)
        self.finite.commit(u, time)

    def flowing(self, u):
        """The larger of the parts of the volume that may yield, of both kinds of bodies, which yields. *Collective.*"""
        return max(self.small.flowing(u), self.finite.flowing(u))

    @property
    def states_of_blocks(self):
        """Internal variables of blocks of either kind."""
        return {**self.states, **self.finite.states_of_blocks}

    def recall(self, name, chunks):
        """See :meth:`Bulk.recall`."""
        return (self.finite if int(name) in self.parts else self.small).recall(name, chunks)

    # -- report -----------------------------------------------------------------------------------------------------

    def _joined(self, small, finite):
        """Values of each block, from the item that has its cells."""
        return [finite[number] if number in self.finite.parts else values for number, values in enumerate(small)]

    def stress(self, u):
        """Mean stress, Cauchy's with finite strain, and undeformed volume of the cells of each block. *Collective.*"""
        return self._joined(self.small.stress(u), self.finite.stress(u))

    def fields(self, u):
        """See :func:`pcontact.assembly.measures.deformation_fields`; bodies with small strain have theirs instead of
        a logarithmic one. *Collective.*"""
        nodal, space = self.space.local.gather(u), self.space
        result = [np.zeros((len(cells), 6)) for cells in space.cells]
        for number in set(range(len(result))) - set(self.finite.parts):
            h = mean_gradients(space, self.small.moved(nodal, number), number)
            result[number][:] = 0.5 * (h + h.transpose(0, 2, 1))[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        return deformation_fields(space, nodal, self._joined(result, self.finite.log_strain(u)))

    def deformations(self, u):
        """Of the bodies with finite strain, see :func:`pcontact.assembly.measures.deformations`. *Collective.*"""
        return self.finite.deformations(u)

    def energies(self, u):
        """See :meth:`pcontact.assembly.solid.Bulk.energies`. *Collective.*"""
        return tuple(sum(parts) for parts in zip(self.small.energies(u), self.finite.energies(u), strict=True))

    def distortions(self, u, held, relief=None):
        """Of the bodies without finite strain, see :func:`pcontact.assembly.measures.distortions`. *Collective.*"""
        return self.small.distortions(u, held, relief)
