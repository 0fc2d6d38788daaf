"""A stiff foot with a round sole on a slab, to be pressed into it and dragged along."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .blocks import Box
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
