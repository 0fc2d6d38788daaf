"""A pinned joint: a lug in a fork, and a pin through both; the half z >= 0."""

from __future__ import annotations

from pathlib import Path

import gmsh

from .tools import finish, gmsh_model, group, restrict_field, use_fields

# radii of the holes and the pin, of the eyes; length of the plates from the axis on [length]
HOLE, EYE, LENGTH = 15.0, 30.0, 90.0
# half thickness of the lug, play beside it, thickness of a cheek of the fork, what the pin juts out [length]
LUG, PLAY, CHEEK, OUT = 10.0, 1.0, 10.0, 3.0
_NEAR = 1e-4


def _plate(low: float, high: float, way: float) -> int:
    """Volume of a plate between two heights with an eye around the axis, that goes along x."""
    occ, height = gmsh.model.occ, high - low
    eye = (3, occ.addCylinder(0, 0, low, 0, 0, height, EYE))
    bar = (3, occ.addBox(min(0.0, way * LENGTH), -EYE, low, LENGTH, 2.0 * EYE, height))
    body, _ = occ.fuse([eye], [bar])
    found, _ = occ.cut(body, [(3, occ.addCylinder(0, 0, low, 0, 0, height, HOLE))])
    return found[0][1]


def _faces(volume: int) -> dict[int, tuple[float, ...]]:
    """Boxes of the faces of a volume."""
    faces = gmsh.model.getBoundary([(3, volume)], oriented=False)
    return {tag: gmsh.model.occ.getBoundingBox(2, tag) for _, tag in faces}


def _within(boxes: dict[int, tuple[float, ...]], axis: int, low: float, high: float) -> list[int]:
    """Faces that are between two values of a coordinate."""
    return [tag for tag, box in boxes.items() if box[axis] > low - _NEAR and box[axis + 3] < high + _NEAR]


def pin(path: str | Path, h: float = 6.0, order: int = 2, *, h_hole: float | None = None) -> Path:
    """A lug along -x between the cheeks of a fork along x, a pin through both, of the radius of the holes; tetrahedra.

    The half z >= 0 of it. Groups: lug, fork, shaft (the pin); lug_hole, fork_hole, shaft_skin; lug_end, fork_end (the
    far faces of the plates); symmetry_z (lug and pin on z = 0).

    Parameters
    ----------
    path : file to write
    h : element size
    order : 1 or 2, degree of the geometry
    h_hole : element size of the pin; default: 0.6 h
    """
    if not (h > 0 and (h_hole is None or h_hole > 0)):
        raise ValueError(f"mesh 'pin': sizes {h}, {h_hole}; expected positive numbers")
    cheek = LUG + PLAY
    with gmsh_model("pin"):
        lug, fork = _plate(0.0, LUG, -1.0), _plate(cheek, cheek + CHEEK, 1.0)
        shaft = gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, cheek + CHEEK + OUT, HOLE)
        gmsh.model.occ.synchronize()
        bottom = []
        for name, tag in (("lug", lug), ("fork", fork), ("shaft", shaft)):
            group(3, name, [tag])
            boxes = _faces(tag)
            bottom += _within(boxes, 2, 0.0, 0.0)
            round_ones = [one for one in _within(boxes, 0, -HOLE, HOLE) if boxes[one][5] - boxes[one][2] > _NEAR]
            if name == "shaft":
                group(2, "shaft_skin", round_ones)
                continue
            group(2, f"{name}_hole", round_ones)
            end = LENGTH if name == "fork" else -LENGTH
            group(2, f"{name}_end", _within(boxes, 0, end, end))
        group(2, "symmetry_z", bottom)
        fields = []
        for size, tags in ((h, [lug, fork]), (h_hole or 0.6 * h, [shaft])):
            field = gmsh.model.mesh.field.add("MathEval")
            gmsh.model.mesh.field.setString(field, "F", f"{size!r}")
            fields.append(restrict_field(field, 3, tags))
        use_fields(fields)
        return finish(path, 3, order)
