"""Gaps of bodies far from the origin: those of the same bodies at it, digit for digit."""

import numpy as np
import pytest

from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Contact, Obstacle
from tests.support.small import DIMENSION, SELF, blocks_file, make_space, vector_of

# a power of two, and dyadic coordinates: they are the same numbers there, and displacements are not
FAR = 2.0**20
CONSTANTS = [(50.0, 50.0)] * 2


def gaps(path, far, obstacle=None, search="closest_point"):
    """Gaps of all points under a displacement that is not dyadic, positions and displacements of the sources."""
    space = make_space(SELF, path, ["lower", "upper"], change=lambda x: np.asarray(x) + far)
    contact = Contact("upper_bottom", "lower_top" if obstacle is None else None, obstacle, gamma0=1.0, theta=0.0,
                      search=search)  # fmt: skip
    source = source_surface(space, "upper_bottom", CONSTANTS)
    if obstacle is None:
        target = target_surface(space, "lower_top")
    else:
        target = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0)
    item = contact_pair(space, contact, source, target, 0.5)
    x = space.points - far
    values = 1e-3 * np.sin(3.0 * x + np.arange(x.shape[1])) + 1e-4 * x[:, ::-1] ** 2
    for block in range(len(space.mesh.blocks)):
        if space.mesh.blocks[block].body == 1:
            values[np.unique(space.cells[block])] *= 1.75
    u = vector_of(space, values)
    item.detect(u, 0.0)
    return item.state(u)["gap"]


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_gap_to_a_body(tmp_path, cell, search):
    path = blocks_file(tmp_path / "b.msh", cell, 2, 4)
    near, far = gaps(path, 0.0, search=search), gaps(path, FAR, search=search)
    assert np.ptp(near) > 1e-5
    np.testing.assert_allclose(far, near, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("shape", ["plane", "sphere"])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_gap_to_an_obstacle(tmp_path, cell, shape):
    path, dim = blocks_file(tmp_path / "b.msh", cell), DIMENSION[cell]
    found = []
    for far in (0.0, FAR):
        if shape == "plane":
            place = {"point": [far] * (dim - 1) + [far + 0.75], "normal": [0.25] * (dim - 1) + [1.0]}
        else:
            place = {"center": [far + 0.5] * (dim - 1) + [far - 1.0], "radius": 1.875}
        found.append(gaps(path, far, Obstacle(shape=shape, **place)))
    assert np.ptp(found[0]) > 1e-5
    np.testing.assert_allclose(found[1], found[0], rtol=0.0, atol=1e-14)
