"""Tractions of both sides at finite motion: what they are, their tangents, surfaces exchanged."""

import numpy as np
import pytest

from pcontact.assembly.finite import FiniteSolid
from pcontact.contact.finite_pair import finite_pair
from pcontact.contact.law import OPEN
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.contact.traction.finite import WeightedFiniteTraction
from pcontact.material.elastic import in_plane
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Displacement, Material
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from tests.support.exchanged import displacement, scene
from tests.support.finite import LAM, MU, finite_material
from tests.support.finite_contact import mesh, moved, slanted, two
from tests.support.patch import blocks, solve
from tests.support.small import DIMENSION, SELF, bend, blocks_file, dense_item, make_space, vector_of

SOFT, STIFF = (LAM, MU), (7.0 * LAM, 7.0 * MU)


def strained(space, seed=0, size=0.03):
    """A displacement (n_owned, d) of both bodies, each with a gradient of its own and the upper one a little lower."""
    rng, x = np.random.default_rng(seed), space.points[space.owned_local]
    upper = space.component[space.owned_local] == 1
    u = 0.003 * rng.standard_normal(x.shape)
    for body, middle in ((~upper, 1.0), (upper, 1.0)):
        arm = x[body] - np.array([*[0.5] * (space.dim - 1), middle])
        u[body] += arm @ (size * rng.standard_normal((space.dim, space.dim))).T
    u[upper, -1] -= 0.02
    u[upper, 0] += 0.013
    return u


def pair(space, laws=("hencky", "multiplicative"), radius=0.4, swapped=False, **said):
    """Item of a contact of two blocks with the materials of two laws."""
    materials = [finite_material(law) for law in laws]
    constants = [in_plane(*moduli, space.kinematics) for moduli in (SOFT, STIFF)]
    bulk = FiniteSolid(space, constants, materials)
    names = ("lower_top", "upper_bottom") if swapped else ("upper_bottom", "lower_top")
    contact = Contact(*names, **said)
    source = source_surface(space, contact.source, constants, contact.quadrature)
    return finite_pair(space, bulk, contact, source, target_surface(space, contact.target), radius), bulk


@pytest.fixture(scope="module", params=["quadrilateral", "triangle", "hexahedron", "tetrahedron", "axisymmetric"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang."""
    cell = "quadrilateral" if request.param == "axisymmetric" else request.param
    d, path = DIMENSION[cell], tmp_path_factory.mktemp("stacked") / "blocks.msh"
    n = (1, 2) if d == 3 else (2, 3)
    blocks_file(path, cell, [n[0]] * d, [n[1]] * (d - 1) + [1], offset=0.2)
    if cell == request.param:
        return make_space(SELF, path, ["lower", "upper"], 1, lambda x: bend(x, 0.02))
    space = make_space(SELF, path, ["lower", "upper"], 1, lambda x: bend(x, 0.02) + np.array([1.0, 0.0]))
    return Space(space.mesh, 1, "axisymmetric")


def residual(item, u):
    out = np.zeros((item.space.n_owned, item.space.dim))
    item.residual(vector_of(item.space, u), out)
    return out.ravel()


def check_difference(item, u, tolerance=1e-6):
    """The tangent along some directions by differences of fourth order, of those that change no status the best."""
    # nothing is taken off where bodies overlap
    item.terms._made = 60
    k, space, errors = dense_item(item, vector_of(item.space, u)), item.space, []
    for seed, h in ((seed, h) for seed in range(3) for h in (1e-5, 1e-6, 1e-7)):
        v = np.random.default_rng(seed).standard_normal(u.shape)
        r = [residual(item, u + s * h * v) for s in (2.0, 1.0, -1.0, -2.0)]
        slope = (8.0 * (r[1] - r[2]) - (r[0] - r[3])) / (12.0 * h)
        errors.append(np.abs(slope - k @ v.ravel()).max() / np.abs(slope).max())
    assert min(errors) < tolerance, (errors, space.dim)


@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta, friction", [(0.0, None), (0.0, 0.05), (0.0, 2.0), (1.0, 0.3), (-1.0, 0.3)])
@pytest.mark.parametrize("laws", [("neo_hooke", "hencky"), ("hencky", "multiplicative")], ids="-".join)
def test_tangent_is_the_derivative(stacked, laws, theta, friction, search):
    """In the second load step, of points that slide along facets; elastic bodies and those that yield."""
    item, bulk = pair(stacked, laws, theta=theta, friction=friction, search=search, gamma0=1.0)
    first, second = strained(stacked, 0), strained(stacked, 1)
    item.detect(stacked.vector(), 0.5)
    bulk.commit(vector_of(stacked, 0.5 * first), 0.5)
    item.commit(vector_of(stacked, 0.5 * first), 0.5)
    item.detect(vector_of(stacked, first), 1.0)
    assert type(item.terms.traction) is WeightedFiniteTraction
    sided = item.terms.wide(item.pairing)
    state = item.state(vector_of(stacked, first))
    assert np.any(sided & (state["status"] > OPEN)) and np.any(item.terms.traction._other > 0.1)
    check_difference(item, first)
    if not np.any(~np.isfinite(residual(item, second))):
        check_difference(item, 0.8 * first + 0.2 * second)


@pytest.mark.parametrize("theta", [1.0, -1.0])
def test_forces_do_not_depend_on_where_partners_were_looked_for(stacked, theta):
    """The adjoint is that of the places of the last search, which goes on until that matters no more."""
    before, begin, found = vector_of(stacked, 0.5 * strained(stacked)), strained(stacked), []
    u = begin.copy()
    u[stacked.component[stacked.owned_local] == 1, 0] += 1e-5
    for ahead in (begin, u):
        item, bulk = pair(stacked, theta=theta, friction=0.3, search="closest_point", gamma0=1.0)
        item.detect(stacked.vector(), 0.5)
        bulk.commit(before, 0.5)
        item.commit(before, 0.5)
        item.detect(before, 1.0, ahead=vector_of(stacked, ahead))
        searches = 0
        while item.renew(vector_of(stacked, u), before, 1.0, tolerance=1e-10) and searches < 3:
            searches += 1
        assert item.stale < 1e-10 and searches < 3
        found.append(residual(item, u))
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9 * np.abs(found[0]).max())


def test_no_part_beside_corners(tmp_path):
    """A target that goes around the upper corner of the lower block: its facets there say nothing."""
    path = blocks_file(tmp_path / "b.msh", "quadrilateral", [4, 4], [4, 1], offset=0.2)
    space = make_space(SELF, path, ["lower", "upper"])
    groups = space.mesh.facet_groups
    parts, corner = {}, {}
    for around in (False, True):
        if around:
            groups["lower_top"] = [*groups["lower_top"], *groups["lower_right"]]
        item, _ = pair(space, search="ray_tracing", theta=0.0, gamma0=1.0)
        item.detect(space.vector(), 1.0)
        parts[around] = item.terms.wide(item.pairing)
        corner[around] = item.pairing.paired & (item.source.x[:, 0] > 0.75)
    assert corner[True].any() and parts[False][corner[True]].any() and not parts[True][corner[True]].any()
    np.testing.assert_array_equal(parts[True][~corner[True]], parts[False][~corner[True]])


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta", [0.0, -1.0])
@pytest.mark.parametrize("cell, order", [("quadrilateral", 1), ("triangle", 2)])
def test_patch_of_stretched_surfaces(shared_tmp, cell, order, theta, search, swapped):
    """The lower block, 1.4 wide, is pressed into the width of the upper one, and both against each other: areas that
    face each other are 1.4 times as large. Pressures are uniform to round-off, and balance by these areas."""
    # the source has the smaller facets, each on one of the target
    n = (4, 2) if swapped else (2, 4)
    path = mesh(slanted, shared_tmp / f"{cell}_{order}_{n[0]}.msh", *n, order, cell, 0.0, 1.4)
    names = ("lower_top", "upper_bottom") if swapped else ("upper_bottom", "lower_top")

    def place(x, time):
        # both bodies have corners at the height of the interface, at 1 and 1.4
        below = (x[:, 1:] < 0.0) | (x[:, :1] > 1.2)
        return x + time * ((1.0 / 1.4 - 1.0) * x[:, :1] * [1.0, 0.0] * below - [0.0, 0.1] * (x[:, 1:] == 1.0))

    def look(simulation):
        space, u = simulation.problem.space, simulation.stepper.u
        (pair,) = simulation.problem.contacts[0].pairs
        state, wide = pair.state(u), pair.terms.wide(pair.pairing)
        assert np.all(state["status"] > 0) and wide.all() and 0.05 < pair.terms.traction._own.min() < 0.95
        np.testing.assert_allclose(state["traction"][:, 0], 0.0, atol=1e-10)
        assert np.ptp(state["traction"][:, 1]) < 1e-10 * np.abs(state["traction"][:, 1]).max()
        values, body = space.local.gather(u), space.component
        for k in range(2):
            x, y = space.points[body == k, 1], values[body == k, 1]
            assert np.abs(np.polyval(np.polyfit(x, y, 1), x) - y).max() < 1e-11
        assert np.abs(state["gap"]).max() < 1e-11

    materials = Material(1.0, 0.3, law="neo_hooke"), Material(3.0, 0.3)
    scene = two(path, 4, materials, held=(), search=search, theta=theta, order=order, source=names[0], target=names[1])
    if theta:
        scene.contacts[0].gamma0 = 1.0
    scene.displacements = [Displacement("sides", [0.0, "free"]), Displacement("bottom", ["free", 0.0]),
                           Displacement("top", ["free", 0.0])]  # fmt: skip
    moved(scene, place, look)


def exchanged(path, ratio, load, **said):
    """How much the displacements of flat blocks differ, either surface the source, and Newton iterations."""
    said = {"strain": "finite", "load": load, "theta": 0.0, "search": "ray_tracing", **said}
    cases = [scene(path, 2, ratio, swapped, **said) for swapped in (False, True)]
    for case in cases:
        case.petsc |= {"pc_type": "lu", "ksp_type": "preonly"}
    (one, first), (other, second) = (solve(case, displacement) for case in cases)
    return np.abs(one - other).max() / np.abs(one).max(), max(first, second)


@pytest.mark.parallel(1, 3)
@pytest.mark.parametrize("ratio, friction", [(1e-3, None), (1e3, 0.5), (1e3, None), (1e-3, 0.5)])
def test_exchanged_surfaces_are_one_problem(shared_tmp, ratio, friction):
    """Flat surfaces that hardly bend; those that bend more differ by how far their facets are from each other."""
    path = blocks(shared_tmp, "quadrilateral", 7, 4, heights=(1.0, 0.3))
    # places of 1 have an error of 1e-16, displacements of 4e-7 one of 1e-9
    difference, iterations = exchanged(path, ratio, 4e-7, friction=friction)
    assert difference < 1e-8 and iterations <= 8
    difference, iterations = exchanged(path, ratio, 1e-3, friction=friction)
    assert difference < 1e-5 and iterations <= 8


@pytest.mark.parametrize("friction", [None, 0.5])
@pytest.mark.parametrize("ratio", [1e-8, 1e8])
def test_extreme_ratios_of_stiffness(shared_tmp, ratio, friction):
    path = blocks(shared_tmp, "quadrilateral", 8, 15, heights=(1.0, 0.3))
    difference, iterations = exchanged(path, ratio, 1e-3, friction=friction)
    assert difference < 1e-4 and iterations <= 12


@pytest.mark.parallel(1, 3)
@pytest.mark.parametrize("cell, theta, search", [("quadrilateral", -1.0, "closest_point"),
                                                 ("tetrahedron", 0.0, "ray_tracing")])  # fmt: skip
def test_on_any_ranks(shared_tmp, cell, theta, search):
    """Cells of partners are on other ranks; bodies that yield, and slide by a part of a facet."""
    path = blocks(shared_tmp, cell, *((5, 3) if cell == "quadrilateral" else (3, 2)), heights=(1.0, 0.3))
    yields = {"yield_stress": 0.03, "hardening": 0.1}
    said = {"strain": "finite", "load": 0.03, "theta": theta, "friction": 0.2, "search": search, "gamma0": 1.0}
    one = scene(path, DIMENSION[cell], 2.0, own=(yields, yields), **said)
    one.displacements = [Displacement("lower_bottom", [0.0] * DIMENSION[cell])]
    one.loads[0].traction[0] = "0.004"

    def look(simulation):
        assert simulation.problem.bulk.plasticity()[0] > 1e-3
        return displacement(simulation)[0]

    alone, together = (run(one, comm, look) for comm in (SELF, MPI.COMM_WORLD))
    assert np.abs(alone - together).max() < 1e-8 * np.abs(alone).max()


def run(case, comm, look):
    """What ``look`` makes of a simulation that converges. Collective."""
    simulation = Simulation(case, comm)
    try:
        assert simulation.run()
        return look(simulation)
    finally:
        simulation.close()
