"""The item of inertia by itself: integrators against a spring whose motion is known, its tangent, its state."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.assembly.inertia import Inertia
from pcontact.assembly.mass import Mass
from pcontact.mesh.distribute import load_mesh
from pcontact.runtime.petsc import MPI
from pcontact.scene.integrators import INTEGRATORS
from pcontact.space.space import Space

SELF = MPI.COMM_SELF


@pytest.fixture
def space(tmp_path):
    one_block(tmp_path / "block.msh", 2, 2)
    return Space(load_mesh(SELF, tmp_path / "block.msh", 1, ["block"], [], lambda mesh: None), 1)


def item(space, name, damping=None):
    mass, row = Mass(space, {"block": 2.0}), INTEGRATORS[name]
    weights = row.weights(row.alpha)
    return Inertia(space, mass, None if damping is None else damping * mass.values, weights, None)


def vector(space, values):
    u = space.vector()
    u.setArray(values.ravel())
    return u


@pytest.mark.parametrize(("name", "order"), [("hht", 2), ("bossak", 2), ("trapezoidal", 2), ("euler", 1)])
def test_order_of_an_integrator(space, name, order):
    """All nodes on springs of the stiffness w^2 M: each step solved in closed form through residual and tangent."""
    frequency, errors = 2.0, []
    for count in (20, 40):
        inertia, size = item(space, name), 1.0 / count
        mass, u = inertia.mass, vector(space, np.ones((space.n_owned, 2)))
        inertia.acceleration = -(frequency**2) * np.ones((space.n_owned, 2))
        inertia.force = mass.times(inertia.acceleration)
        factor = None
        for step in range(count):
            inertia.detect(u, (step + 1) * size)
            # uniform motions stay uniform: tangent and spring are multiples of the mass
            factor = inertia.tangent(u)[0, 0, 0] / mass.values[0, 0, 0]
            out = np.zeros((space.n_owned, 2))
            inertia.residual(u, out)
            out += frequency**2 * mass.times(u.getArray().reshape(-1, 2))
            row = mass.times(np.ones_like(out))
            u.setArray((u.getArray().reshape(-1, 2) - out / row / (factor + frequency**2)).ravel())
            inertia.commit(u, (step + 1) * size)
        errors.append(abs(u.getArray()[0] - np.cos(frequency)))
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.15)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_tangent(space, name):
    inertia, rng = item(space, name, 0.3), np.random.default_rng(3)
    shape = (space.n_owned, 2)
    inertia.velocity, inertia.acceleration, inertia.force = (rng.normal(size=shape) for _ in range(3))
    begin, way = rng.normal(size=shape), rng.normal(size=shape)
    inertia.detect(vector(space, begin), 0.1)
    low, high = np.zeros(shape), np.zeros(shape)
    inertia.residual(vector(space, begin), low)
    inertia.residual(vector(space, begin + way), high)
    expected = inertia.mass.times(way, inertia.tangent(None))
    np.testing.assert_allclose(high - low, expected, atol=1e-11 * np.abs(expected).max())
    drag = np.zeros(shape)
    inertia.drag(vector(space, begin), drag)
    np.testing.assert_array_equal(drag, -low)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_forces_are_those_of_the_state_between_steps(space, name):
    """What the item adds at the end of a step is what it adds after that, until the next one begins."""
    inertia, rng = item(space, name, 0.3), np.random.default_rng(3)
    shape = (space.n_owned, 2)
    inertia.velocity = rng.normal(size=shape)
    u = vector(space, rng.normal(size=shape))
    inertia.detect(space.vector(), 0.1)
    before, after = np.zeros(shape), np.zeros(shape)
    inertia.residual(u, before)
    inertia.commit(u, 0.1)
    inertia.residual(u, after)
    np.testing.assert_allclose(after, before, rtol=1e-13)
    memory = inertia.memory()
    again = item(space, name, 0.3)
    assert all(again.recall(key, [rows]) == space.n_owned for key, rows in memory.items()) and again.begun
    np.testing.assert_array_equal(again.velocity, inertia.velocity)
    assert again.recall("other", []) is None
    assert again.kinetic() == pytest.approx(0.5 * np.sum(inertia.mass.times(inertia.velocity) * inertia.velocity))
