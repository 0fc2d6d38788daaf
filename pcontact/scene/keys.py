"""What a key of a scene file is: declared once, in the dataclass of its table.

From a declaration follow the default, the check of the value (`pcontact.scene.validate`), the option of the command
line that replaces it (`pcontact.build`), the JSON Schema (`pcontact.scene.schema`), the docstring of the table and the
tables of docs/scene.md (``scripts/reference.py``).
"""

import dataclasses
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
