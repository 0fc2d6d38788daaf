"""Modes of vibrations against closed forms; tied surfaces and those that stick have the same ones, on any ranks."""

import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Dynamics,
    Load,
    Material,
    MeshSpec,
    Output,
    Scene,
    Steps,
)
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
YOUNG, DENSITY = 210e3, 7.8e-9
parallel = pytest.mark.parallel(1, 2)


def frequencies(scene, count):
    simulation = Simulation(scene, WORLD)
    try:
        assert simulation.run()
        squares, shapes = simulation.modes(count)
        free = ~simulation.problem.conditions.fixed
        assert all(not shape[~free].any() for shape in shapes)
        return np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    finally:
        simulation.free()


def mesh(function, path, *args, **more):
    if WORLD.rank == 0:
        function(path, *args, **more)
    WORLD.Barrier()
    return path


@parallel
def test_a_free_beam(shared_tmp):
    """Three rigid motions, and bending: b^2 / L^2 sqrt(E I / rho A), 0.6 % less for shear at a slenderness of 40."""
    length, height = 20.0, 0.5
    path = mesh(one_block, shared_tmp / "beam.msh", 2, (40, 2), size=(length, height), order=2)
    scene = Scene(
        MeshSpec(path, order=2, kinematics="plane_stress"), {"m": Material(YOUNG, 0.3, density=DENSITY)},
        [Body("block", "m")], output=Output(fields=False),
    )  # fmt: skip
    found = frequencies(scene, 5)
    slender = np.sqrt(YOUNG * height**2 / 12.0 / DENSITY) / (2.0 * np.pi * length**2)
    assert np.all(found[:3] == 0.0)
    assert found[3:] == pytest.approx(np.array([4.73004, 7.8532]) ** 2 * slender, rel=0.007)
    assert np.all(found[3:] < np.array([4.73004, 7.8532]) ** 2 * slender)


def stack(folder, order=1, **contact):
    path = mesh(two_blocks, folder / "stack.msh", 2, 4, 3, order=order)
    pair = Contact("upper_bottom", "lower_top", gamma0=2.0, alpha=1.0, **contact)
    return Scene(
        MeshSpec(path, order=order), {"m": Material(YOUNG, 0.3, density=DENSITY)},
        [Body("lower", "m"), Body("upper", "m")], contacts=[pair],
        displacements=[Displacement("lower_bottom", [0.0, 0.0])], loads=[Load("upper_top", pressure=1.0)],
        output=Output(fields=False),
    )  # fmt: skip


@parallel
@pytest.mark.parametrize("theta", [0.0, 1.0])
def test_surfaces_that_stick_are_tied(shared_tmp, theta):
    tied = frequencies(stack(shared_tmp, theta=theta, tied=True), 6)
    stuck = frequencies(stack(shared_tmp, theta=theta, friction=0.5), 6)
    assert stuck == pytest.approx(tied, rel=1e-6)
    sliding = frequencies(stack(shared_tmp, theta=theta), 6)
    # without friction the upper block moves freely along the lower one
    assert sliding[0] < 1e-4 * tied[0] and sliding[0] < tied[0]


def test_after_a_motion(shared_tmp):
    """Inertia has no part in the stiffness of small motions."""
    path = mesh(one_block, shared_tmp / "rod.msh", 2, (20, 1))
    supports = [Displacement("left", [0.0, "free"])] + [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)},
        [Body("block", "m", initial_velocity=["0.01*x", 0.0])], displacements=supports, steps=Steps(0.3, 3),
        output=Output(fields=False), dynamics=Dynamics(),
    )  # fmt: skip
    assert frequencies(scene, 1) == pytest.approx([0.25], rel=0.001)


def test_no_more_modes_than_unknowns(shared_tmp):
    path = mesh(one_block, shared_tmp / "one.msh", 2, 1)
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)}, [Body("block", "m")],
        displacements=[Displacement("bottom", [0.0, 0.0])], output=Output(fields=False),
    )  # fmt: skip
    assert len(frequencies(scene, 10)) == 4
