"""Contact with friction: kernels against plain numpy, tangents of pairs against differences, what is known of both."""

import numpy as np
import pytest
from small import DIMENSION, SELF, block_file, blocks_file, dense, dense_item, elasticity, keys, make_space, vector_of
from test_laws import LAWS, law_of, limit_of, numpy_projection

from pcontact.assembly.graph import node_graph
from pcontact.contact import friction
from pcontact.contact.frictional import FrictionalItem
from pcontact.contact.item import ContactItem
from pcontact.contact.laws import OPEN, SLIP, STICK, friction_law
from pcontact.contact.obstacle import RigidObstacle
from pcontact.contact.surface import source_surface, target_surface
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene import amplitude
from pcontact.scene.model import Contact, Obstacle

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
CONSTANTS = lame(10.0, 0.3)
FREE_LAW = np.array([0.0, 1e300, np.inf, 0.0])


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
        self.grad, self.lame = rng.normal(size=(n_points, nn, d)), 0.5 + rng.random((n_facets, 2))
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
            tensor = elasticity(*self.lame[self.facet[p]], self.d)
            for a, node in enumerate(self.cells[self.facet[p]]):
                jump[p, :, node] += self.shape[p, a] * one
                traction[p, :, node] += np.einsum("ijkl,l,j->ik", tensor, self.grad[p, a], self.normal_x[p])
            for m, node in enumerate(self.targets[p]):
                jump[p, :, node] -= self.target_shape[p, m] * one
        return jump.reshape(rows, self.d, -1), traction.reshape(rows, self.d, -1)

    def evaluate(self, u):
        """Traction, jump, tau of the compiled kernels."""
        traction, jump, tau = (np.full_like(self.normal, np.nan) for _ in range(3))
        friction.jumps(u, self.cells, self.targets, self.facet, self.shape, self.target_shape, jump)
        friction.tractions(u, self.cells, self.facet, self.grad, self.lame, self.normal_x, traction)
        friction.augment(
            traction, jump, self.before, self.gap0, self.normal, self.gamma, self.alpha, self.facet, tau
        )
        return traction, jump, tau

    def residual(self, u, law, theta, bilateral):
        """(n d,) of the compiled kernel."""
        traction, _, tau = self.evaluate(u)
        out = np.zeros((self.n, self.d))
        friction.add_residual(
            theta, self.alpha, law, bilateral, self.paired, self.jxw, self.gamma, traction, tau, self.cells,
            self.targets, self.facet, self.shape, self.target_shape, self.grad, self.lame, self.normal_x, self.normal,
            out,
        )  # fmt: skip
        return out.ravel()

    def add_tangent(self, u, law, theta, bilateral, tables):
        """Pattern of the tables, values and missing entries of the compiled kernel."""
        rowptr, columns = node_graph(tables, self.n)
        values = np.zeros((len(columns), self.d, self.d))
        missing = friction.add_tangent(
            theta, self.alpha, law, bilateral, self.paired, self.jxw, self.gamma, self.evaluate(u)[2], self.cells,
            self.targets, self.facet, self.shape, self.target_shape, self.grad, self.lame, self.normal_x, self.normal,
            rowptr, columns, values,
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


def tangential(a, normal):
    """Parts (n, d) of rows across a normal."""
    return a - dots(a, normal)[:, None] * normal


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
    compiled = np.full_like(force, np.nan)
    found = friction.project_all(
        law, bilateral, paired, points.normal, points.evaluate(points.u)[2], compiled
    )
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


def pair(space, contact, radius=1.0, kind=FrictionalItem):
    """Item of a contact whose first search is done by the caller."""
    source = source_surface(space, contact.source, [CONSTANTS] * 2, contact.quadrature)
    if contact.obstacle is None:
        target = target_surface(space, contact.target)
    else:
        target = RigidObstacle(contact.obstacle, amplitude(contact.obstacle.amplitude, 1.0), 1.0)
    more = {} if kind is ContactItem else {"law": friction_law(contact), "alpha": contact.alpha or 1.0}
    return kind(space, contact, source, target, radius, **more)


def bodies(name="coulomb", search="closest_point", theta=0.0, alpha=1.0, **more):
    """Contact of two stacked boxes."""
    said = {**LAWS[name], "gamma0": 1.0, "theta": theta, "alpha": alpha, "search": search, **more}
    return Contact("upper_bottom", "lower_top", **said)


def residual_of(item, array):
    """(n_owned d,)"""
    out = np.zeros((item.space.n_owned, item.space.dim))
    item.residual(vector_of(item.space, array), out)
    return out.ravel()


def state_of(item, array):
    return item.state(vector_of(item.space, array))


def phases(item, array, name):
    """Status of every point, and whether its tangential traction is the largest of the law."""
    state = state_of(item, array)
    size = np.linalg.norm(tangential(state["traction"], state["normal"]), axis=1)
    return np.column_stack([state["status"], size > limit_of(name) * (1.0 - 1e-12)])


def taylor(item, u, v, name):
    """|R(u + h v) - R(u) - h K v| for h and its halves, as parts of the size of the terms.

    The first h is such that no point changes its status.
    """
    slope = dense_item(item, vector_of(item.space, u)) @ v.ravel()
    start, before = residual_of(item, u), phases(item, u, name)
    h = 1.0
    while np.any(phases(item, u + h * v, name) != before):
        h *= 0.25
    assert h > 1e-6
    errors = []
    for part in (0.25 * h, 0.125 * h, 0.0625 * h):
        change = residual_of(item, u + part * v) - start
        errors.append(np.abs(change - part * slope).max() / np.abs(start).max())
    return np.array(errors), np.abs(h * slope).max() / np.abs(start).max()


def check_taylor(item, u, v, name):
    """Second order where a slip direction may turn, exact where the response is linear; returns the statuses."""
    errors, size = taylor(item, u, v, name)
    status = np.unique(state_of(item, u)["status"])
    assert size > 1e-4
    if np.all(errors < 1e-13):
        return status, True
    assert item.space.dim == 3 and SLIP in status
    # large enough to be more than rounding
    assert errors[-1] > 1e-12
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.05)
    assert errors[0] < 0.1 * size
    return status, False


def motion(space, depth, slide, seed=1, noise=0.002):
    """The upper body (the only one) moved down, tilted, drawn apart along x, and everything a little at random."""
    x = space.points[space.owned_local]
    upper = space.component[space.owned_local] == space.component.max()
    u = noise * np.random.default_rng(seed).normal(size=x.shape)
    u[upper, -1] -= depth * (1.0 + 0.8 * (x[upper, 0] - 0.5))
    u[upper, 0] += slide * (x[upper, 0] - 0.5)
    return u


@pytest.fixture(scope="module", params=["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang: some source points have no partner."""
    d = DIMENSION[request.param]
    path = tmp_path_factory.mktemp("stacked") / "blocks.msh"
    blocks_file(path, request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta", THETAS)
def test_tangent_of_a_pair_of_bodies(stacked, theta, search, name, alpha):
    """Open, sticking, slipping, mixed, without partner, in the second load step: always the derivative."""
    space = stacked
    item = pair(space, bodies(name, search, theta, alpha), radius=0.3)
    first = motion(space, 0.02, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    np.testing.assert_allclose(state_of(item, first)["slip"], 0.0, atol=1e-15)
    v = motion(space, 0.01, 0.01, seed=2, noise=0.01)
    seen = {}
    for depth, slide in ((-0.2, 0.0), (0.0, 0.1), (0.1, 0.0), (0.02, 0.3)):
        u = first + motion(space, depth, slide, seed=3)
        status, exact = check_taylor(item, u, v, name)
        seen[tuple(status)] = exact
        k = dense_item(item, vector_of(space, u))
        if theta == 1.0 and name == "tresca":
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    print(name, search, theta, alpha, seen)
