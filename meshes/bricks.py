"""Boxes with structured meshes from closed formulas, bent and moved at will: what gmsh's geometry would refuse.

gmsh takes points nearer than 1e-8 for the same, which shuts out a model of 1e-12, or one far from the origin. Here the
points come from a lattice in [0, 1]^d; a function bends every box, and another one places the whole model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .grid import Grid, add, lattice, name_boundary, near, refined
from .tools import check_cell, gmsh_model, group, write

SIDES = {
    2: ("left", "right", "bottom", "top"),
    3: ("left", "right", "front", "back", "bottom", "top"),
}


@dataclass(frozen=True)
class Brick:
    """A box, its cells, and what bends it.

    Attributes
    ----------
    name : group of its cells; its sides are NAME_left, NAME_right (x), NAME_front, NAME_back (y, in space),
        NAME_bottom, NAME_top (last direction)
    lower, upper : corners with the smallest and the largest coordinates
    n : in each direction the number of cells, or their ends as increasing numbers from 0 to 1
    cell : quadrilateral, triangle, hexahedron, tetrahedron
    order : degree of the geometry
    bend : applied to the points (n, dim) of the box; the nodes of degree 2 are bent like all others
    """

    name: str
    lower: Sequence[float]
    upper: Sequence[float]
    n: Sequence[int | Sequence[float]]
    cell: str
    order: int = 1
    bend: Callable[[np.ndarray], np.ndarray] | None = None


def _grid(brick: Brick, place: Callable | None) -> Grid:
    dim = len(brick.lower)
    check_cell("bricks", brick.cell, dim, brick.order)
    ends = [np.linspace(0.0, 1.0, n + 1) if np.ndim(n) == 0 else np.asarray(n, dtype=float) for n in brick.n]
    axes = np.meshgrid(*[refined(values, brick.order) for values in ends], indexing="ij")
    points = np.zeros((*axes[0].shape, 3))
    points[..., :dim] = np.stack(axes, axis=-1)
    grid = lattice(points, brick.order, brick.cell)
    where = {f"{brick.name}_{side}": near(k // 2, float(k % 2), 1e-14) for k, side in enumerate(SIDES[dim])}
    grid = name_boundary(grid, **where)
    start, stop = np.asarray(brick.lower, float), np.asarray(brick.upper, float)
    x = start + (stop - start) * grid.points[:, :dim]
    for change in (brick.bend, place):
        x = x if change is None else change(x)
    grid.points[:, :dim] = x
    return grid


def bricks(
    path: str | Path,
    parts: Sequence[Brick],
    place: Callable[[np.ndarray], np.ndarray] | None = None,
    skins: dict[str, Sequence[str]] | None = None,
) -> Path:
    """Boxes that share no node.

    Groups: those of every box, see `Brick`, and left, right, ... with the sides of all of them.

    Parameters
    ----------
    path : file to write
    parts : the boxes, of one dimension
    place : applied to the points (n, dim) of all boxes at the end
    skins : further groups, each of some sides, such as {"corner": ["NAME_left", "NAME_bottom"]}
    """
    dim = len(parts[0].lower)
    together: dict[str, list[int]] = {side: [] for side in SIDES[dim]}
    of_side: dict[str, int] = {}
    with gmsh_model("bricks"):
        for brick in parts:
            body, tags = add(_grid(brick, place))
            group(dim, brick.name, [body])
            for side in SIDES[dim]:
                tag = tags[f"{brick.name}_{side}"]
                group(dim - 1, f"{brick.name}_{side}", [tag])
                together[side].append(tag)
                of_side[f"{brick.name}_{side}"] = tag
        together.update({name: [of_side[side] for side in sides] for name, sides in (skins or {}).items()})
        for name, found in together.items():
            group(dim - 1, name, found)
        return write(path)
