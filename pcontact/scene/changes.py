"""Scenes with other values: keys of the tables of a scene file replaced."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from pcontact.runtime.errors import InputError, cut, input_error, unknown_name
from pcontact.scene.model import LIST_TABLES, Contact

# [parts] of a dotted key, from which on it is none of a scene: reading one takes a time that grows with their square
DEEP = 30
_PART = r"""(?:(?<![\w-])[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
DEEP_KEY = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEP}}}")


def plain(value: object) -> object:
    """The same in the types that TOML has: arrays and tuples as lists, numbers of numpy and paths as Python's own."""
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


def changed(data: dict[str, object], changes: Mapping[str, object], file: str) -> dict[str, object]:
    """The tables of a scene with some values replaced.

    Parameters
    ----------
    data : dict
        As `tomllib` makes it; left as it is.
    changes : mapping
        Tables are merged, key by key; None takes a key out. A dict in the place of a list of tables has the changes of
        those that it names, by their `name`, their `region` or their number from 0. All other values take the place of
        the old ones.
    file : str
        For messages.

    Raises
    ------
    InputError
        A list has no table of a name, or several.
    """
    return _merged(data, plain(changes), file, "", [])


def with_words(data: dict[str, object], words: Sequence[str]) -> tuple[dict[str, object], dict[str, str]]:
    """The tables of a scene with what the command line sets.

    Parameters
    ----------
    data : dict
        As `tomllib` makes it; left as it is.
    words : sequence of str
        ``KEY=VALUE`` each, see :func:`assigned`.

    Returns
    -------
    data : dict
    said : dict of str to str
        By the path of each key that is set, what messages call the option.

    Raises
    ------
    InputError
    """
    said = {}
    for word in words:
        touched, option = [], f"command line: -set {word.partition('=')[0].strip()}"
        data = _merged(data, assigned(word), option, "", touched)
        said |= dict.fromkeys(touched, option)
    return data, said


def _merged(table, changes, file, where, touched):
    """A table with changes; the paths of the keys that they set are added to a list."""
    result = dict(table)
    for key, value in changes.items():
        place_ = f"{where}.{key}" if where else key
        old = result.get(key, [] if key in LIST_TABLES and not where else None)
        if isinstance(value, dict) and isinstance(old, dict):
            result[key] = _merged(old, value, file, place_, touched)
            continue
        if isinstance(value, dict) and isinstance(old, list):
            result[key] = _merged_list(key, old, value, file, touched)
            continue
        touched.append(place_)
        result[key] = value
        if value is None:
            result.pop(key)
    return result


def _merged_list(key, items, changes, file, touched):
    items = list(items)
    for name, change in changes.items():
        row = _row(key, items, name, file)
        if isinstance(items[row], dict) and isinstance(change, dict):
            items[row] = _merged(items[row], change, file, f"{key}[{row}]", touched)
        else:
            touched.append(f"{key}[{row}]")
            items[row] = change
    return items


def _row(key, items, name, file):
    """Row of the table of a list that has a name, a region, or else a number."""
    tables, called = [item if isinstance(item, dict) else {} for item in items], []
    for named in ("name", "region"):
        names = [_contact_name(item) if key == "contacts" and named == "name" else item.get(named) for item in tables]
        called += [one for one in names if isinstance(one, str)]
        rows = [row for row, one in enumerate(names) if one == name]
        if len(rows) == 1:
            return rows[0]
        if rows:
            numbers = f"their numbers {', '.join(map(str, rows))}, or a list of all"
            raise input_error(file, key, f"{len(rows)} tables with {named} {name!r}", numbers)
    if name.isdecimal() and int(name) < len(items):
        return int(name)
    allowed = [*dict.fromkeys(called), *[f"a number below {len(items)}"] * bool(items)] or ["none, as there are none"]
    raise input_error(file, key, unknown_name(name, "no such name or region", called), ", ".join(allowed))


def _contact_name(item):
    """Name of the table of a contact, also where it is not said."""
    return Contact(**{key: item.get(key) for key in ("source", "target", "name")}).name


def assigned(word: str) -> dict[str, object]:
    """The change of a scene that ``KEY=VALUE`` stands for: a key and a value of TOML, or a text without quotation
    marks; without a value the key is taken out.

    Raises
    ------
    InputError
    """
    key, equals, value = word.partition("=")
    for text in (value.strip() or '"-"', json.dumps(value, ensure_ascii=False)):
        with suppress(ValueError, RecursionError):
            if equals and not DEEP_KEY.search(key):
                found = tomllib.loads(f"{key} = {text}")
                return found if value.strip() else _emptied(found)
    raise InputError(
        f"command line: -set: found {cut(word) if word else 'nothing'}; allowed: KEY=VALUE, such as steps.count=4 or "
        "contacts.NAME.friction=0.3; parts of a key with other characters than letters, digits, - and _ in "
        "quotation marks"
    )


def _emptied(table):
    return {key: _emptied(value) if isinstance(value, dict) else None for key, value in table.items()}
