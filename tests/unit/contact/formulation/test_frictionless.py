"""Nitsche's kernels against plain numpy, tangents of pairs against differences, the coercivity bound."""

import numpy as np
import pytest

from pcontact.assembly.bulk import ElasticBulk
from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.contact.formulation.frictionless_kernels import add_residual, add_tangent, evaluate
from pcontact.contact.formulation.parameters import Parameters
from pcontact.contact.law import Frictionless, View
from pcontact.contact.pair import contact_pair
from pcontact.contact.points import PartnerPoints, SourcePoints, interpolate, no_excess
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.contact.traction.elastic import traction_operator
from pcontact.material.elastic import lame
from pcontact.scene import amplitude
from pcontact.scene.model import Contact, Obstacle
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    blocks_file,
    dense,
    dense_item,
    elasticity,
    make_space,
    summary_of,
    vector_of,
)

THETAS = [1.0, 0.0, -1.0]
CONSTANTS = lame(10.0, 0.3)


# -- kernels alone ----------------------------------------


class Random:
    """Random arguments of the kernels: ``n_points`` on ``n_facets``, some without partner."""

    def __init__(self, d, targets, seed=0):
        rng = np.random.default_rng(seed)
        self.n, self.d, nn, n_facets, n_points = 14, d, 2 * d, 4, 24
        self.cells = np.array([rng.permutation(8)[:nn] for _ in range(n_facets)])
        self.facet = np.sort(rng.integers(0, n_facets, n_points))
        self.targets = np.array([8 + rng.permutation(6)[:targets] for _ in range(n_points)]).reshape(
            n_points, targets
        )
        self.shape, self.target_shape = rng.random((n_points, nn)), rng.random((n_points, targets))
        self.b = rng.normal(size=(n_points, nn, d))
        normal = rng.normal(size=(n_points, d))
        self.normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        self.gap0, self.jxw = 0.1 * rng.normal(size=n_points), 0.1 + rng.random(n_points)
        self.gamma = 1.0 + rng.random(n_facets)
        self.paired = rng.random(n_points) < 0.8
        self.u = rng.normal(size=(self.n, d))

    def evaluate(self, u):
        """t_n, gap of the compiled kernel."""
        traction, gap = np.empty(len(self.facet)), np.empty(len(self.facet))
        evaluate(u, *self.sides, self.b, traction, gap)
        return traction, gap

    @property
    def sides(self):
        """The arrays as kernels take them."""
        nothing = np.zeros((len(self.facet), 0, self.d))
        normal = np.zeros_like(self.normal)
        source = SourcePoints(
            self.facet, self.cells, self.shape, self.jxw, normal, nothing, nothing, np.zeros(len(self.cells))
        )
        return source, PartnerPoints(self.targets, self.target_shape, self.normal, self.gap0)

    def closed(self, u, bilateral):
        """H of a frictionless law."""
        return Frictionless().closed(View(self.paired, bilateral, False), self.tau(u))

    def tau(self, u):
        """Augmented traction."""
        traction, gap = self.evaluate(u)
        return traction + self.gamma[self.facet] * gap

    def residual(self, u, theta, bilateral):
        """(n d,) of the compiled kernel."""
        out, pressure = np.zeros((self.n, self.d)), np.where(self.closed(u, bilateral), self.tau(u), 0.0)
        add_residual(Parameters(theta, 1.0, self.gamma), *self.sides, self.b, self.evaluate(u)[0], pressure, out)
        return out.ravel()

    def tangent(self, u, theta, bilateral):
        """(n d, n d) of the compiled kernel."""
        everything = np.concatenate([self.cells[self.facet], self.targets], axis=1)
        rowptr, columns = node_graph([everything], self.n)
        values = np.zeros((len(columns), self.d, self.d))
        missing = self.add_tangent(u, theta, bilateral, rowptr, columns, values)
        assert missing == 0
        return dense(rowptr, columns, values, self.n)

    def add_tangent(self, u, theta, bilateral, rowptr, columns, values):
        """Of the compiled kernel, where nothing yields; returns what had no place."""
        nn = self.b.shape[1]
        return add_tangent(
            Parameters(theta, 1.0, self.gamma), *self.sides, self.b, no_excess(nn, self.d), np.zeros((0, nn, self.d)),
            self.closed(u, bilateral), BlockRows(rowptr, columns, values),
        )  # fmt: skip

    def operators(self):
        """Jump along the normal and traction as matrices (np, n d)."""
        jump = np.zeros((len(self.facet), self.n, self.d))
        traction = np.zeros_like(jump)
        row = np.arange(len(self.facet))[:, None]
        nodes = self.cells[self.facet]
        np.add.at(jump, (row, nodes), self.shape[:, :, None] * self.normal[:, None])
        np.add.at(jump, (row, self.targets), -self.target_shape[:, :, None] * self.normal[:, None])
        np.add.at(traction, (row, nodes), self.b)
        return jump.reshape(len(self.facet), -1), traction.reshape(len(self.facet), -1)

    def twin(self, u, theta, bilateral):
        """Residual and tangent as they stand in FORMULATION: (R) and its Jacobian, normal parts alone."""
        jump, b = self.operators()
        gamma = self.gamma[self.facet]
        t = b @ u.ravel()
        tau = t + gamma * (self.gap0 - jump @ u.ravel())
        h = (self.paired & ((tau <= 0) | bilateral)).astype(float)
        p = h * tau
        residual = -jump.T @ (self.jxw * p) + theta * b.T @ (self.jxw / gamma * (p - t))
        dtau = b - gamma[:, None] * jump
        weighted = self.jxw[:, None]
        tangent = -jump.T @ (weighted * h[:, None] * dtau)
        tangent += theta * b.T @ (weighted / gamma[:, None] * (h[:, None] * dtau - b))
        return residual, tangent


def cases():
    return pytest.mark.parametrize(
        "d, targets, bilateral, theta",
        [(d, m, b, t) for d, m in ((2, 2), (3, 4), (2, 0), (3, 0)) for b in (False, True) for t in THETAS],
    )


@pytest.mark.parametrize("d", [2, 3])
def test_traction_operator(d):
    """b . u = n . sigma(u) n_X for any gradients and normals."""
    rng = np.random.default_rng(5)
    n_points, nn = 6, 5
    grad, u = rng.normal(size=(n_points, nn, d)), rng.normal(size=(nn, d))
    facet, mu, volumetric = np.array([0, 0, 0, 1, 1, 1]), np.array([2.0, 7.0]), rng.normal(size=grad.shape)
    normals = rng.normal(size=(2, n_points, d))
    normal_x, normal = normals / np.linalg.norm(normals, axis=2)[:, :, None]
    out = np.empty_like(grad)
    traction_operator(np.arange(len(out)), grad, volumetric, facet, mu, normal_x, normal, out)
    for p in range(n_points):
        sigma = np.einsum("ijkl,ak,al->ij", elasticity(0.0, mu[facet[p]], d), u, grad[p])
        sigma += np.sum(volumetric[p] * u) * np.eye(d)
        assert np.sum(out[p] * u) == pytest.approx(normal[p] @ sigma @ normal_x[p], rel=1e-12)
    kept = out.copy()
    out[[1, 4]] = np.nan
    traction_operator(np.array([1, 4]), grad, volumetric, facet, mu, normal_x, normal, out)
    np.testing.assert_array_equal(out, kept)


@pytest.mark.parametrize("d", [2, 3])
def test_interpolate(d):
    points, out = Random(d, 0), np.full((Random(d, 0).normal.shape[0], d), np.nan)
    interpolate(points.u, points.cells, points.facet, points.shape, out)
    known = np.einsum("pa,pad->pd", points.shape, points.u[points.cells[points.facet]])
    np.testing.assert_allclose(out, known, atol=1e-14)


@pytest.mark.parametrize("d, targets", [(2, 2), (3, 4), (3, 0)])
def test_evaluate(d, targets):
    points = Random(d, targets)
    jump, b = points.operators()
    traction, gap = points.evaluate(points.u)
    np.testing.assert_allclose(traction, b @ points.u.ravel(), atol=1e-13)
    np.testing.assert_allclose(gap, points.gap0 - jump @ points.u.ravel(), atol=1e-13)


@cases()
def test_residual_and_tangent_are_those_of_numpy(d, targets, bilateral, theta):
    points = Random(d, targets)
    tau = points.tau(points.u)
    assert np.any(tau[points.paired] < 0) and np.any(tau[points.paired] > 0) and not np.all(points.paired)
    residual, tangent = points.twin(points.u, theta, bilateral)
    np.testing.assert_allclose(points.residual(points.u, theta, bilateral), residual, atol=1e-11)
    np.testing.assert_allclose(points.tangent(points.u, theta, bilateral), tangent, atol=1e-11)


@cases()
def test_symmetry_of_the_tangent(d, targets, bilateral, theta):
    points = Random(d, targets)
    k = points.tangent(points.u, theta, bilateral)
    off = np.abs(k - k.T).max() / np.abs(k).max()
    assert off < 1e-14 if theta == 1.0 else off > 1e-3


def test_tangent_counts_what_has_no_place():
    points = Random(2, 2)
    rowptr, columns = node_graph([points.cells], points.n)
    values = np.zeros((len(columns), 2, 2))
    missing = points.add_tangent(points.u, 0.0, True, rowptr, columns, values)
    # each coupled point: 4 source and 2 target nodes, less the 4 x 4 that have a place
    assert missing == np.sum(points.paired) * (6 * 6 - 4 * 4)


@pytest.mark.parametrize("theta", THETAS)
def test_a_point_at_the_kink_counts_as_closed(theta):
    """tau = 0 exactly: P is the same from both sides, the tangent that of the closed side."""
    points = Random(2, 2)
    points.gap0[:] = 0.0
    zero = np.zeros_like(points.u)
    assert np.all(points.tau(zero) == 0.0)
    assert np.all(points.residual(zero, theta, False) == 0.0)
    k = points.tangent(zero, theta, False)
    np.testing.assert_array_equal(k, points.tangent(zero, theta, True))
    # a step that closes every pair is followed exactly
    jump, b = points.operators()
    v, *_ = np.linalg.lstsq(
        b - points.gamma[points.facet][:, None] * jump, -np.ones(len(points.facet)), rcond=None
    )
    for h in (1.0, 1e-3):
        step = h * v.reshape(points.u.shape)
        closing = points.tau(step) < 0
        change = points.residual(step, theta, False)
        points.paired &= closing
        np.testing.assert_allclose(
            points.residual(step, theta, False),
            points.tangent(zero, theta, False) @ step.ravel(),
            atol=1e-12 * h,
        )
        assert np.abs(change).max() > 0


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
    k = dense_item(ElasticBulk(space, [CONSTANTS]), zero) + dense_item(item, zero)
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
