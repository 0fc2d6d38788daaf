"""Tied pairs: patch test, bending against a conforming mesh, one Newton step, Taylor tests, gaps that stay, ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh, observed_rates, running
from meshes import one_block, two_blocks
from pcontact.contact.law import STICK
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.pairs import CONSTANTS, by_key, residual_of
from tests.support.small import DIMENSION, SELF, blocks_file, dense_item, make_space, vector_of

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
E = 1000.0
EXACT = {"snes_rtol": "1e-10", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def scene(path, dim, loads, displacements, order=1, material=None, petsc=None, count=1, **said):
    """Two stacked boxes, tied."""
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": material or Material(E, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="glue", tied=True, **said)],
        displacements=displacements,
        loads=loads,
        steps=Steps(count=count),
        output=Output(fields=False),
        petsc=EXACT if petsc is None else petsc,
    )


def nodes_of(simulation):
    """Displacement (n_owned, d) and positions of the owned nodes."""
    space = simulation.problem.space
    return simulation.stepper.u.getArray().reshape(-1, space.dim), space.points[space.owned_local]


def pulled_and_sheared(path, dim, order=1, **said):
    """A uniform stress with tension and shear across the interface: the tractions of every side."""
    stress = np.diag([0.0] * (dim - 1) + [3.0])
    stress[0, -1] = stress[-1, 0] = 2.0
    loads = [Load("upper_top", traction=stress[-1].tolist())]
    for body in ("lower", "upper"):
        loads.append(Load(f"{body}_right", traction=stress[0].tolist()))
        loads.append(Load(f"{body}_left", traction=(-stress[0]).tolist()))
    # the exact displacement at the bottom: zero but for Poisson's effect, which nu = 0 takes away
    held = [Displacement("lower_bottom", [0.0] * dim)]
    return scene(path, dim, loads, held, order, Material(E, 0.0), **said), stress


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("order, theta", [(1, 1.0), (1, 0.0), (1, -1.0), (2, 0.0)])
@pytest.mark.parametrize("cell, lower, upper", [
    ("triangle", 3, 4), ("quadrilateral", 3, 4), ("tetrahedron", 2, 2), ("hexahedron", 2, 4),
])  # fmt: skip
def test_patch(shared_tmp, cell, lower, upper, order, theta):
    """A constant stress with tension and shear passes exactly where facets are cut (in the plane) or nested."""
    dim = DIMENSION[cell]
    path = make_mesh(two_blocks, shared_tmp / "b.msh", dim, lower, upper, cell)
    case, stress = pulled_and_sheared(path, dim, order, theta=theta)
    with running(case) as (simulation, converged):
        assert converged
        u, x = nodes_of(simulation)
        exact = np.zeros_like(x)
        exact[:, 0] = 2.0 * stress[0, -1] / E * x[:, -1]
        exact[:, -1] = stress[-1, -1] / E * x[:, -1]
        (item,) = simulation.problem.contacts
        traction = item.state(simulation.stepper.u)["traction"]
    np.testing.assert_allclose(u, exact, atol=1e-9 * np.abs(exact).max(initial=1e-3))
    np.testing.assert_allclose(traction, np.tile(-stress[:, -1], (len(traction), 1)), atol=1e-6 * 3.0)


@pytest.mark.parametrize("cell, lower, upper", [("hexahedron", 3, 2), ("tetrahedron", 3, 2)])
def test_patch_across_edges(tmp_path, cell, lower, upper):
    """In space, whole facets leave an error that a better quadrature makes smaller; cut along the edges, none."""
    path, errors = two_blocks(tmp_path / "b.msh", 3, lower, upper, cell), []
    for quadrature, cut in ((3, False), (9, False), (15, False), (None, True)):
        case, stress = pulled_and_sheared(path, 3, quadrature=quadrature, cut=cut)
        with running(case) as (simulation, _):
            u, x = nodes_of(simulation)
        exact = np.stack([4.0 / E * x[:, 2], 0.0 * x[:, 2], 3.0 / E * x[:, 2]], axis=1)
        errors.append(np.abs(u - exact).max() / np.abs(exact).max())
    assert errors[0] < 0.1 and errors[2] < 0.02 and errors[2] < 0.5 * errors[0]
    assert errors[3] < 1e-9


# -- bending ------------------------------------------


def bent(path, dim, whole, theta=0.0):
    """Work of the load on a column (two boxes, or one) that is bent at its top. Collective."""
    top, bottom = ("top", "bottom") if whole else ("upper_top", "lower_bottom")
    case = scene(path, dim, [Load(top, traction=[1.0, *[0.0] * (dim - 1)])], [Displacement(bottom, [0.0] * dim)],
                 theta=theta)  # fmt: skip
    if whole:
        case.bodies, case.contacts = [Body("block", "m")], []
    with running(case) as (simulation, converged):
        assert converged
        work = simulation.problem.forces.external(1.0)
        own = np.sum(work * simulation.stepper.u.getArray().reshape(work.shape))
    return WORLD.allreduce(float(own))


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("cell", ["quadrilateral"])
def test_bending(shared_tmp, cell, theta):
    """Work of the load against that of a fine mesh: meshes that do not match do as well as one of one piece."""
    fine = make_mesh(one_block, shared_tmp / "one.msh", 2, [48, 96], cell, size=[1.0, 2.0])
    reference, tied, whole, sizes = bent(fine, 2, True), [], [], (6, 12)
    for n in sizes:
        path = make_mesh(two_blocks, shared_tmp / f"b{n}.msh", 2, n, n + n // 3, cell)
        tied.append(abs(bent(path, 2, False, theta) / reference - 1.0))
        path = make_mesh(one_block, shared_tmp / f"one{n}.msh", 2, [n, 2 * n], cell, size=[1.0, 2.0])
        whole.append(abs(bent(path, 2, True) / reference - 1.0))
    h = [1.0 / n for n in sizes]
    # the clamped corners are singular: less than 2 for either
    rates = [observed_rates(h, errors)[1] for errors in (tied, whole)]
    assert rates[0] > 1.4 and rates[0] > rates[1] - 0.3, (tied, whole, rates)
    assert np.all(np.array(tied) < 1.2 * np.array(whole)), (tied, whole)


# -- one Newton step, no matter how large the deformation -----


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("formulation, theta", [("nitsche", 1.0), ("nitsche", -1.0), ("penalty", 0.0)])
def test_one_newton_step(shared_tmp, formulation, theta):
    """Tied elastic bodies are a linear problem; the body that only the tie holds is not loose."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 4, 5, "quadrilateral")
    case = scene(path, 2, [Load("upper_top", traction=[5.0, 5.0])], [Displacement("lower_bottom", [0.0, 0.0])],
                 petsc={}, count=2, theta=theta, formulation=formulation)  # fmt: skip
    counts = []

    class Watch(Observer):
        def step(self, step, u, record):
            counts.append((step.newton, record["contacts"]["glue"]["stick"], record["contacts"]["glue"]["open"]))

        def cut(self, target, outcome):
            raise AssertionError("a step failed")

    with running(case, None, [Watch()]) as (simulation, converged):
        assert converged and simulation.problem.linear and not simulation.floating
        assert simulation.mesh.n_components == 1 and simulation.mesh.component_names == ["lower + upper"]
        (item,) = simulation.problem.items[1:]
        assert [n for n, _, _ in counts] == [1, 1] and counts[0][1] > 0 and counts[0][2] == 0
        assert np.all(item.pairing.paired)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("gap", [0.05, -0.05])
def test_gap_and_overlap_stay(shared_tmp, gap):
    """Without a load nothing moves; a rigid motion of all bodies costs nothing."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 3, 4, "triangle", gap=gap)
    move = [Displacement("lower_bottom", [0.3, -0.2])]
    with running(scene(path, 2, [], move, search_radius=0.2)) as (simulation, converged):
        u, _ = nodes_of(simulation)
        assert converged
        np.testing.assert_allclose(u, np.tile([0.3, -0.2], (len(u), 1)), atol=1e-9)
        summary = simulation.problem.contacts[0].summary(simulation.stepper.u)
    assert summary["max_pressure"] < 1e-6 and summary["open"] == 0


def test_nothing_to_tie(tmp_path):
    path = two_blocks(tmp_path / "b.msh", 2, 3, 4, "triangle", gap=0.9)
    with pytest.raises(InputError, match=r"contacts\[0\] \(glue\)\.tied: found no point of 'upper_bottom'"):
        Simulation(scene(path, 2, [], [Displacement("lower_bottom", [0.0, 0.0])]))


@pytest.mark.parallel(2, 3)
def test_augmented_lagrangian(shared_tmp):
    """Multipliers settle where the mean of the jump is gone: closer to Nitsche's solution than the penalty method."""
    path, tops = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 3, 4, "quadrilateral"), {}
    for formulation in ("nitsche", "penalty", "augmented_lagrangian"):
        case, _ = pulled_and_sheared(path, 2, formulation=formulation)
        with running(case) as (simulation, converged):
            assert converged
            u, x = nodes_of(simulation)
        tops[formulation] = WORLD.allreduce(float(np.max(u[:, 1], initial=0.0)), op=MPI.MAX)
    exact = 3.0 / E * 2.0
    assert tops["nitsche"] == pytest.approx(exact, rel=1e-9)
    assert tops["penalty"] > 1.02 * exact
    assert tops["augmented_lagrangian"] == pytest.approx(exact, rel=1e-4)


# -- derivatives --------------------------------------


@pytest.mark.parametrize("alpha", [1.0, 0.6])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("cell", CELLS)
def test_tangent(tmp_path, cell, theta, alpha):
    """Linear: the tangent times a displacement is the residual; symmetric for theta = 1; forces balance."""
    path = blocks_file(tmp_path / "b.msh", cell, 2, 3)
    space = make_space(SELF, path, ["lower", "upper"])
    contact = Contact("upper_bottom", "lower_top", tied=True, theta=theta, search="closest_point", gamma0=1.0,
                      alpha=alpha, interference="resolve")  # fmt: skip
    source = source_surface(space, "upper_bottom", [CONSTANTS] * 2)
    item = contact_pair(space, contact, source, target_surface(space, "lower_top"), 0.3)
    item.detect(space.vector(), 1.0)
    assert np.all(item.pairing.paired)
    u = np.random.default_rng(3).normal(size=(space.n_owned, space.dim))
    k = dense_item(item, vector_of(space, u))
    force = residual_of(item, u).ravel()
    np.testing.assert_allclose(force, k @ u.ravel(), atol=1e-12 * np.abs(k).max())
    np.testing.assert_allclose(force.reshape(u.shape).sum(axis=0), 0.0, atol=1e-11 * np.abs(force).max())
    if theta == 1.0:
        np.testing.assert_allclose(k, k.T, atol=1e-13 * np.abs(k).max())
    item.commit(vector_of(space, u), 1.0)
    assert np.all(item.history.committed == STICK) and item.history.memory() == {}
    # a later search changes nothing
    version = item.version
    item.detect(vector_of(space, 0.5 * u), 2.0)
    assert item.version == version
    np.testing.assert_allclose(residual_of(item, u).ravel(), force, atol=1e-12 * np.abs(force).max())


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta, adjoint", [(0.0, "elastic"), (1.0, "elastic"), (1.0, "consistent")])
def test_plastic(shared_tmp, theta, adjoint):
    """Tied bars that yield in tension: the uniform solution of one bar, step by step."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 3, 4, "quadrilateral")
    held = [Displacement("lower_bottom", ["free", 0.0]), Displacement("upper_top", ["free", 0.02]),
            Displacement("lower_left", [0.0, "free"]), Displacement("upper_left", [0.0, "free"])]  # fmt: skip
    case = scene(path, 2, [], held, 1, Material(E, 0.3, yield_stress=5.0, hardening=100.0), EXACT, 3, theta=theta,
                 adjoint=adjoint)  # fmt: skip
    with running(case) as (simulation, converged):
        assert converged
        stress = simulation.problem.items[0].stress(simulation.stepper.u)
        values = np.concatenate([s for s, _ in stress])
    table = np.concatenate(WORLD.allgather(values))
    np.testing.assert_allclose(table, np.tile(table[0], (len(table), 1)), atol=1e-6 * np.abs(table).max())
    assert np.abs(table).max() > 5.0


# -- ranks --------------------------------------------


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_ranks(shared_tmp, cell):
    dim = DIMENSION[cell]
    path, results = make_mesh(two_blocks, shared_tmp / "b.msh", dim, 3, 2, cell), []
    for comm in (WORLD, SELF):
        case, _ = pulled_and_sheared(path, dim)
        simulation = Simulation(case, comm)
        try:
            assert simulation.run()
            results.append(by_key(simulation.problem.space, simulation.stepper.u.getArray().reshape(-1, dim)))
        finally:
            simulation.close()
    np.testing.assert_allclose(*results, atol=1e-9 * np.abs(results[0]).max())


# -- what is refused ----------------------------------


@pytest.mark.parametrize("said, words", [
    ({"friction": 0.3}, "friction: found"), ({"tresca": 1.0}, "tresca: found"),
    ({"bilateral": True}, "bilateral: found"), ({"unbiased": True}, "unbiased: found"),
    ({"interference": "adjust"}, "interference: found"), ({"formulation": "penalty", "theta": 1.0}, "theta: found"),
])  # fmt: skip
def test_refused(tmp_path, said, words):
    path = two_blocks(tmp_path / "b.msh", 2, 1, 1, "triangle")
    with pytest.raises(InputError, match=words):
        Simulation(scene(path, 2, [], [], **said))
