"""Contact with friction: kernels against plain numpy, tangents of pairs against differences, what is known of both."""

import numpy as np
import pytest

from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.contact.formulation import frictional_kernels as friction
from pcontact.contact.formulation.parameters import Parameters
from pcontact.contact.law import OPEN, SLIP, STICK, Frictionless, project_rows
from pcontact.contact.points import PartnerPoints, SourcePoints, no_excess
from pcontact.contact.traction.elastic import tractions
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact
from tests.support.laws import LAWS, law_of, limit_of, numpy_projection
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
    elasticity,
    make_space,
    summary_of,
    vector_of,
)

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
FREE_LAW = np.array([0.0, 1e300, np.inf])


# -- kernels alone ----------------------------------------


class Points:
    """Random arguments of the kernels: points open, sticking and slipping, some without partner.

    The gap and the jump from which slip counts are such that the augmented traction at ``u`` takes random values of
    about 1, whose tangential parts go from far below to far above the bounds.
    """

    def __init__(self, d, targets, alpha=1.0, seed=0):
        rng = np.random.default_rng(seed)
        self.n, self.d, self.alpha, nn, n_facets, n_points = 14, d, alpha, 2 * d, 4, 40
        self.cells = np.array([rng.permutation(8)[:nn] for _ in range(n_facets)])
        self.facet = np.sort(rng.integers(0, n_facets, n_points))
        chosen = [8 + rng.permutation(6)[:targets] for _ in range(n_points)]
        self.targets = np.array(chosen, dtype=np.int64).reshape(n_points, targets)
        self.shape, self.target_shape = rng.random((n_points, nn)), rng.random((n_points, targets))
        self.grad, (lam, self.mu) = rng.normal(size=(n_points, nn, d)), 0.5 + rng.random((n_facets, 2)).T
        # not parallel to the gradients: hoop strain, mean dilatation
        other = 0.3 * np.random.default_rng(seed + 1).normal(size=self.grad.shape)
        self.volumetric = lam[self.facet][:, None, None] * (self.grad + other)
        normals = rng.normal(size=(2, n_points, d))
        self.normal_x, self.normal = normals / np.linalg.norm(normals, axis=2)[:, :, None]
        self.jxw, self.gamma = 0.1 + rng.random(n_points), 1.0 + rng.random(n_facets)
        self.paired = rng.random(n_points) < 0.8
        self.u = rng.normal(size=(self.n, d))
        wanted = rng.normal(size=(n_points, d)) * np.exp(rng.uniform(-2.0, 1.0, n_points))[:, None]
        self._reach(wanted, rng.normal(size=n_points))

    def _reach(self, across, along):
        """Choose gap and reference of the slip for an augmented traction; what is left free is random."""
        jump, b = self.operators()
        jump, traction = jump @ self.u.ravel(), b @ self.u.ravel()
        gamma = self.gamma[self.facet]
        self.gap0 = (along - dots(traction, self.normal)) / gamma + dots(jump, self.normal)
        slip = tangential(traction - across, self.normal) / (self.alpha * gamma[:, None])
        self.before = jump - slip + 0.3 * along[:, None] * self.normal

    def operators(self):
        """Jump N and traction B of the source as matrices (np, d, n d)."""
        rows, one = len(self.facet), np.eye(self.d)
        jump, traction = (np.zeros((rows, self.d, self.n, self.d)) for _ in range(2))
        for p in range(rows):
            tensor = elasticity(0.0, self.mu[self.facet[p]], self.d)
            for a, node in enumerate(self.cells[self.facet[p]]):
                jump[p, :, node] += self.shape[p, a] * one
                traction[p, :, node] += np.einsum("ijkl,l,j->ik", tensor, self.grad[p, a], self.normal_x[p])
                traction[p, :, node] += np.outer(self.normal_x[p], self.volumetric[p, a])
            for m, node in enumerate(self.targets[p]):
                jump[p, :, node] -= self.target_shape[p, m] * one
        return jump.reshape(rows, self.d, -1), traction.reshape(rows, self.d, -1)

    def evaluate(self, u, wanted=None):
        """Traction, jump, tau of the compiled kernels."""
        wanted = np.ones(len(self.facet), dtype=bool) if wanted is None else wanted
        traction, jump, tau = (np.full_like(self.normal, np.nan) for _ in range(3))
        source, partner = self.sides
        friction.jumps(u, source, partner, wanted, jump)
        tractions(u, source, wanted, traction)
        friction.augment(self.parameters(0.0), source, partner, traction, jump, self.before, wanted, tau)
        return traction, jump, tau

    def parameters(self, theta):
        """Parameters as kernels take them."""
        return Parameters(theta, np.full_like(self.gamma, self.alpha), self.gamma)

    @property
    def sides(self):
        """The arrays as kernels take them."""
        source = SourcePoints(
            self.facet, self.cells, self.shape, self.jxw, self.normal_x, self.grad, self.volumetric, self.mu
        )
        return source, PartnerPoints(self.targets, self.target_shape, self.normal, self.gap0)

    def projected(self, u, law, bilateral):
        """P, D and status of a law."""
        force, slope, status = np.zeros_like(self.normal), np.zeros((len(self.facet), self.d, self.d)), self.facet * 0
        project_rows(law, bilateral, self.paired, self.normal, self.evaluate(u)[2], force, slope, status)
        return force, slope, status

    def residual(self, u, law, theta, bilateral):
        """(n d,) of the compiled kernel."""
        out, (force, _, status) = np.zeros((self.n, self.d)), self.projected(u, law, bilateral)
        friction.add_residual(self.parameters(theta), *self.sides, self.evaluate(u)[0], force, status, out)
        return out.ravel()

    def add_tangent(self, u, law, theta, bilateral, tables):
        """Pattern of the tables, values and missing entries of the compiled kernel."""
        rowptr, columns = node_graph(tables, self.n)
        values = np.zeros((len(columns), self.d, self.d))
        _, slope, status = self.projected(u, law, bilateral)
        missing = friction.add_tangent(
            self.parameters(theta), *self.sides, no_excess(self.shape.shape[1], self.d), status, slope,
            BlockRows(rowptr, columns, values),
        )  # fmt: skip
        return rowptr, columns, values, missing

    def tangent(self, u, law, theta, bilateral):
        """(n d, n d) of the compiled kernel."""
        everything = np.concatenate([self.cells[self.facet], self.targets], axis=1)
        rowptr, columns, values, missing = self.add_tangent(u, law, theta, bilateral, [everything])
        assert missing == 0
        return dense(rowptr, columns, values, self.n)

    def twin(self, u, name, theta, bilateral):
        """P (np, d), status, residual, tangent as they stand in FORMULATION: (R) and its Jacobian, with matrices."""
        u, size, (jumps, tractions) = u.ravel(), u.size, self.operators()
        residual, tangent, one = np.zeros(size), np.zeros((size, size)), np.eye(self.d)
        forces, statuses = np.zeros_like(self.normal), np.zeros(len(self.facet), dtype=int)
        for p, (jump, b, n) in enumerate(zip(jumps, tractions, self.normal, strict=True)):
            nn, stiff = np.outer(n, n), self.gamma[self.facet[p]]
            weight = stiff * (nn + self.alpha * (one - nn))
            gap, slip = self.gap0[p] - n @ jump @ u, (one - nn) @ (jump @ u - self.before[p])
            tau = b @ u + stiff * gap * n - self.alpha * stiff * slip
            force, d = np.zeros(self.d), np.zeros((self.d, self.d))
            if self.paired[p]:
                force, d, statuses[p] = numpy_projection(name, bilateral, n, tau)
            forces[p] = force
            adjoint = theta * b.T @ np.linalg.inv(weight)
            residual += self.jxw[p] * (-jump.T @ force + adjoint @ (force - b @ u))
            pull = d @ (weight @ jump - b)
            tangent += self.jxw[p] * (jump.T @ pull - adjoint @ (d @ weight @ jump + (one - d) @ b))
        return forces, statuses, residual, tangent


def dots(a, b):
    """Scalar products (n,) of rows."""
    return np.einsum("pd,pd->p", a, b)


SIZES = [(2, 2), (3, 4), (2, 0), (3, 0)]
sizes = pytest.mark.parametrize("d, targets", SIZES)


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@sizes
def test_jump_traction_augmented_traction(d, targets, alpha):
    points = Points(d, targets, alpha)
    rng = np.random.default_rng(1)
    jumps, tractions = points.operators()
    for u in (points.u, rng.normal(size=points.u.shape)):
        traction, jump, tau = points.evaluate(u)
        np.testing.assert_allclose(jump, jumps @ u.ravel(), atol=1e-13)
        np.testing.assert_allclose(traction, tractions @ u.ravel(), atol=1e-12)
        stiff = points.gamma[points.facet][:, None]
        gap = points.gap0 - dots(jump, points.normal)
        expected = traction + stiff * gap[:, None] * points.normal
        expected -= alpha * stiff * tangential(jump - points.before, points.normal)
        np.testing.assert_allclose(tau, expected, atol=1e-12)
        wanted = np.arange(len(points.facet)) % 2 == 0
        for some, all_ in zip(points.evaluate(u, wanted), (traction, jump, tau), strict=True):
            np.testing.assert_array_equal(some, np.where(wanted[:, None], all_, 0.0))


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", LAWS)
@sizes
def test_residual_and_tangent_are_those_of_numpy(d, targets, name, bilateral, alpha):
    points, law = Points(d, targets, alpha), law_of(name)
    paired, tension = points.paired, dots(points.evaluate(points.u)[2], points.normal) > 0.0
    assert np.any(tension[paired]) and np.any(~tension[paired]) and not np.all(paired)
    for theta in THETAS:
        force, status, residual, tangent = points.twin(points.u, name, theta, bilateral)
        kinds = {STICK, SLIP} if bilateral or name == "tresca" else {OPEN, STICK, SLIP}
        assert set(status[paired]) == kinds
        np.testing.assert_allclose(points.residual(points.u, law, theta, bilateral), residual, atol=1e-11)
        np.testing.assert_allclose(points.tangent(points.u, law, theta, bilateral), tangent, atol=1e-11)
    compiled, _, found = points.projected(points.u, law, bilateral)
    np.testing.assert_array_equal(found, status)
    np.testing.assert_allclose(compiled, force, atol=1e-12)
    assert np.all(found[~paired] == OPEN) and np.all(compiled[~paired] == 0.0)


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@sizes
def test_symmetry_of_the_tangent(d, targets, alpha):
    """Symmetric for theta = 1 unless the bound grows with the pressure where a point slips."""
    points = Points(d, targets, alpha)
    cases = [("tresca", law_of("tresca"), True), ("stick", FREE_LAW, True)]
    cases += [(name, law_of(name), False) for name in LAWS if name != "tresca"]
    for bilateral in (False, True):
        for name, law, symmetric in cases:
            for theta in THETAS:
                k = points.tangent(points.u, law, theta, bilateral)
                off = np.abs(k - k.T).max() / np.abs(k).max()
                assert off < 1e-14 if symmetric and theta == 1.0 else off > 1e-3, (name, theta)


def test_tangent_counts_what_has_no_place():
    points = Points(2, 2)
    missing = points.add_tangent(points.u, FREE_LAW, 0.0, True, [points.cells])[-1]
    # each coupled point: 4 source and 2 target nodes, less the 4 x 4 that have a place
    assert missing == np.sum(points.paired) * (6 * 6 - 4 * 4)
    # open points couple nothing for theta = 0, their source cell otherwise; nor do points without partner
    points.gap0 += 1e6
    for theta in THETAS:
        assert points.add_tangent(points.u, law_of("coulomb"), theta, False, [points.cells])[-1] == 0


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("alpha", [1.0, 0.7])
def test_surfaces_that_just_touch_are_tied(name, theta, alpha):
    """tau = 0 exactly, no slip: no force, and the tangent of a glued pair."""
    points = Points(3, 4, alpha)
    points.gap0[:], points.before[:] = 0.0, 0.0
    zero = np.zeros_like(points.u)
    assert np.all(points.residual(zero, law_of(name), theta, False) == 0.0)
    k = points.tangent(zero, law_of(name), theta, False)
    np.testing.assert_array_equal(k, points.tangent(zero, FREE_LAW, theta, True))
    jump, b = points.operators()
    glued = np.zeros_like(k)
    for p in range(len(points.facet)):
        nn, stiff = np.outer(points.normal[p], points.normal[p]), points.gamma[points.facet[p]]
        weight = stiff * (nn + alpha * (np.eye(3) - nn))
        if points.paired[p]:
            part = jump[p].T @ (weight @ jump[p] - b[p]) - theta * b[p].T @ jump[p]
        else:
            part = -theta * b[p].T @ np.linalg.inv(weight) @ b[p]
        glued += points.jxw[p] * part
    np.testing.assert_allclose(k, glued, atol=1e-11)


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
