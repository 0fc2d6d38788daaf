"""From a TOML file to a scene."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from typing import Any

from pcontact.runtime import log
from pcontact.runtime.errors import closeness, cut, input_error, nearest, set_elsewhere, shown
from pcontact.scene.changes import DEEP, DEEP_KEY, changed, plain, with_words
from pcontact.scene.model import (
    HEADERS,
    INSTEAD,
    LIST_TABLES,
    NAMED,
    OPTIONAL_TABLES,
    RENAMED,
    SINGLE_TABLES,
    Contact,
    Material,
    Obstacle,
    Scene,
    place,
)
from pcontact.scene.target import Budget, Target
from pcontact.scene.validate import validate

HOME = ("path", "beside")
_ALIKE = 0.8  # likeness above which a key of the same table is what was meant


def read_scene(
    path: str | Path, changes: Mapping[str, object] | None = None, words: Sequence[str] = ()
) -> Scene:
    """Read and check a scene file.

    Parameters
    ----------
    path : str or pathlib.Path
        A TOML file.
    changes : mapping, optional
        Keys of the scene with other values, see :func:`pcontact.scene.changes.changed`.
    words : sequence of str
        The same from the command line, ``KEY=VALUE`` each, one after the other.

    Returns
    -------
    Scene
        A valid scene; dimension and groups are checked when the mesh is there (`pcontact.scene.regions`).

    Raises
    ------
    InputError
        One line: file, key path (or line and column), what was found, what is allowed.
    """
    path = Path(path)
    data, said = with_words(changed(_parse(path), changes or {}, str(path)), words)
    set_elsewhere(str(path), said)
    return _scene(data, str(path), path=path)


def scene_from(data: Mapping[str, object], folder: str | Path | None = None) -> Scene:
    """A scene from the tables of a scene file, as they are in Python.

    Parameters
    ----------
    data : mapping
        What `tomllib` makes of a scene file: the same keys, dicts for tables, lists for lists of tables. Arrays and
        numbers of numpy and paths are taken as well.
    folder : str or pathlib.Path, optional
        Where the mesh and other files are; absent: the working directory.

    Returns
    -------
    Scene
        Valid, as :func:`read_scene` returns it.

    Raises
    ------
    InputError
    """
    if not isinstance(data, Mapping):
        raise input_error("scene", "scene", shown(data), "a dict with the tables of a scene file")
    return _scene(plain(data), "scene", beside=None if folder is None else Path(folder))


def _scene(data, file, **home):
    _check_keys(Scene, data, file, "")
    scene = Scene(
        **home,
        title=data.get("title", ""),
        accuracy=_accuracy(data.get("accuracy"), file),
        allow_unsafe=data.get("allow_unsafe", ()),
        **{key: built(cls, data.get(key, {}), file, key) for key, cls in SINGLE_TABLES.items()},
        materials=_materials(data.get("materials", {}), file),
        petsc=data.get("petsc", {}),
        **{key: _list(key, data.get(key, []), file) for key in LIST_TABLES},
        **{key: built(cls, data[key], file, key) for key, cls in OPTIONAL_TABLES.items() if key in data},
    )
    validate(scene)
    return scene


def _accuracy(data, file):
    """A word, or a table with one in it."""
    if not isinstance(data, dict):
        return data
    budget = built(Budget, data.get("budget", {}), file, "accuracy.budget")
    return built(Target, {**data, "budget": budget}, file, "accuracy")


def _parse(path):
    text = ""
    try:
        if path.is_dir():
            raise input_error(str(path), "file", "a directory", "a scene file (TOML)")
        # -sig: some editors put a byte order mark first, which TOML does not know
        text = path.read_text(encoding="utf-8-sig")
        _check_depth(path, text)
        return tomllib.loads(text)
    except OSError as error:
        raise input_error(
            str(path), "file", (error.strerror or str(error)).lower(), "a scene file (TOML)"
        ) from None
    except UnicodeDecodeError as error:
        raise input_error(
            str(path), f"byte {error.start}", "text that is not UTF-8", "a TOML file in UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:
        message = str(error)
    match = re.search(r" \(at (line \d+, column \d+|end of document)\)$", message)
    where = match.group(1) if match else "somewhere"
    found = message[: match.start()] if match else message
    found = found[:1].lower() + found[1:]
    if where.startswith("line"):
        line = text.replace("\r\n", "\n").split("\n")[int(where.split()[1].rstrip(",")) - 1]
        found += f" in {cut(line.strip())}"
    allowed = "TOML: tables such as [mesh], keys such as order = 1, names in quotation marks, true, false"
    if "immutable" in message:
        allowed = "all keys inside the braces { ... }, or all of them dotted, not both"
    raise input_error(str(path), where, found, allowed)


def _check_depth(path, text):
    """Refuse keys of very many parts before they are read."""
    found = DEEP_KEY.search(text)
    if found is not None:
        where = f"line {text.count(chr(10), 0, found.start()) + 1}"
        raise input_error(str(path), where, f"a key of more than {DEEP} parts, {cut(found[0])}", "keys of a scene")


def _keys(cls):
    """Keys of a table in a scene file; where a scene is is no key, nor is what the program knows of a phase."""
    plain = {Scene: [field.name for field in fields(Scene) if field.name not in HOME], Target: ["budget"]}.get(cls, [])
    return [field.name for field in fields(cls) if field.metadata or field.name in plain]


@cache
def _warn_of_old(file, table, old, new):
    """Once for a file, however many tables have the key."""
    log.warning("%s: the key %s of %s is now called %s; the old name will go", file, old, table, new)


def _check_keys(cls, data, file, where):
    known = _keys(cls)
    for old in [old for table, old in RENAMED if table is cls and old in data]:
        new = RENAMED[cls, old]
        if new in data:
            found = f"the old name of {new}, which is there, too"
            raise input_error(file, f"{where}.{old}" if where else old, found, new)
        _warn_of_old(file, HEADERS[cls], old, new)
        data[new] = data.pop(old)
    for key in data:
        if key in known:
            continue
        if (cls, key) in INSTEAD:
            raise input_error(file, f"{where}.{key}", "a key that there is not", INSTEAD[cls, key])
        best, home = nearest(key, known), cls
        if closeness(key, best) < _ALIKE:
            # a key of another table, put here by mistake
            home = next((other for other in HEADERS if key in _keys(other)), cls)
            best = key if home is not cls else best
        found = f"an unknown key, the nearest known key is {best!r} in {HEADERS[home]}"
        raise input_error(file, f"{where}.{key}" if where else key, found, ", ".join(known))


def built(cls: type, data: object, file: str, where: str) -> Any:
    """The dataclass of a table; required keys that are missing become None, which the checks refuse."""
    if not isinstance(data, dict):
        raise input_error(file, where, shown(data), f"a table {HEADERS[cls]}")
    if cls is Contact and "obstacle" in data and not isinstance(data["obstacle"], Obstacle):
        data = {**data, "obstacle": built(Obstacle, data["obstacle"], file, f"{where}.obstacle")}
    _check_keys(cls, data, file, where)
    missing = {
        field.name: None
        for field in fields(cls)
        if field.default is MISSING and field.default_factory is MISSING
    }
    return cls(**{**missing, **data})


def _materials(data, file):
    if not isinstance(data, dict):
        raise input_error(file, "materials", shown(data), "tables [materials.NAME]")
    return {name: built(Material, table, file, f"materials.{name}") for name, table in data.items()}


def _list(key, data, file):
    if not isinstance(data, list):
        raise input_error(file, key, shown(data), f"a list of tables, each headed [[{key}]]")
    cls = LIST_TABLES[key]
    items = []
    for index, table in enumerate(data):
        name = table.get("name" if cls in NAMED else "region") if isinstance(table, dict) else None
        items.append(built(cls, table, file, place(key, index, name)))
    return items
