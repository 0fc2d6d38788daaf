"""Contact at finite motion, one point at a time: against plain numpy, by differences, turned, and in balance."""

from itertools import product

import numpy as np
import pytest

from pcontact.assembly.graph import BlockRows
from pcontact.contact.formulation.finite_geometry import (
    CLOSEST,
    FIXED,
    HELD,
    NONE,
    OBSTACLE,
    RAY,
    TIED,
    FinitePartner,
    FiniteSource,
    Motion,
    area_ratios,
    evaluate,
    point_work,
    unplaced,
)
from pcontact.contact.formulation.finite_kernels import (
    Acting,
    FiniteParameters,
    Sides,
    Slopes,
    add_residual,
    add_tangent,
    augment,
    tangent_work,
)
from pcontact.contact.law import OPEN, SLIP, STICK, RowLaw, Tied, View
from pcontact.contact.surface.facet_maps import KIND
from pcontact.element.reference import reference_nodes, shape, shape_gradient

FACETS = [("segment", 1), ("segment", 2), ("triangle", 1), ("triangle", 2), ("quadrilateral", 1), ("quadrilateral", 2)]
# law, status that is expected, and gap in parts of the facet
STATES = {
    "open": ([0.0, 0.4, np.inf], OPEN, 0.2),
    "stick": ([0.0, 50.0, np.inf], STICK, -0.1),
    "slip": ([0.0, 0.02, np.inf], SLIP, -0.1),
    "tresca": ([0.01, 0.0, 0.01], SLIP, 0.02),
    "frictionless": (None, SLIP, -0.1),
}
NAMES = {RAY: "ray", CLOSEST: "closest", HELD: "held", FIXED: "fixed", TIED: "tied", OBSTACLE: "obstacle", NONE: "none"}
EXTRA = 2
GAMMA, ALPHA, WEIGHT, OWN = 3.0, 0.7, 0.37, 0.4


def turn_of(d, angle=1.1):
    """A rotation."""
    if d == 2:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    cross = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


class Setting:
    """A source point, its facet with nodes of the cell behind, and a target facet above it; the source's traction is
    linear in the displacement, with random numbers. Of ``both`` sides that of the target is, too, and linear in the
    reference coordinates; in the plane it is a section through an axis of symmetry."""

    def __init__(self, facet, degree, mode, state, theta, seed=0, both=False):
        random = np.random.default_rng(seed)
        self.facet, self.degree, self.mode, self.theta, self.name = facet, degree, mode, theta, state
        ref = reference_nodes(facet, degree)
        self.nb, count = ref.shape[1], len(ref)
        self.d = d = self.nb + 1
        self.ms, self.mt = count, (0 if mode == OBSTACLE else count)
        self.nn = self.ms + EXTRA
        row, self.status, gap = STATES[state]
        self.law = Tied() if mode == TIED else (None if row is None else RowLaw(row))
        flat = np.column_stack([ref, np.zeros(count)])
        # the plane's normal of a segment along x is -y, that of a face in the xy plane +z
        under = flat * [1.0, -1.0] if d == 2 else flat
        own = under + 0.08 * random.standard_normal(under.shape)
        side = -1.0 if d == 2 else 1.0
        over = flat[:, [1, 0, 2]] if d == 3 else flat * [-1.0, 1.0]
        over = over + 0.08 * random.standard_normal(over.shape) + side * gap * np.eye(d)[-1] + 0.05 * np.eye(d)[0]
        behind = -side * np.eye(d)[-1] + random.standard_normal((EXTRA, d))
        self.x = np.concatenate([own, behind, over])[: self.nn + self.mt]
        self.both, self.others, self.axis = both, EXTRA * both, -3.0 if both and d == 2 else np.inf
        self.x = np.concatenate([self.x, random.standard_normal((self.others, d))])
        n = len(self.x)
        self.u, self.before = 0.02 * random.standard_normal((2, n, d))
        inside = np.full((1, self.nb), 0.3 if facet == "triangle" else 0.15)
        self.shape, self.dshape = shape(facet, degree, inside)[0], shape_gradient(facet, degree, inside)[0]
        along = self.dshape.T @ own
        q = np.linalg.inv(np.linalg.cholesky(along @ along.T))
        self.source = FiniteSource(
            np.zeros(1, np.int64), np.arange(self.nn)[None], np.arange(self.ms)[None], self.shape[None],
            (q @ self.dshape.T)[None], (self.shape @ own)[None], (q @ along)[None], np.array([WEIGHT]),
        )  # fmt: skip
        self.xi0 = inside[0] + 0.05
        if mode == HELD:
            # in the middle of an edge, of a segment at its end
            self.xi0[-1] = 0.0 if facet == "triangle" else -1.0
        offset, normal = 0.1 * random.standard_normal(d), random.standard_normal(d)
        self.normal, self.offset = normal / np.linalg.norm(normal) * side, offset
        if mode == HELD:
            line = self._held(self.u)[1] + 0.2 * self.normal
            self.normal = np.sign(gap) * line / np.linalg.norm(line)
        self.centre = (self.shape @ own) + side * (1.0 + gap) * np.eye(d)[-1] + 0.1 * random.standard_normal(d)
        self.lag = 0.01 * random.standard_normal(d)
        if mode == RAY:
            along = self._normal(self.dshape.T @ (self.x + self.before)[: self.ms])
            self.lag -= along * (along @ self.lag)
        self.frictional = self.law is not None
        self.t0 = 0.2 * random.standard_normal(d) if state != "open" else 0.02 * random.standard_normal(d)
        self.dt, self.adjoint = random.standard_normal((2, self.nn, d, d))
        if both:
            self.adjoint = random.standard_normal((n, d, d))
            self.t2, self.bend = 0.2 * self.t0 + 0.02 * random.standard_normal(d), random.standard_normal(self.nb)
            self.dt2 = random.standard_normal((n - self.nn, d, d))
        alpha, inverse = (ALPHA, 1.0 / ALPHA) if self.frictional else (0.0, 0.0)
        adjoint = self.adjoint[None] if theta else np.zeros((0, *self.adjoint.shape))
        self.parameters = FiniteParameters(
            theta, np.array([alpha]), np.array([inverse]), np.array([GAMMA]), adjoint, np.array([np.inf])
        )
        self.blocks = BlockRows(np.arange(n + 1) * n, np.tile(np.arange(n), n), np.zeros((n * n, d, d)))

    def partner(self, u):
        """What kernels get; of an obstacle, a sphere around `centre`, at u."""
        d, x = self.d, self.shape @ (self.x + u)[: self.ms]
        away = x - self.centre
        length = np.linalg.norm(away)
        xi = np.zeros((1, 2))
        xi[0, : self.nb] = self.xi0
        normal, curved = self.normal[None], np.zeros((0, d, d))
        if self.mode == OBSTACLE:
            normal = -away[None] / length
            curved = ((np.eye(d) - np.outer(away, away) / length**2) / length)[None]
        return FinitePartner(
            np.array([self.mode]), self.nn + np.arange(self.mt)[None], np.array([KIND[self.facet, self.degree]]), xi,
            normal, np.array([0.003]), self.offset[None], np.array([length - 1.0]), curved,
            (self.shape @ (self.x + self.before)[: self.ms])[None] + 0.01,
            self.nn + self.mt + np.arange(self.others)[None],
        )  # fmt: skip

    def motion(self, u):
        return Motion(self.x, u, self.before, self.lag[None])

    def at(self, u):
        """Residual, and what the law says."""
        d, partner = self.d, self.partner(u)
        traction = (self.t0 + np.einsum("aij,aj->i", self.dt, u[: self.nn]))[None]
        placed, tau = unplaced(1, d, self.mt), np.zeros((1, d))
        work = point_work(d, self.ms + self.mt)
        evaluate(self.source, partner, self.motion(u), self.frictional, work, placed)
        ratio = np.full(1, float(self.both))
        area_ratios(self.source, partner, self.motion(u), self.axis, work, ratio)
        traction = OWN * traction if self.both else traction
        if ratio[0]:
            traction = traction - (1.0 - OWN) * ratio[:, None] * self.other(u, placed.xi[0, : self.nb])
        augment(self.parameters, placed, traction, tau)
        slope, normal, live = np.zeros((1, d, d)), placed.normal, placed.live
        if self.frictional:
            force, status = self.law.project(View(live, self.mode == TIED, False), normal, tau, slope)
        else:
            tau_n = float(tau[0] @ normal[0])
            closed = live & (tau_n <= 0.0)
            force, status = closed[:, None] * tau_n * normal, np.where(closed, SLIP, OPEN)
            slope[:] = closed[0] * np.outer(normal, normal)
        out, acting = np.zeros_like(self.x), Acting(traction, tau, force, status, slope)
        add_residual(self.parameters, self.source, partner, placed, acting, out)
        found = {key: getattr(placed, key)[0] for key in ("normal", "gap", "slip", "xi", "live")}
        return out, {**found, "status": status[0], "ratio": ratio[0]}, acting

    def other(self, u, xi):
        """Traction of the target at reference coordinates."""
        return (self.t2 + np.einsum("aij,aj->i", self.dt2, u[self.nn :])) * (1.0 + self.bend @ xi)

    def tangent(self, u):
        self.blocks.values[:] = 0.0
        slopes, (_, found, acting) = Slopes(np.zeros(1, np.int64), self.dt[None]), self.at(u)
        if self.both:
            xi = found["xi"][: self.nb]
            t2, along, other = self.other(u, xi), np.zeros((2, self.d)), (1.0 + self.bend @ xi) * self.dt2
            along[: self.nb] = self.bend[:, None] * t2 / (1.0 + self.bend @ xi)
            rows = np.concatenate([OWN * self.dt, -(1.0 - OWN) * found["ratio"] * other])[None]
            slopes = Slopes(slopes.at, rows, Sides(np.full(1, OWN - 1.0), t2[None], along[None], self.axis))
        missing = add_tangent(
            self.parameters, self.source, self.partner(u), self.motion(u), acting, slopes,
            tangent_work(self.d, self.nn, self.ms, self.mt, self.others), self.blocks,
        )  # fmt: skip
        assert missing == 0
        n = len(self.x)
        return self.blocks.values.reshape(n, n, self.d, self.d).transpose(0, 2, 1, 3).reshape(n * self.d, n * self.d)

    # -- the same in plain numpy ------------------------------------------------------------------------------------

    def _normal(self, tangents):
        n = np.array([tangents[0, 1], -tangents[0, 0]]) if self.d == 2 else np.cross(*tangents)
        return n / np.linalg.norm(n)

    def _target(self, u, xi):
        z = (self.x + u)[self.nn : self.nn + self.mt]
        return (
            shape(self.facet, self.degree, xi[None])[0] @ z,
            shape_gradient(self.facet, self.degree, xi[None])[0].T @ z,
        )

    def _partner(self, u):
        """xi and g by Newton's method with differences."""
        x, n = self.shape @ (self.x + u)[: self.ms], self._normal(self.dshape.T @ (self.x + u)[: self.ms])

        def wrong(v):
            y, a = self._target(u, v[:-1])
            if self.mode == RAY:
                return y - x - v[-1] * n
            return np.append(a @ (x - y), v[-1] + (y - x) @ self._normal(a))

        v, h = np.append(self.xi0, 0.0), 1e-6
        for _ in range(30):
            jacobian = np.column_stack([(wrong(v + h * e) - wrong(v - h * e)) / (2 * h) for e in np.eye(self.d)])
            v = v - np.linalg.solve(jacobian, wrong(v))
        return v[:-1], v[-1]

    def _held(self, u):
        """xi, and the line from the point to the partner, by differences."""
        x, e, h, s = self.shape @ (self.x + u)[: self.ms], np.eye(self.nb)[0] * (self.nb - 1), 1e-4, 0.0

        def away(v):
            r = self._target(u, self.xi0 + v * e)[0] - x
            return r @ r

        for _ in range(60 * (self.nb - 1)):
            s -= 0.5 * h * (away(s + h) - away(s - h)) / (away(s + h) - 2.0 * away(s) + away(s - h))
        return self.xi0 + s * e, self._target(u, self.xi0 + s * e)[0] - x

    def ratio(self, u, xi, n):
        """Undeformed areas of the target over the source: those of shadows along n, by the stretches of both."""
        def vector(a):
            return np.array([a[0, 1], -a[0, 0]]) if self.d == 2 else np.cross(*a)

        still = np.zeros_like(u)
        own, own0 = (vector(self.dshape.T @ (self.x + w)[: self.ms]) for w in (u, still))
        other, other0 = (vector(self._target(w, xi)[1]) for w in (u, still))
        ratio = np.linalg.norm(other0) / np.linalg.norm(own0) * abs((own @ n) / (other @ n))
        if np.isinf(self.axis):
            return ratio
        return ratio * (self._target(still, xi)[0][0] - self.axis) / (self.shape @ self.x[: self.ms, 0] - self.axis)

    def twin(self, u):
        """Residual, normal, gap and tangential slip from the formulas."""
        one = np.eye(self.d)
        x, old = (self.shape @ (self.x + w)[: self.ms] for w in (u, self.before))
        xi, g = self._partner(u)
        y, a = self._target(u, xi)
        n, old_n = (self._normal(self.dshape.T @ (self.x + w)[: self.ms]) for w in (u, self.before))
        n = n if self.mode == RAY else -self._normal(a)
        old_y, old_a = self._target(self.before, xi)
        z, beside = old_y - old - (g * old_n if self.mode == RAY else 0.0), old_a.T
        if self.mode == RAY:
            beside = (one - np.outer(old_n, old_n)) @ beside
        zeta = [np.linalg.lstsq(b, v, rcond=None)[0] for b, v in ((old_a.T, z), (beside, self.lag))]
        slip = (one - np.outer(n, n)) @ (a.T @ sum(zeta))
        g = g + 0.003
        t = self.t0 + np.einsum("aij,aj->i", self.dt, u[: self.nn])
        if self.both:
            t = OWN * t - (1.0 - OWN) * self.ratio(u, xi, n) * self.other(u, xi)
        tau = t + GAMMA * (g * n - (ALPHA * slip if self.frictional else 0.0))
        tau_n = tau @ n
        tau_t = tau - tau_n * n
        push = min(tau_n, 0.0)
        force = push * n
        weight = np.outer(n, n)
        if self.frictional:
            row = self.law.row
            rho = min(max(row[0] - row[1] * tau_n, 0.0), row[2])
            force = force + tau_t * min(1.0, rho / np.linalg.norm(tau_t))
            weight = weight + (one - np.outer(n, n)) / ALPHA
        out = np.zeros_like(self.x)
        out[: len(self.adjoint)] += self.theta * np.einsum("i,aij->aj", weight @ (force - t) / GAMMA, self.adjoint)
        out[: self.ms] -= np.outer(self.shape, force)
        out[self.nn : self.nn + self.mt] += np.outer(shape(self.facet, self.degree, xi[None])[0], force)
        return WEIGHT * out, n, g, slip


def settings(modes, thetas=(0.0, -1.0), states=STATES):
    cases = product(FACETS, modes, states, thetas)
    return [pytest.param((*f, m, s, t), id=f"{f[0]}{f[1]}-{NAMES[m]}-{s}-{t:+.0f}") for f, m, s, t in cases]


def setting(case, both=False):
    """The first of some random settings in which the point has the status that the state says."""
    for seed in range(50):
        one = Setting(*case, seed, both)
        _, found, _ = one.at(one.u)
        if found["live"] == (one.mode != NONE) and found["status"] == (one.status if found["live"] else OPEN):
            return one
    raise AssertionError(f"no setting for {case}")


@pytest.mark.parametrize("both", [False, True], ids=["source", "both"])
@pytest.mark.parametrize("case", settings([RAY, CLOSEST]))
def test_twin_and_difference(case, both):
    """Residual as the formulas say, tangent as its differences, forces in balance."""
    one = setting(case, both)
    residual, found, _ = one.at(one.u)
    twin, normal, gap, slip = one.twin(one.u)
    scale = np.abs(twin).max() + (one.status == OPEN)
    assert np.abs(residual - twin).max() < 1e-12 * scale
    np.testing.assert_allclose(found["normal"], normal, atol=1e-12)
    np.testing.assert_allclose(found["gap"], gap, atol=1e-12)
    if one.frictional:
        np.testing.assert_allclose(found["slip"], slip, atol=1e-12)
    check_difference(one)
    if one.theta == 0.0:
        assert np.abs(residual.sum(axis=0)).max() < 1e-14


def check_difference(one):
    h, k = 1e-5, one.tangent(one.u)
    difference = np.empty_like(k)
    for column in range(k.shape[1]):
        e = np.zeros(k.shape[1])
        e[column] = h
        e = e.reshape(one.u.shape)
        # of fourth order
        (a, b), (c, e2) = ([one.at(one.u + f * e)[0] for f in (s, -s)] for s in (1.0, 2.0))
        difference[:, column] = (8.0 * (a - b) - (c - e2)).ravel() / (12.0 * h)
    scale = np.abs(k).max() + (one.status == OPEN and one.theta == 0.0)
    assert np.abs(k - difference).max() < 1e-8 * scale


@pytest.mark.parametrize("facet", FACETS, ids=lambda f: f"{f[0]}{f[1]}")
@pytest.mark.parametrize("state", ["open", "slip"])
def test_held(facet, state):
    """The partner is the nearest point of the edge or end, the normal goes there, slip is across it; a point that has
    gone to the other side of a corner has the normal that was found."""
    one = setting((*facet, HELD, state, 0.0))
    _, found, _ = one.at(one.u)
    xi, line = one._held(one.u)
    length = np.linalg.norm(line)
    sign = np.sign(line @ one.normal)
    np.testing.assert_allclose(found["xi"][: one.nb], xi, atol=1e-7)
    np.testing.assert_allclose(found["gap"], sign * length + 0.003, atol=1e-9)
    np.testing.assert_allclose(found["normal"], sign * line / length, atol=1e-7)
    places = [one.shape @ (one.x + w)[: one.ms] - one._target(w, xi)[0] for w in (one.u, one.before)]
    slip = places[0] - places[1] + one.lag
    expected = slip - found["normal"] * (found["normal"] @ slip) if one.frictional else 0.0
    np.testing.assert_allclose(found["slip"], expected, atol=1e-7)
    moved = one.u.copy()
    # beside the corner, or the edge along its first tangent
    aside = turn_of(2, np.pi / 2) @ one.normal if one.d == 2 else np.cross(one.normal, one._target(one.u, xi)[1][0])
    moved[: one.nn] += line + 0.1 * aside / np.linalg.norm(aside)
    np.testing.assert_array_equal(one.at(moved)[1]["normal"], one.normal)


@pytest.mark.parametrize("case", settings([HELD], states=["slip", "tresca", "frictionless"])
                         + settings([FIXED, OBSTACLE], states=["slip", "frictionless"])
                         + settings([NONE], thetas=[-1.0], states=["slip", "frictionless"])
                         + settings([TIED], states=["stick"]))  # fmt: skip
@pytest.mark.parametrize("both", [False, True], ids=["source", "both"])
def test_difference_of_other_partners(case, both):
    """Frozen normals, tied points, a sphere, and points without a partner."""
    one = setting(case, both and case[2] != OBSTACLE)
    residual, _, _ = one.at(one.u)
    check_difference(one)
    if one.theta == 0.0 and one.mode != OBSTACLE:
        assert np.abs(residual.sum(axis=0)).max() < 1e-14


@pytest.mark.parametrize("mode", [OBSTACLE, CLOSEST, RAY], ids=NAMES.get)
def test_tangent_of_deep_overlap(mode):
    """Half of what turns and moves counts at twice the depth, and all of it above."""
    one = setting(("quadrilateral", 1, mode, "slip", 0.0))
    overlap = -one.at(one.u)[1]["gap"]
    assert overlap > 0.01

    def tangent(depth):
        one.parameters = one.parameters._replace(depth=np.array([depth]))
        return one.tangent(one.u)

    full, half, none = tangent(np.inf), tangent(0.5 * overlap), tangent(0.0)
    # rounding errors of the overlap are others in another kernel
    assert (tangent(1.000001 * overlap) == full).all() and np.abs(full - none).max() > 1e-3 * np.abs(full).max()
    np.testing.assert_allclose(half, 0.5 * (full + none), atol=1e-13 * np.abs(full).max())


@pytest.mark.parametrize("facet", FACETS, ids=lambda f: f"{f[0]}{f[1]}")
def test_tangent_of_an_overlap_without_bound(facet):
    """Where nothing is left of what turns and moves, not of slip either, a point that sticks has the tangent of a
    frozen partner."""
    one = setting((*facet, CLOSEST, "stick", 0.0))
    one.parameters = one.parameters._replace(depth=np.zeros(1))
    found, tangent = one.at(one.u)[1], one.tangent(one.u)
    one.mode, one.xi0, one.normal = FIXED, found["xi"][: one.nb], found["normal"]
    frozen = one.tangent(one.u)
    assert found["gap"] < 0.0 and one.at(one.u)[1]["status"] == STICK
    np.testing.assert_allclose(tangent, frozen, atol=1e-12 * np.abs(frozen).max())


@pytest.mark.parametrize("facet", FACETS, ids=lambda f: f"{f[0]}{f[1]}")
@pytest.mark.parametrize("mode", [RAY, CLOSEST], ids=NAMES.get)
def test_turned(facet, mode):
    """Gap and slip do not change where one of the two states, or both, are turned; the lag belongs to the old one."""
    one = Setting(*facet, mode, "stick", 0.0)
    _, still, _ = one.at(one.u)
    q = turn_of(one.d)

    def turned(w):
        return (one.x + w) @ q.T - one.x

    _, both, _ = one.at(turned(one.u))
    np.testing.assert_allclose(both["gap"], still["gap"], atol=1e-13)
    np.testing.assert_allclose(both["slip"], q @ still["slip"], atol=1e-13)
    np.testing.assert_allclose(both["normal"], q @ still["normal"], atol=1e-13)
    one.before, one.lag = turned(one.before), q @ one.lag
    _, old, _ = one.at(one.u)
    np.testing.assert_allclose(old["slip"], still["slip"], atol=1e-13)


@pytest.mark.parametrize("mode", [RAY, CLOSEST], ids=NAMES.get)
@pytest.mark.parametrize("facet", FACETS, ids=lambda f: f"{f[0]}{f[1]}")
def test_beyond(facet, mode):
    """A facet goes on beyond its edge for a while; farther away a point has no partner, and nothing acts."""
    one = Setting(*facet, mode, "stick", 0.0)
    size, live = 1.0 if facet[0] == "triangle" else 2.0, []
    for part in (0.1, 2.0):
        u = one.u.copy()
        u[one.nn :] += part * size * np.eye(one.d)[0] * (1.0 if one.d == 2 else -1.0)
        residual, found, _ = one.at(u)
        live.append(found["live"])
        assert found["live"] or not residual.any()
    assert live == [True, False]


@pytest.mark.parametrize("mode", [RAY, CLOSEST], ids=NAMES.get)
def test_small_motion(mode):
    """For small motions along surfaces that touch slip is the change of the jump."""
    one = Setting("quadrilateral", 1, mode, "stick", 0.0)
    one.x[:, 2] = 0.0
    (one.before, u), one.lag = 1e-6 * np.random.default_rng(1).standard_normal((2, *one.x.shape)), np.zeros(3)
    own = one.x[: one.ms]
    along = one.dshape.T @ own
    q = np.linalg.inv(np.linalg.cholesky(along @ along.T))
    one.source = one.source._replace(
        x=(one.shape @ own)[None], tangent=(q @ along)[None], slope=(q @ one.dshape.T)[None]
    )
    _, found, _ = one.at(u)
    weight = shape("quadrilateral", 1, found["xi"][None])[0]
    jump = one.shape @ (u - one.before)[: one.ms] - weight @ (u - one.before)[one.nn :]
    np.testing.assert_allclose(found["slip"][:2], jump[:2], atol=1e-10)
