"""Serendipity cells: 8 and 20 shape functions, the stiffness of a brick, and the same on several ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import patch
from drivers.cases.rings import measure, ring_scene
from meshes import one_block, rings
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import reference_nodes, shape, shape_gradient
from pcontact.io.result import load_result
from pcontact.mesh.hdf5 import convert
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
)
from pcontact.simulation import Simulation
from tests.support.patch import blocks, solve

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
CELLS = {2: "quadrilateral8", 3: "hexahedron20"}
E, NU = 100.0, 0.3


def serendipity(xi):
    """The 8 or 20 shape functions of textbooks at points (n, d), and their gradients: (n, m), (n, m, d)."""
    n, d = xi.shape
    nodes = reference_nodes(CELLS[d], 2)
    values, slopes = np.empty((n, len(nodes))), np.empty((n, len(nodes), d))
    for a, node in enumerate(nodes):
        factor = [0.5 * (1 + node[k] * xi[:, k]) if node[k] else 1 - xi[:, k] ** 2 for k in range(d)]
        slope = [np.full(n, 0.5 * node[k]) if node[k] else -2 * xi[:, k] for k in range(d)]
        corner = bool(np.all(node))
        last = xi @ node - (d - 1) if corner else np.ones(n)
        values[:, a] = np.prod(factor, axis=0) * last
        for k in range(d):
            rest = np.prod([factor[j] for j in range(d) if j != k], axis=0)
            slopes[:, a, k] = slope[k] * rest * last + (np.prod(factor, axis=0) * node[k] if corner else 0.0)
    return values, slopes


@pytest.mark.parametrize("dim", [2, 3])
def test_shape_functions_are_those_of_textbooks(dim):
    xi = np.random.default_rng(1).uniform(-1, 1, (7, dim))
    values, slopes = serendipity(xi)
    np.testing.assert_allclose(shape(CELLS[dim], 2, xi), values, atol=1e-14)
    np.testing.assert_allclose(shape_gradient(CELLS[dim], 2, xi), slopes, atol=1e-14)


def stiffness(points):
    """Of a unit cube of 20 nodes, with the functions above, Hooke's law, and points in each direction, (60, 60)."""
    xi, w = quadrature("hexahedron", 2 * points - 1)
    slopes = 2.0 * serendipity(xi)[1]
    lam, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    same = np.einsum("qak,qbk,q->ab", slopes, slopes, w / 8)
    first = np.einsum("qai,qbj,q->aibj", slopes, slopes, w / 8)
    result = lam * first + mu * first.transpose(0, 3, 2, 1)
    result += mu * np.einsum("ab,ij->aibj", same, np.eye(3))
    return result.reshape(60, 60)


def solved(path, comm, contact=False, strain="small", integration="full"):
    """Probe of the upper side and reactions, last residual steps of a block that is held below and drawn above."""
    scene = Scene(
        MeshSpec(path, order=2, serendipity=True, strain=strain), {"m": Material(E, NU)},
        [Body("block", "m", integration=integration)],
        displacements=[Displacement("bottom", [0, 0, 0])], loads=[Load("top", traction=[1.0, 0.5, -2.0])],
        output=Output(fields=False, probes=["top"]), petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
    )  # fmt: skip
    if contact:
        scene.contacts = [Contact("right", obstacle=Obstacle("plane", [1.002, 0, 0], [-1, 0, 0]), friction=0.3)]
    simulation = Simulation(scene, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation.records.data()["steps"][-1]


@pytest.fixture
def cube(shared_tmp):
    path = shared_tmp / "cube.msh"
    if WORLD.rank == 0:
        one_block(path, 3, 1, "hexahedron", order=2)
        one_block(shared_tmp / "cubes.msh", 3, 2, "hexahedron", order=2)
    WORLD.Barrier()
    return path


@pytest.mark.parametrize(("integration", "points"), [("full", 3), ("reduced", 2)])
def test_one_brick_is_that_of_twenty_nodes(cube, integration, points):
    """Mean motion and reaction of a cube against the numpy twin: its own functions, stiffness and loads."""
    nodes = (reference_nodes("hexahedron", 2)[:20] + 1) / 2
    face, w = quadrature("quadrilateral", 4)
    at = serendipity(np.column_stack([face, np.ones(len(face))]))[0]
    share = at.T @ w / 4
    force = np.outer(share, [1.0, 0.5, -2.0]).ravel()
    free = np.repeat(nodes[:, 2] > 0, 3)
    u = np.zeros(60)
    u[free] = np.linalg.solve(stiffness(points)[np.ix_(free, free)], force[free])
    step = solved(cube, SELF, integration=integration)
    np.testing.assert_allclose(step["probes"]["top"]["mean"], share @ u.reshape(20, 3), rtol=1e-8)
    np.testing.assert_allclose(step["reactions"]["bottom"], [-1.0, -0.5, 2.0], rtol=1e-8)


@pytest.mark.parallel
@pytest.mark.parametrize(("strain", "integration"), [("small", "full"), ("small", "reduced"), ("finite", "reduced")])
def test_ranks_do_not_matter(cube, strain, integration):
    path = cube.with_name("cubes.msh")
    one, several = (solved(path, comm, True, strain, integration) for comm in (SELF, WORLD))
    np.testing.assert_allclose(several["probes"]["top"]["mean"], one["probes"]["top"]["mean"], rtol=1e-8)
    np.testing.assert_allclose(several["reactions"]["bottom"], one["reactions"]["bottom"], rtol=1e-7)
    assert one["imbalance"] < 1e-8 and one["contacts"]["right-plane"]["force"][0] > 0.01


@pytest.mark.parametrize(("cell", "n_upper", "search"), [
    ("quadrilateral", 3, "closest_point"), ("quadrilateral", 3, "ray_tracing"), ("hexahedron", 4, "closest_point"),
])  # fmt: skip
@pytest.mark.parametrize(("theta", "integration"), [(1.0, "full"), (-1.0, "reduced")])
def test_uniform_pressure_is_exact_where_the_quadrature_is(shared_tmp, cell, n_upper, search, theta, integration):
    case = patch.scene(blocks(shared_tmp, cell, 2, n_upper), 2 if cell == "quadrilateral" else 3, 2, theta=theta,
                       search=search)  # fmt: skip
    case.mesh.serendipity = True
    for body in case.bodies:
        body.integration = integration
    assert max(solve(case, patch.errors)) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("integration", ["full", "reduced"])
def test_curved_rings_converge_at_the_rate_of_degree_2(shared_tmp, integration):
    found = []
    for n in (16, 32):
        path = make_mesh(rings, shared_tmp / f"rings{n}.msh", n=n, cell="quadrilateral", order=2)
        case = ring_scene(path, 2, 0.0)
        case.mesh.serendipity = True
        for body in case.bodies:
            body.integration = integration
        found.append(solve(case, measure))
    rates = {key: np.log2(found[0][key] / found[1][key]) for key in ("energy", "weighted")}
    assert min(rates.values()) > 1.4, rates


@pytest.mark.parallel(2, 3)
def test_a_converted_mesh_a_coupling_and_the_fields(cube, shared_tmp):
    """The mesh itself and the converted one give the same, with a coupling; cells are written with 20 nodes."""
    path, found = cube.with_name("cubes.msh"), []
    if WORLD.rank == 0:
        convert(path, path.with_suffix(".h5"), 2)
    WORLD.Barrier()
    for mesh in (path, path.with_suffix(".h5")):
        case = Scene(
            MeshSpec(mesh, order=2, serendipity=True), {"m": Material(E, NU)}, [Body("block", "m")],
            displacements=[Displacement("bottom", [0, 0, 0])],
            couplings=[Coupling("top", displacement=[0.1, "free", "free"], rotation=[0.0, "free", 0.05])],
            output=Output(probes=["top"]),
            petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
        )  # fmt: skip
        simulation = Simulation(case)
        assert simulation.run(shared_tmp / mesh.suffix[1:], keep=True)
        simulation.close()
        found.append(simulation.records.data()["steps"][-1]["probes"]["top"]["mean"])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8, atol=1e-12)
    assert {name for name, _ in load_result(shared_tmp / "msh").bodies.cells} == {"hexahedron20"}
