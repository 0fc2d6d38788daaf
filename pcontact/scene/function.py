"""Level sets of a scene: functions named as "FILE.py:NAME", or expressions, and the watch over what they return."""

import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

from pcontact.runtime.messages import input_error, shown
from pcontact.scene.expression import Expression
from pcontact.scene.model import Scene
from pcontact.scene.places import place

# kinds of numpy's types that are no distances: complex numbers and booleans
NOT_REAL = "cb"
# characters of an expression in a message
SHOWN = 80


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
    """Refuse a scene that names Python functions: to read it would run a program.

    Raises
    ------
    InputError
    """
    for index, contact in enumerate(scene.contacts):
        for key in ("function", "gradient"):
            reference = None if contact.obstacle is None else getattr(contact.obstacle, key)
            if isinstance(reference, str):
                where = f"{place('contacts', index, contact.name)}.obstacle.{key}"
                raise input_error(scene.where, where, f"{reference!r}, a program, with -no_code", "expression")


class Watched:
    """A function of the user's; what it must not do becomes an input error.

    Parameters
    ----------
    function : callable
        (x (n, d), t) -> array.
    file, key : str
        Scene and key, for messages.
    name : str
        What the scene calls the function.
    vector : bool
        It returns (n, d) values rather than (n,).
    """

    def __init__(self, function: Callable, file: str, key: str, name: str, vector: bool):
        self.function, self.file, self.key, self.name, self.vector = function, file, key, name, vector

    def __call__(self, x, time):
        """Values of the function.

        Parameters
        ----------
        x : ndarray (n, d)
            Points [length].
        time : float

        Returns
        -------
        ndarray (n,) or (n, d)

        Raises
        ------
        InputError
            On the rank where it happens: the function stops, its values have the wrong shape or are not finite.
        """
        shape = x.shape if self.vector else x.shape[:1]
        allowed = f"{'a gradient' if self.vector else 'one distance'} per point, an array of shape {shape}"
        at = f"at time {time:g}"
        try:
            with np.errstate(all="ignore"):  # what is not finite is found below
                value = self.function(x.copy(), time)
            value = np.asarray(value)
            # converted, complex numbers would lose a part without a word
            value = value if value.dtype.kind in NOT_REAL else value.astype(float, copy=False)
        except (Exception, SystemExit) as error:  # whatever the user's function raises is a fault of the input
            raise self._error(f"{_stop(error)} {at}", allowed) from None
        if value.dtype.kind in NOT_REAL:
            raise self._error(f"values of type {value.dtype} {at}", f"{allowed} of real numbers")
        if value.shape != shape:
            raise self._error(f"an array of shape {value.shape} {at}", allowed)
        bad = np.flatnonzero(~np.isfinite(value.reshape(len(x), -1)).all(axis=1))
        if len(bad):
            point = ", ".join(f"{c:g}" for c in x[bad[0]])
            first = np.array2string(value[bad[0]], separator=", ")
            raise self._error(f"the value {first} at the point ({point}) {at}", "finite numbers")
        # on a ridge of the distance it may vanish, but not at every point
        if self.vector and len(x) > 1 and not value.any():
            raise self._error(f"zero at all {len(x)} points {at}", "a gradient, which points into free space")
        return value

    def _error(self, found, allowed):
        return input_error(self.file, self.key, f"{self.name!r}, {found}", allowed)


def _stop(error):
    """What ended the user's code, and in which of its lines."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename != __file__]
    line = f" in line {frames[-1].lineno} of {Path(frames[-1].filename).name}" if frames else ""
    return f"{type(error).__name__}{f': {error}' if str(error) else ''}{line}"


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
