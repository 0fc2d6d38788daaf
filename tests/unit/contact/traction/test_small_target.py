"""Tractions of both sides: weights and areas against what is known of them, tangents, the surfaces exchanged."""

from functools import partial

import numpy as np
import pytest

from pcontact.contact.formulation.small import SmallTerms
from pcontact.contact.law import sticks_by_shear
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact
from tests.support.exchanged import displacement, scene
from tests.support.laws import LAWS
from tests.support.pairs import STEPS, bodies, check_taylor, motion
from tests.support.patch import blocks, solve
from tests.support.small import DIMENSION, SELF, bend, blocks_file, dense_item, elastic_solid, make_space, vector_of

WORLD = MPI.COMM_WORLD
SOFT, STIFF = lame(10.0, 0.45), lame(70.0, 0.2)


def pair(space, contact, radius=1.0):
    """Item of a contact between a soft and a stiff body whose first search is done by the caller."""
    constants = [SOFT, STIFF]
    source = source_surface(space, contact.source, constants, contact.quadrature, sticks=sticks_by_shear(contact))
    target = target_surface(space, contact.target)
    return contact_pair(space, contact, source, target, radius, bulk=elastic_solid(space, constants))


def gradients(space, values):
    """Displacements (n_owned, d) with a gradient (d, d) in each of two bodies."""
    x = space.points[space.owned_local]
    return np.einsum("nij,nj->ni", np.asarray(values)[space.component[space.owned_local]], x)


def stress(gradient, constants):
    """Of linear elasticity, plane strain."""
    strain = 0.5 * (gradient + gradient.T)
    return constants[0] * np.trace(strain) * np.eye(len(strain)) + 2.0 * constants[1] * strain


def facet_nodes(side):
    """Nodes of the facets: those whose shape functions are something there."""
    return [set(side.cells[f][side.shape[side.facet == f].max(axis=0) > 1e-9]) for f in range(len(side.cells))]


def sizes(side, covered):
    """Of what is covered beside their facets (nf,), from the areas (nf,) of the facets that are: facet by facet."""
    whole, on = np.bincount(side.facet, side.jxw, len(side.cells)), facet_nodes(side)
    most = [max(sum(covered[g] for g in range(len(on)) if node in on[g]) for node in nodes) for nodes in on]
    part = np.array([min(m / w, 1.0) if m > 0.0 else 1.0 for m, w in zip(most, whole, strict=True)])
    return part ** (1.0 / (side.x.shape[1] - 1))


def inclined(x, slope):
    """The upper block with a bottom that rises along x."""
    upper = x[:, -1] > 1.0
    x[upper, -1] += slope * (x[upper, 0] - 0.5) * (2.1 - x[upper, -1]) + 0.5 * abs(slope)
    return x


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_weights_areas_and_traction(tmp_path, cell, search, friction):
    """An inclined source over a flat target, both strained: w1 sigma1 n_X - w2 J sigma2 n_Y, with J that of the areas
    which lie beneath each other along the direction of the search."""
    d, slope = DIMENSION[cell], 0.5
    path = blocks_file(tmp_path / "b.msh", cell, 2, 3, gap=0.1)
    space = make_space(SELF, path, ["lower", "upper"], 1, lambda x: inclined(x, slope))
    contact = Contact("upper_bottom", "lower_top", theta=0.0, search=search, friction=0.3 if friction else None)
    item = pair(space, contact)
    rng = np.random.default_rng(3)
    both = 0.05 * rng.normal(size=(2, d, d))
    u = vector_of(space, gradients(space, both))
    item.detect(u, 1.0)
    source, p = item.source, item.pairing
    turn = [np.eye(d) + one for one in both]
    up = np.eye(d)[-1]
    areas = [np.linalg.det(f) * np.linalg.inv(f).T @ n for f, n in zip(turn, (up, source.normal[0]), strict=True)]
    ratio = np.abs(p.normal @ areas[1] / (p.normal @ areas[0]))
    # at the ends of the target partners are held, and no part of them counts
    some = p.paired & (p.operator.width > source.shape.shape[1])
    assert np.count_nonzero(some) > 0.5 * len(some)
    own, other = (stress(one, moduli) for one, moduli in zip(both[::-1], (STIFF, SOFT), strict=True))
    target = source_surface(space, "lower_top", [SOFT, STIFF], sticks=friction)
    on, partners = facet_nodes(target), p.exchange.nodes[p.targets]
    facet = np.array([next((f for f, nodes in enumerate(on) if nodes <= set(row)), 0) for row in partners])
    covered = np.bincount(facet[some], (ratio * source.jxw)[some], len(on))
    l1 = (source.trace / sizes(source, np.bincount(source.facet, source.jxw * some, len(source.cells))))[source.facet]
    l2 = (target.trace[0] / sizes(target, covered))[facet]
    w1 = np.where(some, ratio * l2 / (l1 + ratio * l2), 1.0)
    known = w1[:, None] * (source.normal @ own) - ((1.0 - w1) * ratio)[:, None] * (other @ up)
    gamma = np.where(some, ratio * l1 * l2 / (l1 + ratio * l2), l1) * item.method.gamma0
    if cell != "triangle" and cell != "tetrahedron":
        # cells on the ends of a simplicial mesh have other constants
        np.testing.assert_allclose(item.method.gamma, gamma, rtol=1e-9)
        shear = 4.0 * SOFT[1] / (SOFT[0] + 2.0 * SOFT[1]) if friction else 1.0
        part = (w1**2 * l1 + (1.0 - w1) ** 2 * ratio * l2 * np.where(some, shear, 0.0)) / (gamma / item.method.gamma0)
        np.testing.assert_allclose(item.method.alpha, part, rtol=1e-9)
        found = item.terms._evaluate(p, p.exchange.gather(u), p.every)[0]
        np.testing.assert_allclose(found, known if friction else np.sum(known * p.normal, axis=1)[:, None], atol=1e-12)


@pytest.fixture(scope="module", params=["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def stacked(request, tmp_path_factory):
    """Two boxes whose meshes do not match and which overhang: some source points have no partner."""
    d = DIMENSION[request.param]
    path = tmp_path_factory.mktemp("stacked") / "blocks.msh"
    blocks_file(path, request.param, [2] * d, [3] * (d - 1) + [1], offset=0.3)
    return make_space(SELF, path, ["lower", "upper"], 1)


@pytest.mark.parametrize("name", ["none", *LAWS])
@pytest.mark.parametrize("search", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("theta, alpha", [(1.0, 0.7), (0.0, 1.0), (-1.0, 0.7)])
def test_tangent_is_the_derivative(stacked, theta, search, name, alpha):
    """Open, sticking, slipping, without partner, in the second load step."""
    space = stacked
    contact = bodies("coulomb" if name == "none" else name, search, theta, alpha)
    if name == "none":
        contact.friction = None
    item = pair(space, contact, radius=0.3)
    first = motion(space, -0.01, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    assert type(item.terms) is SmallTerms and np.any(item.pairing.operator.width > item.source.shape.shape[1])
    for depth, slide, tilt in STEPS[:3]:
        u = first + motion(space, depth + 0.01, slide, tilt, seed=3)
        if name == "none" and theta == 1.0:
            k = dense_item(item, vector_of(space, u))
            np.testing.assert_allclose(k, k.T, atol=1e-13 * np.abs(k).max())
        check_taylor(item, u, "coulomb" if name == "none" else name)


def test_tangent_of_curved_cells_of_second_order(tmp_path):
    path = blocks_file(tmp_path / "b.msh", "triangle", 2, 1, order=2)
    space = make_space(SELF, path, ["lower", "upper"], 2, lambda x: bend(x, 0.03))
    for theta in (1.0, 0.0):
        item = pair(space, bodies("coulomb", theta=theta))
        item.detect(space.vector(), 1.0)
        for depth in (0.0, 0.2):
            check_taylor(item, motion(space, depth, 0.02), "coulomb")


# -- whole scenes ----------------------------------------


@pytest.mark.parallel
@pytest.mark.parametrize("theta", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("friction", [None, 0.5])
@pytest.mark.parametrize("cell, ratio", [("quadrilateral", 1e-3), ("triangle", 100.0), ("hexahedron", 10.0)])
def test_exchanged_surfaces_are_one_problem(shared_tmp, cell, ratio, friction, theta):
    """Flat surfaces, facets cut where the other side's end: the same displacement whichever is the source."""
    path = blocks(shared_tmp, cell, *((3, 2) if cell == "hexahedron" else (7, 4)), heights=(1.0, 0.3))
    said = {"theta": theta, "friction": friction, "search": "ray_tracing", "gamma0": 2.0 if theta == 1.0 else 1.0}
    said["nu"] = (0.45, 0.2)
    found = [solve(scene(path, DIMENSION[cell], ratio, swapped, **said), displacement)[0] for swapped in (False, True)]
    assert np.abs(found[0] - found[1]).max() < 1e-8 * np.abs(found[0]).max()


YIELDS = {"yield_stress": 3e-4, "hardening": 0.1}
EXPANDS = {"expansion": 1.0}
OTHERS = {"softer yields": (YIELDS, {}), "stiffer yields": ({}, YIELDS), "both yield": (YIELDS, YIELDS),
          "heated": (EXPANDS, {"expansion": 2.0}), "yields, heated": (YIELDS, EXPANDS)}  # fmt: skip


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [None, 0.5])
@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("cell, theta", [("quadrilateral", 0.0), ("triangle", 1.0), ("hexahedron", -1.0)])
def test_exchanged_surfaces_of_other_bodies(shared_tmp, cell, theta, kind, friction):
    """The same of bodies that yield or expand: what is not linear is that of both sides, too."""
    path = blocks(shared_tmp, cell, *((3, 2) if cell == "hexahedron" else (7, 4)), heights=(1.0, 0.3))
    said = {"theta": theta, "friction": friction, "search": "ray_tracing", "gamma0": 2.0 if theta == 1.0 else 1.0}

    def state(simulation):
        return displacement(simulation)[0], simulation.problem.bulk.plasticity()[0]

    case = partial(scene, path, DIMENSION[cell], 2.0, own=OTHERS[kind], **said)
    (one, p), (other, _) = (solve(case(swapped=swapped), state) for swapped in (False, True))
    assert ("yield" in kind) == (p > 1e-5)
    assert np.abs(one - other).max() < 1e-8 * np.abs(one).max()


@pytest.mark.parametrize("friction", [None, 0.5])
@pytest.mark.parametrize("ratio", [1e-8, 1e8])
def test_extreme_ratios_of_stiffness(shared_tmp, ratio, friction):
    """Whichever surface is the source, or both: few iterations, and the pressure of a mesh that matches."""
    path = blocks(shared_tmp, "quadrilateral", 8, 15, heights=(1.0, 0.3))

    def pressure(simulation):
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        return state["x"][:, 0], state["pressure"], state["weight"], displacement(simulation)[1]

    (shared_tmp / "fine").mkdir()
    fine = solve(scene(blocks(shared_tmp / "fine", "quadrilateral", 60, 60, heights=(1.0, 0.3)), 2, ratio), pressure)
    order = np.argsort(fine[0])
    for more in ({}, {"swapped": True}, {"unbiased": True}):
        x, found, weight, iterations = solve(scene(path, 2, ratio, friction=friction, **more), pressure)
        known = np.interp(x, fine[0][order], fine[1][order])
        assert iterations <= 12
        assert weight @ (found - known) ** 2 < 0.05**2 * (weight @ known**2)
