"""Laws from outside at points: what follows of their form in space in the plane and with axial symmetry."""

import numpy as np
import pytest

from pcontact.material.elastic import FLOWS, Moment, lame
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import Plastic
from pcontact.scene.model import Material
from tests.support.point_laws import ALL, Mises

PARAMETERS = {"mises": [0.5, 20.0], "ramberg_osgood": [0.4, 0.5, 5.0], "norton": [0.3, 3.0, 0.1]}
KINEMATICS = [("plane_strain", 3), ("plane_strain", 2), ("axisymmetric", 2), ("plane_stress", 2)]
every_kinematics = pytest.mark.parametrize("kinematics, dim", KINEMATICS)


def law_of(name, kinematics, dim):
    return ALL[name](Material(100.0, 0.3, law=name, parameters=PARAMETERS[name]), dim, kinematics)


def points(law, dim, kinematics, n=40):
    """Strains, the third one 0 in plane strain and stress, and states that such strains have led to."""
    rng = np.random.default_rng(3)
    strain = np.geomspace(5e-4, 2e-2, n)[:, None] * rng.normal(size=(n, 6 if dim == 3 else 4))
    if dim == 2 and kinematics != "axisymmetric":
        strain[:, 2] = 0.0
    state = np.zeros((n, law.width))
    law.commit(0.3 * strain[:, [0, 1, 2, *range(3, strain.shape[1])[::-1]]], state, Moment(0.1, np.ones(n)))
    return strain, state


@every_kinematics
def test_von_mises_written_anew(kinematics, dim):
    """Stress, tangent, state and energy are those of the law in the package."""
    law, known = law_of("mises", kinematics, dim), Plastic(
        *lame(100.0, 0.3), hardening_curve(*PARAMETERS["mises"]), 0.0, dim, kinematics)  # fmt: skip
    strain, state = points(law, dim, kinematics)
    other = np.zeros((len(strain), known.width))
    known.commit(0.3 * strain[:, [0, 1, 2, *range(3, strain.shape[1])[::-1]]], other)
    own, own_known = law.stress(strain, state, tangent=True), known.stress(strain, other, tangent=True)
    assert 0 < np.sum(own_known.active == FLOWS) < len(strain)
    np.testing.assert_allclose(own.excess, own_known.excess, atol=1e-10)
    flows = own_known.active == FLOWS
    np.testing.assert_allclose(own.tangent[flows], own_known.tangent[flows], atol=1e-9)
    np.testing.assert_allclose(own.tangent[~flows], 0.0, atol=1e-12)
    law.commit(strain, state)
    known.commit(strain, other)
    np.testing.assert_allclose(law.flow(state), known.flow(other), atol=1e-12)
    for one, another in zip(law.energies(strain, state, own.excess), known.energies(strain, other, own_known.excess),
                            strict=True):  # fmt: skip
        np.testing.assert_allclose(one, another, atol=1e-11)


@every_kinematics
@pytest.mark.parametrize("name", ALL)
def test_tangent_and_curvature(name, kinematics, dim):
    """Against differences of the stress, and of the tangent."""
    law, moment = law_of(name, kinematics, dim), Moment(0.2, np.full(40, 0.5))
    strain, state = points(law, dim, kinematics)
    found, h = law.stress(strain, state, moment, tangent=True), 1e-7
    free = [0, 1, 3] if kinematics == "plane_stress" else range(strain.shape[1])
    for k in free:
        ends = [law.stress(strain + sign * h * np.eye(strain.shape[1])[k], state, moment).excess for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), found.tangent[:, :, k], rtol=1e-5, atol=1e-4)
    if name == "mises":
        weight = np.random.default_rng(1).normal(size=strain.shape)
        known = Plastic(*lame(100.0, 0.3), hardening_curve(*PARAMETERS["mises"]), 0.0, dim, kinematics)
        other = state[:, [*range(strain.shape[1]), 6]].copy()
        second, flows = known.curvature(strain, other, weight)
        some = flows > 0
        np.testing.assert_allclose(law.curvature(strain, state, weight)[0][some], second[some], rtol=1e-4, atol=1e-2)


@every_kinematics
def test_energy_of_ramberg_and_osgood(kinematics, dim):
    """The stress is its derivative."""
    law = law_of("ramberg_osgood", kinematics, dim)
    strain, state = points(law, dim, kinematics)
    excess, h = law.stress(strain, state).excess, 1e-6

    def stored(moved):
        own = state.copy()
        law.commit(moved, own)
        return law.energies(moved, own, excess)[0]

    for k in [0, 1, 3]:
        ends = [stored(strain + sign * h * np.eye(strain.shape[1])[k]) for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), excess[:, k], atol=1e-6)


def test_no_stress_across_the_plane():
    law = law_of("mises", "plane_stress", 2)
    strain, state = points(law, 2, "plane_stress")
    law.commit(strain, state)
    full = np.zeros((len(strain), 6))
    full[:, :4], full[:, 2] = strain, state[:, -1]
    stress, _, _ = Mises.respond(law, full, state[:, :-1], 0.0, np.zeros(len(strain)))
    assert np.abs(stress[:, 2]).max() < 1e-12 * np.abs(stress).max()
