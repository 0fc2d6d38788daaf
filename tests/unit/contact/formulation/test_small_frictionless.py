"""Contact without friction: tangents of pairs against differences, the coercivity bound."""

import numpy as np
import pytest

from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import lame
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Contact, Obstacle
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    blocks_file,
    dense_item,
    elastic_solid,
    make_space,
    summary_of,
    vector_of,
)

THETAS = [1.0, 0.0, -1.0]
CONSTANTS = lame(10.0, 0.3)


# -- whole pairs ----------------------------------------


def pair(space, contact, obstacle=None, radius=0.5):
    """Item of a contact of ``upper_bottom`` (or ``bottom``) whose first search is done by the caller."""
    constants = [CONSTANTS] * 2
    source = source_surface(space, contact.source, constants, contact.quadrature)
    if obstacle is None:
        target = target_surface(space, contact.target)
    else:
        target = RigidObstacle(obstacle, amplitude(obstacle.amplitude, 1.0), 1.0)
    return contact_pair(space, contact, source, target, radius)


def taylor(item, u, v, steps=(1.0, 1e-2, 1e-4)):
    """|R(u + h v) - R(u) - h K v| / (h |K v|) for falling h; whether all points kept their state."""
    space = item.space

    def residual(array):
        out = np.zeros((space.n_owned, space.dim))
        item.residual(vector_of(space, array), out)
        return out.ravel()

    def closed(array):
        return item.state(vector_of(space, array))["status"] > 0

    slope = dense_item(item, vector_of(space, u)) @ v.ravel()
    scale = max(np.abs(slope).max(), 1e-300)
    start, before = residual(u), closed(u)
    errors, same = [], []
    for h in steps:
        errors.append(np.abs(residual(u + h * v) - start - h * slope).max() / (h * scale))
        same.append(bool(np.array_equal(before, closed(u + h * v))))
    return np.array(errors), np.array(same)


def check_taylor(item, u, v):
    """Away from kinks the residual is linear: the difference is rounding."""
    errors, same = taylor(item, u, v)
    assert same[-1]
    for h, error, linear in zip((1.0, 1e-2, 1e-4), errors, same, strict=True):
        if linear:
            assert error < 1e-10 / h
    return same


@pytest.fixture(params=["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def stacked(request, tmp_path):
    """Two boxes whose meshes do not match and which overhang: some source points have no partner."""
    d = DIMENSION[request.param]
    path = blocks_file(tmp_path / "blocks.msh", request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


def state_of(space, depth, seed=1):
    """The upper body moved down by a depth, and everything a little at random."""
    rng = np.random.default_rng(seed)
    u = 0.01 * rng.normal(size=(space.n_owned, space.dim))
    u[space.component[space.owned_local] == 1, -1] -= depth
    return u


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta", THETAS)
def test_tangent_of_a_pair_of_bodies(stacked, theta, search):
    """Points open, closed, mixed and unpaired: the tangent is always the derivative of the residual."""
    space = stacked
    contact = Contact("upper_bottom", "lower_top", theta=theta, gamma0=1.0, search=search)
    item = pair(space, contact, radius=0.2)
    item.detect(space.vector(), 1.0)
    paired = item.pairing.paired
    assert np.any(paired)
    if search == "ray_tracing":
        assert not np.all(paired)
    v = state_of(space, 0.01, seed=2)
    seen = set()
    for depth in (-0.5, 0.0, 0.5):
        u = state_of(space, depth)
        closed = item.state(vector_of(space, u))["status"] > 0
        assert not np.any(closed & ~paired)
        seen.add((bool(closed.any()), bool((~closed & paired).any())))
        check_taylor(item, u, v)
        k = dense_item(item, vector_of(space, u))
        if theta == 1.0:
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert seen == {(False, True), (True, True), (True, False)}


@pytest.mark.parametrize("theta", THETAS)
def test_tangent_after_a_search_on_the_deformed_bodies(stacked, theta):
    """The gap takes the value found there and is linear from then on."""
    space = stacked
    item = pair(space, Contact("upper_bottom", "lower_top", theta=theta, search="closest_point"), radius=0.4)
    u = state_of(space, 0.05)
    item.detect(vector_of(space, u), 1.0)
    gap = item.state(vector_of(space, u))["gap"]
    paired = item.pairing.paired
    assert np.max(gap[paired]) < 0.1 and np.min(gap[paired]) < -0.02
    # nothing is nearer than the search radius to a point without a partner
    assert np.all(gap[~paired] == 0.4)
    check_taylor(item, u, state_of(space, 0.01, seed=2))
    # a rigid shift of both bodies changes nothing
    shifted = item.state(vector_of(space, u + 0.7))["gap"]
    np.testing.assert_allclose(shifted, gap, atol=1e-13)


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta", THETAS)
def test_action_is_reaction(stacked, theta, search):
    """The pair's forces are in balance whatever the state (theta != 0 adds forces without a resultant)."""
    space = stacked
    item = pair(space, Contact("upper_bottom", "lower_top", theta=theta, search=search), radius=0.2)
    item.detect(space.vector(), 1.0)
    u = vector_of(space, state_of(space, 0.1))
    out = np.zeros((space.n_owned, space.dim))
    item.residual(u, out)
    assert np.abs(out).max() > 1e-3
    np.testing.assert_allclose(out.sum(axis=0), 0.0, atol=1e-12)
    # the internal minus external forces on the target: minus the contact force that acts on it
    lower = space.component[space.owned_local] == 0
    np.testing.assert_allclose(-out[lower].sum(axis=0), summary_of(item, u)["force"], atol=1e-12)


@pytest.mark.parametrize("theta", THETAS)
def test_tangent_of_curved_cells_of_second_order(tmp_path, theta):
    space = make_space(
        SELF,
        blocks_file(tmp_path / "b.msh", "triangle", 2, 1, order=2),
        ["lower", "upper"],
        2,
        lambda x: bend(x, 0.03),
    )
    item = pair(space, Contact("upper_bottom", "lower_top", theta=theta, search="closest_point"))
    item.detect(space.vector(), 1.0)
    for depth in (-0.05, 0.0, 0.2):
        check_taylor(item, state_of(space, depth), state_of(space, 0.01, seed=2))


OBSTACLES = {
    "plane": {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.1, 0.2, 1.0]},
    "sphere": {"shape": "sphere", "center": [0.4, 0.4, -1.0], "radius": 1.0},
}


def obstacle_of(name, d):
    """The obstacle in d dimensions."""
    said = dict(OBSTACLES[name])
    for key in ("point", "normal", "center"):
        if key in said:
            said[key] = [*said[key][: d - 1], said[key][-1]]
    return Obstacle(**said)


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", OBSTACLES)
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("theta", THETAS)
def test_tangent_against_an_obstacle(tmp_path, cell, name, theta, bilateral):
    space = make_space(SELF, block_file(tmp_path / "b.msh", cell, 2), ["block"])
    obstacle = obstacle_of(name, space.dim)
    contact = Contact("bottom", obstacle=obstacle, theta=theta, bilateral=bilateral)
    item = pair(space, contact, obstacle, radius=5.0)
    item.detect(space.vector(), 1.0)
    assert np.all(item.pairing.paired)
    rng = np.random.default_rng(4)
    kinds = set()
    for depth in (-1.0, 0.0, 1.5):
        u = 0.03 * rng.normal(size=(space.n_owned, space.dim))
        u[:, -1] -= depth
        same = check_taylor(item, u, 0.01 * rng.normal(size=u.shape))
        closed = item.state(vector_of(space, u))["status"] > 0
        kinds.add((bool(closed.any()), bool(closed.all())))
        if bilateral:
            assert np.all(same) and np.all(closed)
        k = dense_item(item, vector_of(space, u))
        if theta == 1.0:
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert bilateral or kinds >= {(False, False), (True, True)}


def turned(points):
    """Points turned about an axis, away from the origin: gaps of zero are lost in rounding."""
    c, s = np.cos(0.3), np.sin(0.3)
    x = np.array(points)
    x[:, 0], x[:, -1] = c * points[:, 0] - s * points[:, -1], s * points[:, 0] + c * points[:, -1]
    return x + 3.0


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("change", [np.array, turned], ids=["straight", "turned"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_bodies_that_just_touch_are_tied_in_the_first_tangent(tmp_path, cell, change, theta):
    """Flat surfaces at gap 0, nothing displaced: every point is closed, the tangent that of closing."""
    space = make_space(SELF, blocks_file(tmp_path / "b.msh", cell, 2, 3), ["lower", "upper"], 1, change)
    item = pair(space, Contact("upper_bottom", "lower_top", theta=theta, search="closest_point"))
    zero = space.vector()
    item.detect(zero, 1.0)
    assert np.all(item.state(zero)["status"] > 0)
    tied = pair(
        space, Contact("upper_bottom", "lower_top", theta=theta, search="closest_point", bilateral=True)
    )
    tied.detect(zero, 1.0)
    np.testing.assert_allclose(dense_item(item, zero), dense_item(tied, zero), atol=1e-13)
    v = np.zeros((space.n_owned, space.dim))
    ends = change(np.vstack([np.zeros(space.dim), -np.eye(space.dim)[-1]]))
    v[space.component[space.owned_local] == 1] = 1e-3 * (ends[1] - ends[0])
    errors, _ = taylor(item, np.zeros_like(v), v)
    assert errors[0] < 1e-11


def test_the_pattern_grows_when_a_far_point_closes(tmp_path):
    """Points that were thought far couple at once when they close: the tangent stays the derivative."""
    space = make_space(
        SELF, blocks_file(tmp_path / "b.msh", "quadrilateral", 2, 3, gap=0.3), ["lower", "upper"]
    )
    item = pair(space, Contact("upper_bottom", "lower_top", theta=0.0, search="closest_point"), radius=0.5)
    item.detect(space.vector(), 1.0)
    assert np.all(item.pairing.paired)
    version, n_entries = item.version, len(item.pattern()[1])
    assert n_entries == 0
    open_state = state_of(space, 0.0)
    assert np.abs(dense_item(item, vector_of(space, open_state))).max(initial=0.0) == 0.0
    assert item.version == version
    u = state_of(space, 0.5)
    check_taylor(item, u, state_of(space, 0.01, seed=2))
    assert item.version > version and len(item.pattern()[1]) > n_entries
    # it does not shrink within a step: a point that opens again costs zeros, no new pattern
    version = item.version
    item.tangent(vector_of(space, open_state))
    assert item.version == version


# -- coercivity ----------------------------------------


def lowest(space, theta, gamma0, bilateral):
    """Smallest eigenvalue of the symmetric part of K_bulk + K_contact over the largest."""
    obstacle = Obstacle("plane", point=[0.0] * space.dim, normal=[0.0] * (space.dim - 1) + [1.0])
    item = pair(
        space, Contact("bottom", obstacle=obstacle, theta=theta, gamma0=gamma0, bilateral=bilateral), obstacle
    )
    zero = space.vector()
    item.detect(zero, 1.0)
    k = dense_item(elastic_solid(space, [CONSTANTS]), zero) + dense_item(item, zero)
    eigenvalues = np.linalg.eigvalsh(0.5 * (k + k.T))
    return eigenvalues[0] / eigenvalues[-1]


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron", "triangle", "tetrahedron"])
def test_coercivity_threshold(tmp_path, cell, theta, bilateral):
    """One cell (simplices: a cut cube) on a plane: stable from gamma0 = (1 + theta)^2 / 4, not far below."""
    space = make_space(SELF, block_file(tmp_path / "b.msh", cell, 1), ["block"])
    bound = (1.0 + theta) ** 2 / 4.0
    if theta == -1.0:
        # the two boundary terms cancel: any gamma0 will do
        assert lowest(space, theta, 1e-3, bilateral) > -1e-13
        return
    assert lowest(space, theta, 1.01 * bound, bilateral) > -1e-13
    assert lowest(space, theta, 0.6 * bound, bilateral) < -1e-5
    low, high = 0.6, 1.01
    while high - low > 1e-2:
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if lowest(space, theta, middle * bound, bilateral) < -1e-12 else (low, middle)
        )
    # frictionless contact sees the normal traction only, the bound counts all of it
    assert 0.6 < high <= 1.01
    if cell in ("quadrilateral", "hexahedron"):
        assert high == pytest.approx(1.0, abs=0.15)
