"""Concentric rings (code_aster SSNP167) against Lame's solution: numbers, rates, and the error norms."""

from functools import partial

import numpy as np
import pytest

from drivers._common import make_mesh, observed_rates, running
from drivers.cases.rings import (
    LARGE,
    MIDDLE,
    NU,
    PRESSURE,
    SMALL,
    E,
    exact,
    interface_pressure,
    measure,
    radial_displacement,
    ring_constants,
    ring_scene,
)
from drivers.error_norms import bulk_error, surface_error
from meshes import rings
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI

THETAS = [1.0, 0.0, -1.0]
P = 9259259.26
U_R = {
    "outer_skin": -8.0e-3,
    "outer_inner_skin": -16e-3 / 3,
    "inner_outer_skin": -16e-3 / 3,
    "inner_skin": -4.0e-3,
}


def solve(folder, n, degree, theta, cell="quadrilateral", **numerics):
    path = make_mesh(rings, folder / f"rings{n}.msh", n=n, cell=cell, order=2)
    with running(ring_scene(path, degree, theta, **numerics)) as (simulation, converged):
        assert converged
        return measure(simulation)


def test_formula():
    outer, inner = ring_constants()
    assert interface_pressure() == pytest.approx(9259259.26, rel=1e-9)
    radii = [(outer, LARGE), (outer, MIDDLE), (inner, MIDDLE), (inner, SMALL)]
    u = [radial_displacement(constants, r) for constants, r in radii]
    assert u == pytest.approx([-8.0e-3, -16e-3 / 3, -16e-3 / 3, -4.0e-3], rel=1e-12)


def test_exact_gradient():
    """The gradient is the derivative of the displacement, and in equilibrium with the pressures."""
    constants = ring_constants()
    x, step = np.array([[0.5, 0.6], [0.1, 0.9]]), 1e-6
    _, gradient = exact(x, 0, constants)
    for j in range(2):
        e = step * np.eye(2)[j]
        slope = (exact(x + e, 0, constants)[0] - exact(x - e, 0, constants)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, :, j], slope, rtol=1e-8, atol=1e-10)
    lam, mu = lame(E, NU)
    for body, r, p in ((0, LARGE, PRESSURE), (0, MIDDLE, P), (1, MIDDLE, P), (1, SMALL, 0.0)):
        g = exact(np.array([[r, 0.0]]), body, constants)[1][0]
        assert lam * np.trace(g) + 2 * mu * g[0, 0] == pytest.approx(-p, rel=1e-9, abs=1e-3)


@pytest.mark.parallel(2, 3)
def test_error_norms(shared_tmp):
    """Energy of the exact solution is the work of the pressure; the error of u = 0 is the solution itself."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8, order=2)
    with running(ring_scene(path, 2, 0.0)) as (simulation, _):
        space, u = simulation.problem.space, simulation.problem.space.vector()
        error = bulk_error(space, [lame(E, NU)] * 2, u, partial(exact, constants=ring_constants()))
    work = PRESSURE * 8.0e-3 * 0.5 * np.pi * LARGE
    assert error.energy_of_exact**2 == pytest.approx(work, rel=1e-5)
    assert error.energy == pytest.approx(error.energy_of_exact, rel=1e-14)
    assert error.displacement == pytest.approx(error.displacement_of_exact, rel=1e-14)


@pytest.mark.parallel(2, 3)
def test_surface_error():
    comm = MPI.COMM_WORLD
    n = 3 if comm.rank == 0 else 0
    values = np.array([1.0, -2.0, 2.0])[:n]
    error = surface_error(comm, values, np.full(n, 2.0), np.array([0.5, 1.0, 1.0])[:n])
    assert error == pytest.approx((np.sqrt(17.0), np.sqrt(18.0), 2.0), rel=1e-14)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize(("degree", "u_tolerance", "p_tolerance"), [(1, 2e-3, 5e-4), (2, 4e-5, 1.1e-5)])
def test_numbers(shared_tmp, degree, u_tolerance, p_tolerance, theta):
    """The tolerances are the discretisation errors of the finer mesh, far smaller than the coarser one's."""
    coarse, fine = (solve(shared_tmp, n, degree, theta) for n in (8, 16))
    errors = [max(abs(f["u_r"][name] / U_R[name] - 1.0) for name in U_R) for f in (coarse, fine)]
    assert errors[1] <= u_tolerance and errors[1] <= 0.35 * errors[0]
    errors = [abs(f["mean_pressure"] / P - 1.0) for f in (coarse, fine)]
    assert errors[1] <= p_tolerance and errors[1] <= 0.5 * errors[0]


@pytest.mark.slow
@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@pytest.mark.parametrize("theta", THETAS)
def test_rates_degree_1(shared_tmp, theta, cell):
    # a coarser mesh has its cells across the outer ring rounded up, from 2.5 to 3
    sizes = [16, 32]
    found = [solve(shared_tmp, n, 1, theta, cell) for n in sizes]
    for key in ("energy", "weighted"):
        rates = observed_rates([1.0 / n for n in sizes], [f[key] for f in found])[1:]
        assert min(rates) >= 0.95, (key, rates)


@pytest.mark.slow
@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", THETAS)
def test_rates_degree_2(shared_tmp, theta):
    sizes = [16, 32]
    found = [solve(shared_tmp, n, 2, theta) for n in sizes]
    for key in ("energy", "weighted"):
        rates = observed_rates([1.0 / n for n in sizes], [f[key] for f in found])[1:]
        assert min(rates) >= 1.4, (key, rates)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("source", ["inner", "outer"])
def test_searches_agree(shared_tmp, source):
    """Both gap definitions have the same limit on a circle; on a mesh they differ by its normals only."""
    found = [solve(shared_tmp, 16, 2, 0.0, source=source, search=s) for s in ("closest_point", "ray_tracing")]
    assert found[0]["energy"] == pytest.approx(found[1]["energy"], rel=1e-2)
    assert found[0]["mean_pressure"] == pytest.approx(found[1]["mean_pressure"], rel=1e-6)
