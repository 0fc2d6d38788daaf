"""Boxes with structured meshes: one block, or two stacked blocks whose meshes do not match."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import gmsh
import numpy as np

from .tools import ALIGNED, check_cell, finish, gmsh_model, group

_SIDES = {
    2: (("left", "right"), ("bottom", "top")),
    3: (("left", "right"), ("front", "back"), ("bottom", "top")),
}
_DEFAULT_CELL = {2: "quadrilateral", 3: "hexahedron"}


class Box:
    """An axis-parallel box of the model with a structured mesh of its own.

    Parameters
    ----------
    lower, upper : sequences of `dim` floats
        The corners with the smallest and the largest coordinates.
    divisions : sequence of `dim` ints
        Cells in each direction.
    cell : str
        Quadrilaterals and hexahedra are recombined, simplices are cut from the same grid.

    Attributes
    ----------
    dim : int
    tag : int
        Tag of the body's entity.
    sides : dict
        Entity of each side, by the names left, right (x), front, back (y, in 3D), bottom, top (the last
        direction).
    corners : dict
        Point of each corner, by a string with 0 (smallest) or 1 (largest coordinate) for each direction.
    """

    def __init__(self, lower: Sequence[float], upper: Sequence[float], divisions: Sequence[int], cell: str):
        self.dim = len(lower)
        start, stop = np.asarray(lower, float), np.asarray(upper, float)
        self.start, self.extent = start, stop - start
        if self.dim == 2:
            self.tag = gmsh.model.occ.addRectangle(*start, 0.0, *self.extent)
        else:
            self.tag = gmsh.model.occ.addBox(*start, *self.extent)
        gmsh.model.occ.synchronize()
        self.sides = {name: tag for tag, name in self._named_sides()}
        self.corners = {name: tag for tag, name in self._named_corners()}
        self._mesh_on_a_grid(divisions, cell)

    def _place(self, dim: int, tag: int) -> np.ndarray:
        """Centre of an entity in units of the box: 0 or 1 on a side, 0.5 in the middle."""
        box = gmsh.model.getBoundingBox(dim, tag)
        centre = 0.5 * (np.asarray(box[:3]) + np.asarray(box[3:]))
        return np.round((centre[: self.dim] - self.start) / self.extent, 3)

    def _boundary(self, dim: int) -> list[int]:
        bodies = [(self.dim, self.tag)]
        for _ in range(self.dim - dim):
            bodies = gmsh.model.getBoundary(bodies, combined=False, oriented=False)
        return sorted({tag for _, tag in bodies})

    def _named_sides(self):
        for tag in self._boundary(self.dim - 1):
            place = self._place(self.dim - 1, tag)
            axis = int(np.argmax(np.abs(place - 0.5)))
            yield tag, _SIDES[self.dim][axis][int(place[axis] > 0.5)]

    def _named_corners(self):
        for tag in self._boundary(0):
            yield tag, "".join(str(int(x > 0.5)) for x in self._place(0, tag))

    def _mesh_on_a_grid(self, divisions: Sequence[int], cell: str) -> None:
        for tag in self._boundary(1):
            axis = int(np.argmin(np.abs(self._place(1, tag) - 0.5)))
            gmsh.model.mesh.setTransfiniteCurve(tag, divisions[axis] + 1)
        for tag in self._boundary(2):
            gmsh.model.mesh.setTransfiniteSurface(tag)
            if cell in ALIGNED:
                gmsh.model.mesh.setRecombine(2, tag)
        if self.dim == 3:
            gmsh.model.mesh.setTransfiniteVolume(self.tag)

    def name_groups(self, body: str, prefix: str) -> None:
        """Name the body, its sides and its corners: `prefix` + side name, corner_01.., origin."""
        group(self.dim, body, [self.tag])
        for side, tag in self.sides.items():
            group(self.dim - 1, prefix + side, [tag])
        for corner, tag in self.corners.items():
            group(0, f"{prefix}corner_{corner}", [tag])
        group(0, f"{prefix}origin", [self.corners["0" * self.dim]])


def _per_direction(name: str, key: str, value: int | float | Sequence, count: int) -> tuple:
    """`value` as a tuple of `count` entries; a single number stands for all directions."""
    values = tuple(np.ravel(value).tolist()) if np.ndim(value) else (value,) * count
    if len(values) != count:
        raise ValueError(f"mesh '{name}': {key} has {len(values)} entries; expected 1 or {count}")
    return values


def _divisions(name: str, key: str, value: int | Sequence[int], dim: int) -> tuple:
    """Divisions per direction; ValueError unless all of them are positive."""
    values = _per_direction(name, key, value, dim)
    if any(n < 1 or n != int(n) for n in values):
        raise ValueError(f"mesh '{name}': {key} {values}; expected whole numbers of at least 1")
    return tuple(int(n) for n in values)


def one_block(
    path: str | Path,
    dim: int = 2,
    n: int | Sequence[int] = 4,
    cell: str | None = None,
    *,
    size: float | Sequence[float] = 1.0,
    lower: float | Sequence[float] = 0.0,
    order: int = 1,
) -> Path:
    """A box with a structured mesh.

    Groups: block; left, right (x), front, back (y, in 3D), bottom, top (last direction); points origin,
    corner_00 .. corner_11 (corner_000 .. corner_111), one digit per direction, 0 at the smallest and 1 at
    the largest coordinate.

    Parameters
    ----------
    path : file to write
    dim : 2 or 3
    n : cells in each direction, one number or `dim` of them
    cell : quadrilateral (default in 2D), triangle, hexahedron (default in 3D), tetrahedron
    size : edge lengths, one number or `dim` of them
    lower : corner with the smallest coordinates
    order : 1 or 2, degree of the geometry
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("one_block", cell, dim, order)
    start = np.asarray(_per_direction("one_block", "lower", lower, dim), float)
    stop = start + _per_direction("one_block", "size", size, dim)
    with gmsh_model("one_block"):
        Box(start, stop, _divisions("one_block", "n", n, dim), cell).name_groups("block", "")
        return finish(path, dim, order)


def two_blocks(
    path: str | Path,
    dim: int = 2,
    n_lower: int | Sequence[int] = 4,
    n_upper: int | Sequence[int] = 3,
    cell: str | None = None,
    *,
    size: float | Sequence[float] = 1.0,
    heights: Sequence[float] = (1.0, 1.0),
    order: int = 1,
    gap: float = 0.0,
    offset: float | Sequence[float] = 0.0,
    widths: Sequence[float] | None = None,
    cell_upper: str | None = None,
) -> Path:
    """Two stacked boxes with structured meshes of their own; the lower one starts at the origin.

    Groups: lower, upper; lower_left, lower_right, lower_front, lower_back (in 3D), lower_bottom, lower_top
    and the same with upper_; left, right, front, back (the sides of both); points lower_origin,
    lower_corner_00 .. (one digit per direction, 0 at the smallest and 1 at the largest coordinate),
    upper_origin, upper_corner_00 ... The contact surfaces are lower_top and upper_bottom.

    Parameters
    ----------
    path : file to write
    dim : 2 or 3
    n_lower, n_upper : cells in each direction, one number or `dim` of them
    cell : quadrilateral (default in 2D), triangle, hexahedron (default in 3D), tetrahedron
    size : horizontal size of both blocks, one number or `dim` - 1 of them
    heights : heights of the lower and the upper block
    order : 1 or 2, degree of the geometry
    gap : vertical distance between the blocks; negative where they overlap
    offset : horizontal shift of the upper block, in x or in every horizontal direction
    widths : sizes in x of the lower and the upper block, instead of size[0]
    cell_upper : cell of the upper block where it differs
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("two_blocks", cell, dim, order)
    check_cell("two_blocks", cell_upper or cell, dim, order)
    extent = np.array(_per_direction("two_blocks", "size", size, dim - 1), float)
    shift = np.zeros(dim - 1)
    shift[: np.size(offset)] = np.ravel(offset)
    extents = np.tile(extent, (2, 1))
    if widths is not None:
        extents[:, 0] = widths
    floor = heights[0] + gap
    with gmsh_model("two_blocks"):
        lower = Box(
            np.zeros(dim), [*extents[0], heights[0]], _divisions("two_blocks", "n_lower", n_lower, dim), cell
        )
        upper = Box(
            [*shift, floor],
            [*(shift + extents[1]), floor + heights[1]],
            _divisions("two_blocks", "n_upper", n_upper, dim),
            cell_upper or cell,
        )
        lower.name_groups("lower", "lower_")
        upper.name_groups("upper", "upper_")
        for pair, k in product(_SIDES[dim][:-1], (0, 1)):
            group(dim - 1, pair[k], [lower.sides[pair[k]], upper.sides[pair[k]]])
        return finish(path, dim, order)


def overclosed_cubes(
    path: str | Path,
    n_lower: int | Sequence[int] = 4,
    n_upper: int | Sequence[int] = 3,
    cell: str = "hexahedron",
    *,
    order: int = 1,
) -> Path:
    """Two unit cubes that overlap by 0.01: [0,1]^3 and [0,1]^2 x [0.99, 1.99].

    Groups and arguments: see `two_blocks`.
    """
    return two_blocks(path, 3, n_lower, n_upper, cell, order=order, gap=-0.01)
