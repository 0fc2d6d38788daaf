"""Obstacles that move and turn: distances, what they carry along, moments."""

import numpy as np
import pytest

from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Obstacle

TURN = {"angle": 70.0, "displacement": [0.3, -0.2, 0.5]}
AXIS = {"pivot": [0.2, 0.1, -0.4], "turn_axis": [1.0, 2.0, -0.5]}
SHAPES = [
    Obstacle("plane", point=[0.1, 0.2, 0.3], normal=[1, -2, 0.5], **TURN, **AXIS),
    Obstacle("plane", point=[0.1, 0.2, 0.3], normal=[1, -2, 0.5], **TURN, turn_axis=[0, 0, 3]),
    Obstacle("sphere", center=[0.1, 0.2, 0.3], radius=0.7, inside=True, **TURN, **AXIS),
    Obstacle("cylinder", point=[0.1, 0.2, 0.3], axis=[1, 1, 2], radius=0.7, **TURN, **AXIS),
    Obstacle("cylinder", point=[0.1, 0.2, 0.3], axis=[1, 1, 2], radius=0.7, **TURN),
    Obstacle("level_set", expression="x**2 - y", **TURN, **AXIS),
]
SHAPES_2D = [
    Obstacle("plane", point=[0.1, 0.2], normal=[1, -2], angle=-50.0),
    Obstacle("sphere", center=[0.1, 0.2], radius=0.7, angle=120.0, pivot=[-1, 0.5], displacement=[1, 2]),
]


def made(obstacle):
    def parabola(x, time):
        return x[:, 0] ** 2 - x[:, 1]

    def slope(x, time):
        return np.column_stack([2.0 * x[:, 0], -np.ones(len(x)), np.zeros(len(x))])

    return RigidObstacle(obstacle, amplitude([(0, 0), (1, 1), (2, 0.5)], 2.0), 1.0, (parabola, slope))


def rotation(angle, axis):
    """Exponential of the cross product by its series."""
    if axis is None:
        across = np.array([[0.0, -1.0], [1.0, 0.0]])
    else:
        across = np.cross(np.eye(3), np.asarray(axis) / np.linalg.norm(axis))
    result, term = np.eye(len(across)), np.eye(len(across))
    for k in range(1, 40):
        term = term @ across * (np.radians(angle) / k)
        result = result + term
    return result


def motion(obstacle, factor):
    """Rotation and centres (before, after) of an obstacle at a factor."""
    d = len(obstacle.displacement or [0, 0])
    axis = obstacle.axis if obstacle.turn_axis is None else obstacle.turn_axis
    place = obstacle.center if obstacle.shape == "sphere" else obstacle.point
    pivot = np.array(place if obstacle.pivot is None else obstacle.pivot, dtype=float)
    shift = np.array(obstacle.displacement or [0] * d, dtype=float)
    return rotation(obstacle.angle * factor, axis), pivot, pivot + factor * shift


@pytest.mark.parametrize("obstacle", SHAPES + SHAPES_2D)
def test_turned_points_see_what_the_others_saw(obstacle):
    """Distance and normal of places that go along with the obstacle; what it carries them in a load step."""
    rigid, rng = made(obstacle), np.random.default_rng(3)
    q, before, after = motion(obstacle, 0.5)
    origin = rng.normal(size=len(before))
    x = rng.normal(size=(20, len(before)))
    gap, normal = rigid.gap(x, 0.0)
    there = (x - before) @ q.T + after
    for time in (0.5, 2.0):
        moved, turned = rigid.gap(there - origin, time, origin)
        np.testing.assert_allclose(moved, gap, atol=1e-13)
        np.testing.assert_allclose(turned, normal @ q.T, atol=1e-13)
    np.testing.assert_allclose(there + rigid.moved(there - origin, 0.5, 1.5, origin), carried(obstacle, x, 0.75),
                               atol=1e-13)  # fmt: skip
    np.testing.assert_allclose(rigid.pivot(0.5), after, atol=1e-14)
    np.testing.assert_allclose(rigid.turned(normal @ q.T, 0.5, 0.0), normal, atol=1e-14)
    assert rigid.angle(0.5, 1.5) == pytest.approx(np.radians(0.25 * obstacle.angle))


def carried(obstacle, x, factor):
    q, before, after = motion(obstacle, factor)
    return (x - before) @ q.T + after


def test_small_turns_lose_no_digits():
    """A plane far from the model's origin that turns by a millionth of a millionth."""
    obstacle = Obstacle("plane", point=[1e3, 1e3], normal=[0, 1], angle=np.degrees(1e-12))
    rigid = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0)
    gap, normal = rigid.gap(np.array([[0.5, 0.0]]), 1.0, np.array([1e3, 1e3]))
    assert gap[0] == pytest.approx(-0.5e-12, rel=1e-12) and normal[0, 0] == pytest.approx(1e-12, rel=1e-12)


def test_normals_of_a_level_set_without_gradient():
    """To a few rounding errors over the step of the differences, as far as that of a sphere half the model's size."""
    def sphere(x, time):
        return np.linalg.norm(x - 0.1, axis=1) - 0.5

    x = 0.1 + np.random.default_rng(1).standard_normal((200, 3))
    obstacle = RigidObstacle(Obstacle("level_set", expression="x"), amplitude(None, 1.0), 1.0, (sphere, None))
    _, normal = obstacle.gap(x, 0.0)
    away = (x - 0.1) / np.linalg.norm(x - 0.1, axis=1, keepdims=True)
    assert np.abs(normal + away).max() < 1e-11
