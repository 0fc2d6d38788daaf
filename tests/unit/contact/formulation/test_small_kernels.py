"""Kernels of small strain against plain numpy: with friction and without, tractions of one side and of both."""

import numpy as np
import pytest

from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.contact.formulation import small_kernels as kernels
from pcontact.contact.formulation.methods import Parameters
from pcontact.contact.law import OPEN, SLIP, STICK, RowLaw, View
from pcontact.contact.points import PartnerPoints, SourcePoints, TractionOperator, interpolate, no_excess
from pcontact.contact.traction.small import FacetCells, fill_rows, tractions
from tests.support.laws import LAWS, law_of, numpy_projection
from tests.support.pairs import tangential
from tests.support.small import dense, elasticity

THETAS = [1.0, 0.0, -1.0]
FREE_LAW = np.array([0.0, 1e300, np.inf])
# closed points bear no tangential traction
FRICTIONLESS = np.zeros(3)


class Points:
    """Random arguments of the kernels: points open, sticking and slipping, some without partner.

    The gap and the jump from which slip counts are such that the augmented traction at ``u`` takes random values of
    about 1, whose tangential parts go from far below to far above the bounds. Without friction all is along the contact
    normal. Of ``both`` sides, most partners have a part in the traction.
    """

    def __init__(self, d, targets, friction=True, both=False, alpha=1.0):
        rng = np.random.default_rng(0)
        self.n, self.d, self.alpha, nn, n_facets, n_points = 14, d, alpha, 2 * d, 4, 60
        self.cells = np.array([rng.permutation(8)[:nn] for _ in range(n_facets)])
        self.facet = np.sort(rng.integers(0, n_facets, n_points))
        chosen = [8 + rng.permutation(6)[:targets] for _ in range(n_points)]
        self.targets = np.array(chosen, dtype=np.int64).reshape(n_points, targets)
        self.shape, self.target_shape = rng.random((n_points, nn)), rng.random((n_points, targets))
        # a node of the cell that is not on the facet
        self.shape[:, -1] = 0.0
        self.paired = rng.random(n_points) < 0.8
        self.speaks = self.paired & (rng.random(n_points) < 0.7) & both
        normal = rng.normal(size=(n_points, d))
        self.normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        axes, along = (np.eye(d)[None], self.normal) if friction else (self.normal[:, None], np.ones((n_points, 1)))
        rows = rng.normal(size=(n_points, nn + (targets if both else 0), axes.shape[1], d))
        rows[~self.speaks, nn:] = 0.0
        self.operator = TractionOperator(axes, along, rows, nn + targets * self.speaks)
        self.jxw, self.gamma = 0.1 + rng.random(n_points), 1.0 + rng.random(n_points)
        self.u = rng.normal(size=(self.n, d))
        wanted = rng.normal(size=along.shape) * np.exp(rng.uniform(-3.0, 1.0, n_points))[:, None]
        self._reach(wanted, rng.normal(size=n_points))

    def _reach(self, across, along):
        """Choose gap and reference of the slip for an augmented traction; what is left free is random."""
        jump, b = self.matrices()
        jump, traction, normal = jump @ self.u.ravel(), b @ self.u.ravel(), self.operator.normal
        self.gap0 = (along - dots(traction, normal)) / self.gamma + dots(jump, normal)
        slip = tangential(traction - across, normal) / (self.alpha * self.gamma[:, None])
        self.before = jump - slip + 0.3 * along[:, None] * normal

    def matrices(self):
        """Jump N and traction B as matrices (np, m, n d)."""
        rows, (axes, _, operator, _) = len(self.facet), self.operator
        jump, traction = (np.zeros((rows, axes.shape[1], self.n, self.d)) for _ in range(2))
        for p in range(rows):
            nodes = np.append(self.cells[self.facet[p]], self.targets[p])
            part, e = np.append(self.shape[p], -self.target_shape[p]), axes[min(p, len(axes) - 1)]
            for a, node in enumerate(nodes):
                jump[p, :, node] += part[a] * e
                if a < operator.shape[1]:
                    traction[p, :, node] += operator[p, a]
        return jump.reshape(*jump.shape[:2], -1), traction.reshape(*jump.shape[:2], -1)

    def evaluate(self, u, wanted=None):
        """Traction, jump, tau of the compiled kernels."""
        wanted = np.ones(len(self.facet), dtype=bool) if wanted is None else wanted
        traction, jump, tau = (np.full_like(self.operator.normal, np.nan) for _ in range(3))
        kernels.evaluate(u, *self.sides, self.operator, wanted, traction, jump)
        arguments = traction, jump, self.before, wanted, tau
        kernels.augment(self.parameters(0.0), self.operator, self.gap0, *arguments)
        return traction, jump, tau

    def parameters(self, theta):
        """Parameters as kernels take them."""
        return Parameters(theta, np.full_like(self.gamma, self.alpha), self.gamma)

    @property
    def sides(self):
        """The arrays as kernels take them."""
        none = np.zeros((len(self.facet), 0, self.d))
        source = SourcePoints(self.facet, self.cells, self.shape, self.jxw, self.normal, none, none, self.gamma)
        return source, PartnerPoints(self.targets, self.target_shape, self.normal, self.gap0)

    def projected(self, u, law, bilateral):
        """P, D and status of a law."""
        tau = self.evaluate(u)[2]
        force, slope, status = np.zeros_like(tau), np.zeros((*tau.shape, tau.shape[1])), self.facet * 0
        normal, view = self.operator.normal, View(self.paired, bilateral, False)
        RowLaw(law).bounded(view, normal, tau, force, slope, status)
        return force, slope, status

    def residual(self, u, law, theta, bilateral):
        """(n d,) of the compiled kernel."""
        out, (force, _, status) = np.zeros((self.n, self.d)), self.projected(u, law, bilateral)
        traction = self.evaluate(u)[0]
        kernels.add_residual(self.parameters(theta), *self.sides, self.operator, traction, force, status, out)
        return out.ravel()

    def add_tangent(self, u, law, theta, bilateral, tables):
        """Pattern of the tables, values and missing entries of the compiled kernel."""
        rowptr, columns = node_graph(tables, self.n)
        values = np.zeros((len(columns), self.d, self.d))
        _, slope, status = self.projected(u, law, bilateral)
        excess = no_excess(self.shape.shape[1], self.d)
        missing = kernels.add_tangent(
            self.parameters(theta), *self.sides, self.operator, excess, status, slope,
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
        """P (np, m), status, residual, tangent as they stand in the docs: (R) and its Jacobian, with matrices."""
        u, size, (jumps, tractions) = u.ravel(), u.size, self.matrices()
        residual, tangent, m = np.zeros(size), np.zeros((size, size)), self.operator.normal.shape[1]
        forces, statuses, one = np.zeros_like(self.before), np.zeros(len(self.facet), dtype=int), np.eye(m)
        for p, (jump, b, n) in enumerate(zip(jumps, tractions, self.operator.normal, strict=True)):
            nn, stiff = np.outer(n, n), self.gamma[p]
            weight = stiff * (nn + self.alpha * (one - nn))
            gap, slip = self.gap0[p] - n @ jump @ u, (one - nn) @ (jump @ u - self.before[p])
            tau = b @ u + stiff * gap * n - self.alpha * stiff * slip
            force, d = np.zeros(m), np.zeros((m, m))
            if self.paired[p] and m > 1:
                force, d, statuses[p] = numpy_projection(name, bilateral, n, tau)
            elif self.paired[p] and (tau[0] <= 0.0 or bilateral):
                force, d, statuses[p] = tau, one, STICK
            forces[p] = force
            adjoint = theta * b.T @ np.linalg.inv(weight)
            residual += self.jxw[p] * (-jump.T @ force + adjoint @ (force - b @ u))
            pull = d @ (weight @ jump - b)
            tangent += self.jxw[p] * (jump.T @ pull - adjoint @ (d @ weight @ jump + (one - d) @ b))
        return forces, statuses, residual, tangent


def dots(a, b):
    """Scalar products (n,) of rows."""
    return np.einsum("pd,pd->p", a, b)


# dimension, nodes of the partners, whether there is friction, whether both sides have a part in the traction
CASES = [(2, 2, True, False), (3, 4, True, False), (2, 0, True, False), (3, 0, False, False), (2, 2, False, False),
         (3, 4, False, False), (2, 4, True, True), (3, 4, True, True), (2, 4, False, True), (3, 4, False, True)]
cases = pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@cases
def test_jump_traction_augmented_traction(case, alpha):
    points = Points(*case, alpha)
    rng = np.random.default_rng(1)
    jumps, tractions = points.matrices()
    for u in (points.u, rng.normal(size=points.u.shape)):
        traction, jump, tau = points.evaluate(u)
        np.testing.assert_allclose(jump, jumps @ u.ravel(), atol=1e-13)
        np.testing.assert_allclose(traction, tractions @ u.ravel(), atol=1e-12)
        stiff, normal = points.gamma[:, None], points.operator.normal
        gap = points.gap0 - dots(jump, normal)
        expected = traction + stiff * gap[:, None] * normal
        expected -= alpha * stiff * tangential(jump - points.before, normal)
        np.testing.assert_allclose(tau, expected, atol=1e-12)
        wanted = np.arange(len(points.facet)) % 2 == 0
        for some, all_ in zip(points.evaluate(u, wanted), (traction, jump, tau), strict=True):
            np.testing.assert_array_equal(some, np.where(wanted[:, None], all_, 0.0))


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", LAWS)
@cases
def test_residual_and_tangent_are_those_of_numpy(case, name, bilateral, alpha):
    friction = case[2]
    points, law = Points(*case, alpha), law_of(name) if friction else FRICTIONLESS
    paired, tension = points.paired, dots(points.evaluate(points.u)[2], points.operator.normal) > 0.0
    assert np.any(tension[paired]) and np.any(~tension[paired]) and not np.all(paired)
    for theta in THETAS:
        force, status, residual, tangent = points.twin(points.u, name, theta, bilateral)
        kinds = {STICK, SLIP} if bilateral or name == "tresca" else {OPEN, STICK, SLIP}
        assert not friction or set(status[paired]) == kinds
        np.testing.assert_allclose(points.residual(points.u, law, theta, bilateral), residual, atol=1e-11)
        np.testing.assert_allclose(points.tangent(points.u, law, theta, bilateral), tangent, atol=1e-11)
    compiled, _, found = points.projected(points.u, law, bilateral)
    np.testing.assert_array_equal(found, status)
    np.testing.assert_allclose(compiled, force, atol=1e-12)
    assert np.all(found[~paired] == OPEN) and np.all(compiled[~paired] == 0.0)


@pytest.mark.parametrize("alpha", [1.0, 0.7])
@cases
def test_symmetry_of_the_tangent(case, alpha):
    """Symmetric for theta = 1 unless the bound grows with the pressure where a point slips."""
    points = Points(*case, alpha)
    laws = [("tresca", law_of("tresca"), True), ("stick", FREE_LAW, True)]
    laws += [(name, law_of(name), False) for name in LAWS if name != "tresca"]
    for bilateral in (False, True):
        for name, law, symmetric in laws if case[2] else [("frictionless", FRICTIONLESS, True)]:
            for theta in THETAS:
                k = points.tangent(points.u, law, theta, bilateral)
                off = np.abs(k - k.T).max() / np.abs(k).max()
                assert off < 1e-14 if symmetric and theta == 1.0 else off > 1e-3, (name, theta)


@pytest.mark.parametrize("friction", [True, False])
def test_tangent_counts_what_has_no_place(friction):
    points = Points(2, 2, friction)
    law = FREE_LAW if friction else FRICTIONLESS
    missing = points.add_tangent(points.u, law, 0.0, True, [points.cells])[-1]
    # coupled points of other nodes than those before: 3 source and 2 target nodes on facets, by all 4 and 2, less the
    # 3 x 4 that have a place
    nodes = np.column_stack([points.facet, points.targets])[points.paired]
    assert missing == (1 + np.sum(np.any(np.diff(nodes, axis=0), axis=1))) * (5 * 6 - 3 * 4)
    # open points couple nothing for theta = 0, their source cell otherwise; nor do points without partner
    points.gap0 += 1e6
    for theta in THETAS:
        law = law_of("coulomb") if friction else FRICTIONLESS
        assert points.add_tangent(points.u, law, theta, False, [points.cells])[-1] == 0


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("case", CASES[1::2], ids=lambda case: "-".join(map(str, case)))
def test_surfaces_that_just_touch_are_tied(case, name, theta):
    """tau = 0 exactly, no slip: no force, and the tangent of a glued pair."""
    points, law = Points(*case, 0.7), law_of(name) if case[2] else FRICTIONLESS
    points.gap0[:], points.before[:] = 0.0, 0.0
    zero = np.zeros_like(points.u)
    assert np.all(points.residual(zero, law, theta, False) == 0.0)
    k = points.tangent(zero, law, theta, False)
    np.testing.assert_array_equal(k, points.tangent(zero, FREE_LAW, theta, True))
    jump, b = points.matrices()
    glued, normal = np.zeros_like(k), points.operator.normal
    for p in range(len(points.facet)):
        nn, stiff = np.outer(normal[p], normal[p]), points.gamma[p]
        weight = stiff * (nn + 0.7 * (np.eye(len(nn)) - nn))
        if points.paired[p]:
            part = jump[p].T @ (weight @ jump[p] - b[p]) - theta * b[p].T @ jump[p]
        else:
            part = -theta * b[p].T @ np.linalg.inv(weight) @ b[p]
        glued += points.jxw[p] * part
    np.testing.assert_allclose(k, glued, atol=1e-11)


@pytest.mark.parametrize("d", [2, 3])
def test_interpolate(d):
    points, out = Points(d, 0), np.full((60, d), np.nan)
    interpolate(points.u, points.cells, points.facet, points.shape, out)
    known = np.einsum("pa,pad->pd", points.shape, points.u[points.cells[points.facet]])
    np.testing.assert_allclose(out, known, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("friction", [False, True])
def test_rows_are_those_of_the_stress(d, friction):
    """rows . u = e . sigma(u) n_X for any gradients and normals, and what is evaluated without them."""
    rng = np.random.default_rng(5)
    n_points, nn = 6, 5
    cells = FacetCells(*rng.normal(size=(2, n_points, nn, d)), 1.0 + rng.random(n_points), rng.normal(size=(6, d)))
    axes = np.eye(d)[None] if friction else rng.normal(size=(n_points, 1, d))
    factor, u = rng.normal(size=n_points), rng.normal(size=(nn, d))
    out = np.full((n_points, nn + 3, axes.shape[1], d), np.nan)
    fill_rows(np.arange(n_points), cells, axes, factor, out)
    assert np.all(np.isnan(out[:, nn:]))
    values = np.empty((n_points, d))
    point = np.arange(n_points)
    table = np.tile(np.arange(nn), (n_points, 1))
    source = SourcePoints(point, table, out[:, 0, 0], point, cells.normal, cells.grad, cells.volumetric, cells.mu)
    tractions(u, source, np.ones(n_points, dtype=bool), values)
    for p in range(n_points):
        sigma = np.einsum("ijkl,ak,al->ij", elasticity(0.0, cells.mu[p], d), u, cells.grad[p])
        sigma += np.sum(cells.volumetric[p] * u) * np.eye(d)
        known = sigma @ cells.normal[p]
        np.testing.assert_allclose(values[p], known, rtol=1e-12, atol=1e-12)
        found = np.einsum("akj,aj->k", out[p, :nn], u)
        np.testing.assert_allclose(found, factor[p] * axes[min(p, len(axes) - 1)] @ known, rtol=1e-11, atol=1e-12)
    kept = out.copy()
    out[[1, 4]] = np.nan
    fill_rows(np.array([1, 4]), cells, axes, factor, out)
    np.testing.assert_array_equal(out, kept)
