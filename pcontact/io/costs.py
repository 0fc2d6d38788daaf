"""Costs of a run: time, messages and memory of its phases, how evenly the work is spread, bytes of arrays by item,
calls of kernels; and what pieces that a scene does not have would add.

Physics that a scene does not use must not show here: the counters of a scene without it are those of a program that
does not have it.
"""

import numpy as np

from pcontact.assembly.geometry import n_points
from pcontact.runtime import log, profile
from pcontact.runtime.jit import CALLS

# marks of the memory, in their order
MARKS = ("start", "read", "distribute", "set_up", "assembly", "solve")
# what the searches count
COUNTS = ("searches", "points", "asked", "candidates", "gathered_bytes")
MB = 1024.0**2
# seconds of a load step over those without the piece, ball on block (docs/performance_details.md)
FRICTION_TIMES, PLASTIC_TIMES = "0.8 to 1.6", "2.2 to 2.9"
# the same of finite strain (docs/finite_strain.md), and the bytes that contact which moves holds over those of contact
# that does not. From: blocks and ball on block, 1.9 to 2.4 times as many
FINITE_TIMES, MOVING = "1.5 to 2.3", 2.4


# what tables of bytes call the derivative of the normal traction
ROWS = "pairs.pairing.operator.rows"


class CostReport:
    """Blocks of the report on what the run has cost so far.

    Parameters
    ----------
    record : pcontact.runtime.profile.Profile
        Of this rank.
    problem : pcontact.solve.problem.Problem
    """

    def __init__(self, record, problem):
        self._record, self._problem, self._comm = record, problem, problem.space.comm

    def phases(self):
        """Seconds of the slowest rank by phase. *Collective.*

        Returns
        -------
        dict of str to float
            Each phase without those inside it; ``exchange`` is that inside all of them, ``other`` what is in none.
        """
        own = self._record.phases()
        largest, _ = profile.largest_and_sum(self._comm, own, own)
        return largest

    def parallel(self):
        """Search, exchange and imbalance. *Collective.*

        Returns
        -------
        dict
            ``search``: sums over the ranks, see :meth:`search`. ``exchange``: by phase ``messages`` and ``bytes`` of
            all ranks and of the rank with most; those of ``preconditioner`` and ``krylov`` are PETSc's. ``imbalance``:
            largest over mean of the ranks, 1 at best; of ``cells``, ``unknowns``, ``contact`` (points with a partner at
            the last search, times the unknowns that they couple) and ``candidates``.
        """
        return {"search": self.search(), "exchange": self._exchange(), "imbalance": self._imbalance()}

    def search(self):
        """Points and candidates of the searches in the load steps. *Collective.*

        Returns
        -------
        dict of str to float
            ``searches``; ``points`` that looked for a partner; ``asked``: to how many ranks they went; ``candidates``:
            target facets that were tried; both per point, too; ``gathered_bytes`` that each rank received from all
            others together: boxes, whose number does not depend on the mesh.
        """
        _, total = profile.largest_and_sum(self._comm, COUNTS, self._record.counts.get("search", {}))
        points, size = max(total["points"], 1.0), self._comm.size
        result = {name: int(value) for name, value in total.items()}
        result.update({name: result[name] // size for name in ("searches", "gathered_bytes")})
        result["ranks_per_point"] = total["asked"] / points
        result["candidates_per_point"] = total["candidates"] / points
        return result

    def _exchange(self):
        own = self._record.messages()
        names = [name for name in (*profile.STAGES, *profile.EVENTS, *profile.PETSC_EVENTS, profile.OTHER)
                 if name != "exchange"]  # fmt: skip
        tables = [
            profile.largest_and_sum(self._comm, names, {name: values[k] for name, values in own.items()})
            for k in (0, 1)
        ]
        (most, messages), (largest, size) = tables
        return {
            name: {
                "messages": int(messages[name]), "messages_largest": int(most[name]),
                "bytes": int(size[name]), "bytes_largest": int(largest[name]),
            }
            for name in names if messages[name] > 0
        }  # fmt: skip

    def _imbalance(self):
        space, parts = self._problem.space, self._problem.parts
        own = {
            "cells": sum(len(block.nodes) for block in space.mesh.blocks),
            "unknowns": space.n_owned * space.dim,
            "contact": sum(part.counters()["work"] for part in parts),
            "candidates": self._record.counts.get("search", {}).get("candidates", 0),
        }
        largest, total = profile.largest_and_sum(self._comm, own, own)
        return {name: largest[name] * self._comm.size / total[name] if total[name] > 0 else 1.0 for name in own}

    def memory(self):
        """Resident sets, in the order of the run. *Collective.*

        Returns
        -------
        dict of str to dict
            By mark: ``peak_mb`` and ``resident_mb``, sums over the ranks; ``peak_mb_largest`` of the largest rank;
            ``peak_bytes_per_unknown`` and ``resident_bytes_per_unknown``: what came after the start, over all unknowns.
        """
        self._record.memory["solve"] = profile.memory()
        marks, unknowns = self._record.memory, self._problem.space.n_dofs
        names = [(mark, k) for mark in MARKS for k in (0, 1)]
        own = {(mark, k): marks[mark][k] for mark, k in names if mark in marks}
        largest, total = profile.largest_and_sum(self._comm, names, own)
        start = total["start", 1]
        return {
            mark: {
                "peak_mb": total[mark, 0] / MB,
                "resident_mb": total[mark, 1] / MB,
                "peak_mb_largest": largest[mark, 0] / MB,
                "peak_bytes_per_unknown": max(total[mark, 0] - start, 0.0) / unknowns,
                "resident_bytes_per_unknown": max(total[mark, 1] - start, 0.0) / unknowns,
            }
            for mark in MARKS if mark in marks
        }  # fmt: skip

    def announce(self):
        """One line: search, exchange, imbalance. *Collective.*"""
        found, exchange, uneven = self.search(), self._exchange(), self._imbalance()
        if not found["searches"]:
            return
        size, messages = (sum(entry[key] for entry in exchange.values()) for key in ("bytes", "messages"))
        log.info(
            "search: %d for %d points, %.2f candidates and %.2f ranks a point | exchange: %d messages, %.3g MB, of the "
            "search %.3g MB | imbalance: cells %.2f, contact %.2f",
            found["searches"], found["points"], found["candidates_per_point"], found["ranks_per_point"], messages,
            size / MB, exchange.get("search", {"bytes": 0})["bytes"] / MB, uneven["cells"], uneven["contact"],
        )  # fmt: skip


def held(thing, shared=()):
    """Bytes of all arrays that an object reaches, by the attribute through which it reaches them.

    Parameters
    ----------
    thing : object
    shared : sequence
        Objects that are not its own: neither they nor what they hold directly counts.

    Returns
    -------
    dict of str to int
        Paths such as ``source.jxw``; arrays that overlap count once. Those of a list or dict count together.
    """
    result = {}
    seen = {id(one) for one in shared}
    for one in shared:
        seen.update(id(_whole(part)) for part in vars(one).values())
    _walk(thing, "", seen, result)
    return result


def _whole(thing):
    """The array of which another one is a view."""
    while isinstance(thing, np.ndarray) and isinstance(thing.base, np.ndarray):
        thing = thing.base
    return thing


def _walk(thing, path, seen, result):
    thing = _whole(thing)
    if id(thing) in seen or isinstance(thing, type) or callable(thing):
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        if thing.nbytes:
            result[path] = result.get(path, 0) + thing.nbytes
    elif isinstance(thing, dict):
        for part in thing.values():
            _walk(part, path, seen, result)
    elif hasattr(thing, "_asdict") or hasattr(thing, "__dict__"):
        # attributes that a name hides are the same thing to a reader of the report
        parts = thing._asdict() if hasattr(thing, "_asdict") else vars(thing)
        for name, part in parts.items():
            _walk(part, f"{path}.{name.lstrip('_')}" if path else name.lstrip("_"), seen, result)
    elif isinstance(thing, (list, tuple)):
        for part in thing:
            _walk(part, path, seen, result)


class Counters:
    """Of a run, from its beginning on.

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : sequence of pcontact.assembly.item.Item
    before : collections.Counter
        Calls of kernels before the run.
    """

    def __init__(self, space, parts, before):
        self._space, self._before = space, before
        self._parts = {part.name: part for part in parts}

    def __call__(self):
        """Counts of all ranks. *Collective.*

        Returns
        -------
        dict
            ``kernels``: calls by kernel; ``bytes``: by item and attribute (`held`); ``points``: quadrature points by
            item, where it keeps something at them; ``bytes_per_unknown``: of all items; ``bytes_per_point``: by item.
        """
        space, parts = self._space, self._parts
        shared = (space, space.mesh)
        own = {
            "kernels": dict(CALLS - self._before),
            "bytes": {name: held(part, shared) for name, part in parts.items()},
            "points": {name: part.counters()["points"] for name, part in parts.items()},
        }
        total = space.comm.allreduce(own, op=_sum)
        sizes = {name: sum(table.values()) for name, table in total["bytes"].items()}
        total["points"] = {name: count for name, count in total["points"].items() if count}
        total["bytes_per_unknown"] = sum(sizes.values()) / space.n_dofs
        total["bytes_per_point"] = {name: sizes[name] / count for name, count in total["points"].items()}
        return total


def _sum(a, b):
    """Sum of nested dicts of numbers."""
    names = sorted(a.keys() | b.keys())
    nested = {name for name in names if isinstance(a.get(name, b.get(name)), dict)}
    return {
        name: _sum(a.get(name, {}), b.get(name, {})) if name in nested else a.get(name, 0) + b.get(name, 0)
        for name in names
    }


def friction_bytes(d, rows):
    """Of a quadrature point: lag, slip reference and the jump before the step, d numbers each, the derivative of d - 1
    more components of the traction, ``rows`` bytes each, and of the law, d d numbers instead of one."""
    return 3 * 8 * d + (d - 1) * rows + 8 * (d * d - 1)


def plastic_bytes(d):
    """Of a quadrature point of the cells: plastic strain (6 components, 4 in the plane) and its accumulated norm."""
    return 8 * (7 if d == 3 else 5)


def cost_forecast(problem, scene):
    """Lines for the user. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    scene : pcontact.scene.model.Scene

    Returns
    -------
    list of str
    """
    space = problem.space
    counts = Counters(space, problem.parts, CALLS)()
    lines = []
    for name, table in counts["bytes"].items():
        size, points = sum(table.values()), counts["points"].get(name)
        each = f", {size / points:.0f} bytes at each of {points} points" if points else ""
        lines.append(f"{name}: {size / MB:.3g} MB{each or f', {size / space.n_dofs:.0f} bytes per unknown'}")
    cells = space.comm.allreduce(sum(n_points(space, k) * len(table) for k, table in enumerate(space.cells)))
    contacts = [contact for contact in scene.contacts if not contact.tied]
    smooth = [contact.name for contact in contacts if not (contact.friction or contact.tresca or contact.law)]
    points = sum(counts["points"].get(name, 0) for name in smooth)
    if points:
        rows = sum(counts["bytes"].get(name, {}).get(ROWS, 0) for name in smooth) / points
        lines.append(_more("friction", points, friction_bytes(space.dim, rows), FRICTION_TIMES))
    if not scene.plastic:
        lines.append(_more("plasticity of all bodies", cells, plastic_bytes(space.dim), PLASTIC_TIMES))
    if not any(scene.finite(body) for body in scene.bodies):
        held = sum(sum(counts["bytes"].get(contact.name, {}).values()) for contact in contacts)
        lines.append(f"more with finite strain of all bodies: up to {(MOVING - 1.0) * held / MB:.3g} MB for contact "
                     f"that moves, none for elastic bodies, a load step {FINITE_TIMES} times as long")  # fmt: skip
    biased = [contact.name for contact in contacts if contact.obstacle is None and not contact.unbiased
              and not contact.all and contact.source != contact.target]  # fmt: skip
    if biased:
        size = sum(sum(counts["bytes"][name].values()) for name in biased)
        lines.append(f"more with unbiased contact: about {size / MB:.3g} MB, and twice the search and contact assembly")
    return lines


def _more(name, points, size, times):
    each = f"({size:.0f} bytes at each of {points} points)"
    return f"more with {name}: {points * size / MB:.3g} MB for the state {each}, a load step {times} times as long"
