"""Stretches and rotations of cells, and the most of them by body."""

import numpy as np
import pytest

from pcontact.assembly.measures import rotation_vectors
from tests.support.finite import finite_bulk, finite_grid, finite_space
from tests.support.small import vector_of


def turn_of(vector):
    """Rotation (3, 3) of a rotation vector [radian], Rodrigues' formula."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


@pytest.mark.parametrize("angle", [1e-6, 20.0, 90.0, 170.0, 180.0 - 1e-3])
def test_rotation_vector(angle):
    """That of the rotation alone, whatever the stretch, of random axes."""
    rng, out = np.random.default_rng(3), np.zeros((20, 3))
    axes = rng.standard_normal((20, 3))
    axes *= angle / np.linalg.norm(axes, axis=1)[:, None]
    h = np.zeros((20, 3, 3))
    for k, axis in enumerate(axes):
        stretch = np.diag([1.4, 0.7, 1.1]) + 0.1 * (np.ones((3, 3)) - np.eye(3))
        h[k] = turn_of(np.radians(axis)) @ stretch - np.eye(3)
    rotation_vectors(h, 6, out)
    np.testing.assert_allclose(out, axes, rtol=0.0, atol=1e-9)


def test_half_a_turn_has_its_axis():
    """At 180 degrees the axial vector vanishes; either sign of the axis is right."""
    axis, out = np.array([0.6, 0.0, -0.8]), np.zeros((1, 3))
    rotation_vectors((turn_of(np.pi * axis) - np.eye(3))[None], 6, out)
    assert abs(out[0] @ axis) == pytest.approx(180.0, rel=1e-12)


@pytest.mark.parametrize("cell, kinematics", [("hexahedron", "plane_strain"), ("quadrilateral", "plane_strain"),
                                              ("quadrilateral", "plane_stress")])  # fmt: skip
def test_a_stretched_and_turned_block(tmp_path, cell, kinematics):
    """Principal stretches from the largest on, in plane stress that across the plane too; the rotation; the report."""
    space = finite_space(finite_grid(tmp_path, cell, 1), 1, kinematics, False)
    bulk, d, x = finite_bulk(space, "hencky"), space.dim, space.points[space.owned_local]
    stretches, rotation = np.array([0.8, 1.5, 1.1])[:d], np.array([0.0, 0.0, 35.0])
    gradient = (turn_of(np.radians(rotation))[:d, :d] @ np.diag(stretches)) - np.eye(d)
    u = vector_of(space, x @ gradient.T)
    fields, expected = bulk.fields(u), [*stretches]
    if kinematics == "plane_stress":
        expected.append(np.exp(-0.3 / 0.7 * np.log(stretches).sum()))
    expected = sorted([*expected, *([1.0] * (3 - len(expected)))], reverse=True)
    for k in range(3):
        np.testing.assert_allclose(fields[f"stretch_{k + 1}"][0], expected[k], rtol=1e-11)
    np.testing.assert_allclose(fields["rotation"][0], np.tile(rotation, (len(space.cells[0]), 1)), atol=1e-9)
    found = bulk.deformations(u)[0]
    assert found.largest_stretch == pytest.approx(1.5) and found.smallest_stretch == pytest.approx(expected[2])
    assert found.rotation == pytest.approx(35.0) and len(found.place) == d
