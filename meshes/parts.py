"""Parts of machines that touch: a lug on a loose pin and a disc between a stamp and an anvil, in the plane, and a
crowned roller on a block, in space."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np

from .tools import check_cell, finish, gmsh_model, group, point_size_field, restrict_field, unstructured, use_fields

# of the lug: radii of bore, eye and fillets, half width and length of the shank; hole of the pin [length]
BORE, EYE, FILLET, SHANK, LENGTH, HOLE = 10.0, 20.0, 6.0, 8.0, 60.0, 4.0
# of the roller: radius, radius of its profile, half length, height of the piece; of the block: size along x, half of
# it along y, depth [length]
ROLLER, CROWN, HALF, PIECE = 10.0, 100.0, 6.0, 5.0
BLOCK = (20.0, 8.0, 8.0)
# of the stamp: radius of its flat face, of the edge, height; radius and thickness of the disc and of the anvil [length]
FACE, EDGE, STAMP = 2.0, 4.0, 8.0
DISC, ANVIL = (10.0, 3.0), (14.0, 6.0)


def _loop(pieces: list[tuple[tuple[float, float], tuple[float, float] | None]]) -> tuple[int, list[int]]:
    """Closed line of straight pieces and arcs: beginnings of the pieces, and centres of arcs or None; the pieces."""
    geo = gmsh.model.geo
    ends = [geo.addPoint(*begin, 0.0) for begin, _ in pieces]
    lines = []
    for a, b, (_, centre) in zip(ends, ends[1:] + ends[:1], pieces, strict=True):
        lines.append(geo.addLine(a, b) if centre is None else geo.addCircleArc(a, geo.addPoint(*centre, 0.0), b))
    return geo.addCurveLoop(lines), lines


def _circle(radius: float) -> tuple[int, list[int]]:
    """Circle around the origin, of four arcs."""
    corners = [(radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius)]
    return _loop([(corner, (0.0, 0.0)) for corner in corners])


def _sizes(sizes: list[tuple[float, int]]) -> None:
    """One size of cells for each of some faces."""
    fields = []
    for size, face in sizes:
        field = gmsh.model.mesh.field.add("MathEval")
        gmsh.model.mesh.field.setString(field, "F", f"{size!r}")
        fields.append(restrict_field(field, 2, [face]))
    use_fields(fields)


def lug_on_pin(path: str | Path, h: float = 2.5, order: int = 2, *, clearance: float = 0.05) -> Path:
    """A lug whose shank goes along x, and a hollow pin in its bore, around the origin; triangles.

    Groups: lug, pin; lug_bore, lug_end (far end of the shank), lug_skin (all else); pin_skin, pin_hole.

    Parameters
    ----------
    path : file to write
    h : element size of the lug; that of the pin is 0.8 h
    order : 1 or 2, degree of the geometry
    clearance : radius of the bore less that of the pin
    """
    check_cell("lug_on_pin", "triangle", 2, order)
    if not 0.0 <= clearance < BORE - HOLE:
        raise ValueError(f"mesh 'lug_on_pin': clearance {clearance}; expected 0 <= clearance < {BORE - HOLE:g}")
    y = SHANK + FILLET
    x = float(np.sqrt((EYE + FILLET) ** 2 - y**2))
    part = EYE / (EYE + FILLET)
    with gmsh_model("lug_on_pin"):
        outline, lines = _loop([
            ((part * x, part * y), (0.0, 0.0)), ((-EYE, 0.0), (0.0, 0.0)), ((part * x, -part * y), (x, -y)),
            ((x, -SHANK), None), ((LENGTH, -SHANK), None), ((LENGTH, SHANK), None), ((x, SHANK), (x, y)),
        ])  # fmt: skip
        bore, inside = _circle(BORE)
        skin, outside = _circle(BORE - clearance)
        hole, held = _circle(HOLE)
        lug, pin = gmsh.model.geo.addPlaneSurface([outline, bore]), gmsh.model.geo.addPlaneSurface([skin, hole])
        gmsh.model.geo.synchronize()
        for name, face in (("lug", lug), ("pin", pin)):
            group(2, name, [face])
        for name, some in (
            ("lug_bore", inside), ("lug_end", [lines[4]]), ("lug_skin", [*lines[:4], *lines[5:]]),
            ("pin_skin", outside), ("pin_hole", held),
        ):  # fmt: skip
            group(1, name, some)
        _sizes([(h, lug), (0.8 * h, pin)])
        unstructured("triangle")
        return finish(path, 2, order)


def disc_in_press(path: str | Path, h: float = 1.0, order: int = 2) -> Path:
    """Meridian sections, x the radius, of a disc (its lower face on y = 0), the anvil below, and a stamp with a flat
    face and a round edge above; triangles.

    Groups: stamp, disc, anvil; stamp_skin (flat face and round edge), stamp_side, stamp_top; disc_top, disc_bottom,
    disc_rim; anvil_top, anvil_side, anvil_bottom; axis (x = 0, all three).

    Parameters
    ----------
    path : file to write
    h : element size of the disc; that of the stamp and the anvil is 1.5 h
    order : 1 or 2, degree of the geometry
    """
    check_cell("disc_in_press", "triangle", 2, order)
    if not h > 0.0:
        raise ValueError(f"mesh 'disc_in_press': h {h}; expected a positive number")
    (radius, top), (width, depth) = DISC, ANVIL
    with gmsh_model("disc_in_press"):
        loops = {
            "stamp": _loop([
                ((0.0, top), None), ((FACE, top), (FACE, top + EDGE)), ((FACE + EDGE, top + EDGE), None),
                ((FACE + EDGE, top + STAMP), None), ((0.0, top + STAMP), None),
            ]),
            "disc": _loop([((0.0, 0.0), None), ((radius, 0.0), None), ((radius, top), None), ((0.0, top), None)]),
            "anvil": _loop([((0.0, -depth), None), ((width, -depth), None), ((width, 0.0), None), ((0.0, 0.0), None)]),
        }  # fmt: skip
        faces = {name: gmsh.model.geo.addPlaneSurface([loop]) for name, (loop, _) in loops.items()}
        stamp, disc, anvil = (lines for _, lines in loops.values())
        gmsh.model.geo.synchronize()
        for name, face in faces.items():
            group(2, name, [face])
        for name, some in (
            ("stamp_skin", stamp[:2]), ("stamp_side", [stamp[2]]), ("stamp_top", [stamp[3]]),
            ("disc_bottom", [disc[0]]), ("disc_rim", [disc[1]]), ("disc_top", [disc[2]]),
            ("anvil_bottom", [anvil[0]]), ("anvil_side", [anvil[1]]), ("anvil_top", [anvil[2]]),
            ("axis", [stamp[4], disc[3], anvil[3]]),
        ):  # fmt: skip
            group(1, name, some)
        _sizes([(h if name == "disc" else 1.5 * h, face) for name, face in faces.items()])
        unstructured("triangle")
        return finish(path, 2, order)


def crowned_roller(path: str | Path, h: float = 0.7, order: int = 2, *, far: float = 4.0, growth: float = 0.5) -> Path:
    """The lower piece of a roller along y, whose profile is an arc, on a block; the half y >= 0; tetrahedra.

    The roller touches the block, below z = 0, at the origin.

    Groups: roller, block; roller_tread (its round face), roller_top, roller_end; block_top, block_bottom, block_sides;
    symmetry_y (y = 0, both).

    Parameters
    ----------
    path : file to write
    h : element size at the origin
    order : 1 or 2, degree of the geometry
    far : element size far from it
    growth : of the size per unit of length
    """
    check_cell("crowned_roller", "tetrahedron", 3, order)
    if not 0.0 < h <= far or not growth > 0.0:
        raise ValueError(f"mesh 'crowned_roller': h {h}, far {far}, growth {growth}; expected 0 < h <= far and a "
                         "positive growth")  # fmt: skip
    with gmsh_model("crowned_roller"):
        occ = gmsh.model.occ
        # profile in the plane of y and z, below the axis of the roller at z = ROLLER
        rise = CROWN - float(np.sqrt(CROWN**2 - HALF**2))
        ends = [occ.addPoint(0.0, *at) for at in ((0.0, 0.0), (HALF, rise), (HALF, ROLLER), (0.0, ROLLER))]
        lines = [occ.addCircleArc(ends[0], occ.addPoint(0.0, 0.0, CROWN), ends[1])]
        lines += [occ.addLine(a, b) for a, b in zip(ends[1:], [*ends[2:], ends[0]], strict=True)]
        profile = occ.addPlaneSurface([occ.addCurveLoop(lines)])
        both = []
        for way in (1.0, -1.0):
            copy = occ.copy([(2, profile)])
            turned = occ.revolve(copy, 0.0, 0.0, ROLLER, 0.0, 1.0, 0.0, way * 0.5 * np.pi)
            both += [one for one in turned if one[0] == 3]
        wheel, _ = occ.fuse(both[:1], both[1:])
        low = (3, occ.addBox(-2.0 * ROLLER, -1.0, -1.0, 4.0 * ROLLER, HALF + 2.0, 1.0 + PIECE))
        roller, _ = occ.intersect(wheel, [low])
        occ.remove([(2, profile)], recursive=True)
        length, half, depth = BLOCK
        block = (3, occ.addBox(-0.5 * length, 0.0, -depth, length, half, depth))
        occ.synchronize()
        faces = {}
        for name, (_, volume) in (("roller", roller[0]), ("block", block)):
            group(3, name, [volume])
            for _, tag in gmsh.model.getBoundary([(3, volume)], oriented=False):
                faces[tag] = (name, gmsh.model.getBoundingBox(2, tag))

        def on(name, axis, value):
            """Faces of a body on a plane."""
            return [tag for tag, (body, box) in faces.items()
                    if body == name and max(abs(box[axis] - value), abs(box[axis + 3] - value)) < 1e-4]  # fmt: skip

        flat = {"roller_top": on("roller", 2, PIECE), "roller_end": on("roller", 1, HALF)}
        ahead = [on(name, 1, 0.0) for name in ("roller", "block")]
        flat |= {"block_top": on("block", 2, 0.0), "block_bottom": on("block", 2, -depth)}
        known = {tag for tags in [*flat.values(), *ahead] for tag in tags}
        tread, sides = ([tag for tag, (body, _) in faces.items() if body == name and tag not in known]
                        for name in ("roller", "block"))  # fmt: skip
        for name, tags in (
            *flat.items(), ("roller_tread", tread), ("block_sides", sides), ("symmetry_y", ahead[0] + ahead[1]),
        ):  # fmt: skip
            group(2, name, tags)
        fields = []
        for (_, volume), size in ((roller[0], h), (block, 1.2 * h)):
            points = gmsh.model.getBoundary([(3, volume)], oriented=False, recursive=True)
            near = [tag for _, tag in points if np.linalg.norm(gmsh.model.getValue(0, tag, [])) < 1e-6]
            origin = near[0] if near else occ.addPoint(0.0, 0.0, 0.0)
            occ.synchronize()
            fields.append(restrict_field(point_size_field(origin, size, far, 1.5, growth), 3, [volume]))
        use_fields(fields)
        unstructured("tetrahedron")
        return finish(path, 3, order)
