"""Round bodies in space, one in the hole of the other: spherical shells and tubes whose meshes do not match."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gmsh
import numpy as np

from .grid import add, lattice, name_boundary, near, sweep, upright
from .tools import check_cell, finish, gmsh_model, group, unstructured, write


def _octant(small: float, large: float) -> int:
    """The volume between two spheres in the first octant."""
    occ, right = gmsh.model.occ, 0.5 * np.pi
    outer = occ.addSphere(0.0, 0.0, 0.0, large, angle1=0.0, angle2=right, angle3=right)
    inner = occ.addSphere(0.0, 0.0, 0.0, small, angle1=0.0, angle2=right, angle3=right)
    return occ.cut([(3, outer)], [(3, inner)])[0][0][1]


def shells(
    path: str | Path,
    radii: Sequence[float] = (1.0, 0.6, 0.3),
    h: float = 0.15,
    cell: str = "tetrahedron",
    *,
    order: int = 1,
    mismatch: float = 0.8,
) -> Path:
    """Eighths of two concentric shells, the inner one in the hole of the outer one.

    Groups: outer, inner; outer_skin, outer_inner_skin (the hole of the outer shell), inner_outer_skin, inner_skin;
    symmetry_x, symmetry_y, symmetry_z (on x = 0, ...).

    Parameters
    ----------
    path : file to write
    radii : outer radius, radius of the sphere of contact, radius of the hole
    h : element size of the outer shell
    cell : tetrahedron
    order : 1 or 2, degree of the geometry
    mismatch : element size of the inner shell in units of h
    """
    check_cell("shells", cell, 3, order)
    if cell != "tetrahedron":
        raise ValueError(f"mesh 'shells': cell '{cell}'; allowed: tetrahedron")
    large, middle, small = radii
    if not large > middle > small > 0:
        raise ValueError(f"mesh 'shells': radii {tuple(radii)}; expected three decreasing positive numbers")
    with gmsh_model("shells"):
        bodies = {"outer": (_octant(middle, large), middle, large, h)}
        bodies["inner"] = (_octant(small, middle), small, middle, mismatch * h)
        gmsh.model.occ.synchronize()
        planes = {0: [], 1: [], 2: []}
        for name, (volume, low, high, size) in bodies.items():
            group(3, name, [volume])
            skins = {low: [], high: []}
            for _, face in gmsh.model.getBoundary([(3, volume)], oriented=False):
                box = np.array(gmsh.model.getBoundingBox(2, face))
                flat = [k for k in range(3) if box[k + 3] - box[k] < 1e-3 * large]
                if flat:
                    planes[flat[0]].append(face)
                else:
                    skins[high if box[3:].max() > 0.5 * (low + high) else low].append(face)
            far, near = ("skin", "inner_skin") if name == "outer" else ("outer_skin", "skin")
            group(2, f"{name}_{far}", skins[high])
            group(2, f"{name}_{near}", skins[low])
            points = gmsh.model.getBoundary([(3, volume)], recursive=True)
            gmsh.model.mesh.setSize(points, size)
        for axis, faces in planes.items():
            group(2, f"symmetry_{'xyz'[axis]}", faces)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 1)
        unstructured(cell)
        return finish(path, 3, order)


def tubes(
    path: str | Path,
    radii: Sequence[float] = (1.0, 0.6, 0.2),
    n: int = 8,
    cell: str = "hexahedron",
    *,
    order: int = 1,
    height: float = 0.3,
) -> Path:
    """Quarters of two concentric tubes along z, the inner one in the hole of the outer one; structured meshes.

    Groups as for `shells`: outer, inner; outer_skin, outer_inner_skin, inner_outer_skin, inner_skin; symmetry_x,
    symmetry_y, and symmetry_z (both ends).

    Parameters
    ----------
    path : file to write
    radii : outer radius, radius of contact, radius of the hole
    n : cells of the outer tube around; those across and along follow from their shape
    cell : hexahedron
    order : 1 or 2, degree of the geometry
    height : along z
    """
    check_cell("tubes", cell, 3, order)
    if cell != "hexahedron":
        raise ValueError(f"mesh 'tubes': cell '{cell}'; allowed: hexahedron")
    large, middle, small = radii
    if not large > middle > small > 0:
        raise ValueError(f"mesh 'tubes': radii {tuple(radii)}; expected three decreasing positive numbers")
    facets = {}
    with gmsh_model("tubes"):
        for name, low, high, around in (("outer", middle, large, n), ("inner", small, middle, round(1.4 * n) + 1)):
            grid = _tube(low, high, around, order)
            grid = sweep(grid, max(1, round(height * around / (0.5 * np.pi * high))), upright(height), "front", "back")
            tag, sides = add(grid)
            group(3, name, [tag])
            far, close = ("skin", "inner_skin") if name == "outer" else ("outer_skin", "skin")
            group(2, f"{name}_{far}", [sides["far"]])
            group(2, f"{name}_{close}", [sides["close"]])
            for key, side in (("x", "side_x"), ("y", "side_y"), ("z", "front"), ("z", "back")):
                facets.setdefault(f"symmetry_{key}", []).append(sides[side])
        for name, tags in facets.items():
            group(2, name, tags)
        return write(path)


def _tube(low: float, high: float, around: int, order: int):
    """Quadrilaterals of a quarter of a ring, its sides named."""
    across = max(1, round((high - low) * around / (0.25 * np.pi * (low + high))))
    r = np.linspace(low, high, order * across + 1)[:, None]
    t = 0.5 * np.pi * np.linspace(0.0, 1.0, order * around + 1)
    c, s = np.cos(t), np.sin(t)
    c[-1] = s[0] = 0.0
    grid = lattice(np.stack([r * c, r * s, np.zeros((len(r), len(t)))], axis=-1), order, "quadrilateral")
    mean = 0.5 * (low + high)
    return name_boundary(
        grid,
        side_x=near(0, 0.0),
        side_y=near(1, 0.0),
        close=lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < mean,
        far=lambda x: np.hypot(x[..., 0], x[..., 1]).min(axis=1) > mean,
    )
