"""Soft layers: the curve against plain numbers, tangents of pairs against differences."""

import numpy as np
import pytest

from pcontact.contact.formulation.layer import Layer, turned
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.scene.model import Contact
from pcontact.simulation import Simulation
from tests.support.finite_contact import mesh, slanted, two
from tests.support.pairs import bodies, motion, pair, residual_of
from tests.support.small import SELF, blocks_file, dense_item, make_space, vector_of

# begins at a gap, softer and stiffer pieces
CURVE = ((-0.02, 0.0), (0.0, 0.1), (0.03, 0.13), (0.05, 0.6))
LAWS = {"none": {}, "coulomb": {"friction": 0.3}, "adhesion": {"friction": 0.3, "adhesion": 0.02}}


def plain(curve, closing):
    """Pressure over the overclosure, point by point; negative before the curve begins."""
    (h0, p0), *rest = curve
    for h1, p1 in rest:
        if closing <= h1 or (h1, p1) == rest[-1]:
            return p0 + (p1 - p0) * (closing - h0) / (h1 - h0)
        h0, p0 = h1, p1
    raise AssertionError


@pytest.mark.parametrize("bilateral", [False, True])
def test_curve(bilateral):
    contact = Contact("a", "b", theta=0.0, gamma0=2.0, pressure_overclosure=CURVE, bilateral=bilateral)
    gap = np.linspace(-0.0812, 0.0613, 57)
    method = Layer(contact, np.where(np.arange(57) % 2 == 0, 0.5, 3.0), 0.5)
    tau, ratio = method.normal(gap)
    gamma = method.gamma
    inside = gap <= 0.02
    expected = [-plain(CURVE, -g) for g in gap]
    expected = np.where(inside | bilateral, expected, gamma * (gap - 0.02))
    np.testing.assert_allclose(tau, expected, atol=1e-15)
    step = 1e-7
    ahead, back = (method.normal(gap + s)[0] for s in (step, -step))
    corner = np.min(np.abs(gap[:, None] + np.array(CURVE)[:, 0]), axis=1) < 2 * step
    np.testing.assert_allclose((ratio * gamma)[~corner], ((ahead - back) / (2 * step))[~corner], rtol=1e-6)
    assert method.begins == 0.02
    np.testing.assert_allclose(method.firmest, np.maximum(method.gamma, 23.5))


def test_a_number_is_a_slope():
    method = Layer(Contact("a", "b", theta=0.0, pressure_overclosure=7.0), np.ones(2), 1.0)
    tau, ratio = method.normal(np.array([0.1, -0.2]))
    np.testing.assert_allclose(tau, [0.1 * method.gamma[0], -1.4])
    np.testing.assert_allclose(ratio * method.gamma[0], [method.gamma[0], 7.0])
    assert not method.stiff and Layer(Contact("a", "b", theta=0.0, pressure_overclosure=1e3), np.ones(1), 1.0).stiff


def test_stiffness_of_sticking_points():
    said = {"theta": 0.0, "alpha": 0.5, "pressure_overclosure": 7.0, "stick_stiffness": 3.0}
    method = Layer(Contact("a", "b", friction=0.1, **said), np.array([1.0, 2.0]), 1.0)
    method.begin(np.array([[2.0, 3.0], [3.0, 4.0]]))
    np.testing.assert_array_equal(method.alpha * method.gamma, 3.0)


def test_turned_derivatives():
    rng = np.random.default_rng(0)
    slope, ratio, normal = rng.normal(size=(5, 3, 3)), rng.random(5), rng.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    for k, found in enumerate(turned(slope, ratio, normal)):
        nn = np.outer(normal[k], normal[k])
        np.testing.assert_allclose(found, slope[k] @ (ratio[k] * nn + np.eye(3) - nn), atol=1e-14)


def check_tangent(item, space, u):
    """Against central differences, between whose ends no point changes its piece."""
    rng = np.random.default_rng(2)
    v, h = rng.normal(size=u.shape), 1e-7
    slope = (dense_item(item, vector_of(space, u)) @ v.ravel()).ravel()
    change = (residual_of(item, u + h * v) - residual_of(item, u - h * v)) / (2.0 * h)
    assert np.abs(slope).max() > 0.0
    np.testing.assert_allclose(slope, change, atol=2e-7 * np.abs(slope).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("cell, d", [("quadrilateral", 2), ("tetrahedron", 3)])
def test_tangent_of_a_pair(tmp_path, cell, d, law):
    """Points on all pieces of the curve, and in tension where friction has adhesion."""
    path = blocks_file(tmp_path / "b.msh", cell, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    space = make_space(SELF, path, ["lower", "upper"], 1)
    more = {"pressure_overclosure": CURVE, "stick_stiffness": 4.0 if law == "adhesion" else None}
    item = pair(space, bodies("coulomb", **{"friction": None, **LAWS[law], **more}), radius=0.3)
    item.detect(space.vector(), 1.0)
    seen, pieces = set(), set()
    for depth, slide, tilt in [(0.02, 0.004, 0.2), (0.02, 0.1, 0.2), (0.03, 0.004, 0.08)]:
        u = motion(space, depth, slide, tilt)
        check_tangent(item, space, u)
        state = item.state(vector_of(space, u))
        seen |= set(state["status"])
        near = state["paired"]
        pieces |= set(np.searchsorted(np.array(CURVE)[:, 0], -state["gap"][near]))
        closed = (state["status"] > OPEN) & (state["gap"] < 0.02)
        expected = [plain(CURVE, -gap) for gap in state["gap"][closed]]
        np.testing.assert_allclose(state["pressure"][closed], expected, atol=1e-14)
    assert seen == ({OPEN, SLIP} if law == "none" else {OPEN, STICK, SLIP}) and pieces == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("law", LAWS)
def test_tangent_at_finite_motion(tmp_path, law, search):
    case = two(mesh(slanted, tmp_path / "s.msh"), pressure_overclosure=CURVE, search=search, **LAWS[law])
    simulation = Simulation(case, SELF)
    try:
        space, (item,) = simulation.problem.space, simulation.problem.contacts[0].pairs
        x = space.points[space.owned_local]
        item.detect(space.vector(), 1.0)
        upper = space.component[space.owned_local] == 1
        for slide in (0.003, 0.1):
            u = 0.002 * np.random.default_rng(1).normal(size=x.shape)
            u[upper] += np.column_stack([0 * x[upper, 0] + slide, 0.012 - 0.09 * x[upper, 0] + 0.25 * slide])
            check_tangent(item, space, u)
        state = item.state(vector_of(space, u))
        assert len(set(np.searchsorted(np.array(CURVE)[:, 0], -state["gap"]))) > 3
    finally:
        simulation.close()
