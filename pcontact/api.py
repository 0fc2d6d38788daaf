"""The Python API: scenes read and run in memory. ``import pcontact as pc`` has its names.

A run is a function call: it writes nothing unless asked, reads no command line, has PETSc options of its own, shows
nothing, raises what goes wrong, and leaves nothing behind but what it returns.
"""

# ruff: noqa: E402
from pcontact.runtime import start
from pcontact.runtime.observer import Observer

# before PETSc starts: the command line is the caller's
start.as_library()

import warnings
from collections.abc import Mapping

import numpy as np

from pcontact.adapt.loop import Loop
from pcontact.adapt.target import wanted
from pcontact.io.fields import NODE_NUMBER
from pcontact.io.history import columns
from pcontact.io.report import jsonable
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD, NotConverged, Stopped
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, own_options
from pcontact.scene import Scene, read_scene, scene_from
from pcontact.simulation import Simulation

__all__ = ["Fields", "Run", "Scene", "Step", "from_dict", "read", "run"]


def read(path, **changes):
    """Read and check a scene file.

    Parameters
    ----------
    path : str or pathlib.Path
        A TOML file.
    **changes
        Keys of the scene with other values: ``steps={"count": 4}``, ``materials={"soft": {"E": 3.0}}``. Tables are
        merged, None takes a key out; in lists of tables a dict names those that change, contacts by ``name``, the
        others by ``region``: ``contacts={"ball-block": {"friction": 0.3}}``.

    Returns
    -------
    pcontact.scene.model.Scene
        Its attributes are the keys of the file and may be changed; :func:`run` checks them again.

    Raises
    ------
    InputError
        One line: the file, the key, what was found, what is allowed.
    """
    return read_scene(path, changes)


def from_dict(data, folder=None):
    """A scene from a dict with the keys of a scene file, with the same checks.

    Parameters
    ----------
    data : dict
        Dicts for tables, lists for lists of tables; arrays and numbers of numpy and paths are taken as well.
    folder : str or pathlib.Path, optional
        Where the mesh and other files are; absent: the working directory.

    Returns
    -------
    pcontact.scene.model.Scene

    Raises
    ------
    InputError
    """
    return scene_from(data, folder)


def run(scene, options=None, on_step=None, output=None, comm=None, level=None, check=True):
    """Run a scene. *Collective* on the ranks of `comm`.

    Parameters
    ----------
    scene : Scene, str, pathlib.Path or dict
        A file is read, a dict is taken as by :func:`from_dict`. It is left as it is.
    options : dict or str, optional
        Options of this run, of pcontact and of PETSc: ``{"snes_rtol": 1e-10}`` or ``"-snes_rtol 1e-10"``. They win over
        the scene. Those of the process (``PETSC_OPTIONS``, ``petsc4py.init``) are neither used nor changed.
    on_step : callable, optional
        Called with a :class:`Step` after each load step, when it has been committed and written, on every rank. False
        ends the run, if any rank returns it.
    output : str or pathlib.Path, optional
        Directory for what the command line writes; absent: nothing is written.
    comm : MPI.Comm, optional
        Absent: all ranks.
    level : {"error", "warning", "info", "debug"}, optional
        Lines as important as this are shown on standard output. Absent: none, unless the caller's own logging takes
        them from the logger "pcontact".
    check : bool
        Raise NotConverged where a load step does not converge; otherwise the run is returned as far as it got.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        The scene, the mesh or an option is wrong; on every rank.
    OutputError
        A file cannot be written; on every rank.
    NotConverged
        A load step did not converge; its attribute ``run`` is the run up to the last one that did.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    with log.of_a_library(comm.rank, level), own_options():
        Options("options").give(options or {})
        if isinstance(scene, Mapping):
            scene = from_dict(scene)
        elif not isinstance(scene, Scene):
            scene = read(scene)
        aimed = wanted(scene, Options("options"))
        if aimed is not None:
            result, failure = _reach(aimed, comm, on_step, output)
        else:
            result, failure = _run(Simulation(scene, comm, "options"), on_step, output)
    if comm.rank == 0:
        for text in result.unused:
            warnings.warn(text, UserWarning, stacklevel=2)
    if failure is not None and check:
        raise NotConverged(str(failure), result) from None
    return result


def _run(simulation, on_step, output):
    """The result and the failure of a simulation, which is freed. *Collective.*"""
    together = simulation.comm.size == 1
    try:
        observers = [] if on_step is None else [_Caller(on_step, simulation)]
        converged = simulation.run(output, observers, keep=True, said="output")
        result, failure = Run(simulation, converged), simulation.failure
        together = True
    except (*TOLD, _OnStepFailed) as error:
        together = True
        if isinstance(error, _OnStepFailed):
            raise error.own from None
        raise
    finally:
        # what one rank alone meets is no reason for it to wait for the others
        if together:
            simulation.free()
    return result, failure


def _reach(scene, comm, on_step, output):
    """The result and the failure of the runs that reach an error. *Collective.*"""

    def observers(simulation):
        return [] if on_step is None else [_Caller(on_step, simulation)]

    try:
        outcome = Loop(scene, comm, "options", Run, observers).run(output, "output")
    except _OnStepFailed as error:
        raise error.own from None
    return outcome.kept, outcome.failure


class _OnStepFailed(Exception):
    """The caller's function failed on some rank; `own` is what this rank raises."""

    def __init__(self, own):
        super().__init__()
        self.own = own


class _Caller(Observer):
    """Observer that calls the caller's function."""

    def __init__(self, function, simulation):
        self._function, self._simulation = function, simulation

    def step(self, step, u, record):
        """Call it, and have all ranks do the same afterwards. *Collective.*"""
        comm, error, stops = self._simulation.comm, None, False
        try:
            stops = self._function(Step(step, record, self._simulation)) is False
        except Exception as problem:
            error = problem
        told = comm.allgather((stops, None if error is None else f"{type(error).__name__}: {error}"))
        failed = [(rank, text) for rank, (_, text) in enumerate(told) if text is not None]
        if failed:
            rank, text = failed[0]
            raise _OnStepFailed(error or RuntimeError(f"on_step failed on rank {rank}: {text}"))
        if any(one for one, _ in told):
            raise Stopped


class Step:
    """A load step that has been committed.

    Attributes
    ----------
    number : int
        From 1.
    time : float
        At its end.
    newton, krylov, cutbacks : int
        Iterations of the solve that converged, and attempts before it that did not.
    report : dict
        As in ``report.json``: reactions, contacts (force, area, largest pressure, ...), probes, ...; the same on every
        rank.
    """

    def __init__(self, step, record, simulation):
        self.number, self.time, self.report = step.number, step.time, jsonable(record)
        self.newton, self.krylov, self.cutbacks = step.newton, step.krylov, step.cutbacks
        self._taken, self._fields = simulation.snapshot.taken, None
        self._comm = simulation.comm

    def fields(self):
        """The fields at its end, this rank's part: :class:`Fields`."""
        if self._fields is None:
            self._fields = Fields.of(self._taken)
        return self._fields

    def gather(self, everywhere=False):
        """The fields of all ranks, see :meth:`Run.gather`. *Collective.*"""
        return self.fields().gather(self._comm, everywhere)


class Run:
    """What a run has found.

    Attributes
    ----------
    converged : bool
        Whether all load steps converged, to the end of the run.
    stopped : bool
        Whether `on_step` ended it.
    report : dict
        What ``report.json`` holds; the same on every rank.
    history : dict of str to ndarray (n_steps,)
        The columns of ``history.csv``.
    unused : list of str
        A line for each option that nothing asked for.
    """

    def __init__(self, simulation, converged):
        data = simulation.records.data()
        self.converged, self.stopped = converged, simulation.stopped
        self.history, self.report = columns(data["steps"]), jsonable(data)
        self.unused = simulation.unused()
        taken = simulation.snapshot.taken
        self._fields = None if taken is None else Fields.of(taken)
        self._comm = simulation.comm

    @property
    def warnings(self):
        """What the run warned of, a list of lines."""
        return self.report["warnings"]

    def fields(self):
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

    def gather(self, everywhere=False):
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


class Fields:
    """Fields at the end of a load step, with d the dimension of space. Arrays are not to be written to.

    Attributes
    ----------
    number, time : int, float
        Of the load step.
    points : ndarray (n, d)
        Coordinates of the nodes in the undeformed state [length].
    node_numbers : ndarray (n,)
        Place of each node in the mesh file, from 0, without nodes that no cell has; nodes that the program has added
        to cells of degree 1 come after.
    cells : list of (str, ndarray (nc, nn))
        Blocks of cells: the type as meshio calls it, nodes as rows of `points`, in VTK's order.
    cell_numbers : ndarray (n_cells,)
        Place of each cell in the mesh file, block after block.
    point_data : dict of str to ndarray (n,) or (n, k)
        ``displacement`` (n, d), with ``smooth = true`` the fields of the cells averaged, ``stress_smooth``, ...
    cell_data : dict of str to ndarray (n_cells,) or (n_cells, k)
        ``stress`` (components XX, YY, ZZ, XY, YZ, XZ), ``equivalent_stress``, ``equivalent_plastic_strain`` where
        bodies may yield, ``body`` (number in the scene), ``rank``, ...
    contacts : dict of str to dict of str to ndarray
        By the name of the contact, at its quadrature points: ``x`` (np, d), ``pressure``, ``gap``, ``traction``
        (np, d), ``normal``, ``status`` (0 open, 1 stick, 2 slip), ``weight`` (area), ``paired``, ``number`` (the same
        on any ranks).
    """

    def __init__(self, number, time, points, cells, data, contacts):
        self.number, self.time, self.points, self.cells, self.contacts = number, time, points, cells, contacts
        self.node_numbers, self.cell_numbers, self.point_data, self.cell_data = data

    @classmethod
    def of(cls, taken):
        """Those that a run has at hand.

        Parameters
        ----------
        taken : pcontact.io.snapshot.Taken
        """
        piece, contacts = taken.bodies, {}
        point_data = dict(piece.point_data)
        numbers = point_data.pop(NODE_NUMBER)
        cell_data = {name: np.concatenate(arrays) for name, arrays in piece.cell_data.items()}
        for name, cloud in taken.points.items():
            contacts[name] = {"x": cloud.points, **cloud.data, "number": taken.point_numbers[name]}
        found = cls(
            taken.number, taken.time, piece.points, list(piece.cells),
            (numbers, np.concatenate(taken.cell_numbers), point_data, cell_data), contacts,
        )  # fmt: skip
        found._lock()
        return found

    def _lock(self):
        """Views that cannot be written to: the run goes on with the same arrays."""
        self.points, self.node_numbers, self.cell_numbers = map(
            _locked, (self.points, self.node_numbers, self.cell_numbers)
        )
        self.cells = [(kind, _locked(table)) for kind, table in self.cells]
        for data in (self.point_data, self.cell_data, *self.contacts.values()):
            data.update({name: _locked(array) for name, array in data.items()})

    def __getitem__(self, name):
        """A field of the nodes or of the cells by its name."""
        for data in (self.point_data, self.cell_data):
            if name in data:
                return data[name]
        raise KeyError(f"{name!r}; there are {', '.join([*self.point_data, *self.cell_data])}")

    @property
    def displacement(self):
        """Displacement of the nodes (n, d) [length]."""
        return self.point_data["displacement"]

    @property
    def stress(self):
        """Mean stress of the cells (n_cells, 6): XX, YY, ZZ, XY, YZ, XZ [stress]."""
        return self.cell_data["stress"]

    def gather(self, comm, everywhere=False):
        """Those of all ranks in one, see :meth:`Run.gather`. *Collective.*"""
        parts = comm.allgather(self) if everywhere else comm.gather(self)
        return None if parts is None else _joined(parts)


def _locked(array):
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def _joined(parts):
    """The parts of all ranks in one: each node once, nodes, cells and points by their numbers."""
    numbers = np.concatenate([part.node_numbers for part in parts])
    bodies = np.concatenate([_body_of_nodes(part) for part in parts])
    order = np.lexsort((bodies, numbers))
    fresh = np.ones(len(order), dtype=bool)
    fresh[1:] = (np.diff(numbers[order]) != 0) | (np.diff(bodies[order]) != 0)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.cumsum(fresh) - 1
    kept = order[fresh]
    point_data = {name: np.concatenate([part.point_data[name] for part in parts])[kept] for name in parts[0].point_data}
    points = np.concatenate([part.points for part in parts])[kept]
    cells, rows = _joined_cells(parts, place)
    cell_numbers = np.concatenate([part.cell_numbers for part in parts])
    filled = [part for part in parts if len(part.cell_numbers)] or parts[:1]
    cell_data = {name: np.concatenate([part.cell_data[name] for part in filled])[rows] for name in filled[0].cell_data}
    contacts = {name: _joined_points([part.contacts[name] for part in parts]) for name in parts[0].contacts}
    data = numbers[kept], cell_numbers[rows], point_data, cell_data
    return Fields(parts[0].number, parts[0].time, points, cells, data, contacts)


def _body_of_nodes(part):
    """By which nodes of one number are told apart: bodies that share them have their own where fields are averaged."""
    body, first = np.zeros(len(part.points), dtype=np.int64), 0
    if not any(name.endswith("_smooth") for name in part.point_data):
        return body
    for _, table in part.cells:
        body[table] = part.cell_data["body"][first : first + len(table), None]
        first += len(table)
    return body


def _joined_cells(parts, place):
    """One block for each type, by the numbers of the cells, and their rows among the cells of all ranks."""
    blocks, node, cell = {}, 0, 0
    for part in parts:
        for kind, table in part.cells:
            blocks.setdefault(kind, []).append((place[node + table], np.arange(cell, cell + len(table))))
            cell += len(table)
        node += len(part.points)
    numbers = np.concatenate([part.cell_numbers for part in parts])
    cells, rows = [], []
    for kind, found in blocks.items():
        tables, own = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        order = np.argsort(numbers[own], kind="stable")
        cells.append((kind, tables[order]))
        rows.append(own[order])
    return cells, np.concatenate(rows)


def _joined_points(parts):
    """Quadrature points of all ranks, by their numbers."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(joined["number"], kind="stable")
    return {name: array[order] for name, array in joined.items()}
