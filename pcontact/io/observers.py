"""What watches a run: terminal, history, report, fields."""

import time as clock

import numpy as np

from pcontact.contact.smooth_geometry import SMOOTH, WRONG, facet_pressure
from pcontact.element.reference import MESHIO_NAMES
from pcontact.io.fields import NODE_NUMBER, Cloud, FieldWriter, Piece
from pcontact.io.history import History
from pcontact.io.report import Report
from pcontact.io.smooth import NodeMeans
from pcontact.material.elastic import equivalent_stress
from pcontact.runtime import log
from pcontact.runtime.parallel import on_root


class Terminal:
    """One line per load step, and why a step was cut.

    Parameters
    ----------
    end : float
        Time at which the run ends.
    volume : float
        Of the bodies that may yield; 0 without any [length^d].
    """

    def __init__(self, end, volume=0.0):
        self._progress, self._volume = log.Progress(end, "load"), volume

    def step(self, step, u, record):
        """Print the step."""
        parts = [
            f"step {step.number}  time {step.time:.6g}  newton {step.newton}  krylov {step.krylov}  "
            f"residual {step.residual:.2e}  imbalance {record['imbalance']:.1e}"
        ]
        if "uzawa" in record:
            parts.append(f"multipliers: {record['uzawa']['updates']} updates, change {record['uzawa']['change']:.1e}")
        if self._volume > 0.0:
            plastic = record["plastic"]
            part, strain = plastic["yielded_volume"] / self._volume, plastic["max_equivalent_strain"]
            parts.append(f"yielded {100.0 * part:.1f} % (max strain {strain:.4g})")
        if "estimate" in record:
            parts.append(f"error {100.0 * record['estimate']['relative']:.3g} %")
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


class FacetErrors:
    """Warns, at the end of the run, of pairs whose straight facets put the pressure wrong.

    Parameters
    ----------
    items : list of ContactItem or UnbiasedItem
    """

    def __init__(self, items):
        self._items, self._worst = items, {}

    def step(self, step, u, record):
        """Keep the step with the largest pressure of each pair: under a small one any gap is large."""
        for name, pair in record["contacts"].items():
            pressure, *_ = self._worst.get(name, (0.0,))
            if pair.get("facet_error", 0.0) > 0.0 and pair["max_pressure"] > pressure:
                self._worst[name] = pair["max_pressure"], pair["facet_error"], step.time

    def cut(self, target, outcome):
        """A step that failed has no pressure."""

    def end(self, converged):
        """Warn. *Collective.*"""
        for item in self._items:
            _, error, time = self._worst.get(item.name, (0.0, 0.0, 0.0))
            if error > WRONG:
                _, gap = facet_pressure(getattr(item, "halves", [item]))
                log.warning(
                    "contact %s: gaps of up to %.2g between straight facets of curved surfaces that conform put the "
                    "pressure wrong by %s (in L2, time %g): they are %.2g times what it does to a layer of cells; "
                    "remedy: %s",
                    item.name, gap, "100 % or more" if error > 1.0 else f"about {100.0 * error:.0f} %", time, error,
                    SMOOTH,
                )  # fmt: skip


class Records:
    """history.csv and report.json, on rank 0.

    Parameters
    ----------
    directory : pathlib.Path
    comm : MPI.Comm
    head : dict
        First entries of the report.
    finish : callable
        Returns the blocks of the report on what the run has cost: timing, parallel, memory. *Collective.*
    resume_time : float, optional
        Rows of an earlier run up to this time are kept.

    Raises
    ------
    InputError
        On every rank: files of the earlier run cannot be read.
    """

    def __init__(self, directory, comm, head, finish, resume_time=None):
        self._comm, self._finish = comm, finish
        on_root(comm, self._open, directory, head, resume_time)

    def _open(self, directory, head, resume_time):
        self._history = History(directory / "history.csv", resume_time)
        self.report = Report(directory / "report.json", resume_time)
        self.report.data.update(head)

    def step(self, step, u, record):
        """Append the step to both files. *Collective.*

        Raises
        ------
        OutputError
            On every rank.
        """
        on_root(self._comm, self._step, record, self._finish())

    def _step(self, record, costs):
        self._history.append(record)
        self.report.data.update(costs, warnings=log.warnings())
        if "estimate" in record:
            self.report.data["estimate"].update(record["estimate"])
        self.report.add_step(record)

    def cut(self, target, outcome):
        """Nothing is written."""

    def end(self, converged):
        """Write the verdict. *Collective.*

        Raises
        ------
        OutputError
            On every rank.
        """
        on_root(self._comm, self._end, converged, self._finish())

    def _end(self, converged, costs):
        self.report.data.update({"converged": converged, "warnings": log.warnings(), **costs})
        self.report.write()


class Fields:
    """Fields of every step, for ParaView.

    Parameters
    ----------
    directory : pathlib.Path
    problem : pcontact.solve.problem.Problem
    timing : dict
        ``output`` seconds are added.
    smooth : bool
        Write the fields of the cells averaged at the nodes too.
    resume_time : float, optional
        Steps of an earlier run up to this time are kept.
    estimate : pcontact.io.error_estimate.ErrorEstimate, optional
        Observer that has estimated the error of the step before.
    """

    def __init__(self, directory, problem, timing, smooth=False, resume_time=None, estimate=None):
        self._writer = FieldWriter(directory, problem.space.comm, resume_time)
        self._problem, self._timing = problem, timing
        self._means = NodeMeans(problem.space) if smooth else None
        self._estimate = estimate

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
        space, bulk = self._problem.space, self._problem.items[0]
        blocks, stress = space.mesh.blocks, bulk.stress(u)
        data = {
            "stress": [values for values, _ in stress],
            "equivalent_stress": [equivalent_stress(values) for values, _ in stress],
        }
        if hasattr(bulk, "plastic_strain"):
            data["equivalent_plastic_strain"] = bulk.plastic_strain()
        points, tables, nodal = space.points, space.cells, {"displacement": space.local.gather(u)}
        numbers = space.mesh.file_nodes[space.mesh_nodes]
        if self._means is not None:
            means = self._means(data, [volume for _, volume in stress])
            nodes, tables = self._means.nodes, self._means.cells
            points, nodal, numbers = points[nodes], {"displacement": nodal["displacement"][nodes]}, numbers[nodes]
            nodal.update({f"{name}_smooth": values for name, values in means.items()})
        # by which the pieces of several ranks are put together, where other nodes are in the same place, too
        nodal[NODE_NUMBER] = numbers.astype(np.int32 if space.mesh.n_nodes_total < 2**31 else np.int64)
        if self._estimate is not None:
            data["error_estimate"] = self._estimate.cells
            data["cell_number"] = [block.ids for block in blocks]
        data["body"] = [np.full(len(block.nodes), block.body, dtype=np.int32) for block in blocks]
        data["rank"] = [np.full(len(block.nodes), space.comm.rank, dtype=np.int32) for block in blocks]
        names = [MESHIO_NAMES[(block.cell, space.degree)] for block in blocks]
        return Piece(points, list(zip(names, tables, strict=True)), nodal, data)

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
        names = getattr(item, "surfaces", (item.contact.source,))
        for facets in (part for name in names for part in mesh.facet_groups.get(name, [])):
            block = mesh.blocks[facets.block]
            table = space.facet_nodes(facets)
            cells.append((MESHIO_NAMES[(space.facet_kind(block), space.degree)], table))
            for name, values in mean.items():
                data[name].append(values[first : first + len(table)])
            first += len(table)
        return Piece(space.points, cells, {"displacement": space.local.gather(u)}, data)


def _cloud(state):
    keys = ("pressure", "gap", "traction", "normal", "status", "weight", "paired")
    return Cloud(state["x"], {key: state[key] for key in keys})
