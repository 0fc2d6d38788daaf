"""Keys of a scene file: declared once, in the dataclass of its table.

From a declaration follow the default, the check of the value (`pcontact.scene.validate`), the option of the command
line that replaces it (`pcontact.build`), the JSON Schema (`pcontact.scene.schema`), the docstring of the table and the
tables of docs/scene.md (``scripts/reference.py``).

Rules between keys are declared with them, in words that stand in messages, too: ``friction`` is a key of the table that
has been set, ``control = "auto"`` one with a value, ``[mesh] kinematics = "axisymmetric"`` one of another table,
``[dynamics]`` a table that is there, and ``friction | law`` one of them. :func:`conflicts` checks them,
:func:`between` says in JSON Schema what they say of one table.
"""

import dataclasses
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from functools import cache, partial
from typing import Any, TypeVar, dataclass_transform

from pcontact.runtime.declared import Option
from pcontact.runtime.errors import unknown_name
from pcontact.runtime.rules import NON_NEGATIVE, TEXT, Rule, either, entries, number, optional, sequence, text
from pcontact.scene.expressions import ALLOWED, CONDITION, Called, Condition, Expression

T = TypeVar("T")


@dataclass(frozen=True)
class Key:
    """A key of a table of the scene.

    Attributes
    ----------
    rule : pcontact.runtime.rules.Rule
        Type and range of its values.
    help : str
        One line.
    default : object
        What holds where the key is not said; None: see `otherwise`. MISSING where it must be said.
    unit : str
    otherwise : str
        What is assumed, in words, where the default is no value.
    more : str
        What the docs say beyond `help`.
    option : str
        Option of the command line that replaces the key, without the dash.
    said : Rule or None
        What the option takes, where that is not what the key does.
    resolved : bool
        The default is filled in after the command line (`pcontact.scene.validate.resolve_contacts`): until then the
        value is None where it is not said.
    requires : tuple of str
        Conditions that hold where the key is set.
    excludes : tuple of str
        Keys of the table that are not set beside it; messages stand at those.
    unless : dict of str to str
        Conditions under which it is not set, and why.
    one_of, any_of : tuple of str
        Of this key and these exactly one, or at least one, is set.
    in_space : str
        Condition under which the key is set with a mesh in space, and not with one in the plane.
    group : str or callable
        The key names a group: of "cells", "facets", or "any"; or what says which, of a table.
    """

    rule: Rule
    help: str
    default: object = MISSING
    unit: str = ""
    otherwise: str = ""
    more: str = ""
    option: str = ""
    said: Rule | None = None
    resolved: bool = False
    requires: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    unless: Mapping[str, str] = dataclasses.field(default_factory=dict)
    one_of: tuple[str, ...] = ()
    any_of: tuple[str, ...] = ()
    in_space: str = ""
    group: str | Callable[[Any], str] = ""

    @property
    def per_direction(self) -> bool:
        """Return whether its values have an entry for each direction of the mesh."""
        schema = self.rule.schema
        return any(one.get("minItems") == 2 and one.get("maxItems") == 3 for one in schema.get("anyOf", [schema]))

    @property
    def per_turn(self) -> bool:
        """Return whether it is a number in the plane, and a list of three in space."""
        return self.rule.allowed in (MOMENT.allowed, ROTATION.allowed, INERTIA.allowed)

    @property
    def varies(self) -> bool:
        """Return whether its values may be expressions of place and time."""
        return ALLOWED in self.rule.allowed

    @property
    def text(self) -> str:
        """Help, unit, and what is assumed where a schema cannot give it as a value."""
        otherwise = f"; default: {self.otherwise}" if self.otherwise else ""
        return self.help + (f" [{self.unit}]" if self.unit else "") + otherwise


def key(
    rule: Rule, help: str, *, default: object = MISSING, unit: str = "", otherwise: str = "", resolved: bool = False,
    kw_only: bool = False, **more,
) -> Any:
    """The field of a table for a key; parameters as for :class:`Key`. None is allowed where it is the default.

    With `kw_only` a Python program names it: the places of those after it are as they were before it came. All but the
    first two are named: checkers of types see a default only as ``default=``.
    """
    checked = optional(rule) if default is None or resolved else rule
    declared = Key(checked, help, default, unit, otherwise, resolved=resolved, **more)
    return dataclasses.field(default=None if resolved else default, metadata={"key": declared}, kw_only=kw_only)


@cache
def keys(cls: type) -> dict[str, Key]:
    """The keys of a table, in the order of its fields."""
    return {one.name: one.metadata["key"] for one in dataclasses.fields(cls) if "key" in one.metadata}


def options(cls: type) -> dict[str, Option]:
    """Return by key the options of the command line that replace keys of a table."""
    return {
        name: Option(one.option, one.said or one.rule, one.help, section="scene", checked=not one.resolved, key=name)
        for name, one in keys(cls).items() if one.option
    }  # fmt: skip


def closed(cls: type[T]) -> type[T]:
    """Class decorator: a dataclass that takes no attributes but its own, as a file takes no other keys."""
    known = [one.name for one in dataclasses.fields(cls)]

    def set_known(self, name, value):
        if name not in known and not hasattr(cls, name):
            keys_of = [one for one in known if one in keys(cls)] or known
            found = unknown_name(name, "no such key", keys_of)
            raise AttributeError(f"{cls.__name__}: found {found}; allowed: {', '.join(keys_of)}")
        object.__setattr__(self, name, value)

    cls.__setattr__ = set_known
    return cls


@dataclass_transform(field_specifiers=(key, dataclasses.field))
def table(cls: type[T]) -> type[T]:
    """Class decorator: the dataclass of a table, whose docstring lists its keys."""
    cls = closed(dataclass(cls))
    lines = [f"{name} : {one.rule.allowed}\n        {one.text}" for name, one in keys(cls).items()]
    listed = "\n    ".join(["Parameters", "----------", *lines])
    cls.__doc__ = f"{(cls.__doc__ or '').rstrip()}\n\n    {listed}\n"
    return cls


_CONDITION = re.compile(r"(?:\[+(\w+)\]+)? ?(?:(\w+)(?: = (.+))?)?")


def is_set(one: object, name: str) -> bool:
    """Return whether a key of a table has another value than it has where nobody says it; false is no value."""
    value, declared = getattr(one, name), keys(type(one)).get(name)
    return value is not None and value is not False and (declared is None or value != declared.default)


def holds(words: str, one: object, scene: object) -> bool:
    """Return whether a condition on the keys of a table holds."""
    for condition in words.split(" | "):
        other, name, literal = _CONDITION.fullmatch(condition).groups()
        table = one if other is None else getattr(scene, other)
        if name is None or literal is None:
            found = bool(table) if name is None else is_set(table, name)
        else:
            value = getattr(table, name)
            found = (keys(type(table))[name].default if value is None else value) == json.loads(literal)
        if found:
            return True
    return False


def shown_value(value: object) -> str:
    """A value as a scene file has it."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(shown_value, value))}]"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value) if isinstance(value, int | float) else f"a {type(value).__name__.lower()}"


def _or(words):
    return words.replace(" | ", " or ")


def conflicts(one: object, scene: object) -> Iterator[tuple[str, str, str]]:
    """Rules between the keys of a table that are broken: key (empty: the table), what was found, what is allowed."""
    for name, declared in keys(type(one)).items():
        for others, exactly in ((declared.one_of, True), (declared.any_of, False)):
            yield from choice_of(one, scene, (name, *others), exactly) if others else ()
        if not is_set(one, name):
            continue
        value = shown_value(getattr(one, name))
        for words in declared.requires:
            if not holds(words, one, scene):
                yield name, f"{value} without {_or(words)}", f"{_or(words)} as well"
        for other in declared.excludes:
            if is_set(one, other):
                words = f"{name} = true" if value == "true" else name
                found = f"{shown_value(getattr(one, other))} together with {words}"
                yield other, found, f"at most one of {other}, {words}"
        for words, why in declared.unless.items():
            if holds(words, one, scene):
                yield name, f"{value} together with {words}", f"nothing: {why}"


def choice_of(
    one: object, scene: object, group: tuple[str, ...], exactly: bool = True
) -> Iterator[tuple[str, str, str]]:
    """Say that not exactly one, or not at least one, of some conditions on a table holds: as :func:`conflicts` does."""
    there = [words for words in group if holds(words, one, scene)]
    if not there or (exactly and len(there) > 1):
        none = f"neither {' nor '.join(group)}" if len(group) == 2 else "none"
        found = "both " * (len(there) == 2) + " and ".join(map(_or, there)) if there else none
        yield "", found, f"{'exactly' if exactly else 'at least'} one of {', '.join(map(_or, group))}"


def _set(name, one):
    """Schema of tables in which a key is set."""
    none = [] if one is None or one.default in (None, MISSING) else [one.default]
    none += [False] if one is not None and one.rule.schema.get("type") == "boolean" and False not in none else []
    return {"required": [name], **({"properties": {name: {"not": {"enum": none}}}} if none else {})}


def _schema(words, known):
    """Schema of tables for which a condition holds; None where it is about others."""
    found = []
    for condition in words.split(" | "):
        other, name, literal = _CONDITION.fullmatch(condition).groups()
        if other is not None:
            return None
        if literal is None:
            found.append(_set(name, known.get(name)))
        else:
            value, default = json.loads(literal), known[name].default
            one = {"properties": {name: {"const": value}}}
            found.append(one if value == default else {"required": [name], **one})
    return found[0] if len(found) == 1 else {"anyOf": found}


def between(cls: type) -> list[dict]:
    """The rules between keys of a table in JSON Schema, as far as they are about this table alone."""
    known, found = keys(cls), []
    for name, declared in known.items():
        for word, others in (("oneOf", declared.one_of), ("anyOf", declared.any_of)):
            if others:
                found.append({word: [_schema(words, known) for words in (name, *others)]})
        needs = [_schema(words, known) for words in declared.requires]
        needs += [{"not": _schema(words, known)} for words in (*declared.excludes, *declared.unless)
                  if _schema(words, known) is not None]  # fmt: skip
        found += [{"if": _set(name, declared), "then": need} for need in needs if need is not None]
    return found


def _function(value):
    if callable(value):
        return value
    module, _, name = TEXT.accept(value).rpartition(":")
    if not module.endswith(".py") or not name.isidentifier():
        raise ValueError
    return value


def _expression(value):
    Expression(TEXT.accept(value))
    return value


def _condition(value):
    Condition(TEXT.accept(value))
    return value


def _pairs(allowed, test):
    """A list of at least one pair of numbers."""

    def accept(value):
        rows = entries(value, sequence("", number(), (2,)), None)
        if not rows:
            raise ValueError
        test(rows)
        return rows

    row = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    return Rule(allowed, accept, {"type": "array", "items": row, "minItems": 1})


def _check_growing(rows, words, where=""):
    """The first numbers of pairs increase."""
    for index in range(1, len(rows)):
        if rows[index][0] <= rows[index - 1][0]:
            raise ValueError(f"whose {words} do not increase{where and f' {where} {index}'}")


def _check_hardening(rows):
    if rows[0][0] != 0:
        raise ValueError(f"whose first strain is {rows[0][0]:g}")
    if rows[0][1] <= 0:
        raise ValueError(f"whose first stress is {rows[0][1]:g}")
    _check_growing(rows, "strains", "in entry")
    for index in range(1, len(rows)):
        if rows[index][1] < rows[index - 1][1]:
            raise ValueError(f"whose stresses decrease in entry {index}")


def _check_overclosure(rows):
    if len(rows) < 2:
        raise ValueError("of one pair")
    if rows[0][1] != 0:
        raise ValueError(f"whose first pressure is {rows[0][1]:g}")
    _check_growing(rows, "overclosures", "in entry")
    for index in range(1, len(rows)):
        if rows[index][1] <= 0 or rows[index][1] < rows[index - 1][1]:
            raise ValueError(f"whose pressure {rows[index][1]:g} in entry {index} is not positive, or decreases")


def _check_ogden(rows):
    for index, (modulus, power) in enumerate(rows):
        if modulus * power == 0.0:
            raise ValueError(f"whose entry {index} has no stiffness")
    if sum(modulus * power for modulus, power in rows) <= 0:
        raise ValueError("whose shear modulus sum(mu alpha) / 2 is not positive")


def _or_list(allowed, single, several):
    """Return a rule for what one rule accepts, or of lists another one."""
    return Rule(
        allowed, lambda value: (several if isinstance(value, list | tuple) else single).accept(value),
        {"anyOf": [single.schema, several.schema]},
    )  # fmt: skip


def _or_expression(rule, words=()):
    """Return a rule for another, an expression, or from Python a function; `words` are for the rule."""

    def accept(value):
        if isinstance(value, Called):
            return value
        if callable(value) and not isinstance(value, type):
            return Called(value)
        text = isinstance(value, str) and value not in words
        return _expression(value) if text else rule.accept(value)

    return Rule(rule.allowed, accept, {"anyOf": [rule.schema, {"type": "string", "pattern": r"\S"}]})


COEFFICIENT = _or_expression(NON_NEGATIVE)._replace(allowed=f"a number >= 0, or {ALLOWED}")


def _coefficients(value):
    if not isinstance(value, Mapping):
        raise ValueError
    return {TEXT.accept(name): COEFFICIENT.accept(one) for name, one in value.items()}


COEFFICIENTS = Rule(
    f"a table of names and numbers >= 0 or expressions, {ALLOWED}", _coefficients,
    {"type": "object", "additionalProperties": COEFFICIENT.schema},
)  # fmt: skip
SCALAR = _or_expression(number())._replace(allowed=f"a finite number, or {ALLOWED}")
VECTOR = sequence("a list of 2 or 3 finite numbers, one per direction", number(), (2, 3))
STIFFNESSES = sequence(
    "a list of 2 or 3 numbers >= 0, one per direction, not all zero", number(least=0), (2, 3), any
)
STIFFNESSES.schema["contains"] = {"not": {"const": 0}}
MOMENT = _or_list(
    "a finite number in the plane, a list of 3 finite numbers in space", number(), sequence("", number(), (3,))
)
ROTATION = _or_list(
    'a finite number or "free" in the plane, a list of 3 of them in space', either("free", number()),
    sequence("", either("free", number()), (3,)),
)  # fmt: skip
INERTIA = _or_list(
    "a number >= 0 in the plane, a list of 3 of them about the axes of the mesh in space", number(least=0),
    sequence("", number(least=0), (3,)),
)  # fmt: skip
WAYS = sequence(
    'a list of 2 or 3 entries, one per direction: a finite number or "free"', either("free", number()), (2, 3)
)
FOUNDATION = _or_list(f"a number > 0, along the normal, or {STIFFNESSES.allowed}", number(above=0), STIFFNESSES)
VECTORS = sequence(
    f"a list of 2 or 3 entries, one per direction: a finite number, or {ALLOWED}", _or_expression(number()), (2, 3)
)
COMPONENTS = sequence(
    f'a list of 2 or 3 entries, one per direction: a finite number, "free", or {ALLOWED}',
    _or_expression(either("free", number()), ("free",)), (2, 3),
)  # fmt: skip
DIRECTION = sequence("a list of 2 or 3 finite numbers, one per direction, not all zero", number(), (2, 3), any)
DIRECTION.schema["contains"] = {"not": {"const": 0}}
FUNCTION = text('"FILE.py:NAME", a function in a Python file beside the scene', _function, r"\.py:[^:]+$")
EXPRESSION = text(ALLOWED, _expression)
PLACE_CONDITION = text(CONDITION, _condition)


def _term(value):
    """A group, a direction, a coefficient."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError
    region, direction, factor = value
    if not isinstance(region, str) or not region.strip() or direction not in ("x", "y", "z"):
        raise ValueError
    factor = number().accept(factor)
    if factor == 0.0:
        raise ValueError("whose coefficient is zero")
    return region, direction, factor


TERMS = sequence(
    'a list of at least one [group, "x" | "y" | "z", number that is not 0]',
    Rule("", _term, {"type": "array", "minItems": 3, "maxItems": 3}), None, bool,
)  # fmt: skip
TERMS.schema["minItems"] = 1
AMPLITUDE = _pairs("a list of [time, factor] pairs of finite numbers, times increasing",
                   partial(_check_growing, words="times"))  # fmt: skip
HARDENING_CURVE = _pairs(
    "a list of [equivalent plastic strain, yield stress] pairs, the first strain 0, strains increasing, stresses > 0 "
    "and not decreasing",
    _check_hardening,
)
_OVERCLOSURES = _pairs(
    "a list of at least two [overclosure, pressure] pairs, overclosures increasing, the first pressure 0, all others "
    "> 0 and not decreasing",
    _check_overclosure,
)
_OVERCLOSURES.schema["minItems"] = 2
PRESSURE_OVERCLOSURE = _or_list(f"a number > 0, or {_OVERCLOSURES.allowed}", number(above=0), _OVERCLOSURES)
OGDEN = _pairs("a list of [mu, alpha] pairs, not zero, sum(mu alpha) > 0", _check_ogden)
MOONEY_RIVLIN = sequence("a list of two numbers c10, c01 with c10 + c01 > 0", number(), (2,), lambda c: sum(c) > 0)


def _or_three(rule, words, item):
    """A number, or three along the axes of an orthotropic material."""
    return _or_list(f"{rule.allowed}; {words}", rule, sequence("", item, (3,)))


YOUNG = _or_three(number(above=0), "orthotropic: a list of 3 such numbers, E1, E2, E3", number(above=0))
POISSON = _or_three(
    number(above=-1, below=0.5, words="a number with -1 < nu < 0.5; nearly incompressible: use e.g. 0.4999"),
    "orthotropic: a list of 3 numbers, nu12, nu13, nu23", number(),
)  # fmt: skip
EXPANSION = _or_three(number(), "orthotropic: a list of 3 such numbers, along axes 1, 2, 3", number())
SHEAR = sequence("a list of 3 numbers > 0, G12, G13, G23", number(above=0), (3,))
LAW = TEXT._replace(allowed='"hencky" | "neo_hooke" | "mooney_rivlin" | "ogden", or the name of a law that was added')
NUMBERS = sequence("a list of finite numbers", number(), None)
AXES = sequence(
    "a list of two vectors of 3 numbers, not zero", sequence("", number(), (3,), any), (2,)
)  # fmt: skip
