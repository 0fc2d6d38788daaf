"""The mass of the bodies against integrals that are known."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.assembly.mass import Mass
from pcontact.mesh.distribute import load_mesh
from pcontact.runtime.petsc import MPI
from pcontact.space.space import Space

WORLD = MPI.COMM_WORLD
CELLS = [(2, "quadrilateral"), (2, "triangle"), (3, "hexahedron"), (3, "tetrahedron")]


def space_of(folder, dim, cell, order, kinematics="plane_strain"):
    path = folder / "block.msh"
    if WORLD.rank == 0:
        one_block(path, dim, 3, cell, order=order, lower=(1.0,) + (0.0,) * (dim - 1))
    WORLD.Barrier()
    return Space(load_mesh(WORLD, path, order, ["block"], [], lambda mesh: None), order, kinematics)


def total(space, values):
    return space.comm.allreduce(float(np.sum(values)), op=MPI.SUM)


@pytest.mark.parallel
@pytest.mark.parametrize("lumped", [False, True])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("dim", "cell"), CELLS)
def test_momentum_and_energy_of_a_block(shared_tmp, dim, cell, order, lumped):
    """Of the unit block at x = 1 .. 2 with density 3: v = (x, 0, ..)."""
    space = space_of(shared_tmp, dim, cell, order)
    mass = Mass(space, {"block": 3.0}, lumped)
    x = space.points[space.owned_local][:, 0]
    velocity = np.zeros((space.n_owned, dim))
    velocity[:, 0] = x
    momentum = mass.times(velocity)
    assert total(space, momentum[:, 0]) == pytest.approx(3.0 * 1.5, rel=1e-12)
    assert total(space, momentum[:, 1:]) == 0.0
    energy = total(space, momentum * velocity)
    assert energy == pytest.approx(3.0 * 7.0 / 3.0, rel=0.02 if lumped else 1e-12)
    diagonal = mass.times(np.ones((space.n_owned, dim)))
    assert not lumped or diagonal.min() > 0.0
    assert total(space, diagonal) == pytest.approx(3.0 * dim, rel=1e-12)


def test_of_a_ring(shared_tmp):
    """With axial symmetry of the whole circumference."""
    space = space_of(shared_tmp, 2, "quadrilateral", 1, "axisymmetric")
    values = Mass(space, {"block": 2.0}).times(np.ones((space.n_owned, 2)))
    assert total(space, values[:, 1]) == pytest.approx(2.0 * np.pi * (4.0 - 1.0), rel=1e-12)


def test_of_a_region_alone(shared_tmp):
    space = space_of(shared_tmp, 2, "quadrilateral", 1)
    assert not Mass(space, {}).times(np.ones((space.n_owned, 2))).any()
