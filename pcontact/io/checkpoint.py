"""checkpoint.h5: what a run needs to go on, written aside and put in place at once.

The state of a run is the committed displacement, the time, and what the items remember of their points. Rows are kept
in the order in which the ranks wrote them, each with a number that all ranks, of any number, agree on.

What is read is verified, compared with the run that wants to go on (the mesh, the physics, and the points that remember
something), and dealt to its ranks.
"""

import json
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import h5py
import numpy as np

from pcontact.io.names import CHECKPOINT
from pcontact.mesh.mesh import hashes, mesh_digest, total
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import Damaged, Hdf5Aside, make_directory, reading, verify
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import aside_of_root, take_rows, together, write_rows
from pcontact.scene.describe import differences, physics_so_far
from pcontact.scene.model import OUTER, groups_named, tables

NAME, VERSION = CHECKPOINT, 4
ROWS = 1 << 20  # rows that are read at a time
DISPLACEMENTS = ("displacement", "before")  # at the end and at the beginning of the last load step
# of the mesh: what a state cannot go on without
NEEDED = "cells"
SAID = {
    "cells": "cells of other nodes, or other numbers",
    "points": "nodes at other places",
    "groups": "other members",
}
MADE = "a file that pcontact wrote, as it was written"
UNREADABLE = f"found no readable checkpoint ({{reason}}); allowed: {MADE}"
ANYWAY = "restart_anyway"


def remembering(items):
    """Items that have something to remember of their points."""
    return [item for item in items if item.memory_keys() is not None]


class Checkpoint(Observer):
    """Writes the state of a run after a load step. An observer.

    Parameters
    ----------
    directory : str or pathlib.Path
    space : pcontact.space.space.Space
    items : list
        Parts of the problem, of which those that have one are asked for their memory.
    schedule : pcontact.stepping.schedule.Schedule
    every : int
        Load steps between two checkpoints; the last one is always written.
    identity : pcontact.io.checkpoint.Identity
        Of the run.
    first : float, optional
        Time at which the first load step ended, if this run continues another.
    carriers : dict of str to object
        Parts of the run that carry a number from load step to load step, their ``carried``.
    """

    def __init__(self, directory, space, items, schedule, every, identity, first=None, carriers=None):
        self.path, self._space, self._schedule = Path(directory) / NAME, space, schedule
        self._identity, self._carriers = identity.written(), carriers or {}
        self._items, self._every, self._first = remembering(items), every, first

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
        with aside_of_root(self._space.comm, lambda: self._open(step)) as aside:
            self._rows(aside, u, step.before)

    def _open(self, step):
        make_directory(self.path.parent)
        aside = Hdf5Aside(self.path)
        self._head(aside.file, step)
        return aside

    def _head(self, file, step):
        space = self._space
        file.attrs.update({
            "version": VERSION, "number": step.number, "time": step.time, "first": self._first,
            "size": self._schedule.size, "begin": step.begin, "degree": space.degree, "dim": space.dim,
            "nodes": space.numbering.n_total,
        })  # fmt: skip
        file.create_dataset("identity", data=self._identity)
        file.create_group("carried").attrs.update({name: one.carried for name, one in self._carriers.items()})
        file.create_group("memory")

    def _tables(self, u, before):
        """Place in the file, attributes, keys (n,) and values (n, m) of every table."""
        for name, vector in zip(DISPLACEMENTS, (u, before), strict=True):
            yield name, {}, self._space.keys, self._space.of_owned(vector)
        number = count()
        for item in self._items:
            for name, (keys, values) in item.memory().items():
                # names may hold anything, a path of HDF5 may not
                yield f"memory/{next(number)}", {"item": item.name, "table": name}, keys, values

    def _rows(self, aside, u, before):
        for place, names, keys, values in self._tables(u, before):
            keys, values = np.ascontiguousarray(keys, np.int64), np.ascontiguousarray(values, np.float64)
            if aside is not None:
                aside.file.create_group(place).attrs.update(names)
            for name, rows in (("key", keys), ("value", values)):
                write_rows(self._space.comm, aside, f"{place}/{name}", rows)


@dataclass
class Difference:
    """Between a run and the one that wrote a checkpoint.

    Attributes
    ----------
    key : str
        File and key.
    found, allowed : str
        What the run has there, and what the checkpoint is of.
    final : bool
        Whether the state cannot be that of the run, whatever the user says.
    """

    key: str
    found: str
    allowed: str
    final: bool


@dataclass
class Identity:
    """Of a run, or of the one that wrote a checkpoint.

    Attributes
    ----------
    physics : dict
        See :func:`pcontact.scene.describe.physics`.
    mesh : dict of str to str
        See :func:`pcontact.mesh.mesh.mesh_digest`.
    rows : dict of str to [int, str]
        Of every item that remembers something: how many points (or cells) there are, and a digest of their numbers.
    scene_file, mesh_file : str or pathlib.Path
        What messages call them; of a run.
    """

    physics: dict
    mesh: dict
    rows: dict
    scene_file: str | Path = ""
    mesh_file: str | Path = ""

    @classmethod
    def of(cls, scenes, space, items):
        """That of a run. *Collective.*

        Parameters
        ----------
        scenes : list of pcontact.scene.model.Scene
            With what the command line says; those of the phases so far, one after the other.
        space : pcontact.space.space.Space
        items : list
            Those that remember something.
        """
        rows = {}
        for item in items:
            keys = item.memory_keys()
            rows[item.name] = [space.comm.allreduce(len(keys)), total(space.comm, hashes(keys))]
        named = (one for scene in scenes for _, table in tables(scene) for one in groups_named(table))
        regions = {name for _, name, _ in named if name != OUTER}
        mesh = mesh_digest(space.mesh, space.mesh_nodes[space.owned_local], regions)
        return cls(physics_so_far(scenes), mesh, rows, scenes[0].where, scenes[0].mesh_path)

    @classmethod
    def read(cls, data):
        """That of a checkpoint, from bytes (n,) that :meth:`written` gave."""
        return cls(**json.loads(bytes(data)))

    def written(self):
        """The same as bytes, an ndarray (n,) uint8."""
        data = {"physics": self.physics, "mesh": self.mesh, "rows": self.rows}
        return np.frombuffer(json.dumps(data).encode(), dtype=np.uint8)

    def differences(self, then, time):
        """Return the points in which a run is not what a checkpoint is of.

        Parameters
        ----------
        then : Identity
            Of the checkpoint.
        time : float
            Of the checkpoint.

        Returns
        -------
        list of Difference
            What the user has written comes first.
        """
        found = [
            Difference(f"{self.scene_file}: {key}", now, old, False)
            for key, now, old in differences(then.physics, self.physics, time)
        ]
        # groups that only one of both uses differ in the physics
        for key in sorted(self.mesh):
            if self.mesh[key] != then.mesh.get(key, self.mesh[key]):
                now, old = SAID[key.partition(".")[0]], f"digest {then.mesh[key]}"
                found.append(Difference(f"{self.mesh_file}: {key}", now, old, key == NEEDED))
        for name in self.rows:
            if self.rows[name] != then.rows.get(name, self.rows[name]):
                now, old = (f"{rows} of digest {sum_}" for rows, sum_ in (self.rows[name], then.rows[name]))
                found.append(Difference(f"{self.scene_file}: points or cells of {name}", now, old, True))
        return found


@dataclass
class Resumed:
    """State at which a run goes on.

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
    carried : dict of str to float
        What parts of the run carry on, see `pcontact.io.checkpoint.Checkpoint`.
    """

    number: int
    time: float
    first: float
    size: float
    values: np.ndarray
    path: Path
    last: tuple
    carried: dict

    def recall(self, comm, items):
        """Give the items back what they remembered. *Collective.*

        Raises
        ------
        InputError
            On every rank: rows are missing, there twice, or of points that this run does not have.
        """
        items = {item.name: item for item in remembering(items)}

        def read():
            with reading(self.path, UNREADABLE), h5py.File(self.path, "r") as file:
                return [
                    (table.attrs["item"], table.attrs["table"], len(table["key"]), self._taken(items, table))
                    for table in file["memory"].values()
                ]

        for item, name, rows, taken in together(comm, read):
            # not taken by any rank: another law, which the user insists on, remembers other things
            there = comm.allreduce(taken or 0)
            if taken is not None and there != rows:
                raise InputError(
                    f"{self.path}: {name} of {item}: found {rows} rows, {there} of them of points of this run; "
                    f"allowed: {MADE}"
                )

    @staticmethod
    def _taken(items, table):
        """Rows that an item of this rank takes back; None if there is no such item, or it does not know the table."""
        item = items.get(table.attrs["item"])
        return None if item is None else item.recall(table.attrs["table"], _chunks(table))


def checkpoint_time(directory, comm):
    """Time of the state of an earlier run; 0 of one that cannot be read. *Collective.*

    Parameters
    ----------
    directory : str or pathlib.Path
    comm : MPI.Comm
    """

    def read():
        try:
            with h5py.File(Path(directory) / NAME, "r") as file:
                return float(file.attrs["time"])
        except (OSError, KeyError, TypeError, ValueError):
            return 0.0

    return comm.bcast(read() if comm.rank == 0 else None)


def read_checkpoint(directory, space, identity, anyway=False):
    """State of an earlier run, on any number of ranks. *Collective.*

    Parameters
    ----------
    directory : str or pathlib.Path
        Holds checkpoint.h5.
    space : pcontact.space.space.Space
    identity : Identity
        Of this run.
    anyway : bool
        Differences that a state can go on with are warned of, and not refused.

    Returns
    -------
    Resumed

    Raises
    ------
    InputError
        On every rank: there is no checkpoint, it is damaged, or one of another mesh, degree or physics.
    """
    path, comm = Path(directory) / NAME, space.comm
    summed = together(comm, _verified, directory, path, comm)
    resumed, differences = together(comm, _read, path, summed, space, identity, anyway)
    for one in differences:
        log.warning("restart from %s although it differs: %s: %s instead of %s", path, one.key, one.found, one.allowed)
    return resumed


def _verified(directory, path, comm):
    """Return whether the file has checksums, which this rank's part of it meets."""
    try:
        return verify(path, comm.rank, comm.size)
    except FileNotFoundError:
        raise InputError(
            f"-restart {directory}: found no {NAME} there; allowed: the results of an earlier run"
        ) from None
    except OSError as error:
        raise InputError(f"{path}: {UNREADABLE.format(reason=error.strerror or error)}") from None
    except Damaged as error:
        raise InputError(f"{path}: found a damaged checkpoint ({error}); allowed: {MADE}") from None


def _read(path, summed, space, identity, anyway):
    with reading(path, UNREADABLE), h5py.File(path, "r") as file:
        head = dict(file.attrs)
        _require(path, head, version=VERSION)
        if not summed:
            raise InputError(f"{path}: found no checksums; allowed: {MADE}")
        _require(path, head, dim=space.dim, degree=space.degree, nodes=space.numbering.n_total)
        _require_times(path, head)
        differences = _compare(path, identity, Identity.read(file["identity"][:]), head["time"], anyway)
        values, before = (_nodal(path, file[name], space) for name in DISPLACEMENTS)
        carried = {name: float(value) for name, value in file["carried"].attrs.items()}
    resumed = Resumed(
        int(head["number"]), float(head["time"]), float(head["first"]), float(head["size"]), values, path,
        (float(head["begin"]), before), carried,
    )  # fmt: skip
    return resumed, differences


def _require(path, head, **wanted):
    for key, value in wanted.items():
        if head.get(key) != value:
            raise InputError(f"{path}: {key}: found {head.get(key)}; allowed: {value}, as in this run")


def _require_times(path, head):
    """Refuse a state of a time that cannot be."""
    begin, first, time, size = (float(head[key]) for key in ("begin", "first", "time", "size"))
    for key, good, allowed in (
        ("number", int(head["number"]) >= 1, "a number of load steps >= 1"),
        ("time", 0.0 < time < np.inf, "a time > 0"),
        ("first", 0.0 < first <= time, f"a time > 0, at most {time:g}"),
        ("begin", 0.0 <= begin < time, f"a time >= 0, below {time:g}"),
        ("size", 0.0 < size < np.inf, "a load step > 0"),
    ):
        if not good:
            raise InputError(f"{path}: {key}: found {head[key]:g}; allowed: {allowed}")


def _compare(path, identity, then, time, anyway):
    """Differences between this run and the one of the checkpoint that the user insists on.

    Raises
    ------
    InputError
        On others.
    """
    found = identity.differences(then, float(time))
    final = any(one.final for one in found)
    if not found or (anyway and not final):
        return found
    first = next(one for one in found if one.final or not anyway)
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    remedy = "" if final else f" (or -{ANYWAY})"
    raise InputError(f"{first.key}: found {first.found}{more}; allowed: {first.allowed}, as in {path}{remedy}")


def _nodal(path, table, space):
    """Values (n_owned, d) of the owned nodes."""
    values = np.zeros((space.n_owned, space.dim))
    found, rows = take_rows(space.keys, _chunks(table), values), len(table["key"])
    if found < len(values) or rows != space.numbering.n_total:
        raise InputError(
            f"{path}: {table.name[1:]}: found {rows} rows, and none for {len(values) - found} nodes; "
            f"allowed: one row for each of {space.numbering.n_total} nodes"
        )
    return values


def _chunks(table):
    """Keys (n,) and values (n, m) of a table, a part at a time."""
    keys, values = table["key"], table["value"]
    if keys.ndim != 1 or values.ndim != 2 or len(keys) != len(values):
        raise ValueError(f"a table of shapes {keys.shape} and {values.shape}")
    for start in range(0, len(keys), ROWS):
        part = values[start : start + ROWS]
        if not np.isfinite(part).all():
            raise ValueError("values that are no numbers")
        yield keys[start : start + ROWS], part
