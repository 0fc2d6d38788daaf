"""Parts that studies share: runs in memory, what an observer counts, rows that are kept as they come, pages.

A study runs scenes with variations, each run is a row (a dict), and tables follow from rows:

    rows = Rows(args.o / "rows.jsonl", ("scene", "variant"), args.go_on)
    for ...:
        row = rows.get({"scene": scene, "variant": variant}, lambda: measure(scene, variant))

With ``--go-on`` of :func:`study_parser` a study that was ended goes on where it was.
"""

import json
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

from drivers._common import make_parser, plain
from pcontact.runtime.errors import InputError, StepFailure
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, MeshSpec, Output, Scene
from pcontact.simulation import Simulation


class Counts(Observer):
    """Observer: what load steps take, those that were cut, too.

    Attributes
    ----------
    newton, krylov, updates : int
        Iterations, and updates of multipliers.
    hardest : int
        Krylov iterations of the linear solve that took most.
    most : int
        Newton iterations of a load step with the attempts that failed before it.
    steps, cuts : int
        Load steps that converged, and that did not.
    records : list of dict
        Of those that did.
    cause : str
        Why the last one failed that did not.
    """

    def __init__(self):
        self.newton = self.krylov = self.updates = self.hardest = self.most = self.cuts = self._failed = 0
        self.records, self.cause = [], ""

    @property
    def steps(self):
        return len(self.records)

    @property
    def record(self):
        """That of the last load step that converged, None before."""
        return self.records[-1] if self.records else None

    def _add(self, what):
        self.newton, self.krylov = self.newton + what.newton, self.krylov + what.krylov
        self.hardest = max(self.hardest, what.hardest)

    def step(self, step, u, record):
        """Add the step."""
        self._add(step)
        self.updates += record.get("uzawa", {"updates": 0})["updates"]
        self.most, self._failed = max(self.most, step.newton + self._failed), 0
        self.records.append(record)

    def cut(self, target, result):
        """Add what the attempt took."""
        self._add(result)
        self.cuts, self._failed = self.cuts + 1, self._failed + result.newton
        self.cause = f"step to time {target:g}: {result.reason} after {result.newton} iterations"


@contextmanager
def solved(scene, mesh=None, comm=MPI.COMM_WORLD, observers=lambda simulation: ()):
    """A run in memory, with observers of the simulation, and the record of its last load step. *Collective.*

    Raises
    ------
    StepFailure
        A load step did not converge.
    """
    simulation, counts = Simulation(scene, comm, mesh=mesh), Counts()
    try:
        if not simulation.run(None, [counts, *observers(simulation)]):
            raise StepFailure(str(simulation.failure))
        yield simulation, counts.record
    finally:
        simulation.free()


def composed(mesh, bodies, supports=(), petsc=None, **keys):
    """A scene that writes no fields.

    Parameters
    ----------
    mesh : pathlib.Path or MeshSpec
    bodies : dict of str to Material
        By their regions.
    supports : dict of str to list, or list of Displacement
        Displacements by their regions.
    petsc : dict of str to object, optional
    **keys
        Of :class:`pcontact.scene.model.Scene`.
    """
    if isinstance(supports, dict):
        supports = [Displacement(region, value) for region, value in supports.items()]
    return Scene(
        mesh=mesh if isinstance(mesh, MeshSpec) else MeshSpec(mesh),
        materials=bodies,
        bodies=[Body(name, name) for name in bodies],
        displacements=list(supports),
        petsc=petsc or {},
        **{"output": Output(fields=False), **keys},
    )


class Rows:
    """Rows (dicts) of a study in a file, a line of JSON each.

    Parameters
    ----------
    path : pathlib.Path
        Of the file; a line that was cut off by the end of a run counts as missing.
    keys : tuple of str
        What tells a row from the others.
    kept : bool
        Whether those of an earlier run stay.
    comm : MPI.Comm
        Ranks that have the rows; the first one writes.

    Raises
    ------
    InputError
        The file has other lines. On every rank.
    """

    def __init__(self, path, keys, kept=True, comm=MPI.COMM_WORLD):
        self._path, self._keys, self._comm = path, keys, comm
        self._rows = comm.bcast(on_root(comm, self._read, kept))

    def _read(self, kept):
        if not self._path.exists():
            return {}
        *lines, last = self._path.read_text(encoding="utf-8").split("\n") if kept else [""]
        try:
            rows = [json.loads(line) for line in lines]
            found = {tuple(row[key] for key in self._keys): row for row in rows}
        except (ValueError, KeyError, TypeError) as error:
            text = f"{self._path}: found {type(error).__name__}, allowed: rows of this study"
            raise InputError(text) from None
        if last or not kept:
            self._path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        return found

    def __iter__(self):
        return iter(self._rows.values())

    def _key(self, row):
        return tuple(row[key] for key in self._keys)

    def __contains__(self, row):
        return self._key(row) in self._rows

    def add(self, row):
        """Add a row, and write it at once. *Collective.*"""
        text = json.dumps(row, default=plain) + "\n"

        def write():
            with open(self._path, "a", encoding="utf-8") as file:
                file.write(text)

        on_root(self._comm, write)
        self._rows[self._key(row)] = self._comm.bcast(json.loads(text))

    def get(self, key, make):
        """The row of a key (dict), made and kept where there is none. *Collective.*"""
        if key not in self:
            self.add({**key, **make()})
        return self._rows[self._key(key)]


def study_parser(description, directory):
    """The parser of a study with rows: ``-o``, ``--tiny``, ``--go-on``."""
    parser = make_parser(description, directory)
    parser.add_argument("--go-on", action="store_true", help="rows of an earlier run in -o are not run again")
    return parser


def results(path, said, keys=()):
    """Load the JSON that an earlier run has written. *Collective.*

    Parameters
    ----------
    path : pathlib.Path
    said : str
        What leads to it, for a message.
    keys : tuple of str
        Of the dict that is wanted; empty: all there is.

    Raises
    ------
    InputError
        On every rank.
    """

    def read():
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            return {key: data[key] for key in keys} if keys else data
        except (OSError, ValueError, KeyError, TypeError) as error:
            found = "no file" if isinstance(error, OSError) else "something else"
            text = f"{said}: found {found} in {path}; allowed: results of an earlier sweep of this study"
            raise InputError(text) from None

    return MPI.COMM_WORLD.bcast(on_root(MPI.COMM_WORLD, read))


def joined(places, file, keys):
    """Rows of several runs; of those with the same keys that of the later run.

    Parameters
    ----------
    places : list of pathlib.Path
        Their directories.
    file : str
        Of the rows, in each.
    keys : tuple of str
    """
    rows = [row for place in places for row in results(place / file, f"command line: --join {place}")]
    return list({tuple(row[key] for key in keys): row for row in rows}.values())


def command():
    """The command line of this study, for a document."""
    return "mpirun -n N python drivers/" + " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])


def publish(path, mark, text, pictures=()):
    """Put text into a document in place of what follows a line, and pictures (file, name) beside it. Serial.

    Raises
    ------
    InputError
        The document has no such line, or cannot be read.
    """
    try:
        head, found, _ = path.read_text().partition(mark)
    except OSError as error:
        raise InputError(f"command line: --publish {path}: found {error.strerror}") from None
    if not found:
        raise InputError(f"{path}: found no line {mark!r}, allowed: a document with one")
    path.write_text(f"{head}{mark}\n\n{text}")
    for file, name in pictures:
        shutil.copy(file, path.parent / name)
