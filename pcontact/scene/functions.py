"""Level sets of a scene: functions named as "FILE.py:NAME", or expressions, and the watch over what they return.

Numbers and expressions that a key holds, as a function of place and time.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from pcontact.runtime.errors import coordinates, input_error, shown
from pcontact.runtime.files import GEOMETRIES, SCRIPTS
from pcontact.scene.expressions import Called, Expression, Watched
from pcontact.scene.model import Scene, place

# characters of an expression in a message
SHOWN = 80
# numba reads it where it starts; it may say where compiled kernels are, which are pickled objects
NUMBA = ".numba_config.yaml"
# a value of an option of PETSc that names neither a file, which it may write or run, nor a command; hypre has words
# such as SOR/Jacobi
PLAIN = re.compile(r"[\w.,+-]*|\w[\w+-]*(/\w[\w+-]*)+", re.ASCII)
# words that stand for no value
WORDS = ("free",)


def obstacle_functions(scene: Scene, index: int) -> tuple[Callable, Callable | None]:
    """Functions of the level set obstacle of a contact.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    index : int
        Number of the contact in `scene.contacts`; its obstacle is a level set.

    Returns
    -------
    function : Watched
        phi(x (n, d), t) -> (n,) signed distance, positive in free space [length].
    gradient : Watched or None
        (x (n, d), t) -> (n, d).

    Raises
    ------
    InputError
        The file cannot be run, or holds no such function.
    """
    contact = scene.contacts[index]
    where = f"{place('contacts', index, contact.name)}.obstacle"
    gradient = contact.obstacle.gradient
    if contact.obstacle.expression is not None:
        text, key = contact.obstacle.expression, f"{where}.expression"
        function, name = Expression(text), text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
        return (
            Watched(function, scene.where, key, name, False),
            Watched(function.gradient, scene.where, f"{key}, its gradient", name, True),
        )
    return (
        _load(scene, f"{where}.function", contact.obstacle.function, False),
        None if gradient is None else _load(scene, f"{where}.gradient", gradient, True),
    )


def require_no_code(scene: Scene) -> None:
    """Refuse a scene that could run a program: of Python, of gmsh, or through settings of PETSc or numba.

    Raises
    ------
    InputError
    """
    if Path(NUMBA).exists():
        raise input_error(NUMBA, "file", "settings of numba in the working directory, with -no_code", "no such file")
    for key, found, allowed in _programs(scene):
        raise input_error(scene.where, key, f"{found!r}, a program, with -no_code", allowed)


def _programs(scene):
    """Keys that run something, their values, and what is allowed in their place."""
    for index, contact in enumerate(scene.contacts):
        for key in ("function", "gradient"):
            reference = None if contact.obstacle is None else getattr(contact.obstacle, key)
            if isinstance(reference, str):
                yield f"{place('contacts', index, contact.name)}.obstacle.{key}", reference, "expression"
    geometry = scene.mesh.geometry
    if geometry is not None and Path(geometry).suffix.lower() in SCRIPTS:
        yield "mesh.geometry", str(geometry), f"a file {', '.join(one for one in GEOMETRIES if one not in SCRIPTS)}"
    for name, value in scene.petsc.items():
        if "python" in f"{name} {value}".lower() or not PLAIN.fullmatch(value):
            yield f"petsc.{name}", value, "numbers and words that name no file and nothing of Python"


def _load(scene, key, reference, vector):
    if callable(reference):
        name = getattr(reference, "__name__", type(reference).__name__)
        return Watched(reference, scene.where, key, name, vector)
    file, _, name = reference.rpartition(":")
    path = scene.folder / file
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    try:
        # an import would leave compiled code beside the scene, and several ranks would write it
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:  # whatever the user's file raises is a fault of the input
        found = f"{reference!r}, the file stops with {type(error).__name__}: {error}"
        raise input_error(scene.where, key, found, "a Python file that can be imported") from error
    function = getattr(module, name, None)
    if not callable(function):
        found = f"{reference!r}, where {name} is {shown(function)}"
        raise input_error(scene.where, key, found, f"a function {name}(x, t) in {path}")
    return Watched(function, scene.where, key, reference, vector)


def expressions(value: object) -> dict[int, Expression]:
    """The expressions and functions among the entries of a value, by number; a value that is no list is entry 0."""
    entries = value if isinstance(value, list | tuple) else (value,)
    return {k: one if isinstance(one, Called) else Expression(one)
            for k, one in enumerate(entries) if isinstance(one, str) and one not in WORDS}  # fmt: skip


def names(value: object) -> set[str]:
    """Variables that the expressions of a value have."""
    return set().union(*(one.names for one in expressions(value).values()))


class Prescribed:
    """Values of a key at points: numbers as they are, expressions evaluated there.

    Parameters
    ----------
    value : float, str or sequence of them
        Words such as ``"free"`` count as zero.
    file, key : str
        Scene and key, for messages.

    Attributes
    ----------
    varies : bool
        Whether it has expressions.
    timed : bool
        Whether one of them has the time.
    """

    def __init__(self, value: float | str | Sequence[float | str], file: str = "scene", key: str = "value"):
        entries = value if isinstance(value, list | tuple | np.ndarray) else (value,)
        self._file, self._key, self._texts = file, key, entries
        self._expressions = expressions(value)
        self._numbers = np.array([0.0 if isinstance(one, str) else float(one) for one in entries])
        self.varies, self.timed = bool(self._expressions), "t" in names(value)

    def has(self, entry: int) -> bool:
        """Return whether an entry is an expression."""
        return entry in self._expressions

    def __call__(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n, m) at points x (n, d) [length].

        Raises
        ------
        InputError
            On this rank: a value is not finite.
        """
        out = np.empty((len(x), len(self._numbers)))
        out[:] = self._numbers
        for entry in self._expressions:
            out[:, entry] = self.entry(entry, x, time)
        return out

    def entry(self, entry: int, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,) of one entry at points x (n, d), see :meth:`__call__`."""
        if entry not in self._expressions:
            return np.full(len(x), self._numbers[entry])
        if isinstance(self._texts[entry], Called):
            # a rank without points does not ask
            return self._texts[entry].watched(self._file, self._key)(x, time) if len(x) else np.zeros(0)
        values = self._expressions[entry](x, time)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            text = self._texts[entry] if len(self._texts[entry]) <= SHOWN else f"{self._texts[entry][:SHOWN]}..."
            point = coordinates(x[bad[0]])
            found = f"{text!r}, the value {values[bad[0]]:g} at the point {point} at time {time:g}"
            raise input_error(self._file, self._key, found, "finite numbers")
        return values
