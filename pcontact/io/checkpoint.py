"""checkpoint.h5: what a run needs to go on, written aside and put in place at once.

The state of a run is the committed displacement, the time, and what the items remember of their points. Rows are kept
in the order in which the ranks wrote them, each with a number that all ranks, of any number, agree on.
"""

from itertools import count
from pathlib import Path

import numpy as np

from pcontact.runtime.files import Hdf5Aside, make_directory
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import aside_of_root, write_rows

NAME, VERSION = "checkpoint.h5", 4
ROWS = 1 << 20  # rows that are read at a time
DISPLACEMENTS = ("displacement", "before")  # at the end and at the beginning of the last load step


def remembering(items):
    """Items that have something to remember of their points."""
    return [item for item in items if item.memory_keys() is not None]


def keys_of(space):
    """Numbers of the owned nodes that do not depend on the ranks."""
    return space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]


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
    identity : pcontact.io.identity.Identity
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
            yield name, {}, keys_of(self._space), vector.getArray(readonly=True).reshape(-1, self._space.dim)
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
