"""Plane meshes of a few structured patches: rectangles and sectors of rings with given lines, joined, in one file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .grid import Grid, add, add_vertex, lattice, refined
from .tools import gmsh_model, group, write


def growing(step: float, length: float, factor: float = 1.25) -> np.ndarray:
    """Ends of intervals from 0 to `length`: the first about `step` long, each longer than the last by a factor."""
    n = max(1, round(float(np.log1p(length / step * (factor - 1.0)) / np.log(factor))))
    size = factor ** np.arange(n)
    return np.concatenate([[0.0], length * np.cumsum(size) / size.sum()])


def rectangle(x: Sequence[float], y: Sequence[float], order: int = 2) -> Grid:
    """Quadrilaterals between the lines x and y (increasing numbers)."""
    axes = np.meshgrid(*(refined(np.asarray(line, float), order) for line in (x, y)), indexing="ij")
    return lattice(np.stack([*axes, 0.0 * axes[0]], axis=-1), order, "quadrilateral")


def sector(r: Sequence[float], degrees: Sequence[float], order: int = 2) -> Grid:
    """Curved quadrilaterals between circles around the origin and rays (increasing radii and angles)."""
    radius, angle = np.meshgrid(
        *(refined(np.asarray(line, float), order) for line in (r, np.radians(degrees))), indexing="ij"
    )
    # exact zeros on the axes, where cosines and sines leave round-off
    c, s = (np.where(np.abs(part) < 1e-15, 0.0, part) for part in (np.cos(angle), np.sin(angle)))
    return lattice(np.stack([radius * c, radius * s, 0.0 * radius], axis=-1), order, "quadrilateral")


@contextmanager
def patches(
    path: str | Path, points: Mapping[str, tuple[str, Sequence[float]]] | None = None
) -> Iterator[dict[str, Grid]]:
    """Write the bodies that are put into the dict; groups of the same name in two bodies are one.

    Parameters
    ----------
    path : file to write
    points : body and place (x, y) of nodes that are groups of their own, by name

    Yields
    ------
    dict
        To be filled with grids, made while it is open; their names are those of the groups of cells.
    """
    named: dict[str, list[int]] = {}
    bodies: dict[str, Grid] = {}
    with gmsh_model("patches"):
        yield bodies
        for name, grid in bodies.items():
            body, tags = add(grid)
            group(2, name, [body])
            for key, tag in tags.items():
                named.setdefault(key, []).append(tag)
            for key, (owner, place) in (points or {}).items():
                if owner == name:
                    group(0, key, [add_vertex(grid, [*place, 0.0])])
        for key, found in named.items():
            group(1, key, found)
        write(path)
