"""The error estimate: kernel and test functions, zero where it has to be, effectivity, the same on any ranks."""

import json
from functools import partial

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.rings import NU, E, exact, ring_constants, ring_scene
from drivers.error_norms import bulk_error
from meshes import rings
from meshes.blocks import two_blocks
from pcontact.element.reference import CELLS
from pcontact.io.result import load_result
from pcontact.material.elastic import lame
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

FREE = "free"
EXACT = {"snes_rtol": "1e-10", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def pressed(path, order, material=None, **said):
    """Two stacked boxes under a uniform pressure, free to widen: the exact displacement is linear in each."""
    dim = 2 if "2d" in path.name else 3
    sides = ("left",) if dim == 2 else ("left", "front")
    held = [Displacement("lower_bottom", [FREE] * (dim - 1) + [0.0])]
    for axis, side in enumerate(sides):
        value = [0.0 if k == axis else FREE for k in range(dim)]
        held += [Displacement(f"{body}_{side}", value) for body in ("lower", "upper")]
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": material or Material(10.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="c", **said)],
        displacements=held,
        loads=[Load("upper_top", pressure=0.1)],
        output=Output(fields=False, estimate=True),
        petsc=EXACT,
    )


def sheared(path, lower=None, **said):
    """The same boxes, the upper one pushed sideways, too: a rough solution; `lower`: the lower one of degree 1 in a
    mesh of degree 2."""
    scene = pressed(path, lower or 1, **said)
    scene.bodies[0].order = lower and 1
    scene.displacements = [Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.02, -0.02])]
    scene.loads = []
    return scene


class Watch(Observer):
    """Observer: the last record."""

    def step(self, step, u, record):
        """Keep it."""
        self.record = record

    def cut(self, target, outcome):
        """Nothing."""

    def end(self, converged):
        """Nothing."""


def run(scene, directory=None, comm=MPI.COMM_WORLD):
    """The simulation (closed) and the estimate of its last step."""
    scene.output.estimate = True
    simulation, watch = Simulation(scene, comm), Watch()
    try:
        assert simulation.run(directory, [watch])
    finally:
        simulation.close()
    return simulation, watch.record["estimate"]


PATCHES = [
    *(("triangle", k, 3) for k in (1, 2)),
    *(("quadrilateral", k, 3) for k in (1, 2)),
    *(("tetrahedron", k, 2) for k in (1, 2)),
    *(("hexahedron", k, 2) for k in (1, 2)),
]


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("cell, order, n_upper", PATCHES)
def test_patch(shared_tmp, cell, order, n_upper, friction):
    """Zero where the exact displacement is in the space; in the plane on meshes that do not match."""
    dim = CELLS[cell].dim
    path = make_mesh(two_blocks, shared_tmp / f"blocks{dim}d.msh", dim, 2, n_upper, cell)
    _, estimate = run(pressed(path, order, friction=friction))
    assert estimate["absolute"] < 1e-8 * estimate["energy_norm"]
    assert max(estimate["parts"].values()) < 1e-8 * estimate["energy_norm"]
    # sigma^2 / E times the volume
    assert estimate["energy_norm"] == pytest.approx(np.sqrt(0.1**2 / 10.0 * (1 if dim == 3 else 1 - 0.3**2) * 2.0))


@pytest.mark.parallel
@pytest.mark.parametrize("degree, theta", [(1, 0.0), (1, 1.0), (2, -1.0), (2, 0.0)])
def test_effectivity(shared_tmp, degree, theta):
    """Estimate over error of the rings: within 10 % of 1 on a mesh of 8 cells (1.04 and 1.01 were measured)."""
    path = make_mesh(rings, shared_tmp / "rings.msh", n=8, order=2)
    simulation, estimate = run(ring_scene(path, degree, theta))
    solution = partial(exact, constants=ring_constants())
    error = bulk_error(simulation.problem.space, [lame(E, NU)] * 2, simulation.stepper.u, solution)
    assert estimate["absolute"] == pytest.approx(error.energy, rel=0.1)
    assert estimate["relative"] == pytest.approx(estimate["absolute"] / estimate["energy_norm"])
    assert 0.0 < estimate["algebraic"] < 1e-4 * estimate["absolute"]
    assert set(estimate["parts"]) == {"interior", "jumps", "neumann", "contact", "friction"}
    assert estimate["parts"]["friction"] == 0.0
    assert estimate["surfaces"]["circle"]["contact"] > 0.0


@pytest.mark.parallel
@pytest.mark.parametrize(
    "cell, said",
    [
        ("triangle", {}),
        ("triangle", {"friction": 0.2}),
        ("quadrilateral", {"unbiased": True, "friction": 0.2}),
        ("quadrilateral", {"tied": True}),
        ("triangle", {"formulation": "penalty"}),
        ("triangle", {"lower": 2, "friction": 0.2}),
        ("quadrilateral", {"material": Material(10.0, 0.3, yield_stress=0.1, hardening=1.0)}),
    ],
)
def test_ranks(shared_tmp, cell, said):
    """On any ranks what one rank says, cell by cell: to what the solver leaves over."""
    path = make_mesh(two_blocks, shared_tmp / "blocks2d.msh", 2, 4, 6, cell)
    whole, alone = run(sheared(path, **said), shared_tmp / f"alone{MPI.COMM_WORLD.rank}", MPI.COMM_SELF)
    del whole
    _, together = run(sheared(path, **said), shared_tmp / "together")
    assert together["absolute"] == pytest.approx(alone["absolute"], rel=1e-7)
    for part, value in alone["parts"].items():
        assert together["parts"][part] == pytest.approx(value, rel=1e-6, abs=1e-9 * alone["absolute"])
    for pair, values in alone["surfaces"].items():
        assert together["surfaces"][pair] == pytest.approx(values, rel=1e-6, abs=1e-9 * alone["absolute"])
    assert alone["parts"]["jumps"] > 0.0
    assert (alone["parts"]["friction"] > 0.0) == ("friction" in said)
    assert (alone["parts"]["contact"] > 0.0) == ("tied" not in said)


@pytest.mark.parallel
def test_output(shared_tmp):
    """The report and the field of the cells say the same; label and theory."""
    path = make_mesh(two_blocks, shared_tmp / "blocks2d.msh", 2, 3, 4, "triangle")
    scene = sheared(path, friction=0.2, material=Material(10.0, 0.3, yield_stress=0.1, hardening=1.0))
    scene.output.fields = True
    run(scene, shared_tmp / "run")
    report = json.loads((shared_tmp / "run" / "report.json").read_text())
    assert "no proof under yielding" in report["estimate"]["label"] and "Coulomb" in report["estimate"]["label"]
    assert report["estimate"]["absolute"] == report["steps"][-1]["estimate"]["absolute"]
    cells = np.concatenate(load_result(shared_tmp / "run").bodies.cell_data["error_estimate"])
    assert np.sqrt(np.sum(cells**2)) == pytest.approx(report["estimate"]["absolute"], rel=1e-6)
    assert "error estimate" in " ".join(report["model"]["active"])


@pytest.mark.parallel
def test_not_asked(shared_tmp):
    """Nothing is computed or written."""
    path = make_mesh(two_blocks, shared_tmp / "blocks2d.msh", 2, 2, 2, "triangle")
    scene, watch = pressed(path, 1), Watch()
    scene.output.estimate = False
    simulation = Simulation(scene)
    assert simulation.run(shared_tmp / "run", [watch])
    simulation.close()
    assert "estimate" not in watch.record
    assert "estimate" not in json.loads((shared_tmp / "run" / "report.json").read_text())


@pytest.mark.parallel
def test_what_the_solver_leaves(shared_tmp, monkeypatch):
    """Where it is little, one application of the preconditioner says how much, but for a small factor."""
    scene = sheared(make_mesh(two_blocks, shared_tmp / "blocks2d.msh", 2, 3, 4, "triangle"), friction=0.2)
    scene.petsc = {"snes_rtol": "1e-3", "pc_direct_below": "0"}
    found = {}
    for little in (0.0, 1.0):
        monkeypatch.setattr("pcontact.io.error_estimate.LITTLE", little)
        found[little] = run(scene)[1]
    # multigrid adds what other ranks send in the order in which it comes: runs differ by 1e-15
    assert found[1.0]["absolute"] == pytest.approx(found[0.0]["absolute"], rel=1e-12)
    assert found[0.0]["absolute"] > found[0.0]["algebraic"] > 0.0
    assert 0.05 * found[0.0]["algebraic"] < found[1.0]["algebraic"] < 2.0 * found[0.0]["algebraic"]
    assert found[1.0]["algebraic"] != pytest.approx(found[0.0]["algebraic"], rel=1e-3)
