"""The error estimate: kernel and test functions, zero where it has to be, effectivity, the same on any ranks."""

import json
from functools import partial

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases.rings import NU, E, exact, ring_constants, ring_scene
from meshes import rings
from meshes.blocks import two_blocks
from pcontact.assembly.error_norms import bulk_error
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.estimate.bubbles import bubbles, supports
from pcontact.estimate.local import energies
from pcontact.io.result import load_result
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from tests.support.small import elasticity

FREE = "free"
EXACT = {"snes_rtol": "1e-10", "ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
SOLIDS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", SOLIDS)
def test_bubbles(cell, degree):
    """They vanish at the nodes, their gradients are those of their values, they are independent."""
    dim = CELLS[cell].dim
    assert np.abs(bubbles(cell, degree, reference_nodes(cell, degree))[0]).max() < 1e-14
    xi = np.random.default_rng(1).uniform(0.05, 0.3, (60, dim))
    values, gradients = bubbles(cell, degree, xi)
    assert np.linalg.matrix_rank(values) == values.shape[1]
    for axis in range(dim):
        step = 1e-6 * np.eye(dim)[axis]
        slope = (bubbles(cell, degree, xi + step)[0] - bubbles(cell, degree, xi - step)[0]) / 2e-6
        assert np.abs(slope - gradients[:, :, axis]).max() < 1e-8
    on = supports(cell, degree)
    # one on the middle of an edge lives on the facets around the edge, and nowhere else
    assert on.shape == (values.shape[1], len(CELLS[cell].facets))
    assert on.any(axis=0).all() and not on.all(axis=1).any()


@pytest.mark.parametrize("dim, hoop", [(2, False), (2, True), (3, False)])
@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_local_problems(dim, hoop, shared):
    """The kernel against dense matrices."""
    rng = np.random.default_rng(2)
    nc, nq, nb, parts, lam, mu = 2, 7, 3, 2, 1.7, 0.6
    grad, jxw = rng.normal(size=(nc, nq, nb, dim)), rng.uniform(0.5, 1.0, (nc, nq))
    ring = rng.normal(size=(nc, nq, nb)) if hoop else np.zeros((0, 0, 0))
    loads = rng.normal(size=(nc, parts, nb, dim))
    fixed = np.zeros((nc, nb, dim), dtype=bool)
    fixed[1, 2, 0] = fixed[0, 0, 1] = True
    out = np.empty((nc, parts + 1))
    basis = rng.normal(size=(nc, nq, 2))
    energies(grad, ring, jxw, lam, shared, mu, basis, loads, fixed, out)
    c4 = elasticity(lam, mu, 3)
    for c in range(nc):
        full = np.zeros((nq, nb, dim, 3, 3))
        for i in range(dim):
            full[:, :, i, i, :dim] = grad[c]
        if hoop:
            full[:, :, 0, 2, 2] = ring[c]
        matrix = np.einsum("q,qaimn,mnkl,qbjkl->aibj", jxw[c], full, c4, full).reshape(nb * dim, nb * dim)
        for mode in basis[c].T:
            mean = np.einsum("q,q,qaikk->ai", jxw[c], mode, full).ravel()
            matrix += shared / jxw[c].sum() * np.outer(mean, mean)
        free = ~fixed[c].ravel()
        for k, b in enumerate([*loads[c], loads[c].sum(axis=0)]):
            b = b.ravel()[free]
            expected = b @ np.linalg.solve(matrix[np.ix_(free, free)], b)
            assert out[c, k] == pytest.approx(expected, rel=1e-9)


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


def sheared(path, **said):
    """The same boxes, the upper one pushed sideways, too: a rough solution."""
    scene = pressed(path, 1, **said)
    scene.displacements = [Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.02, -0.02])]
    scene.loads = []
    return scene


class Watch:
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
