"""Cook's membrane: a tapered panel, in the plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .grid import add, add_vertex, lattice, name_boundary, near
from .tools import check_cell, gmsh_model, group, write

_CORNERS = np.array([[0.0, 0.0], [48.0, 44.0], [48.0, 60.0], [0.0, 44.0]])


def cook(path: str | Path, n: int = 16, order: int = 1, cell: str = "quadrilateral") -> Path:
    """A panel with the corners (0, 0), (48, 44), (48, 60), (0, 44), n by n cells.

    Groups: panel; left, right, bottom, top; corner (the point at (48, 60)).

    Parameters
    ----------
    path : file to write
    n : cells along each side
    order : 1 or 2, degree of the geometry
    cell : quadrilateral, triangle
    """
    check_cell("cook", cell, 2, order)
    s = np.linspace(0.0, 1.0, order * n + 1)
    a, b = (t[..., None] for t in np.meshgrid(s, s, indexing="ij"))
    low = (1.0 - a) * _CORNERS[0] + a * _CORNERS[1]
    high = (1.0 - a) * _CORNERS[3] + a * _CORNERS[2]
    plane = (1.0 - b) * low + b * high
    with gmsh_model("cook"):
        grid = lattice(np.concatenate([plane, np.zeros_like(a)], axis=-1), order, cell)
        # the lower and the upper side lie on straight lines of different slope
        grid = name_boundary(
            grid,
            left=near(0, 0.0),
            right=near(0, 48.0),
            bottom=lambda x: np.abs(x[..., 1] - 44.0 / 48.0 * x[..., 0]) < 1e-9,
            top=lambda x: np.abs(x[..., 1] - 44.0 - 16.0 / 48.0 * x[..., 0]) < 1e-9,
        )
        body, tags = add(grid)
        group(2, "panel", [body])
        for key, tag in tags.items():
            group(1, key, [tag])
        group(0, "corner", [add_vertex(grid, (48.0, 60.0, 0.0))])
        return write(path)
