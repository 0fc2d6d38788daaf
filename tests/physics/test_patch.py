"""Uniform pressure through a contact, exact where the quadrature is; overlaps resolved or adjusted away."""

from itertools import product

import numpy as np
import pytest

from drivers.cases.patch import errors, scene
from meshes import overclosed_cubes
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from tests.support.patch import blocks, solve
from tests.support.small import DIMENSION

WORLD = MPI.COMM_WORLD
ROUNDOFF = 1e-9
LAM = MU = 50.0
# on several ranks half of them will do
VARIANTS = list(product((1.0, 0.0, -1.0), ("closest_point", "ray_tracing")))
VARIANTS = VARIANTS if WORLD.size == 1 else [VARIANTS[k] for k in (0, 3, 4)]


@pytest.mark.slow
@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("n_lower", "n_upper"), [(2, 2), (2, 4)])
@pytest.mark.parametrize("cell", list(DIMENSION))
def test_exact_on_matching_and_nested_meshes(shared_tmp, cell, n_lower, n_upper, order):
    path = blocks(shared_tmp, cell, n_lower, n_upper)
    for theta, search in VARIANTS:
        wrong = solve(scene(path, DIMENSION[cell], order, theta=theta, search=search), errors)
        assert max(wrong) < ROUNDOFF, (theta, search)


@pytest.mark.slow
@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("lower", "upper"),
    [("triangle", "quadrilateral"), ("quadrilateral", "triangle"), ("hexahedron", "tetrahedron")],
)
def test_exact_between_different_cells(shared_tmp, lower, upper, order):
    path = blocks(shared_tmp, lower, 2, 4, cell_upper=upper)
    for theta in (1.0, 0.0, -1.0):
        assert max(solve(scene(path, DIMENSION[lower], order, theta=theta), errors)) < ROUNDOFF, theta


@pytest.mark.parametrize("order", [1, 2])
def test_squares_above_triangles_are_off_by_the_quadrature_alone_if_not_cut(shared_tmp, order):
    # the diagonals of the target cut the source's facets, although all vertices match
    path = blocks(shared_tmp, "tetrahedron", 2, 2, cell_upper="hexahedron")
    wrong = [max(solve(scene(path, 3, order, quadrature=degree, cut=False), errors)) for degree in (5, 11, 20)]
    assert wrong[0] > wrong[1] > wrong[2] and wrong[2] < 0.2 * wrong[0]


@pytest.mark.slow
@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize(("n_lower", "n_upper"), [(3, 4), (4, 3)], ids=["source finer", "target finer"])
def test_exact_in_2d_where_meshes_do_not_match(shared_tmp, cell, n_lower, n_upper, order):
    """Source facets are cut where their partner changes."""
    path = blocks(shared_tmp, cell, n_lower, n_upper)
    for theta, search in VARIANTS:
        wrong = solve(scene(path, 2, order, theta=theta, search=search), errors)
        assert max(wrong) < ROUNDOFF, (theta, search)


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
@pytest.mark.parametrize(("n_lower", "n_upper"), [(3, 4), (4, 3)], ids=["source finer", "target finer"])
def test_error_falls_with_the_quadrature_of_whole_facets_in_3d(shared_tmp, cell, n_lower, n_upper):
    path = blocks(shared_tmp, cell, n_lower, n_upper)
    # the worst of neighbouring degrees: how the points lie about the target's edges is luck
    wrong = [
        max(solve(scene(path, 3, quadrature=degree, cut=False), errors)[1] for degree in pair)
        for pair in ((1, 2), (5, 7), (17, 20))
    ]
    assert wrong[0] > wrong[1] > wrong[2]
    assert wrong[2] < 0.12 * wrong[0] and wrong[2] < (5e-3 if n_upper > n_lower else 2e-2)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_default_solver_and_tolerances(shared_tmp, theta):
    """Quadratic hexahedra are the hardest for the multigrid method."""
    path = blocks(shared_tmp, "hexahedron", 2, 4)
    case = scene(path, 3, 2, theta=theta)
    case.petsc = {}
    assert max(solve(case, errors)) < 1e-5


def cubes(path, order, theta, interference):
    """Two overlapping cubes between symmetry planes."""
    free = "free"
    young, poisson = MU * (3.0 * LAM + 2.0 * MU) / (LAM + MU), 0.5 * LAM / (LAM + MU)
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": Material(young, poisson)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", theta=theta, interference=interference)],
        displacements=[
            Displacement("left", [0.0, free, free]),
            Displacement("front", [free, 0.0, free]),
            Displacement("lower_bottom", [free, free, 0.0]),
            Displacement("upper_top", [free, free, 0.0]),
        ],
        output=Output(fields=False),
    )


def extremes(simulation):
    """Largest displacement in each direction; smallest and largest contact pressure. Collective."""
    u = simulation.problem.space.local.gather(simulation.stepper.u)
    pressure = simulation.problem.contacts[0].state(simulation.stepper.u)["pressure"]
    largest = np.abs(u).max(axis=0) if len(u) else np.zeros(3)
    values = [*largest, np.max(-pressure, initial=-np.inf), np.max(pressure, initial=-np.inf)]
    values = np.array(WORLD.allgather(values)).max(axis=0)
    return values[:3], -values[3], values[4]


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize(("cell", "order"), [("hexahedron", 1), ("tetrahedron", 1), ("hexahedron", 2)])
def test_overclosed_cubes(shared_tmp, cell, order, theta):
    """Uniaxial stress: each cube gives half the overlap of 0.01, p = E * 0.005, and 0.005 nu sideways."""
    path = shared_tmp / "cubes.msh"
    on_root(WORLD, lambda: overclosed_cubes(path, 2, 4, cell))
    largest, low, high = solve(cubes(path, order, theta, "resolve"), extremes)
    assert largest == pytest.approx([0.00125, 0.00125, 0.005], abs=1e-8)
    assert max(largest) == pytest.approx(0.005, abs=1e-6)
    assert (low, high) == pytest.approx((0.625, 0.625), rel=1e-5)


@pytest.mark.parallel(2, 3)
def test_overclosed_cubes_on_meshes_that_do_not_match(shared_tmp):
    path = shared_tmp / "cubes.msh"
    on_root(WORLD, lambda: overclosed_cubes(path, 3, 4))
    case = cubes(path, 1, 0.0, "resolve")
    case.contacts[0].quadrature = 20
    largest, low, high = solve(case, extremes)
    assert max(largest) == pytest.approx(0.005, abs=1e-6)
    assert (low, high) == pytest.approx((0.625, 0.625), rel=1e-3)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_adjusted_overlap_leaves_nothing(shared_tmp, cell):
    path = shared_tmp / "cubes.msh"
    on_root(WORLD, lambda: overclosed_cubes(path, 3, 4, cell))
    largest, low, high = solve(cubes(path, 1, 0.0, "adjust"), extremes)
    assert np.all(largest == 0.0)
    assert low == high == 0.0
