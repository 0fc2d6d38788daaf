"""checkpoint.h5: what a run needs to go on, written aside and put in place at once.

The state of a run is the committed displacement, the time, and what the items remember of their points. Rows are kept
in the order in which the ranks wrote them, each with a number that all ranks, of any number, agree on.
"""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from pcontact.runtime.files import Hdf5Aside, make_directory
from pcontact.runtime.parallel import agree, matching, together

NAME, VERSION = "checkpoint.h5", 3
ROWS = 1 << 20  # rows that are read at a time


@dataclass
class Resumed:
    """Where a run goes on.

    Attributes
    ----------
    number : int
        Load steps that are done.
    time : float
    first : float
        Time at which the first load step ended.
    size : float
        Load step that the schedule had reached [time].
    values : ndarray (n_owned, d)
        Committed displacement of the owned nodes [length].
    path : pathlib.Path
    last : (float, ndarray (n_owned, d))
        Time and displacement at the beginning of the last load step.
    """

    number: int
    time: float
    first: float
    size: float
    values: np.ndarray
    path: Path
    last: tuple

    def recall(self, items):
        """Give the items back what they remembered."""
        with h5py.File(self.path, "r") as file:
            for item in _remembering(items):
                for name, table in file["memory"][item.name].items():
                    item.recall(name, _chunks(table["key"], table["value"]))


def _remembering(items):
    return [item for item in items if hasattr(item, "memory")]


def _chunks(keys, values):
    """Rows of two datasets, a part at a time."""
    for start in range(0, keys.shape[0], ROWS):
        yield keys[start : start + ROWS], values[start : start + ROWS]


def _keys(space):
    """Numbers of the owned nodes that do not depend on the ranks."""
    return space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]


class Checkpoint:
    """Writes the state of a run after a load step. An observer.

    Parameters
    ----------
    directory : str or pathlib.Path
    space : pcontact.space.space.Space
    items : list
        Those with a ``memory`` are asked for it.
    schedule : pcontact.stepping.schedule.Schedule
    every : int
        Load steps between two checkpoints; the last one is always written.
    first : float, optional
        Time at which the first load step ended, if this run continues another.
    """

    def __init__(self, directory, space, items, schedule, every=1, first=None):
        self.path, self._space, self._schedule = Path(directory) / NAME, space, schedule
        self._items, self._every, self._first = _remembering(items), every, first

    def step(self, step, u, record):
        """Write the state. *Collective.*

        Raises
        ------
        OutputError
            On every rank, when the file cannot be written; the one before is still there.
        """
        if self._first is None:
            self._first = step.time
        if step.number % self._every and not self._schedule.done:
            return
        comm = self._space.comm
        # whether rank 0 can write is settled before the others wait for it
        aside = together(comm, self._open, step)
        try:
            self._rows(aside, u, step.before)
            together(comm, self._place, aside)
        finally:
            if aside is not None:
                aside.discard()

    def _open(self, step):
        if self._space.comm.rank != 0:
            return None
        make_directory(self.path.parent)
        aside = Hdf5Aside(self.path)
        self._head(aside.file, step)
        return aside

    def _place(self, aside):
        """Put the file in place once the disk has it."""
        if aside is not None:
            aside.place()

    def cut(self, target, outcome):
        """Nothing is written."""

    def end(self, converged):
        """All is written already."""

    def _head(self, file, step):
        space = self._space
        file.attrs.update({
            "version": VERSION, "number": step.number, "time": step.time, "first": self._first,
            "size": self._schedule.size, "begin": step.begin, "degree": space.degree, "dim": space.dim,
            "nodes": space.numbering.n_total,
        })  # fmt: skip
        file.create_group("memory")

    def _tables(self, u, before):
        """Name, keys (n,) and values (n, m) of every table."""
        for name, vector in (("displacement", u), ("before", before)):
            yield name, _keys(self._space), vector.getArray(readonly=True).reshape(-1, self._space.dim)
        for item in self._items:
            for name, (keys, values) in item.memory().items():
                yield f"memory/{item.name}/{name}", keys, values

    def _rows(self, aside, u, before):
        for name, keys, values in self._tables(u, before):
            self._table(aside, name, np.ascontiguousarray(keys, np.int64), np.ascontiguousarray(values, np.float64))

    def _table(self, aside, name, keys, values):
        """Ranks hand their rows to rank 0 in turn: memory for one more rank's rows is enough. *Collective.*"""
        comm = self._space.comm
        counts = comm.allgather(len(keys))
        if comm.rank != 0:
            comm.recv(source=0)
            comm.Send(keys, dest=0)
            comm.Send(values, dest=0)
            return
        group = aside.file.create_group(name)
        group.create_dataset("key", (sum(counts),), np.int64)
        group.create_dataset("value", (sum(counts), *values.shape[1:]), np.float64)
        start = 0
        for rank, count in enumerate(counts):
            if rank > 0:
                keys, values = np.empty(count, np.int64), np.empty((count, *values.shape[1:]))
                comm.send(None, dest=rank)
                comm.Recv(keys, source=rank)
                comm.Recv(values, source=rank)
            # what fails is told when the file is put in place; until then the other ranks have to be heard
            if not aside.failed:
                group["key"][start : start + count], group["value"][start : start + count] = keys, values
            start += count


def read_checkpoint(directory, space, items):
    """State of an earlier run, on any number of ranks. *Collective.*

    Parameters
    ----------
    directory : str or pathlib.Path
        Holds checkpoint.h5.
    space : pcontact.space.space.Space
    items : list

    Returns
    -------
    Resumed

    Raises
    ------
    InputError
        On every rank: there is no checkpoint, it is no checkpoint, or one of another mesh or degree.
    """
    path, message, resumed = Path(directory) / NAME, None, None
    try:
        with h5py.File(path, "r") as file:
            message = _mismatch(path, dict(file.attrs), space) or _forgotten(path, file, items)
            if message is None:
                head = file.attrs
                values, found = _pick(file["displacement"], _keys(space), space.dim)
                last = float(head["begin"]), _pick(file["before"], _keys(space), space.dim)[0]
                resumed = Resumed(
                    int(head["number"]), float(head["time"]), float(head["first"]), float(head["size"]), values, path,
                    last,
                )  # fmt: skip
                if found < len(values):
                    message = f"{path}: found no row for {len(values) - found} nodes; allowed: one of this mesh"
    except FileNotFoundError:
        message = f"-restart {directory}: found no {NAME} there; allowed: the results of an earlier run"
    except (OSError, KeyError) as error:
        message = f"{path}: found no readable checkpoint ({error}); allowed: a file that pcontact wrote"
    agree(space.comm, message)
    return resumed


def _mismatch(path, head, space):
    """What forbids to continue from a checkpoint; None if nothing."""
    wanted = {"version": VERSION, "dim": space.dim, "degree": space.degree, "nodes": space.numbering.n_total}
    for key, value in wanted.items():
        if head.get(key) != value:
            return f"{path}: {key}: found {head.get(key)}; allowed: {value}, as in this run"
    return None


def _forgotten(path, file, items):
    """What an item needs to know and the checkpoint does not hold; None if nothing."""
    missing = [item.name for item in _remembering(items) if item.name not in file["memory"]]
    if not missing:
        return None
    found = ", ".join(file["memory"]) or "none"
    return f"{path}: friction of {', '.join(missing)}: found {found}; allowed: a run with the same friction"


def _pick(table, keys, dim):
    """Rows (n, d) of some nodes, and how many were there."""
    values, found = np.zeros((len(keys), dim)), 0
    for rows, part in matching(keys, _chunks(table["key"], table["value"])):
        values[rows] = part
        found += len(rows)
    return values, found
