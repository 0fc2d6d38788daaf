"""Helical springs of hexahedra, and a plane C-shaped strip whose lips meet when it is closed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .grid import Grid, add, join, lattice, name_boundary, name_inside, near, split_group, sweep
from .tools import check_cell, check_choice, gmsh_model, group, write

_ENDS = ("open", "closed", "ground")
_CORE = 0.55  # half width of the middle of the section in units of the wire's radius
_BLEND = 0.5  # turns over which the pitch changes
_LEFT_AT_THE_TIP = 0.35  # of the wire's diameter where the ground ends begin


@dataclass(frozen=True)
class Helix:
    """Centre line of the wire over t in [0, coils] turns, and where ground ends cut the wire."""

    wire: float
    diameter: float
    coils: float
    pitch: float
    ends: str
    closed: float
    gap: float
    top: float | None = None

    @property
    def closed_pitch(self) -> float:
        """Rise per turn of the end coils."""
        return self.pitch if self.ends == "open" else self.wire * (1.0 + self.gap)

    @property
    def start(self) -> float:
        """Height of the centre line's beginning: the lowest point, or the plane of the ground end, is z = 0."""
        return 0.5 * self.wire if self.ends != "ground" else (_LEFT_AT_THE_TIP - 0.5) * self.wire

    @property
    def height(self) -> float:
        """Height of the plane of the upper end, where the ends are ground; else that of the wire's highest point."""
        return float(self.rise(np.array([self.coils]))[0][0]) + self.start

    def rise(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height of the centre line and its derivative by the turns; the pitch changes as a smooth step."""
        low, (a, b) = self.closed_pitch, (self.closed - 0.5 * _BLEND, self.coils - self.closed - 0.5 * _BLEND)
        up, down = (np.clip((t - first) / _BLEND, 0.0, 1.0) for first in (a, b))
        step = up**2 * (3.0 - 2.0 * up) - down**2 * (3.0 - 2.0 * down)
        area = _BLEND * (up**3 - 0.5 * up**4 - down**3 + 0.5 * down**4)
        area += np.maximum(t - a - _BLEND, 0.0) - np.maximum(t - b - _BLEND, 0.0)
        return self.start + low * t + (self.pitch - low) * area, low + (self.pitch - low) * step

    def width(self, t: np.ndarray) -> np.ndarray:
        """Diameter of the centre line."""
        return self.diameter + ((self.top or self.diameter) - self.diameter) * t / self.coils

    def place(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The points x (n, 2) of the section at the parameters s (m,); see `sweep`."""
        t = self.coils * s
        z, slope = self.rise(t)
        angle, radius = 2.0 * np.pi * t, 0.5 * self.width(t)
        # a cone is narrow: its sections stand across the circle
        tangent = np.column_stack([-radius * np.sin(angle), radius * np.cos(angle), slope / (2.0 * np.pi)])
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        inward = np.column_stack([-np.cos(angle), -np.sin(angle), 0.0 * angle])
        upward = np.cross(tangent, inward)
        centre = -radius[:, None] * inward + z[:, None] * [0.0, 0.0, 1.0]
        across, along = np.tile(x[:, 0], (len(s), 1)), np.tile(x[:, 1], (len(s), 1))
        if self.ends == "ground":
            across, along = self._ground(across, along, -z / upward[:, 2])
            across, along = self._ground(across, -along, (z - self.height) / upward[:, 2])
            along = -along
        points = centre[:, None] + across[..., None] * inward[:, None] + along[..., None] * upward[:, None]
        if self.ends == "ground":
            for plane in (0.0, self.height):  # without the round-off
                points[..., 2] = np.where(np.abs(points[..., 2] - plane) < 1e-10 * self.wire, plane, points[..., 2])
        return points

    def _ground(self, x: np.ndarray, y: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Move the points (m, n) of round sections into what is left of them above y = floor (m,).

        Seen from the middle of what is left, every point keeps its direction. A circle around the middle stays nearly
        round far from the rim, so that the two corners of the cut bend the cells near them only.
        """
        r = 0.5 * self.wire
        floor = np.maximum(floor, -r)[:, None]
        middle, part = 0.5 * (r + floor), np.hypot(x, y) / r
        ex, ey = (u / np.where(part > 0.0, r * part, 1.0) for u in (x, y))
        way = np.sqrt((middle * ey) ** 2 + r**2 - middle**2) - middle * ey
        down = np.minimum(ey, -1e-12)
        way = np.where(ey < 0.0, np.minimum(way, (floor - middle) / down), way)
        way = part * (r - middle + part**2 * (way - r + middle))  # r - middle: the largest circle in what is left
        return way * ex, middle + way * ey


def _section(radius: float, n: int, rim: int, order: int) -> Grid:
    """A disk of quadrilaterals: n x n in its middle, 4 n around it in `rim` layers."""
    t = np.linspace(-1.0, 1.0, order * n + 1)
    s = np.linspace(0.0, 1.0, order * rim + 1)[:, None, None]

    def core(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        bulged = [u * np.sqrt(1.0 - 0.25 * v**2), v * np.sqrt(1.0 - 0.25 * u**2), 0.0 * u]
        return _CORE * radius * np.stack(np.broadcast_arrays(*bulged), axis=-1)

    patches = [core(*np.meshgrid(t, t, indexing="ij"))]
    angle = 0.25 * np.pi * t
    round_side = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * t])
    side = (1.0 - s) * core(np.ones_like(t), t) + s * round_side
    for k in range(4):
        c, q = ((1, 0), (0, 1), (-1, 0), (0, -1))[k]
        patches.append(side @ np.array([[c, q, 0.0], [-q, c, 0.0], [0.0, 0.0, 1.0]]))
    return name_boundary(join([lattice(patch, order, "quadrilateral") for patch in patches]), "spring_skin")


def spring(
    path: str | Path,
    h: float = 0.5,
    order: int = 1,
    *,
    wire: float = 2.0,
    diameter: float = 16.0,
    coils: float = 4.0,
    pitch: float = 5.0,
    ends: str = "open",
    closed: float = 1.0,
    gap: float = 0.1,
    along: float | None = None,
    top: float | None = None,
) -> Path:
    """A helical or conical spring of round wire around the z-axis: hexahedra swept along the wire.

    Groups: spring; spring_skin; end_bottom, end_top; skin (all facets). Open and closed ends: the ends are the sections
    of the wire. Ground ends: they are the flat faces z = 0 and z = height, the sections of the wire are called
    wire_ends. The flat groups hold the facets that lie in the plane entirely (half of the cut at h = wire / 4, three
    quarters at wire / 8).

    Parameters
    ----------
    path : file to write
    h : element size in the section
    order : 1 or 2, degree of the geometry
    wire, diameter : of the wire, and of its centre line
    coils : all turns, with those of the ends
    pitch : rise per turn of the coils between the ends
    ends : open (the same pitch everywhere), closed (the end coils lie close to their neighbours), or ground (closed
        and cut flat, with 0.35 of the wire left at its tips)
    closed : turns at each end that are closed
    gap : between closed coils, in units of the wire
    along : element size along the wire; default 2 h
    top : diameter of the centre line at the upper end, if another than at the lower one: a cone
    """
    check_cell("spring", "hexahedron", 3, order)
    check_choice("spring", "ends", ends, _ENDS)
    if not 0 < h or not 0 < wire < min(diameter, top or diameter) or not coils > 0 or not gap >= 0:
        raise ValueError(f"mesh 'spring': h {h}, wire {wire}, diameter {diameter}, top {top}, coils {coils}, gap {gap}")
    if coils > 1 and pitch <= 1.02 * wire:
        raise ValueError(f"mesh 'spring': pitch {pitch}; expected more than 1.02 times the wire {wire}")
    if ends != "open" and not (closed >= 0.5 and coils >= 2 * closed + _BLEND):
        raise ValueError(
            f"mesh 'spring': {coils} coils, {closed} of them closed at each end; expected 0.5 or more, "
            f"and {_BLEND} more coils than the closed ones"
        )
    helix = Helix(wire, diameter, coils, pitch, ends, closed, gap, top)
    n, rim = max(2, round(0.25 * np.pi * wire / h)), max(1, round(0.5 * (1.0 - _CORE) * wire / h))
    layers = max(2, round(np.hypot(np.pi * max(diameter, top or 0.0), pitch) * coils / (along or 2.0 * h)))
    with gmsh_model("spring"):
        flat = _section(0.5 * wire, n, rim, order)
        if ends == "ground":
            grid = sweep(flat, layers, helix.place, "wire_ends", "wire_ends")
            grid = split_group(grid, "spring_skin", end_bottom=near(2, 0.0), end_top=near(2, helix.height))
        else:
            grid = sweep(flat, layers, helix.place, "end_bottom", "end_top")
        body, facets = add(grid)
        group(3, "spring", [body])
        for key, tag in facets.items():
            group(2, key, [tag])
        group(2, "skin", list(facets.values()))
        return write(path)


def c_strip(
    path: str | Path,
    n: Sequence[int] = (3, 24),
    order: int = 1,
    cell: str = "quadrilateral",
    *,
    radius: float = 10.0,
    thickness: float = 1.0,
    gap: float = 10.0,
    split: bool = False,
) -> Path:
    """A plane ring around the origin with a gap on its right (x > 0), in one piece or cut into two halves.

    Both pieces have the same cells: with `back` held, contact of the lips of one body with each other has to give the
    same as contact of two bodies.

    Groups: strip (split: strip_upper, strip_lower); strip_inner, strip_outer (the round faces), lip_upper, lip_lower
    (the faces of the gap), lips (both), skin (lips and round faces), back (the line y = 0 on the left, across the
    strip: inside the whole one, where the halves were cut otherwise).

    Parameters
    ----------
    path : file to write
    n : cells across the strip and along each half
    order : 1 or 2, degree of the geometry
    cell : quadrilateral or triangle
    radius : of the middle of the strip
    thickness : of the strip
    gap : angle of the gap in degrees
    split : two halves whose nodes on the line `back` are apart
    """
    check_cell("c_strip", cell, 2, order)
    if not 0 < thickness < 2 * radius or not 0 < gap < 360 or min(n) < 1:
        raise ValueError(f"mesh 'c_strip': radius {radius}, thickness {thickness}, gap {gap}, cells {tuple(n)}")
    half = 0.5 * np.radians(gap)
    r = radius + thickness * np.linspace(-0.5, 0.5, order * n[0] + 1)[:, None]
    t = np.linspace(half, np.pi, order * n[1] + 1)
    y = np.where(np.arange(len(t)) == len(t) - 1, 0.0, np.sin(t))  # exactly zero on the line between the halves

    def lip(side: float) -> Callable[[np.ndarray], np.ndarray]:
        # Only on the lips all nodes are at this angle.
        return lambda x: np.abs(np.arctan2(x[..., 1], x[..., 0]) - side * half) < 1e-9

    conditions = {
        "lip_upper": lip(1.0),
        "lip_lower": lip(-1.0),
        "back": near(1, 0.0),
        "strip_inner": lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < radius,
    }
    with gmsh_model("c_strip"):
        halves = {
            key: lattice(np.stack([r * np.cos(t), side * r * y, 0.0 * r * t], axis=-1), order, cell)
            for key, side in (("strip_upper", 1.0), ("strip_lower", -1.0))
        }
        pieces = halves if split else {"strip": join(list(halves.values()))}
        tags: dict[str, list[int]] = {}
        for key, piece in pieces.items():
            named = name_boundary(piece, "strip_outer", **conditions)
            body, facets = add(named if split else name_inside(named, "back", conditions["back"]))
            group(2, key, [body])
            for name, tag in facets.items():
                tags.setdefault(name, []).append(tag)
        tags["lips"] = tags["lip_upper"] + tags["lip_lower"]
        faces = ("strip_inner", "strip_outer", "lips")
        tags["skin"] = [tag for name in faces for tag in tags[name]]
        for name, entities in tags.items():
            group(1, name, entities)
        return write(path)
