"""Internal variables of bodies: blocks of cells that have any, and what items of bodies do with them, whatever the
strain."""

import numpy as np

from pcontact.assembly.geometry import n_points
from pcontact.assembly.item import Bulk
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


class Bodies(Bulk):
    """What all items of bodies do with internal variables; ``states_of_blocks`` has those of each block."""

    states_of_blocks = {}

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
