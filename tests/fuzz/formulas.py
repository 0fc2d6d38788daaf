"""Expressions of place and time that move with a scene: sums of texts in x, y, z, t at an affine image of the place."""

import re
from dataclasses import dataclass, replace

import numpy as np

NAMES = {name: getattr(np, name) for name in ("sin", "cos", "exp", "sqrt", "tanh", "hypot")}


@dataclass(frozen=True)
class Formula:
    """sum(c f(A x + b, t)): `terms` are pairs (c, text of f); A (d, d) and b (d,) lead to the place of the texts."""

    terms: tuple
    A: np.ndarray
    b: np.ndarray

    @classmethod
    def of(cls, text, d, factor=1.0):
        """The text itself, times a factor, in d directions."""
        return cls(((factor, text),), np.eye(d), np.zeros(d))

    def __call__(self, x, t):
        """Values (n,) at places x (n, d) and a time."""
        at = x @ self.A.T + self.b
        names = {**NAMES, "t": t, **{name: at[:, k] for k, name in enumerate("xyz"[: at.shape[1]])}}
        total = sum(c * eval(text, {"__builtins__": {}}, names) for c, text in self.terms)
        return np.broadcast_to(total, len(x)).astype(float)

    def __mul__(self, factor):
        return replace(self, terms=tuple((factor * c, text) for c, text in self.terms))

    __rmul__ = __mul__

    def moved(self, motion):
        """The same values at the places of a motion x' = length R x + shift."""
        A = self.A @ motion.R.T / motion.length
        return replace(self, A=A, b=self.b - A @ motion.shift)

    def text(self):
        """As the scene says it."""
        places = {}
        for name, row, first in zip("xyz", self.A, self.b, strict=False):
            parts = [f"{v!r}*{other}" for v, other in zip(row.tolist(), "xyz", strict=False) if v]
            places[name] = f"({' + '.join([*parts, repr(float(first))])})"
        return " + ".join(
            f"{float(c)!r}*({re.sub(r'(?<![a-z])[xyz](?![a-z])', lambda m: places[m[0]], text)})"
            for c, text in self.terms
        )


def combined(factors, entries):
    """Sum of entries, numbers or formulas of one place, times factors."""
    formulas = [e for e in entries if isinstance(e, Formula)]
    if not any(f != 0.0 and isinstance(e, Formula) for f, e in zip(factors, entries, strict=True)):
        return float(sum(f * e for f, e in zip(factors, entries, strict=True) if not isinstance(e, Formula)))
    terms = []
    for factor, entry in zip(factors, entries, strict=True):
        rows = entry.terms if isinstance(entry, Formula) else ((entry, "1.0"),)
        terms += [(factor * c, text) for c, text in rows if factor * c != 0.0]
    return replace(formulas[0], terms=tuple(terms)) if terms else 0.0


def moved_value(motion, value):
    """A value, or a list of them, at the places of a motion; numbers stay."""
    if isinstance(value, list):
        return [moved_value(motion, one) for one in value]
    return value.moved(motion) if isinstance(value, Formula) else value
