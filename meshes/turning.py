"""Bodies that are turned on each other: a hollow hemisphere on a cube, a square pad on a ring, a disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .grid import Grid, add, join, lattice, name_boundary, near
from .tools import check_cell, gmsh_model, group, write

_RIGHT = 0.5 * np.pi


def _write(path: str | Path, bodies: dict[str, Grid]) -> Path:
    for name, grid in bodies.items():
        body, facets = add(grid)
        group(3, name, [body])
        for key, tag in facets.items():
            group(2, key, [tag])
    return write(path)


def _steps(low: float, high: float, n: int, order: int) -> np.ndarray:
    return np.linspace(low, high, order * n + 1)


def _box(low: Sequence[float], high: Sequence[float], n: Sequence[int], order: int, cell: str) -> Grid:
    """A box of equal cells."""
    ends = [_steps(a, b, k, order) for a, b, k in zip(low, high, n, strict=True)]
    return lattice(np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1), order, cell)


def _half_shell(inner: float, outer: float, n: int, layers: int, order: int, cell: str) -> Grid:
    """The half z <= 0 of a shell around the origin: a patch around its pole, n cells along a side, and four beside it
    that go up to z = 0. Angles between the cells of a patch are equal, as on a cube that is blown up."""
    r = _steps(inner, outer, layers, order)
    whole, half = (np.tan(_steps(low, 0.5 * _RIGHT, k, order)) for low, k in ((-0.5 * _RIGHT, n), (0.0, n // 2)))
    a, b = np.meshgrid(whole, whole, indexing="ij")
    ways = [np.stack([a, b, np.full_like(a, -1.0)], axis=-1)]
    a, b = np.meshgrid(whole, half, indexing="ij")
    for k in range(4):
        c, s = round(np.cos(k * _RIGHT)), round(np.sin(k * _RIGHT))
        ways.append(np.stack([c - s * a, s + c * a, -b], axis=-1))
    patches = []
    for way in ways:
        way = way / np.linalg.norm(way, axis=-1, keepdims=True)
        patches.append(lattice(way[:, :, None] * r[:, None], order, cell))
    return join(patches)


def hemisphere_on_cube(
    path: str | Path, n: int = 8, order: int = 1, cell: str = "hexahedron", *, radius: float = 1.0, inner: float = 0.5,
    side: float = 2.0,
) -> Path:  # fmt: skip
    """A hollow hemisphere, its pole downward, on the middle of a cube; they touch at the origin.

    Groups: hemisphere, cube; hemisphere_skin, hemisphere_inside, hemisphere_top (the ring above); cube_top (z = 0),
    cube_bottom, cube_sides.

    Parameters
    ----------
    path : file to write
    n : cells along the side of the cube, and along each side of the patch around the pole; even
    order : 1 or 2, degree of the geometry
    cell : hexahedron
    radius, inner : of the hemisphere
    side : of the cube
    """
    check_cell("hemisphere_on_cube", cell, 3, order)
    if cell != "hexahedron" or n < 2 or n % 2 or not 0.0 < inner < radius or not side > 0.0:
        raise ValueError(f"mesh 'hemisphere_on_cube': {cell}, n {n}, radii {radius}, {inner}, side {side}; expected "
                         "hexahedra, an even n, an inner radius below the radius, a positive side")  # fmt: skip
    # cells of the shell are about as thick as they are wide in the middle of its wall
    layers = max(1, round(n * (radius - inner) / (0.25 * np.pi * (radius + inner))))
    mean = 0.5 * (inner + radius)
    with gmsh_model("hemisphere_on_cube"):
        shell = _half_shell(inner, radius, n, layers, order, cell)
        shell.points[:, 2] += radius
        centre = np.array([0.0, 0.0, radius])
        shell = name_boundary(
            shell,
            hemisphere_top=near(2, radius),
            hemisphere_skin=lambda x: np.linalg.norm(x - centre, axis=-1).min(axis=1) > mean,
            hemisphere_inside=lambda x: np.linalg.norm(x - centre, axis=-1).max(axis=1) < mean,
        )
        half = 0.5 * side
        cube = _box((-half, -half, -side), (half, half, 0.0), (n, n, n), order, cell)
        cube = name_boundary(cube, "cube_sides", cube_top=near(2, 0.0), cube_bottom=near(2, -side))
        return _write(path, {"hemisphere": shell, "cube": cube})


def pad_on_ring(
    path: str | Path, n: int = 4, order: int = 1, cell: str = "hexahedron", *, radii: Sequence[float] = (0.4, 1.0),
    pad: Sequence[float] = (0.4, 0.1), thickness: float = 0.1,
) -> Path:  # fmt: skip
    """A square pad on a flat ring around the z-axis; the ring lies below z = 0, the pad above it.

    Groups: ring, pad; ring_top, ring_bottom, ring_sides; pad_bottom, pad_top, pad_sides.

    Parameters
    ----------
    path : file to write
    n : cells along a side of the pad; cells of the ring are somewhat wider
    order : 1 or 2, degree of the geometry
    cell : hexahedron
    radii : of the ring; the middle of the pad is half way between them, on the x-axis
    pad : side and height of the pad
    thickness : of the ring
    """
    check_cell("pad_on_ring", cell, 3, order)
    inner, outer = radii
    side, height = pad
    middle, half = 0.5 * (inner + outer), 0.5 * side
    if cell != "hexahedron" or n < 1 or not 0.0 < inner < middle - half or not np.hypot(middle + half, half) < outer:
        raise ValueError(f"mesh 'pad_on_ring': {cell}, n {n}, radii {inner}, {outer}, pad {side}; expected hexahedra, "
                         "and a pad that lies on the ring")  # fmt: skip
    wide = 1.2 * side / n
    across, around = max(1, round((outer - inner) / wide)), max(8, round(2.0 * np.pi * middle / wide))
    layers = max(1, round(thickness / wide))
    with gmsh_model("pad_on_ring"):
        # a quarter after the other: a patch cannot close on itself
        quarters = []
        around = 4 * -(-around // 4)
        r, z = _steps(inner, outer, across, order), _steps(-thickness, 0.0, layers, order)
        for k in range(4):
            t = _steps(k * _RIGHT, (k + 1) * _RIGHT, around // 4, order)
            radius, angle, level = np.meshgrid(r, t, z, indexing="ij")
            quarters.append(lattice(np.stack([radius * np.cos(angle), radius * np.sin(angle), level], -1), order, cell))
        ring = name_boundary(join(quarters), "ring_sides", ring_top=near(2, 0.0), ring_bottom=near(2, -thickness))
        block = _box(
            (middle - half, -half, 0.0), (middle + half, half, height), (n, n, max(1, round(height * n / side))), order,
            cell,
        )  # fmt: skip
        block = name_boundary(block, "pad_sides", pad_bottom=near(2, 0.0), pad_top=near(2, height))
        return _write(path, {"ring": ring, "pad": block})


def disk(
    path: str | Path, n: int = 4, order: int = 1, cell: str = "hexahedron", *, radius: float = 1.0,
    thickness: float = 0.05,
) -> Path:  # fmt: skip
    """A disk around the z-axis, 0 <= z <= thickness, of one layer of cells.

    Groups: disk; bottom, top, sides.

    Parameters
    ----------
    path : file to write
    n : cells along each side of the square in the middle, and from there to the edge; even
    order : 1 or 2, degree of the geometry
    cell : hexahedron
    radius, thickness : of the disk
    """
    check_cell("disk", cell, 3, order)
    if cell != "hexahedron" or n < 2 or n % 2 or min(radius, thickness) <= 0.0:
        raise ValueError(f"mesh 'disk': {cell}, n {n}, radius {radius}, thickness {thickness}; expected hexahedra, an "
                         "even n, a positive radius and thickness")  # fmt: skip
    half, z = 0.5 * radius, _steps(0.0, thickness, 1, order)
    with gmsh_model("disk"):
        side, out = _steps(-1.0, 1.0, n, order), _steps(0.0, 1.0, n // 2, order)
        x, y, level = np.meshgrid(half * side, half * side, z, indexing="ij")
        patches = [lattice(np.stack([x, y, level], axis=-1), order, cell)]
        s, t, level = np.meshgrid(out, side, z, indexing="ij")
        # from a side of the square to a quarter of the edge
        x = (1.0 - s) * half + s * radius * np.cos(0.5 * _RIGHT * t)
        y = (1.0 - s) * half * t + s * radius * np.sin(0.5 * _RIGHT * t)
        for k in range(4):
            a, b = round(np.cos(k * _RIGHT)), round(np.sin(k * _RIGHT))
            patches.append(lattice(np.stack([a * x - b * y, b * x + a * y, level], axis=-1), order, cell))
        whole = name_boundary(join(patches), "sides", bottom=near(2, 0.0), top=near(2, thickness))
        return _write(path, {"disk": whole})
