"""A stiff foot with a round sole on a slab, to be pressed into it and dragged along."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .blocks import Box
from .grid import add, lattice, name_boundary, near
from .tools import check_cell, generate, gmsh_model, group, move_nodes, write

_DEFAULT_CELL = {2: "quadrilateral", 3: "hexahedron"}


def _divisions(extent: np.ndarray, h: float) -> list[int]:
    return [max(1, round(float(length) / h)) for length in extent]


def _round_off(foot: Box, radius: float) -> None:
    """Bend the bottom of the foot into a circle or sphere that touches y = 0 (z = 0) at the origin; the top stays."""
    dim, height = foot.dim, foot.extent[-1]
    own = {(dim, foot.tag)} | {(d, tag) for d in range(dim) for tag in foot._boundary(d)}

    def bend(x: np.ndarray, entity: tuple[int, int]) -> np.ndarray:
        if entity not in own:
            return x
        sag = radius - np.sqrt(radius**2 - np.sum(x[:, : dim - 1] ** 2, axis=1))
        moved = x.copy()
        moved[:, dim - 1] += sag * (1.0 - x[:, dim - 1] / height)
        return moved

    move_nodes(bend)


def ironing(
    path: str | Path,
    dim: int = 2,
    h: float = 0.1,
    order: int = 1,
    cell: str | None = None,
    *,
    radius: float = 1.0,
    foot: Sequence[float] = (0.8, 0.5),
    slab: Sequence[float] = (4.0, 1.0),
    start: float = 1.0,
    width: float = 1.6,
    mismatch: float = 0.8,
) -> Path:
    """A foot with a round sole that touches a slab at the origin; both have structured meshes.

    Groups: slab, indenter; slab_bottom, slab_top, slab_sides, indenter_top, indenter_skin (the sole),
    indenter_sides.

    Parameters
    ----------
    path : file to write
    dim : 2 or 3
    h : element size of the slab
    order : 1 or 2, degree of the geometry
    cell : quadrilateral (default in 2D), triangle, hexahedron (default in 3D), tetrahedron
    radius : of the sole: a circle in 2D, a sphere in 3D
    foot : length (in 3D width, too) and height of the foot
    slab : length and depth of the slab
    start : distance of the origin from the left end of the slab
    width : of the slab in 3D
    mismatch : element size of the foot in units of h
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("ironing", cell, dim, order)
    if not 0.5 * foot[0] * (dim - 1) ** 0.5 < radius:
        raise ValueError(f"mesh 'ironing': a foot of length {foot[0]}; expected one below the sphere's diameter")
    half = 0.5 * foot[0]
    across = [-0.5 * width] * (dim - 2), [0.5 * width] * (dim - 2)
    low, high = np.array([-start, *across[0], -slab[1]]), np.array([slab[0] - start, *across[1], 0.0])
    left, right = np.array([*[-half] * (dim - 1), 0.0]), np.array([*[half] * (dim - 1), foot[1]])
    with gmsh_model("ironing"):
        bodies = {
            "slab": Box(low, high, _divisions(high - low, h), cell),
            "indenter": Box(left, right, _divisions(right - left, mismatch * h), cell),
        }
        for name, box in bodies.items():
            group(dim, name, [box.tag])
            sides = dict(box.sides)
            group(dim - 1, f"{name}_top", [sides.pop("top")])
            group(dim - 1, "slab_bottom" if name == "slab" else "indenter_skin", [sides.pop("bottom")])
            group(dim - 1, f"{name}_sides", sides.values())
        generate(dim, order)
        _round_off(bodies["indenter"], radius)
        return write(path)


# the foundation, and the slab on it: its sides, the highest of its round bottom, which touches y = 4, and its top
_FOUNDATION = np.array([12.0, 4.0])
_LEFT, _RIGHT, _TIP, _EDGE, _TOP = 0.2, 1.4, 4.2, 4.5, 5.4


def _arc(x: np.ndarray) -> np.ndarray:
    """Height of the circle through (0.2, 4.5), (0.8, 4.2), (1.4, 4.5)."""
    half, rise = 0.5 * (_RIGHT - _LEFT), _EDGE - _TIP
    radius = (half**2 + rise**2) / (2.0 * rise)
    return _TIP + radius - np.sqrt(radius**2 - (x - _LEFT - half) ** 2)


def ironing_slab(path: str | Path, n: int = 4, order: int = 1, cell: str = "quadrilateral") -> Path:
    """A slab with a round bottom above a long foundation, both deformable, in the plane: it is pressed down by 1, then
    dragged along by 10 (K. A. Fischer, P. Wriggers, Comput. Methods Appl. Mech. Engrg. 195, 2006, 5020).

    Groups: foundation, slab; foundation_top, foundation_bottom, foundation_sides, slab_skin (bottom and sides),
    slab_top.

    Parameters
    ----------
    path : file to write
    n : cells per unit of length
    order : 1 or 2, degree of the geometry
    cell : quadrilateral, triangle
    """
    check_cell("ironing_slab", cell, 2, order)
    axes = [np.linspace(0.0, length, order * round(n * length) + 1) for length in _FOUNDATION]
    x, y = np.meshgrid(*axes, indexing="ij")
    across, up = max(2, round(n * (_RIGHT - _LEFT))), max(2, round(n * (_TOP - _TIP)))
    a, b = np.meshgrid(
        np.linspace(_LEFT, _RIGHT, order * across + 1), np.linspace(0.0, 1.0, order * up + 1), indexing="ij"
    )
    plates = {"foundation": (x, y), "slab": (a, (1.0 - b) * _arc(a) + b * _TOP)}
    with gmsh_model("ironing_slab"):
        for name, places in plates.items():
            grid = lattice(np.stack([*places, np.zeros_like(places[0])], axis=-1), order, cell)
            if name == "slab":
                grid = name_boundary(grid, "slab_skin", slab_top=near(1, _TOP))
            else:
                ends = {"foundation_top": near(1, _FOUNDATION[1]), "foundation_bottom": near(1, 0.0)}
                grid = name_boundary(grid, "foundation_sides", **ends)
            body, tags = add(grid)
            group(2, name, [body])
            for key, tag in tags.items():
                group(1, key, [tag])
        return write(path)
