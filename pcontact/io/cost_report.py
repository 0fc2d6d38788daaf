"""What a run costs, for the report: time, messages and memory of its phases, and how evenly the work is spread."""

from pcontact.runtime import log, profile

# marks of the memory, in their order
MARKS = ("start", "read", "distribute", "set_up", "assembly", "solve")
# what the searches count
COUNTS = ("searches", "points", "asked", "candidates", "gathered_bytes")
MB = 1024.0**2


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
        return {name: _over_mean(largest[name], total[name], self._comm.size) for name in own}

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


def _over_mean(largest, total, size):
    return largest * size / total if total > 0 else 1.0
