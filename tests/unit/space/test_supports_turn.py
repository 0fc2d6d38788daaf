"""Supports that turn: places, moments, agreement with others, refusals."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Displacement
from pcontact.space.supports import Supports, Turn, moments
from tests.support.small import make_space

SELF = MPI.COMM_SELF


def rotation(axis, angle):
    """Rodrigues' rotation in plain words: what is along the axis stays, the rest turns."""
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    along = np.outer(axis, axis)
    return along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * np.cross(axis, np.eye(3)).T


@pytest.mark.parametrize("axis", [[0, 0, 2], [1, -2, 0.5], [0, 1, 0]])
def test_turn_in_space(axis):
    points, centre = np.random.default_rng(1).normal(size=(7, 3)), np.array([0.3, -0.2, 1.0])
    turn = Turn(centre, axis, 2.0)
    for factor in (0.0, 0.4, -1.0, 3.0):
        places = points + turn.displacement(points, factor)
        q = rotation(axis, 2.0 * factor)
        assert np.allclose(q @ q.T, np.eye(3)) and np.linalg.det(q) == pytest.approx(1.0)
        np.testing.assert_allclose(places, centre + (points - centre) @ q.T, atol=1e-14)


def test_turn_is_counterclockwise():
    np.testing.assert_allclose(Turn([1, 1], None, np.pi / 2).displacement(np.array([[2.0, 1.0]]), 1.0), [[-1, 1]])
    x = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(Turn([0, 0, 0], [0, 0, 3], np.pi / 2).displacement(x, 1.0), [[-1, 1, 0]])


def test_small_turns_keep_their_digits():
    moved = Turn([0.0, 0.0], None, 1e-9).displacement(np.array([[1.0, 0.0]]), 1.0)[0]
    np.testing.assert_allclose(moved, [-0.5e-18, 1e-9], rtol=1e-15)


@pytest.mark.parametrize("dim", [2, 3])
def test_moments(dim):
    rng = np.random.default_rng(2)
    arms, forces = rng.normal(size=(2, 5, dim))
    full = [np.cross(np.pad(a, (0, 3 - dim)), np.pad(f, (0, 3 - dim))) for a, f in zip(arms, forces, strict=True)]
    np.testing.assert_allclose(moments(arms, forces), np.sum(full, axis=0)[2 if dim == 2 else slice(None)])


@pytest.fixture
def supports(tmp_path):
    """Makes the supports of a unit box from displacements."""
    def make(dim, *displacements):
        path = one_block(tmp_path / "block.msh", dim, 2)
        space = make_space(SELF, path, ["block"])
        return space, Supports(space, displacements, [amplitude(one.amplitude, 1.0) for one in displacements])

    return make


def test_values_are_those_of_the_time(supports):
    """Angle and translation have the factor, not the displacement."""
    ramp = [(0, 0), (1, 2)]
    space, held = supports(2, Displacement("bottom", [0.1, -0.2], ramp, angle=30.0, point=[0.5, 0.0]))
    nodes = held.nodes[0]
    for time in (0.25, 1.0):
        a = np.radians(60.0 * time)
        q = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        expected = (space.points[nodes] - [0.5, 0.0]) @ (q - np.eye(2)).T + 2.0 * time * np.array([0.1, -0.2])
        np.testing.assert_allclose(held.values(time)[nodes], expected, atol=1e-15)
    assert held.turned(0.25, 0.5) == pytest.approx(np.radians(15.0))
    assert held.largest_turn(0) == pytest.approx(np.radians(60.0))
    assert not np.delete(held.values(1.0), nodes, axis=0).any()


def test_a_direction_along_the_axis_may_be_free(supports):
    _, held = supports(3, Displacement("top", [0, 0, "free"], angle=90.0, point=[0.5, 0.5, 1], axis=[0, 0, -1]))
    assert held.fixed[held.nodes[0], :2].all() and not held.fixed[:, 2].any()
    assert not held.values(1.0)[:, 2].any()


def test_supports_that_turn_alike_may_meet(supports):
    one = Displacement("bottom", [0, 0], angle=70.0, point=[0.2, 0.1])
    two = Displacement("left", [0, 0], angle=70.0, point=[0.2, 0.1])
    supports(2, one, two)
    # a node in the centre of a turn stands still
    supports(2, Displacement("bottom", [0, 0]), Displacement("left", [0, 0], angle=10.0, point=[0, 0]))
    three = Displacement("left", [0, 0], angle=70.0, point=[0.2, 0.2])
    for other in (three, Displacement("left", [0, 0])):
        with pytest.raises(InputError) as caught:
            supports(2, one, other)
        assert "displacements[1] (left).value" in str(caught.value) and "70 degrees" in str(caught.value)
