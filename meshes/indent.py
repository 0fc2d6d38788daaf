"""A block to be indented at the origin, graded towards it, alone or with an elastic half-ball on top."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .bodies import half_ball, half_disk, half_space
from .grid import Grid, add, join, lattice, name_boundary, near, refined
from .tools import (
    check_cell,
    generate,
    gmsh_model,
    group,
    point_size_field,
    restrict_field,
    unstructured,
    use_fields,
    write,
)

_DEFAULT_CELL = {2: "quadrilateral", 3: "hexahedron"}


def _rays(h: float, fine: float, length: float, growth: float) -> np.ndarray:
    """Ends of the cells between fine and length: the first about h, each longer than the last by 1 + growth."""
    span = (length - fine) / h
    n = max(1, round(float(np.log1p(growth * span) / np.log1p(growth))))
    size = (1.0 + growth) ** np.arange(n)
    return np.concatenate([[fine], fine + (length - fine) * np.cumsum(size) / size.sum()])


def _block_grid(
    cell: str, order: int, h: float, fine: float, length: float, growth: float, mirrored: bool = False
) -> Grid:
    """A fine square (cube) at the origin, and from every side of it but the symmetry planes a patch along rays.

    With `mirrored` the same for x < 0 as well.
    """
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    t = np.linspace(0.0, 1.0, order * max(1, round(fine / h)) + 1)
    rays = refined(_rays(h, fine, length, growth), order)
    patches = [np.stack(np.meshgrid(*[fine * t] * dim, indexing="ij"), axis=-1)]
    for axis in range(dim):
        unit = np.meshgrid(rays, *[t] * (dim - 1), indexing="ij")
        x = [unit[0] * u for u in unit[1:]]
        x.insert(axis, unit[0])
        patches.append(np.stack(x, axis=-1))
    grids = []
    for patch in patches:
        points = np.zeros((*patch.shape[:-1], 3))
        points[..., :dim] = patch
        points[..., dim - 1] *= -1.0
        grids.append(lattice(points, order, cell))
        if mirrored:
            grids.append(lattice(points * [-1.0, 1.0, 1.0], order, cell))
    grid, planes = join(grids), dict(zip(("side_x", "side_y")[: dim - 1], range(dim - 1), strict=True))
    if dim == 2:
        planes = {"axis": 0}
    if mirrored:
        del planes["axis" if dim == 2 else "side_x"]
    return name_boundary(
        grid,
        "block_side",
        block_top=near(dim - 1, 0.0),
        block_bottom=near(dim - 1, -length, 1e-9 * length),
        **{key: near(axis, 0.0) for key, axis in planes.items()},
    )


def indent(
    path: str | Path,
    dim: int = 2,
    h: float = 0.1,
    order: int = 1,
    cell: str | None = None,
    *,
    fine: float = 0.5,
    length: float = 5.0,
    growth: float = 0.25,
    radius: float | None = None,
    mismatch: float = 0.8,
    mirrored: bool = False,
) -> Path:
    """A block whose top is touched at the origin: half a meridian section (2D, x the radius) or a quarter (3D).

    The block is [0, length] x [-length, 0] in the plane, [0, length]^2 x [-length, 0] in space. Quadrilaterals,
    triangles and hexahedra are structured: a uniform square (cube) of size `fine` at the origin, and cells along rays
    from there to the far sides, which grow in all directions alike. Tetrahedra follow a size field.

    Nodes of the 3D block: hexahedra of degree 1 with h = 0.018 have 70,692 (212,076 unknowns), of degree 2 with h =
    0.04 69,655; tetrahedra of degree 1 with h = 0.0088 72,377, of degree 2 with h = 0.02 64,340.

    Groups: block; block_top, block_bottom, block_side (the far sides). 2D: axis (x = 0, of both bodies); 3D: side_x,
    side_y (x = 0, y = 0, of both bodies). With a ball: ball; ball_skin (its round face), ball_top (flat, at height
    radius).

    Parameters
    ----------
    path : file to write
    dim : 2 (axisymmetric, or half a plane problem) or 3
    h : element size at the origin
    order : 1 or 2, degree of the geometry
    cell : quadrilateral (default in 2D), triangle, hexahedron (default in 3D), tetrahedron
    fine : size of the zone at the origin where the size is h
    length : size of the block
    growth : growth of the size per unit length outside of it
    radius : of the half-ball that touches the block from above; None leaves it out. In 2D its cells are unstructured
        and of the same kind, in 3D always tetrahedra
    mismatch : size of the ball's cells in units of h
    mirrored : the block for x < 0 as well (half a block in space, the whole one in the plane), without a group on
        x = 0; not with a ball or tetrahedra
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("indent", cell, dim, order)
    if not 0 < h <= fine < length or not growth > 0:
        raise ValueError(
            f"mesh 'indent': h {h}, fine {fine}, length {length}, growth {growth}; expected 0 < h <= fine < length "
            "and a positive growth"
        )
    if mirrored and (radius is not None or cell == "tetrahedron"):
        raise ValueError("mesh 'indent': mirrored with a ball or tetrahedra; allowed: a block of other cells alone")
    with gmsh_model("indent"):
        groups = _drawn(dim, order, cell, (h, fine, length, growth), radius, mismatch)
        if cell != "tetrahedron":
            body, facets = add(_block_grid(cell, order, h, fine, length, growth, mirrored))
            groups.setdefault("block", []).append(body)
            for key, tag in facets.items():
                groups.setdefault(key, []).append(tag)
        for key, tags in groups.items():
            group(dim if key in ("block", "ball") else dim - 1, key, tags)
        return write(path)


def _drawn(
    dim: int, order: int, cell: str, grading: Sequence[float], radius: float | None, mismatch: float
) -> dict[str, list[int]]:
    """Draw and mesh what is not structured: the ball, and the block where it consists of tetrahedra; its groups."""
    h, fine, length, growth = grading
    ball = block = None
    if radius is not None:
        ball = half_disk(radius, 1, True) if dim == 2 else half_ball(radius, 1, True)
    if cell == "tetrahedron":
        block = half_space((2.0 * length, 2.0 * length, length), True)
    bodies = [(ball, mismatch * h, 0.25 * (radius or 1.0)), (block, h, length)]
    drawn = [entry for entry in bodies if entry[0] is not None]
    if not drawn:
        return {}
    unstructured("tetrahedron" if dim == 3 else cell)
    fields = []
    for body, size, far in drawn:
        point = body.origin if body is block else body.tip
        fields.append(restrict_field(point_size_field(point, size, far, fine, growth), dim, body.body))
    use_fields(fields)
    generate(dim, order)
    groups: dict[str, list[int]] = {}
    if ball is not None:
        groups = {"ball": ball.body, "ball_skin": ball.skin, "ball_top": ball.flat}
    if block is not None:
        groups |= {"block": block.body, "block_top": block.top, "block_bottom": block.bottom, "block_side": block.sides}
    for key, name in (("symmetry_x", "side_x" if dim == 3 else "axis"), ("symmetry_y", "side_y")):
        tags = [tag for body, *_ in drawn for tag in getattr(body, key)]
        if tags:
            groups[name] = tags
    return groups
