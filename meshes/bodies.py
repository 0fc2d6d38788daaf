"""Bodies drawn in the current gmsh model: half disks, rectangles, half balls, boxes; all touch the origin.

Every function draws points, curves and faces of its own, so that bodies never share a node, and
synchronises the model. Embedding and size fields come after all bodies are drawn: drawing forgets them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gmsh
import numpy as np

from .tools import group


class Round(NamedTuple):
    """Entities of a half disk or a half ball: tags of one dimension less unless said otherwise."""

    body: list[int]  # of the body's own dimension
    skin: list[int]  # the round part
    flat: list[int]  # the straight side or plane disk opposite the tip
    symmetry_x: list[
        int
    ]  # on x = 0; inside the body when it is modelled whole (half disk), else on its boundary
    symmetry_y: list[int]  # on y = 0 (quarter of a half ball only)
    tip: int  # point: the origin
    centre: int  # point: the middle of the flat side


class Block(NamedTuple):
    """Entities of a rectangle or box below the origin, with the names of `Round`."""

    body: list[int]
    top: list[int]
    bottom: list[int]
    sides: list[int]  # without the symmetry planes
    symmetry_x: list[int]
    symmetry_y: list[int]
    origin: int  # point on the top


def _line_loop(points: Sequence[int]) -> list[int]:
    return [gmsh.model.geo.addLine(a, b) for a, b in zip(points, (*points[1:], points[0]), strict=True)]


def _face(curves: Sequence[int]) -> int:
    geo = gmsh.model.geo
    return geo.addPlaneSurface([geo.addCurveLoop(list(curves))])


def half_disk(radius: float, side: int, half: bool) -> Round:
    """Half a disk that touches the origin from above (side 1) or below (-1), flat side at y = side * radius.

    It consists of the parts x >= 0 and x <= 0 with the line x = 0 between them; `half` leaves only x >= 0.
    """
    geo = gmsh.model.geo
    tip, centre = geo.addPoint(0.0, 0.0, 0.0), geo.addPoint(0.0, side * radius, 0.0)
    axis = geo.addLine(tip, centre)
    faces, skin, flat = [], [], []
    for direction in (1,) if half else (1, -1):
        end = geo.addPoint(direction * radius, side * radius, 0.0)
        arc, straight = geo.addCircleArc(tip, centre, end), geo.addLine(end, centre)
        skin.append(arc)
        flat.append(straight)
        loop = [arc, straight, -axis]
        faces.append(_face(loop if direction * side > 0 else [-c for c in reversed(loop)]))
    geo.synchronize()
    return Round(faces, skin, flat, [axis], [], tip, centre)


def half_plane(width: float, depth: float, half: bool) -> Block:
    """The rectangle [-width/2, width/2] x [-depth, 0], or its half x >= 0.

    The whole one consists of two parts with the line x = 0 between them.
    """
    geo = gmsh.model.geo
    origin, foot = geo.addPoint(0.0, 0.0, 0.0), geo.addPoint(0.0, -depth, 0.0)
    axis = geo.addLine(foot, origin)
    faces, top, bottom, sides = [], [], [], []
    for direction in (1,) if half else (1, -1):
        x = 0.5 * direction * width
        low, high = geo.addPoint(x, -depth, 0.0), geo.addPoint(x, 0.0, 0.0)
        curves = [geo.addLine(foot, low), geo.addLine(low, high), geo.addLine(high, origin)]
        for found, curve in zip((bottom, sides, top), curves, strict=True):
            found.append(curve)
        loop = [*curves, -axis]
        faces.append(_face(loop if direction > 0 else [-c for c in reversed(loop)]))
    geo.synchronize()
    return Block(faces, top, bottom, sides, [axis], [], origin)


def half_ball(radius: float, side: int, quarter: bool) -> Round:
    """Half a ball that touches the origin from above (side 1) or below (-1), its disk at z = side * radius.

    `quarter` leaves x >= 0, y >= 0. The skin consists of eighths of a sphere that meet at the tip.
    """
    geo = gmsh.model.geo
    height = side * radius
    tip, centre = geo.addPoint(0.0, 0.0, 0.0), geo.addPoint(0.0, 0.0, height)
    angles = 0.5 * np.pi * np.arange(2 if quarter else 4)
    rim = [geo.addPoint(radius * np.round(np.cos(t)), radius * np.round(np.sin(t)), height) for t in angles]
    meridians = [geo.addCircleArc(tip, centre, p) for p in rim]
    n = len(rim)
    eighths = 1 if quarter else 4
    circle = [geo.addCircleArc(rim[k], centre, rim[(k + 1) % n]) for k in range(eighths)]
    skin = [
        geo.addSurfaceFilling(
            [geo.addCurveLoop([meridians[k], circle[k], -meridians[(k + 1) % n]])], sphereCenterTag=centre
        )
        for k in range(eighths)
    ]
    planes: list[list[int]] = [[], []]
    if quarter:
        axis, radii = geo.addLine(tip, centre), [geo.addLine(p, centre) for p in rim]
        planes = [[_face([meridians[k], radii[k], -axis])] for k in (1, 0)]
        flat = [_face([radii[0], -radii[1], -circle[0]])]
    else:
        flat = [_face(circle)]
    body = geo.addVolume([geo.addSurfaceLoop([*skin, *flat, *planes[0], *planes[1]])])
    geo.synchronize()
    return Round([body], skin, flat, *planes, tip, centre)


def half_space(block: Sequence[float], quarter: bool) -> Block:
    """The box of size `block` (x, y, z) below the origin, which is the middle of its top.

    `quarter` leaves x >= 0, y >= 0.
    """
    geo = gmsh.model.geo
    x, y, depth = 0.5 * block[0], 0.5 * block[1], block[2]
    x0, y0 = (0.0, 0.0) if quarter else (-x, -y)
    corners = ((x0, y0), (x, y0), (x, y), (x0, y))
    lower, upper = ([geo.addPoint(a, b, z) for a, b in corners] for z in (-depth, 0.0))
    below, above = _line_loop(lower), _line_loop(upper)
    posts = [geo.addLine(a, b) for a, b in zip(lower, upper, strict=True)]
    sides = [_face([below[k], posts[(k + 1) % 4], -above[k], -posts[k]]) for k in range(4)]
    bottom, top = _face(below), _face(above)
    body = geo.addVolume([geo.addSurfaceLoop([bottom, top, *sides])])
    origin = upper[0] if quarter else geo.addPoint(0.0, 0.0, 0.0)
    geo.synchronize()
    if quarter:
        return Block([body], [top], [bottom], sides[1:3], [sides[3]], [sides[0]], origin)
    return Block([body], [top], [bottom], sides, [], [], origin)


def embed_point(point: int, dim: int, tag: int) -> None:
    """Make a point inside a curve or face a node of the mesh (after all bodies are drawn)."""
    gmsh.model.mesh.embed(0, [point], dim, tag)


def name_round(name: str, body: Round, dim: int, flat: str = "flat") -> None:
    """Groups `name`, `name`_skin, `name`_`flat`, and the points `name`_tip and `name`_center."""
    group(dim, name, body.body)
    group(dim - 1, f"{name}_skin", body.skin)
    group(dim - 1, f"{name}_{flat}", body.flat)
    group(0, f"{name}_tip", [body.tip])
    group(0, f"{name}_center", [body.centre])


def name_block(name: str, block: Block, dim: int) -> None:
    """Groups `name`, `name`_top, `name`_bottom, `name`_sides, and the point `name`_origin."""
    group(dim, name, block.body)
    for side in ("top", "bottom", "sides"):
        group(dim - 1, f"{name}_{side}", getattr(block, side))
    group(0, f"{name}_origin", [block.origin])
