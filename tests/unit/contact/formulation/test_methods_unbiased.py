"""Unbiased contact: patch test, swapped surfaces, tangents against differences, rings, memory, ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh, parse, running
from drivers.cases.hertz import check as check_hertz
from drivers.cases.hertz import generate, make_options, make_scene
from drivers.cases.patch import errors, scene
from drivers.cases.rings import measure, ring_scene
from meshes import rings, two_blocks
from pcontact.contact.formulation.methods import GAMMA0, contacts_of_halves, halved
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import plastic_constants
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Load, Output
from tests.support.laws import LAWS
from tests.support.pairs import STEPS, by_key, check_taylor, field, motion, pair, residual_of, state_of
from tests.support.plastic import SOFT, flowing
from tests.support.plastic import check as check_plastic
from tests.support.plastic import items as plastic_items
from tests.support.plastic import taylor as taylor_plastic
from tests.support.restarts import Keep, run
from tests.support.small import DIMENSION, SELF, Together, blocks_file, dense_item, make_space, vector_of

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
ROUNDOFF = 1e-9


def both(contact, make):
    """An unbiased contact from halves that `make` makes of a contact."""
    halves = [make(one) for one in contacts_of_halves(contact, False)]
    for half in halves:
        half.source = half._stressed = half.terms.source = half.terms.traction.source = halved(half.source)
    return Together(contact, halves)


def unbiased(space, name, radius=0.3, **said):
    """Unbiased contact of two stacked boxes."""
    said = {"gamma0": 1.0, "theta": 0.0, "search": "closest_point", "alpha": 1.0, **LAWS.get(name, {}), **said}
    contact = Contact("upper_bottom", "lower_top", unbiased=True, **said)
    return both(contact, lambda one: pair(space, one, radius))


# -- the patch test -----------------------------------


@pytest.mark.slow
@pytest.mark.parallel
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "cell, lower, upper", [("triangle", 3, 4), ("quadrilateral", 3, 4), ("tetrahedron", 2, 2), ("hexahedron", 2, 2)]
)
def test_patch(shared_tmp, cell, lower, upper, order, theta):
    """Exact where the source facets are cut (in the plane) or match; pressure at the points of both sides."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", DIMENSION[cell], lower, upper, cell)
    search = "ray_tracing" if order == 1 else "closest_point"
    case = scene(path, DIMENSION[cell], order, theta=theta, search=search, unbiased=True)
    with running(case) as (simulation, converged):
        assert converged and max(errors(simulation)) < ROUNDOFF
        (item,) = simulation.problem.contacts
        summary = item.summary(simulation.stepper.u)
    # the two sides' means: a unit length (area) of pressure 1e5
    assert summary["area"] == pytest.approx(1.0, rel=1e-9)
    assert summary["force"][-1] == pytest.approx(-1e5, rel=1e-9)
    assert summary["slip"] == WORLD.allreduce(len(item.source.facet)) and summary["open"] == 0


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("traction", ["both", "source"])
def test_patch_between_bodies_of_unlike_stiffness(tmp_path, traction, theta):
    """Both sides have one gamma where the traction is that of both, else that of their own cells."""
    path = make_mesh(two_blocks, tmp_path / "b.msh", 2, 3, 4, "quadrilateral")
    case = scene(path, 2, theta=theta, unbiased=True, traction=traction)
    soft = case.materials["elastic"]
    case.materials["soft"] = type(soft)(E=1e-2 * soft.E, nu=0.0)
    case.bodies[0].material = "soft"
    with running(case) as (simulation, converged):
        assert converged
        (item,) = simulation.problem.contacts
        upper, lower = (pair.method.gamma for pair in item.pairs)
        ratio = 1.0 if traction == "both" else 100.0 * 4.0 / 3.0
        np.testing.assert_allclose(upper.mean() / lower.mean(), ratio, rtol=1e-12)
        pressure = item.state(simulation.stepper.u)["pressure"]
    # two springs one behind the other
    np.testing.assert_allclose(pressure, 0.1 / (1.0 / 2e6 + 1.0 / 2e4), rtol=1e-9)


# -- source and target are alike ----------------------


def slanted(path, dim, friction, theta, source="upper_bottom", target="lower_top"):
    """Blocks of unlike meshes, pressed unevenly and dragged."""
    more = {"friction": friction} if friction else {}
    case = scene(path, dim, theta=theta, source=source, target=target, unbiased=True, **more)
    case.displacements = case.displacements[:2]
    case.displacements[0].value = [0.0] * dim
    case.displacements[1].value = [0.05, *[0.0] * (dim - 2), -0.1]
    case.materials["elastic"].nu = 0.3
    case.loads = [Load("upper_right", traction=[0.0] * (dim - 1) + [2e4])]
    case.steps.count = 2
    case.petsc = {"snes_rtol": "1e-14", "snes_stol": "0", "ksp_type": "preonly", "pc_type": "lu"}
    return case


def displacement(case):
    with running(case) as (simulation, converged):
        assert converged
        space, (item,) = simulation.problem.space, simulation.problem.contacts
        u = simulation.stepper.u
        return by_key(space, u.getArray().reshape(-1, space.dim)), item.summary(u)


@pytest.mark.parametrize("friction, theta", [(0.0, 0.0), (0.0, 1.0), (0.3, 0.0), (0.3, -1.0)])
@pytest.mark.parametrize("dim", [2, 3])
def test_swapping_source_and_target_changes_nothing(tmp_path, dim, friction, theta):
    path = make_mesh(two_blocks, tmp_path / "b.msh", dim, 2, 3, None)
    one, first = displacement(slanted(path, dim, friction, theta))
    other, second = displacement(slanted(path, dim, friction, theta, "lower_top", "upper_bottom"))
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-10 * np.abs(one).max())
    force = np.array(first["force"])
    np.testing.assert_allclose(second["force"], -force, rtol=0.0, atol=1e-9 * np.abs(force).max())
    assert [first[key] for key in ("open", "stick", "slip")] == [second[key] for key in ("open", "stick", "slip")]
    assert second["area"] == pytest.approx(first["area"], rel=1e-9) and first["area"] > 0.3


# -- tangents -----------------------------------------


@pytest.fixture(scope="module", params=["quadrilateral", "tetrahedron"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang: some points have no partner."""
    d = DIMENSION[request.param]
    path = tmp_path_factory.mktemp("stacked") / "blocks.msh"
    blocks_file(path, request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


@pytest.mark.parametrize("name", ["none", "coulomb", "tresca"])
@pytest.mark.parametrize("theta, search", [(1.0, "closest_point"), (0.0, "ray_tracing"), (-1.0, "closest_point")])
def test_tangent(stacked, theta, search, name):
    """Open, sticking, slipping, mixed, in the second load step: always the derivative, symmetric where it can be."""
    space = stacked
    item = unbiased(space, name, search=search, theta=theta, alpha=0.7)
    first = motion(space, -0.01, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    seen = set()
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3)
        seen |= {status for status, _ in check_taylor(item, u, name if name in LAWS else "coulomb")}
        k = dense_item(item, vector_of(space, u))
        if theta == 1.0 and name != "coulomb":
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
    assert seen == ({OPEN, SLIP} if name == "none" else {OPEN, STICK, SLIP})


@pytest.mark.parametrize("name", ["none", "coulomb"])
@pytest.mark.parametrize("theta, adjoint", [(0.0, "elastic"), (1.0, "consistent"), (-1.0, "elastic")])
def test_tangent_where_both_bodies_yield(tmp_path, theta, adjoint, name):
    path = blocks_file(tmp_path / "b.msh", "quadrilateral", 2, [3, 1], offset=0.3)
    space = make_space(SELF, path, ["lower", "upper"])
    said = {"theta": theta, "adjoint": adjoint, "alpha": 0.7, "gamma0": 1.0, "search": "closest_point"}
    contact = Contact("upper_bottom", "lower_top", unbiased=True, **LAWS.get(name, {}), **said)
    material = plastic_constants(*SOFT, 0.4), hardening_curve(0.05, 1.0)
    bulks = []

    def make(one):
        bulk, item = plastic_items(space, one, [material] * 2, SOFT, 0.3)
        bulks.append(bulk)
        traction = item.terms.traction
        traction._excess = type(traction._excess)(space, bulks[0], halved(item.source), one.source)
        return item

    item, bulk = both(contact, make), bulks[0]
    first = motion(space, -0.01, 0.01, noise=0.006)
    item.detect(space.vector(), 0.5)
    for one in (bulk, item):
        one.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    assert 0.0 < max(s.p.max() for s in bulk.states.values()) < 0.3
    directions = [motion(space, 0.01, 0.01, 0.01, seed, 0.01) for seed in range(5, 9)]
    curved = 0
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3, noise=0.006)
        curved += check_plastic(taylor_plastic(bulk, item, u, "coulomb", directions))
        assert flowing(bulk, u).any()
    assert curved >= 2


def test_halves_weigh_half(stacked):
    """Residual and tangent are the means of the two contacts with a source and a target."""
    space, u = stacked, motion(stacked, 0.03, 0.01, 0.1)
    item, parts = unbiased(space, "coulomb", theta=1.0), []
    said = {"gamma0": 1.0, "theta": 1.0, "alpha": 1.0, "search": "closest_point", **LAWS["coulomb"]}
    for names in (("upper_bottom", "lower_top"), ("lower_top", "upper_bottom")):
        parts.append(pair(space, Contact(*names, **said), 0.3))
    for one in (item, *parts):
        one.detect(space.vector(), 1.0)
    mean = 0.5 * sum(residual_of(one, u) for one in parts)
    assert np.abs(mean).max() > 1e-3
    np.testing.assert_allclose(residual_of(item, u), mean, atol=1e-14 * np.abs(mean).max())
    mean = 0.5 * sum(dense_item(one, vector_of(space, u)) for one in parts)
    np.testing.assert_allclose(dense_item(item, vector_of(space, u)), mean, atol=1e-14 * np.abs(mean).max())
    # action is reaction
    force = residual_of(item, u).reshape(-1, space.dim)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-13 * np.abs(force).max())
    area = sum(Together(one.contact, [one]).summary(vector_of(space, u))["area"] for one in parts)
    assert item.summary(vector_of(space, u))["area"] == pytest.approx(0.5 * area, rel=1e-13)
    assert state_of(item, u)["weight"].sum() == pytest.approx(sum(one.source.jxw.sum() for one in parts), rel=1e-13)


def test_default_gamma0_is_half_as_large():
    """Where each half has the traction of its source alone."""
    for theta in THETAS:
        forth, back = contacts_of_halves(Contact("a", "b", unbiased=True, theta=theta), False)
        assert forth.gamma0 == back.gamma0 == 0.5 * GAMMA0[theta]
        assert (forth.source, back.source, forth.name, back.name) == ("a", "b", "a-b", "a-b")
        assert contacts_of_halves(Contact("a", "b", unbiased=True, theta=theta), True)[0].gamma0 is None
    assert contacts_of_halves(Contact("a", "b", unbiased=True, theta=0.0, gamma0=3.0), False)[1].gamma0 == 3.0


# -- curved surfaces, several ranks, restart ----------


@pytest.mark.parallel
def test_hertz(shared_tmp):
    """Two cylinders: the closed form as near as with a source and a target."""
    args = parse(make_options(), ["--case", "cylinders", "--hold", "1", "--drive", "displacement"])
    case = check_hertz(args)
    h = case.half_width / 12
    path, found = generate(case, shared_tmp / "hertz.msh", h, 1), []
    for both_ways in (False, True):
        hertz = make_scene(case, path, args)
        hertz.contacts[0].unbiased = both_ways
        with running(hertz) as (simulation, converged):
            assert converged
            found.append(simulation.problem.contacts[0].summary(simulation.stepper.u))
    one, two = found
    force = np.linalg.norm(two["force"])
    assert force == pytest.approx(np.linalg.norm(one["force"]), rel=5e-3)
    half_width, peak = case.from_force(case.copies * force)
    assert abs(two["area"] - half_width) < 1.5 * h
    assert two["max_pressure"] == pytest.approx(peak, rel=0.03)


@pytest.mark.parallel
@pytest.mark.parametrize("theta", THETAS)
def test_rings(shared_tmp, theta):
    """The pressure of the closed form, and nearly the error in energy of contact with a source and a target."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8, order=2)
    found = []
    for both_ways in (False, True):
        with running(ring_scene(path, 1, theta, unbiased=both_ways, gamma0=None)) as (simulation, converged):
            assert converged
            found.append(measure(simulation))
    assert found[1]["energy"] < 1.01 * found[0]["energy"]
    # each half has the traction of its own source, not that of both
    assert found[0]["weighted"] < 0.006 and found[1]["weighted"] < 0.013
    assert found[1]["mean_pressure"] == pytest.approx(found[0]["mean_pressure"], rel=1e-3)


@pytest.mark.parallel
@pytest.mark.parametrize("cell, name, theta", [("triangle", "coulomb", 0.0), ("hexahedron", "none", 1.0)])
def test_the_same_on_any_ranks(shared_tmp, cell, name, theta):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, cell, 2, 3)
    WORLD.Barrier()
    results = []
    for comm in (WORLD, SELF):
        space = make_space(comm, path, ["lower", "upper"])
        item = unbiased(space, name, radius=1.0, theta=theta)
        item.detect(space.vector(), 0.5)
        first = 0.001 * field(space, 2)
        item.commit(vector_of(space, first), 0.5)
        item.detect(vector_of(space, first), 1.0)
        u = first + motion(space, 0.03, 0.004, 0.1, noise=0.0) + 0.005 * field(space, 3)
        results.append((by_key(space, residual_of(item, u).reshape(-1, space.dim)), item.summary(vector_of(space, u))))
    assert np.abs(results[1][0]).max() > 1e-3
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-11)
    for key, value in results[1][1].items():
        np.testing.assert_allclose(results[0][1][key], value, atol=1e-11)


def test_memory_comes_back(stacked):
    """What the halves remember, given back to another item, gives the same forces."""
    space, first = stacked, motion(stacked, 0.03, 0.01, 0.1)
    one, other = (unbiased(space, "coulomb") for _ in range(2))
    one.detect(space.vector(), 0.5)
    one.commit(vector_of(space, first), 0.5)
    memory = one.memory()
    assert set(memory) == {"source_status", "target_status", "source_lag", "target_lag"}
    other.detect(space.vector(), 0.5)
    for name, table in memory.items():
        other.recall(name, [table])
    u = first + motion(space, 0.01, 0.01, seed=7)
    for item in (one, other):
        item.detect(vector_of(space, first), 1.0)
    np.testing.assert_array_equal(one.closed, other.closed)
    np.testing.assert_array_equal(residual_of(one, u), residual_of(other, u))
    assert one.closed.any()


@pytest.mark.parallel
def test_a_run_and_its_restart(shared_tmp):
    """One entry in report, fields (of both surfaces) and checkpoint; a run that goes on comes to the same numbers."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 3, 4, "quadrilateral")
    case = scene(path, 2, unbiased=True, friction=0.3)
    case.displacements = case.displacements[:2]
    case.displacements[0].value, case.displacements[1].value = [0.0, 0.0], [0.2, -0.1]
    case.materials["elastic"].nu = 0.3
    case.output = Output(fields=True, checkpoint=True)
    case.steps.count = 6
    watch = Keep(shared_tmp / "whole", shared_tmp / "kept", WORLD)
    whole = run(case, WORLD, shared_tmp / "whole", [watch])
    rest = run(case, WORLD, shared_tmp / "rest", restart=shared_tmp / "kept")
    a, b = whole[-1]["contacts"], rest[-1]["contacts"]
    assert list(a) == list(b) == ["patch"] and 2 <= len(rest) < len(whole)
    assert [row["time"] for row in rest] == [row["time"] for row in whole[-len(rest) :]]
    np.testing.assert_allclose(b["patch"]["force"], a["patch"]["force"], rtol=1e-8)
    assert b["patch"]["slip"] == a["patch"]["slip"] > 0
    assert list((shared_tmp / "whole" / "fields").glob("surface_patch_*.pvtu"))
