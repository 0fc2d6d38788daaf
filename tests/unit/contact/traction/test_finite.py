"""How much stiffer bodies with finite strain become behind their facets."""

import numpy as np
import pytest

from pcontact.contact.formulation.methods import Method
from pcontact.scene.model import Contact, Material
from tests.support.finite_contact import moved, slanted, two

NORMAL = np.array([0.25, -1.0]) / np.hypot(0.25, 1.0)  # of the source, the underside of the upper block
RUBBER = Material(1.0, 0.3, law="ogden", ogden=[(1.0 / 1.3 / 20.0, 20.0)])


def growth(path, gradient, material, strain="finite", **more):
    """Of the facets (nf, 2) of the upper block, where both blocks have a displacement gradient (2, 2)."""

    def look(simulation):
        (pair,) = simulation.problem.contacts[0].pairs
        p = pair.pairing
        return pair.terms.traction.growth(p.exchange.gather(simulation.stepper.u), p)

    scene = two(path, materials=(material, material), tied=True, **more)
    scene.bodies[1].strain = strain
    return moved(scene, lambda x, time: x + time * x @ gradient.T, look)


@pytest.mark.parametrize("formulation, near", [("nitsche", 1e-6), ("penalty", 0.05)])
def test_compressed_along_the_normal(tmp_path, formulation, near):
    """Hencky's law at the stretch 1/w along N and 1 across: (1 + ln w) w^2 times lambda + 2 mu. A penalty leaves the
    blocks a part of that."""
    w = 1.0 / 0.8
    path, gradient = slanted(tmp_path / "s.msh"), -0.2 * np.outer(NORMAL, NORMAL)
    found = growth(path, gradient, Material(1.0, 0.3), formulation=formulation)
    np.testing.assert_allclose(found[:, 0], (1.0 + np.log(w)) * w**2, rtol=near)


def test_rubber_that_stiffens(tmp_path):
    """Stretched along its surface it is stiffer across, too; what is softer than undeformed counts as that."""
    along = np.array([-NORMAL[1], NORMAL[0]])
    path = slanted(tmp_path / "s.msh")
    assert growth(path, 0.5 * np.outer(along, along), RUBBER)[:, 0].min() > 10.0
    np.testing.assert_array_equal(growth(path, 0.2 * np.outer(NORMAL, NORMAL), Material(1.0, 0.3)), 1.0)


def test_rubber_that_stiffens_in_shear_alone(tmp_path):
    """What hardly changes its volume is as stiff along its normal as before; alpha makes up for that, up to 1."""
    along = np.array([-NORMAL[1], NORMAL[0]])
    soft = Material(1.0, 0.4999, law="ogden", ogden=[(1.0 / 1.4999 / 20.0, 20.0)])
    stretch = 0.3 * np.outer(along, along) - 0.3 / 1.3 * np.outer(NORMAL, NORMAL)
    found = growth(slanted(tmp_path / "s.msh"), stretch, soft)
    assert found[:, 0].max() < 2.0 and found[:, 1].min() > 5.0
    method = Method(Contact("a", "b", friction=0.1, theta=0.0), np.ones(3))
    method.take_alpha(np.array([0.001, 0.3, 1.0]))
    method.begin(np.array([[2.0, 10.0], [2.0, 20.0], [3.0, 2.0]]))
    np.testing.assert_allclose(method.alpha, [0.005, 1.0, 1.0])
    method.begin()
    np.testing.assert_array_equal(method.alpha, [0.001, 0.3, 1.0])


def test_small_strain_keeps_its_moduli(tmp_path):
    found = growth(slanted(tmp_path / "s.msh"), -0.2 * np.outer(NORMAL, NORMAL), Material(1.0, 0.3), "small")
    np.testing.assert_array_equal(found, 1.0)
