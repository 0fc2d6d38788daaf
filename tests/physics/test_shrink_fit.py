"""A ring shrunk onto another: Lame's interference pressure, and interference that is adjusted away."""

from dataclasses import replace

import numpy as np
import pytest

from drivers._common import make_mesh, running
from drivers.cases.rings import LARGE, MIDDLE, NU, SMALL, E, interface_pressure, measure, ring_scene
from meshes import rings
from pcontact.contact.search.partners import initial_gap
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact
from pcontact.simulation import Simulation

# small against the radii, large against what the curved facets miss of the circle (5e-7 at n = 8)
DELTA = 6e-4


def run(folder, n, theta=0.0, interference="resolve", degree=2):
    path = make_mesh(rings, folder / f"shrink{n}.msh", n=n, order=2, delta=DELTA)
    scene = ring_scene(path, degree, theta, pressure=0.0, interference=interference)
    with running(scene) as (simulation, converged):
        assert converged
        (item,) = simulation.problem.contacts
        state = item.state(simulation.stepper.u)
        largest = MPI.COMM_WORLD.allreduce(float(np.max(np.abs(state["pressure"]), initial=0.0)), op=MPI.MAX)
        return measure(simulation, 0.0, DELTA), largest, simulation.stepper.u.norm()


def test_formula():
    """Lame, one material, plane strain: p = E' delta/(2 c^3) (b^2 - c^2)(c^2 - a^2)/(b^2 - a^2)."""
    a, c, b = SMALL, MIDDLE, LARGE
    delta = 1e-9
    p = E / (1 - NU**2) * delta / (2 * c**3) * (b**2 - c**2) * (c**2 - a**2) / (b**2 - a**2)
    # the formula does not tell the two radii of the shared circle apart
    assert interface_pressure(0.0, delta) == pytest.approx(p, rel=10 * delta / c)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_resolve(shared_tmp, theta):
    """2e-4 is the discretisation error at n = 16, a sixteenth of that at n = 8: the circles of the mesh."""
    coarse, fine = run(shared_tmp, 8, theta)[0], run(shared_tmp, 16, theta)[0]
    p = interface_pressure(0.0, DELTA)
    assert fine["mean_pressure"] == pytest.approx(p, rel=2e-4)
    assert abs(fine["mean_pressure"] - p) < 0.1 * abs(coarse["mean_pressure"] - p)
    assert fine["energy"] < 0.5 * coarse["energy"]
    # the two sides of the circle come to lie on each other
    u = fine["u_r"]
    assert u["outer_inner_skin"] - u["inner_outer_skin"] == pytest.approx(DELTA, rel=1e-3)


@pytest.mark.parallel(2, 3)
def test_adjust(shared_tmp):
    _, largest, norm = run(shared_tmp, 8, interference="adjust")
    assert largest <= 1e-9 * interface_pressure(0.0, DELTA)
    assert norm <= 1e-12 * DELTA


def given(folder, delta, count=1, **contact):
    """Mean pressure at the end of every load step, of rings with a gap or an overlap in the mesh, and their motion."""
    path = make_mesh(rings, folder / f"given{delta:g}.msh", n=8, order=2, delta=delta)
    scene = ring_scene(path, 2, 0.0, pressure=0.0)
    scene.contacts[0] = replace(scene.contacts[0], **contact)
    scene.steps.count = count
    simulation = Simulation(scene)
    try:
        (item,), pressures = simulation.problem.contacts, []

        class Look(Observer):
            def step(self, step, u, record):
                state = item.state(u)
                sums = np.array([state["pressure"] @ state["weight"], np.sum(state["weight"])])
                total = MPI.COMM_WORLD.allreduce(sums)
                pressures.append(total[0] / total[1])

        assert simulation.run(None, [Look()])
        return pressures, simulation.stepper.u.norm()
    finally:
        simulation.close()


@pytest.mark.parallel(2, 3)
def test_clearance(shared_tmp):
    """An overlap that is said, of rings that touch in the mesh, is Lame's; by an amplitude it grows in proportion."""
    half, full = given(shared_tmp, 0.0, 2, clearance=-DELTA, interference_amplitude=((0.0, 0.0), (1.0, 1.0)))[0]
    p = interface_pressure(0.0, DELTA)
    # weights of the two sides are those of the areas that face each other where partners were found
    assert full == pytest.approx(p, rel=2e-3) and half == pytest.approx(0.5 * full, rel=1e-5)
    assert given(shared_tmp, 0.0, clearance=-DELTA)[0] == pytest.approx([full], rel=1e-5)
    # whatever the mesh has
    pressures, norm = given(shared_tmp, DELTA, clearance=0.5 * DELTA)
    assert pressures == [0.0] and norm == 0.0


@pytest.mark.parallel(2, 3)
def test_overlap_of_the_mesh_by_an_amplitude(shared_tmp):
    table = ((0.0, 0.0), (0.5, 0.0), (1.0, 1.0))
    first, last = given(shared_tmp, DELTA, 2, interference_amplitude=table)[0]
    assert first == pytest.approx(0.0, abs=1e-9 * last)
    assert last == pytest.approx(interface_pressure(0.0, DELTA), rel=2e-3)


def test_adjusted_gaps():
    """Overlaps and gaps within a length become none, what is farther stays; where nothing faces a point, nothing."""
    gap, paired = np.array([-0.3, 0.0, 0.1, 0.4, 0.2]), np.array([True, True, True, True, False])
    adjusts = initial_gap(Contact("a", "b", interference="adjust", adjust_within=0.15))
    adjusts.take(gap, paired)
    np.testing.assert_array_equal(gap + adjusts.offset(0.3), [0.0, 0.0, 0.0, 0.4, 0.2])
    overlaps = initial_gap(Contact("a", "b", interference_amplitude=((0.0, 0.0), (2.0, 1.0))))
    overlaps.take(gap, paired)
    np.testing.assert_allclose(gap + overlaps.offset(0.5), [-0.075, 0.0, 0.1, 0.4, 0.2])
    assert initial_gap(Contact("a", "b", interference="resolve")) is None


@pytest.mark.parallel(2, 3)
def test_gaps_are_closed_without_strain(shared_tmp):
    """Rings apart by a gap within the distance touch at once: they are as stiff as rings that touch in the mesh."""
    path = make_mesh(rings, shared_tmp / "apart.msh", n=8, order=2, delta=-DELTA)
    found = []
    for within in (2.0 * DELTA, None):
        scene = ring_scene(path, 2, 0.0, pressure=1.0, interference="adjust", adjust_within=within)
        with running(scene) as (simulation, converged):
            assert converged
            found.append(measure(simulation, 1.0, 0.0)["mean_pressure"])
    assert found[0] == pytest.approx(interface_pressure(1.0, 0.0), rel=5e-3) and found[1] == 0.0
