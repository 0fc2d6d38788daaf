"""Contact of bodies that yield: tangents against differences, extrapolation, pressure of a known stress, coercivity."""

import numpy as np
import pytest

from pcontact.assembly.geometry import bulk_degree
from pcontact.contact.formulation.methods import GAMMA0
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.contact.surface.sides import source_surface
from pcontact.contact.traction.small import Traction, extrapolation
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_points
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import plastic_constants
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Obstacle
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from tests.support.laws import LAWS
from tests.support.pairs import STEPS, motion, phases
from tests.support.plastic import (
    BARS,
    LAME,
    SOFT,
    YIELD,
    YIELD_STRAIN,
    YOUNG,
    Point,
    bar,
    check,
    flowing,
    items,
    mandel,
    taylor,
    tensor,
    uniaxial,
)
from tests.support.small import DIMENSION, SELF, block_file, blocks_file, dense_item, make_space, vector_of

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
ADJOINTS = [(1.0, "elastic"), (0.0, "elastic"), (-1.0, "elastic"), (1.0, "consistent"), (-1.0, "consistent")]
# cell, degree, kinematics, mean dilatation
CASES = [
    ("triangle", 1, "plane_strain", False),
    ("triangle", 2, "plane_stress", False),
    ("quadrilateral", 1, "plane_strain", True),
    ("quadrilateral", 1, "plane_stress", False),
    ("quadrilateral", 1, "axisymmetric", True),
    ("quadrilateral", 2, "plane_strain", False),
    ("quadrilateral", 2, "plane_strain", True),
    ("tetrahedron", 2, "plane_strain", False),
    ("hexahedron", 1, "plane_strain", True),
]
every_case = pytest.mark.parametrize("space", CASES, indirect=True, ids=lambda case: "-".join(map(str, case)))


@pytest.fixture(scope="module")
def space(request, tmp_path_factory):
    """Two stacked boxes whose meshes do not match, and which overhang."""
    cell, degree, kinematics, averaged = request.param
    path, d = tmp_path_factory.mktemp("b") / "b.msh", DIMENSION[cell]
    blocks_file(path, cell, 1 if d == 3 else 2, [1] * d if d == 3 else [3, 1], offset=0.3)
    mesh = make_space(SELF, path, ["lower", "upper"], degree).mesh
    return Space(mesh, degree, kinematics, *([[0, 1]] * 2 if averaged else []))


# -- tangents -----------------------------------------


@pytest.mark.parametrize("partner", ["body", "body that yields", "plane"])
@pytest.mark.parametrize("theta, adjoint", ADJOINTS)
# all cases together take long: those of the third law are left to the slow tests
@pytest.mark.parametrize("name", ["none", "coulomb", pytest.param("limit", marks=pytest.mark.slow)])
@every_case
def test_tangent(space, name, theta, adjoint, partner):
    """Open, sticking, slipping, mixed, in the second load step of a body that has yielded in the first."""
    d = space.dim
    if partner != "plane":
        side = {"target": "lower_top"}
    else:
        normal = [*[0.0] * (d - 1), 1.0]
        side = {"obstacle": Obstacle("plane", point=normal, normal=normal)}
    side |= LAWS.get(name, {})
    side |= {"theta": theta, "adjoint": adjoint, "alpha": 0.7, "gamma0": 1.0, "search": "closest_point"}
    contact = Contact("upper_bottom", **side)
    material = plastic_constants(*SOFT, 0.4), hardening_curve(0.05, 1.0)
    bulk, item = items(space, contact, [material if partner == "body that yields" else None, material], SOFT, 0.3)
    law = name if name in LAWS else "coulomb"
    first = motion(space, -0.01, 0.01, noise=0.006)
    item.detect(space.vector(), 0.5)
    for one in (bulk, item):
        one.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    assert 0.0 < max(s.p.max() for s in bulk.states.values()) < 0.3
    directions = [motion(space, 0.01, 0.01, 0.01, seed, 0.01) for seed in range(5, 9)]
    seen, curved = set(), 0
    for depth, slide, tilt in STEPS:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3, noise=0.006)
        before = [s.p.copy() for s in bulk.states.values()]
        curved += check(taylor(bulk, item, u, law, directions))
        if adjoint == "consistent" and theta == 1.0 and name == "none":
            k = dense_item(item, vector_of(space, u))
            np.testing.assert_allclose(k, k.T, atol=1e-13 * max(np.abs(k).max(), 1.0))
        seen |= set(phases(item, u, law)[:, 0])
        for a, s in zip(before, bulk.states.values(), strict=True):
            np.testing.assert_array_equal(a, s.p)
    assert curved >= 2
    assert seen >= ({OPEN, SLIP} if name == "none" else {OPEN, STICK, SLIP})


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", ["none", "coulomb"])
@every_case
def test_tangent_at_the_yield_surface(space, name, theta):
    """At the committed state the pair has the tangent of an elastic one; towards the inside it is exact."""
    said = {"theta": theta, "gamma0": 1.0, "search": "closest_point", **LAWS.get(name, {})}
    contact = Contact("upper_bottom", "lower_top", **said)
    bulk, item = items(space, contact, [None, (plastic_constants(*SOFT, 0.4), hardening_curve(0.02, 1.0))], SOFT, 0.3)
    first = motion(space, 0.03, 0.003, noise=0.006)
    item.detect(space.vector(), 1.0)
    bulk.commit(vector_of(space, first), 0.5)
    (yielded,) = (s.p > 0.0 for s in bulk.states.values())
    assert yielded.any()
    values = item.pairing.exchange.gather(vector_of(space, first))
    at, rows = item.terms.traction._excess.rows(values, item.pairing.cells)
    assert np.all(at == -1) and len(rows) == 0
    at, rows = item.terms.traction._excess.rows(1.5 * values, item.pairing.cells)
    assert np.any(at >= 0) and len(rows) == np.sum(at >= 0)
    errors = taylor(bulk, item, first, name if name in LAWS else "coulomb", [-first])
    # slip may turn in space
    assert check(errors) == (space.dim == 3 and name != "none") or np.all(errors < 1e-9)


# -- extrapolation ------------------------------------


@pytest.mark.parametrize("axisymmetric", [False, True])
@pytest.mark.parametrize("geometry", [1, 2])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", DIMENSION)
def test_extrapolation_is_exact_for_its_polynomials(cell, degree, geometry, axisymmetric):
    """Constants, linear functions on simplices; products of the displacement's degree on tensor cells."""
    d, rng = DIMENSION[cell], np.random.default_rng(0)
    points, _ = quadrature(cell, bulk_degree(cell, degree, geometry, axisymmetric and d == 2))
    xi = facet_points(cell, quadrature(CELLS[cell].facet, 5)[0]).reshape(-1, d)
    matrix = extrapolation(cell, degree, points, xi)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    powers = np.stack(np.meshgrid(*[range(degree + 1)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    if not CELLS[cell].is_tensor:
        powers = powers[powers.sum(axis=1) < degree]
    weights = rng.normal(size=len(powers))

    def polynomial(x):
        return np.prod(x[:, None, :] ** powers, axis=2) @ weights

    np.testing.assert_allclose(matrix @ polynomial(points), polynomial(xi), rtol=0, atol=1e-12)


@every_case
def test_traction_of_a_uniform_stress(space):
    """Excess times outward normal, at the points of every side."""
    material = plastic_constants(*LAME, 15.0), hardening_curve(0.5, 20.0)
    mode = "3D" if space.dim == 3 else {"plane_stress": "plane stress"}.get(space.kinematics, "plane strain")
    slope = 3.0 * YIELD_STRAIN * np.random.default_rng(1).normal(size=(space.dim, space.dim))
    if space.kinematics == "axisymmetric":
        slope[0] = 0.0  # no hoop strain
    u, strain = space.points[space.owned_local] @ slope.T, np.zeros((3, 3))
    strain[: space.dim, : space.dim] = 0.5 * (slope + slope.T)
    point = Point(material, mode)
    excess, *_ = point.raw(mandel(strain, point.m))
    assert np.abs(excess).max() > 0.1
    for side in ("upper_bottom", "upper_left", "upper_right", "upper_top"):
        bulk, item = items(space, Contact(side, "lower_top", theta=0.0, gamma0=1.0), [None, material], LAME)
        values = vector_of(space, u)
        local = space.local.gather(values)
        found = np.zeros_like(item.source.x)
        item.terms.traction._excess.add(local, np.ascontiguousarray(item.source.cells), found)
        expected = item.source.normal @ tensor(excess)[: space.dim, : space.dim]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    lower = source_surface(space, "lower_top", bulk.constants)
    assert Traction(lower).of_materials(space, bulk, "lower_top", 1.0).symmetric


class Pressed(Observer):
    """Pressures and force of the floor, stress of the cells, reaction after every step."""

    def __init__(self):
        self.rows, self.simulation = [], None

    def step(self, step, u, record):
        bulk, floor = self.simulation.problem.items
        stress = np.concatenate(WORLD.allgather(np.concatenate([values for values, _ in bulk.stress(u)])))
        pressure = np.concatenate(WORLD.allgather(floor.state(u)["pressure"]))
        self.rows.append((stress, pressure, record["contacts"]["floor"], record["reactions"]["top"]))

    def cut(self, target, outcome):
        raise AssertionError(outcome)


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("hardening, kinematic", [(0.0, 0.0), (20.0, 0.0), (20.0, 30.0)])
@pytest.mark.parametrize("kinematics, held", [pytest.param(*BARS[0], marks=pytest.mark.parallel), *BARS[1:]])
def test_pressed_on_a_plane(shared_tmp, kinematics, held, hardening, kinematic, theta):
    """A block pressed until it yields, let go a little, pressed again: the pressure is its uniform stress."""
    strains = -np.array([0.9, 2.0, 4.0, 3.5, 6.0]) * YIELD_STRAIN
    table = [(0.0, 0.0), *((k + 1.0, e) for k, e in enumerate(strains))]
    scene = bar(shared_tmp / "b.msh", kinematics, 2, held, hardening, kinematic, table)
    d = 3 if kinematics == "3D" else 2
    (floor,) = (k for k, support in enumerate(scene.displacements) if support.region == "bottom")
    del scene.displacements[floor]
    plane = Obstacle("plane", point=[0.0] * d, normal=[*[0.0] * (d - 1), 1.0])
    scene.contacts = [Contact("bottom", obstacle=plane, name="floor", theta=theta)]
    look, simulation = Pressed(), Simulation(scene)
    look.simulation = simulation
    try:
        assert simulation.run(None, [look])
    finally:
        simulation.close()
    rates = (2.0 * LAME[1], 3.0 * LAME[1]) if held else (YOUNG, YOUNG)
    expected = uniaxial(strains, *rates, hardening, kinematic)
    area = np.pi if kinematics == "axisymmetric" else 1.0
    for (stress, pressure, contact, top), e, (driving, _, _) in zip(look.rows, strains, expected, strict=True):
        along = (LAME[0] + 2.0 / 3.0 * LAME[1]) * e + 2.0 / 3.0 * driving if held else driving
        assert along < 0.0
        np.testing.assert_allclose(stress[:, d - 1], along, rtol=0, atol=1e-10 * YIELD)
        np.testing.assert_allclose(pressure, -along, rtol=0, atol=1e-10 * YIELD)
        assert contact["force"][-1] == pytest.approx(top[-1], abs=1e-10 * YIELD * area)
        assert top[-1] == pytest.approx(area * along, abs=1e-10 * YIELD * area)
        assert contact["open"] == 0


# -- coercivity ---------------------------------------


def lowest(space, theta, gamma0, friction, hardening, size, adjoint="elastic"):
    """Smallest over largest eigenvalue of the symmetric part of the tangent; all points closed, all yield.

    The strain is that of a block pressed on the plane, ``size`` times as far as to first yield in plane strain.
    """
    d = space.dim
    plane = Obstacle("plane", point=[0.0] * d, normal=[*[0.0] * (d - 1), 1.0])
    contact = Contact("bottom", obstacle=plane, theta=theta, gamma0=gamma0, adjoint=adjoint, bilateral=True)
    contact.friction = friction
    material = plastic_constants(*LAME), hardening_curve(0.5, hardening)
    bulk, item = items(space, contact, [material], LAME)
    item.detect(space.vector(), 1.0)
    u = np.zeros((space.n_owned, d))
    u[:, -1] = -size * 0.5 / (2.0 * LAME[1]) * space.points[space.owned_local, -1]
    assert flowing(bulk, u).all()
    at = vector_of(space, u)
    k = dense_item(bulk, at) + dense_item(item, at)
    eigenvalues = np.linalg.eigvalsh(0.5 * (k + k.T))
    return eigenvalues[0] / eigenvalues[-1]


@pytest.fixture(scope="module")
def one_cell(request, tmp_path_factory):
    """One cell, or simplices that fill it."""
    cell, degree, kinematics, averaged = request.param
    path = block_file(tmp_path_factory.mktemp("one") / "b.msh", cell, 1)
    return Space(make_space(SELF, path, ["block"], degree).mesh, degree, kinematics, [0] if averaged else [])


def cells(*cases):
    return pytest.mark.parametrize("one_cell", cases, indirect=True, ids=lambda case: "-".join(map(str, case)))


@pytest.mark.parametrize("size", [1.6, 6.0])
@pytest.mark.parametrize("hardening", [100.0, 2.0, 0.0])
@pytest.mark.parametrize("friction", [None, 1e9])
@cells(*(case for case in CASES if case[2] != "axisymmetric"), ("quadrilateral", 1, "plane_strain", False))
def test_coercive_without_adjoint(one_cell, friction, hardening, size):
    """theta = 0, down to perfect plasticity: little more than 1/4, as for elastic bodies, and so with the default."""
    for gamma0 in (0.4, GAMMA0[0.0]):
        assert lowest(one_cell, 0.0, gamma0, friction, hardening, size) > -1e-12


@pytest.mark.parametrize("theta", [1.0, -1.0])
@pytest.mark.parametrize("friction", [None, 1e9])
@cells(*(case for case in CASES if case[2] == "plane_strain"), ("quadrilateral", 1, "plane_stress", False))
def test_coercive_with_the_elastic_adjoint(one_cell, friction, theta):
    """The defaults where hardening is half of Young's modulus; near perfect plasticity a cell that may flow without
    any resistance is not coercive, since the adjoint is that of elasticity (theta = 0 is).
    """
    assert lowest(one_cell, theta, GAMMA0[theta], friction, 100.0, 1.6) > -1e-12
    free = one_cell.dim == 3 or one_cell.kinematics == "plane_stress"
    if free and friction is None and one_cell.degree == 1:
        assert lowest(one_cell, theta, 100.0, friction, 0.02, 1.6) < -1e-8


@pytest.mark.parametrize("hardening", [100.0, 2.0, 0.0])
@pytest.mark.parametrize("theta", [1.0, -1.0])
@pytest.mark.parametrize("friction", [None, 1e9])
@cells(*(case for case in CASES if case[2] == "plane_strain"), ("quadrilateral", 1, "plane_stress", False))
def test_coercive_with_the_consistent_adjoint(one_cell, friction, theta, hardening):
    """Down to perfect plasticity, from little more than the elastic bound (1 for theta = 1)."""
    for gamma0 in (1.2, GAMMA0[theta]):
        assert lowest(one_cell, theta, gamma0, friction, hardening, 1.6, "consistent") > -1e-12
