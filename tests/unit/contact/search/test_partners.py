"""Partners on obstacles: points that face them, and points behind their middle."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.contact.search.partners import ObstacleSearch
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Obstacle

# all of them reach 0.4 deep into the body below the surface y = 0, from a middle that is below it, too
BAR = Obstacle("sphere", center=[0.0, -0.1], radius=0.3)
TOOLS = [
    BAR,
    Obstacle("punch", point=[0.0, -0.4], normal=[0.0, -1.0], width=0.6, edge_radius=0.1),
    Obstacle("level_set", expression="x**2 + (y + 0.1)**2 - 0.09"),
]


def search_of(obstacle):
    functions = (lambda x, time: x[:, 0] ** 2 + (x[:, 1] + 0.1) ** 2 - 0.09, None)
    return ObstacleSearch(
        SimpleNamespace(comm=MPI.COMM_SELF), RigidObstacle(obstacle, amplitude(None, 1.0), 1.0, functions)
    )


def found(search, x, normal, radius=1.0):
    x = np.asarray(x, dtype=float)
    return search.find(None, x, np.broadcast_to(normal, x.shape).astype(float), 0.0, radius, np.zeros(2))


@pytest.mark.parametrize("tool", TOOLS, ids=[tool.shape for tool in TOOLS])
def test_a_surface_behind_the_middle_of_an_obstacle(tool):
    """It goes into its body, to where the obstacle ends, and sees the plane there until it faces the obstacle."""
    search = search_of(tool)
    partners = found(search, [[0.0, 0.0], [0.1, 0.0], [0.9, 0.0]], [0.0, 1.0])
    assert partners.paired[:2].all()
    assert partners.gap[0] == pytest.approx(-0.4, abs=1e-8)
    ends = np.array([[0.0, -0.4], [0.1, 0.0] + partners.gap[1] / partners.normal[1, 1] * np.array([0.0, 1.0])])
    gap, normal = search.distance(ends, 0.0, np.zeros(2))
    np.testing.assert_allclose(gap, 0.0, atol=1e-7)
    np.testing.assert_allclose(partners.normal[:2], normal, atol=1e-6)
    half_way = np.array([[0.0, -0.05], [0.1, 0.0], [0.9, 0.0]])
    assert search.gap(half_way, 0.0, np.zeros(2))[0][0] == pytest.approx(-0.35, abs=1e-7)


def test_what_points_that_face_the_obstacle_push_out_is_left_to_them():
    """A sheet of thickness 0.05 over a bar: its upper side is inside, too."""
    search, x = search_of(BAR), [[0.0, 0.1], [0.0, 0.15]]
    partners = search.find(None, np.array(x), np.array([[0.0, -1.0], [0.0, 1.0]]), 0.0, 1.0, np.zeros(2))
    assert partners.paired.tolist() == [True, False]
    assert partners.gap[0] == pytest.approx(-0.1)


def test_no_way_out():
    """The upper side of a block below the surface of a half space, and a way longer than the search radius."""
    plane = search_of(Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0]))
    assert not found(plane, [[0.0, -0.2]], [0.0, 1.0]).paired.any()
    bar = search_of(BAR)
    assert not found(bar, [[0.0, 0.0]], [0.0, 1.0], radius=0.35).paired.any()
    assert bar.too_deep == 1
