"""The item of all bodies: what holds whatever their strain (:class:`Bulk`), and that of small strain (:class:`Solid`),
a material for each (`pcontact.material.elastic`).

What is linear in the displacement is integrated once, a sparse product ever after. Cells whose law is not linear have
internal variables besides, :class:`PointStates`, and what their stress has in excess of linear elasticity is integrated
anew for each displacement. Residual and tangent are functions of the displacement and the committed state.
"""

import numpy as np

from pcontact.assembly import strains
from pcontact.assembly.geometry import chunks, hoop, keep, n_points, points_of
from pcontact.assembly.graph import BlockRows, Product, find, multiply, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.matrix import OwnedRows, positions
from pcontact.assembly.measures import distortions
from pcontact.assembly.strains import add_forces, add_means, cell_points
from pcontact.element.dilatation import linear, squares
from pcontact.material.elastic import FLOWS, Moment
from pcontact.runtime.jit import njit
from pcontact.runtime.parallel import kept_rows, take_rows
from pcontact.runtime.petsc import MPI

# Quadrature points of a cell, at most: cells times it are keys of checkpoints.
POINTS = 1 << 10


class BlockStates:
    """Internal variables at the points of the cells of a block.

    Parameters
    ----------
    space : pcontact.space.space.Space
    number : int
        Block.
    material : object
        Its law, with the ``width`` of a state, and ``flow`` from states to equivalent plastic strains.

    Attributes
    ----------
    values : ndarray (nc, nq, width)
        The committed state.
    """

    def __init__(self, space, number, material):
        self.space, self.number, self.material = space, number, material
        self.values = np.zeros((len(space.cells[number]), n_points(space, number), material.width))

    @property
    def p(self):
        """Equivalent plastic strain (nc, nq)."""
        return self.material.flow(self.values)

    @property
    def table(self):
        """All states of a cell in a row (nc, nq width), a view."""
        nc, nq, width = self.values.shape
        return self.values.reshape(nc, nq * width)

    def chunks(self):
        """Cells, what kernels need of them, and weights (nc, nq) of the chunks of all cells."""
        raise NotImplementedError

    def advance(self, rows, cells, nodal, values):
        """Let states (nc, nq, width) of some cells, in place, follow displacements (n, d) from the committed state.

        Returns
        -------
        int
            Points that cannot be integrated.
        """
        raise NotImplementedError


class Bulk(Item):
    """All bodies, the first item of a problem, and what all kinds of them do with internal variables.

    Attributes
    ----------
    constants : list of (float, float)
        Lame constants of each body [stress].
    materials : list of pcontact.material.elastic.Elastic
        Of each body, its law of small strain.
    orthotropic : dict of int to pcontact.material.orthotropic.Orthotropic
        By body, elasticity of which the constants are the nearest isotropic ones.
    yields : bool
        Whether bodies may yield.
    extrapolates : bool
        Whether a load step begins where the bodies are if they move on as they did: see :meth:`predict`.
    states : dict of int to pcontact.assembly.solid.PointStates
        Internal variables, by block; empty where none may yield.
    parts : dict of int to pcontact.assembly.finite.FiniteStates
        Blocks with finite strain.
    finite : pcontact.assembly.finite.FiniteSolid or None
        The item that has their cells.
    heat : pcontact.assembly.heat.Heat or None
        Thermal stress of the cells.
    added : frozenset of int
        Blocks of bodies that have begun in a later phase than the first, without strain.
    origins : dict of int to ndarray (n_local, d)
        Displacement from which the strain of such a block is counted [length]; empty before it is known.
    states_of_blocks : dict of int to BlockStates
        Of all blocks with internal variables.
    rigid : ndarray (n_local,) of bool or None
        Nodes all of whose motion supports and rigid groups prescribe: cells of such nodes alone have no stress.
    """

    constants = materials = ()
    yields = extrapolates = False
    orthotropic, states, parts, finite, heat = {}, {}, {}, None, None
    added, origins, states_of_blocks, rigid = frozenset(), {}, {}, None

    def count_from(self, origins):
        """Count the strain of some blocks from displacements (n_local, d), at which they have no stress. *Collective.*

        Parameters
        ----------
        origins : dict of int to ndarray (n_local, d)
            By block, the same blocks on all ranks.
        """
        if origins:
            raise NotImplementedError

    def predict(self, u, committed, out):
        """Add the forces of bodies that go from the committed displacement to ``u`` without yielding. *Collective.*"""
        self.residual(u, out)

    def energies(self, u):
        """Energies that bodies store, and that plastic flow has dissipated, at a committed displacement [force *
        length]. *Collective.*

        Returns
        -------
        stored, dissipated : float
        """
        raise NotImplementedError

    def deformations(self, u):
        """Measure how far bodies with finite strain are stretched and turned, see
        :func:`pcontact.assembly.measures.deformations`; of others nothing. *Collective.*"""
        return {}

    def distortions(self, u, held, relief=None):
        """Measure how far bodies with small strain are from what it represents, see
        :func:`pcontact.assembly.measures.distortions`; of those with finite strain nothing. *Collective.*"""
        return {}

    def stress(self, u):
        """Mean stress and volume of the cells of each block. *Collective.*

        Returns
        -------
        list of (ndarray (nc, 6), ndarray (nc,))
        """
        raise NotImplementedError

    def fields(self, u):
        """Further fields of cells: values (nc, ...) of the cells of each block, by name. *Collective.*

        Returns
        -------
        dict of str to list of ndarray
        """
        return {}

    def moved(self, nodal, number):
        """Displacement (n_local, d) of which a block has the strain."""
        return nodal

    def commit(self, u, time):
        """Take the internal variables to a displacement. *Collective.*"""
        nodal = self.space.local.gather(u)
        for number, state in self.states_of_blocks.items():
            moved = self.moved(nodal, number)
            for rows, cells, _ in state.chunks():
                state.advance(rows, cells, moved, state.values[rows])

    def flowing(self, u):
        """Part of the volume that may yield which yields between the committed displacement and ``u``. *Collective.*"""
        nodal, sums = self.space.local.gather(u), np.zeros(2)
        for number, state in self.states_of_blocks.items():
            moved, flow = self.moved(nodal, number), state.material.flow
            for rows, cells, jxw in state.chunks():
                values = state.values[rows].copy()
                missed = state.advance(rows, cells, moved, values)
                flows = ~(flow(values) <= flow(state.values[rows])) | (missed > 0)
                sums += [np.sum(jxw[flows]), np.sum(jxw)]
        flowing, volume = self.space.comm.allreduce(sums, op=MPI.SUM)
        return float(flowing / volume) if volume > 0.0 else 0.0

    def counters(self):
        """Quadrature points with internal variables."""
        return {"points": sum(int(np.prod(state.values.shape[:2])) for state in self.states_of_blocks.values()),
                "work": 0}  # fmt: skip

    def memory(self):
        """Internal variables of the cells that have any, for a checkpoint.

        Returns
        -------
        dict of str to (ndarray (n,), ndarray (n, nq width))
            By block: cell numbers; states of their points.
        """
        tables = {}
        for number, state in self.states_of_blocks.items():
            tables[str(number)] = kept_rows(self.space.mesh.blocks[number].ids, state.table)
        return tables

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have: cells, by the number of their points; None where no law
        has a state."""
        if not self.yields:
            return None
        blocks = self.space.mesh.blocks
        keys = [blocks[number].ids * POINTS + state.values.shape[1] for number, state in self.states_of_blocks.items()]
        return np.concatenate([np.zeros(0, dtype=np.int64), *keys])

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave, see `pcontact.assembly.item.Item.recall`."""
        state = self.states_of_blocks.get(int(name))
        if state is None:
            return 0
        state.values[:] = 0.0
        return take_rows(self.space.mesh.blocks[int(name)].ids, chunks, state.table)

    def plastic_strain(self):
        """Mean equivalent plastic strain (nc,) of the cells of each block; None where nothing may yield."""
        if not self.yields:
            return None
        result = [np.zeros(len(cells)) for cells in self.space.cells]
        for number, state in self.states_of_blocks.items():
            for rows, _, jxw in state.chunks():
                result[number][rows] = np.sum(jxw * state.p[rows], axis=1) / jxw.sum(axis=1)
        return result

    def plasticity(self):
        """Largest equivalent plastic strain, and volume of the points that have yielded [length^d, with axial symmetry
        length^3]. *Collective.*"""
        if not self.yields:
            return 0.0, 0.0
        largest, volume = 0.0, 0.0
        for state in self.states_of_blocks.values():
            largest = max(largest, float(np.max(state.p, initial=0.0)))
            volume += sum(float(np.sum(jxw[state.p[rows] > 0.0])) for rows, _, jxw in state.chunks())
        comm = self.space.comm
        return comm.allreduce(largest, op=MPI.MAX), comm.allreduce(volume, op=MPI.SUM)


# Points whose strains, stresses and stiffnesses are held at once. From: a processor's cache holds these.
PIECE = 4096


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


def pieces(space, number):
    """Rows, points as kernels want them and weights (nc, nq) of some cells of a block at a time."""
    for rows, grad, jxw, shapes in chunks(space, number):
        ring, count = hoop(space, number, rows, shapes), max(PIECE // jxw.shape[1], 1)
        for first in range(0, len(grad), count):
            some = slice(first, min(first + count, len(grad)))
            own = slice(rows.start + some.start, rows.start + some.stop)
            points = cell_points(space.cells[number][own], grad[some], None if ring is None else ring[some])
            yield own, points, np.ascontiguousarray(jxw[some])


class PointStates(BlockStates):
    """Internal variables of the points of a block whose law is not linear.

    Parameters
    ----------
    solid : Solid
    number : int
        Block.
    material : pcontact.material.elastic.Elastic
    """

    def __init__(self, solid, number, material):
        super().__init__(solid.space, number, material)
        self._solid = solid

    def of(self, rows):
        """States of the points of some cells in a row (n, width): a view for a slice."""
        return _in_a_row(self.values[rows])

    def chunks(self):
        """Cells, points, weights (nc, nq) of the chunks of all cells."""
        return pieces(self.space, self.number)

    def advance(self, rows, cells, nodal, values):
        """See :meth:`BlockStates.advance`."""
        strain, moment = self.at(rows, cells, nodal)
        self.material.commit(strain, _in_a_row(values), moment)
        return 0

    def stress(self, rows, points, nodal, tangent=False, virgin=False):
        """Response of cells beyond linear elasticity under displacements, a `pcontact.material.elastic.Response`.

        Parameters
        ----------
        rows : slice or ndarray
            Cells.
        points : pcontact.assembly.strains.CellPoints
            Theirs.
        nodal : ndarray (n, d)
            Displacement from which the block counts its strain.
        tangent : bool
            Whether the derivative is wanted.
        virgin : bool
            From no state instead of the committed one.
        """
        strain, moment = self.at(rows, points, nodal)
        state = self.of(rows)
        return self.material.stress(strain, np.zeros_like(state) if virgin else state, moment, tangent)

    def curvature(self, rows, points, nodal, weights):
        """Second derivatives (n, m, m) of weights (n, m) times the stress of cells, and where they are not zero, as
        `active`; others as for :meth:`stress`."""
        strain, moment = self.at(rows, points, nodal)
        return self.material.curvature(strain, self.of(rows), weights, moment)

    def at(self, rows, points, nodal):
        """Strain (n, m) of the points of cells, without that of thermal expansion where the law asks for it, and what
        the law depends on besides; parameters as for :meth:`stress`."""
        strain, solid, material = strains.strains(points, nodal), self._solid, self.material
        if solid.heat is None or not material.reads_temperature:
            return strain, Moment(solid.step)
        some = np.arange(len(self.values))[rows]
        heat, temperature = solid.heat.temperatures(self.number, some, points_of(self.space, self.number, some))
        strain[:, : 2 if material.plane_stress else 3] -= material.expansion * heat.reshape(-1, 1)
        return strain, Moment(solid.step, temperature.ravel())


class Solid(Bulk):
    """Item of all bodies with small strain.

    Parameters
    ----------
    space : pcontact.space.space.Space
    materials : list of pcontact.material.elastic.Elastic
        Of each body of the scene.
    heat : pcontact.assembly.heat.Heat, optional

    Attributes
    ----------
    constants : list of (float, float)
        Lame constants of each body [stress].
    rowptr, columns : ndarray
        Pattern of the owned rows, global nodes.
    values : ndarray (nnz, d, d)
        Stiffness of linear elasticity [stress * length^(d-2)].
    states : dict of int to PointStates
        By block.
    step : float
        Increment of the load step [time]; 0 once it has been committed.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, space, materials, heat=None):
        self.space, self.materials, self.heat = space, materials, heat
        self.constants = [material.constants for material in materials]
        self.orthotropic = {body: material for body, material in enumerate(materials) if material.anisotropic}
        self.yields = self.changes = any(material.nonlinear for material in materials)
        self.symmetric = all(material.symmetric for material in materials)
        rowptr, columns = node_graph(space.cells, space.n_local)
        local = np.zeros((len(columns), space.dim, space.dim))
        for number in range(len(space.mesh.blocks)):
            self._add_block(number, rowptr, columns, local)
        self.origins, self._free_forces, self._free_energy = {}, None, 0.0
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self.rowptr, self.columns = owned.rowptr, owned.columns
        self.values = owned.sum(local)
        self._product = Product(space, self.rowptr, self.columns)
        self.states, self._time, self.step = {}, 0.0, 0.0
        if self.yields:
            self._add_states()

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
        material, blocks = self.materials[block.body], BlockRows(rowptr, columns, local)
        for _, points, jxw, x in self._pieces(number, material.uniform) if material.anisotropic else ():
            moduli = material.deviation(x)
            strains.add_stiffness(points, jxw, moduli, np.full(len(moduli), FLOWS), blocks)

    def _pieces(self, number, uniform):
        """Cells, points, weights and places (n, d), of a uniform law the first one alone, of some cells of a block at a
        time."""
        for rows, points, jxw in pieces(self.space, number):
            x = points_of(self.space, number, slice(rows.start, rows.start + 1) if uniform else rows)
            yield rows, points, jxw, x.reshape(-1, self.space.dim)

    def _add_states(self):
        """Give the cells whose law is not linear internal variables, and their places in the tangent. *Collective.*"""
        space = self.space
        for number, block in enumerate(space.mesh.blocks):
            if self.materials[block.body].nonlinear:
                self.states[number] = PointStates(self, number, self.materials[block.body])
                # residuals, tangents and estimates ask for the same again in every iteration
                keep(space, number)
        rowptr, columns = node_graph([space.cells[number] for number in self.states], space.n_local)
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes, rowptr, columns)
        self._pattern, self._owned = (rowptr, columns), owned
        self._place = positions(owned.rowptr, owned.columns, self.rowptr, self.columns)

    @property
    def states_of_blocks(self):
        """Internal variables of blocks."""
        return self.states

    @property
    def name(self):
        """For reports and checkpoints."""
        return "bodies that may yield" if self.yields else "bodies"

    def count_from(self, origins):
        """See :meth:`pcontact.assembly.solid.Bulk.count_from`. *Collective.*"""
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

    # -- forces and stiffness ---------------------------------------------------------------------------------------

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.rowptr, self.columns

    def detect(self, u, time, motion=0.0, ahead=None):
        """Temperatures are those of the end of the load step. *Collective.*"""
        self.step = time - self._time
        if self.heat is not None:
            self.heat.detect(time)

    def elastic_forces(self, u, out):
        """Add the forces of linear elasticity on the owned nodes, without heat, to ``out`` (n_owned, d).
        *Collective.*"""
        y = self._product(self.values, u)
        out += y if self._free_forces is None else y - self._free_forces

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*

        A point that cannot be integrated leaves NaN.
        """
        self.predict(u, u, out)

    def predict(self, u, committed, out):
        """Add the forces of bodies that go from the committed displacement to ``u`` without yielding. *Collective.*"""
        self.elastic_forces(u, out)
        if self.yields:
            out += self._excess_forces(committed, False)
        if self.heat is not None:
            out -= self.heat.forces

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        y = self._product(self.values, u, magnitudes=True)
        out += y if self._free_forces is None else y + np.abs(self._free_forces)
        if self.yields:
            out += self._excess_forces(u, True)
        if self.heat is not None:
            out += np.abs(self.heat.forces)

    def _responses(self, u, tangent=False):
        """State, cells, points, weights, displacement and response of the chunks of cells whose law is not linear."""
        nodal = self.space.local.gather(u)
        for number, state in self.states.items():
            moved = self.moved(nodal, number)
            for rows, points, jxw in state.chunks():
                yield state, rows, points, jxw, moved, state.stress(rows, points, moved, tangent)

    def _excess_forces(self, u, absolute):
        local = np.zeros((self.space.n_local, self.space.dim))
        for _, _, points, jxw, _, found in self._responses(u):
            add_forces(points, jxw, found.excess, found.active, absolute, local)
        return self.space.summed(self.space.local, local)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        if not self.yields:
            return self.values
        d, count = self.space.dim, 0
        local = np.zeros((len(self._pattern[1]), d, d))
        blocks = BlockRows(*self._pattern, local)
        for _, _, points, jxw, _, found in self._responses(u, True):
            count += strains.add_stiffness(points, jxw, found.tangent, found.active, blocks)[0]
        if not self.space.comm.allreduce(count, op=MPI.SUM):
            return self.values
        values = self.values.copy()
        values[self._place] += self._owned.sum(local)
        return values

    def commit(self, u, time):
        """See :meth:`Bulk.commit`. *Collective.*"""
        if self.yields:
            super().commit(u, time)
        self._time, self.step = time, 0.0

    # -- report -----------------------------------------------------------------------------------------------------

    def energies(self, u):
        """See :meth:`Bulk.energies`: half of (u - u0) K (u - u0), what laws say of their excess,
        and, of heated bodies, 1/2 (eps - alpha dT) C (eps - alpha dT). *Collective.*"""
        forces, own = self._product(self.values, u), np.zeros(3)
        if self._free_forces is not None:
            forces -= 2.0 * self._free_forces
        if self.heat is not None:
            forces -= 2.0 * self.heat.forces
        own[0] = 0.5 * np.sum(forces * self.space.of_owned(u))
        for state, rows, points, jxw, moved, found in self._responses(u):
            strain, _ = state.at(rows, points, moved)
            own[1:] += [np.sum(jxw.ravel() * part)
                        for part in state.material.energies(strain, state.of(rows), found.excess)]  # fmt: skip
        elastic, more, dissipated = (float(x) for x in self.space.comm.allreduce(own, op=MPI.SUM))
        stored = elastic + self._free_energy + more
        return stored if self.heat is None else stored + self.heat.energy(), dissipated

    def heat_beyond(self, u, before, begin):
        """What temperatures have supplied since ``begin`` [time] where laws that depend on them are not linear (float,
        of this rank): - excess : alpha dT by the trapezoidal rule, from a committed ``before`` to ``u``. *Collective.*
        """
        nodal, supplied = [self.space.local.gather(x) for x in (u, before)], 0.0
        for number, state in self.states.items():
            if not (state.material.reads_temperature and self.heat.heated(number)):
                continue
            along = 2 if state.material.plane_stress else 3
            for rows, points, jxw in state.chunks():
                some = np.arange(rows.start, rows.stop)
                x, ends = points_of(self.space, number, rows), []
                for time, at in zip((None, begin), nodal, strict=True):
                    with self.heat.at(time):
                        found = state.stress(rows, points, self.moved(at, number))
                        stress = (found.excess[:, :along] * state.material.expansion).sum(axis=1)
                        ends.append((stress, self.heat.temperatures(number, some, x)[0].ravel()))
                (last, hot), (first, cold) = ends
                supplied -= 0.5 * float(np.sum(jxw.ravel() * (first + last) * (hot - cold)))
        return supplied

    def distortions(self, u, held, relief=None):
        """See :func:`pcontact.assembly.measures.distortions`. *Collective.*"""
        return distortions(self, u, held, relief)

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
            material = self.materials[block.body]
            stress, volume = np.zeros((len(block.nodes), 6)), np.zeros(len(block.nodes))
            moved = self.moved(nodal, number)
            for rows, points, jxw, x in self._pieces(number, material.uniform):
                moduli, strain = material.stiffness(x), strains.strains(points, moved)
                own = strain @ moduli[0] if material.uniform else np.einsum("nij,nj->ni", moduli, strain)
                add_means(jxw, own, stress[rows])
                volume[rows] = jxw.sum(axis=1)
            if self.heat is not None:
                stress -= self.heat.means[number]
            result.append((stress, volume))
        for state, rows, _, jxw, _, found in self._responses(u):
            add_means(jxw, found.excess, result[state.number][0][rows])
        return result


def _in_a_row(values):
    """States (n, width) of values (nc, nq, width), a view."""
    return values.reshape(values.shape[0] * values.shape[1], values.shape[2])
