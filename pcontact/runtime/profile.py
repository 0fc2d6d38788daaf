"""Time, messages and memory of phases: PETSc's log stages and events, and the same phases for the report.

    with phase("search"):
        ...

Phases nest, and each counts the seconds that no inner one takes: together they are the whole. The outer phases are
stages of ``-log_view``, the inner ones events in it; PETSc's own events (``PCSetUp``, ``KSPSolve``) tell the rest.
"""

import ctypes
import resource
import time as clock
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pcontact.runtime.jit import resident
from pcontact.runtime.petsc import MPI, PETSc

STAGES = ("read", "distribute", "set_up", "search", "solve", "output")
EVENTS = ("exchange", "bulk_assembly", "contact_assembly", "matrix")
OTHER = "other"

# PETSc registers its own events with the first object of a class
PETSC_EVENTS = {"preconditioner": ("PCSetUp", "PCSetUpOnBlocks"), "krylov": ("KSPSolve",)}
PETSc.KSP().create(comm=PETSc.COMM_SELF).destroy()
_STAGES = {name: PETSc.Log.Stage(name) for name in STAGES}
_EVENTS = {name: PETSc.Log.Event(name) for name in EVENTS}
_PETSC = {name: [PETSc.Log.Event(event) for event in events] for name, events in PETSC_EVENTS.items()}
# [bytes] Resident set up to which a process holds freed memory for runs to come, see `holding`. From: chosen; a process
# that has run small meshes has 0.2 to 0.4 GB.
HELD = 2**29


def _petsc_counts():
    """Seconds, messages and bytes (sent and received, halved) of PETSc's own events on this rank so far."""
    result = {name: [0.0, 0.0, 0.0] for name in _PETSC}
    if not PETSc.Log.isActive():
        return result
    for name, events in _PETSC.items():
        for event in events:
            for stage in (0, *(stage.id for stage in _STAGES.values())):
                info = event.getPerfInfo(stage)
                own = info["time"], 0.5 * info["numMessages"], 0.5 * info["messageLength"]
                result[name] = [a + b for a, b in zip(result[name], own, strict=True)]
    return result


def memory():
    """Largest and present resident set of this process [byte]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return peak, resident() or peak


def free_memory():
    """Memory that this machine has free [byte]; None where it does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            found = dict(line.split(":", 1) for line in lines)
        return 1024.0 * float(found["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None


def give_back():
    """Hand freed memory back to the system, where the C library can: other ranks of the machine may need it."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


_holding = [False]


@contextmanager
def holding():
    """Have runs inside the block leave the memory that they free to those that follow, unless it is much.

    Where one run follows another at once, each page that is handed back is asked for anew, and cleared by the system:
    that takes a twentieth of the seconds of meshes of some thousand unknowns.
    """
    _holding.append(True)
    try:
        yield
    finally:
        _holding.pop()


def spare():
    """Hand freed memory back to the system, unless it is held."""
    if not _holding[-1] or memory()[1] > HELD:
        give_back()


def forget_peak():
    """Hand freed memory back as :func:`spare`, and have the largest resident set begin anew, where Linux can."""
    spare()
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


class Profile:
    """Costs of the phases of a run on this rank.

    Attributes
    ----------
    seconds : dict of str to float
        By phase, without its inner phases.
    sent : dict of str to [int, int]
        Messages and bytes to other ranks, by the phase that has them exchanged.
    counts : dict of str to dict of str to int
        Whatever :func:`count` was told, by phase.
    memory : dict of str to (int, int)
        Largest and present resident set [byte] at the marks, in their order.
    """

    def __init__(self):
        self.seconds = dict.fromkeys((*STAGES, *EVENTS, OTHER), 0.0)
        self.sent, self.counts, self.memory = {}, {}, {}
        self._stack, self._last = [OTHER], clock.perf_counter()
        self._petsc, self._since = {name: [0.0, 0.0, 0.0] for name in _PETSC}, None

    def _switch(self):
        now = clock.perf_counter()
        self.seconds[self._stack[-1]] += now - self._last
        self._last = now

    def enter(self, name):
        """A phase begins."""
        self._switch()
        self._stack.append(name)

    def leave(self):
        """The innermost phase ends."""
        self._switch()
        self._stack.pop()

    @property
    def within(self):
        """The innermost phase that is not the exchange itself."""
        return next(name for name in reversed(self._stack) if name != "exchange")

    def start(self):
        """Begin to count, or go on."""
        if not PETSc.Log.isActive():
            PETSc.Log.begin()
        self._last, self._since = clock.perf_counter(), _petsc_counts()

    def stop(self):
        """Stop counting."""
        self._switch()
        self._petsc, self._since = self.petsc(), None

    def petsc(self):
        """Seconds, messages and bytes of the preconditioner's set-up and of the Krylov method on this rank."""
        if self._since is None:
            return self._petsc
        now = _petsc_counts()
        return {
            name: [a + b - c for a, b, c in zip(self._petsc[name], now[name], self._since[name], strict=True)]
            for name in now
        }

    def phases(self):
        """Seconds of this rank by phase, the solve split into preconditioner and Krylov method; they sum to all."""
        if self._since is not None:
            self._switch()
        seconds = dict(self.seconds)
        solve = seconds.pop("solve")
        # what is left of Newton's own work is a few sums of vectors
        seconds["preconditioner"] = min(self.petsc()["preconditioner"][0], solve)
        seconds["krylov"] = solve - seconds["preconditioner"]
        return seconds

    def messages(self):
        """Messages and bytes of this rank by phase."""
        return {**self.sent, **{name: values[1:] for name, values in self.petsc().items()}}


_active = [Profile()]


@contextmanager
def recording(profile):
    """Have all phases inside the block count for a profile."""
    profile.start()
    _active.append(profile)
    try:
        yield profile
    finally:
        _active.pop()
        profile.stop()


class phase:  # noqa: N801
    """Context manager: what happens inside is a phase.

    Parameters
    ----------
    name : str
        One of ``STAGES`` and ``EVENTS``.
    """

    __slots__ = ("_name", "_stage", "_event")

    def __init__(self, name):
        self._name, self._stage, self._event = name, _STAGES.get(name), _EVENTS.get(name)

    def __enter__(self):
        if self._stage is not None:
            self._stage.push()
        else:
            self._event.begin()
        _active[-1].enter(self._name)

    def __exit__(self, *exception):
        _active[-1].leave()
        if self._stage is not None:
            self._stage.pop()
        else:
            self._event.end()
        return False


def sent(messages, size):
    """Count messages and bytes to other ranks."""
    profile = _active[-1]
    entry = profile.sent.setdefault(profile.within, [0, 0])
    entry[0] += messages
    entry[1] += size


def count(**numbers):
    """Add to the counts of the present phase."""
    profile = _active[-1]
    counts = profile.counts.setdefault(profile.within, {})
    for name, number in numbers.items():
        counts[name] = counts.get(name, 0) + int(number)


def mark(name):
    """Note the memory in use, the first time that the run gets here."""
    marks = _active[-1].memory
    if name not in marks:
        marks[name] = memory()


def largest_and_sum(comm, names, own):
    """Largest over the ranks and sum of named numbers. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    names : iterable of str
        The same on all ranks.
    own : dict of str to float
        Missing ones are 0.

    Returns
    -------
    largest, total : dict of str to float
    """
    names = list(names)
    values = np.array([own.get(name, 0.0) for name in names], dtype=np.float64)
    largest, total = np.empty_like(values), np.empty_like(values)
    comm.Allreduce(values, largest, op=MPI.MAX)
    comm.Allreduce(values, total, op=MPI.SUM)
    return dict(zip(names, largest.tolist(), strict=True)), dict(zip(names, total.tolist(), strict=True))
