"""Contact of all surfaces: its facets, against pairs, beside pairs, one group of many bodies, ranks, refusals."""

import numpy as np
import pytest

from drivers._common import make_mesh, running
from drivers.cases.stack import scene as heap_scene
from meshes import heap, one_block, two_blocks
from pcontact.contact.search.self_contact import facet_ids, outer_surfaces
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components, once
from pcontact.pairs import OUTER
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import Body, Contact, Displacement, Load, Obstacle
from pcontact.scene.validate import validate
from pcontact.simulation import Simulation
from pcontact.solve.preconditioners import rigid_motions
from pcontact.space.modes import near_pairs
from tests.support.blocks import blocks
from tests.support.pairs import by_key
from tests.support.small import DIMENSION, SELF, block_file, make_space

WORLD = MPI.COMM_WORLD
TIGHT = {"snes_rtol": "1e-10"}
PLANE = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])


def summary_of(case, comm=WORLD):
    """Summaries of the contacts and displacement by node. Collective."""
    simulation = Simulation(case, comm)
    try:
        assert simulation.run()
        u = simulation.stepper.u
        found = {item.name: item.summary(u) for item in simulation.problem.contacts}
        return found, by_key(simulation.problem.space, u.getArray().reshape(-1, simulation.mesh.dim)), simulation
    finally:
        simulation.close()


# -- which facets -------------------------------------


@pytest.mark.parametrize("n", [0, 1, 2, 7, 1000])
def test_keys_that_are_there_once(n):
    """As numpy counts them, also those that fall to one place of the table."""
    for keys in (np.random.default_rng(n).integers(0, n // 2 + 1, n), 4096 * np.arange(n), np.full(n, -1)):
        _, place, count = np.unique(keys, return_inverse=True, return_counts=True)
        assert np.array_equal(once(keys), count[place] == 1)


@pytest.mark.parallel
@pytest.mark.parametrize("cell", list(DIMENSION))
def test_outer_facets(shared_tmp, cell):
    """The whole boundary of a box, each facet on one rank."""
    path = shared_tmp / "b.msh"
    if WORLD.rank == 0:
        block_file(path, cell, 3)
    WORLD.Barrier()
    space = make_space(WORLD, path, ["block"])
    space.mesh.facet_groups[OUTER] = outer_surfaces(space)
    wanted = [facet_ids(space, name) for name in space.mesh.facet_groups if name != OUTER and "axis" not in name]
    own = np.sort(facet_ids(space, OUTER))
    np.testing.assert_array_equal(own, np.unique(np.concatenate(wanted)))
    dim = DIMENSION[cell]
    count = {"triangle": 12, "quadrilateral": 12, "hexahedron": 54}.get(cell)
    total = WORLD.allreduce(len(own))
    assert total == count or (count is None and total % 6 == 0), (dim, total)


def test_near_pairs():
    random = np.random.default_rng(0)
    low = random.uniform(0.0, 10.0, (60, 3))
    high = low + random.uniform(0.1, 1.0, (60, 3))
    apart = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)
    wanted = {(a, b) for a, b in zip(*np.nonzero(apart <= 0.7), strict=True) if a < b}
    assert {tuple(pair) for pair in near_pairs(low, high, 0.7).tolist()} == wanted and len(wanted) > 10


# -- against pairs ------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("more", [{}, {"friction": 0.3}, {"theta": 1.0}, {"theta": -1.0}, {"formulation": "penalty"},
                                  {"formulation": "augmented_lagrangian"}])  # fmt: skip
def test_like_an_unbiased_pair(shared_tmp, more):
    """Two boxes: the same force but for gamma of the corner cells, which have more facets in the surface."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 4, 5, "quadrilateral")
    one = summary_of(blocks(path, [Contact("upper_bottom", "lower_top", unbiased=True, name="pair", **more)]))[0]
    all_ = summary_of(blocks(path, [Contact(all=True, **more)]))[0]
    a, b = one["pair"], all_["all"]
    assert b["area"] == pytest.approx(a["area"], rel=1e-9) and b["slip"] + b["stick"] == a["slip"] + a["stick"]
    force = {body["body"]: np.array(body["force"]) for body in b["bodies"]}
    np.testing.assert_allclose(force["lower"], a["force"], rtol=0.0, atol=0.01 * abs(a["force"][1]))
    np.testing.assert_allclose(force["lower"] + force["upper"], 0.0, atol=1e-9 * abs(a["force"][1]))


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_loads_and_supports_stay_what_they_are(tmp_path, theta):
    """A facet with a load has a traction that is not that of contact: the adjoint term must not fight it."""
    path = two_blocks(tmp_path / "b.msh", 2, 4, 4, "quadrilateral")
    pressed = [Load("upper_top", pressure=20.0), Load("upper_right", pressure=7.0)]
    heights = []
    for contact in (Contact("upper_bottom", "lower_top", unbiased=True), Contact(all=True)):
        contact.theta = theta
        case = blocks(path, [contact], loads=pressed)
        case.displacements = case.displacements[:1]
        case.displacements += [Displacement(f"{name}_left", [0.0, "free"]) for name in ("lower", "upper")]
        with running(case) as (simulation, converged):
            assert converged
            heights.append(simulation.stepper.u.getArray().reshape(-1, 2)[:, 1].min())
    assert heights[1] == pytest.approx(heights[0], rel=2e-3)


@pytest.mark.parallel
def test_explicit_pairs_come_first(shared_tmp):
    """A pair with friction beside all surfaces without: the pair takes the facets, once."""
    path = make_mesh(two_blocks, shared_tmp / "b.msh", 2, 4, 5, "triangle")
    pair = Contact("upper_bottom", "lower_top", friction=0.4, name="pair")
    alone, beside = (summary_of(blocks(path, contacts)) for contacts in ([pair], [pair, Contact(all=True)]))
    assert beside[0]["all"]["area"] == 0.0 and beside[0]["all"]["bodies"] == []
    np.testing.assert_allclose(beside[0]["pair"]["force"], alone[0]["pair"]["force"], rtol=1e-6)
    np.testing.assert_allclose(beside[1], alone[1], atol=1e-8)


def test_tied_bodies_are_one(tmp_path):
    path = two_blocks(tmp_path / "b.msh", 2, 3, 4, "triangle")
    glue = Contact("upper_bottom", "lower_top", tied=True, name="glue")
    found, _, simulation = summary_of(blocks(path, [glue, Contact(all=True, self_contact=True)]))
    assert simulation.mesh.n_components == 1 and found["all"]["area"] == 0.0


# -- many bodies in one group -------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("dim, hollow", [(2, 0.0), (2, 0.6), (3, 0.0)])
def test_heap_on_any_ranks(shared_tmp, dim, hollow):
    """Loose bodies of one region in a box: the same on one rank; one item for all; forces balance."""
    h = 0.3 if dim == 2 else 0.6
    path, results = make_mesh(heap, shared_tmp / "h.msh", dim, 5, h, hollow, overlap=0.03), []
    for comm in (WORLD, SELF):
        case = heap_scene(path, dim, 5, steps=1, overlap=0.03, petsc=TIGHT)
        found, u, simulation = summary_of(case, comm)
        assert simulation.mesh.n_components == 5 and len(simulation.problem.items) == 2 + 2 * dim
        assert sorted(simulation.problem.features.loose) == sorted(simulation.floating) == list(range(5))
        assert len(found["all"]["bodies"]) == 5
        results.append((found, u))
    (one, u), (other, v) = results
    np.testing.assert_allclose(u, v, atol=1e-6 * np.abs(v).max())
    forces = [np.array([body["force"] for body in found["all"]["bodies"]]) for found in (one, other)]
    np.testing.assert_allclose(*forces, atol=1e-6 * np.abs(forces[0]).max())
    np.testing.assert_allclose(forces[0].sum(axis=0), 0.0, atol=1e-9 * np.abs(forces[0]).max())
    assert {k: one["all"][k] for k in ("stick", "slip")} == {k: other["all"][k] for k in ("stick", "slip")}


def test_own_body_is_passed_by(tmp_path):
    """Bodies far from each other: without self contact no facet is tried at all."""
    path = two_blocks(tmp_path / "b.msh", 2, 20, 20, "triangle", gap=0.5)
    counts = []
    for own in (False, True):
        case = blocks(path, [Contact(all=True, self_contact=own, search_radius=0.2)])
        case.displacements[1].value = [0.0, 0.0]
        simulation = summary_of(case)[2]
        counts.append(simulation.problem.items[1].search.among.candidates)
    assert counts[0] == 0 and counts[1] > 0


def test_rigid_motions(tmp_path):
    """Columns move one body each, and strain none."""
    path = heap(tmp_path / "h.msh", 2, 5, 0.5)
    simulation = Simulation(heap_scene(path, 2, 5))
    try:
        problem = simulation.problem
        basis = rigid_motions(problem.space, problem.conditions.fixed, sorted(simulation.floating))
        assert basis.getSize() == (problem.space.n_dofs, 15)
        x, u = basis.createVecRight(), problem.space.vector()
        x.setArray(np.random.default_rng(1).normal(size=15))
        basis.mult(x, u)
        force = np.zeros((problem.space.n_owned, 2))
        problem.items[0].residual(u, force)
        assert np.abs(force).max() < 1e-10 * 1000.0
    finally:
        simulation.close()


def test_group_of_many_bodies(tmp_path):
    """One body region: connected parts are told apart by the mesh alone."""
    raw = read_mesh(heap(tmp_path / "h.msh", 3, 5, 0.7))
    assert components(raw).max() == 4 and list(raw.cell_groups) == ["heap"]


# -- words --------------------------------------------


@pytest.mark.parametrize("contacts, words", [
    ([{"all": True, "source": "upper_bottom"}], r"\(all\)\.source: found a string 'upper_bottom' together with all"),
    ([{"all": True, "target": "upper_bottom"}], r"\.target: found"),
    ([{"all": True}, {"all": True, "name": "b"}], r"contacts\[1\] \(b\)\.all: found true a second time"),
    ([{"all": True, "bilateral": True}], r"\.bilateral: found true together with all"),
    ([{"all": True, "tied": True}], r"\.tied: found true together with all"),
    ([{"all": True, "theta": 1.0}, {"source": "upper_bottom", "target": "lower_top"}], r"\.theta: found 1 "),
    ([{"source": "upper_bottom", "target": "lower_top", "self_contact": True}], r"\.self_contact: found true with two"),
    ([{"all": True, "obstacle": PLANE, "self_contact": True}], r"\.self_contact: found true with an obstacle"),
    ([{"all": 1}], r"\.all: found"),
    ([{}], r"\.source: found nothing"),
])  # fmt: skip
def test_refused(tmp_path, contacts, words):
    path = two_blocks(tmp_path / "b.msh", 2, 1, 1, "triangle")
    with pytest.raises(InputError, match=words):
        validate(blocks(path, [Contact(**said) for said in contacts]))


def test_described(tmp_path):
    path = two_blocks(tmp_path / "b.msh", 2, 1, 1, "triangle")
    contacts = [Contact(all=True, friction=0.2), Contact(all=True, obstacle=PLANE, name="floor")]
    active, left_out = describe(blocks(path, contacts), 2)
    assert any("contact all" in line and "friction 0.2" in line for line in active)
    assert any("contact floor" in line and "rigid plane" in line for line in active)
    assert "self contact" in left_out and not {"contact of all surfaces", "unbiased contact"} & set(left_out)


@pytest.mark.parallel
@pytest.mark.parametrize("itself", [False, True])
def test_the_back_of_a_body_cuts_no_facet(shared_tmp, itself):
    """A block alone, as thin as its facets are long: all have as many points as one that faces nothing."""
    if WORLD.rank == 0:
        one_block(shared_tmp / "b.msh", 3, (3, 3, 1), size=(1.0, 1.0, 0.3), cell="tetrahedron")
    WORLD.Barrier()
    case = blocks(shared_tmp / "b.msh", [Contact(all=True, name="c", cut=True, self_contact=itself)], dim=3)
    case.bodies = [Body("block", "m")]
    case.displacements = [Displacement("bottom", [0.0, 0.0, 0.0])]
    simulation = Simulation(case)
    source = simulation.problem.items[1].source
    counts = np.unique(np.concatenate(WORLD.allgather(np.bincount(source.facet, minlength=len(source.cells)))))
    simulation.close()
    assert len(counts) == 1
