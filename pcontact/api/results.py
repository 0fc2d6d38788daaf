"""Results of a run: fields, contacts, history, report; kept in memory, saved, and loaded again."""

from __future__ import annotations

import tempfile
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pcontact.api.fields import Fields
from pcontact.api.tables import Named, Table, html, shown
from pcontact.io.fields import FieldWriter
from pcontact.io.names import STATUS
from pcontact.io.report import History, Report, columns, jsonable, read_report
from pcontact.io.result import has_fields, load_result
from pcontact.io.vtu import CELL_TYPES, SOLID
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import discard, reason
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

# of a contact in the report, and how they are shown
NUMBERS = {
    "force": "force", "normal_force": "normal force", "friction_force": "friction force", "area": "closed area",
    "max_pressure": "largest pressure", "max_penetration": "penetration", "open": "open", "stick": "stick",
    "slip": "slip",
}  # fmt: skip


class ContactResult:
    """A contact at the end of the last load step that converged: this rank's quadrature points.

    Attributes
    ----------
    x : ndarray (np, d)
        Places of the points in the undeformed bodies [length].
    pressure, gap : ndarray (np,)
        Contact pressure [stress] and gap [length].
    status : ndarray of int (np,)
        0 open, 1 stick, 2 slip; without friction closed points slip.
    status_names : ndarray of str (np,)
        The same in words.
    traction, normal : ndarray (np, d)
    weight : ndarray (np,)
        Area of each point.
    force : ndarray (d,)
        On the target, of all ranks [force].
    report : dict
        As in ``report.json``: force, area, largest pressure and penetration, numbers of points.
    """

    def __init__(self, data: dict[str, np.ndarray], report: dict[str, Any]) -> None:
        self.x, self.pressure, self.gap, self.status = (data[key] for key in ("x", "pressure", "gap", "status"))
        self.status_names = np.array(STATUS)[np.asarray(self.status, dtype=int)]
        self.traction, self.normal, self.weight = data["traction"], data["normal"], data["weight"]
        self.report = report
        self.force = np.array(report.get("force", []), dtype=float)

    def __repr__(self) -> str:
        words = ", ".join(f"{words} {shown(self.report[key])}" for key, words in NUMBERS.items() if key in self.report)
        return f"<ContactResult: {len(self.x)} points; {words}>"

    def _repr_html_(self) -> str:
        return html(("", ""), [(words, self.report[key]) for key, words in NUMBERS.items() if key in self.report])


class Picture:
    """A picture in memory: a notebook shows it; ``save`` writes it."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    def _repr_png_(self) -> bytes:
        return self._content

    def save(self, path: str | Path) -> Path:
        """Write it as PNG."""
        Path(path).write_bytes(self._content)
        return Path(path)


class Run:
    """Results of a run.

    Attributes
    ----------
    converged : bool
        Whether all load steps converged, to the end of the run.
    stopped : bool
        Whether `on_step` ended it.
    report : dict
        What ``report.json`` holds; the same on every rank.
    history : dict of str to ndarray (n_steps,)
        The columns of ``history.csv``: `history["time"]`, a :class:`Table`.
    unused : list of str
        A line for each option that nothing asked for.
    """

    def __init__(
        self, report: dict[str, Any], fields: Fields | None, comm: Any, steps: list[Any] | None = None
    ) -> None:
        self.report = report
        self.converged, self.stopped, self.unused = bool(report.get("converged")), False, list[str]()
        self.history = Table(columns(report["steps"] if steps is None else steps))
        self._fields, self._comm = fields, comm
        self._taken: Any = None
        self._directory: Path | None = None

    @classmethod
    def of(cls, simulation: Any, converged: bool) -> Run:
        """That of a simulation that has ended. *Collective.*"""
        data = simulation.records.data()
        taken = simulation.snapshot.taken
        made = cls(jsonable(data), None if taken is None else Fields.of(taken), simulation.comm, data["steps"])
        made.converged, made.stopped, made.unused = converged, simulation.stopped, simulation.unused()
        made._taken = taken
        return made

    def __repr__(self) -> str:
        fields = [] if self._fields is None else [*self._fields.point_data, *self._fields.cell_data]
        return f"<Run: {self._how()}; contacts {', '.join(self._contacts()) or 'none'}; fields {', '.join(fields)}>"

    def _how(self) -> str:
        ended = "converged" if self.converged else "stopped" if self.stopped else "ended early"
        to = f" to time {self.steps[-1]['time']:g}" if self.steps else ""
        said = f", {len(self.warnings)} warnings" if self.report.get("warnings") else ""
        return f"{ended}, {len(self.steps)} load steps{to}{said}"

    def _contacts(self) -> dict[str, Any]:
        return self.steps[-1]["contacts"] if self.steps else {}

    def _repr_html_(self) -> str:
        contacts = self._contacts()
        known = [key for key in NUMBERS if any(key in one for one in contacts.values())]
        rows = [[name, *(one.get(key) for key in known)] for name, one in contacts.items()]
        words = html(["contact", *(NUMBERS[key] for key in known)], rows) if rows else ""
        largest = self.steps[-1].get("largest", {}) if self.steps else {}
        tops = [[name.replace("_", " "), one["value"], one["body"], one["place"]] for name, one in largest.items()]
        words += html(("largest", "", "body", "place"), tops) if tops else ""
        said = "".join(f"<li>{escape(line)}</li>" for line in self.report.get("warnings", []))
        return f"<p>{escape(self._how())}</p>{words}" + (f"<ul>{said}</ul>" if said else "")

    @property
    def warnings(self) -> list[str]:
        """Warnings of the run, a list of lines."""
        return self.report["warnings"]

    @property
    def steps(self) -> list[dict[str, Any]]:
        """The load steps as in ``report.json``."""
        return self.report["steps"]

    @property
    def displacement(self) -> np.ndarray:
        """Displacement of this rank's nodes (n, d) [length]."""
        return self.fields().displacement

    @property
    def stress(self) -> np.ndarray:
        """Mean stress of this rank's cells (n_cells, 6): XX, YY, ZZ, XY, YZ, XZ [stress]."""
        return self.fields().stress

    @property
    def contact(self) -> dict[str, ContactResult]:
        """Contacts by their names: ``run.contact["skin-top"].pressure``."""
        last, found = self._contacts(), self.fields().contacts
        return Named({name: ContactResult(data, last.get(name, {})) for name, data in found.items()})

    def table(self) -> Table:
        """The history; ``table().to_pandas()`` is a pandas.DataFrame."""
        return self.history

    def fields(self) -> Fields:
        """The fields at the end of the last load step that converged, this rank's part.

        Returns
        -------
        Fields

        Raises
        ------
        LookupError
            No load step converged.
        """
        if self._fields is None:
            raise LookupError("no load step has converged: there are no fields")
        return self._fields

    def gather(self, everywhere: bool = False) -> Fields | None:
        """The same of all ranks, nodes and cells in the order of the mesh file. *Collective.*

        Parameters
        ----------
        everywhere : bool
            On every rank, not on rank 0 alone.

        Returns
        -------
        Fields or None
            None on ranks that do not get it.
        """
        return self.fields().gather(self._comm, everywhere)

    def to_pyvista(self) -> Any:
        """The bodies with their fields, of all ranks. *Collective.*

        Returns
        -------
        pyvista.UnstructuredGrid or None
            None but on rank 0. Vectors have three components.
        """
        whole = self.gather()
        return None if whole is None else _grid(whole)

    def plot(self, field: str | None = None, output: str | Path | None = None, **look: Any) -> Any:
        """Draw it as ``pcontact view`` does. *Collective.*

        Parameters
        ----------
        field : str, optional
            As the option ``-field``.
        output : str or pathlib.Path, optional
            A picture, a page (.html) or an animation; absent: a picture in memory, which a notebook shows.
        **look
            `step`, `scale`, `size`, `cut`, `smooth`, `views`, as the options of ``pcontact view``.

        Returns
        -------
        Picture, pathlib.Path or None
            What was written, or the picture; None but on rank 0.
        """
        with tempfile.TemporaryDirectory() as scratch:
            folder = self._directory
            if folder is None:
                folder = Path(self._comm.bcast(scratch))
                self._write_fields(folder)
            drawn = on_root(self._comm, _drawn, folder, field, output, look)
            # the others' directories are theirs alone; that of rank 0 goes when all are done
            self._comm.Barrier()
        return drawn if self._comm.rank == 0 else None

    def save(self, directory: str | Path) -> Path:
        """Write report, history and the fields of the last load step, as the command line does. *Collective.*

        Returns
        -------
        pathlib.Path
        """
        directory = Path(directory)
        on_root(self._comm, _write_numbers, directory, self.report, self.steps)
        if self._fields is not None:
            self._write_fields(directory)
        return directory

    def _write_fields(self, directory: Path) -> None:
        if self._taken is None:
            raise LookupError("the fields of a run that was loaded are where they were loaded from")
        taken = self._taken
        FieldWriter(directory, self._comm).write(taken.number, taken.time, taken.bodies, taken.surfaces, taken.points)


def load(directory: str | Path, step: int = -1, comm: Any = None) -> Run:
    """Load what a run has written: report, history and the fields of a load step, whole on every rank.

    Parameters
    ----------
    directory : str or pathlib.Path
        The output directory of a run.
    step : int
        Which of the load steps whose fields are there, from 1; negative numbers count from the last one; 0: the
        undeformed bodies.
    comm : MPI.Comm, optional
        Of the ranks that draw it together; absent: this rank alone.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        There is no report.
    """
    directory = Path(directory)
    try:
        report = read_report(directory)
    except (OSError, ValueError, TypeError) as problem:
        why = reason(problem) if isinstance(problem, OSError) else problem
        raise InputError(
            f"{directory}: found no report.json that can be read ({why}); allowed: the output directory of a run"
        ) from None
    fields = _loaded(directory, step) if has_fields(directory) else None
    run = Run(report, fields, MPI.COMM_SELF if comm is None else comm)
    run._directory = directory
    return run


def _loaded(directory: Path, step: int) -> Fields:
    """The fields of a load step from its files; nodes in the order of their numbers."""
    result = load_result(directory, step)
    bodies = result.bodies
    d = 3 if any(CELL_TYPES[name][0] in SOLID for name, _ in bodies.cells) else 2

    def cut(name: str, array: np.ndarray) -> np.ndarray:
        return array[:, :d] if array.ndim == 2 and array.shape[1] == 3 and d == 2 else array

    contacts = {name: {"x": cloud.points[:, :d], **{key: cut(key, array) for key, array in cloud.point_data.items()}}
                for name, cloud in result.points.items()}  # fmt: skip
    point_data = {name: cut(name, array) for name, array in bodies.point_data.items()}
    cell_data = {name: np.concatenate(arrays) for name, arrays in bodies.cell_data.items()}
    n_cells = sum(len(nodes) for _, nodes in bodies.cells)
    numbers = (np.arange(len(bodies.points)), np.arange(n_cells))
    number = step if step >= 0 else len(result.times) + 1 + step
    return Fields(number, result.time, bodies.points[:, :d], list(bodies.cells),
                  (*numbers, point_data, cell_data), contacts)  # fmt: skip


def _drawn(folder: Path, field: str | None, output: str | Path | None, look: dict[str, Any]) -> Any:
    from pcontact.view import extra
    from pcontact.view.show import show

    words = {name: _word(value) for name, value in look.items()}
    if field is not None:
        words["field"] = field
    if output is not None:
        return show(str(folder), {**words, "o": str(output)})
    extra.require()
    with tempfile.TemporaryDirectory() as scratch:
        path = show(str(folder), {**words, "o": str(Path(scratch) / "picture.png")})
        return Picture(Path(path).read_bytes())


def _word(value: Any) -> str:
    """A value as the command line has it."""
    if isinstance(value, (tuple, list)):
        return ("x" if all(isinstance(one, int) for one in value) else ",").join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def _write_numbers(directory: Path, report: dict[str, Any], steps: list[dict[str, Any]]) -> None:
    saved = Report(directory, keep=False)
    saved.data = {name: value for name, value in report.items() if name != "steps"}
    saved.begin()
    for step in report["steps"]:
        saved.add_step(step)
    saved.write()
    discard(directory / "history.csv")
    history = History(directory / "history.csv")
    for step in steps:
        history.append(step)


def _grid(fields: Fields) -> Any:
    import pyvista

    pad = ((0, 0), (0, 3 - fields.points.shape[1]))
    rows = [np.column_stack([np.full(len(nodes), nodes.shape[1]), nodes]).ravel() for _, nodes in fields.cells]
    kinds = [np.full(len(nodes), CELL_TYPES[name][0], dtype=np.uint8) for name, nodes in fields.cells]
    grid = pyvista.UnstructuredGrid(np.concatenate(rows), np.concatenate(kinds), np.pad(fields.points, pad))
    d = fields.points.shape[1]
    for target, data in ((grid.point_data, fields.point_data), (grid.cell_data, fields.cell_data)):
        for name, array in data.items():
            target[name] = np.pad(array, pad) if array.ndim == 2 and array.shape[1] == d == 2 else np.array(array)
    return grid
