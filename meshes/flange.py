"""A flanged joint: two rings with a gap for a gasket, held together by bolts through their holes."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np

from .tools import finish, gmsh_model, group, restrict_field, use_fields

# radii of the bore, of the gasket outside, of the bolt circle, of the rings outside [length]
BORE, SEAL, PITCH, OUTER = 50.0, 70.0, 85.0, 110.0
# thickness of a ring, gap between the rings, height of heads and nuts [length]
THICK, GAP, HEIGHT = 20.0, 2.0, 10.0
# radii of holes, shanks, heads and nuts [length]
HOLE, SHANK, HEAD = 9.5, 8.0, 14.0
_TOLERANCE = 1e-6


def _ring(low: float, count: int) -> list[int]:
    """Volumes of a ring from a height on: the part below the gasket, and that with the holes."""
    occ = gmsh.model.occ

    def annulus(inner, outer):
        body, hole = ((3, occ.addCylinder(0, 0, low, 0, 0, THICK, r)) for r in (outer, inner))
        return occ.cut([body], [hole])[0]

    angles = 2.0 * np.pi * np.arange(count) / count
    holes = [(3, occ.addCylinder(PITCH * np.cos(t), PITCH * np.sin(t), low, 0, 0, THICK, HOLE)) for t in angles]
    outside, _ = occ.cut(annulus(SEAL, OUTER), holes)
    parts, _ = occ.fragment(annulus(BORE, SEAL), outside)
    return [tag for dim, tag in parts if dim == 3]


def _bolt(angle: float) -> list[int]:
    """Volumes of a bolt: both halves of its shank, head and nut."""
    occ, x, y, end = gmsh.model.occ, PITCH * np.cos(angle), PITCH * np.sin(angle), 0.5 * GAP + THICK
    spans = [(-end, end, SHANK), (0.0, end, SHANK), (end, HEIGHT, HEAD), (-end - HEIGHT, HEIGHT, HEAD)]
    parts = [(3, occ.addCylinder(x, y, low, 0, 0, height, radius)) for low, height, radius in spans]
    found, _ = occ.fragment(parts[:1], parts[1:])
    return [tag for dim, tag in found if dim == 3]


def _faces(volumes: list[int]) -> tuple[list[int], list[int]]:
    """Faces on the boundary of joined volumes, and those between them."""
    bodies = [(3, tag) for tag in volumes]
    outside = {tag for _, tag in gmsh.model.getBoundary(bodies, combined=True, oriented=False)}
    every = {tag for _, tag in gmsh.model.getBoundary(bodies, combined=False, oriented=False)}
    return sorted(outside), sorted(every - outside)


def _flat(faces: list[int], height: float) -> list[int]:
    """Those in a plane z = height."""
    boxes = {tag: gmsh.model.occ.getBoundingBox(2, tag) for tag in faces}
    return [tag for tag, box in boxes.items() if max(abs(box[2] - height), abs(box[5] - height)) < _TOLERANCE * OUTER]


def _reach(face: int) -> float:
    """How far a face goes along x or y."""
    x, y, _, *far = gmsh.model.occ.getBoundingBox(2, face)
    return float(max(map(abs, (x, y, *far[:2]))))


def flange(path: str | Path, h: float = 10.0, *, h_bolt: float | None = None, bolts: int = 8) -> Path:
    """Two rings face to face with a gap of 2 for a gasket, and bolts through holes with play; tetrahedra.

    Groups: lower, upper, bolts; lower_gasket, upper_gasket (faces of the gap inside the bolts), lower_pipe, upper_pipe
    (the other sides of these), bore; lower_seat, upper_seat (where nuts and heads lie), heads, nuts (their faces
    there), section_1, ... (planes across the shanks, in the middle of the gap).

    Parameters
    ----------
    path : file to write
    h : element size of the rings
    h_bolt : element size of the bolts; default: 0.6 h
    bolts : how many
    """
    if not (h > 0 and (h_bolt is None or h_bolt > 0)):
        raise ValueError(f"mesh 'flange': sizes {h}, {h_bolt}; expected positive numbers")
    if not 3 <= bolts <= int(np.pi * PITCH / HEAD):
        raise ValueError(f"mesh 'flange': {bolts} bolts; expected 3 to {int(np.pi * PITCH / HEAD)}")
    with gmsh_model("flange"):
        rings = {"lower": _ring(-0.5 * GAP - THICK, bolts), "upper": _ring(0.5 * GAP, bolts)}
        shanks = [_bolt(2.0 * np.pi * k / bolts) for k in range(bolts)]
        gmsh.model.occ.synchronize()
        bore, ends = [], {"heads": [], "nuts": []}
        for sign, (name, parts) in zip((-1.0, 1.0), rings.items(), strict=True):
            group(3, name, parts)
            outside, _ = _faces(parts)
            near, far = _flat(outside, 0.5 * sign * GAP), _flat(outside, sign * (0.5 * GAP + THICK))
            middle = SEAL * (1.0 + _TOLERANCE)
            group(2, f"{name}_gasket", [tag for tag in near if _reach(tag) < middle])
            group(2, f"{name}_pipe", [tag for tag in far if _reach(tag) < middle])
            group(2, f"{name}_seat", [tag for tag in far if _reach(tag) > middle])
            flat = {*near, *far}
            bore += [tag for tag in outside if tag not in flat and _reach(tag) < BORE * (1.0 + _TOLERANCE)]
        group(2, "bore", bore)
        for number, parts in enumerate(shanks, 1):
            outside, inside = _faces(parts)
            for name, sign in (("nuts", -1.0), ("heads", 1.0)):
                ends[name] += _flat(outside, sign * (0.5 * GAP + THICK))
            group(2, f"section_{number}", _flat(inside, 0.0))
        group(3, "bolts", [tag for parts in shanks for tag in parts])
        for name, tags in ends.items():
            group(2, name, tags)
        fields = []
        for size, tags in ((h, sum(rings.values(), [])), (h_bolt or 0.6 * h, sum(shanks, []))):
            field = gmsh.model.mesh.field.add("MathEval")
            gmsh.model.mesh.field.setString(field, "F", f"{size!r}")
            fields.append(restrict_field(field, 3, tags))
        use_fields(fields)
        return finish(path, 3, 1)
