"""A flat punch with sharp corners on a block: half of it, in the plane."""

from __future__ import annotations

from pathlib import Path

import gmsh

from .tools import check_cell, finish, gmsh_model, group, unstructured


def _polygon(points: list[tuple[float, float]]) -> tuple[int, list[int]]:
    """A face and its edges; edge k goes from point k to the next."""
    geo = gmsh.model.geo
    corners = [geo.addPoint(x, y, 0.0) for x, y in points]
    edges = [geo.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return geo.addPlaneSurface([geo.addCurveLoop(edges)]), edges


def punch(
    path: str | Path,
    h: float = 0.25,
    *,
    half_width: float = 0.5,
    width: float = 2.0,
    depth: float = 2.0,
    height: float = 0.5,
    order: int = 1,
) -> Path:
    """Half a punch (x >= 0, above y = 0) on half a block (below), both of triangles.

    Groups: punch, block; punch_face, punch_top, block_under (below the punch), block_bottom, symmetry (x = 0, both).

    Parameters
    ----------
    path : file to write
    h : element size
    half_width, height : of the punch
    width, depth : of the half block
    order : 1 or 2, degree of the geometry
    """
    check_cell("punch", "triangle", 2, order)
    if not 0.0 < half_width < width or min(depth, height) <= 0.0:
        raise ValueError(f"mesh 'punch': half_width {half_width}, width {width}; expected 0 < half_width < width")
    with gmsh_model("punch"):
        a = half_width
        upper, top = _polygon([(0, 0), (a, 0), (a, height), (0, height)])
        lower, base = _polygon([(0, -depth), (width, -depth), (width, 0), (a, 0), (0, 0)])
        gmsh.model.geo.synchronize()
        group(2, "punch", [upper])
        group(2, "block", [lower])
        for name, edges in (
            ("punch_face", [top[0]]),
            ("punch_top", [top[2]]),
            ("block_under", [base[3]]),
            ("block_bottom", [base[0]]),
            ("symmetry", [top[3], base[4]]),
        ):
            group(1, name, edges)
        gmsh.model.mesh.setSize(gmsh.model.getEntities(0), h)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        unstructured("triangle")
        return finish(path, 2, order)
