"""A disk resting on a block (Chouly, Mlika, Renard)."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np

from .bodies import embed_point
from .tools import (
    check_cell,
    finish,
    gmsh_model,
    group,
    point_size_field,
    restrict_field,
    unstructured,
    use_fields,
)

_RADIUS, _DEPTH, _HALF_WIDTH, _PIN = 0.25, 0.25, 0.5, 0.1


def _draw_disk() -> tuple[int, list[int], list[int]]:
    """The disk: its face, its arcs (from angle 0, counter-clockwise), the points pin_0, pin_1, disk_tip."""
    geo = gmsh.model.geo
    centre, pin = geo.addPoint(0.0, 0.0, 0.0), geo.addPoint(0.0, _PIN, 0.0)
    angles = 0.5 * np.pi * np.arange(4)
    rim = [geo.addPoint(_RADIUS * np.round(np.cos(t)), _RADIUS * np.round(np.sin(t)), 0.0) for t in angles]
    arcs = [geo.addCircleArc(rim[k], centre, rim[(k + 1) % 4]) for k in range(4)]
    face = geo.addPlaneSurface([geo.addCurveLoop(arcs)])
    geo.synchronize()
    return face, arcs, [centre, pin, rim[3]]


def _draw_block() -> tuple[int, list[int]]:
    """The block: its face and its lines bottom, right, top, left."""
    geo, w = gmsh.model.geo, _HALF_WIDTH
    corners = [geo.addPoint(x, y, 0.0) for x, y in ((-w, -w), (w, -w), (w, -_DEPTH), (-w, -_DEPTH))]
    lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    face = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    return face, lines


def disk_on_block(
    path: str | Path,
    h: float = 0.05,
    order: int = 1,
    cell: str = "triangle",
    *,
    contact_h: float | None = None,
    mismatch: float = 1.2,
) -> Path:
    """The disk of radius 0.25 around the origin, touching the block ]-0.5, 0.5[ x ]-0.5, -0.25[.

    Groups: disk, block; disk_skin (the whole circle), disk_lower_skin (its lower half); block_top,
    block_bottom, block_sides; points pin_0 (0, 0), pin_1 (0, 0.1), disk_tip (0, -0.25). The pins are nodes
    inside the disk.

    Parameters
    ----------
    path : file to write
    h : element size
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    contact_h : element size within 0.1 of the contact; default h
    mismatch : size of the block in units of the disk's
    """
    check_cell("disk_on_block", cell, 2, order)
    near = contact_h or h
    with gmsh_model("disk_on_block"):
        disk, arcs, (pin_0, pin_1, tip) = _draw_disk()
        block, (bottom, right, top, left) = _draw_block()
        for dim, name, tags in (
            (2, "disk", [disk]),
            (2, "block", [block]),
            (1, "disk_skin", arcs),
            (1, "disk_lower_skin", arcs[2:]),
            (1, "block_top", [top]),
            (1, "block_bottom", [bottom]),
            (1, "block_sides", [left, right]),
            (0, "pin_0", [pin_0]),
            (0, "pin_1", [pin_1]),
            (0, "disk_tip", [tip]),
        ):
            group(dim, name, tags)
        for pin in (pin_0, pin_1):
            embed_point(pin, 2, disk)
        unstructured(cell)
        use_fields(
            [
                restrict_field(point_size_field(tip, factor * near, factor * h, 0.1, 0.3), 2, [face])
                for face, factor in ((disk, 1.0), (block, mismatch))
            ]
        )
        return finish(path, 2, order)
