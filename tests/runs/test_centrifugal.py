"""Forces per mass: a rotating ring, weight, a block on springs that flies outwards, ranks, refusals."""

import numpy as np
import pytest

from meshes import cylinder_strip, one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene, Spring, Steps
from pcontact.simulation import Simulation

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
E, NU, RHO = 200.0, 0.3, 2.0


@pytest.fixture
def mesh(shared_tmp):
    paths = {name: shared_tmp / f"{name}.msh" for name in ("ring", "square", "cube")}
    if WORLD.rank == 0:
        cylinder_strip(paths["ring"], (16, 1), inner=1.0, outer=3.0, height=0.2, order=2)
        one_block(paths["square"], 2, 2, lower=[99.5, -0.5])
        one_block(paths["cube"], 3, 2, "tetrahedron", lower=[1.0, 0.0, 0.0])
    WORLD.Barrier()
    return paths


def scene(path, region, displacements, loads, kinematics="plane_strain", **more):
    return Scene(
        MeshSpec(path, order=more.pop("order", 1), kinematics=kinematics, strain=more.pop("strain", "small")),
        {"m": Material(more.pop("E", E), NU, density=more.pop("density", RHO))}, [Body(region, "m")],
        displacements=displacements, loads=loads, steps=Steps(count=more.pop("count", 1)),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
        output=Output(fields=False, probes=more.pop("probes", ())), **more,
    )  # fmt: skip


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation, simulation.records.data()["steps"]


def test_rotating_ring(mesh):
    """Inner radius of a long ring; at half the speed a quarter."""
    held = [Displacement(side, ["free", 0]) for side in ("bottom", "top")]
    case = scene(mesh["ring"], "body", held, [Load("body", angular_speed=0.7)], "axisymmetric", order=2,
                 probes=["inner"], count=2)  # fmt: skip
    _, steps = simulated(case)
    modulus, ratio = E / (1.0 - NU**2), NU / (1.0 - NU)
    hoop = (3.0 + ratio) / 4.0 * RHO * 0.49 * (9.0 + (1.0 - ratio) / (3.0 + ratio))
    means = [step["probes"]["inner"]["mean"][0] for step in steps]
    assert means[1] == pytest.approx(hoop / modulus, rel=1e-5)
    assert means[0] == pytest.approx(0.25 * means[1], rel=1e-9)


@pytest.mark.parallel(1, 2, 3)
def test_forces_of_a_block(mesh):
    """Weight, and the centrifugal force about a slanted axis: those of the mass at its centre."""
    axis, point, centre = np.array([1.0, 2.0, 2.0]) / 3.0, np.array([0.3, -0.2, 0.1]), np.array([1.5, 0.5, 0.5])
    loads = [Load("block", acceleration=[0.0, "-t", -9.81]),
             Load("block", angular_speed=1.5, point=point, axis=3.0 * axis)]  # fmt: skip
    case = scene(mesh["cube"], "block", [Displacement("bottom", [0, 0, 0])], loads)
    _, steps = simulated(case, WORLD)
    out = centre - point
    expected = RHO * (np.array([0.0, -1.0, -9.81]) + 2.25 * (out - (out @ axis) * axis))
    np.testing.assert_allclose(steps[-1]["reactions"]["bottom"], -expected, rtol=1e-9)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_block_on_springs_flies_outwards(mesh, strain):
    """With finite strain its mass is where it has moved to: k u = m w^2 (R + u)."""
    case = scene(mesh["square"], "block", [], [Load("block", angular_speed=2.0, point=[0, 0])], strain=strain, E=1e7,
                 springs=[Spring("block", stiffness=[40.0, 40.0])])  # fmt: skip
    _, steps = simulated(case)
    way = 4.0 * RHO * 100.0 / (40.0 - (4.0 * RHO if strain == "finite" else 0.0))
    assert steps[-1]["springs"]["block"]["force"][0] == pytest.approx(-40.0 * way, rel=1e-4)
    assert steps[-1]["imbalance"] < 1e-8


@pytest.mark.parametrize(
    "load, parts",
    [
        (Load("block", angular_speed=1.0), ("point", "nothing")),
        (Load("block", angular_speed=1.0, point=[0, 0], axis=[0, 1]), ("axis", "2D mesh")),
        (Load("block", body_force=[0, 1], axis=[0, 1]), ("axis", "without angular_speed")),
        (Load("block", body_force=[0, 1], point=[0, 1]), ("point", "without force or moment or angular_speed")),
        (Load("top", acceleration=[0, 1]), ("region", "a group of facets")),
        (Load("block", acceleration=[0, 1], angular_speed=1.0), ("acceleration and angular_speed", "exactly one")),
        (Load("block", acceleration=[0, 1]), ("acceleration", "body block without density", "[materials.m]")),
    ],
)
def test_bad_forces(mesh, load, parts):
    case = scene(mesh["square"], "block", [Displacement("bottom", [0, 0])], [load], density=None)
    with pytest.raises(InputError) as caught:
        Simulation(case, SELF)
    assert all(part in str(caught.value) for part in ("loads[0]", *parts)), str(caught.value)
