"""Phases of a run: what is left of the phase before, forces that ramp to zero, and where supports and bodies begin.

The nodes of bodies that begin go along with the bodies that they share nodes with. A body that begins has no strain
wherever its nodes are put. They are put where they make it an elastic body that the shared nodes move: one on a body
that has moved as a rigid one moves with it. Bodies that share no nodes stay where the mesh has them.
"""

import numpy as np

from pcontact.assembly.item import LAW, Item
from pcontact.assembly.matrix import GlobalMatrix
from pcontact.runtime.parallel import kept_rows, take_rows

# tables of a checkpoint, and attributes
TABLES = ("forces", "drawn", "offset")


def equilibrium(problem, u, time):
    """Internal plus contact minus external forces (n_owned, d) of a problem at its committed displacement and a time
    [force]. *Collective.*"""
    problem.time = time
    for item in problem.items:
        item.detect(u, time)
    return problem.unbalanced(u)


def borne_by(problem, u, time):
    """Forces (n_owned, d) that supports, groups and sections exert at a committed displacement and a time, with those
    that draw sections [force]; zero at all other nodes, but for what solving has left. *Collective.*"""
    return equilibrium(problem, u, time) + sum(section.at(time) for section in problem.features.sections)


class Release(Item):
    """Forces that what acts no longer has exerted at the end of the phase before; they ramp to zero over a phase.

    Parameters
    ----------
    space : pcontact.space.space.Space
    begin, end : float
        Of the phase [time].

    Attributes
    ----------
    forces : ndarray (n_owned, d)
        On the bodies at the beginning of the phase [force].
    drawn : ndarray (n_owned, d)
        Beside these, on the sides of sections that a force draws: their tension there beyond that force [force].
    offset : ndarray (n_owned, d)
        How far nodes had moved there beyond what is prescribed: supports move them on from where they are [length].
    absolute : ndarray (n_owned, d) of bool
        Components of which that ends with the phase.
    origins : dict of int to ndarray (n_owned, d)
        Displacement at the beginning of the phases in which bodies have begun, by their numbers: it is from there that
        the strain of these bodies is counted [length].
    begun : dict of int to list of int
        Blocks of these bodies.
    """

    name, changes = "phase", False

    def __init__(self, space, begin, end, begun):
        self.space, self._span, self._part, self.begun = space, (begin, end), 1.0, begun
        self.origins = {number: np.zeros((space.n_owned, space.dim)) for number in begun}
        self.forces, self.drawn, self.offset = (np.zeros((space.n_owned, space.dim)) for _ in range(3))
        self.absolute = np.zeros(self.forces.shape, dtype=bool)

    def start(self, problem, u, borne):
        """Take what a problem lacks of equilibrium at the beginning of the phase, and where its supports are there.
        *Collective.*

        Whatever has ended, supports, loads, contact, friction, leaves the same gap: the forces on the bodies that the
        items of this phase do not bear, nor the supports, groups and sections that stay. These bear at first what they
        have borne; what is a residual of this phase in that, nobody bears any more.

        Parameters
        ----------
        problem : pcontact.solve.problem.Problem
            This item among its own; its items have the committed state.
        u : PETSc.Vec
            The committed displacement.
        borne : ndarray (n_owned, d)
            At the end of the phase before, see :func:`borne_by` [force].
        """
        moved = self.space.of_owned(u)
        prescribed = problem.conditions.supports.values(self._span[0])[self.space.owned_local]
        self.offset = np.where(problem.conditions.fixed, moved - prescribed, 0.0)
        gap, kept = equilibrium(problem, u, self._span[0]) - borne, borne.copy()
        for section in problem.features.sections:
            if section.free:
                tension, force = section.drawing(section.tension(borne)), section.at(self._span[0])
                self.drawn += tension - force
                gap += force
                kept -= tension
        problem.conditions.condense(kept)
        self.forces = gap + kept

    def origin(self, number):
        """Displacement at the beginning of a phase in which bodies have begun, as a vector. *Collective.*"""
        return self.space.vector(self.origins[number])

    def free_strains(self, bulk):
        """Let bodies that have begun be without strain where they have. *Collective.*"""
        origins = {}
        for number, blocks in self.begun.items():
            origins |= dict.fromkeys(blocks, self.space.local.gather(self.origin(number)))
        bulk.count_from(origins)

    def pattern(self):
        """No entries."""
        return np.zeros(self.space.n_owned + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def _left(self, time):
        begin, end = self._span
        return min(max((end - time) / (end - begin), 0.0), 1.0)

    def detect(self, u, time, motion=0.0, ahead=None):
        """The part that is left at the end of the load step."""
        self._part = self._left(time)

    def shift(self, time):
        """Return what is added to prescribed displacements (n_owned, d) at a time [length]."""
        return np.where(self.absolute, self._left(time), 1.0) * self.offset

    def residual(self, u, out, rule=LAW):
        """Take the forces off ``out`` (n_owned, d)."""
        out -= self._part * (self.forces + self.drawn)

    def external(self, u, out):
        """Add them to ``out`` (n_owned, d)."""
        out += self._part * (self.forces + self.drawn)

    def draw(self, out):
        """Add those on the sides of sections to ``out`` (n_owned, d)."""
        out += self._part * self.drawn

    def add_magnitude(self, u, out):
        """Add their magnitudes to ``out`` (n_owned, d)."""
        out += self._part * (np.abs(self.forces) + np.abs(self.drawn))

    def tangent(self, u, rule=LAW):
        """None, they do not depend on the displacement."""
        return np.zeros((0, self.space.dim, self.space.dim))

    def report(self, u):
        """Their resultant. *Collective.*"""
        return {"released": {"force": (self._part * self.space.comm.allreduce(self.forces.sum(axis=0))).tolist()}}

    def memory_keys(self):
        """Numbers (n_owned,) of the owned nodes."""
        return self.space.keys

    def memory(self):
        """Forces, how far supports have been moved before they began, and where bodies have begun."""
        tables = {name: getattr(self, name) for name in TABLES}
        tables |= {f"origin {number}": values for number, values in self.origins.items()}
        return {name: kept_rows(self.memory_keys(), table) for name, table in tables.items()}

    def recall(self, name, chunks):
        """See :meth:`pcontact.assembly.item.Item.recall`."""
        number = int(name.partition(" ")[2]) if name.startswith("origin ") else None
        if name not in TABLES and number not in self.origins:
            return None
        values = np.zeros((self.space.n_owned, self.space.dim))
        count = take_rows(self.memory_keys(), chunks, values)
        if number is not None:
            self.origins[number] = values
        else:
            setattr(self, name, values)
        return count


# [-] Reduction of the residual. From: ranks are to agree to many digits; what is left strains no body.
SMALL = 1e-12
# Krylov iterations at most. From: chosen, far more than layers of a hundred cells take.
MOST = 20_000


def extend(problem, values, fresh, time):
    """Put nodes that are there from now on where the others draw them.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Whose bodies count their strain from the undeformed ones yet.
    values : ndarray (n_owned, d)
        Displacement [length]; of those nodes it is overwritten.
    fresh : ndarray (n_owned,) of bool
        Those nodes.
    time : float

    Notes
    -----
    *Collective.*
    """
    space = problem.space
    if not space.comm.allreduce(int(fresh.sum())):
        return
    held = ~fresh
    brought = [group for group in problem.conditions.groups if group.bring(values, fresh)]
    for group in brought:
        held[group.rows] = True
    fixed = space.at_nodes(np.repeat(held, space.dim).astype(float)) > 0.5
    bulk = getattr(problem.bulk, "small", problem.bulk)
    forces = np.zeros_like(values)
    bulk.elastic_forces(space.vector(values), forces)
    forces[held] = 0.0
    if space.comm.allreduce(float(np.sum(forces**2))) > 0.0:
        values += _solved(space, bulk, fixed, -forces)
    for group in problem.conditions.groups:
        if group not in brought:
            entered = values.copy()
            group.enter(entered, time)
            values[fresh] = entered[fresh]


def _solved(space, bulk, fixed, forces):
    """Displacement (n_owned, d) of elastic bodies under forces, nodes (n_local, d) held. *Collective.*"""
    whole = GlobalMatrix(space, fixed)
    whole.fill(bulk.pattern(), bulk.values)
    whole.matrix.assemble()
    # bodies that nothing draws have a zero right-hand side: these iterations leave them where they are
    solution = whole.solved(forces, SMALL, MOST)
    result = space.of_owned(solution).copy()
    for one in (solution, whole.matrix):
        one.destroy()
    return result
