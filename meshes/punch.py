"""Punches on blocks: half of a flat one with sharp corners in the plane, a quarter of a cube with sharp edges, the
meridian of one whose edge is rounded."""

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
    cell: str = "triangle",
) -> Path:
    """Half a punch (x >= 0, above y = 0) on half a block (below).

    Groups: punch, block; punch_face, punch_top, block_under (below the punch), block_bottom, symmetry (x = 0, both).

    Parameters
    ----------
    path : file to write
    h : element size
    half_width, height : of the punch
    width, depth : of the half block
    order : 1 or 2, degree of the geometry
    cell : triangle, quadrilateral
    """
    check_cell("punch", cell, 2, order)
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
        unstructured(cell)
        return finish(path, 2, order)


def cube_on_block(
    path: str | Path,
    h: float = 0.5,
    *,
    half_width: float = 0.5,
    width: float = 1.5,
    depth: float = 1.5,
    height: float = 0.5,
    order: int = 1,
) -> Path:
    """A quarter of a box with sharp edges (x, y >= 0, above z = 0) on a quarter of a larger one, in tetrahedra.

    Groups: punch, block; punch_face, punch_top, punch_side, block_under (below the punch), block_top (beside it),
    block_bottom, block_side, symmetry_x (x = 0, both), symmetry_y.

    Parameters
    ----------
    path : file to write
    h : element size
    half_width, height : of the punch
    width, depth : of the quarter of the block
    order : 1 or 2, degree of the geometry
    """
    check_cell("cube_on_block", "tetrahedron", 3, order)
    if not 0.0 < half_width < width or min(depth, height) <= 0.0:
        raise ValueError(f"mesh 'cube_on_block': half_width {half_width}, width {width}; expected 0 < half_width "
                         "< width")  # fmt: skip
    with gmsh_model("cube_on_block"):
        occ, a = gmsh.model.occ, half_width
        block, square = occ.addBox(0, 0, -depth, width, width, depth), occ.addRectangle(0, 0, 0, a, a)
        pieces, _ = occ.fragment([(3, block)], [(2, square)])
        # a body of its own, which shares no node with the block
        upper = occ.addBox(0, 0, 0, a, a, height)
        occ.synchronize()
        lower = [tag for dim, tag in pieces if dim == 3]
        bodies = {"punch": [upper], "block": lower}
        faces = {name: gmsh.model.getBoundary([(3, one) for one in some], oriented=False)
                 for name, some in bodies.items()}  # fmt: skip

        def on(names, axis, value):
            """Faces of bodies on a plane."""
            boxes = {tag: gmsh.model.getBoundingBox(2, tag) for name in names for _, tag in faces[name]}
            return [tag for tag, box in boxes.items()
                    if max(abs(box[axis] - value), abs(box[axis + 3] - value)) < 1e-5 * width]  # fmt: skip

        for name, some in bodies.items():
            group(3, name, some)
        group(2, "punch_face", on(["punch"], 2, 0.0))
        group(2, "punch_top", on(["punch"], 2, height))
        group(2, "punch_side", [tag for axis in (0, 1) for tag in on(["punch"], axis, a)])
        # the square alone ends where the punch does
        top = on(["block"], 2, 0.0)
        under = [tag for tag in top if gmsh.model.getBoundingBox(2, tag)[3] < 0.5 * (a + width)]
        group(2, "block_under", under)
        group(2, "block_top", [tag for tag in top if tag not in under])
        group(2, "block_bottom", on(["block"], 2, -depth))
        group(2, "block_side", [tag for axis in (0, 1) for tag in on(["block"], axis, width)])
        group(2, "symmetry_x", on(bodies, 0, 0.0))
        group(2, "symmetry_y", on(bodies, 1, 0.0))
        gmsh.model.mesh.setSize(gmsh.model.getEntities(0), h)
        unstructured("tetrahedron")
        return finish(path, 3, order)


def rounded_punch(
    path: str | Path,
    h: float = 5.0,
    order: int = 1,
    cell: str = "triangle",
    *,
    radius: float = 50.0,
    fillet: float = 10.0,
    height: float = 100.0,
    width: float = 100.0,
    depth: float = 200.0,
    edge: float = 0.1,
) -> Path:
    """A cylindrical punch whose lower edge is rounded on a cylindrical block: their meridian sections, x the radius.

    The flat part of the punch, up to radius - fillet, touches the block on y = 0.

    Groups: punch, block; punch_skin (flat face and fillet), punch_top, punch_side; block_top, block_bottom, block_side;
    axis (x = 0, both); points punch_centre, block_centre (the origin).

    Parameters
    ----------
    path : file to write
    h : element size far from the end of the flat face
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    radius, fillet, height : of the punch
    width, depth : radius and depth of the block
    edge : size at the end of the flat face in units of h
    """
    check_cell("rounded_punch", cell, 2, order)
    flat = radius - fillet
    if not 0.0 < fillet < radius < width or min(height - fillet, depth, h, edge) <= 0.0:
        raise ValueError(f"mesh 'rounded_punch': radius {radius}, fillet {fillet}, width {width}; expected 0 < fillet "
                         "< radius < width, and a height above the fillet")  # fmt: skip
    with gmsh_model("rounded_punch"):
        geo = gmsh.model.geo
        fine, middle = edge * h, 0.5 * h
        corners = [geo.addPoint(*x, 0.0, size) for x, size in (
            ((0.0, 0.0), middle), ((flat, 0.0), fine), ((radius, fillet), h), ((radius, height), h), ((0.0, height), h)
        )]  # fmt: skip
        centre = geo.addPoint(flat, fillet, 0.0, h)
        lines = [geo.addLine(corners[0], corners[1]), geo.addCircleArc(corners[1], centre, corners[2])]
        lines += [geo.addLine(a, b) for a, b in zip(corners[2:], [*corners[3:], corners[0]], strict=True)]
        upper = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        corners_below = [geo.addPoint(*x, 0.0, size) for x, size in (
            ((0.0, -depth), h), ((width, -depth), h), ((width, 0.0), h), ((flat, 0.0), 1.3 * fine), ((0.0, 0.0), middle)
        )]  # fmt: skip
        below = [geo.addLine(a, b) for a, b in zip(corners_below, corners_below[1:] + corners_below[:1], strict=True)]
        lower = geo.addPlaneSurface([geo.addCurveLoop(below)])
        geo.synchronize()
        for name, bodies in (("punch", [upper]), ("block", [lower])):
            group(2, name, bodies)
        for name, curves in (
            ("punch_skin", lines[:2]), ("punch_side", [lines[2]]), ("punch_top", [lines[3]]),
            ("block_bottom", [below[0]]), ("block_side", [below[1]]), ("block_top", below[2:4]),
            ("axis", [lines[4], below[4]]),
        ):  # fmt: skip
            group(1, name, curves)
        for name, point in (("punch_centre", corners[0]), ("block_centre", corners_below[4])):
            group(0, name, [point])
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        unstructured(cell)
        return finish(path, 2, order)
