"""Functions of place and time that a Python program gives in the place of expressions, and the watch over them."""

import hashlib
import inspect
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pcontact.runtime.messages import input_error

# kinds of numpy's types that are no real numbers: complex numbers and booleans
NOT_REAL = "cb"


def text_of(function: Callable) -> str:
    """Name of a function and a hash of the text that defines it, where there is one: what tells it from others."""
    name = getattr(function, "__qualname__", type(function).__name__)
    try:
        text = inspect.getsource(function).encode()
    except (OSError, TypeError):
        return name
    return f"{name}, text {hashlib.sha256(text).hexdigest()[:16]}"


class Called(str):
    """A function in the place of an expression: its text is what messages and checkpoints call it.

    Parameters
    ----------
    function : callable
        (x (n, d), t) -> (n,).
    """

    def __new__(cls, function: Callable) -> "Called":
        """The text of the function, which it keeps."""
        one = super().__new__(cls, text_of(function))
        one.function = function
        return one

    def __reduce__(self):
        return Called, (self.function,)

    # what its values depend on: it may be the time, too
    names = frozenset("t")

    def __call__(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,) at points x (n, d) [length]."""
        return self.watched("scene", "value")(x, time)

    def watched(self, file: str, key: str) -> "Watched":
        """The function, with the scene and the key for messages."""
        return Watched(self.function, file, key, str(self), False, "one number")


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
    what : str
        What it returns.
    """

    def __init__(self, function: Callable, file: str, key: str, name: str, vector: bool, what: str = "one distance"):
        self.function, self.file, self.key, self.name, self.vector = function, file, key, name, vector
        self._what = "a gradient" if vector else what

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
        allowed = f"{self._what} per point, an array of shape {shape}"
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
