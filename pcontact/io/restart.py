"""Reading of checkpoint.h5: verified, compared with the run that wants to go on, and dealt to its ranks."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from pcontact.io.checkpoint import DISPLACEMENTS, NAME, ROWS, VERSION, keys_of, remembering
from pcontact.io.identity import Identity
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import Damaged, verify
from pcontact.runtime.parallel import take_rows, together

MADE = "a file that pcontact wrote, as it was written"
ANYWAY = "restart_anyway"


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
            with h5py.File(self.path, "r") as file:
                return [
                    (table.attrs["item"], table.attrs["table"], len(table["key"]), self._taken(items, table))
                    for table in file["memory"].values()
                ]

        for item, name, rows, taken in together(comm, _guarded, self.path, read):
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
    resumed, differences = together(comm, _guarded, path, lambda: _read(path, summed, space, identity, anyway))
    for one in differences:
        log.warning("restart from %s although it differs: %s: %s instead of %s", path, one.key, one.found, one.allowed)
    return resumed


def _verified(directory, path, comm):
    """Whether the file has checksums, which this rank's part of it meets."""
    try:
        return verify(path, comm.rank, comm.size)
    except FileNotFoundError:
        raise InputError(
            f"-restart {directory}: found no {NAME} there; allowed: the results of an earlier run"
        ) from None
    except OSError as error:
        raise InputError(f"{path}: found no readable checkpoint ({error.strerror or error}); allowed: {MADE}") from None
    except Damaged as error:
        raise InputError(f"{path}: found a damaged checkpoint ({error}); allowed: {MADE}") from None


def _guarded(path, read):
    """Read; whatever HDF5 and what is missing in the file raise is an input error."""
    try:
        return read()
    except InputError:
        raise
    except Exception as error:  # HDF5 has many words for what it cannot read
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: found no readable checkpoint ({reason}); allowed: {MADE}") from None


def _read(path, summed, space, identity, anyway):
    with h5py.File(path, "r") as file:
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
    found, rows = take_rows(keys_of(space), _chunks(table), values), len(table["key"])
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
