"""A heap of disks, rings or balls in a box: layers in which every body rests on the ones below it."""

from __future__ import annotations

from itertools import count as counting
from pathlib import Path

import gmsh
import numpy as np

from .tools import check_cell, finish, gmsh_model, group, unstructured

# bodies have the radius 1
RADIUS = 1.0


def layers(dim: int, count: int, overlap: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, dim) of at least `count` bodies in full layers, and the size (dim,) of the box around them.

    In the plane rows of n and n - 1 disks take turns, in space squares of n^2 and (n - 1)^2 balls. Neighbours overlap
    by `overlap` diameters, floor and walls by half of that; the box has its corner at the origin.
    """
    n = max(2, round(count ** (1 / dim)))
    step = 2.0 * RADIUS * (1.0 - overlap)
    # in the plane a body rests on two, in space on four: this high above them
    rise = step * (np.sqrt(3.0) / 2.0 if dim == 2 else np.sqrt(0.5))
    found: list[np.ndarray] = []
    for layer in counting():
        if sum(map(len, found)) >= count:
            break
        short = layer % 2
        line = step * (0.5 + 0.5 * short + np.arange(n - short))
        level = np.stack(np.meshgrid(*[line] * (dim - 1), indexing="ij"), axis=-1).reshape(-1, dim - 1)
        found.append(np.column_stack([level, np.full(len(level), 0.5 * step + layer * rise)]))
    centres = np.concatenate(found)
    return centres, np.array([*[n * step] * (dim - 1), centres[-1, -1] + 0.5 * step])


def _circle(centre: np.ndarray, radius: float) -> list[int]:
    """Twelve arcs, so that places of contact are nodes."""
    geo = gmsh.model.geo
    middle = geo.addPoint(*centre, 0.0)
    angles = np.pi / 6.0 * np.arange(12)
    ends = [geo.addPoint(*(centre + radius * np.array([np.cos(a), np.sin(a)])), 0.0) for a in angles]
    return [geo.addCircleArc(ends[k], middle, ends[(k + 1) % 12]) for k in range(12)]


def _disk(centre: np.ndarray, hollow: float) -> tuple[int, list[int]]:
    """Face and outer curves of a disk or ring."""
    geo = gmsh.model.geo
    skin = _circle(centre, RADIUS)
    loops = [geo.addCurveLoop(skin)]
    if hollow:
        loops.append(geo.addCurveLoop(_circle(centre, hollow * RADIUS)))
    return geo.addPlaneSurface(loops), skin


def _ball(centre: np.ndarray) -> tuple[int, list[int]]:
    """Volume and faces of a ball: eighths of a sphere."""
    geo = gmsh.model.geo
    middle = geo.addPoint(*centre)
    poles = [geo.addPoint(*(centre + sign * RADIUS * np.eye(3)[axis])) for axis in range(3) for sign in (1, -1)]
    arcs = {}
    for a in range(6):
        for b in range(a + 1, 6):
            if a // 2 != b // 2:
                arcs[a, b] = geo.addCircleArc(poles[a], middle, poles[b])
    faces = []
    for x in (0, 1):
        for y in (2, 3):
            for z in (4, 5):
                loop = [arcs[x, y], arcs[y, z], -arcs[x, z]]
                outward = (x + y + z) % 2 == 0
                loop = loop if outward else [-curve for curve in reversed(loop)]
                faces.append(geo.addSurfaceFilling([geo.addCurveLoop(loop)], sphereCenterTag=middle))
    return geo.addVolume([geo.addSurfaceLoop(faces)]), faces


def heap(
    path: str | Path,
    dim: int = 2,
    count: int = 20,
    h: float = 0.25,
    hollow: float = 0.0,
    cell: str | None = None,
    order: int = 1,
    overlap: float = 0.01,
) -> Path:
    """Disks, rings (2D) or balls (3D) of radius 1 that rest on each other in a box, see `layers`.

    Groups: heap (all bodies, which share no node), skin (their outer boundary).

    Parameters
    ----------
    path : file to write
    dim : 2 or 3
    count : bodies at least; layers are full
    h : size of the cells
    hollow : 2D: inner over outer radius of rings; 0: disks
    cell : triangle or quadrilateral; in space tetrahedron
    order : 1 or 2, degree of the geometry
    overlap : of neighbours, in diameters
    """
    cell = cell or ("triangle" if dim == 2 else "tetrahedron")
    check_cell("heap", cell, dim, order)
    if cell == "hexahedron":
        raise ValueError("mesh 'heap': cell 'hexahedron'; allowed: tetrahedron")
    if count < 1 or not 0.0 <= overlap < 0.2 or not 0.0 <= hollow < 1.0 or not h > 0.0:
        raise ValueError(
            f"mesh 'heap': count {count}, overlap {overlap:g}, hollow {hollow:g}, h {h:g}; allowed: count >= 1, "
            "0 <= overlap < 0.2, 0 <= hollow < 1, h > 0"
        )
    centres, _ = layers(dim, count, overlap)
    with gmsh_model("heap"):
        made = [_disk(c, hollow) if dim == 2 else _ball(c) for c in centres]
        gmsh.model.geo.synchronize()
        group(dim, "heap", [body for body, _ in made])
        group(dim - 1, "skin", [part for _, skin in made for part in skin])
        unstructured(cell)
        gmsh.option.setNumber("Mesh.MeshSizeMin", h)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        return finish(path, dim, order)
