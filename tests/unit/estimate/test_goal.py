"""The error of quantities: local products, the transposed tangent, forces and displacements of known solutions."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.cases import rings
from drivers.studies._named_scenes import HELD_BACK
from drivers.studies._round_bodies import wound_rings
from meshes import rings as rings_mesh
from meshes.blocks import two_blocks
from pcontact.adapt.passes import Watch
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.element.reference import shape, shape_gradient
from pcontact.estimate import goal, residuals
from pcontact.estimate.goal import closing, contact_force, transposed, value
from pcontact.estimate.goal import probe as goal_of_probe
from pcontact.estimate.local import Bound, LocalFunctions, Moduli, energies, products
from pcontact.estimate.stress import Softening
from pcontact.estimate.tractions import Cells
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.scene.target import Target
from pcontact.simulation import Simulation
from pcontact.stepping.record import Recorder

COMM = MPI.COMM_WORLD


def test_products_of_local_problems():
    """With one right-hand side twice they are its energy; else they are those of dense algebra."""
    rng = np.random.default_rng(4)
    nc, nq, nb, d = 3, 12, 4, 2
    functions = LocalFunctions(rng.normal(size=(nc, nq, nb, d)), np.zeros((0, 0, 0)), rng.uniform(0.5, 1, (nc, nq)),
                               np.zeros((0, 0, 0)))  # fmt: skip
    moduli, fixed = Moduli(1.3, 0.0, 0.7), np.zeros((nc, nb, d), dtype=bool)
    fixed[1, 2, 0] = True
    first, second = rng.normal(size=(2, nc, nb, d))
    free = Bound(np.full(nc, -1), np.zeros((0, nb * d, nb * d)))
    none = Softening(np.zeros((nc, 1)), np.zeros((0, 0)), np.zeros(nq, dtype=np.int64))
    out, squares, both = np.empty((3, nc, 2))
    products(functions, moduli, none, free, first, second, fixed, out)
    energies(functions, moduli, none, free, first[:, None].copy(), fixed, squares)
    energies(functions, moduli, none, free, (first + second)[:, None].copy(), fixed, both)
    other = np.empty((nc, 2))
    energies(functions, moduli, none, free, second[:, None].copy(), fixed, other)
    assert out[:, 0] == pytest.approx(0.5 * (both - squares - other)[:, 1])
    assert out[:, 1] == pytest.approx(other[:, 1])
    products(functions, moduli, none, free, first, first, fixed, out)
    assert out == pytest.approx(squares[:, [1, 1]])


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Rings on a coarse mesh, by the degree."""
    folder = COMM.bcast(str(tmp_path_factory.mktemp("rings")) if COMM.rank == 0 else None)
    path, known = Path(folder) / "rings.msh", {}
    on_root(COMM, partial(rings_mesh, path, n=6, cell="triangle", order=2))

    def of(degree):
        if degree not in known:
            scene = rings.ring_scene(path, degree, 0.0, gamma0=None)
            scene.output.fields, scene.output.estimate, scene.output.probes = False, True, ["outer_skin"]
            scene.petsc = {"snes_rtol": "1e-10"}
            simulation = Simulation(scene)
            watch = Watch(simulation)
            assert simulation.run(None, [watch])
            known[degree] = simulation, watch
        return known[degree]

    yield of
    for simulation, _ in known.values():
        simulation.free()


@pytest.mark.parallel
def test_transposed_tangent_is_the_derivative(solved):
    """Taylor: phi . (N(u + h w) - N(u)) / h."""
    simulation, _ = solved(1)
    problem, u = simulation.problem, simulation.stepper.u
    space, rng = problem.space, np.random.default_rng(COMM.rank)
    phi, way = rng.normal(size=(2, space.n_owned, space.dim))
    slope = transposed(space, problem.items, u, phi)
    step = 1e-7 * float(np.abs(u.getArray(readonly=True)).max(initial=0.0))
    step = COMM.allreduce(step, op=MPI.MAX)
    moved = u.copy()
    moved.setArray(moved.getArray(readonly=True) + step * way.ravel())
    change = (problem.unbalanced(moved) - problem.unbalanced(u)) / step
    sums = COMM.allreduce(np.array([np.vdot(phi, change), np.vdot(slope, way)]), op=MPI.SUM)
    assert sums[0] == pytest.approx(sums[1], rel=1e-5)


@pytest.mark.parallel
@pytest.mark.parametrize("of", ["force:rings", "support:outer_symmetry", "displacement:outer_skin"])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_component_has_its_value_and_its_derivative(solved, of, axis):
    """The record's, with its sign, which the size of the vector does not have."""
    simulation, watch = solved(2)
    problem, u, record = simulation.problem, simulation.stepper.u, watch.record
    names = {"force": next(iter(record["contacts"])), "support": next(iter(record["reactions"]))}
    word, _, name = of.partition(":")
    name = names.get(word, name)
    vector = {"force": lambda: record["contacts"][name]["force"], "support": lambda: record["reactions"][name],
              "displacement": lambda: record["probes"][name]["mean"]}[word]()  # fmt: skip
    target = Target(0.1, f"{word}:{name}.{'xy'[axis]}")
    assert value(problem, target, record, u) == pytest.approx(vector[axis], rel=1e-12)
    assert value(problem, Target(0.1, f"{word}:{name}"), record, u) == pytest.approx(np.linalg.norm(vector))
    goal = simulation.error_estimate.goal(target, record, u)
    way, moved = np.random.default_rng(COMM.rank).normal(size=(problem.space.n_owned, 2)), u.copy()
    step = 1e-7 * COMM.allreduce(float(np.abs(u.getArray(readonly=True)).max(initial=0.0)), op=MPI.MAX)
    moved.setArray(moved.getArray(readonly=True) + step * way.ravel())
    slope = goal.sign * COMM.allreduce(np.vdot(goal.slope, way))
    if word == "displacement":
        change = goal_of_probe(problem, name, moved, axis).value - goal.value
    elif word == "force":
        change = problem.contacts[0].summary(moved)["force"][axis] - goal.value
    else:
        change = problem.forces.reactions(moved, problem.unbalanced(moved))[name][axis] - goal.value
    assert change / step == pytest.approx(slope, rel=1e-4)


def test_the_mean_of_a_probe_is_that_of_its_region(tmp_path):
    """On a mesh with nodes that lie close on one side, and beside a region that is a line on the axis."""
    two_blocks(tmp_path / "blocks.msh", 2, 3, 4, "triangle")
    scene = Scene(
        mesh=MeshSpec(tmp_path / "blocks.msh", kinematics="axisymmetric"), materials={"soft": Material(10.0, 0.3)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", ["free", 0.0]), Displacement("upper_top", ["free", -0.05])],
        output=Output(fields=False, probes=["upper", "left", "upper_top"], estimate=True),
    )  # fmt: skip
    simulation = Simulation(scene)
    assert simulation.run()
    space, u = simulation.problem.space, simulation.stepper.u
    x = space.points[space.owned_local]
    # a linear displacement has the mean of the region's centroid: over the radius r dr to 1, 2/3
    u.setArray(np.column_stack([x[:, 0], 2.0 * x[:, 1]]).ravel())
    probes = Recorder(simulation.problem, scene.output.probes)
    found = {name: probes._probe(*one, u)["mean"] for name, one in probes._probes.items()}
    top = x[:, 1].max()
    assert found["upper_top"] == pytest.approx([2.0 / 3.0 * x[:, 0].max(), 2.0 * top])
    assert found["upper"][0] == pytest.approx(2.0 / 3.0 * x[:, 0].max())
    on_axis = x[np.isclose(x[:, 0], 0.0)]
    assert found["left"] == pytest.approx([0.0, 2.0 * on_axis[:, 1].mean()])
    simulation.free()


@pytest.mark.parallel
def test_the_force_of_a_symmetric_method_has_its_own_derivative(shared_tmp):
    """Taylor, theta = 1: terms that vanish with the error on the contact are no part of the force."""
    on_root(COMM, partial(rings_mesh, shared_tmp / "rings.msh", n=4, cell="triangle", order=2))
    scene = rings.ring_scene(shared_tmp / "rings.msh", 1, 1.0, gamma0=None)
    scene.output.fields = False
    simulation = Simulation(scene)
    assert simulation.run(None, [], keep=True)
    problem, u, (contact,) = simulation.problem, simulation.stepper.u, simulation.problem.contacts
    goal = contact_force(problem, contact, contact.summary(u)["force"], u)
    way = np.random.default_rng(COMM.rank).normal(size=(problem.space.n_owned, 2))
    size = COMM.allreduce(float(np.abs(u.getArray(readonly=True)).max(initial=0.0)), op=MPI.MAX)
    moved = u.copy()
    moved.setArray(moved.getArray(readonly=True) + 1e-6 * size * way.ravel())
    change = np.linalg.norm(contact.summary(moved)["force"]) - goal.value
    simulation.free()
    assert change == pytest.approx(1e-6 * size * COMM.allreduce(np.vdot(goal.slope, way)), rel=1e-4)


@pytest.mark.parametrize("theta", [0.0, -1.0])
def test_what_contact_exerts_on_a_dual_displacement_is_its_transposed_tangent(tmp_path, monkeypatch, theta):
    """Where points stick, slip and are open: tested with displacements of the space it is  - z . N'(u) w."""
    scene = HELD_BACK["sheared"].scene(tmp_path).copy()
    scene.contacts = [replace(scene.contacts[0], friction=0.4, theta=theta, alpha=0.7)]
    # one end lifts off
    scene.displacements[1] = replace(scene.displacements[1], value=[0.03, "-0.05 * (x - 0.4)"])
    simulation = Simulation(scene)
    assert simulation.run(None, [], keep=True)
    problem, u, (contact,) = simulation.problem, simulation.stepper.u, simulation.problem.contacts
    space, rng = problem.space, np.random.default_rng(7)
    assert set(np.unique(contact.pairs[0].history.committed)) == {OPEN, STICK, SLIP}
    z, w, zero = space.vector(), rng.normal(size=(space.n_owned, 2)), space.vector()
    z.setArray(rng.normal(size=2 * space.n_owned))
    for name, own in (("tests_of", _shapes), ("bubbles", lambda *some: (shape(*some), shape_gradient(*some)))):
        monkeypatch.setattr(residuals, name, own)
    names = [contact.contact.source, contact.contact.target]
    exerted = residuals.ContactResiduals(problem, Cells(space, names))
    tested = [np.zeros((len(own), 5, own.shape[1], 2)) for own in space.cells]
    exerted.add_dual(contact, u, z, zero, tested)
    work = sum(np.vdot(t.sum(axis=1), w[own]) for t, own in zip(tested, space.cells, strict=True))
    tangent = transposed(space, contact.pairs, u, z.getArray(readonly=True).reshape(-1, 2).copy())
    simulation.free()
    assert work == pytest.approx(-np.vdot(tangent, w), rel=1e-10)


def _shapes(space, number, xi):
    block = space.mesh.blocks[number]
    return shape(block.cell, space.degree_of(block), xi)


@pytest.mark.parallel
def test_quantities_of_the_rings(solved):
    """The estimate is 0.5 to 2 times the error of the contact force and of the displacement of the outer circle.

    With degree 1: the forces of degree 2 are as wrong as the circles of degree 2 are, 1e-4.
    """
    simulation, watch = solved(1)
    u, constants = simulation.stepper.u, rings.ring_constants()
    force = np.sqrt(2.0) * rings.interface_pressure() * rings.MIDDLE
    # the mean of the vectors of a quarter of a circle
    outer = abs(rings.radial_displacement(constants[0], rings.LARGE)) * 2.0 * np.sqrt(2.0) / np.pi
    for of, exact in (("force:circle", force), ("displacement:outer_skin", outer)):
        target = Target(0.1, of)
        found = simulation.error_estimate.of_quantity(target, watch.record, u, watch.time, watch.unbalanced)
        assert found.value == pytest.approx(value(simulation.problem, target, watch.record, u))
        assert found.error == pytest.approx(COMM.allreduce(sum(own.sum() for own in found.cells)))
        # cells cancel, and their norms do not
        assert abs(found.error) <= COMM.allreduce(sum(np.abs(own).sum() for own in found.cells)) <= found.bound
        assert 0.5 < found.error / (exact - found.value) < 2.0, (of, found.value, exact, found.error)


@pytest.mark.parallel
def test_gaps_between_facets_do_not_spoil_the_error_of_a_force(shared_tmp):
    """Eight facets meet eleven, and their gaps open points between others that are closed.

    The estimate is 5.5 times the error. A displacement of degree 2 on the same facets has a hundredth of it.
    """
    path, force = shared_tmp / "rings.msh", {}
    on_root(COMM, partial(rings_mesh, path, n=8, cell="triangle", order=2))
    for degree in (2, 1):
        scene, _ = wound_rings(path, degree, 1.0)
        scene.output.estimate, scene.petsc = True, {"snes_rtol": "1e-10"}
        simulation = Simulation(scene)
        watch = Watch(simulation)
        assert simulation.run(None, [watch], keep=True)
        force[degree], target = np.linalg.norm(watch.record["contacts"]["circle"]["force"]), Target(0.1, "force:circle")
        if degree == 1:
            found = simulation.error_estimate.of_quantity(
                target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            assert watch.record["contacts"]["circle"]["open"] > 0
        simulation.free()
    assert 0.5 < found.error / (force[2] - force[1])


def test_points_that_are_pressed_around_them_count_as_closed():
    """Not those in tension, nor those that are far away."""
    tau, true = np.array([0.0, 1.0, 1.0, 19.0, 21.0, 1.0]), np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 0.0])
    assert closing(tau, true).tolist() == [True, True, False, True, False, False]


def test_dual_problems_in_the_plane_are_solved_with_factors(solved, monkeypatch):
    """In an iteration, or with the preconditioner of Newton's method where there are none: the same."""
    simulation, watch = solved(1)
    target, kept = Target(0.1, "force:circle"), []
    for factors in (goal._factors, lambda *_: None):
        monkeypatch.setattr(goal, "_factors", lambda *some, make=factors: kept.append(make(*some)) or kept[-1])
        found = simulation.error_estimate.goal(target, watch.record, simulation.stepper.u)
        z = goal.dual(simulation.problem, found, simulation.newton.last_preconditioner())
        kept.append(z)
    assert kept[0] is not None and kept[2] is None
    assert kept[1] == pytest.approx(kept[3], abs=1e-5 * np.abs(kept[3]).max())


@pytest.mark.parallel
def test_the_pressure_has_errors_of_both_bodies(solved):
    """Cells of either ring, on the contact alone; the estimate is no less than a part of the error, on any ranks."""
    simulation, watch = solved(2)
    space, estimate = simulation.problem.space, simulation.error_estimate
    target = Target(0.1, "pressure:circle")
    found = estimate.of_quantity(target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced)
    sums, cells = np.zeros(2), 0
    for block, squares in zip(space.mesh.blocks, found.cells, strict=True):
        sums[block.body] += squares.sum()
        cells += int(np.count_nonzero(squares))
    facets = [part for name in rings.SIDES["inner"] for part in space.mesh.facet_groups.get(name, [])]
    missing = COMM.allreduce(cells - sum(len(part.cells) for part in facets))
    sums = COMM.allreduce(sums, op=MPI.SUM)
    assert found.error == pytest.approx(np.sqrt(sums.sum()))
    assert (sums > 0.02 * sums.sum()).all() and missing == 0
    (state,) = simulation.problem.contacts[0].states(simulation.stepper.u)
    off = COMM.allreduce(float(state["weight"] @ (state["pressure"] - rings.interface_pressure()) ** 2))
    assert 0.5 < found.error / np.sqrt(off) < 2.5
