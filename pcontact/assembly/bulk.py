"""The item of all bodies, whatever their strain: its contract, and what it does with internal variables."""

import numpy as np

from pcontact.assembly.geometry import n_points
from pcontact.assembly.item import Item
from pcontact.runtime.parallel import take_rows
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
        """What bodies store, and what plastic flow has dissipated, at a committed displacement [force * length].
        *Collective.*

        Returns
        -------
        stored, dissipated : float
        """
        raise NotImplementedError

    def deformations(self, u):
        """How far bodies with finite strain are stretched and turned, see
        :func:`pcontact.assembly.measures.deformations`; of others nothing. *Collective.*"""
        return {}

    def distortions(self, u, held):
        """How far bodies with small strain are from what it represents, see
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
        """What else there is to see in cells: values (nc, ...) of the cells of each block, by name. *Collective.*

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
            rows = np.flatnonzero(state.table.any(axis=1))
            tables[str(number)] = self.space.mesh.blocks[number].ids[rows], state.table[rows]
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
