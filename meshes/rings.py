"""Two concentric rings whose meshes do not match on the circle they share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gmsh
import numpy as np

from .tools import ALIGNED, check_cell, check_choice, generate, gmsh_model, group, move_nodes, write


class _Ring:
    """A ring of `sectors` quarters: radial lines, arcs and faces by quarter, with a structured mesh."""

    def __init__(self, small: float, large: float, around: int, across: int, sectors: int, cell: str):
        geo = gmsh.model.geo
        self.small, self.large, self.around, self.across = small, large, around, across
        angles = 0.5 * np.pi * np.arange(sectors if sectors == 4 else sectors + 1)
        centre = geo.addPoint(0.0, 0.0, 0.0)
        inside = [geo.addPoint(small * np.cos(t), small * np.sin(t), 0.0) for t in angles]
        outside = [geo.addPoint(large * np.cos(t), large * np.sin(t), 0.0) for t in angles]
        n = len(angles)
        self.radial = [geo.addLine(a, b) for a, b in zip(inside, outside, strict=True)]
        self.hole = [geo.addCircleArc(inside[k], centre, inside[(k + 1) % n]) for k in range(sectors)]
        self.skin = [geo.addCircleArc(outside[k], centre, outside[(k + 1) % n]) for k in range(sectors)]
        self.faces = []
        for k in range(sectors):
            loop = geo.addCurveLoop([self.radial[k], self.skin[k], -self.radial[(k + 1) % n], -self.hole[k]])
            self.faces.append(geo.addPlaneSurface([loop]))
        # Set in the drawing, not in the model: drawing the next ring would forget it.
        for curve in self.radial:
            geo.mesh.setTransfiniteCurve(curve, across + 1)
        for curve in self.hole + self.skin:
            geo.mesh.setTransfiniteCurve(curve, around + 1)
        for face in self.faces:
            geo.mesh.setTransfiniteSurface(face)
            if cell in ALIGNED:
                geo.mesh.setRecombine(2, face)
        geo.synchronize()

    def snap(self, points: np.ndarray) -> np.ndarray:
        """Put points (n, 3) of this ring on its polar grid, twice as fine as its cells."""
        step_r, step_t = 0.5 * (self.large - self.small) / self.across, 0.25 * np.pi / self.around
        radius = np.hypot(points[:, 0], points[:, 1])
        i = np.clip(np.round((radius - self.small) / step_r), 0, 2 * self.across)
        t = step_t * np.round(np.arctan2(points[:, 1], points[:, 0]) / step_t)
        r = self.small + step_r * i
        # Exact zeros on the axes, where cos and sin leave round-off.
        x, y = r * np.cos(t), r * np.sin(t)
        return np.column_stack(
            [np.where(abs(x) < 1e-14 * r, 0.0, x), np.where(abs(y) < 1e-14 * r, 0.0, y), np.zeros(len(r))]
        )


def _snap_rings(inner: _Ring, outer: _Ring) -> None:
    """Give every node of the two rings its place on the polar grid of its own ring."""
    owner = {}
    for ring in (inner, outer):
        bodies = [(2, face) for face in ring.faces]
        curves = gmsh.model.getBoundary(bodies, combined=False, oriented=False)
        points = gmsh.model.getBoundary(curves, combined=False, oriented=False)
        owner.update({entity: ring for entity in (*bodies, *curves, *points)})
    move_nodes(lambda x, entity: owner[entity].snap(x) if entity in owner else x)


def _name_axes(inner: _Ring, outer: _Ring, symmetry: str) -> None:
    """Groups of the radial lines: the symmetry lines of a quarter, or the axes of whole rings."""
    if symmetry == "quarter":
        group(1, "symmetry_y", [inner.radial[0], outer.radial[0]])
        group(1, "symmetry_x", [inner.radial[1], outer.radial[1]])
        return
    for name, ring in (("outer", outer), ("inner", inner)):
        group(1, f"{name}_axis_y", ring.radial[0::2])
        group(1, f"{name}_axis_x", ring.radial[1::2])


def rings(
    path: str | Path,
    radii: Sequence[float] = (1.0, 0.6, 0.2),
    n: int = 8,
    cell: str = "quadrilateral",
    *,
    order: int = 1,
    symmetry: str = "quarter",
    mismatch: float = 1.4,
    delta: float = 0.0,
) -> Path:
    """Two concentric rings, the inner one in the hole of the outer one; structured meshes that do not match.

    Groups: outer, inner; outer_skin (the outermost circle), outer_inner_skin (the hole of the outer ring),
    inner_outer_skin (the outer circle of the inner ring), inner_skin (its hole). Quarter: symmetry_x (both
    rings on x = 0, where u_x = 0), symmetry_y (on y = 0). Whole rings: outer_axis_x, inner_axis_x (lines
    inside the rings on x = 0), outer_axis_y, inner_axis_y (on y = 0). With order 2 every circle of the mesh
    is curved: all nodes lie on a polar grid.

    Parameters
    ----------
    path : file to write
    radii : outer radius, radius of the contact circle, radius of the hole
    n : cells of the outer ring around a quarter; cells across follow from their shape
    cell : quadrilateral or triangle
    order : 1 or 2, degree of the geometry
    symmetry : "quarter" (x >= 0, y >= 0) or "none" (whole rings)
    mismatch : cells of the inner ring around a quarter, in units of n (rounded, and never equal to n unless
        mismatch = 1)
    delta : interference: the outer radius of the inner ring is radii[1] + delta (both circles keep their
        own radius in the mesh)
    """
    check_cell("rings", cell, 2, order)
    check_choice("rings", "symmetry", symmetry, ("quarter", "none"))
    large, middle, small = radii
    if not large > middle > small > 0:
        raise ValueError(f"mesh 'rings': radii {tuple(radii)}; expected three decreasing positive numbers")
    n_inner = max(1, round(mismatch * n))
    if mismatch != 1 and n_inner % n == 0:
        n_inner += 1
    across = [
        max(1, round((b - a) * count / (0.25 * np.pi * (a + b))))
        for a, b, count in ((small, middle, n_inner), (middle, large, n))
    ]
    sectors = {"quarter": 1, "none": 4}[symmetry]
    with gmsh_model("rings"):
        inner = _Ring(small, middle + delta, n_inner, across[0], sectors, cell)
        outer = _Ring(middle, large, n, across[1], sectors, cell)
        for name, ring in (("outer", outer), ("inner", inner)):
            group(2, name, ring.faces)
        for name, curves in (
            ("outer_skin", outer.skin),
            ("outer_inner_skin", outer.hole),
            ("inner_outer_skin", inner.skin),
            ("inner_skin", inner.hole),
        ):
            group(1, name, curves)
        _name_axes(inner, outer, symmetry)
        generate(2, order)
        _snap_rings(inner, outer)
        return write(path)
