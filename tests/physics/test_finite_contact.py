"""Contact at finite strain against closed forms: patch, turned bodies."""

from dataclasses import replace

import numpy as np
import pytest

from drivers._common import running
from drivers.cases.large_sliding import ironing_scene
from meshes.blocks import one_block
from meshes.ironing import ironing_slab
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.finite_contact import mesh, moved, slanted, turn, two

# deformation of both blocks, law, traction per undeformed area on the source, not turned and turned by 60 degrees
PATCH = {
    "frictionless": (np.diag([0.8, 0.8]), {}, (-0.130097, 0.520387), (-0.515717, 0.147526)),
    "stick": (np.diag([1.1, 0.7]), {"friction": 2.0}, (-0.017082, 0.589227), (-0.518826, 0.279820)),
}


@pytest.mark.parametrize("search", ["ray_tracing", "closest_point"])
@pytest.mark.parametrize("degrees", [0.0, 60.0])
@pytest.mark.parametrize("name", PATCH)
@pytest.mark.parametrize("theta", [0.0, -1.0])
@pytest.mark.parametrize("cell, order", [("quadrilateral", 1), ("triangle", 2), ("quadrilateral", 2)])
def test_patch(shared_tmp, name, degrees, search, theta, cell, order):
    """Blocks whose meshes do not match, at a homogeneous deformation: to round-off."""
    path = mesh(slanted, shared_tmp / f"slanted_{cell}_{order}.msh", order=order, cell=cell)
    f, law, still, turned = PATCH[name]

    def place(x, time):
        return x @ (turn(degrees * time) @ (np.eye(2) + time * (f - np.eye(2)))).T

    def look(simulation):
        space, u = simulation.problem.space, simulation.stepper.u
        x = space.points + space.local.gather(u)
        np.testing.assert_allclose(x, place(space.points, 1.0), atol=1e-11)
        (pair,) = simulation.problem.contacts[0].pairs
        state = pair.state(u)
        assert np.all(state["status"] > 0)
        expected = turned if degrees else still
        np.testing.assert_allclose(state["traction"], np.tile(expected, (len(state["gap"]), 1)), atol=2e-6)
        assert np.abs(state["gap"]).max(initial=0.0) < 1e-11
        if theta == 0.0 and "slip" in state:
            assert np.abs(state["slip"]).max(initial=0.0) < 1e-11

    scene = two(path, 6, search=search, theta=theta, **law, order=order)
    if theta:
        scene.contacts[0].gamma0 = 1.0
    moved(scene, place, look)


def test_points_hardly_beyond_their_facets(shared_tmp):
    """A solution at which points have slid over the edges of their facets: hardly, they may keep them; farther, not."""
    simulation = Simulation(two(mesh(slanted, shared_tmp / "edges.msh"), 1, search="ray_tracing"))
    try:
        space, (pair,) = simulation.problem.space, simulation.problem.contacts[0].pairs
        u, before = space.vector(), space.vector()
        upper = np.isin(np.arange(len(space.points)), pair.source.cells)[space.owned_local]
        along, into = np.array([4.0, 1.0]) / 17**0.5, np.array([1.0, -4.0]) / 17**0.5
        for slid, kept in ((0.02, True), (0.2, False)):
            pair.detect(before, 0.0)
            u.setArray(np.where(upper[:, None], slid * along + 1e-3 * into, 0.0).ravel())
            assert pair.renew(u, before, 1.0, firm=True) is not kept
            assert pair.renew(u, before, 1.0) is kept
    finally:
        simulation.close()


class States(Observer):
    """The state of the pair after every load step, and Newton's residuals."""

    def __init__(self):
        self.states, self.norms, self.pair = [], [], None

    def step(self, step, u, record):
        self.states.append(self.pair.state(u))
        self.norms.append(step.norms)

    def cut(self, target, outcome):
        raise AssertionError(outcome.reason)


def turned(path, degrees, search, law):
    """States of blocks that are pressed in one load step, stay for two, and are turned by so much in nine."""
    look = States()

    def place(x, time):
        push = 0.1 * min(time, 1.0) * np.where(x[:, 1] > 0.5, 1.0, 0.0)[:, None] * np.array([0.3, -1.0])
        return (x + push) @ turn(degrees * max(time - 3.0, 0.0) / 9.0).T

    def begin(simulation):
        look.pair = simulation.problem.contacts[0]

    scene = two(path, 12, end=12.0, held=("bottom", "top"), search=search, **law)
    moved(scene, place, observers=[look], begin=begin)
    return look


@pytest.mark.parametrize("search", ["ray_tracing", "closest_point"])
@pytest.mark.parametrize(
    "law, digits",
    [
        ({}, 1e-9), ({"friction": 0.1}, 1e-9), ({"friction": 2.0}, 1e-9), ({"tied": True}, 1e-9),
        ({"formulation": "penalty", "friction": 0.3}, 1e-9), ({"unbiased": True, "friction": 0.3}, 1e-9),
        # the weight of P - t is that of the last load step
        ({"friction": 0.3, "theta": -1.0}, 2e-2),
        # multipliers settle to this
        ({"formulation": "augmented_lagrangian", "friction": 0.3}, 1e-3),
    ],
)  # fmt: skip
def test_turn(shared_tmp, search, law, digits):
    """Tractions of blocks that are pressed and then turned by 90 degrees turn with them, and no point changes."""
    path = mesh(slanted, shared_tmp / "slanted.msh", 4, 6)
    still, turns = (turned(path, degrees, search, law) for degrees in (0.0, 90.0))
    for number, (one, other) in enumerate(zip(still.states[2:], turns.states[2:], strict=True)):
        assert 0 < np.sum(one["status"] > 0)
        np.testing.assert_array_equal(one["status"] > 0, other["status"] > 0)
        expected = one["traction"] @ turn(10.0 * number).T
        np.testing.assert_allclose(other["traction"], expected, atol=digits * np.abs(expected).max())


class Forces(Observer):
    """Forces on the foundation, by contact and by its support, of load steps none of which may be cut."""

    def __init__(self):
        self.forces = []

    def step(self, step, u, record):
        self.forces.append([record["contacts"]["sole"]["force"], record["reactions"]["foundation_bottom"]])

    def cut(self, target, result):
        raise AssertionError(result.reason)


@pytest.mark.parallel(1, 3)
def test_points_that_leave_their_facets_in_a_load_step_find_others(shared_tmp):
    """A slab with a round bottom is pressed deep into a soft foundation, then dragged along by a facet in each load
    step: no step is cut. With facets that are the same until Newton's method has ended seven are."""
    path = mesh(ironing_slab, shared_tmp / "ironing.msh", n=2)
    look = Forces()
    scene = Scene(
        mesh=MeshSpec(path, strain="finite"),
        materials={"soft": Material(689.6, 0.32, law="neo_hooke"), "stiff": Material(6896.0, 0.32, law="neo_hooke")},
        bodies=[Body("foundation", "soft"), Body("slab", "stiff")],
        contacts=[Contact("foundation_top", "slab_skin", name="sole", friction=0.3, search="ray_tracing")],
        displacements=[
            Displacement("foundation_bottom", [0.0, 0.0]),
            Displacement("slab_top", ["free", -1.0], [(0, 0), (5, 1), (10, 1)]),
            Displacement("slab_top", [1.0, "free"], [(0, 0), (5, 0), (10, 1)]),
        ],
        steps=Steps(end=10.0, count=10),
        output=Output(fields=False),
    )
    with running(scene, None, [look]) as (_, converged):
        assert converged
    forces = np.abs(look.forces)
    assert len(forces) == 10
    np.testing.assert_allclose(forces[:, 0], forces[:, 1], rtol=1e-5, atol=1e-4)
    # all of it slides at the end; the rays are those of the deformed foundation, which rises in front of the slab
    assert forces[-1, 0, 0] > 0.3 * forces[-1, 0, 1]


class Cuts(Observer):
    """Load steps that were cut, and iterations of Newton's method in each of the others."""

    def __init__(self):
        self.cuts, self.newton = 0, []

    def step(self, step, u, record):
        self.newton.append(step.newton)

    def cut(self, target, result):
        self.cuts += 1


@pytest.mark.parallel(1, 3)
@pytest.mark.parametrize(
    "n, order, search, counts",
    [
        # a point at a vertex of the slab is beside its facet with either of them
        (1, 2, "closest_point", (5, 15)),
        # points that are held at the sharp edge of the slab, and turn about it
        (2, 1, "closest_point", (10, 20)),
        # points whose rays pass the end of the slab
        (2, 2, "ray_tracing", (4, 8)),
    ],
)
def test_points_at_vertices_and_beyond_edges(shared_tmp, n, order, search, counts):
    """The slab that irons a foundation takes so many load steps, few of them cut. If points are told to be on their
    facets whatever they do at edges, 14, 11 and 6 are cut, and the first two runs end early."""
    path = mesh(ironing_slab, shared_tmp / f"vertices_{n}_{order}.msh", n=n, order=order)
    scene, look = ironing_scene(path, 1.0, 1.5, *counts), Cuts()
    contact = replace(scene.contacts[0], search=search)
    scene = replace(scene, contacts=[contact], mesh=replace(scene.mesh, order=order), output=Output(fields=False))
    with running(scene, None, [look]) as (_, converged):
        assert converged
    assert look.cuts <= 1
    assert max(look.newton) < 20


def test_rubber_that_has_stiffened(shared_tmp):
    """Stretched to twice its length along its surface and then pressed on a round obstacle: a thousand times as stiff
    as undeformed, and where it bears a pressure it touches."""
    path = mesh(lambda file: one_block(file, 2, 8, "quadrilateral"), shared_tmp / "rubber.msh")
    rubber = Material(1.0, 0.3, law="ogden", ogden=[(1.0 / 1.3 / 20.0, 20.0)])
    scene = Scene(
        MeshSpec(path, strain="finite"), {"rubber": rubber}, [Body("block", "rubber")],
        contacts=[Contact("bottom", obstacle=Obstacle("sphere", center=[1.0, -5.0], radius=5.0), name="c")],
        displacements=[
            Displacement("left", [0.0, "free"]),
            Displacement("right", ["min(2*t, 1)", "free"]),
            Displacement("top", ["x*min(2*t, 1)", "-0.2*max(0, t - 0.5)"]),
        ],
        steps=Steps(count=8), output=Output(fields=False),
    )  # fmt: skip
    with running(scene) as (simulation, converged):
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        assert converged
    assert state["pressure"].max() > 100.0
    assert np.abs(state["gap"][state["pressure"] > 0.0]).max() < 0.01
