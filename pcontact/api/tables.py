"""Values that the API gives by name: dicts, lists of tables and columns that say what there is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, SupportsIndex, TypeVar

import numpy as np

from pcontact.runtime.errors import unknown_name

V = TypeVar("V")
# attributes of tables that are no keys
INNER = ("path", "beside", "absent", "since", "held")
# rows of a table that are shown at either end of a long one
SHOWN = 10


def lost(name: str, there: Iterable[str]) -> KeyError:
    """The error to raise for a name that is not there: the nearest one, and all."""
    names = list(dict.fromkeys(there))
    return KeyError(f"{unknown_name(name, 'no such name', names)}; there are {', '.join(names) or 'none'}")


def html(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table of HTML, numbers with five digits."""
    lines = [f"<tr>{''.join(f'<th>{escape(word)}</th>' for word in head)}</tr>"]
    lines += [f"<tr>{''.join(f'<td>{escape(shown(one))}</td>' for one in row)}</tr>" for row in rows]
    return f"<table>{''.join(lines)}</table>"


def shown(value: Any) -> str:
    """A value as it is shown."""
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim):
        return "(" + ", ".join(shown(one) for one in value) + ")"
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value))
    return f"{value + 0.0:.5g}" if isinstance(value, (float, np.floating)) else "" if value is None else str(value)


class Named(dict[str, V]):
    """A dict whose errors say what there is."""

    def __missing__(self, name: str) -> V:
        raise lost(name, self)


class Table(Named[np.ndarray]):
    """Columns of equal length by their names: a dict, which a notebook shows as a table."""

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self)

    def to_pandas(self) -> Any:
        """The same as a pandas.DataFrame.

        Raises
        ------
        ModuleNotFoundError
            pandas is not installed.
        """
        import pandas

        return pandas.DataFrame(dict(self))

    def __repr__(self) -> str:
        return f"<Table: {self._rows()} rows; columns {', '.join(self)}>"

    def _repr_html_(self) -> str:
        n = self._rows()
        rows = [*range(n)] if n <= 2 * SHOWN else [*range(SHOWN), *range(n - SHOWN, n)]
        lines = [[column[row] for column in self.values()] for row in rows]
        return html(self.columns, lines) + (f"<p>{n} rows</p>" if len(rows) < n else "")

    def _rows(self) -> int:
        return max((len(column) for column in self.values()), default=0)


class Tables(list[V]):
    """Tables of a scene, by number and by name or region: ``scene.contacts["press"]``."""

    def __getitem__(self, which: SupportsIndex | slice | str) -> Any:
        if not isinstance(which, str):
            return super().__getitem__(which)
        found = [one for one in self if which in names_of(one)]
        if len(found) > 1:
            rows = ", ".join(str(row) for row, one in enumerate(self) if which in names_of(one))
            raise KeyError(f"{which!r}, the name of {len(found)} tables; their numbers are {rows}")
        if not found:
            raise lost(which, (name for one in self for name in names_of(one)))
        return found[0]


def names_of(table: object) -> list[str]:
    """Name and region of a table of a scene, as far as it has them."""
    found = (getattr(table, key, None) for key in ("name", "region"))
    return [name for name in found if isinstance(name, str)]


def there(one: Any) -> list[str]:
    """Return the names that a table, a dict or a list of a scene has."""
    if is_dataclass(one):
        return [field.name for field in fields(one) if field.name not in INNER]
    if isinstance(one, dict):
        return list(one)
    if isinstance(one, list):
        return [*dict.fromkeys(name for part in one for name in names_of(part)), *map(str, range(len(one)))]
    return []
