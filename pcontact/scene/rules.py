"""What each key of each table allows: one rule per key, in one place.

A rule takes the value as it was written (TOML or Python), refuses it, or returns it as the program wants it:
numbers as float, lists as tuples.
"""

import math
import numbers
import os
from collections.abc import Callable
from typing import NamedTuple

from pcontact.runtime.presets import PRESETS
from pcontact.scene.expression import ALLOWED, Expression
from pcontact.scene.messages import input_error, kind, shown
from pcontact.scene.model import (
    UNSAFE,
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
)

# sizes of numbers between which squares and products of several of them neither overflow nor lose digits
TINY, HUGE = 1e-60, 1e60


class Rule(NamedTuple):
    """What is allowed, in words, and the function that accepts a value or raises ValueError(why)."""

    allowed: str
    accept: Callable


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


def number(allowed: str = "a finite number", test: Callable = lambda value: True) -> Rule:
    """A finite number that passes the test, zero or of a size that can be calculated with."""

    def accept(value):
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise ValueError
        if not math.isfinite(value) or not test(value):
            raise ValueError
        if value and not TINY <= abs(value) <= HUGE:
            raise ValueError(f"whose size is not between {TINY:g} and {HUGE:g}: take other units")
        return float(value)

    return Rule(allowed, accept)


def integer(low: int, high: int | None = None) -> Rule:
    """A whole number between two limits, both included."""

    def accept(value):
        if isinstance(value, bool) or not isinstance(value, numbers.Integral):
            raise ValueError
        if value < low or (high is not None and value > high):
            raise ValueError
        return int(value)

    return Rule(f"an integer >= {low}" if high is None else f"an integer from {low} to {high}", accept)


def choice(*options: str) -> Rule:
    """One of some words."""

    def accept(value):
        if not isinstance(value, str) or value not in options:
            raise ValueError
        return value

    return Rule(" | ".join(f'"{option}"' for option in options), accept)


def optional(rule: Rule) -> Rule:
    """The rule, or nothing at all."""
    return Rule(rule.allowed, lambda value: None if value is None else rule.accept(value))


def _entries(value, item: Rule, sizes) -> tuple:
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


def sequence(allowed: str, item: Rule, sizes=None, test: Callable = lambda value: True) -> Rule:
    """A list whose entries follow one rule, of one of the sizes."""

    def accept(value):
        value = _entries(value, item, sizes)
        if not test(value):
            raise ValueError
        return value

    return Rule(allowed, accept)


def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError
    return value


def _any_text(value):
    if not isinstance(value, str):
        raise ValueError
    return value


def _boolean(value):
    if not isinstance(value, bool):
        raise ValueError
    return value


def _file(value):
    value = _text(os.fspath(value) if isinstance(value, os.PathLike) else value)
    os.fsencode(value)  # a ValueError where the locale has not all of its letters
    return value


def _component(value):
    return value if isinstance(value, str) and value == "free" else number().accept(value)


def _function(value):
    if callable(value):
        return value
    module, _, name = _text(value).rpartition(":")
    if not module.endswith(".py") or not name.isidentifier():
        raise ValueError
    return value


def _expression(value):
    Expression(_text(value))
    return value


def _amplitude(value):
    rows = _entries(value, sequence("", number(), (2,)), None)
    if not rows:
        raise ValueError
    if any(later[0] <= earlier[0] for earlier, later in zip(rows[:-1], rows[1:], strict=True)):
        raise ValueError("whose times do not increase")
    return rows


def _hardening_curve(value):
    rows = _entries(value, sequence("", number(), (2,)), None)
    if not rows:
        raise ValueError
    if rows[0][0] != 0:
        raise ValueError(f"whose first strain is {rows[0][0]:g}")
    if rows[0][1] <= 0:
        raise ValueError(f"whose first stress is {rows[0][1]:g}")
    for index in range(1, len(rows)):
        if rows[index][0] <= rows[index - 1][0]:
            raise ValueError(f"whose strains do not increase in entry {index}")
        if rows[index][1] < rows[index - 1][1]:
            raise ValueError(f"whose stresses decrease in entry {index}")
    return rows


def option_text(value: object) -> str:
    """A value of the [petsc] table as PETSc's options database takes it."""
    value = _plain(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | int):
        return str(value)
    if isinstance(value, float):
        return repr(number().accept(value))
    if isinstance(value, list | tuple):
        return ",".join(option_text(entry) for entry in value)
    raise ValueError(kind(value))


POSITIVE = number("a number > 0", lambda value: value > 0)
NON_NEGATIVE = number("a number >= 0", lambda value: value >= 0)
NU = number(
    "a number with -1 < nu < 0.5; nearly incompressible: use e.g. 0.4999", lambda value: -1 < value < 0.5
)
THETA = number("1 | 0 | -1", lambda value: value in (1, 0, -1))
TEXT = Rule("a string that is not empty", _text)
ANY_TEXT = Rule("a string", _any_text)
BOOLEAN = Rule("true | false", _boolean)
VECTOR = sequence("a list of one finite number per direction (2 or 3)", number(), (2, 3))
COMPONENTS = sequence(
    'a list of one finite number or "free" per direction (2 or 3)', Rule("", _component), (2, 3)
)
DIRECTION = sequence(
    "a list of one finite number per direction (2 or 3), not all zero", number(), (2, 3), any
)
FUNCTION = Rule('"FILE.py:NAME", a function in a Python file beside the scene', _function)
EXPRESSION = Rule(ALLOWED, _expression)
AMPLITUDE = Rule("a list of [time, factor] pairs of finite numbers, times increasing", _amplitude)
HARDENING_CURVE = Rule(
    "a list of [equivalent plastic strain, yield stress] pairs, the first strain 0, strains increasing, stresses > 0 "
    "and not decreasing",
    _hardening_curve,
)
OPTION = Rule("a string, a boolean, a finite number or a list of them", option_text)

RULES: dict[type, dict[str, Rule]] = {
    Scene: {
        "title": ANY_TEXT,
        "accuracy": optional(choice(*PRESETS)),
        "allow_unsafe": sequence("a list of " + choice(*UNSAFE).allowed, choice(*UNSAFE)),
    },
    MeshSpec: {
        "file": Rule("the name of a mesh file beside the scene", _file),
        "order": optional(integer(1, 2)),
        "kinematics": choice("plane_strain", "plane_stress", "axisymmetric"),
        "mean_dilatation": optional(BOOLEAN),
    },
    Material: {
        "E": POSITIVE,
        "nu": NU,
        "yield_stress": optional(POSITIVE),
        "hardening": NON_NEGATIVE,
        "kinematic_hardening": NON_NEGATIVE,
        "hardening_curve": optional(HARDENING_CURVE),
    },
    Body: {"region": TEXT, "material": TEXT},
    Obstacle: {
        "shape": choice("plane", "sphere", "cylinder", "level_set"),
        "point": optional(VECTOR),
        "normal": optional(DIRECTION),
        "center": optional(VECTOR),
        "axis": optional(DIRECTION),
        "radius": optional(POSITIVE),
        "inside": BOOLEAN,
        "function": optional(FUNCTION),
        "gradient": optional(FUNCTION),
        "expression": optional(EXPRESSION),
        "displacement": optional(VECTOR),
        "amplitude": optional(AMPLITUDE),
    },
    Contact: {
        "source": optional(TEXT),
        "target": optional(TEXT),
        "name": TEXT,
        "friction": optional(NON_NEGATIVE),
        "tresca": optional(NON_NEGATIVE),
        "friction_limit": optional(POSITIVE),
        "adhesion": optional(NON_NEGATIVE),
        "bilateral": BOOLEAN,
        "unbiased": BOOLEAN,
        "all": BOOLEAN,
        "self_contact": optional(BOOLEAN),
        "tied": BOOLEAN,
        "formulation": optional(choice("nitsche", "penalty", "augmented_lagrangian")),
        "theta": optional(THETA),
        "gamma0": optional(POSITIVE),
        "alpha": optional(POSITIVE),
        "adjoint": optional(choice("elastic", "consistent")),
        "quadrature": optional(integer(1, 20)),
        "cut": optional(BOOLEAN),
        "search": optional(choice("closest_point", "ray_tracing")),
        "search_radius": optional(POSITIVE),
        "interference": optional(choice("resolve", "adjust")),
        "smooth_geometry": optional(BOOLEAN),
    },
    Displacement: {
        "region": TEXT,
        "value": COMPONENTS,
        "amplitude": optional(AMPLITUDE),
    },
    Load: {
        "region": TEXT,
        "pressure": optional(number()),
        "traction": optional(VECTOR),
        "body_force": optional(VECTOR),
        "amplitude": optional(AMPLITUDE),
    },
    Steps: {"end": POSITIVE, "count": integer(1, 1_000_000), "min_step": optional(POSITIVE)},
    Output: {
        "fields": BOOLEAN,
        "checkpoint": BOOLEAN,
        "checkpoint_every": integer(1),
        "probes": sequence("a list of names of groups", TEXT),
        "smooth": BOOLEAN,
        "estimate": BOOLEAN,
    },
}

# per obstacle shape: the keys that must be there, the keys that may be there; every shape may move
OBSTACLE_KEYS = {
    "plane": (("point", "normal"), ()),
    "sphere": (("center", "radius"), ("inside",)),
    "cylinder": (("point", "axis", "radius"), ("inside",)),
    "level_set": ((), ("expression", "function", "gradient")),
}
MOTION_KEYS = ("displacement", "amplitude")
