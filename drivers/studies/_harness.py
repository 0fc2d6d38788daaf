"""What studies share: rows that are kept as they come, so that a study goes on where it was left."""

import json

from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI


class Rows:
    """Rows (dicts) of a study in a file, a line of JSON each; those that are there are not measured again.

    Parameters
    ----------
    path : pathlib.Path
        Of the file; a line that was cut off by the end of a run counts as missing.
    keys : tuple of str
        What tells a row from the others.
    comm : MPI.Comm
        Ranks that have the rows; the first one writes.

    Raises
    ------
    InputError
        The file has other lines. On every rank.
    """

    def __init__(self, path, keys, comm=MPI.COMM_WORLD):
        self._path, self._keys, self._comm = path, keys, comm
        self._rows = comm.bcast(on_root(comm, self._read))

    def _read(self):
        if not self._path.exists():
            return {}
        *lines, last = self._path.read_text(encoding="utf-8").split("\n")
        try:
            rows = [json.loads(line) for line in lines]
            found = {tuple(row[key] for key in self._keys): row for row in rows}
        except (ValueError, KeyError, TypeError) as error:
            text = f"{self._path}: found {type(error).__name__}, allowed: rows of this study"
            raise InputError(text) from None
        if last:
            self._path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        return found

    def __iter__(self):
        return iter(self._rows.values())

    def __contains__(self, row):
        return self._key(row) in self._rows

    def _key(self, row):
        return tuple(row[key] for key in self._keys)

    def add(self, row):
        """Add a row, and write it at once. *Collective.*"""

        def write():
            with open(self._path, "a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")

        on_root(self._comm, write)
        self._rows[self._key(row)] = row
