"""Round bodies in contact at the origin, graded to the size h there: cylinders (2D) and balls (3D).

In every mesh the element size is h up to `contact_radius` from the origin (take about 1.5 contact half
widths), grows from there by `growth` per unit length and stops at `coarse`. The target body is coarser by
`mismatch`, so that the two meshes do not match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import gmsh
import numpy as np

from .bodies import (
    Block,
    Round,
    embed_point,
    half_ball,
    half_disk,
    half_plane,
    half_space,
    name_block,
    name_round,
)
from .halve import write_halved
from .tools import (
    check_cell,
    check_choice,
    finish,
    generate,
    gmsh_model,
    group,
    logger,
    node_count,
    point_size_field,
    restrict_field,
    unstructured,
    use_fields,
    write,
)

_TOLERANCE, _CORRECTIONS = 0.05, 7
_SMALL_FIRST = (1 / 20, 1 / 5, 1)  # parts of the wanted unknowns in the first meshes, which are quick


@dataclass(frozen=True)
class _Grading:
    """Element size around the origin: h, its extent, growth and end, and the factor of the target body."""

    h: float
    contact_radius: float
    growth: float
    coarse: float | None
    mismatch: float
    radius: float

    def __post_init__(self):
        for key in ("h", "contact_radius", "growth", "mismatch", "radius"):
            if not getattr(self, key) > 0:
                raise ValueError(
                    f"mesh of round bodies: {key} {getattr(self, key)}; expected a positive number"
                )

    @property
    def far(self) -> float:
        """Largest size: as given, or ten times h, but no more than a quarter of the radius."""
        return max(self.h, self.coarse or min(10.0 * self.h, 0.25 * self.radius))

    def size(self, distance: np.ndarray, factor: float) -> np.ndarray:
        """Element size at a distance (n,) from the origin in the body with this factor."""
        grown = factor * self.h + self.growth * np.maximum(distance - self.contact_radius, 0.0)
        return np.minimum(grown, max(self.far, factor * self.h))

    def apply(self, dim: int, point: int, source: Sequence[int], target: Sequence[int]) -> None:
        """Hand the size of both bodies to gmsh."""
        fields = []
        for tags, factor in ((source, 1.0), (target, self.mismatch)):
            if not tags:
                continue
            field = point_size_field(point, factor * self.h, self.far, self.contact_radius, self.growth)
            fields.append(restrict_field(field, dim, tags))
        use_fields(fields)


def _name_symmetry(dim: int, bodies: Sequence[Round | Block]) -> None:
    for key in ("symmetry_x", "symmetry_y"):
        group(dim - 1, key, [tag for body in bodies for tag in getattr(body, key)])


def cylinders(
    path: str | Path,
    h: float = 0.1,
    order: int = 1,
    cell: str = "triangle",
    *,
    radius: float = 8.0,
    radius_lower: float | None = None,
    half: bool = False,
    contact_radius: float | None = None,
    growth: float = 0.25,
    coarse: float | None = None,
    mismatch: float = 1.3,
    single: bool = False,
) -> Path:
    """Two half cylinders in plane strain (half disks) that touch at the origin, flat sides up and down.

    Groups: upper, lower; upper_skin, lower_skin (the arcs); upper_flat (y = radius), lower_flat (y =
    -radius); points upper_tip, lower_tip (the origin), upper_center, lower_center (middle of the flat
    sides). Whole: upper_axis, lower_axis (the lines x = 0 inside the bodies, where u_x = 0 by symmetry).
    Half: symmetry_x (both bodies on x = 0). The half model is at the same time the meridian section of two
    balls (axisymmetric).

    Parameters
    ----------
    path : file to write
    h : element size at the contact (half width 0.68 with the data of the Hertz case)
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    radius : radius of the upper cylinder
    radius_lower : radius of the lower one where it differs
    half : model x >= 0 only
    contact_radius : distance from the origin up to which the size is h; default radius / 8 (1.5 half widths
        of the Hertz case)
    growth : growth of the size per unit length
    coarse : largest size; default 10 h, at most radius / 4
    mismatch : size of the lower body in units of the upper one's
    single : the upper body alone
    """
    check_cell("cylinders", cell, 2, order)
    grading = _Grading(h, contact_radius or radius / 8, growth, coarse, mismatch, radius)
    with gmsh_model("cylinders"):
        drawn = {"upper": half_disk(radius, 1, half)}
        if not single:
            drawn["lower"] = half_disk(radius_lower or radius, -1, half)
        for name, body in drawn.items():
            name_round(name, body, 2)
            if not half:
                group(1, f"{name}_axis", body.symmetry_x)
        if half:
            _name_symmetry(2, list(drawn.values()))
        unstructured(cell)
        grading.apply(2, drawn["upper"].tip, drawn["upper"].body, [] if single else drawn["lower"].body)
        return finish(path, 2, order)


def cylinder_on_block(
    path: str | Path,
    h: float = 0.1,
    order: int = 1,
    cell: str = "triangle",
    *,
    radius: float = 8.0,
    width: float = 64.0,
    depth: float = 32.0,
    half: bool = False,
    contact_radius: float | None = None,
    growth: float = 0.25,
    coarse: float | None = None,
    mismatch: float = 1.3,
) -> Path:
    """A half cylinder (half disk, flat side up) on a block, touching at the origin.

    The block is 64 wide and 32 deep by default: 33 half widths a = 0.963 of the Hertz case to every side
    and below, so that it stands for a half space (what its ends change in the contact pressure is of the
    order (a / depth)^2 = 1e-3).

    Groups: cylinder, block; cylinder_skin (the arc), cylinder_flat (y = radius); block_top, block_bottom,
    block_sides; points cylinder_tip, block_origin (the origin), cylinder_center. Whole: cylinder_axis,
    block_axis (the lines x = 0 inside the bodies). Half: symmetry_x (both bodies on x = 0).

    Parameters
    ----------
    path : file to write
    h : element size at the contact
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    radius : radius of the cylinder
    width, depth : size of the (whole) block
    half : model x >= 0 only
    contact_radius : distance from the origin up to which the size is h; default radius / 5.5 (1.5 half
        widths of the Hertz case)
    growth : growth of the size per unit length
    coarse : largest size; default 10 h, at most radius / 4
    mismatch : size of the block in units of the cylinder's
    """
    check_cell("cylinder_on_block", cell, 2, order)
    grading = _Grading(h, contact_radius or radius / 5.5, growth, coarse, mismatch, radius)
    with gmsh_model("cylinder_on_block"):
        cylinder, block = half_disk(radius, 1, half), half_plane(width, depth, half)
        name_round("cylinder", cylinder, 2)
        name_block("block", block, 2)
        if half:
            _name_symmetry(2, (cylinder, block))
        else:
            group(1, "cylinder_axis", cylinder.symmetry_x)
            group(1, "block_axis", block.symmetry_x)
        unstructured(cell)
        grading.apply(2, cylinder.tip, cylinder.body, block.body)
        return finish(path, 2, order)


def two_balls(
    path: str | Path,
    h: float = 1.5,
    order: int = 1,
    *,
    radius: float = 50.0,
    symmetry: str = "quarter",
    contact_radius: float | None = None,
    growth: float = 0.35,
    coarse: float | None = None,
    mismatch: float = 1.25,
) -> Path:
    """Two half balls that touch at the origin, their plane disks up and down.

    The data of code_aster SSNV104: radius 50, approach 4, contact radius 10.

    Groups: upper, lower; upper_skin, lower_skin (the round parts); upper_flat (z = radius), lower_flat (z =
    -radius); points upper_tip, lower_tip (the origin), upper_center, lower_center (middle of the disks).
    Quarter: symmetry_x (both on x = 0), symmetry_y (both on y = 0).

    Parameters
    ----------
    path : file to write
    h : element size at the contact
    order : 1 or 2, degree of the geometry
    radius : radius of both balls
    symmetry : "quarter" (x >= 0, y >= 0) or "none"
    contact_radius : distance from the origin up to which the size is h; default 0.3 radius
    growth : growth of the size per unit length
    coarse : largest size; default 10 h, at most radius / 4
    mismatch : size of the lower ball in units of the upper one's
    """
    check_cell("two_balls", "tetrahedron", 3, order)
    check_choice("two_balls", "symmetry", symmetry, ("quarter", "none"))
    quarter = symmetry == "quarter"
    grading = _Grading(h, contact_radius or 0.3 * radius, growth, coarse, mismatch, radius)
    with gmsh_model("two_balls"):
        upper, lower = half_ball(radius, 1, quarter), half_ball(radius, -1, quarter)
        for name, body in (("upper", upper), ("lower", lower)):
            name_round(name, body, 3)
            if not quarter:
                embed_point(body.centre, 2, body.flat[0])
        _name_symmetry(3, (upper, lower))
        unstructured("tetrahedron")
        grading.apply(3, upper.tip, upper.body, lower.body)
        return finish(path, 3, order)


def ball_on_block(
    path: str | Path,
    h: float = 0.05,
    order: int = 1,
    *,
    unknowns: int | None = None,
    radius: float = 1.0,
    block: Sequence[float] = (2.0, 2.0, 1.0),
    symmetry: str = "none",
    contact_radius: float | None = None,
    growth: float = 0.35,
    coarse: float | None = None,
    mismatch: float = 1.25,
    halvings: int = 0,
) -> Path:
    """Half a ball, its plane disk up, on the middle of a block; they touch at the origin. Tetrahedra.

    Groups: ball, block; ball_skin (the whole round part), ball_top (the plane disk, z = radius); block_top
    (z = 0), block_bottom, block_sides (without symmetry planes); points ball_tip, block_origin (both at the
    origin), ball_center (middle of the disk). Quarter: symmetry_x (both bodies on x = 0), symmetry_y (both
    on y = 0).

    Parameters
    ----------
    path : file to write
    h : element size at the contact
    order : 1 or 2, degree of the geometry
    unknowns : instead of h: wanted number of displacement unknowns (3 per node, degree = order, supports
        included), met within 10 %
    radius : radius of the ball
    block : size of the (whole) block
    symmetry : "quarter" (x >= 0, y >= 0) or "none"
    contact_radius : distance from the origin up to which the size is h; default 0.2 radius
    growth : growth of the size per unit length
    coarse : largest size; default 10 h, at most radius / 4
    mismatch : size of the block in units of the ball's
    halvings : how often the edges of the whole mesh are halved at the end, the new nodes on the ball's skin
        put on the ball: for meshes of millions of cells (gmsh takes 5 kB per cell to make one); degree 1 only
    """
    check_cell("ball_on_block", "tetrahedron", 3, order)
    if halvings and order != 1:
        raise ValueError(f"mesh 'ball_on_block': order {order} with halvings; expected order 1")
    check_choice("ball_on_block", "symmetry", symmetry, ("quarter", "none"))
    quarter = symmetry == "quarter"
    grading = _Grading(h, contact_radius or 0.2 * radius, growth, coarse, mismatch, radius)
    with gmsh_model("ball_on_block"):
        if unknowns is None:
            _mesh_ball_on_block(grading, block, quarter, order)
        else:
            # halves have nearly eight times the nodes
            _meet_unknowns(round(unknowns / 8**halvings), grading, block, quarter, order)
        if halvings:
            centre = np.array([0.0, 0.0, radius])
            return write_halved(path, halvings, lambda x: _onto_sphere(x, centre, radius), "ball_skin")
        return write(path)


def _onto_sphere(x: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    away = x - centre
    return centre + radius * away / np.linalg.norm(away, axis=1)[:, None]


def _mesh_ball_on_block(grading: _Grading, block: Sequence[float], quarter: bool, order: int) -> int:
    """Draw and mesh anew; the number of displacement unknowns."""
    gmsh.clear()
    ball, box = half_ball(grading.radius, 1, quarter), half_space(block, quarter)
    name_round("ball", ball, 3, flat="top")
    name_block("block", box, 3)
    _name_symmetry(3, (ball, box))
    if not quarter:
        embed_point(ball.centre, 2, ball.flat[0])
        embed_point(box.origin, 2, box.top[0])
    unstructured("tetrahedron")
    grading.apply(3, ball.tip, ball.body, box.body)
    generate(3, order)
    return 3 * node_count()


class _Density:
    """Integral of 1 / size^3 over both bodies: the number of nodes, but for a factor that a mesh tells.

    The volume is split into shells around the origin once; an integral is then a sum over the shells.
    """

    def __init__(self, radius: float, block: Sequence[float]):
        edges = np.concatenate(
            [[0.0], np.geomspace(1e-3 * radius, 2.0 * radius + np.linalg.norm(block), 240)]
        )
        self.distance = 0.5 * (edges[1:] + edges[:-1])
        shell = np.diff(edges**3) / 3.0
        height = (np.arange(100) + 0.5) / 100
        angle = 2.0 * np.pi * (np.arange(96) + 0.5) / 96
        r, c, t = np.meshgrid(self.distance, height, angle, indexing="ij")
        flat = r * np.sqrt(1.0 - c**2)
        inside_ball = (r < 2.0 * radius * c) & (r * c < radius)
        inside_block = (
            (abs(flat * np.cos(t)) < 0.5 * block[0])
            & (abs(flat * np.sin(t)) < 0.5 * block[1])
            & (r * c < block[2])
        )
        self.volumes = [
            2.0 * np.pi * shell * inside.mean(axis=(1, 2)) for inside in (inside_ball, inside_block)
        ]

    def __call__(self, grading: _Grading) -> float:
        return sum(
            float((volume / grading.size(self.distance, factor) ** 3).sum())
            for volume, factor in zip(self.volumes, (1.0, grading.mismatch), strict=True)
        )

    def h(self, wanted: float, grading: _Grading) -> float:
        """The h with the integral `wanted`, by bisection of its logarithm."""
        low, high = 1e-4 * grading.contact_radius, grading.radius
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self(replace(grading, h=middle)) > wanted else (low, middle)
        return float(np.sqrt(low * high))


def _meet_unknowns(
    unknowns: int, grading: _Grading, block: Sequence[float], quarter: bool, order: int
) -> None:
    """Choose h so that the mesh has the wanted number of unknowns.

    The unknowns are taken to be a power of the density integral; two small meshes tell the power and the
    factor, and every mesh after that corrects them.

    Raises
    ------
    RuntimeError
        When no mesh comes within 10 %: the wanted number is below that of the coarsest mesh.
    """
    density = _Density(grading.radius, block)
    power, factor, last = 1.0, (3.0 if order == 1 else 24.0) * (0.35 if quarter else 1.3), None
    for k in range(_CORRECTIONS):
        wanted = unknowns * _SMALL_FIRST[min(k, len(_SMALL_FIRST) - 1)]
        grading = replace(grading, h=density.h((wanted / factor) ** (1.0 / power), grading))
        found, integral = _mesh_ball_on_block(grading, block, quarter, order), density(grading)
        logger.info("ball_on_block: h = %.4g gives %d unknowns", grading.h, found)
        if abs(found - unknowns) < _TOLERANCE * unknowns:
            return
        if last is not None and abs(np.log(integral / last[1])) > 0.05:
            power = float(np.clip(np.log(found / last[0]) / np.log(integral / last[1]), 0.7, 1.2))
        factor, last = found / integral**power, (found, integral)
    if abs(found - unknowns) > 2 * _TOLERANCE * unknowns:
        raise RuntimeError(f"mesh 'ball_on_block': {unknowns} unknowns wanted, {found} met; give h instead")
