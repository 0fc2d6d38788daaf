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
    Obstacle("punch", point=[0.1, 0.2, 0.3], normal=[1, -2, 0.5], radius=0.7, edge_radius=0.2, **TURN, **AXIS),
    Obstacle("punch", point=[0.1, 0.2, 0.3], normal=[2, 1, 0], axis=[0, 0, 4], width=0.9, **TURN, **AXIS),
    Obstacle("wedge", point=[0.1, 0.2, 0.3], normal=[2, 1, 0], axis=[-1, 2, 0], half_angle=50.0, **TURN, **AXIS),
    Obstacle("cone", point=[0.1, 0.2, 0.3], normal=[1, -2, 0.5], half_angle=70.0, edge_radius=0.3, **TURN, **AXIS),
    Obstacle("torus", center=[0.1, 0.2, 0.3], axis=[1, 1, 2], radius=0.3, ring_radius=0.8, **TURN),
]
SHAPES_2D = [
    Obstacle("plane", point=[0.1, 0.2], normal=[1, -2], angle=-50.0),
    Obstacle("punch", point=[0.1, 0.2], normal=[1, -2], width=0.9, edge_radius=0.3, angle=-50.0),
    Obstacle("wedge", point=[0.1, 0.2], normal=[1, -2], half_angle=35.0, edge_radius=0.3, angle=-50.0),
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
    place = obstacle.point if obstacle.center is None else obstacle.center
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


def outline(obstacle, n=4001):
    """Points of the surface of a shape and its outward normals, by its parameters; n each way (n, 2 or 3)."""
    e, a = obstacle.edge_radius or 0.0, np.radians(obstacle.half_angle or 0.0)
    s = np.linspace(0.0, 1.0, n)
    if obstacle.shape == "torus":
        t = 2.0 * np.pi * s
        return np.column_stack([obstacle.ring_radius + obstacle.radius * np.cos(t), obstacle.radius * np.sin(t)])
    if obstacle.shape == "punch":
        w = obstacle.radius or 0.5 * obstacle.width
        t = 0.5 * np.pi * s
        face = np.column_stack([(w - e) * s, 0.0 * s])
        edge = np.column_stack([w - e + e * np.sin(t), -e + e * np.cos(t)])
        return np.vstack([face, edge, np.column_stack([np.full(n, w), -e - 4.0 * s])])
    t = (0.5 * np.pi - a) * s
    tip = np.column_stack([e * np.sin(t), -e + e * np.cos(t)])
    flank = tip[-1] + 5.0 * s[:, None] * np.array([np.sin(a), -np.cos(a)])
    return np.vstack([tip, flank])


PROFILES = [
    Obstacle("punch", point=[0, 0, 0], normal=[0, 0, 2], radius=0.7, edge_radius=0.2),
    Obstacle("punch", point=[0, 0, 0], normal=[0, 0, 2], radius=0.7),
    Obstacle("punch", point=[0, 0, 0], normal=[0, 0, 2], axis=[0, 3, 0], width=1.4, edge_radius=0.5),
    Obstacle("wedge", point=[0, 0, 0], normal=[0, 0, 2], axis=[0, 3, 0], half_angle=40.0),
    Obstacle("wedge", point=[0, 0, 0], normal=[0, 0, 2], axis=[0, 3, 0], half_angle=70.0, edge_radius=0.4),
    Obstacle("cone", point=[0, 0, 0], normal=[0, 0, 2], half_angle=30.0, edge_radius=0.25),
    Obstacle("cone", point=[0, 0, 0], normal=[0, 0, 2], half_angle=80.0),
    Obstacle("torus", center=[0, 0, 0], axis=[0, 0, 2], radius=0.3, ring_radius=0.8),
    Obstacle("punch", point=[0, 0], normal=[0, 2], width=1.4, edge_radius=0.5),
    Obstacle("wedge", point=[0, 0], normal=[0, 2], half_angle=40.0, edge_radius=0.4),
]


@pytest.mark.parametrize("obstacle", PROFILES, ids=lambda one: f"{one.shape}, {one.edge_radius}")
def test_distance_is_that_from_points_of_the_surface(obstacle):
    """In free space, in all directions around or along the axis."""
    rng, d = np.random.default_rng(2), len(obstacle.center or obstacle.point)
    plane = np.column_stack([rng.uniform(0.0, 1.5, 400), rng.uniform(-0.8, 0.8, 400)])
    surface = outline(obstacle)
    nearest = np.linalg.norm(plane[:, None] - surface[None], axis=2).min(axis=1)
    if d == 2:
        x, along = plane, np.zeros((400, 2))
    elif obstacle.axis is not None and obstacle.shape != "torus":
        x = np.column_stack([plane[:, 0] * rng.choice([-1, 1], 400), rng.normal(size=400), plane[:, 1]])
        along = [0, 1, 0]
    else:
        t = rng.uniform(0.0, 2.0 * np.pi, 400)
        x = np.column_stack([plane[:, 0] * np.cos(t), plane[:, 0] * np.sin(t), plane[:, 1]])
        along = np.column_stack([-np.sin(t), np.cos(t), 0.0 * t])
    gap, normal = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0).gap(x, 0.0)
    free = gap > 0.0
    assert 50 < np.sum(free) < 390
    # the nearest point of the outline is at most half of the widest gap between its points beside the nearest place
    assert np.all(gap[free] <= nearest[free] + 1e-12)
    assert np.max(nearest[free] ** 2 - gap[free] ** 2) <= (0.5 * 5.0 / 4000.0) ** 2
    assert np.abs(np.sum(normal * along, axis=1)).max() < 1e-14
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)
    # the foot of each point is on the surface
    foot = x + gap[:, None] * normal
    again = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0).gap(foot[free], 0.0)[0]
    np.testing.assert_allclose(again, 0.0, atol=1e-14)


@pytest.mark.parametrize("obstacle", PROFILES, ids=lambda one: f"{one.shape}, {one.edge_radius}")
def test_normals_are_slopes_of_the_distance(obstacle):
    rigid, d = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0), len(obstacle.center or obstacle.point)
    x, h = np.random.default_rng(4).uniform(-1.0, 1.0, (300, d)), 1e-6
    ends = [(rigid.gap(x + h * e, 0.0), rigid.gap(x - h * e, 0.0)) for e in np.eye(d)]
    slope = np.column_stack([(ahead[0] - back[0]) / (2.0 * h) for ahead, back in ends])
    smooth = np.all([np.abs(ahead[1] - back[1]).max(axis=1) < 1e-3 for ahead, back in ends], axis=0)
    np.testing.assert_allclose(-rigid.gap(x, 0.0)[1][smooth], slope[smooth], atol=1e-8)
    assert np.sum(smooth) > 290
