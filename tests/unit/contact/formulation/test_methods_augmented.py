"""Penalty and augmented Lagrangian: items against plain numpy, tangents against differences, runs with closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.contact.formulation.methods import AugmentedLagrangian, update_multipliers, without_traction
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.contact.traction.small import Traction
from pcontact.pairs import pair_of
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.blocks import DEPTH, POISSON, TIGHT, YOUNG, made, pressed
from tests.support.laws import LAWS, numpy_projection
from tests.support.pairs import CONSTANTS, STEPS, along, check_taylor, motion, obstacle_of, residual_of, tangential
from tests.support.restarts import STOP, Keep, block, counts
from tests.support.restarts import run as run_steps
from tests.support.small import SELF, bend, block_file, blocks_file, dense_item, elastic_solid, make_space, vector_of

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
FORMULATIONS = ["penalty", "augmented_lagrangian"]
# on several ranks half of them will do
ORDERS = [1, 2] if WORLD.size == 1 else [1]
both = pytest.mark.parametrize("formulation", FORMULATIONS)
# "none" is frictionless
CASES = {**LAWS, "none": {}}


# -- items ----------------------------------------


def contact_of(formulation, name="coulomb", bilateral=False, search="closest_point", obstacle=None, **more):
    """A contact with all its numerics."""
    partner = {"target": "lower_top"} if obstacle is None else {"obstacle": obstacle}
    said = {"theta": 0.0, "alpha": 0.7, "gamma0": 3.0, "search": search, "bilateral": bilateral, **CASES[name], **more}
    return Contact("upper_bottom" if obstacle is None else "bottom", formulation=formulation, **partner, **said)


def item_of(space, contact, radius=0.3):
    source = source_surface(space, contact.source, [CONSTANTS] * 2, contact.quadrature)
    if contact.obstacle is None:
        target = target_surface(space, contact.target)
    else:
        target = RigidObstacle(contact.obstacle, amplitude(contact.obstacle.amplitude, 1.0), 1.0)
    return pair_of(space, elastic_solid(space, [CONSTANTS] * 2), contact, source, target, radius)


class Twin:
    """(R) of FORMULATION with t = 0 and its Jacobian, with matrices, from the source as it is for Nitsche's method."""

    def __init__(self, item, contact, name):
        space, p = item.space, item.pairing
        self.item, self.name, self.alpha = item, name, contact.alpha
        source = source_surface(space, contact.source, [CONSTANTS] * 2, contact.quadrature)
        self.gamma = contact.gamma0 * source.trace[source.facet]
        self.jxw, d = source.jxw, space.dim
        place = np.argsort(space.owned_local)
        weight = np.zeros((len(source.facet), space.n_owned))
        rows = np.arange(len(weight))[:, None]
        np.add.at(weight, (rows, place[source.cells[source.facet]]), source.shape)
        np.add.at(weight, (rows, p.exchange.nodes[p.targets]), -p.target_shape)
        self.jump = np.einsum("pn,ij->pinj", weight, np.eye(d)).reshape(len(weight), d, -1)

    def __call__(self, u, before, multiplier):
        """P (np, d), residual, tangent at a displacement (n_owned, d)."""
        item, u, one = self.item, u.ravel(), np.eye(self.item.space.dim)
        forces, residual, tangent = np.zeros_like(multiplier), np.zeros(u.size), np.zeros((u.size, u.size))
        for k, (n, jump) in enumerate(zip(item.pairing.normal, self.jump, strict=True)):
            if not item.pairing.paired[k]:
                continue
            nn = np.outer(n, n)
            stiff = self.gamma[k] * (nn + self.alpha * (one - nn))
            arm = item.pairing.gap0[k] * n - nn @ jump @ u - (one - nn) @ (jump @ u - before[k])
            force, d = self._law(n, multiplier[k] + stiff @ arm)
            forces[k] = force
            residual -= self.jxw[k] * jump.T @ force
            tangent += self.jxw[k] * jump.T @ d @ stiff @ jump
        return forces, residual, tangent

    def _law(self, n, tau):
        if self.name != "none":
            return numpy_projection(self.name, self.item.bilateral, n, tau)[:2]
        nn = np.outer(n, n)
        return (nn @ tau, nn) if self.item.bilateral or tau @ n <= 0.0 else (0.0 * n, 0.0 * nn)


def test_gamma_grows_from_that_of_the_stretch():
    """Updates let gamma grow; by how much the cells are compressed counts all the same, and does not stay."""
    method = AugmentedLagrangian(contact_of("augmented_lagrangian", gamma0=0.05), np.array([2.0, 3.0]), (4, 2))
    for stretch, factor in (([1.0, 4.0], 10.0), ([2.0, 1.0], 10.0)):
        method.begin(np.column_stack([stretch, np.ones(2)]))
        np.testing.assert_allclose(method.gamma, 0.05 * np.array([2.0, 3.0]) * stretch)
        method.stiffen()
        np.testing.assert_allclose(method.gamma, factor * 0.05 * np.array([2.0, 3.0]) * stretch)
    method.begin()
    np.testing.assert_allclose(method.gamma, 0.05 * np.array([2.0, 3.0]))


def advance(item, first):
    """A committed load step, with an update of the multipliers if there are any; then the search of the next one."""
    space = item.space
    item.detect(space.vector(), 0.5)
    u = vector_of(space, first)
    if isinstance(item.method, AugmentedLagrangian):
        assert update_multipliers([item], u, 1e-12)[0] > 1e-3
    state = item.state(u)
    item.commit(u, 0.5)
    item.detect(u, 1.0)
    return state


def check_twin(item, contact, name, first, states):
    """Residual and tangent of the second load step, which begins with the traction of the first."""
    committed = advance(item, first)
    twin = Twin(item, contact, name)
    augmented = isinstance(item.method, AugmentedLagrangian)
    multiplier = item.method.multiplier if augmented else np.zeros_like(item.source.x)
    closed = item.history.closed[:, None]
    normal = item.pairing.normal
    spring = np.where(closed, tangential(committed["traction"] - multiplier, committed["normal"]), 0.0)
    if name == "none":
        multiplier = np.einsum("pd,pd->p", multiplier, normal)[:, None] * normal
    before = np.einsum("pin,n->pi", twin.jump, first.ravel()) + spring / (contact.alpha * twin.gamma)[:, None]
    statuses = set()
    for u in states:
        force, residual, tangent = twin(u, before, multiplier)
        state = item.state(vector_of(item.space, u))
        np.testing.assert_allclose(state["traction"], force, atol=1e-12)
        np.testing.assert_allclose(state["pressure"], -np.einsum("pd,pd->p", force, normal), atol=1e-12)
        np.testing.assert_allclose(residual_of(item, u), residual, atol=1e-12)
        np.testing.assert_allclose(dense_item(item, vector_of(item.space, u)), tangent, atol=1e-11)
        statuses |= set(state["status"].tolist())
    return statuses


def expected(formulation, name):
    """Statuses that are met: multipliers may have reached the limit of the law everywhere."""
    limited = formulation == "augmented_lagrangian" and name not in ("coulomb", "steep", "adhesion")
    return {OPEN, SLIP} if limited or name == "none" else {OPEN, STICK, SLIP}


@pytest.fixture(scope="module", params=["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang: some source points have no partner."""
    d = 2 if request.param in ("quadrilateral", "triangle") else 3
    path = tmp_path_factory.mktemp("stacked") / "blocks.msh"
    blocks_file(path, request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


@pytest.fixture(scope="module", params=["quadrilateral", "tetrahedron"])
def box(request, tmp_path_factory):
    path = block_file(tmp_path_factory.mktemp("block") / "b.msh", request.param, 2)
    return make_space(SELF, path, ["block"])


@both
@pytest.mark.parametrize("name", CASES)
def test_residual_and_tangent_are_those_of_numpy(stacked, formulation, name):
    contact = contact_of(formulation, name)
    first = motion(stacked, 0.02, 0.01)
    states = [first + motion(stacked, depth - 0.02, slide, tilt, seed=3) for depth, slide, tilt in STEPS]
    statuses = check_twin(item_of(stacked, contact), contact, name, first, states)
    assert statuses >= expected(formulation, name)


@both
@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", ["coulomb", "tresca", "none"])
@pytest.mark.parametrize("shape", ["plane", "sphere"])
def test_residual_and_tangent_against_an_obstacle(box, formulation, shape, name, bilateral):
    contact = contact_of(formulation, name, bilateral=bilateral, obstacle=obstacle_of(shape, box.dim))
    first = motion(box, 0.02, 0.01)
    states = [first + motion(box, depth - 0.02, slide, tilt, seed=3) for depth, slide, tilt in STEPS]
    check_twin(item_of(box, contact, 5.0), contact, name, first, states)


@both
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
def test_tangent_of_a_pair_of_bodies(stacked, formulation, search, name):
    """Open, sticking, slipping, mixed, without partner, in the second load step: always the derivative."""
    item = item_of(stacked, contact_of(formulation, name, search=search))
    first = motion(stacked, 0.02, 0.01)
    advance(item, first)
    seen = [
        check_taylor(item, first + motion(stacked, depth - 0.02, slide, tilt, seed=3), name)
        for depth, slide, tilt in STEPS
    ]
    assert {status for phase in seen for status, _ in phase} >= expected(formulation, name)


@both
@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("name", ["limit", "adhesion"])
@pytest.mark.parametrize("shape", ["plane", "sphere"])
def test_tangent_against_a_moving_obstacle(box, formulation, shape, name, bilateral):
    obstacle = obstacle_of(shape, box.dim, np.array([0.012, -0.008, 0.01]))
    item = item_of(box, contact_of(formulation, name, bilateral=bilateral, obstacle=obstacle), 5.0)
    first = motion(box, 0.02, 0.01)
    advance(item, first)
    # the obstacle moves on, its motion is slip of a body at rest
    moved = 0.5 * along(np.array([0.012, -0.008, 0.01]), box.dim)
    state = item.state(vector_of(box, first))
    np.testing.assert_allclose(state["slip"], -tangential(moved, state["normal"]), atol=1e-15)
    for depth, slide, tilt in STEPS:
        check_taylor(item, first + motion(box, depth - 0.02, slide, tilt, seed=3), name)


@both
def test_tangent_of_curved_cells_of_second_order(tmp_path, formulation):
    path = blocks_file(tmp_path / "b.msh", "triangle", 2, 1, order=2)
    space = make_space(SELF, path, ["lower", "upper"], 2, lambda x: bend(x, 0.03))
    item = item_of(space, contact_of(formulation), 1.0)
    first = motion(space, 0.01, 0.02)
    advance(item, first)
    for depth, slide, tilt in STEPS:
        check_taylor(item, first + motion(space, depth, slide, tilt, seed=3), "coulomb")


def test_only_the_nodes_on_the_facets_remain(stacked):
    source = source_surface(stacked, "upper_bottom", [CONSTANTS] * 2)
    lean = without_traction(source)
    assert lean.cells.shape[1] == (2 if stacked.dim == 2 else len(set(np.flatnonzero(np.abs(lean.shape[0]) > 0))))
    assert lean.cells.shape[1] < source.cells.shape[1] and lean.grad.size == lean.volumetric.size == 0
    u = np.random.default_rng(1).normal(size=(stacked.n_local, stacked.dim))
    values = [np.einsum("pa,pad->pd", s.shape, u[s.cells[s.facet]]) for s in (source, lean)]
    np.testing.assert_allclose(*values, atol=1e-14)


@both
def test_a_step_that_is_cut_back_leaves_nothing(stacked, formulation):
    """Multipliers, reference of the slip: those of the committed state, as if the attempt had not been."""
    item = item_of(stacked, contact_of(formulation))
    first = motion(stacked, 0.02, 0.01)
    advance(item, first)
    u = first + motion(stacked, 0.03, 0.03, 0.1, seed=3)
    before = residual_of(item, u)
    if formulation == "augmented_lagrangian":
        update_multipliers([item], vector_of(stacked, u), 0.0)
        assert np.abs(residual_of(item, u) - before).max() > 1e-3
    item.detect(vector_of(stacked, first), 1.0)
    np.testing.assert_array_equal(residual_of(item, u), before)


@both
def test_a_load_step_begins_with_the_traction_of_the_last_one(box, formulation):
    for name in CASES:
        item = item_of(box, contact_of(formulation, name, obstacle=obstacle_of("plane", box.dim)), 5.0)
        first = motion(box, 0.03, 0.01, 0.08)
        committed = advance(item, first)
        assert 0.0 < np.mean(committed["status"] > OPEN) < 1.0
        state = item.state(vector_of(box, first))
        # at open points Tresca's bound acts, and their slip is forgotten
        closed = (committed["status"] > OPEN)[:, None]
        np.testing.assert_allclose(state["traction"] * closed, committed["traction"] * closed, atol=1e-13)


# -- runs ----------------------------------------


def solved(scene, measure=lambda simulation: None, comm=WORLD, prepare=lambda simulation: None):
    """Records of the steps, and what `measure` makes of the run. Collective."""
    records = []

    class Watch(Observer):
        def step(self, step, u, record):
            records.append(record)

    simulation = Simulation(scene, comm)
    prepare(simulation)
    try:
        assert simulation.run(observers=[Watch()])
        return records, measure(simulation)
    finally:
        simulation.close()


def states(simulation):
    """Values of the points of the first pair, and its item, of this rank."""
    item = simulation.problem.items[1]
    return item.state(simulation.stepper.u), item


@parallel
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_penetration_is_pressure_over_gamma(shared_tmp, cell, order):
    """Block and spring in a row: p = depth / (h / E + 1 / gamma)."""
    path, d = made(shared_tmp, cell)
    stiff = YOUNG if d == 3 else YOUNG / (1.0 - POISSON**2)
    for gamma0 in (None, 1.0):
        state, item = solved(pressed(path, d, "penalty", order, gamma0=gamma0), states)[1]
        assert item.method.gamma0 == (gamma0 or 3.0)
        gamma = item.method.gamma
        # corner cells have the same constant, else the pressure would not be uniform
        expected = DEPTH / (1.0 / stiff + 1.0 / gamma)
        np.testing.assert_allclose(state["pressure"], expected, rtol=1e-9)
        np.testing.assert_allclose(state["gap"], -expected / gamma, rtol=1e-9)


@parallel
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_multipliers_make_the_pressure_exact(shared_tmp, cell, order):
    """With a moderate gamma; equal to Nitsche's, which is exact, within the tolerance."""
    path, d = made(shared_tmp, cell)
    exact = DEPTH * (YOUNG if d == 3 else YOUNG / (1.0 - POISSON**2))
    for formulation, gamma0, rtol in (("nitsche", None, 1e-12), ("augmented_lagrangian", 1.0, 1e-9),
                                      ("augmented_lagrangian", None, 1e-4)):  # fmt: skip
        petsc = {"contact_uzawa_rtol": str(rtol)} if formulation != "nitsche" else {}
        records, (state, item) = solved(pressed(path, d, formulation, order, petsc, gamma0=gamma0), states)
        np.testing.assert_allclose(state["pressure"], exact, rtol=max(2.0 * rtol, 1e-9))
        if formulation == "nitsche":
            assert "uzawa" not in records[0]
            continue
        assert records[0]["uzawa"]["updates"] > 0 and records[0]["uzawa"]["change"] <= rtol
        depth = np.abs(state["gap"]) * item.method.gamma
        assert np.all(depth < 2.0 * rtol * exact)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_axial_symmetry(tmp_path, formulation):
    path = one_block(tmp_path / "b.msh", 2, 3, "quadrilateral")
    petsc = {"contact_uzawa_rtol": "1e-8"} if formulation != "penalty" else None
    scene = pressed(path, 2, formulation, petsc=petsc, kinematics="axisymmetric", gamma0=20.0)
    scene.displacements = scene.displacements[:1]
    (record,), (state, item) = solved(scene, states)
    gamma = item.method.gamma
    expected = DEPTH / (1.0 / YOUNG + (1.0 / gamma if formulation == "penalty" else 0.0))
    # gamma is another one on the axis: the pressure of the penalty method is not uniform to all digits
    np.testing.assert_allclose(state["pressure"], expected, rtol=1e-2 if formulation == "penalty" else 1e-6)
    if formulation != "penalty":
        assert record["contacts"]["floor"]["force"][1] == pytest.approx(-np.pi * DEPTH * YOUNG, rel=1e-7)
        np.testing.assert_allclose(state["gap"], 0.0, atol=1e-8 * DEPTH)


def dragged(path, formulation, count=3, end=0.05, **numerics):
    """A block under a pressure of 10 on a plane, its top dragged sideways."""
    obstacle = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(YOUNG, 0.0)},
        bodies=[Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="floor", formulation=formulation, **numerics)],
        displacements=[Displacement("top", [end, "free"], [(0, 0), (0.5, 0), (1, 1)])],
        loads=[Load("top", pressure=10.0, amplitude=[(0, 0), (0.5, 1)])],
        steps=Steps(1.0, count),
        output=Output(fields=False),
        petsc={"snes_rtol": "1e-11"},
    )


@parallel
@both
@pytest.mark.parametrize("law", [{"friction": 0.3}, {"tresca": 2.0}, {"friction": 0.3, "friction_limit": 2.5}])
def test_a_sliding_block(shared_tmp, formulation, law):
    """All points slip: the tangential force is what the law says, whatever the penetration."""
    path, _ = made(shared_tmp, "quadrilateral", 4)
    (*_, record), _ = solved(dragged(path, formulation, **law))
    contact = record["contacts"]["floor"]
    assert contact["stick"] == 0 and contact["slip"] > 0
    assert contact["force"][1] == pytest.approx(-10.0, rel=1e-9)
    if "friction_limit" in law:
        # points near the edge are pressed less and stay below the limit
        assert 1.5 < contact["force"][0] <= 2.5
    else:
        assert contact["force"][0] == pytest.approx(law.get("tresca", 3.0), rel=1e-7)


@both
def test_what_sticks_does_not_creep(tmp_path, formulation):
    """The tangential spring of a point keeps its traction from step to step: one step or eight, the same force."""
    path = one_block(tmp_path / "b.msh", 2, 3)
    forces = []
    for count in (2, 16):
        scene = dragged(path, formulation, count, 0.001, friction=50.0, gamma0=10.0)
        scene.petsc["contact_uzawa_rtol"] = "1e-9"
        scene.allow_unsafe = ["friction"]
        (*_, record), _ = solved(scene)
        assert record["contacts"]["floor"]["slip"] == 0
        forces.append(record["contacts"]["floor"]["force"])
    np.testing.assert_allclose(*forces, rtol=1e-6)


def stack(path, d, first, second, petsc=None):
    """Two blocks on a plane, pressed by a load: a pair between them, another at the floor."""
    plane = Obstacle("plane", point=[0.0] * d, normal=[0.0] * (d - 1) + [1.0])
    return Scene(
        mesh=MeshSpec(path),
        materials={"soft": Material(YOUNG, 0.3), "hard": Material(3.0 * YOUNG, 0.2)},
        bodies=[Body("lower", "hard"), Body("upper", "soft")],
        contacts=[
            Contact("upper_bottom", "lower_top", name="between", formulation=first),
            Contact("lower_bottom", obstacle=plane, name="floor", formulation=second),
        ],
        displacements=[Displacement("left", [0.0] + ["free"] * (d - 1))],
        loads=[Load("upper_top", pressure=10.0)],
        output=Output(fields=False),
        petsc={**TIGHT, **(petsc or {})},
    )


@parallel
@pytest.mark.parametrize(("first", "second"), [("nitsche", "penalty"), ("penalty", "nitsche"),
                                               ("augmented_lagrangian", "penalty")])  # fmt: skip
def test_pairs_of_one_scene_may_differ(shared_tmp, first, second):
    path = shared_tmp / "stack.msh"
    on_root(WORLD, lambda: two_blocks(path, 2, 2, 4, "quadrilateral"))
    (record,), items = solved(stack(path, 2, first, second), lambda s: s.problem.items[1:])
    for item, formulation in zip(items, (first, second), strict=True):
        contact = record["contacts"][item.name]
        assert contact["force"][1] == pytest.approx(-10.0, rel=1e-8)
        assert contact["max_pressure"] == pytest.approx(10.0, rel=1e-6)
        gamma = WORLD.allreduce(item.method.gamma.min(initial=np.inf), op=MPI.MIN)
        expected = 10.0 / gamma if formulation == "penalty" else 0.0
        assert contact["max_penetration"] == pytest.approx(expected, rel=1e-6, abs=1e-5 * 10.0 / gamma)
    assert ("uzawa" in record) == ("augmented_lagrangian" in (first, second))


@parallel
@both
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_runs_are_the_same_on_any_ranks(shared_tmp, formulation, cell):
    """A block on a tilted plane in two load steps, with friction: forces and counts."""
    path, d = made(shared_tmp, cell, 4 if cell == "triangle" else 2)
    scene = pressed(path, d, formulation, friction=0.3)
    scene.contacts[0].obstacle = Obstacle("plane", point=[0.0] * d, normal=[0.02] + [0.0] * (d - 2) + [1.0])
    scene.steps = Steps(1.0, 2)
    results = [solved(scene, comm=comm)[0] for comm in (WORLD, SELF)]
    for a, b in zip(*results, strict=True):
        first, second = a["contacts"]["floor"], b["contacts"]["floor"]
        assert [first[key] for key in ("open", "stick", "slip")] == [second[key] for key in ("open", "stick", "slip")]
        np.testing.assert_allclose(first["force"], second["force"], atol=1e-6 * np.abs(second["force"]).max())
        np.testing.assert_allclose(first["max_penetration"], second["max_penetration"], rtol=1e-5, atol=1e-12)
        if "uzawa" in b:
            assert a["uzawa"]["updates"] == b["uzawa"]["updates"]


@parallel
@both
@pytest.mark.usefixtures("one_order")
def test_restart_gives_the_same_numbers(shared_tmp, formulation):
    path, _ = made(shared_tmp, "quadrilateral", 6)

    def scene():
        new = block(path)
        new.contacts[0].formulation = formulation
        return new

    out, dead = shared_tmp / "out", shared_tmp / "dead"
    full = run_steps(scene(), WORLD, out, [Keep(out, dead, WORLD)])
    again = run_steps(scene(), WORLD, shared_tmp / "again", restart=dead)
    assert len(again) == len(full) - STOP
    for a, b in zip(full[STOP:], again, strict=True):
        assert a["time"] == b["time"] and a["newton"] == b["newton"] and counts(a) == counts(b)
        if formulation == "augmented_lagrangian":
            assert a["uzawa"]["updates"] == b["uzawa"]["updates"]
            assert a["uzawa"]["change"] == pytest.approx(b["uzawa"]["change"], rel=1e-6)
        # what multipliers leave of the penetration is near the rounding error of the displacement
        one, other = (record["contacts"]["floor"]["max_penetration"] for record in (a, b))
        assert one == pytest.approx(other, rel=1e-12, abs=1e-14)
        for key in ("force", "max_pressure"):
            one, other = (np.atleast_1d(record["contacts"]["floor"][key]) for record in (a, b))
            assert np.abs(one - other).max() < 1e-12 * np.abs(one).max()


@pytest.mark.parametrize("update", [1, 2])
def test_cut_backs_are_forgotten(tmp_path, update):
    """An attempt that fails after some updates, and one that fails before any: the same numbers from then on."""
    path, results = one_block(tmp_path / "b.msh", 2, 3), []
    for name, fatal in (("solve", 1), ("again", update)):
        failed = []

        def failing(simulation, name=name, fatal=fatal, failed=failed):
            newton, function = simulation.newton, getattr(simulation.newton, name)

            def call(u, *follow, **more):
                outcome = function(u, *follow, **more)
                late = simulation.problem.time > 0.7
                failed.extend([u] * late)
                return replace(outcome, converged=not late or len(failed) != fatal)

            setattr(newton, name, call)

        results.append(solved(dragged(path, "augmented_lagrangian", 4, friction=0.3), prepare=failing)[0])
        assert len(failed) > fatal
    assert [record["cutbacks"] for record in results[0]] == [record["cutbacks"] for record in results[1]]
    assert sum(record["cutbacks"] for record in results[0]) == 1
    for first, second in zip(*results, strict=True):
        assert first["time"] == second["time"]
        for key in ("force", "max_pressure", "max_penetration"):
            np.testing.assert_array_equal(first["contacts"]["floor"][key], second["contacts"]["floor"][key])


def test_multipliers_that_do_not_settle_end_the_run(tmp_path, capsys, monkeypatch):
    """Unless they are near enough, with a warning."""
    path = one_block(tmp_path / "b.msh", 2, 3)
    petsc = {"contact_uzawa_max_it": "1", "contact_uzawa_rtol": "1e-9"}
    simulation = Simulation(pressed(path, 2, "augmented_lagrangian", petsc=petsc, gamma0=1.0))
    assert not simulation.run()
    simulation.close()
    assert "contact floor: multipliers still change by" in capsys.readouterr().err
    monkeypatch.setattr("pcontact.stepping.load_step.CREEP", np.inf)
    (record,), _ = solved(pressed(path, 2, "augmented_lagrangian", petsc=petsc, gamma0=1.0))
    assert record["uzawa"]["updates"] == 1 and record["uzawa"]["change"] > 1e-9
    # the traction is in equilibrium all the same
    assert record["imbalance"] < 1e-10


@parallel
@pytest.mark.parametrize("law", [{}, {"friction": 0.3}])
def test_gamma_grows_where_multipliers_are_slow(shared_tmp, monkeypatch, law):
    """From a millionth of the default to the default, in each load step; the answer is that of the default.

    With such a gamma multipliers change by a millionth of the gap, and seem to have settled in the second load step.
    """
    path, d = made(shared_tmp, "quadrilateral")
    results = []
    for gamma0 in (1e-6, None):
        scene = pressed(path, d, "augmented_lagrangian", gamma0=gamma0, **law)
        scene.steps = Steps(1.0, 2)
        records, (state, item) = solved(scene, states)
        updates = [record["uzawa"]["updates"] for record in records]
        assert max(updates) < 30 and all(record["cutbacks"] == 0 for record in records)
        np.testing.assert_allclose(item.method.gamma, item.source.trace[item.source.facet], rtol=1e-12)
        results.append((updates, state["pressure"]))
    assert results[0][0][0] > results[1][0][0]
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-3)
    monkeypatch.setattr(AugmentedLagrangian, "stiffen", lambda self: None)
    simulation = Simulation(pressed(path, d, "augmented_lagrangian", gamma0=1e-6, **law))
    assert not simulation.run()
    simulation.close()


@both
@pytest.mark.parametrize(("law", "solver"), [({}, "cg"), ({"tresca": 1.0}, "cg"), ({"friction": 0.3}, "gmres")])
def test_tangents_are_symmetric_without_coulomb_friction(tmp_path, formulation, law, solver):
    path = one_block(tmp_path / "b.msh", 2, 3)
    simulation = Simulation(pressed(path, 2, formulation, **law))
    try:
        assert simulation.newton.applied["ksp_type"] == solver
        assert simulation.run()
        simulation.newton.snes.computeJacobian(simulation.stepper.u, simulation.problem.matrix.matrix)
        k = simulation.problem.matrix.matrix
        difference = k.copy()
        difference.axpy(-1.0, k.copy().transpose(), structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        assert (difference.norm() < 1e-12 * k.norm()) or solver == "gmres"
    finally:
        simulation.close()


@both
def test_a_block_that_yields(tmp_path, formulation):
    """Uniform uniaxial stress beyond the yield stress; the contact knows nothing of plasticity."""
    path = one_block(tmp_path / "b.msh", 3, 2, "hexahedron")
    scene = pressed(path, 3, formulation)
    scene.materials = {"m": Material(YOUNG, POISSON, yield_stress=5.0, hardening=100.0)}
    scene.displacements = scene.displacements[1:]
    scene.loads, scene.steps = [Load("top", pressure=10.0)], Steps(1.0, 2)
    records, (state, item) = solved(scene, states)
    traction = item.terms.traction
    assert type(traction) is Traction and traction._excess is None
    assert records[-1]["plastic"]["max_equivalent_strain"] == pytest.approx(0.05, rel=1e-6)
    np.testing.assert_allclose(state["pressure"], 10.0, rtol=1e-4)


def test_report_and_history_hold_the_updates(tmp_path):
    path = one_block(tmp_path / "b.msh", 2, 3)
    simulation = Simulation(pressed(path, 2, "augmented_lagrangian"))
    try:
        assert simulation.run(tmp_path / "out")
    finally:
        simulation.close()
    (step,) = json.loads((tmp_path / "out" / "report.json").read_text())["steps"]
    assert set(step["uzawa"]) == {"updates", "change"}
    assert "uzawa.updates" in (tmp_path / "out" / "history.csv").read_text().splitlines()[0]
