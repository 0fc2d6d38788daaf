"""What a key of a scene file is: declared once, in the dataclass of its table.

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
from functools import cache
from typing import Any, TypeVar, dataclass_transform

from pcontact.runtime.declared import Option
from pcontact.runtime.messages import unknown_name
from pcontact.runtime.rules import Rule, optional

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
        """Whether its values have an entry for each direction of the mesh."""
        schema = self.rule.schema
        return schema.get("minItems") == 2 and schema.get("maxItems") == 3 and "anyOf" not in schema

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
    """By key, the options of the command line that replace keys of a table."""
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
    """Whether a key of a table has another value than it has where nobody says it; false is no value."""
    value, declared = getattr(one, name), keys(type(one)).get(name)
    return value is not None and value is not False and (declared is None or value != declared.default)


def holds(words: str, one: object, scene: object) -> bool:
    """Whether a condition on the keys of a table holds."""
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
            group = (name, *others)
            there = [words for words in group if others and holds(words, one, scene)]
            if others and (not there or (exactly and len(there) > 1)):
                none = f"neither {' nor '.join(group)}" if len(group) == 2 else "none"
                found = "both " * (len(there) == 2) + " and ".join(map(_or, there)) if there else none
                yield "", found, f"{'exactly' if exactly else 'at least'} one of {', '.join(map(_or, group))}"
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
