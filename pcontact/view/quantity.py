"""Quantity that a picture shows: a field by its name, or by the name and one of its components."""

from dataclasses import dataclass

import numpy as np

from pcontact.io.names import STATUS
from pcontact.runtime.errors import InputError, nearby

_VECTOR = ("x", "y", "z")
_TENSOR = ("xx", "yy", "zz", "xy", "yz", "xz")


@dataclass
class Quantity:
    """One number per cell or per point.

    Parameters
    ----------
    name : str
        As the user says it.
    place : str
        "bodies", "surfaces" or "points" (of quadrature).
    at : str
        "cell" or "point".
    values : dict of str to ndarray (n,)
        Per contact pair; the key is "" for the bodies. Cells are counted over all blocks.
    whole : bool
        Integers: they stand for kinds of things, not for amounts.
    """

    name: str
    place: str
    at: str
    values: dict
    whole: bool

    @property
    def label(self):
        """str : what the colour bar says."""
        return self.name.replace("_", " ")

    @property
    def all_values(self):
        """ndarray (n,) : the finite numbers of all pairs together."""
        values = np.concatenate([np.zeros(0), *self.values.values()])
        return values[np.isfinite(values)]

    def word(self, number):
        """Return what a whole number stands for.

        Parameters
        ----------
        number : int

        Returns
        -------
        str
        """
        known = self.name == "status" and 0 <= number < len(STATUS)
        return STATUS[number] if known else f"{self.label} {number}"


def _arrays(result):
    """All arrays: (place, at) -> name -> part -> ndarray, those of the bodies first."""
    places = {(place, at): {} for place in ("bodies", "surfaces", "points") for at in ("cell", "point")}
    pieces = [
        ("bodies", "", result.bodies),
        *(("surfaces", name, piece) for name, piece in result.surfaces.items()),
        *(("points", name, piece) for name, piece in result.points.items()),
    ]
    for place, part, piece in pieces:
        for name, blocks in piece.cell_data.items():
            if blocks:
                places[place, "cell"].setdefault(name, {})[part] = np.concatenate(blocks)
        for name, array in piece.point_data.items():
            places[place, "point"].setdefault(name, {})[part] = array
    return places


def _components(arrays):
    """Ending of a name -> column; the bare name of a vector ("") is its magnitude."""
    array = next(iter(arrays.values()))
    if array.ndim == 1:
        return {"": None}
    if array.shape[1] == len(_VECTOR):
        return {"": None, **{f"_{part}": column for column, part in enumerate(_VECTOR)}}
    parts = _TENSOR if array.shape[1] == len(_TENSOR) else range(array.shape[1])
    return {f"_{part}": column for column, part in enumerate(parts)}


def available(result):
    """Names that `find` knows.

    Parameters
    ----------
    result : Result

    Returns
    -------
    list of str
    """
    names = {}
    for fields in _arrays(result).values():
        for name, arrays in fields.items():
            names.update({name + ending: None for ending in _components(arrays)})
    return list(names)


def find(result, name=None):
    """The quantity of that name; without one, what most deserves a picture.

    Parameters
    ----------
    result : Result
    name : str, optional
        A field, or one of its components: displacement_x, stress_xy. A vector's bare name is its magnitude. "mesh": the
        bodies, each in a colour of its own.

    Returns
    -------
    Quantity

    Raises
    ------
    InputError
        There is no such field.
    """
    names = available(result)
    name = "body" if name == "mesh" and "mesh" not in names else name
    if name is None:
        pieces = result.surfaces.values()
        touching = any(np.any(b > 0) for piece in pieces for b in piece.cell_data.get("contact_pressure", []))
        wanted = ["contact_pressure"] * touching + ["equivalent_stress", "displacement", *names]
        name = next((field for field in wanted if field in names), None)
    for (place, at), fields in _arrays(result).items():
        for field, arrays in fields.items():
            for ending, column in _components(arrays).items():
                if field + ending == name:
                    values = {part: _column(array, column) for part, array in arrays.items()}
                    whole = all(array.dtype.kind in "iu" for array in arrays.values())
                    return Quantity(name, place, at, values, whole)
    allowed = f"{', '.join(names) or 'none'}{nearby(str(name), names)}"
    raise InputError(f"{result.directory}: no field {name!r}; allowed: {allowed}")


def _column(array, column):
    """A component as floating point numbers, or the magnitude of a vector."""
    if array.ndim == 1:
        return array.astype(float)
    return np.linalg.norm(array, axis=1) if column is None else array[:, column].astype(float)
