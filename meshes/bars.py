"""Round bars in the plane of their meridian (x the radius, y the axis), half their length."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .grid import add, add_vertex, lattice, name_boundary, near
from .tools import check_cell, gmsh_model, group, write


def round_bar(
    path: str | Path,
    n: Sequence[int] = (8, 20),
    order: int = 1,
    cell: str = "quadrilateral",
    *,
    radius: float = 6.413,
    length: float = 53.334,
    waist: float = 0.982,
) -> Path:
    """The half 0 <= y <= length / 2 of a bar whose radius falls linearly towards the middle y = 0.

    Groups: bar; axis (x = 0), middle (y = 0), end (y = length / 2), side; neck (the point of the side at y = 0), rim
    (that at the end).

    Parameters
    ----------
    path : file to write
    n : cells along the radius and the half length
    order : 1 or 2, degree of the geometry
    cell : quadrilateral, triangle
    radius, length : of the bar, the radius at its ends
    waist : radius in the middle over that at the ends
    """
    check_cell("round_bar", cell, 2, order)
    if not (radius > 0 and length > 0 and 0 < waist <= 1 and min(n) >= 1):
        raise ValueError(f"mesh 'round_bar': radius {radius}, length {length}, waist {waist}, cells {tuple(n)}; "
                         "expected positive numbers, and a waist of at most 1")  # fmt: skip
    half = 0.5 * length
    s, y = np.meshgrid(
        np.linspace(0.0, 1.0, order * n[0] + 1), np.linspace(0.0, half, order * n[1] + 1), indexing="ij"
    )
    x = s * radius * (waist + (1.0 - waist) * y / half)
    with gmsh_model("round_bar"):
        grid = lattice(np.stack([x, y, np.zeros_like(x)], axis=-1), order, cell)
        grid = name_boundary(grid, "side", axis=near(0, 0.0), middle=near(1, 0.0), end=near(1, half))
        body, tags = add(grid)
        group(2, "bar", [body])
        for key, tag in tags.items():
            group(1, key, [tag])
        group(0, "neck", [add_vertex(grid, (waist * radius, 0.0, 0.0))])
        group(0, "rim", [add_vertex(grid, (radius, half, 0.0))])
        return write(path)
