"""The traction of orthotropic cells: tangents against differences, and isotropic cells split in another way."""

import numpy as np
import pytest

from pcontact.assembly.solid import Solid
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import Elastic, in_plane, lame
from pcontact.pairs import pair_of
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Contact
from pcontact.space.space import Space
from tests.support.orthotropic import SKEW, isotropic, law_of, plane_axes
from tests.support.pairs import STEPS, bodies, check_taylor, motion, obstacle_of, phases
from tests.support.small import DIMENSION, SELF, blocks_file, dense_item, make_space, vector_of

SOFT = ([20.0, 8.0, 5.0], [0.3, 0.2, 0.25], [4.0, 3.0, 2.0])
CASES = [("quadrilateral", 1, "plane_strain"), ("triangle", 2, "plane_stress"), ("quadrilateral", 1, "axisymmetric"),
         ("tetrahedron", 1, "plane_strain")]  # fmt: skip


def space_of(path, cell, degree, kinematics):
    """Two stacked boxes whose meshes do not match, and which overhang."""
    d = DIMENSION[cell]
    blocks_file(path, cell, 1 if d == 3 else 2, [1] * d if d == 3 else [3, 1], offset=0.3)
    return Space(make_space(SELF, path, ["lower", "upper"], degree).mesh, degree, kinematics)


def item_of(space, contact, laws, constants):
    """The pair, its partners not found yet."""
    bulk = Solid(space, [laws.get(body) or Elastic(*pair) for body, pair in enumerate(constants)])
    source = source_surface(space, contact.source, constants, contact.quadrature, laws)
    target = target_surface(space, contact.target) if contact.obstacle is None else RigidObstacle(
        contact.obstacle, amplitude(None, 1.0), 1.0)  # fmt: skip
    contact.formulation = "nitsche"
    return pair_of(space, bulk, contact, source, target, 1.0)


def contact_of(name, theta, alpha=1.0):
    """Contact of two boxes, without friction where no law has the name; and the law that says what points do."""
    if name != "none":
        return bodies(name, theta=theta, alpha=alpha), name
    return Contact("upper_bottom", "lower_top", theta=theta, gamma0=1.0, search="closest_point"), "coulomb"


def axes(space):
    return SKEW if space.dim == 3 else plane_axes(35.0)


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("name", ["none", "coulomb"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_tangent(tmp_path, case, name, theta):
    """Open, sticking, slipping, mixed; symmetric where the method is."""
    space = space_of(tmp_path / "b.msh", *case)
    law, seen = law_of(SOFT, axes(space), space.dim, case[2]), set()
    contact, friction = contact_of(name, theta, 0.7)
    item = item_of(space, contact, {1: law}, [(1.0, 1.0), law.constants])
    first = motion(space, -0.01, 0.01, noise=0.006)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3, noise=0.006)
        seen |= {status for status, _ in check_taylor(item, u, friction)}
        if theta == 1.0 and name == "none":
            assert item.symmetric
            k = dense_item(item, vector_of(space, u))
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert seen >= ({OPEN, SLIP} if name == "none" else {OPEN, STICK, SLIP})


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("name, partner", [("none", "body"), ("coulomb", "body"), ("coulomb", "plane")])
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_isotropic_cells_split_in_another_way(tmp_path, case, name, partner, theta):
    """C_iso of any constants, the rest as C_dev: trace constant, forces and tangent are as they were."""
    space = space_of(tmp_path / "b.msh", *case)
    law = law_of(isotropic(7.0, 0.3), axes(space), space.dim, case[2], split=(1.0, 4.0))
    known = in_plane(*lame(7.0, 0.3), case[2])
    items = []
    for laws, constants in (({1: law}, law.constants), ({}, known)):
        contact, friction = contact_of(name, theta)
        if partner == "plane":
            contact.target, contact.obstacle = None, obstacle_of("plane", space.dim, [0.0, 0.0, 1.0])
        items.append(item_of(space, contact, laws, [(1.0, 1.0), constants]))
        items[-1].detect(space.vector(), 1.0)
    np.testing.assert_allclose(*(item.method.gamma for item in items), rtol=1e-10)
    u = motion(space, 0.03, 0.008, 0.1)
    assert len(set(phases(items[0], u, friction)[:, 0])) > 1
    results = []
    for item in items:
        out = np.zeros((space.n_owned, space.dim))
        item.residual(vector_of(space, u), out)
        results.append((out, dense_item(item, vector_of(space, u)), item.state(vector_of(space, u))["pressure"]))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-11 * np.abs(other).max())
