"""Numbers and expressions that a key holds, as a function of place and time."""

from collections.abc import Sequence

import numpy as np

from pcontact.runtime.messages import input_error
from pcontact.scene.called import Called
from pcontact.scene.expression import Expression

# characters of an expression in a message
SHOWN = 80
# words that stand for no value
WORDS = ("free",)


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
        """Whether an entry is an expression."""
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
            point = ", ".join(f"{c:g}" for c in x[bad[0]])
            found = f"{text!r}, the value {values[bad[0]]:g} at the point ({point}) at time {time:g}"
            raise input_error(self._file, self._key, found, "finite numbers")
        return values
