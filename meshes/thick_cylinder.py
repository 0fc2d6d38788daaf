"""A thick cylinder: a quarter of its section, in the plane or extruded, and its axisymmetric strip."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .grid import Grid, add, graded, lattice, name_boundary, near, refined, sweep, upright
from .tools import check_cell, gmsh_model, group, write

_PLANE = {"quadrilateral": "quadrilateral", "triangle": "triangle", "hexahedron": "quadrilateral"}
_DEFAULT_CELL = {2: "quadrilateral", 3: "hexahedron"}


def _check(name: str, inner: float, outer: float, grading: float, counts: Sequence[int]) -> None:
    if not 0 <= inner < outer:
        raise ValueError(f"mesh '{name}': radii {inner}, {outer}; expected 0 <= inner < outer")
    if not grading > 0 or min(counts) < 1:
        raise ValueError(f"mesh '{name}': grading {grading}, cells {tuple(counts)}; expected positive numbers")


def _write(path: str | Path, grid: Grid, body: str) -> Path:
    tag, facets = add(grid)
    group(grid.dim, body, [tag])
    for key, entity in facets.items():
        group(grid.dim - 1, key, [entity])
    return write(path)


def thick_cylinder(
    path: str | Path,
    dim: int = 2,
    n: Sequence[int] = (8, 12),
    order: int = 1,
    cell: str | None = None,
    *,
    inner: float = 100.0,
    outer: float = 200.0,
    grading: float = 1.0,
    height: float = 10.0,
    layers: int = 1,
) -> Path:
    """A quarter of a thick cylinder, x >= 0 and y >= 0, its axis the z-axis; structured.

    Groups: body; inner, outer (the round faces), side_x (on x = 0), side_y (on y = 0); in 3D front (z = 0) and back (z
    = height).

    Parameters
    ----------
    path : file to write
    dim : 2 or 3
    n : cells across the wall and around the quarter
    order : 1 or 2, degree of the geometry
    cell : quadrilateral (default in 2D), triangle, hexahedron (default in 3D), tetrahedron
    inner, outer : radii
    grading : thickness of the outermost cells over that of the innermost ones
    height, layers : length of the cylinder and its cells along the axis (3D)
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("thick_cylinder", cell, dim, order)
    _check("thick_cylinder", inner or -1.0, outer, grading, (*n, layers))
    across, around = n
    r = inner + (outer - inner) * refined(graded(across, grading), order)[:, None]
    t = 0.5 * np.pi * np.linspace(0.0, 1.0, order * around + 1)
    c, s = np.cos(t), np.sin(t)
    c[-1] = s[0] = 0.0
    points = np.stack([r * c, r * s, np.zeros((len(r), len(t)))], axis=-1)
    with gmsh_model("thick_cylinder"):
        grid = lattice(points, order, _PLANE.get(cell, "triangle"))
        mean = 0.5 * (inner + outer)
        grid = name_boundary(
            grid,
            side_x=near(0, 0.0),
            side_y=near(1, 0.0),
            inner=lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < mean,
            outer=lambda x: np.hypot(x[..., 0], x[..., 1]).min(axis=1) > mean,
        )
        if dim == 3:
            grid = sweep(grid, layers, upright(height), "front", "back")
        return _write(path, grid, "body")


def cylinder_strip(
    path: str | Path,
    n: Sequence[int] = (8, 2),
    order: int = 1,
    cell: str = "quadrilateral",
    *,
    inner: float = 100.0,
    outer: float = 200.0,
    height: float = 10.0,
    grading: float = 1.0,
) -> Path:
    """The rectangle [inner, outer] x [0, height]: the meridian section of a thick cylinder (x is the radius).

    Groups: body; inner, outer (x = inner, outer), bottom, top. With inner = 0 it is a full disk, inner its axis.

    Parameters
    ----------
    path : file to write
    n : cells across the wall and along the axis
    order : 1 or 2, degree of the geometry
    cell : quadrilateral or triangle
    inner, outer : radii
    height : length along the axis
    grading : thickness of the outermost cells over that of the innermost ones
    """
    check_cell("cylinder_strip", cell, 2, order)
    _check("cylinder_strip", inner, outer, grading, n)
    x = inner + (outer - inner) * refined(graded(n[0], grading), order)
    y = height * np.linspace(0.0, 1.0, order * n[1] + 1)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], axis=-1)
    with gmsh_model("cylinder_strip"):
        grid = name_boundary(
            lattice(points, order, cell),
            inner=near(0, inner),
            outer=near(0, outer),
            bottom=near(1, 0.0),
            top=near(1, height),
        )
        return _write(path, grid, "body")
