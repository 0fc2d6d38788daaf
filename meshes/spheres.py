"""Two spheres between two round plates: the meridian section of a stack of four bodies."""

from __future__ import annotations

from pathlib import Path

import gmsh

from .tools import check_cell, finish, gmsh_model, group, unstructured


def sphere_stack(path: str | Path, h: float = 0.4, order: int = 2, cell: str = "quadrilateral") -> Path:
    """Spheres of the radii 5 and 10 on a plate of radius 20 and thickness 4, below one of radius 10 and thickness 2.

    The dimensions are those of code_aster's test SSNA102; x is the radius, the lower plate stands on y = 0.

    Groups: top_plate, small, large, bottom_plate; top, top_rim, top_under (of the upper plate), small_upper,
    small_lower, large_upper, large_lower (halves of the spheres), bottom_over, bottom_rim, bottom_under; axis; point
    bottom_centre.

    Parameters
    ----------
    path : file to write
    h : element size where bodies touch; 1 / 16 of the dimension elsewhere at most
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    """
    check_cell("sphere_stack", cell, 2, order)
    with gmsh_model("sphere_stack"):
        geo, groups, axis, bodies = gmsh.model.geo, {}, [], {}

        def plate(name, radius, low, high, touches_low):
            near_, far = (h, radius / 10.0) if touches_low else (radius / 10.0, h)
            corners = [geo.addPoint(*x, 0.0, size) for x, size in (
                ((0.0, low), near_), ((radius, low), radius / 10.0), ((radius, high), radius / 10.0), ((0.0, high), far)
            )]  # fmt: skip
            lines = [geo.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
            bodies[name] = geo.addPlaneSurface([geo.addCurveLoop(lines)])
            axis.append(lines[3])
            return corners, lines

        def sphere(name, radius, low):
            middle = geo.addPoint(0.0, low + radius, 0.0, radius / 8.0)
            ends = [geo.addPoint(*x, 0.0, size) for x, size in (
                ((0.0, low), h), ((radius, low + radius), radius / 8.0), ((0.0, low + 2.0 * radius), h)
            )]  # fmt: skip
            arcs = [geo.addCircleArc(a, middle, b) for a, b in zip(ends, ends[1:], strict=False)]
            lines = [geo.addLine(ends[2], middle), geo.addLine(middle, ends[0])]
            bodies[name] = geo.addPlaneSurface([geo.addCurveLoop([*arcs, *lines])])
            axis.extend(lines)
            groups[f"{name}_lower"], groups[f"{name}_upper"] = [arcs[0]], [arcs[1]]

        corners, lines = plate("bottom_plate", 20.0, 0.0, 4.0, False)
        groups.update(bottom_under=[lines[0]], bottom_rim=[lines[1]], bottom_over=[lines[2]])
        sphere("large", 10.0, 4.0)
        sphere("small", 5.0, 24.0)
        _, lines = plate("top_plate", 10.0, 34.0, 36.0, True)
        groups.update(top_under=[lines[0]], top_rim=[lines[1]], top=[lines[2]])
        geo.synchronize()
        for name, tag in bodies.items():
            group(2, name, [tag])
        for name, tags in {**groups, "axis": axis}.items():
            group(1, name, tags)
        group(0, "bottom_centre", [corners[0]])
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        unstructured(cell)
        return finish(path, 2, order)


def balls(
    path: str | Path, radius: float = 1.0, h: float = 0.01, order: int = 2, cell: str = "triangle", *,
    gap: float = 0.0, two: bool = False,
) -> Path:
    """Meridian section of a ball above y = 0, x is the radius; or of two, above and below.

    Groups: upper; upper_skin (the half that looks to y = 0), upper_back, axis; of two the same with lower.

    Parameters
    ----------
    path : file to write
    radius : of the balls
    h : element size where they come near y = 0; an eighth of the radius elsewhere at most
    order : 1 or 2, degree of the geometry
    cell : triangle or quadrilateral
    gap : from y = 0 to a ball
    two : a second ball, below
    """
    check_cell("balls", cell, 2, order)
    with gmsh_model("balls"):
        geo, axis, names = gmsh.model.geo, [], {}
        for name, sign in (("upper", 1.0), ("lower", -1.0))[: 2 if two else 1]:
            middle = geo.addPoint(0.0, sign * (gap + radius), 0.0, radius / 8.0)
            near_, side, far = (geo.addPoint(*x, 0.0, size) for x, size in (
                ((0.0, sign * gap), h), ((radius, sign * (gap + radius)), radius / 8.0),
                ((0.0, sign * (gap + 2.0 * radius)), radius / 8.0),
            ))  # fmt: skip
            skin, back = geo.addCircleArc(near_, middle, side), geo.addCircleArc(side, middle, far)
            lines = [geo.addLine(far, middle), geo.addLine(middle, near_)]
            loop = [skin, back, *lines]
            surface = geo.addPlaneSurface([geo.addCurveLoop(loop if sign > 0.0 else [-one for one in loop[::-1]])])
            names[name] = (surface, skin, back)
            axis += lines
        geo.synchronize()
        for name, (surface, skin, back) in names.items():
            group(2, name, [surface])
            group(1, f"{name}_skin", [skin])
            group(1, f"{name}_back", [back])
        group(1, "axis", axis)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        unstructured(cell)
        return finish(path, 2, order)
