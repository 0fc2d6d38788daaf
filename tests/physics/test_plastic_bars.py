"""Bars whose strain is the same everywhere: loops of stress over strain, springback, by closed forms."""

import numpy as np
import pytest

from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation
from tests.support.kinematics import nodal
from tests.support.plastic import BARS, LAME, YIELD, YIELD_STRAIN, YOUNG, bar, uniaxial

WORLD = MPI.COMM_WORLD
HARDENING = [(0.0, 0.0), (20.0, 0.0), (0.0, 30.0), (20.0, 30.0)]


class Look(Observer):
    """Mean stress (n, 6) and plastic strain (n,) of all cells, extent of yielding, reaction, after every step."""

    def __init__(self):
        self.rows, self.simulation = [], None

    def step(self, step, u, record):
        bulk = self.simulation.problem.items[0]
        stress = np.concatenate(WORLD.allgather(np.concatenate([values for values, _ in bulk.stress(u)])))
        p = np.concatenate(WORLD.allgather(np.concatenate(bulk.plastic_strain())))
        self.rows.append((stress, p, *bulk.plasticity(), record["reactions"].get("top")))

    def cut(self, target, outcome):
        raise AssertionError(outcome)


def history(scene):
    """What `Look` saw of a run, and its last displacements. Collective."""
    look, simulation = Look(), Simulation(scene)
    look.simulation = simulation
    try:
        assert simulation.run(None, [look])
        return look.rows, nodal(simulation)
    finally:
        simulation.close()


def stress_of(kinematics, along, across):
    """XX, YY, ZZ, XY, YZ, XZ of a bar."""
    stress = np.array([across] * 3 + [0.0] * 3)
    stress[2 if kinematics == "3D" else 1] = along
    return stress


# strains at the end of the steps, in yield strains: load, unload, reverse, load again
CYCLE = np.array([0.9, 2.0, 4.0, 3.0, 1.0, -2.0, -3.0, 0.0, 5.0])
BULK_MODULUS = LAME[0] + 2.0 / 3.0 * LAME[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "hardening, kinematic", [*HARDENING[:3], pytest.param(20.0, 30.0, marks=pytest.mark.parallel(2, 3))]
)
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("kinematics, held", BARS)
def test_cyclic_bar(shared_tmp, kinematics, held, n, hardening, kinematic):
    """Stress over strain with isotropic, kinematic, both, no hardening."""
    strains = CYCLE * YIELD_STRAIN
    table = [(0.0, 0.0), *((k + 1.0, e) for k, e in enumerate(strains))]
    rows, _ = history(bar(shared_tmp / "b.msh", kinematics, n, held, hardening, kinematic, table))
    # what drives a held bar is the equivalent stress
    rates = (2.0 * LAME[1], 3.0 * LAME[1]) if held else (YOUNG, YOUNG)
    expected = uniaxial(strains, *rates, hardening, kinematic)
    area = np.pi if kinematics == "axisymmetric" else 1.0
    for (stress, p, largest, volume, top), e, (driving, _, exact) in zip(rows, strains, expected, strict=True):
        along = BULK_MODULUS * e + 2.0 / 3.0 * driving if held else driving
        wanted = stress_of(kinematics, along, BULK_MODULUS * e - driving / 3.0 if held else 0.0)
        np.testing.assert_allclose(stress, np.tile(wanted, (len(p), 1)), rtol=0, atol=1e-10 * YIELD)
        np.testing.assert_allclose(p, exact, rtol=0, atol=1e-10 * YIELD_STRAIN)
        assert top[-1] == pytest.approx(area * along, abs=1e-10 * area * YIELD)
        assert largest == pytest.approx(exact, abs=1e-10 * YIELD_STRAIN)
        assert volume == pytest.approx(area * (exact > 0.0), rel=1e-12)


@pytest.mark.parametrize("hardening, kinematic", HARDENING)
@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric", "3D"])
def test_springback(shared_tmp, kinematics, hardening, kinematic):
    """Held sideways, pulled by a traction, let go: stress is left across the bar, and a strain along it."""
    mu, rate, pull = LAME[1], BULK_MODULUS + 4.0 / 3.0 * LAME[1], 2.8 * YIELD
    load = [(0.0, 0.0), (1.0, pull), (2.0, 0.0)]
    rows, (u, x) = history(bar(shared_tmp / "b.msh", kinematics, 2, True, hardening, kinematic, load=load))
    # rate e - 2 mu ep = pull,  2 mu e - 3 mu ep = yield stress + (H + Hk) ep
    _, plastic = np.linalg.solve([[rate, -2.0 * mu], [2.0 * mu, -3.0 * mu - hardening - kinematic]], [pull, YIELD])
    e = 2.0 * mu * plastic / rate
    equivalent = 2.0 * mu * e - 3.0 * mu * plastic
    assert plastic > 0.5 * YIELD_STRAIN and abs(equivalent - kinematic * plastic) < YIELD + hardening * plastic
    across = BULK_MODULUS * e - equivalent / 3.0
    assert across > 0.3 * YIELD
    stress, p, *_ = rows[-1]
    wanted = stress_of(kinematics, 0.0, across)
    np.testing.assert_allclose(stress, np.tile(wanted, (len(p), 1)), rtol=0, atol=1e-10 * YIELD)
    np.testing.assert_allclose(p, plastic, rtol=0, atol=1e-10 * YIELD_STRAIN)
    np.testing.assert_allclose(u[:, -1], e * x[:, -1], rtol=0, atol=1e-10 * YIELD_STRAIN)
