"""The error of a contact pressure: areas on both sides, and bodies that are stretched differently."""

from functools import partial

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.adapt.passes import Watch
from pcontact.estimate.tractions import stretched
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps
from pcontact.scene.target import Target
from pcontact.simulation import Simulation

COMM = MPI.COMM_WORLD
# [length] Widths of two blocks that are both as wide as the lower one in the end.
LOWER, UPPER = 1.0, 0.98


@pytest.mark.parametrize("d", [2, 3])
def test_areas_of_linear_functions(d):
    """They are those of the parallelograms along a facet, whatever it does across itself; one point tells none."""
    rng = np.random.default_rng(3)
    along, facet = rng.normal(size=(2, d - 1, d)), np.array([0] * 7 + [1] * 6 + [2])
    at, weight = rng.uniform(size=(14, d - 1)), rng.uniform(0.5, 1.0, 14)
    turned = np.linalg.qr(rng.normal(size=(d, d)))[0]
    slopes = [turned @ np.diag([1.3, *rng.uniform(0.5, 2.0, d - 1)]), rng.normal(size=(d, d)), np.eye(d)]
    x = np.einsum("pk,pkd->pd", at, along[np.minimum(facet, 1)])
    y = 5.0 + np.einsum("pij,pj->pi", np.array(slopes)[facet], x)
    areas = [np.sqrt(np.linalg.det(a @ s.T @ s @ a.T) / np.linalg.det(a @ a.T))
             for s, a in zip(slopes, along, strict=False)]  # fmt: skip
    assert stretched(facet, 3, weight, x, y) == pytest.approx([*areas, 1.0])


def stretched_blocks(path, d):
    """A scene of two blocks under uniform stress, the upper one as wide as the lower one in the end."""
    sides = [Displacement(name, [0.0, "free", "free"][:d]) for name in ("left", "lower_right")]
    sides += [Displacement("upper_right", [LOWER - UPPER, "free", "free"][:d])]
    sides += [Displacement(name, ["free", 0.0, "free"]) for name in ("front", "back") if d == 3]
    ends = ("lower_bottom", 0.0), ("upper_top", -0.05)
    return Scene(
        mesh=MeshSpec(path),
        materials={"soft": Material(10.0, 0.3)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[*sides, *(Displacement(name, [*["free"] * (d - 1), value]) for name, value in ends)],
        output=Output(fields=False, estimate=True),
        # partners of the second load step are those where it is expected to end, by the first one, whose partners are
        # those at its beginning: what they miss there, 3 %, leaves the areas uneven by some 1e-5
        steps=Steps(count=2),
        petsc={"snes_rtol": "1e-11"},
    )


@pytest.mark.parallel
def test_a_body_that_is_stretched_along_the_contact(shared_tmp):
    """Of blocks under a uniform stress next to nothing is missed: forces act on another area of the target (1.4 %)."""
    path = shared_tmp / "stretched.msh"
    on_root(COMM, partial(two_blocks, path, 2, 3, 2, "triangle", widths=(LOWER, UPPER)))
    simulation = Simulation(stretched_blocks(path, 2))
    watch = Watch(simulation)
    assert simulation.run(None, [watch], keep=True)
    u, estimate = simulation.stepper.u, simulation.error_estimate
    found = estimate.of_quantity(Target(0.1, "pressure:face"), watch.record, u, watch.time, watch.unbalanced)
    simulation.free()
    assert found.value > 0.1 and found.error < 1e-3 * found.value


@pytest.mark.parallel
def test_forces_on_the_facets_of_a_target_in_space(shared_tmp):
    """The same of the estimate of the energy norm, which was 1.5 % when the areas were those of the source."""
    path = shared_tmp / "stretched_3.msh"
    on_root(COMM, partial(two_blocks, path, 3, 2, 4, "tetrahedron", widths=(LOWER, UPPER)))
    simulation = Simulation(stretched_blocks(path, 3))
    assert simulation.run(None, [], keep=True)
    last = simulation.error_estimate.last
    simulation.free()
    assert last["energy_norm"] > 0.1 and last["relative"] < 1e-3
