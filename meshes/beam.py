"""A long rectangle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .blocks import Box
from .tools import check_cell, finish, gmsh_model


def beam(
    path: str | Path,
    n: Sequence[int] = (20, 4),
    cell: str = "quadrilateral",
    *,
    length: float = 10.0,
    height: float = 2.0,
    order: int = 1,
) -> Path:
    """The rectangle [0, length] x [-height/2, height/2] with a structured mesh.

    Groups: beam; left, right, bottom, top; points origin (the lower left corner), corner_00, corner_10,
    corner_01, corner_11.

    Parameters
    ----------
    path : file to write
    n : cells along and across
    cell : quadrilateral or triangle
    length, height : size of the rectangle
    order : 1 or 2, degree of the geometry
    """
    check_cell("beam", cell, 2, order)
    with gmsh_model("beam"):
        Box((0.0, -0.5 * height), (length, 0.5 * height), tuple(n), cell).name_groups("beam", "")
        return finish(path, 2, order)
