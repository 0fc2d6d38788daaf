"""A block with a domed underside on a flat block, structured: hexahedra for what a ball on a block is to tetrahedra."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .grid import Grid, add, lattice, name_boundary, near, refined
from .tools import check_cell, gmsh_model, group, write

_ZONE = 0.2  # distance from the origin up to which the cells are fine
_GROWTH = 1.3  # of neighbouring cells outside of it
_MISMATCH = 1.25  # size of the block's cells in units of the dome's


def _half(h: float, length: float) -> np.ndarray:
    """Ends of cells from 0 to length: of size h in the zone, growing outside of it."""
    fine = np.linspace(0.0, _ZONE, max(1, round(_ZONE / h)) + 1)
    span = (length - _ZONE) / fine[1]
    n = max(1, int(np.ceil(np.log1p((_GROWTH - 1.0) * span) / np.log(_GROWTH))))
    size = _GROWTH ** np.arange(n)
    return np.concatenate([fine, _ZONE + (length - _ZONE) * np.cumsum(size)[:-1] / size.sum(), [length]])


def _axes(h: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of the lattice along a side, -1 to 1, and from the contact into the body, 0 to 1."""
    half = _half(h, 1.0)
    return refined(np.concatenate([-half[:0:-1], half]), order), refined(half, order)


def _nodes(h: float, order: int) -> int:
    sides = [_axes(size, order) for size in (h, _MISMATCH * h)]
    return sum(len(side) ** 2 * len(depth) for side, depth in sides)


def _grids(h: float, order: int, radius: float, cell: str) -> tuple[Grid, Grid]:
    """The dome, z = r^2 / (2 radius) below and 1 above, and the block below z = 0."""
    side, depth = _axes(h, order)
    x, y, s = np.meshgrid(side, side, depth, indexing="ij")
    floor = (x**2 + y**2) / (2.0 * radius)
    dome = lattice(np.stack([x, y, floor + (1.0 - floor) * s], axis=-1), order, cell)
    side, depth = _axes(_MISMATCH * h, order)
    x, y, s = np.meshgrid(side, side, depth, indexing="ij")
    block = lattice(np.stack([x, y, -s], axis=-1), order, cell)

    def under(points):
        return np.abs(points[..., 2] - (points[..., 0] ** 2 + points[..., 1] ** 2) / (2.0 * radius)) < 1e-9

    dome = name_boundary(dome, "dome_sides", ball_skin=under, ball_top=near(2, 1.0))
    return dome, name_boundary(block, "block_sides", block_top=near(2, 0.0), block_bottom=near(2, -1.0))


def dome_on_block(
    path: str | Path,
    h: float = 0.05,
    order: int = 1,
    cell: str = "hexahedron",
    *,
    unknowns: int | None = None,
    radius: float = 2.0,
) -> Path:
    """A block [-1, 1]^2 with a domed underside on the middle of a block [-1, 1]^2 x [-1, 0]; they touch at the origin.

    Near the origin the dome is a ball of the given radius; its upper side is plane, z = 1. Groups as those of
    ball_on_block: ball, block; ball_skin (the domed side), ball_top, dome_sides; block_top, block_bottom, block_sides.

    Parameters
    ----------
    path : file to write
    h : element size at the contact
    order : 1 or 2, degree of the geometry
    cell : hexahedron, or tetrahedron (six out of every hexahedron)
    unknowns : instead of h: wanted number of displacement unknowns (3 per node, degree = order, supports included),
        met as nearly as whole cells allow
    radius : of the dome at the origin, more than 1
    """
    check_cell("dome_on_block", cell, 3, order)
    if not radius > 1.0:
        raise ValueError(f"mesh 'dome_on_block': radius {radius}; expected more than 1")
    if unknowns is not None:
        sizes = np.geomspace(2e-3, 2.0 * _ZONE, 1000)
        found = np.array([3 * _nodes(size, order) for size in sizes])
        h = float(sizes[np.argmin(np.abs(np.log(found / unknowns)))])
    with gmsh_model("dome_on_block"):
        for grid, name in zip(_grids(h, order, radius, cell), ("ball", "block"), strict=True):
            body, facets = add(grid)
            group(3, name, [body])
            for key, tag in facets.items():
                group(2, key, [tag])
        return write(path)
