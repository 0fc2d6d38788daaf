"""A ring shrunk onto another: Lame's interference pressure, and interference that is adjusted away."""

import numpy as np
import pytest

from drivers._common import make_mesh, running
from drivers.cases.rings import LARGE, MIDDLE, NU, SMALL, E, interface_pressure, measure, ring_scene
from meshes import rings
from pcontact.runtime.petsc import MPI

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


@pytest.mark.parallel(3)
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


@pytest.mark.parallel(3)
def test_adjust(shared_tmp):
    _, largest, norm = run(shared_tmp, 8, interference="adjust")
    assert largest <= 1e-9 * interface_pressure(0.0, DELTA)
    assert norm <= 1e-12 * DELTA
