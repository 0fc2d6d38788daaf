"""A snap-fit: a cantilever with a hook is pushed along x under the nose of a fixed catch and snaps in behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np

from .grid import Grid, add, sweep, take, upright
from .tools import check_cell, generate, gmsh_model, group, logger, unstructured, use_fields, write

_DEFAULT_CELL = {2: "triangle", 3: "hexahedron"}
_PLANE = {"hexahedron": "quadrilateral", "tetrahedron": "triangle"}


@dataclass(frozen=True)
class ClipShape:
    """Dimensions of the clip and of its catch; lengths in one unit (mm), angles in degrees.

    The beam is [0, length] x [0, thickness], its hook rises to thickness + height. The catch hangs from above, its nose
    reaches down to thickness + height - overlap. Both have a ramp, a flat crest and a retention face.

    With E = 2000, nu = 0.35 a beam of these dimensions in plane strain, clamped at its root and bent by `overlap`, has
    a bending stress of 3 E thickness overlap / (2 length^2 (1 - nu^2)) = 42 there. The clip itself, whose root gives
    way and whose hook is longer than the beam, has an equivalent stress of 33 at the fillets (elastic, no friction).

    Attributes
    ----------
    length : from the end of the root block to the foot of the hook's retention face
    thickness : of the beam
    height : of the hook above the beam and of the nose below its plate
    overlap : what the hook has to give way to pass the nose
    crest : length of the crests between the corners before rounding
    ramp, catch_ramp : angles of the insertion faces of hook and nose against x; the nose's is not the steeper one, so
        that the hook's corner slides along the nose's ramp
    retention : angle of both retention faces against x
    radius : of the rounded corners
    front : height of the clip's front face below the hook's ramp
    root_length, root_height, root_radius : the block at the root, what it stands out above and below, and the fillets
    plate, plate_overhang : thickness of the catch's plate, and how far it reaches beyond the nose on either side
    clearance : distance of the bodies at the start, and of their retention faces after the full travel
    """

    length: float = 7.0
    thickness: float = 1.0
    height: float = 0.8
    overlap: float = 0.6
    crest: float = 0.4
    ramp: float = 33.0
    catch_ramp: float = 30.0
    retention: float = 70.0
    radius: float = 0.2
    front: float = 0.8
    root_length: float = 1.0
    root_height: float = 0.75
    root_radius: float = 0.5
    plate: float = 1.0
    plate_overhang: float = 0.8
    clearance: float = 0.08

    def __post_init__(self):
        if not 0 < self.overlap < self.height or not 0 < self.clearance < self.height - self.overlap:
            raise ValueError(
                f"clip: overlap {self.overlap}, clearance {self.clearance}; expected an overlap below the height "
                f"{self.height} and a clearance below what is left of it"
            )
        if not 0 < self.catch_ramp <= self.ramp < self.retention < 90:
            raise ValueError(
                f"clip: angles {self.catch_ramp}, {self.ramp}, {self.retention} of catch_ramp, ramp and retention; "
                "expected them in this order between 0 and 90"
            )
        turns = np.radians([self.ramp, self.retention])
        if self.crest < 1.05 * self.radius * float(np.tan(0.5 * turns).sum()):
            raise ValueError(f"clip: radius {self.radius} is too large for a crest of {self.crest}")

    def _run(self, rise: float, angle: float) -> float:
        return rise / float(np.tan(np.radians(angle)))

    @property
    def top(self) -> float:
        """Height of the hook's crest."""
        return self.thickness + self.height

    @property
    def crest_start(self) -> float:
        """x of the corner between the hook's retention face and its crest."""
        return self.length + self._run(self.height, self.retention)

    @property
    def tip(self) -> float:
        """x of the clip's front face."""
        return self.crest_start + self.crest + self._run(self.top - self.front, self.ramp)

    @property
    def nose_bottom(self) -> float:
        """Height of the nose's crest."""
        return self.top - self.overlap

    @property
    def nose_start(self) -> float:
        """x of the corner between the nose's ramp and its crest, such that the bodies are `clearance` apart.

        The hook's rounded corner between ramp and crest is nearest to the nose's ramp: its centre is
        radius + clearance away from it.
        """
        turn, angle = np.radians(self.ramp), np.radians(self.catch_ramp)
        centre = np.array([self.crest_start + self.crest - self.radius * np.tan(0.5 * turn), self.top - self.radius])
        normal = np.array([np.sin(angle), np.cos(angle)])  # from the hook to the ramp
        # (corner - centre) . normal = radius + clearance, the corner at the height of the nose's bottom.
        away = self.radius + self.clearance - (self.nose_bottom - centre[1]) * normal[1]
        return float(centre[0] + away / normal[0])

    @property
    def nose_end(self) -> float:
        """x of the corner between the nose's crest and its retention face."""
        return self.nose_start + self.crest

    @property
    def plate_height(self) -> float:
        """Height of the plate's lower side."""
        return self.nose_bottom + self.height

    @property
    def first_touch(self) -> float:
        """Travel at which the undeformed bodies touch first."""
        return self.clearance / float(np.sin(np.radians(self.catch_ramp)))

    @property
    def passed(self) -> float:
        """Travel at which the retention faces of the undeformed bodies lie on one another."""
        # The hook's retention face meets the height of the nose's bottom at this x at the start.
        at_bottom = self.crest_start - self._run(self.overlap, self.retention)
        return self.nose_end - at_bottom

    @property
    def travel(self) -> float:
        """Full travel: the undeformed hook is behind the nose, its retention face `clearance` away from the nose's."""
        return self.passed + self.clearance / float(np.sin(np.radians(self.retention)))

    @property
    def play(self) -> float:
        """Height that is left between the hook's crest and the plate, and the nose's crest and the beam, at the end."""
        return self.height - self.overlap


CLIP = ClipShape()


class _Outline:
    """A polygon with rounded corners, counter-clockwise; curves by the names given to the sides.

    Every corner is (x, y, radius, name of the side to the next corner, name of its arc).
    """

    def __init__(self, corners: Sequence[tuple[float, float, float, str, str]]):
        geo = gmsh.model.geo
        x = np.array([corner[:2] for corner in corners])
        ahead, behind = np.roll(x, -1, axis=0) - x, np.roll(x, 1, axis=0) - x
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        behind /= np.linalg.norm(behind, axis=1)[:, None]
        self.curves: dict[str, list[int]] = {}
        ends, arcs = [], []
        for k, (_, _, radius, _, name) in enumerate(corners):
            if not radius:
                ends.append([geo.addPoint(*x[k], 0.0)] * 2)
                arcs.append(None)
                continue
            half = 0.5 * np.arccos(np.clip(ahead[k] @ behind[k], -1, 1))
            back = radius / np.tan(half)
            middle = (ahead[k] + behind[k]) / np.linalg.norm(ahead[k] + behind[k])
            centre = geo.addPoint(*(x[k] + radius / np.sin(half) * middle), 0.0)
            pair = [geo.addPoint(*(x[k] + back * way), 0.0) for way in (behind[k], ahead[k])]
            ends.append(pair)
            arcs.append(geo.addCircleArc(pair[0], centre, pair[1]))
            self.curves.setdefault(name, []).append(arcs[-1])
        loop = []
        for k, (*_, side, _) in enumerate(corners):
            line = geo.addLine(ends[k][1], ends[(k + 1) % len(corners)][0])
            self.curves.setdefault(side, []).append(line)
            loop += [curve for curve in (arcs[k], line) if curve is not None]
        self.surface = geo.addPlaneSurface([geo.addCurveLoop(loop)])
        geo.synchronize()


def _clip_outline(s: ClipShape) -> _Outline:
    low, high = -s.root_height, s.thickness + s.root_height
    skin = max(0.5 * s.length, s.length - 1.5 * s.height)
    r = s.radius
    return _Outline(
        [
            (-s.root_length, low, 0, "sides", ""),
            (0.0, low, 0, "sides", ""),
            (0.0, 0.0, s.root_radius, "sides", "fillet"),
            (s.tip, 0.0, r, "sides", "sides"),
            (s.tip, s.front, r, "skin", "skin"),
            (s.crest_start + s.crest, s.top, r, "skin", "skin"),
            (s.crest_start, s.top, r, "skin", "skin"),
            (s.length, s.thickness, r, "skin", "skin"),
            (skin, s.thickness, 0, "sides", ""),
            (0.0, s.thickness, s.root_radius, "sides", "fillet"),
            (0.0, high, 0, "sides", ""),
            (-s.root_length, high, 0, "root", ""),
        ]
    )


def _catch_outline(s: ClipShape) -> _Outline:
    bottom, top, r = s.plate_height, s.plate_height + s.plate, s.radius
    foot = s.nose_start - s._run(s.height, s.catch_ramp), s.nose_end + s._run(s.height, s.retention)
    left, right = foot[0] - s.plate_overhang, foot[1] + s.plate_overhang
    return _Outline(
        [
            (left, bottom, r, "skin", "sides"),
            (foot[0], bottom, r, "skin", "skin"),
            (s.nose_start, s.nose_bottom, r, "skin", "skin"),
            (s.nose_end, s.nose_bottom, r, "skin", "skin"),
            (foot[1], bottom, r, "skin", "skin"),
            (right, bottom, r, "sides", "sides"),
            (right, top, 0, "base", ""),
            (left, top, 0, "sides", ""),
        ]
    )


def _size_field(curves: Sequence[int], h: float, coarse: float, growth: float) -> int:
    """h on the curves, then growing by `growth` per unit length up to `coarse`."""
    add_field, number = gmsh.model.mesh.field.add, gmsh.model.mesh.field.setNumber
    distance, field = add_field("Distance"), add_field("Threshold")
    gmsh.model.mesh.field.setNumbers(distance, "CurvesList", list(curves))
    number(distance, "Sampling", 100)
    reach = 1.5 * h
    values = {
        "InField": distance,
        "SizeMin": h,
        "SizeMax": coarse,
        "DistMin": reach,
        "DistMax": reach + (coarse - h) / growth,
    }
    for key, value in values.items():
        number(field, key, value)
    return field


def _plane_grids(s: ClipShape, h: float, order: int, cell: str, coarse: float, growth: float) -> dict[str, Grid]:
    """The plane meshes of the two bodies, taken out of gmsh."""
    outlines = {"clip": _clip_outline(s), "catch": _catch_outline(s)}
    unstructured(cell)
    fine = [curve for line in outlines.values() for key in ("skin", "fillet") for curve in line.curves.get(key, [])]
    use_fields([_size_field(fine, h, coarse, growth)])
    generate(2, order)
    grids = {}
    for name, outline in outlines.items():
        curves = {f"{name}_{key}": list(tags) for key, tags in outline.curves.items()}
        curves[f"{name}_sides"] += curves.pop(f"{name}_fillet", [])
        grids[name] = take(cell, order, [outline.surface], curves)
    gmsh.clear()
    return grids


def clip(
    path: str | Path,
    dim: int = 2,
    h: float = 0.1,
    order: int = 1,
    cell: str | None = None,
    *,
    coarse: float | None = None,
    growth: float = 0.3,
    width: float = 3.0,
    layers: int | None = None,
    shape: ClipShape = CLIP,
) -> Path:
    """A snap-fit clip and its catch, in the plane or extruded to z in [0, width].

    To be moved by shape.travel in x at its root: the hook rides up the catch's ramp, passes under the nose and snaps in
    behind it. `ClipShape` tells the numbers; `meshes.CLIP` has those of the default: travel 2.297, first touch at
    0.16. Usable levels for a study: h = 0.1, 0.05, 0.025.

    Groups: clip, catch; clip_root (its rear, to be moved), clip_skin (front edge, ramp, crest, retention face and a bit
    of the beam), clip_sides (the rest); catch_skin (the lower side), catch_base (its top, to be held), catch_sides (the
    rest); in 3D clip_front, clip_back, catch_front, catch_back (z = 0, z = width).

    Parameters
    ----------
    path : file to write
    dim : 2 (plane strain) or 3
    h : element size on the skins and in the root's fillets
    order : 1 or 2, degree of the geometry
    cell : triangle (default in 2D), quadrilateral, hexahedron (default in 3D), tetrahedron
    coarse : largest size; default 2.5 h, at most a quarter of the beam's thickness
    growth : growth of the size per unit length
    width, layers : width of both bodies and cells across it (3D; default: layers of about 3 h, tetrahedra 1.5 h)
    shape : other dimensions, from Python
    """
    cell = cell or _DEFAULT_CELL.get(dim, "")
    check_cell("clip", cell, dim, order)
    if not isinstance(shape, ClipShape):
        raise ValueError(f"mesh 'clip': shape '{shape}'; a ClipShape is expected, which only Python can give")
    coarse = max(h, coarse or min(2.5 * h, shape.thickness / 4.0))
    with gmsh_model("clip"):
        for name, grid in _plane_grids(shape, h, order, _PLANE.get(cell, cell), coarse, growth).items():
            if dim == 3:
                count = layers or max(1, round(width / ((1.5 if cell == "tetrahedron" else 3.0) * h)))
                grid = sweep(grid, count, upright(width), f"{name}_front", f"{name}_back")
            body, facets = add(grid)
            group(dim, name, [body])
            for key, tag in facets.items():
                group(dim - 1, key, [tag])
        logger.info("clip: first touch at %.4g, full travel %.4g", shape.first_touch, shape.travel)
        return write(path)
