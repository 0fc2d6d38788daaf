"""Rules of allowed values: a rule refuses a value or returns it as the program wants it, and says the same as a schema.

Numbers become float, lists tuples. Scene keys (`pcontact.scene.keys`) and options (`pcontact.runtime.declared`) name
the rules of their values.
"""

import math
import numbers
import os
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from pcontact.runtime.errors import CONTROL, input_error, shown

# sizes of numbers between which squares and products of several of them neither overflow nor lose digits
TINY, HUGE = 1e-60, 1e60


class Rule(NamedTuple):
    """Rule of what is allowed.

    Attributes
    ----------
    allowed : str
        In words.
    accept : callable
        Takes a value as it was written (TOML or Python); returns it, or raises ValueError(why).
    schema : dict
        The same in the words of JSON Schema. It may allow more than `accept`, never less.
    """

    allowed: str
    accept: Callable
    schema: dict


def _plain(value):
    """Arrays and scalars of numpy as Python's own, without importing numpy for it."""
    return value.tolist() if hasattr(value, "tolist") else value


def apply(rule: Rule, value: object, file: str, key: str) -> object:
    """Return the value as the program wants it.

    Raises
    ------
    InputError
        The rule refuses the value.
    """
    value = _plain(value)
    try:
        return rule.accept(value)
    except (ValueError, OverflowError) as error:
        why = f", {error}" if str(error) else ""
        raise input_error(file, key, shown(value) + why, rule.allowed) from None


def _bounds(least, most, above, below):
    limits = {"minimum": least, "maximum": most, "exclusiveMinimum": above, "exclusiveMaximum": below}
    return {name: limit for name, limit in limits.items() if limit is not None}


def number(
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
    words: str = "",
) -> Rule:
    """A finite number within limits (least and most included), zero or of a size that can be calculated with."""
    signs = {f"> {above}": above, f">= {least}": least, f"< {below}": below, f"<= {most}": most}
    limits = " and ".join(sign for sign, limit in signs.items() if limit is not None)

    def accept(value):
        if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
            raise ValueError
        if (least is not None and value < least) or (above is not None and value <= above):
            raise ValueError
        if (most is not None and value > most) or (below is not None and value >= below):
            raise ValueError
        if value and not TINY <= abs(value) <= HUGE:
            raise ValueError(f"whose size is not between {TINY:g} and {HUGE:g}: take other units")
        return float(value)

    allowed = words or (f"a number {limits}" if limits else "a finite number")
    return Rule(allowed, accept, {"type": "number", **_bounds(least, most, above, below)})


def integer(least: int, most: int | None = None) -> Rule:
    """A whole number between two limits, both included."""

    def accept(value):
        if isinstance(value, bool) or not isinstance(value, numbers.Integral):
            raise ValueError
        if value < least or (most is not None and value > most):
            raise ValueError
        return int(value)

    allowed = f"an integer >= {least}" if most is None else f"an integer from {least} to {most}"
    if most is not None and most - least < 3:  # editors offer what is listed
        return Rule(allowed, accept, {"type": "integer", "enum": list(range(least, most + 1))})
    return Rule(allowed, accept, {"type": "integer", **_bounds(least, most, None, None)})


def choice(*words: str) -> Rule:
    """One of some words."""

    def accept(value):
        if not isinstance(value, str) or value not in words:
            raise ValueError
        return value

    return Rule(" | ".join(f'"{word}"' for word in words), accept, {"type": "string", "enum": list(words)})


def one_of(*values: float) -> Rule:
    """One of some numbers."""

    def accept(value):
        if number().accept(value) not in values:
            raise ValueError
        return float(value)

    return Rule(" | ".join(f"{value:g}" for value in values), accept, {"type": "number", "enum": list(values)})


def either(word: str, rule: Rule) -> Rule:
    """A word, or what a rule accepts, as a part of a rule that says so."""

    def accept(value):
        return value if isinstance(value, str) and value == word else rule.accept(value)

    return Rule("", accept, {"anyOf": [rule.schema, {"const": word}]})


def optional(rule: Rule) -> Rule:
    """The rule, or nothing at all."""
    return rule._replace(accept=lambda value: None if value is None else rule.accept(value))


def entries(value: object, item: Rule, sizes: tuple[int, ...] | None) -> tuple:
    """The entries of a list, each as its rule wants it."""
    if not isinstance(value, list | tuple):
        raise ValueError
    if sizes is not None and len(value) not in sizes:
        raise ValueError(f"{len(value)} entries")
    result = []
    for index, entry in enumerate(value):
        try:
            result.append(item.accept(_plain(entry)))
        except (ValueError, OverflowError) as error:
            why = f", {error}" if str(error) else ""
            raise ValueError(f"entry {index} is {shown(_plain(entry))}{why}") from None
    return tuple(result)


def sequence(allowed: str, item: Rule, sizes: tuple[int, ...] | None = None, test: Callable | None = None) -> Rule:
    """A list whose entries follow one rule, of one of the sizes, which passes the test (may raise ValueError(why))."""

    def accept(value):
        value = entries(value, item, sizes)
        if test is not None and not test(value):
            raise ValueError
        return value

    limits = {} if sizes is None else {"minItems": min(sizes), "maxItems": max(sizes)}
    return Rule(allowed, accept, {"type": "array", "items": item.schema, **limits})


def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError
    return _printable(value)


def _printable(value):
    """A text, unless there are control characters in it."""
    if CONTROL.search(value):
        raise ValueError("with a control character")
    return value


def _instance(cls, value):
    if not isinstance(value, cls):
        raise ValueError
    return value


def _file(value):
    value = _text(os.fspath(value) if isinstance(value, os.PathLike) else value)
    os.fsencode(value)  # a ValueError where the locale has not all of its letters
    return value


def text(allowed: str = "a string that is not empty", check: Callable = _text, pattern: str = r"\S") -> Rule:
    """A text that a function accepts; `pattern` is what a schema can say of it."""
    return Rule(allowed, check, {"type": "string", "pattern": pattern})


def is_number(word: str) -> bool:
    """Return whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _option_text(value):
    value = _plain(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | int):
        return _printable(str(value))
    if isinstance(value, float) and math.isfinite(value):
        return repr(value)
    if isinstance(value, list | tuple):
        return ",".join(_option_text(entry) for entry in value)
    raise ValueError


POSITIVE = number(above=0)
NON_NEGATIVE = number(least=0)
TEXT = text()
ANY_TEXT = Rule("a string", partial(_instance, str), {"type": "string"})
BOOLEAN = Rule("true | false", partial(_instance, bool), {"type": "boolean"})
# a value of the [petsc] table, as PETSc's options database takes it
PETSC_VALUE = Rule(
    "a string, a boolean, a finite number or a list of them", _option_text,
    {"type": ["string", "boolean", "number", "array"]},
)  # fmt: skip


def file(allowed: str) -> Rule:
    """The name of a file."""
    return text(allowed, _file)
