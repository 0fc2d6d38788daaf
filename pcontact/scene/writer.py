"""From a scene to its file: tables, and their text."""

import math
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np

from pcontact.scene.keys import keys
from pcontact.scene.model import LIST_TABLES, OPTIONAL_TABLES, SINGLE_TABLES, Contact, Scene

# keys whose values are files beside the scene, and those that are "FILE.py:NAME"
FILES, FUNCTIONS = ("file", "geometry"), ("function", "gradient")


def tables_of(scene: Scene, folder: str | Path) -> list[tuple[str, dict, str]]:
    """Tables of a scene file, for :func:`text`: keys that are not at their defaults.

    Parameters
    ----------
    scene : Scene
        Without an error to reach.
    folder : str or pathlib.Path
        Of the file, from where its other files are named.

    Raises
    ------
    TypeError
        A value has no text, as a function of Python.
    """

    def table(one):
        values = {key: getattr(one, key) for key in (*keys(type(one)), *(["obstacle"] * isinstance(one, Contact)))}
        default = {one.name: one.default for one in fields(one)}
        said = {key: value for key, value in values.items() if value is not None and default[key] is MISSING
                or not _same(value, default[key])}  # fmt: skip
        return {key: _moved(scene, folder, key, value) if key in FILES + FUNCTIONS else plain(value)
                for key, value in said.items()}  # fmt: skip

    def plain(value):
        if hasattr(value, "__dataclass_fields__"):
            return table(value)
        if isinstance(value, Mapping):
            return {str(key): plain(one) for key, one in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist())
        if isinstance(value, list | tuple):
            return [plain(one) for one in value]
        if isinstance(value, str | bool | int | float):
            return value
        raise TypeError(f"{type(value).__name__} has no text")

    head = {key: plain(getattr(scene, key)) for key in ("title", "accuracy", "allow_unsafe") if getattr(scene, key)}
    found = [("", head, "")] if head else []
    found += [(f"[materials.{name}]", table(one), "") for name, one in scene.materials.items()]
    found += [(f"[{key}]", table(getattr(scene, key)), "") for key in (*SINGLE_TABLES, *OPTIONAL_TABLES)
              if getattr(scene, key) is not None]  # fmt: skip
    found += [(f"[[{key}]]", table(one), "") for key in LIST_TABLES for one in getattr(scene, key)]
    return [*found, ("[petsc]", {key: str(value) for key, value in scene.petsc.items()}, "")]


def _same(value, default):
    """Return whether a key has its default, or None, which is no value of a file."""
    return value is None or (type(value) is type(default) and value == default)


def _moved(scene, folder, key, value):
    """A file beside the scene, as it is named from a folder."""
    name, colon, function = str(value).rpartition(":") if key in FUNCTIONS else (str(value), "", "")
    if not isinstance(value, str | Path):
        raise TypeError(f"{key} has no text")
    return os.path.relpath(scene.folder / name, folder) + colon + function


def _toml(one):
    """A value as TOML has it."""
    if isinstance(one, bool):
        return "true" if one else "false"
    if isinstance(one, str):
        escaped = one.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else " " for c in escaped) + '"'
    if isinstance(one, dict):
        return "{ " + ", ".join(f"{toml_key(name)} = {_toml(part)}" for name, part in one.items()) + " }"
    if isinstance(one, (list, tuple)):
        return f"[{', '.join(map(_toml, one))}]"
    if isinstance(one, float):
        return repr(one) if math.isfinite(one) else "inf"
    return str(one)


def toml_key(name):
    """A key, in quotes where it needs them."""
    return name if name and all(c.isascii() and (c.isalnum() or c in "_-") for c in name) else _toml(name)


def text(tables, head=()):
    """A file from its tables.

    Parameters
    ----------
    tables : list of (str, dict, str)
        Header such as "[mesh]", or "" for the keys before any; keys and values; a comment or "".
    head : sequence of str
        Lines of the comment at the beginning.

    Returns
    -------
    str
    """
    lines = [f"# {line}".rstrip() for line in head]
    for header, table, comment in tables:
        lines += [""] * bool(lines)
        if header:
            lines.append(header + (f"    # {comment}" if comment else ""))
        lines += [f"{toml_key(name)} = {_toml(one)}" for name, one in table.items()]
    return "\n".join([*lines, ""])
