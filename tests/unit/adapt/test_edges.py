"""Singular edges in space: told by two meshes, and cells that touch them become as small as they have to at once."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes.blocks import one_block
from pcontact.adapt.mark import Contributions, cuts
from pcontact.adapt.singularities import Corners
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.refinement.refine import refine
from pcontact.runtime.petsc import MPI
from pcontact.space.space import Space

COMM = MPI.COMM_WORLD
POWER, SMOOTH = 2.2, 7.0


def cells(mesh):
    """Sizes of cells, and distances of their vertices to the edge x = y = 0."""
    x = np.concatenate([mesh.points[block.nodes[:, :4]] for block in mesh.blocks])
    return np.cbrt(np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))), np.linalg.norm(x[:, :, :2], axis=2)


def squares(mesh, power=POWER):
    """Squared estimates of degree 2 of a displacement that goes like r^0.6, those beside the edge small as they are."""
    size, distance = cells(mesh)
    far = np.where((distance == 0.0).any(axis=1), 1.0, 0.01) * distance.max(axis=1) ** (power - SMOOTH)
    return size**SMOOTH * far


def everywhere(mesh, number):
    return np.full(sum(len(block.nodes) for block in mesh.blocks), number)


def total(values):
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def two_meshes(folder, of):
    """Space of a block of tetrahedra that has been refined twice, and its edges after that."""
    path = make_mesh(one_block, folder / "block.msh", 3, 2, "tetrahedron")
    mesh, corners = load_mesh(COMM, path, 2, ["block"], [], lambda mesh: None), Corners(COMM)
    power, rise, around = corners.look(Space(mesh, 2), of(mesh))
    assert power is None and rise is None and corners.edges is None and not corners.explain
    mesh, fields = refine(mesh, everywhere(mesh, 3), around)
    corners.take(fields)
    space = Space(mesh, 2)
    return space, corners, corners.look(space, of(mesh))


@pytest.mark.parallel
def test_cells_that_touch_an_edge_become_small_at_once(shared_tmp):
    """The edge alone is found, with its power; a mesh with a quarter of the error has as much as expected, and as many
    cells, but for those that follow."""
    space, corners, (power, rise, _) = two_meshes(shared_tmp, squares)
    mesh, own = space.mesh, squares(space.mesh)
    size, distance = cells(mesh)
    on, edges = distance == 0.0, corners.edges
    assert corners.explain and (edges.touches == np.minimum(on.sum(axis=1), 2)).all() and (edges.on == on).all()
    assert power[on.any(axis=1)] == pytest.approx(POWER, rel=0.1) and (power[~on.any(axis=1)] == SMOOTH).all()
    some = edges.touches == 2
    assert (rise.toward[some, :2] == 0.0).all() and (np.abs(rise.along[some, 2]) == 0.25).all()
    errors = Contributions(own, 2, 3, power=power, level=mesh.origin.level, touches=edges.touches,
                           shared=edges.shared(space, own))  # fmt: skip
    step = cuts(COMM, errors, 0.25)
    planned = (size * 2.0 ** (-(step.deep + step.more) / 3.0))[some]
    planned = COMM.allreduce(float(np.min(planned, initial=np.inf)), op=MPI.MIN)
    finer, _ = refine(mesh, step.more, (), None, rise._replace(most=step.deep, within=rise.within * step.within))
    size, distance = cells(finer)
    touching = (distance == 0.0).sum(axis=1) == 2
    smallest = COMM.allreduce(float(np.min(size[touching], initial=np.inf)), op=MPI.MIN)
    largest = COMM.allreduce(float(np.max(size[touching], initial=0.0)), op=MPI.MAX)
    assert 0.6 < smallest / planned < 1.3 and largest < 2.0 * smallest < 0.1
    left = np.sqrt(total(squares(finer)) / total(own))
    assert step.part <= 0.26 and 0.5 * step.part < left < 1.3 * step.part
    assert 1.0 < total(np.ones(len(size))) / total(np.ones(len(own))) / step.growth < 2.5
    far = COMM.allreduce(float(np.max(size[distance.min(axis=1) > 0.5], initial=0.0)), op=MPI.MAX)
    assert far > 8.0 * smallest


@pytest.mark.parallel
@pytest.mark.parametrize("power", [SMOOTH, 3.5])
def test_where_squares_fall_fast_there_is_no_edge(power, shared_tmp):
    _, corners, (of_cells, rise, around) = two_meshes(shared_tmp, lambda mesh: squares(mesh, power))
    assert of_cells is None and rise is None and corners.edges is None and not corners.explain
    assert len(around) == 1 and (around[0][:, 3] == 0.0).all()


@pytest.mark.parallel
def test_an_edge_that_has_little_of_the_error(shared_tmp):
    """It is not cut for, and may be on the next mesh."""

    def of(mesh):
        _, distance = cells(mesh)
        return squares(mesh) * np.where((distance == 0.0).any(axis=1), 1.0, 1e4)

    _, corners, (of_cells, rise, around) = two_meshes(shared_tmp, of)
    assert of_cells is None and rise is None and corners.edges is None and not corners.explain
    assert COMM.allreduce(float(np.max(around[0][:, 3])), op=MPI.MAX) >= 2.0
