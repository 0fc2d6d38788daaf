"""Geometries of some of the meshes, for scenes that name them: as text for gmsh, of its own kernel or OpenCASCADE's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gmsh

from .tools import gmsh_model

# of an octant and of a quarter, bodies of radii r > q > s, the outer one first
_TWO = """SetFactory("OpenCASCADE");
{shape}(1) = {{{at}, {r}, {angles}}};
{shape}(2) = {{{at}, {q}, {angles}}};
{shape}(3) = {{{at}, {q}, {angles}}};
{shape}(4) = {{{at}, {s}, {angles}}};
BooleanDifference{{ Volume{{1}}; Delete; }}{{ Volume{{2}}; Delete; }}
BooleanDifference{{ Volume{{3}}; Delete; }}{{ Volume{{4}}; Delete; }}
"""


def rings(radii: Sequence[float] = (1.0, 0.6, 0.2), delta: float = 0.0, kernel: str = "Built-in") -> str:
    """A quarter of two rings, see :func:`meshes.rings`."""
    large, middle, small = radii
    text = f'SetFactory("{kernel}");\nPoint(1) = {{0, 0, 0}};\n'
    for k, r in enumerate((large, middle, middle + delta, small)):
        text += f"Point({10 * k + 11}) = {{{r!r}, 0, 0}};\nPoint({10 * k + 12}) = {{0, {r!r}, 0}};\n"
        text += f"Circle({k + 1}) = {{{10 * k + 11}, 1, {10 * k + 12}}};\n"
    for n, (out, hole) in enumerate(((0, 1), (2, 3))):
        text += f"Line({20 + 2 * n}) = {{{10 * hole + 11}, {10 * out + 11}}};\n"
        text += f"Line({21 + 2 * n}) = {{{10 * hole + 12}, {10 * out + 12}}};\n"
        text += f"Curve Loop({n + 1}) = {{{20 + 2 * n}, {out + 1}, -{21 + 2 * n}, -{hole + 1}}};\n"
        text += f"Plane Surface({n + 1}) = {{{n + 1}}};\n"
    return text


def shells(radii: Sequence[float] = (1.0, 0.6, 0.3)) -> str:
    """Eighths of two spherical shells, see :func:`meshes.shells.shells`."""
    r, q, s = radii
    return _TWO.format(shape="Sphere", at="0, 0, 0", r=r, q=q, s=s, angles="0, Pi/2, Pi/2")


def tubes(radii: Sequence[float] = (1.0, 0.6, 0.2), height: float = 0.3) -> str:
    """Quarters of two tubes, see :func:`meshes.shells.tubes`."""
    r, q, s = radii
    return _TWO.format(shape="Cylinder", at=f"0, 0, 0, 0, 0, {height}", r=r, q=q, s=s, angles="Pi/2")


def write_geometry(path: str | Path, text: str) -> Path:
    """Write a geometry, as text to a file `.geo`, or as what gmsh makes of it.

    Parameters
    ----------
    path : file to write: `.geo`, or with OpenCASCADE `.step` or `.brep`
    text : the geometry
    """
    path = Path(path)
    if path.suffix == ".geo":
        path.write_text(text)
        return path
    plain = path.with_suffix(".geo")
    plain.write_text(text)
    with gmsh_model("geometry"):
        gmsh.merge(str(plain))
        gmsh.write(str(path))
    return path
