"""Contact with friction: tangents of pairs against differences, what is known of them."""

import numpy as np
import pytest

from pcontact.contact.law import OPEN, SLIP, STICK, Frictionless
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact
from tests.support.laws import LAWS, limit_of
from tests.support.pairs import (
    LIMITED,
    OBSTACLES,
    STEPS,
    along,
    bodies,
    by_key,
    check_taylor,
    field,
    motion,
    obstacle_of,
    pair,
    residual_of,
    state_of,
    tangential,
)
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    blocks_file,
    dense,
    dense_item,
    make_space,
    summary_of,
    vector_of,
)

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
FREE_LAW = np.array([0.0, 1e300, np.inf])


# -- whole pairs ----------------------------------------


@pytest.fixture(scope="module", params=["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang: some source points have no partner."""
    d = DIMENSION[request.param]
    path = tmp_path_factory.mktemp("stacked") / "blocks.msh"
    blocks_file(path, request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta, alpha", [(1.0, 0.7), (0.0, 1.0), (-1.0, 0.7)])
def test_tangent_of_a_pair_of_bodies(stacked, theta, search, name, alpha):
    """Open, sticking, slipping, mixed, without partner, in the second load step: always the derivative."""
    space = stacked
    item = pair(space, bodies(name, search, theta, alpha), radius=0.3)
    first = motion(space, -0.01, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    np.testing.assert_allclose(state_of(item, first)["slip"], 0.0, atol=1e-15)
    seen = []
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3)
        seen.append(check_taylor(item, u, name))
        k = dense_item(item, vector_of(space, u))
        if theta == 1.0 and name == "tresca":
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert {status for status, _ in seen[0]} == {OPEN}
    assert {status for phase in seen for status, _ in phase} == {OPEN, STICK, SLIP}
    assert np.isinf(limit_of(name)) or any((SLIP, LIMITED) in phase for phase in seen)


@pytest.mark.parametrize("theta", THETAS)
def test_symmetry_of_the_tangent_of_a_pair(stacked, theta):
    """theta = 1: symmetric while points are open or stick, and not once one slips."""
    space = stacked
    item = pair(space, bodies("steep", "ray_tracing", theta, 0.7), radius=0.3)
    item.detect(space.vector(), 1.0)
    for (depth, slide, tilt), status in ((STEPS[0], OPEN), (STEPS[1], STICK), (STEPS[4], SLIP)):
        u = motion(space, depth, slide, tilt)
        assert np.any(state_of(item, u)["status"] == status)
        k = dense_item(item, vector_of(space, u))
        off = np.abs(k - k.T).max() / max(np.abs(k).max(), 1.0)
        assert off < 1e-13 if status == OPEN or (status == STICK and theta == 1.0) else off > 1e-3


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("theta", THETAS)
def test_tangent_of_curved_cells_of_second_order(tmp_path, theta, name):
    path = blocks_file(tmp_path / "b.msh", "triangle", 2, 1, order=2)
    space = make_space(SELF, path, ["lower", "upper"], 2, lambda x: bend(x, 0.03))
    item = pair(space, bodies(name, theta=theta, alpha=0.7))
    first = motion(space, 0.01, 0.02)
    item.detect(vector_of(space, first), 1.0)
    statuses = set()
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth, slide, tilt, seed=3)
        statuses |= {status for status, _ in check_taylor(item, u, name)}
    assert statuses == {OPEN, STICK, SLIP}


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_action_is_reaction(stacked, theta, name):
    """The pair's forces are in balance whatever the state (theta != 0 adds forces without a resultant)."""
    space = stacked
    item = pair(space, bodies(name, theta=theta), radius=0.3)
    item.detect(space.vector(), 1.0)
    lower = space.component[space.owned_local] == 0
    for depth, slide, tilt in STEPS[1:]:
        u = motion(space, depth, slide, tilt)
        out = residual_of(item, u).reshape(-1, space.dim)
        assert np.abs(out).max() > 1e-3
        np.testing.assert_allclose(out.sum(axis=0), 0.0, atol=1e-12)
        # what the target's nodes feel, and what the report says, in all directions
        force = summary_of(item, vector_of(space, u))["force"]
        np.testing.assert_allclose(-out[lower].sum(axis=0), force, atol=1e-12)
        assert abs(force[0]) > 1e-3


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
def test_hardly_any_friction_is_none(stacked, search):
    """theta = 0: residual and tangent of frictionless contact; other theta ask for no tangential traction, too."""
    space = stacked
    laws = ((1e-300, None), (None, Frictionless()))
    items = [pair(space, bodies(search=search, friction=f), 0.3, law) for f, law in laws]
    for item in items:
        item.detect(space.vector(), 1.0)
    for depth, slide, tilt in STEPS:
        u = motion(space, depth, slide, tilt)
        a, b = (residual_of(item, u) for item in items)
        np.testing.assert_allclose(a, b, atol=1e-13)
        a, b = (dense_item(item, vector_of(space, u)) for item in items)
        np.testing.assert_allclose(a, b, atol=1e-12)
        a, b = (state_of(item, u) for item in items)
        for key in ("pressure", "gap", "traction", "status"):
            np.testing.assert_allclose(a[key], b[key], atol=1e-12)


# -- slip ----------------------------------------


def rotation(angle, d):
    """A turn about an oblique axis."""
    if d == 2:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    axis = np.array([0.48, -0.6, 0.64])
    cross = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
def test_slip_counts_from_the_committed_displacement(stacked, search):
    """None in the first moment of a step, that of the body when it moves, none when both move."""
    space = stacked
    item = pair(space, bodies(search=search), radius=0.3)
    item.detect(space.vector(), 0.5)
    # so far that most points get another partner
    first = motion(space, -0.01, -0.2, 0.02)
    old = item.pairing.ids
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    paired = item.pairing.paired
    assert np.any(old[paired] != item.pairing.ids[paired])
    np.testing.assert_allclose(state_of(item, first)["slip"], 0.0, atol=1e-15)
    shift = np.array([0.3, -0.2, 0.1][: space.dim])
    np.testing.assert_allclose(state_of(item, first + shift)["slip"], 0.0, atol=1e-15)
    upper = space.component[space.owned_local] == 1
    state = state_of(item, first + upper[:, None] * shift)
    expected = np.where(paired[:, None], tangential(shift, state["normal"]), 0.0)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(state["slip"], expected, atol=1e-15)


@pytest.mark.parametrize("gap", [0.0, 0.1])
def test_turning_both_bodies_is_no_slip(tmp_path, gap):
    """None where they touch, whatever the angle; angle times gap where they do not, because pairs are points."""
    for cell in ("quadrilateral", "hexahedron"):
        path = blocks_file(tmp_path / f"{cell}.msh", cell, 2, 3, gap=gap)
        space = make_space(SELF, path, ["lower", "upper"])
        item = pair(space, bodies())
        item.detect(space.vector(), 1.0)
        assert np.all(item.pairing.paired)
        for angle in (1e-3, 1.0):
            turn = rotation(angle, space.dim) - np.eye(space.dim)
            slip = state_of(item, (space.points[space.owned_local] - 0.3) @ turn.T)["slip"]
            normal = item.pairing.normal
            np.testing.assert_allclose(slip, tangential(-gap * normal @ turn.T, normal), atol=1e-14)
            assert np.abs(slip).max() <= gap * angle + 1e-14


# -- obstacles ----------------------------------------


SHIFT = np.array([0.012, -0.008, 0.01])


@pytest.fixture(scope="module", params=["quadrilateral", "tetrahedron"])
def block(request, tmp_path_factory):
    """A box."""
    path = block_file(tmp_path_factory.mktemp("block") / "b.msh", request.param, 2)
    return make_space(SELF, path, ["block"])


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("shape", OBSTACLES)
@pytest.mark.parametrize("theta", THETAS)
def test_tangent_against_a_moving_obstacle(block, theta, shape, name, bilateral):
    space = block
    obstacle = obstacle_of(shape, space.dim, SHIFT)
    said = {"theta": theta, "alpha": 0.7, "gamma0": 1.0, "bilateral": bilateral, **LAWS[name]}
    item = pair(space, Contact("bottom", obstacle=obstacle, **said), radius=5.0)
    item.detect(space.vector(), 0.4)
    first = motion(space, 0.01, 0.02)
    item.commit(vector_of(space, first), 0.4)
    item.detect(vector_of(space, first), 0.9)
    state = state_of(item, first)
    assert np.all(item.pairing.paired)
    moved = 0.5 * along(SHIFT, space.dim)
    np.testing.assert_allclose(state["slip"], -tangential(moved, state["normal"]), atol=1e-15)
    statuses = set()
    # the body goes with the obstacle: what stuck sticks
    states = [first + moved + motion(space, 0.05, 0.0)]
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth, slide, tilt, seed=3)
        states.append(u)
    for u in states:
        statuses |= {status for status, _ in check_taylor(item, u, name)}
        if theta == 1.0 and name == "tresca":
            k = dense_item(item, vector_of(space, u))
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert statuses == ({STICK, SLIP} if bilateral else {OPEN, STICK, SLIP})


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("theta", THETAS)
def test_dragging_the_obstacle_is_dragging_the_body(block, theta, name):
    """A plane that moves by d under a body at rest, and a body that moves by -d over a plane at rest."""
    space, d = block, along(SHIFT, block.dim)
    said = {"theta": theta, "alpha": 0.7, **LAWS[name]}
    moving, fixed = (
        pair(space, Contact("bottom", obstacle=obstacle_of("plane", space.dim, shift), **said), radius=5.0)
        for shift in (SHIFT, None)
    )
    for item in (moving, fixed):
        item.detect(space.vector(), 1.0)
    u = motion(space, 0.005, 0.01, 0.05)
    statuses = state_of(moving, u)["status"]
    assert len(set(statuses)) > 1
    np.testing.assert_array_equal(state_of(fixed, u - d)["status"], statuses)
    np.testing.assert_allclose(residual_of(moving, u), residual_of(fixed, u - d), atol=1e-13)
    np.testing.assert_allclose(
        dense_item(moving, vector_of(space, u)), dense_item(fixed, vector_of(space, u - d)), atol=1e-12
    )


@pytest.mark.parametrize("shape", OBSTACLES)
def test_a_body_that_goes_with_the_obstacle_does_not_slip(block, shape):
    """Over two load steps, one of them cut back: slip counts from the committed time."""
    space, d = block, along(SHIFT, block.dim)
    table = [(0.0, 0.0), (0.5, 1.0), (1.0, -1.0)]
    contact = Contact("bottom", obstacle=obstacle_of(shape, space.dim, SHIFT, table), theta=0.0, friction=0.3)
    item = pair(space, contact, radius=5.0)
    for before, target, moved in ((0.0, 0.5, 1.0), (1.0, 1.0, -1.0), (1.0, 0.75, 0.0)):
        start, end = (np.tile(part * d, (space.n_owned, 1)) for part in (before, moved))
        item.detect(vector_of(space, start), target)
        expected = tangential((before - moved) * d, item.pairing.normal)
        np.testing.assert_allclose(state_of(item, start)["slip"], expected, atol=1e-15)
        np.testing.assert_allclose(state_of(item, end)["slip"], 0.0, atol=1e-15)
        if target == 0.5:
            item.commit(vector_of(space, end), target)


# -- several ranks ----------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("name, theta", [("coulomb", 0.0), ("all", 1.0), ("tresca", -1.0)])
@pytest.mark.parametrize("cell, degree", [("triangle", 2), ("hexahedron", 1)])
def test_friction_is_the_same_on_any_ranks(shared_tmp, cell, degree, name, theta):
    """Forces, tangent times vector, summary of a pair in its second load step, partly open, sticking, slipping."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, cell, 2, 7 if cell == "triangle" else 3)
    WORLD.Barrier()
    results = []
    for comm in (WORLD, SELF):
        space = make_space(comm, path, ["lower", "upper"], degree)
        item = pair(space, bodies(name, theta=theta, alpha=0.7))
        item.detect(space.vector(), 0.5)
        first = 0.001 * field(space, 2)
        item.commit(vector_of(space, first), 0.5)
        item.detect(vector_of(space, first), 1.0)
        u = first + motion(space, 0.03, 0.004, 0.1, noise=0.0) + 0.005 * field(space, 3)
        residual = residual_of(item, u).reshape(-1, space.dim)
        values = item.tangent(vector_of(space, u))
        rows = dense(*item.pattern(), values, space.numbering.n_total)
        v = np.concatenate(comm.allgather(field(space, 4)))
        product = (rows @ v.ravel()).reshape(-1, space.dim)
        summary = summary_of(item, vector_of(space, u))
        results.append((by_key(space, residual), by_key(space, product), summary))
    for a, b in zip(results[0][:2], results[1][:2], strict=True):
        assert np.abs(b).max() > 1e-3
        np.testing.assert_allclose(a, b, atol=1e-11)
    first, second = results[0][2], results[1][2]
    assert min(second["open"], second["stick"], second["slip"]) > 0
    for key, value in second.items():
        np.testing.assert_allclose(first[key], value, atol=1e-11)
    assert len({str(s) for s in WORLD.allgather(first)}) == 1
