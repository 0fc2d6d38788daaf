"""What watches a run: terminal, history, report, fields."""

import time as clock

import numpy as np

from pcontact.element.reference import MESHIO_NAMES
from pcontact.io.fields import Cloud, FieldWriter, Piece
from pcontact.io.history import History
from pcontact.io.report import Report
from pcontact.material.elastic import equivalent_stress
from pcontact.runtime import log


class Terminal:
    """One line per load step, and why a step was cut.

    Parameters
    ----------
    end : float
        Time at which the run ends.
    """

    def __init__(self, end):
        self._progress = log.Progress(end, "load")

    def step(self, step, u, record):
        """Print the step."""
        parts = [
            f"step {step.number}  time {step.time:.6g}  newton {step.newton}  krylov {step.krylov}  "
            f"residual {step.residual:.2e}  imbalance {record['imbalance']:.1e}"
        ]
        for name, c in record["contacts"].items():
            at = " ".join(f"{v + 0.0:.4g}" for v in c["deepest"])
            parts.append(
                f"{name}: open {c['open']} stick {c['stick']} slip {c['slip']} flipped {c['flipped']}  "
                f"penetration {c['max_penetration']:.3e} at ({at})  pressure {c['max_pressure']:.6g}  "
                f"force {' '.join(f'{v + 0.0:.6g}' for v in c['force'])}"
            )
        log.info("%s", " | ".join(parts))
        self._progress.to(step.time)

    def cut(self, target, outcome):
        """Print why."""
        log.info(
            "step to time %.6g cut back: %s after %d iterations, residual %.3e from %.3e%s%s",
            target, outcome.reason, outcome.newton, outcome.residual, outcome.initial,
            "; " if outcome.detail else "", outcome.detail,
        )  # fmt: skip

    def end(self, converged):
        """Take the bar away."""
        self._progress.close()


class Records:
    """history.csv and report.json, on rank 0.

    Parameters
    ----------
    directory : pathlib.Path
    rank : int
    head : dict
        First entries of the report.
    timing : dict
        Seconds, read at every write.
    finish : callable
        Returns the timing block of the report. *Collective.*
    resume_time : float, optional
        Rows of an earlier run up to this time are kept.
    """

    def __init__(self, directory, rank, head, finish, resume_time=None):
        self._rank, self._finish = rank, finish
        if rank == 0:
            self._history = History(directory / "history.csv", resume_time)
            self.report = Report(directory / "report.json", resume_time)
            self.report.data.update(head)

    def step(self, step, u, record):
        """Append the step to both files. *Collective.*"""
        timing = self._finish()
        if self._rank == 0:
            self._history.append(record)
            self.report.data["timing"] = timing
            self.report.add_step(record)

    def cut(self, target, outcome):
        """Nothing is written."""

    def end(self, converged):
        """Write the verdict. *Collective.*"""
        timing = self._finish()
        if self._rank == 0:
            self.report.data.update({"converged": converged, "timing": timing})
            self.report.write()


class Fields:
    """Fields of every step, for ParaView.

    Parameters
    ----------
    directory : pathlib.Path
    problem : pcontact.solve.problem.Problem
    timing : dict
        ``output`` seconds are added.
    resume_time : float, optional
        Steps of an earlier run up to this time are kept.
    """

    def __init__(self, directory, problem, timing, resume_time=None):
        self._writer = FieldWriter(directory, problem.space.comm, resume_time)
        self._problem, self._timing = problem, timing

    def step(self, step, u, record):
        """Write the step. *Collective.*"""
        start = clock.perf_counter()
        surfaces, points = {}, {}
        for item in self._problem.items[1:]:
            state = item.state(u)
            surfaces[item.name] = self._surface(item, state, u)
            points[item.name] = _cloud(state)
        self._writer.write(step.number, step.time, self._bodies(u), surfaces, points)
        self._timing["output"] += clock.perf_counter() - start

    def cut(self, target, outcome):
        """Nothing is written."""

    def end(self, converged):
        """All is written already."""

    def _bodies(self, u):
        space = self._problem.space
        mesh = space.mesh
        stress = self._problem.items[0].stress(u)
        cells, data = [], {"stress": [], "equivalent_stress": [], "body": [], "rank": []}
        for number, block in enumerate(mesh.blocks):
            table = space.cells[number]
            cells.append((MESHIO_NAMES[(block.cell, space.degree)], table))
            data["stress"].append(stress[number][0])
            data["equivalent_stress"].append(equivalent_stress(stress[number][0]))
            data["body"].append(np.full(len(table), block.body, dtype=np.int32))
            data["rank"].append(np.full(len(table), space.comm.rank, dtype=np.int32))
        return Piece(space.points, cells, {"displacement": space.local.gather(u)}, data)

    def _surface(self, item, state, u):
        """Source facets with the means of their quadrature points."""
        space, mesh = self._problem.space, self._problem.space.mesh
        facet, n = item.source.facet, len(item.source.cells)
        area = np.bincount(facet, state["weight"], minlength=n)
        mean = {}
        for name, key in (("contact_pressure", "pressure"), ("gap", "gap")):
            mean[name] = np.bincount(facet, state["weight"] * state[key], minlength=n) / area
        closed = np.bincount(facet, state["status"] > 0, minlength=n)
        mean["status"] = np.where(closed > 0, 2, 0)
        mean["area"] = area
        cells, data, first = [], {name: [] for name in mean}, 0
        for facets in mesh.facet_groups.get(item.contact.source, []):
            block = mesh.blocks[facets.block]
            table = space.facet_nodes(facets)
            cells.append((MESHIO_NAMES[(space.facet_kind(block), space.degree)], table))
            for name, values in mean.items():
                data[name].append(values[first : first + len(table)])
            first += len(table)
        return Piece(space.points, cells, {"displacement": space.local.gather(u)}, data)


def _cloud(state):
    keys = ("pressure", "gap", "traction", "normal", "status", "weight")
    return Cloud(state["x"], {key: state[key] for key in keys})
