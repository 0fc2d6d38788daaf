"""Orthotropic stiffness against tensors of four indices, and what follows from it."""

import numpy as np
import pytest

from pcontact.material.elastic import in_plane, lame
from pcontact.material.orthotropic import frame, nearest_isotropic, stiffness, traction_matrix, turn
from tests.support.orthotropic import LAMINATE, PAIRS, SKEW, WOOD, isotropic, law_of, plane_axes, tensor_of

ROOT = np.sqrt([1, 1, 1, 2, 2, 2])


def test_compliance_of_simple_stresses():
    """A stress along an axis extends it and contracts the others; shear is by the modulus of its plane."""
    young, poisson, shear = LAMINATE
    strain = np.linalg.inv(stiffness(*LAMINATE))
    np.testing.assert_allclose(strain[:3, 0], [1 / young[0], -poisson[0] / young[0], -poisson[1] / young[0]])
    np.testing.assert_allclose(strain[:3, 1], [-poisson[0] / young[0], 1 / young[1], -poisson[2] / young[1]])
    np.testing.assert_allclose(strain[2, 2], 1 / young[2])
    np.testing.assert_allclose(np.diag(strain)[3:], [0.5 / shear[0], 0.5 / shear[2], 0.5 / shear[1]])


def test_turned_as_tensors_are():
    axes, moduli = frame(*SKEW), stiffness(*WOOD)
    expected = np.einsum("ai,bj,ck,dl,abcd->ijkl", axes, axes, axes, axes, tensor_of(moduli))
    matrix = turn(axes[None])[0]
    np.testing.assert_allclose(tensor_of(matrix @ moduli @ matrix.T), expected, atol=1e-13)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(6), atol=1e-14)
    np.testing.assert_allclose(law_of(WOOD, SKEW, 3).moduli(np.zeros((1, 3)))[0], matrix @ moduli @ matrix.T)


def test_nearest_isotropic():
    """Itself of an isotropic stiffness; nothing is nearer, whatever the frame."""
    np.testing.assert_allclose(nearest_isotropic(stiffness(*isotropic(7.0, 0.3))), lame(7.0, 0.3))
    law = law_of(LAMINATE, SKEW, 3)
    moduli = law.moduli(np.zeros((1, 3)))[0]
    ones = np.diag([1.0] * 3 + [0.0] * 3) @ np.ones((6, 6)) @ np.diag([1.0] * 3 + [0.0] * 3)
    distance = [np.linalg.norm(moduli - (law.constants[0] + a) * ones - 2 * (law.constants[1] + b) * np.eye(6))
                for a, b in ((0.0, 0.0), (1e-3, 0.0), (-1e-3, 0.0), (0.0, 1e-3), (0.0, -1e-3))]  # fmt: skip
    assert np.argmin(distance) == 0
    np.testing.assert_allclose(nearest_isotropic(moduli), nearest_isotropic(stiffness(*LAMINATE)))


def test_plane_stress_has_no_stress_across():
    """Condensed; the expansion across the plane is free."""
    law, alpha = law_of(WOOD, plane_axes(25.0), 2, "plane_stress", expansion=[1.0, 2.0, 5.0]), np.array([1.0, 2.0, 5.0])
    full = law_of(WOOD, plane_axes(25.0), 3, expansion=alpha)
    place, strain = np.zeros((1, 2)), np.array([0.3, -0.1, 0.0, 0.2])
    moduli, heated = full.moduli(np.zeros((1, 3)))[0], full.thermal(np.zeros((1, 3)))[0]
    for hot in (0.0, 1.0):
        across = (hot * heated[2] - moduli[2, :4] @ strain) / moduli[2, 2]
        expected = moduli[:, :4] @ (strain + [0.0, 0.0, across, 0.0]) - hot * heated
        found = law.moduli(place)[0] @ strain - hot * law.thermal(place)[0]
        np.testing.assert_allclose(found, expected[:4], atol=1e-14)
        assert abs(expected[2]) < 1e-14
    assert law.constants == in_plane(*full.constants, "plane_stress")


def test_expansion_without_stress():
    """Where the strain is that of the expansion."""
    law, axes = law_of(WOOD, SKEW, 3, expansion=[1.0, 2.0, 5.0]), frame(*SKEW)
    free = axes.T @ np.diag([1.0, 2.0, 5.0]) @ axes
    strain = np.array([free[i, j] for i, j in PAIRS]) * ROOT
    x = np.zeros((1, 3))
    np.testing.assert_allclose(law.moduli(x)[0] @ strain, law.thermal(x)[0], atol=1e-13)


def test_around_an_axis():
    """At each place it is the plane frame turned there; the axis itself is no trouble."""
    around = np.array([1.0, -2.0, 0.5]), np.array([0.0, 0.0, 3.0])
    law = law_of(LAMINATE, plane_axes(10.0), 3, around=around, expansion=[1.0, 2.0, 3.0])
    for angle in (0.0, 40.0, 200.0):
        x = around[0] + [[2.0 * np.cos(np.radians(angle)), 2.0 * np.sin(np.radians(angle)), 7.0]]
        flat = law_of(LAMINATE, plane_axes(10.0 + angle), 3, expansion=[1.0, 2.0, 3.0])
        np.testing.assert_allclose(law.moduli(x), flat.moduli(x), atol=1e-12)
        np.testing.assert_allclose(law.thermal(x), flat.thermal(x), atol=1e-12)
    assert np.isfinite(law.moduli(around[0][None])).all() and not law.uniform


@pytest.mark.parametrize("dim", [2, 3])
def test_acoustic_tensor(dim):
    """lam + 2 mu of an isotropic body; else the largest |sigma n|^2 / sigma : eps."""
    rng, axes = np.random.default_rng(1), SKEW if dim == 3 else plane_axes(30.0)
    normal = rng.normal(size=(3, dim))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    lam, mu = lame(7.0, 0.4)
    np.testing.assert_allclose(law_of(isotropic(7.0, 0.4), axes, dim).acoustic(normal), lam + 2 * mu)
    for nu, part in ((0.4, 4 * mu / (lam + 2 * mu)), (-0.3, 1.0)):
        np.testing.assert_allclose(law_of(isotropic(7.0, nu), axes, dim).shear(normal, normal), part)
    law = law_of(LAMINATE, axes, dim)
    strain = rng.normal(size=(2000, law.size))
    stress = strain @ law.moduli(normal)[0]
    energy = np.einsum("sk,sk->s", stress, strain)
    for one, bound in zip(normal, law.acoustic(normal), strict=True):
        ratio = np.sum((stress @ traction_matrix(one[None])[0].T) ** 2, axis=1) / energy
        assert 0.5 * bound < ratio.max() <= bound * (1.0 + 1e-12)
    # of the tangential part alone
    for one, bound in zip(normal, law.acoustic(normal) * law.shear(normal, normal), strict=True):
        traction = stress @ traction_matrix(one[None])[0].T
        traction -= np.outer(traction @ one, one)
        ratio = np.sum(traction**2, axis=1) / energy
        assert 0.2 * bound < ratio.max() <= bound * (1.0 + 1e-12)
