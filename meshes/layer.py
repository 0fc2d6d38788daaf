"""A layer that lies loose on a large base: half of both, in the plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .grid import add, lattice, name_boundary, near, split_group
from .tools import gmsh_model, group, write

# part by which cells grow from one to the next, and how far along the layer they have the same size [heights]
_GROWTH, _FINE = 1.12, 4.0


def _steps(step: float, end: float, fine: float = _FINE) -> np.ndarray:
    """Increasing numbers from 0 to `end`: steps of one size, then growing ones."""
    x = list(np.arange(round(fine / step) + 1) * step)
    rest = []
    while x[-1] + sum(rest) < end:
        step *= _GROWTH
        rest.append(step)
    # the growing steps are stretched so that the last one ends where it should
    rest = np.array(rest) * ((end - x[-1]) / sum(rest))
    return np.concatenate([x, x[-1] + np.cumsum(rest)])


def layer_on_base(
    path: str | Path,
    n: int = 10,
    *,
    length: float = 16.0,
    base: float = 60.0,
    strip: float = 0.1,
    mismatch: float = 1.1,
) -> Path:
    """Half a layer of height 1 (x >= 0, above y = 0) on half a base (below), both of quadrilaterals.

    Groups: layer, base; layer_bottom, layer_top (without the strip), strip (the part of the top next to x = 0),
    layer_end; base_top, base_bottom, base_side; symmetry (x = 0, both).

    Parameters
    ----------
    path : file to write
    n : cells over the height of the layer; the strip ends at a node where n times its width is a whole number
    length : of the half layer
    base : width and depth of the half base
    strip : half the width of the load
    mismatch : size of the base's cells in units of the layer's
    """
    if n < 1 or abs(n * strip - round(n * strip)) > 1e-9 or round(n * strip) < 1:
        raise ValueError(f"mesh 'layer_on_base': n {n}, strip {strip}; expected n times strip to be a whole number")
    bodies = {
        "layer": (_steps(1.0 / n, length), np.linspace(0.0, 1.0, n + 1)),
        "base": (_steps(mismatch / n, base), -_steps(mismatch / n, base, 0.0)[::-1]),
    }
    symmetry = []
    with gmsh_model("layer_on_base"):
        for name, axes in bodies.items():
            x, y = np.meshgrid(*axes, indexing="ij")
            grid = lattice(np.stack([x, y, 0.0 * x], axis=-1), 1, "quadrilateral")
            top, bottom = float(axes[1][-1]), float(axes[1][0])
            side = "layer_end" if name == "layer" else "base_side"
            where = {"symmetry": near(0, 0.0), f"{name}_top": near(1, top), f"{name}_bottom": near(1, bottom)}
            grid = name_boundary(grid, side, **where)
            if name == "layer":
                grid = split_group(grid, "layer_top", strip=lambda points: points[..., 0] < strip + 1e-9)
            body, tags = add(grid)
            group(2, name, [body])
            symmetry.append(tags.pop("symmetry"))
            for key, tag in tags.items():
                group(1, key, [tag])
        group(1, "symmetry", symmetry)
        return write(path)
