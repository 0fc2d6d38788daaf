"""Singular points: their powers are told by two meshes, and cells become smaller toward them."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes.blocks import one_block
from pcontact.adapt.singularities import Corners, PressureError, around_vertices
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.refinement.refine import refine
from pcontact.mesh.refinement.simplices import WISHED
from pcontact.runtime.petsc import MPI
from pcontact.space.space import Space

COMM = MPI.COMM_WORLD
POWER, SMOOTH = 1.0, 6.0


def cells(mesh):
    """Sizes of cells, and distances of their farthest vertices to the corner at the origin."""
    x = np.concatenate([mesh.points[block.nodes[:, :3]] for block in mesh.blocks])
    return np.sqrt(np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))), np.linalg.norm(x, axis=2).max(axis=1)


def squares(mesh, power=POWER):
    """Squared estimates of degree 2 of a displacement that goes like r^(1/2)."""
    size, distance = cells(mesh)
    return size**SMOOTH * distance ** (power - SMOOTH)


def everywhere(mesh, cuts):
    return np.full(sum(len(block.nodes) for block in mesh.blocks), cuts)


@pytest.mark.parallel
def test_cells_grow_smaller_toward_a_corner(shared_tmp):
    """At the corner alone; sizes go with r^(1 - e / (2 p + d)), so that squares are alike."""
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, 2, "triangle")
    mesh, corners = load_mesh(COMM, path, 2, ["block"], [], lambda mesh: None), Corners(COMM)
    mesh, _ = refine(mesh, everywhere(mesh, 3))
    power, rise, around = corners.look(Space(mesh, 2), squares(mesh))
    assert power is None and rise is None and not corners.explain
    mesh, fields = refine(mesh, everywhere(mesh, 4), around)
    corners.take(fields)
    corners.sought = False
    assert corners.look(Space(mesh, 2), squares(mesh)) == (None, None, ())
    corners.sought = True
    power, rise, _ = corners.look(Space(mesh, 2), squares(mesh))
    assert corners.explain
    found = rise.rise > 0.0
    assert power[found] == pytest.approx(POWER, abs=1e-6) and (power[~found] == SMOOTH).all()
    assert np.abs(rise.toward[found]).max(initial=0.0) == 0.0
    assert COMM.allreduce(int(found.sum())) in (1, 2)
    mesh, _ = refine(mesh, np.where(found, 6, 0), (), None, rise)
    size, distance = cells(mesh)
    near = distance < COMM.allreduce(float(np.min(distance, initial=np.inf)), op=MPI.MIN) * 8.0
    spread = COMM.allgather(squares(mesh)[near])
    spread = np.concatenate(spread)
    # cuts are by halves: squares of neighbours differ by 2^(2 p + d) per halving of both edges
    assert spread.max() / spread.min() < 2.0**SMOOTH
    assert COMM.allreduce(float(np.min(size, initial=np.inf)), op=MPI.MIN) < 0.25 / 2**8


@pytest.mark.parallel
def test_vertices_in_a_row_are_no_points(shared_tmp):
    """Squares that fall slowly along a whole side, as those of a steep solution on coarse meshes do."""
    path = make_mesh(one_block, shared_tmp / "side.msh", 2, 2, "triangle")
    mesh, corners = load_mesh(COMM, path, 2, ["block"], [], lambda mesh: None), Corners(COMM)

    def along(mesh):
        x = np.concatenate([mesh.points[block.nodes[:, :3]] for block in mesh.blocks])
        return cells(mesh)[0] ** SMOOTH * x[:, :, 0].max(axis=1) ** (POWER - SMOOTH)

    mesh, _ = refine(mesh, everywhere(mesh, 3))
    *_, around = corners.look(Space(mesh, 2), along(mesh))
    mesh, fields = refine(mesh, everywhere(mesh, 4), around)
    corners.take(fields)
    before, now = fields[0], around_vertices(Space(mesh, 2), along(mesh))
    some = (now[:, 2] == before[:, 2]) & (now[:, 0] > 0.0) & (mesh.points[:, 0] == 0.0)
    fallen = np.log(before[some, 0] / now[some, 0]) / np.log(before[some, 1] / now[some, 1])
    assert fallen == pytest.approx(POWER)
    power, rise, _ = corners.look(Space(mesh, 2), along(mesh))
    assert (power == SMOOTH).all() and (rise.rise == 0.0).all() and not corners.explain


@pytest.mark.parallel
@pytest.mark.parametrize("power", [1.5, 1.0])
def test_what_no_mesh_takes_from_a_pressure(power, shared_tmp):
    """At a corner on the contact cells are graded for the square of the pressure, which falls with the power of the
    energy less one; told ahead is what the smallest cells leave, all of it where that power is 0."""
    path = make_mesh(one_block, shared_tmp / "block.msh", 2, 2, "triangle")
    mesh, corners = load_mesh(COMM, path, 2, ["block"], [], lambda mesh: None), Corners(COMM)

    def own(mesh):
        return 0.01 * squares(mesh, power) / cells(mesh)[0]

    mesh, _ = refine(mesh, everywhere(mesh, 2))
    space = Space(mesh, 2)
    *_, around = corners.look(space, squares(mesh, power), True, PressureError.of(space, own(mesh), ["bottom"]))
    assert corners.wall is None
    mesh, fields = refine(mesh, everywhere(mesh, 10), around)
    corners.take(fields)
    space = Space(mesh, 2)
    pressure = PressureError.of(space, own(mesh), ["bottom"])
    corner = np.abs(mesh.points[pressure.ends] - [0.5, 0.0])
    assert corner == pytest.approx(np.tile([0.5, 0.0], (len(corner), 1))) and COMM.allreduce(len(corner)) >= 2
    falls, rise, _ = corners.look(space, squares(mesh, power), True, pressure)
    found = rise.rise > 0.0
    assert falls[found] == pytest.approx(max(power - 1.0, 0.1), abs=1e-6)
    size, distance = cells(mesh)
    near = distance < 2.0 * COMM.allreduce(float(np.min(distance, initial=np.inf)), op=MPI.MIN)
    square = COMM.allreduce(float(own(mesh)[near & found].sum()), op=MPI.SUM)
    left = np.sqrt(square * 2.0 ** (-(power - 1.0) * (WISHED - 12) / 2))
    assert corners.wall.point == (0.0, 0.0) and corners.wall.power == pytest.approx(0.5 * power - 1.0)
    assert corners.wall.left == pytest.approx(left)
    pressure = PressureError.of(space, own(mesh), ["top"])
    assert (corners.look(space, squares(mesh, power), True, pressure)[0][found] == pytest.approx(power))
    assert corners.wall is None
