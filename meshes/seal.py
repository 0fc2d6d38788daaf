"""A hollow seal: half of its section, to be squeezed into a groove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .grid import add, lattice, name_boundary, near
from .tools import check_cell, gmsh_model, group, write


def seal(
    path: str | Path, n: Sequence[int] = (3, 28), order: int = 1, cell: str = "quadrilateral", *, radius: float = 1.0,
    wall: float = 0.3, flat: float = 0.6,
) -> Path:  # fmt: skip
    """The half x >= 0 of a tube with a flat bottom and a flat top, half circles between them; its bottom is on y = 0.

    Groups: seal; base (the outside at y = 0), outside (the rest of it), inside, symmetry (x = 0).

    Parameters
    ----------
    path : file to write
    n : cells across the wall and along it
    order : 1 or 2, degree of the geometry
    cell : quadrilateral, triangle
    radius : outer radius of the half circles
    wall : thickness
    flat : half the length of the flat parts
    """
    check_cell("seal", cell, 2, order)
    if min(n) < 1 or not 0.0 < wall < radius or not flat > 0.0:
        raise ValueError(f"mesh 'seal': cells {tuple(n)}, radius {radius}, wall {wall}, flat {flat}; expected positive "
                         "numbers and a wall thinner than the radius")  # fmt: skip
    middle = radius - 0.5 * wall
    round_cells = max(1, round(n[1] * np.pi * middle / (np.pi * middle + 2.0 * flat)))
    flat_cells = max(1, (n[1] - round_cells) // 2)
    ends = np.linspace(0.0, 1.0, order * flat_cells + 1)
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, order * round_cells + 1)
    x = np.concatenate([flat * ends[:-1], np.full(len(angle), flat), flat * (1.0 - ends[1:])])
    turn = np.concatenate([np.full(len(ends) - 1, angle[0]), angle, np.full(len(ends) - 1, angle[-1])])
    way = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    way[np.abs(way) < 1e-15] = 0.0
    depth = np.linspace(radius - wall, radius, order * n[0] + 1)
    points = np.zeros((len(depth), len(x), 3))
    points[..., :2] = depth[:, None, None] * way
    points[..., 0] += x
    points[..., 1] += radius
    tall = 2.0 * radius

    def outside(points: np.ndarray) -> np.ndarray:
        beyond = np.maximum(points[..., 0] - flat, 0.0)
        return np.abs(np.hypot(beyond, points[..., 1] - radius) - radius) < 1e-9 * tall

    with gmsh_model("seal"):
        grid = lattice(points, order, cell)
        grid = name_boundary(grid, "inside", symmetry=near(0, 0.0), base=near(1, 0.0), outside=outside)
        body, facets = add(grid)
        group(2, "seal", [body])
        for key, tag in facets.items():
            group(1, key, [tag])
        return write(path)
