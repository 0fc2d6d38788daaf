"""Linear equations between components of the displacement: in each of them one component follows the others.

An equation says sum(c_k u_k) = 0; of the numbers u_k some may be given, functions of time. One after the other
equations are solved for a component that no support prescribes, and that is put into all others (Gauss' elimination):
what is left are components that follow (:mod:`pcontact.space.constraints`), u_i = sum(w_ij u_j) of components that do
not, prescribed ones among these. The forces that equations exert do no work, but for those with given numbers.
"""

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes
from pcontact.element.shape import shape
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI
from pcontact.space.constraints import Constraint, gathered

# [-] Part of the largest coefficient of an equation that counts as zero. From: far above rounding errors.
ZERO = 1e-12
# [-] Part of the largest coefficient from which the component that stands first may follow the others. From: chosen.
FIRST = 0.1
# [extents of a group] Distance of two nodes that are a pair. From: far above what files round, below sizes of cells.
NEAR = 1e-4
# nodes whose partners are looked for at a time
CHUNK = 512


def eliminate(rows, fixed):
    """Solve equations for components that are not prescribed.

    Parameters
    ----------
    rows : list of dict of int to float
        Coefficients by component; the first component is taken to follow where it can.
    fixed : set of int
        Prescribed components.

    Returns
    -------
    ways : dict of int to dict of int to float
        What each component that follows is in those that do not.
    bound : list of int
        Rows that are about prescribed components alone.
    """
    ways, used, bound = {}, {}, []
    for number, row in enumerate(rows):
        size, left = max(map(abs, row.values()), default=0.0), {}
        for component, factor in row.items():
            for other, weight in ways.get(component, {component: 1.0}).items():
                left[other] = left.get(other, 0.0) + factor * weight
        left = {component: factor for component, factor in left.items() if abs(factor) > ZERO * size}
        free = [component for component in left if component not in fixed]
        if not free:
            bound += [number] * bool(left)
            continue
        most = max(abs(left[component]) for component in free)
        chosen = next(component for component in free if abs(left[component]) >= FIRST * most)
        pivot = left.pop(chosen)
        way = {component: -factor / pivot for component, factor in left.items()}
        for user in used.pop(chosen, ()):
            weight = ways[user].pop(chosen)
            for component, factor in way.items():
                ways[user][component] = ways[user].get(component, 0.0) + weight * factor
                used.setdefault(component, set()).add(user)
        ways[chosen] = way
        for component in way:
            used.setdefault(component, set()).add(chosen)
    return ways, bound


def single(space, region, where):
    """Global number of the one node of a region. *Collective.*

    Raises
    ------
    InputError
        On every rank: it has others.
    """
    numbers = space.nodes[space.region(region)]
    numbers = sorted(set().union(*space.comm.allgather(set(numbers.tolist()))))
    if len(numbers) != 1:
        raise InputError(
            f"{where[0]}: {where[1]}.terms: found {region!r}, a group of {len(numbers)} nodes; allowed: groups of one"
        )
    return numbers[0]


def term_rows(space, equations, where):
    """Rows of `eliminate` of equations with terms. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    equations : list of pcontact.scene.model.Equation
    where : (str, list of str)
        Scene and key path of each, for messages.
    """
    node, rows = {}, []
    for path, one in zip(where[1], equations, strict=True):
        row = {}
        for region, direction, factor in one.terms:
            if region not in node:
                node[region] = single(space, region, (where[0], path))
            component = node[region] * space.dim + "xyz".index(direction)
            row[component] = row.get(component, 0.0) + factor
        rows.append(row)
    return rows


def _nearest(points, others):
    """Row of the nearest of other points (m, d), and how far it is, for each point (n, d)."""
    rows, far = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
    for k in range(0, len(points), CHUNK):
        distances = np.linalg.norm(points[k : k + CHUNK, None] - others[None], axis=2)
        rows[k : k + CHUNK] = distances.argmin(axis=1)
        far[k : k + CHUNK] = distances.min(axis=1)
    return rows, far


def pair_rows(space, pair, motion, where):
    """Rows of `eliminate` of two groups of which one moves as the other, turned. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pair : pcontact.scene.model.Periodic
    motion : (ndarray (d, d), ndarray (d,))
        Q and s: a node of the partner at x has its own at Q x + s, and u = Q u(partner).
    where : (str, str)
        Scene and key path, for messages.

    Raises
    ------
    InputError
        On every rank: a node has no partner.
    """
    d, (turn, shift) = space.dim, motion
    (followers, places), (leaders, others) = (gathered(space, name) for name in (pair.region, pair.partner))
    rows, far = _nearest(places, others @ turn.T + shift)
    within = NEAR * float(np.ptp(places, axis=0).max(initial=0.0)) if pair.within is None else pair.within
    if (far > within).any():
        worst = int(far.argmax())
        at = ", ".join(f"{c:g}" for c in places[worst])
        raise InputError(
            f"{where[0]}: {where[1]}.partner: found {pair.partner!r}, whose nearest node is {far[worst]:.3g} off where "
            f"that of the node ({at}) of {pair.region!r} is to be; allowed: nodes that are pairs, or a larger within"
        )
    found = []
    for own, partner in zip(followers.tolist(), leaders[rows].tolist(), strict=True):
        for i in range(d):
            row = {own * d + i: 1.0}
            for j in np.flatnonzero(turn[i]).tolist():
                row[partner * d + j] = row.get(partner * d + j, 0.0) - turn[i, j]
            found.append(row)
    return found


def linear_rows(space, bodies):
    """Rows of `eliminate` of the nodes in the middles of cells of bodies that have degree 1: they follow the vertices.
    *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2.
    bodies : set of int

    Returns
    -------
    list of dict of int to float
    """
    found = {}
    for block, table in zip(space.mesh.blocks, space.cells, strict=True):
        if block.body not in bodies:
            continue
        n, numbers = CELLS[block.cell].n_vertices, space.nodes[table]
        weights = shape(block.cell, 1, reference_nodes(block.cell, space.degree)[n:])
        for a, row in enumerate(weights, start=n):
            ends = np.flatnonzero(np.abs(row) > ZERO)
            middles, first = np.unique(numbers[:, a], return_index=True)
            for node, others in zip(middles.tolist(), numbers[first][:, ends].tolist(), strict=True):
                found[node] = dict(zip(others, row[ends].tolist(), strict=True))
    every = {node: row for part in space.comm.allgather(found) for node, row in part.items()}
    return [
        {node * space.dim + i: 1.0, **{other * space.dim + i: -weight for other, weight in row.items()}}
        for node, row in sorted(every.items()) for i in range(space.dim)
    ]  # fmt: skip


class Equations(Constraint):
    """All equations of a problem.

    Parameters
    ----------
    space : pcontact.space.space.Space
    rows : list of dict of int to float
        Coefficients by global number of the component, the same on all ranks.
    fixed, taken : ndarray (n_local, d) of bool
        Components that supports prescribe; those that other groups have.
    where : (str, list of str)
        Scene and the key path of each row, for messages.
    said : bool
        Whether the scene says any of them.
    given : dict of int to callable, optional
        Numbers beyond those of all components, which rows may name as well, and what stands for them at a time.

    Raises
    ------
    InputError
        On every rank: a node is in another group.

    Notes
    -----
    The constructor is *Collective*. An equation about prescribed components alone is left out: the supports say what
    they are.
    """

    def __init__(self, space, rows, fixed, taken, where, said=True, given=None):
        self._space, self._rows, self.said, self._given, d = space, rows, said, given or {}, space.dim
        every = sorted({component for row in rows for component in row} - self._given.keys())
        prescribed = self._flagged(fixed, every) | self._given.keys()
        others = self._flagged(taken, every)
        clash = next((k for k, row in enumerate(rows) if others & row.keys()), None)
        agree(space.comm, None if clash is None else (
            f"{where[0]}: {where[1][clash]}: found a node of a rigid group or of a section; allowed: other nodes"
        ))  # fmt: skip
        ways, bound = eliminate(rows, prescribed)
        self._check_given(bound, where)
        first, last = space.start * d, (space.start + space.n_owned) * d
        mine = sorted(component for component in ways if first <= component < last)
        self._shifts = {}
        for k, component in enumerate(mine):
            for number in ways[component].keys() & self._given.keys():
                self._shifts.setdefault(number, np.zeros(len(mine)))[k] = ways[component][number]
        entries = [(k, other, weight) for k, component in enumerate(mine)
                   for other, weight in ways[component].items() if other not in self._given]  # fmt: skip
        row, column, weight = (np.array([one[k] for one in entries], dtype=kind)
                               for k, kind in enumerate((np.int64, np.int64, float)))  # fmt: skip
        free = ~np.isin(column, np.array(sorted(prescribed), dtype=np.int64))
        self._set(np.array(mine, dtype=np.int64) - first, row, column, weight, free)
        self.count = len(ways)

    def _check_given(self, bound, where):
        """Refuse equations with a given value whose components are all prescribed."""
        for k in bound:
            if self._given.keys() & self._rows[k].keys():
                raise InputError(
                    f"{where[0]}: {where[1][k]}: found a motion of which supports, or others like it, leave nothing "
                    "open; allowed: a group that they do not hold"
                )

    def _flagged(self, flags, components):
        """Components whose flags (n_local, d) are set, on any rank. *Collective.*"""
        space, d = self._space, self._space.dim
        own = np.array(components, dtype=np.int64) - space.start * d
        own = own[(own >= 0) & (own < space.n_owned * d)]
        set_ = own[flags[space.owned_local].ravel()[own]] + space.start * d
        return set().union(*space.comm.allgather(set(set_.tolist())))

    def given(self, u, time):
        """What is given of components that follow, at a time."""
        return sum((self._given[number](time) * shift for number, shift in self._shifts.items()), 0.0)

    def hold(self, modes):
        """What rigid motions (n_modes, n_local, d) of bodies violate equations between nodes of one body, on rank 0.
        *Collective.*"""
        space, d = self._space, self._space.dim
        local = {int(number): k for k, number in zip(space.owned_local, space.nodes[space.owned_local], strict=True)}
        values = np.zeros((len(self._rows), len(modes)))
        bodies = np.zeros((len(self._rows), 2), dtype=np.int64)
        bodies[:, 0], bodies[:, 1] = space.mesh.n_components, -1
        for k, row in enumerate(self._rows):
            for component, factor in row.items():
                node = local.get(component // d)
                if node is not None:
                    values[k] += factor * modes[:, node, component % d]
                    body = space.component[node]
                    bodies[k] = min(bodies[k, 0], body), max(bodies[k, 1], body)
        space.comm.Allreduce(MPI.IN_PLACE, values)
        least, most = bodies[:, 0].copy(), bodies[:, 1].copy()
        space.comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
        space.comm.Allreduce(MPI.IN_PLACE, most, op=MPI.MAX)
        held = np.zeros((space.mesh.n_components, len(modes), len(modes)))
        if space.comm.rank == 0:
            same = least == most
            np.add.at(held, least[same], values[same][:, :, None] * values[same][:, None, :])
        return held

    def record(self, unbalanced):
        """Resultant of the forces that the equations exert on components that are not prescribed, for the report.
        *Collective.*

        Parameters
        ----------
        unbalanced : ndarray (n_owned, d)
            Internal plus contact minus external forces.
        """
        space, d = self._space, self._space.dim
        own = np.bincount(self._at % d, unbalanced.reshape(-1)[self._at], minlength=d)
        back = self._weight * unbalanced.reshape(-1)[self._at][self._row]
        own = own - np.bincount(self._column[self._free] % d, back[self._free], minlength=d)
        return {"force": space.comm.allreduce(own, op=MPI.SUM).tolist()}
