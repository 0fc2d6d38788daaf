"""Report of a contact of the scene: its one pair, or the two halves of unbiased contact as one, and how deep
nodes of two surfaces are inside each other: the points of the source do not see what is between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcontact.contact.active_set import DEEPER, compression
from pcontact.contact.formulation.methods import WEIGHT, is_unbiased
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.contact.search.partners import find_partners
from pcontact.contact.search.projection import QueryPoints
from pcontact.contact.surface.sides import target_surface
from pcontact.contact.surface.smooth_geometry import facet_error
from pcontact.runtime.petsc import MPI
from pcontact.space.supports import moments

# [-] So many times as deep as the deepest point a node has to be. From: chosen; what points have, too, is the
# formulation's.
HIDDEN = 1.25
# [-] What a node is deeper than the points, over the compression of the bodies behind them, from which on forces are
# wrong. From: 80 blocks drawn at random on wider ones; beyond it are nine, with forces 1 to 9 % off, 5 % at the median,
# below 0.5 % at the median and 5 % at most too soft.
SUNK = 0.1


class NodeDepths:
    """Nodes of source and target of a pair, which look for their places on the other surface.

    Parameters
    ----------
    pair : pcontact.contact.pair.ContactPair
        With a target that is a surface of bodies, and another one than the source.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, pair):
        self._pair, self._source = pair, target_surface(pair.space, pair.contact.source)
        size = pair.space.comm.allreduce(np.array([pair.source.size.sum(), len(pair.source.size)]), op=MPI.SUM)
        self._size = size[0] / max(size[1], 1.0)

    def sinks(self, u, depth, points):
        """Return whether a node of the target is so deep [length] that the points, as deep as `points`, do not see it,
        and that it matters beside what the bodies are compressed. *Collective.*"""
        if depth <= HIDDEN * points:
            return False
        pair, values = self._pair, self._pair.pairing.exchange.gather(u)
        force = pair.source.jxw * np.linalg.norm(pair.forces(u)[0], axis=1)
        sums = np.array([force.sum(), *compression(pair, u, values, pair.history.time) @ force])
        total, *ways = pair.space.comm.allreduce(sums, op=MPI.SUM)
        if total == 0.0:
            return depth > DEEPER * self._size
        return bool((depth - points) * total > SUNK * np.abs(ways).sum())

    def of_source(self, u):
        """Depth of the deepest node of the source in the target [length], and its reference position (d,); 0 where none
        is inside. *Collective.*"""
        p, source = self._pair.pairing, self._pair.source
        near = np.flatnonzero(self._pair.rows.coupled)
        own = p.cells[source.facet[near]]
        return self._deepest(u, self._pair.search.target, np.where(source.shape[near] != 0.0, own, -1), p.normal[near])

    def of_target(self, u):
        """The same of the nodes of the target in the source. *Collective.*"""
        p, near = self._pair.pairing, np.flatnonzero(self._pair.rows.coupled)
        return self._deepest(u, self._source, p.targets[near], -p.normal[near])

    def _deepest(self, u, surface, nodes, normal):
        """Deepest of some nodes (n, m) of the pair (-1: none) of points with outward normals (n, d) in a surface."""
        pair, space = self._pair, self._pair.space
        local = np.zeros((len(pair.pairing.exchange.nodes), space.dim))
        for column in nodes.T:
            some = column >= 0
            np.add.at(local, column[some], normal[some])
        # a node has the mean normal of the points around it
        normal = space.summed(pair.pairing.exchange, local)
        length = np.linalg.norm(normal, axis=1)
        owned = np.flatnonzero(length > 0.0)
        x = space.points[space.owned_local[owned]]
        moved = space.of_owned(u)[owned]
        query = QueryPoints((x - pair.search.origin) + moved, normal[owned] / length[owned, None], pair.radius)
        found = find_partners(space, surface, space.local.gather(u), query, "closest_point", pair.search.origin)
        return deepest(np.where(found.paired, -found.gap, 0.0), x, space.comm)


def deepest(depth, x, comm):
    """Largest depth (n,) of all ranks and its place, of places (n, d); zeros where none is above 0. *Collective.*"""
    k = int(np.argmax(depth)) if len(depth) else -1
    own = (float(depth[k]), x[k]) if k >= 0 and depth[k] > 0.0 else (0.0, np.zeros(x.shape[1]))
    return max(comm.allgather(own), key=lambda entry: entry[0])


def node_depths(contact, pairs):
    """The :class:`NodeDepths` of a contact with one pair; None where the target is rigid, its own source, or has points
    of its own, and where gaps are not those of the facets. *Collective.*"""
    pair = pairs[0]
    other = contact.clearance is not None or contact.interference == "adjust" or contact.smooth_geometry
    if len(pairs) > 1 or pair.rigid or pair.law.tied or contact.target == contact.source or contact.all or other:
        return None
    return NodeDepths(pair)


# what the halves are called in a checkpoint
SIDES = ("source", "target")


def summarise(state, flips, lost, comm):
    """Sums and extremes of the quadrature points of all ranks. *Collective.*

    Parameters
    ----------
    state : dict of str to ndarray
        See `pcontact.contact.pair.ContactPair.state`.
    flips : list of int
        Points of this rank whose status changed in each Newton iteration.
    lost : (int, int)
        Points of this rank that have passed into their partner, and that have left it.
    comm : MPI.Comm

    Returns
    -------
    dict
        ``force`` on the target (d,) [force], ``area`` of the closed points, ``max_pressure`` [stress],
        ``max_penetration`` [length] and ``deepest``, the reference position where it is, ``least_gap`` of the points
        with a partner [length] (None: there is none), ``open``, ``stick``, ``slip``
        (points), ``flipped`` (points that changed their status in the last Newton iteration), ``passed`` and ``left``
        (points that frozen partners have misled). The same on every rank.
    """
    status, weight, x = state["status"], state["weight"], state["x"]
    closed, d = status > OPEN, x.shape[1]
    sums = np.concatenate([
        -(state["traction"] * weight[:, None]).sum(axis=0),
        [weight[closed].sum(), np.sum(~closed), np.sum(status == STICK), np.sum(status == SLIP)],
        [flips[-1] if flips else 0, *lost],
    ])  # fmt: skip
    sums = comm.allreduce(sums, op=MPI.SUM)
    depth, where = deepest(np.where(closed, -state["gap"], 0.0), x, comm)
    top = comm.allreduce(float(np.max(state["pressure"], initial=0.0)), op=MPI.MAX)
    near = comm.allreduce(float(np.min(state["gap"][state["paired"]], initial=np.inf)), op=MPI.MIN)
    n_open, n_stick, n_slip, flipped, passed, left = (int(n) for n in sums[d + 1 :])
    return {
        "force": sums[:d].tolist(),
        "area": float(sums[d]),
        "max_pressure": top,
        "max_penetration": depth,
        "deepest": where.tolist(),
        "least_gap": near if near < np.inf else None,
        "open": n_open,
        "stick": n_stick,
        "slip": n_slip,
        "flipped": flipped,
        "passed": passed,
        "left": left,
    }


def resultants(state, places, comm):
    """Forces of the quadrature points of all ranks together. *Collective.*

    Parameters
    ----------
    state : dict of str to ndarray
        See `pcontact.contact.pair.ContactPair.state`.
    places : ndarray (np, d)
        Of the points [length].
    comm : MPI.Comm

    Returns
    -------
    dict
        On the target: ``normal_force`` and ``friction_force`` (d,) [force], whose sum is the force, and ``moment``, a
        number in the plane, (3,) in space, about the origin [force * length]; ``centre`` (d,) of the normal force, NaN
        where there is none [length]. The same on every rank.
    """
    weight, normal, d = state["weight"], state["normal"], places.shape[1]
    total = -state["traction"] * weight[:, None]
    along = np.einsum("pd,pd->p", total, normal)
    pressing = along[:, None] * normal
    moment = np.atleast_1d(moments(places, total))
    sums = np.concatenate([
        pressing.sum(axis=0), (total - pressing).sum(axis=0), np.abs(along) @ places, [np.abs(along).sum()], moment
    ])  # fmt: skip
    sums = comm.allreduce(sums, op=MPI.SUM)
    centre = sums[2 * d : 3 * d] / sums[3 * d] if sums[3 * d] > 0.0 else np.full(d, np.nan)
    moment = sums[3 * d + 1 :].tolist()
    return {
        "normal_force": sums[:d].tolist(), "friction_force": sums[d : 2 * d].tolist(), "centre": centre.tolist(),
        "moment": moment if d == 3 else moment[0],
    }  # fmt: skip


@dataclass
class Surfaces:
    """The points of the sources of a contact, one source after the other.

    Attributes
    ----------
    cells : ndarray (nf,)
        One entry for each facet: its global number.
    size : ndarray (nf,)
        Diameter of the facets [length].
    facet : ndarray (np,)
        Facet of each point.
    jxw : ndarray (np,)
        Area of the points.
    x, normal : ndarray (np, d)
        Reference position [length] and outward unit normal of the points.
    """

    cells: np.ndarray
    size: np.ndarray
    facet: np.ndarray
    jxw: np.ndarray
    x: np.ndarray
    normal: np.ndarray

    @classmethod
    def of(cls, pairs, weight):
        """Join the sources of some pairs of a weight."""
        parts, n = [], 0
        for source in (pair.source for pair in pairs):
            parts.append({"cells": source.facet_ids, "size": source.size, "facet": source.facet + n,
                          "jxw": source.jxw / weight, "x": source.x, "normal": source.normal})  # fmt: skip
            n += len(source.cells)
        return cls(**_joined(parts))


class ContactReport:
    """The pairs of a contact of the scene, which report as one.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        As the scene has it, with its numerics resolved.
    pairs : list of pcontact.contact.pair.ContactPair
        One; or the halves of unbiased contact, or the one half of self contact.
    stiffer : float
        How many times as stiff as the target the source is, where that is too much; else 0.

    Attributes
    ----------
    weight : float
        Of the pairs: 1/2 for unbiased contact and self contact.
    groups : tuple of str
        Facet groups of the sources.
    sinks : bool
        Whether the last :meth:`summary` has found a corner of the target in the source that the points do not see.
    overlap : float
        Largest one that it has found at a closed point, in sizes of its facet; 0 where the law says how deep points go.
    """

    def __init__(self, contact, pairs, stiffer=0.0):
        self.contact, self.pairs, self.name, self.space = contact, pairs, contact.name, pairs[0].space
        self.weight = WEIGHT if is_unbiased(contact) else 1.0
        self.groups = tuple(pair.contact.source for pair in pairs)
        self.rigid, self.law, self.method = pairs[0].rigid, pairs[0].law, pairs[0].method
        self.sinks, self.overlap, self.stiffer = False, 0.0, stiffer

    @cached_property
    def _node_depths(self):
        return node_depths(self.contact, self.pairs)

    @property
    def _waits(self):
        """Whether a part of the overlap does not act yet."""
        table = None if self.contact.bilateral else self.contact.interference_amplitude
        return table is not None and np.interp(self.pairs[0].history.time, *np.transpose(table)) < 1.0

    @property
    def source(self):
        """The points of all sources."""
        return Surfaces.of(self.pairs, self.weight)

    @property
    def gamma(self):
        """Parameter (np,) of the points of all sources, as it acts [stress/length]."""
        return np.concatenate([pair.method.gamma for pair in self.pairs])

    @property
    def flips(self):
        """Points of this rank whose status changed in each Newton iteration."""
        return [sum(counts) for counts in zip(*(pair.flips for pair in self.pairs), strict=True)]

    @property
    def closed(self):
        """Points of this rank (np,) that were closed at the end of the last load step."""
        return np.concatenate([pair.history.closed for pair in self.pairs])

    @property
    def lost(self):
        """Points of this rank that have passed into their partner, and that have left it."""
        passed, left = zip(*(pair.lost for pair in self.pairs), strict=True)
        return sum(passed), sum(left)

    @property
    def candidates(self):
        """Facets that the searches of this rank tried."""
        return sum(pair.search.among.candidates for pair in self.pairs)

    def counters(self):
        """Points of this rank, and those with a partner times the unknowns that each of them couples."""
        points = sum(len(pair.source.facet) for pair in self.pairs)
        work = 0
        for p in (pair.pairing for pair in self.pairs if pair.pairing is not None):
            work += int(p.paired.sum()) * (p.cells.shape[1] + p.targets.shape[1]) * self.space.dim
        return {"points": points, "work": work}

    # -- a checkpoint ---------------------------------------------------------------------------------------------

    def _sides(self):
        """The pairs by what their tables begin with."""
        if self.weight == 1.0:
            return {"": self.pairs[0]}
        return {f"{side}_": pair for side, pair in zip(SIDES, self.pairs, strict=False)}

    def memory(self):
        """See :meth:`pcontact.assembly.item.Item.memory`: of halves, under names that begin with their side."""
        return {
            prefix + name: table for prefix, pair in self._sides().items()
            for name, table in pair.history.memory().items()
        }

    def memory_keys(self):
        """See :meth:`pcontact.assembly.item.Item.memory_keys`."""
        if self.weight == 1.0:
            return self.pairs[0].history.memory_keys()
        return np.concatenate([pair.history.memory_keys() * len(SIDES) + side for side, pair in enumerate(self.pairs)])

    def recall(self, name, chunks):
        """See :meth:`pcontact.assembly.item.Item.recall`."""
        for prefix, pair in self._sides().items():
            if name.startswith(prefix):
                return pair.history.recall(name[len(prefix) :], chunks)
        return None

    # -- at the end of a load step --------------------------------------------------------------------------------

    def states(self, u):
        """Of each pair, see :meth:`pcontact.contact.pair.ContactPair.state`. *Collective.*"""
        return [pair.state(u) for pair in self.pairs]

    def state(self, u):
        """Contact at the points of all sources, one after the other. *Collective.*

        Returns
        -------
        dict of str to ndarray
            As of `pcontact.contact.pair.ContactPair.state`: ``traction`` acts on the body of the point, ``weight`` is
            the area of the point.
        """
        state = _joined(self.states(u))
        return {**state, "weight": state["weight"] / self.weight}

    def paths(self):
        """Slip and wear at the points of all sources, see :meth:`pcontact.contact.history.SlipPath.fields`; empty where
        they are not asked for."""
        return _joined([pair.history.path.fields() for pair in self.pairs]) if self.pairs[0].history.path else {}

    def displacement(self, u):
        """Of the points of all sources (np, d) [length]. *Collective.*"""
        nodal = self.space.local.gather(u)
        return np.concatenate([pair.search.interpolated(nodal) for pair in self.pairs])

    def report(self, u):
        """See :meth:`pcontact.assembly.item.Item.report`. *Collective.*"""
        return {"contacts": {self.name: self.summary(u)}}

    def summary(self, u):
        """Numbers of the contact for the report, the same on every rank. *Collective.*

        Of two halves force and area are the means of what the two sides say. Self contact has no sides: its force has
        in every direction the sum of the magnitudes, which is that between two places that touch where there are only
        two.
        """
        states, comm = self.states(u), self.space.comm
        errors = facet_error(self.pairs, states)
        alone = self.weight != 1.0 and len(states) == 1
        if alone:
            states[0]["traction"] = -np.abs(states[0]["traction"])
        for state in states[1:]:
            state["traction"] = -state["traction"]
        joined, closed = _joined(states), [state["status"] > OPEN for state in states]
        if not (self.law.tied or self.contact.pressure_overclosure):
            parts = [
                np.max(-(state["gap"] / pair.source.size[pair.source.facet])[rows], initial=0.0)
                for pair, state, rows in zip(self.pairs, states, closed, strict=True)
            ]
            self.overlap = comm.allreduce(float(max(parts)), op=MPI.MAX)
        summary = {**summarise(joined, self.flips, self.lost, comm), **errors}
        if self.method.has_traction and not (self.law.tied or self.contact.pressure_overclosure):
            summary["unresolved"] = self._unresolved(joined)
        own = sum(len(np.unique(pair.source.facet[rows])) for pair, rows in zip(self.pairs, closed, strict=True))
        # a mean of two sides
        if self.contact.surfaces is not None:
            summary["source"] = self.contact.source
        summary["facets"] = -(-comm.allreduce(own) // len(states))
        if not alone:
            summary |= self._resultants(u, joined)
        for pair in (pair for pair in self.pairs if pair.history.path):
            one = pair.history.path.summary(pair.source.jxw / self.weight, comm)
            summary |= {key: max(value, summary.get(key, 0.0)) for key, value in one.items()}
        self.sinks = False
        if self._node_depths is not None and not self._waits:
            depths = self._node_depths.of_source(u), self._node_depths.of_target(u)
            summary["target_penetration"] = depths[1][0]
            self.sinks = self._node_depths.sinks(u, depths[1][0], summary["max_penetration"])
            depth, where = max(depths, key=lambda entry: entry[0])
            if depth > summary["max_penetration"]:
                summary |= {"max_penetration": depth, "deepest": where.tolist()}
        if self.rigid and self.pairs[0].search.target.has_moment:
            summary["moment"] = self._moment(u, states[0]).tolist()
        return {**summary, "bodies": self._on_bodies(u)} if self.contact.all and not self.rigid else summary

    def _unresolved(self, state):
        """Part of the pressure that the stress of the cells does not have [1], from a state of all points.
        *Collective.*

        Points that are closed have p = -t_n - gamma g: a cell that contact covers in part has the mean pressure of its
        facet, and bodies enter each other by what is missing.
        """
        closed = (state["status"] > OPEN) * state["weight"]
        entered, pressed = self.space.comm.allreduce(
            np.array([(closed * self.gamma) @ state["gap"], closed @ np.abs(state["pressure"])]), op=MPI.SUM
        )
        return float(abs(entered) / pressed) if pressed > 0.0 else 0.0

    def _resultants(self, u, joined):
        """See :func:`resultants`, of the deformed bodies. *Collective.*

        With axial symmetry there is no moment: what one side of the axis has, the other one takes away.
        """
        nodal = self.space.local.gather(u)
        places = np.concatenate([pair.search.deformed(nodal) + pair.search.origin for pair in self.pairs])
        result = resultants(joined, places, self.space.comm)
        if self.space.axisymmetric:
            del result["moment"]
        return result

    def _moment(self, u, state):
        """Moment of contact on the obstacle about the point that it turns about: a number in the plane, (3,) in space
        [force * length]. *Collective.*"""
        (pair,) = self.pairs
        search, pivot = pair.search, pair.search.target.pivot(pair.history.time)
        arms = search.deformed(self.space.local.gather(u)) + (search.origin - pivot)
        moment = moments(arms, -state["traction"] * state["weight"][:, None])
        return self.space.comm.allreduce(moment, op=MPI.SUM)

    def _on_bodies(self, u):
        """Force on every body that others touch, the same on every rank; they add up to zero. *Collective.*"""
        space, mesh = self.space, self.space.mesh
        nodal, table = np.zeros((space.n_owned, space.dim)), np.zeros((mesh.n_components, space.dim))
        for pair in self.pairs:
            pair.residual(u, nodal)
        np.subtract.at(table, space.component[space.owned_local], nodal)
        table = space.comm.allreduce(table, op=MPI.SUM)
        touched = np.flatnonzero(np.any(table != 0.0, axis=1))
        return [{"number": int(k), "body": mesh.component_names[k], "force": table[k].tolist()} for k in touched]


def _joined(states):
    return {key: np.concatenate([state[key] for state in states]) for key in states[0]}
