"""The estimate of bodies with a stiffness or a degree of their own: what is known of it by another way."""

import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.adapt.secondary import Last
from pcontact.material import orthotropic
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.scene.target import Target
from pcontact.simulation import Simulation
from tests.support.orthotropic import SKEW, isotropic
from tests.support.small import DIMENSION

E, NU = 7.0, 0.3
EXACT = {"snes_rtol": "1e-10", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
CASES = [
    ("triangle", 2, "plane_strain", {"point": [-0.4, 0.2]}),
    ("quadrilateral", 1, "plane_stress", {"angle": 35.0}),
    ("triangle", 1, "axisymmetric", {"angle": -20.0}),
    ("tetrahedron", 2, "plane_strain", {"point": [-0.3, 0.2, 0.0], "axis": [1.0, 2.0, 0.5]}),
    ("hexahedron", 1, "plane_strain", {"axes": SKEW}),
]


def estimates(path, material, order, kinematics, of, friction, lower=None, **more):
    """Estimate of blocks that are pressed and sheared, of their cells, and of the cells' part of a force."""
    dim = 3 if kinematics == "plane_strain" and "3d" in path.name else 2
    aside = 0.0 if kinematics == "axisymmetric" else 0.01
    scene = Scene(
        MeshSpec(path, order=order, kinematics=kinematics),
        {"m": material}, [Body("lower", "m", order=lower), Body("upper", "m", order=lower)],
        contacts=[Contact("upper_bottom", "lower_top", name="c", theta=1.0, friction=friction, quadrature=6, **more)],
        displacements=[Displacement("lower_bottom", [0.0] * dim),
                       Displacement("upper_top", [aside, *[0.0] * (dim - 2), -0.03])],
        output=Output(fields=False, estimate=True, probes=["upper_top"]), petsc=EXACT,
    )  # fmt: skip
    simulation, watch = Simulation(scene, MPI.COMM_SELF), Last()
    try:
        assert simulation.run(None, [watch], keep=True)
        estimate, u = simulation.error_estimate, simulation.stepper.u
        unbalanced = np.zeros_like(simulation.problem.conditions.fixed, dtype=float)
        goal = estimate.of_quantity(Target(0.1, of), watch.record, u, 1.0, unbalanced)
        return watch.record["estimate"], np.concatenate(estimate.cells), np.concatenate(goal.cells)
    finally:
        simulation.close()


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[2]}")
def test_isotropic_bodies_split_in_another_way(tmp_path, monkeypatch, case):
    """C_iso of any constants, the rest as C_dev: the estimate is that of the isotropic run."""
    cell, order, kinematics, frame = case
    dim = DIMENSION[cell]
    path = two_blocks(tmp_path / f"b{dim}d.msh", dim, 2, 3, cell)
    friction = 0.3 if cell == "triangle" else None
    known = estimates(path, Material(E, NU), order, kinematics, "support:upper_top", friction)
    young, poisson, shear = isotropic(E, NU)
    lam, mu = lame(E, NU)
    monkeypatch.setattr(orthotropic, "nearest_isotropic", lambda _: (0.5 * lam, 1.2 * mu))
    found = estimates(path, Material(young, poisson, G=shear, **frame), order, kinematics, "support:upper_top",
                      friction)  # fmt: skip
    assert found[0]["absolute"] == pytest.approx(known[0]["absolute"], rel=1e-7)
    assert found[0]["energy_norm"] == pytest.approx(known[0]["energy_norm"], rel=1e-7)
    for part, value in known[0]["parts"].items():
        assert found[0]["parts"][part] == pytest.approx(value, rel=1e-6, abs=1e-9 * known[0]["absolute"])
    for one, other in zip(found[1:], known[1:], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max())


@pytest.mark.parametrize("cell, of", [
    ("triangle", "support:upper_top"), ("triangle", "force:c"), ("triangle", "pressure:c"),
    ("quadrilateral", "displacement:upper_top"), ("tetrahedron", "support:upper_top"),
])  # fmt: skip
def test_bodies_of_degree_1_in_a_mesh_of_degree_2(tmp_path, cell, of):
    """The estimate is that of the run of degree 1, on cells with straight sides."""
    dim = DIMENSION[cell]
    path = two_blocks(tmp_path / f"b{dim}d.msh", dim, 4 - dim, 5 - dim, cell)
    said = ("plane_strain", of, 0.3)
    known = estimates(path, Material(E, NU), 1, *said, cut=True)
    found = estimates(path, Material(E, NU), 2, *said, lower=1, cut=True)
    assert found[0]["absolute"] == pytest.approx(known[0]["absolute"], rel=1e-7)
    for one, other in zip(found[1:], known[1:], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max())
