"""Serendipity cells: 8 and 20 shape functions, the stiffness of a brick, and the same on several ranks."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import reference_nodes
from pcontact.element.shape import shape
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.simulation import Simulation
from pcontact.space.middles import weights

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
CELLS = {2: "quadrilateral", 3: "hexahedron"}
E, NU = 100.0, 0.3


def serendipity(xi):
    """The 8 or 20 shape functions of textbooks at points (n, d), and their gradients: (n, m), (n, m, d)."""
    n, d = xi.shape
    nodes = reference_nodes(CELLS[d], 2)[: 8 if d == 2 else 20]
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
def test_complete_cells_whose_middles_follow_have_the_serendipity_functions(dim):
    xi = np.random.default_rng(1).uniform(-1, 1, (7, dim))
    whole = shape(CELLS[dim], 2, xi)
    follows = weights(CELLS[dim])
    way = np.eye(whole.shape[1])[:, : 8 if dim == 2 else 20]
    for node, leading, values in follows:
        way[node, leading] = values
    assert len(follows) == (1 if dim == 2 else 7)
    np.testing.assert_allclose(whole @ way, serendipity(xi)[0], atol=1e-14)


def test_triangles_and_tetrahedra_have_none():
    assert weights("triangle") == [] and weights("tetrahedron") == []


def stiffness():
    """Of a unit cube of 20 nodes, with the functions above and Hooke's law, (60, 60)."""
    xi, w = quadrature("hexahedron", 5)
    slopes = 2.0 * serendipity(xi)[1]
    lam, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    same = np.einsum("qak,qbk,q->ab", slopes, slopes, w / 8)
    first = np.einsum("qai,qbj,q->aibj", slopes, slopes, w / 8)
    result = lam * first + mu * first.transpose(0, 3, 2, 1)
    result += mu * np.einsum("ab,ij->aibj", same, np.eye(3))
    return result.reshape(60, 60)


def solved(path, comm, contact=False, strain="small"):
    """Probe of the upper side and reactions, last residual steps of a block that is held below and drawn above."""
    scene = Scene(
        MeshSpec(path, order=2, serendipity=True, strain=strain), {"m": Material(E, NU)}, [Body("block", "m")],
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


def test_one_brick_is_that_of_twenty_nodes(cube):
    """Mean motion and reaction of a cube against the numpy twin: its own functions, stiffness and loads."""
    nodes = (reference_nodes("hexahedron", 2)[:20] + 1) / 2
    face, w = quadrature("quadrilateral", 4)
    at = serendipity(np.column_stack([face, np.ones(len(face))]))[0]
    share = at.T @ w / 4
    force = np.outer(share, [1.0, 0.5, -2.0]).ravel()
    free = np.repeat(nodes[:, 2] > 0, 3)
    u = np.zeros(60)
    u[free] = np.linalg.solve(stiffness()[np.ix_(free, free)], force[free])
    step = solved(cube, SELF)
    top, corner = u.reshape(20, 3)[nodes[:, 2] == 1], np.all(nodes[nodes[:, 2] == 1] != 0.5, axis=1)
    centre = 0.5 * top[~corner].sum(axis=0) - 0.25 * top[corner].sum(axis=0)
    np.testing.assert_allclose(step["probes"]["top"]["mean"], (top.sum(axis=0) + centre) / 9, rtol=1e-8)
    np.testing.assert_allclose(step["reactions"]["bottom"], [-1.0, -0.5, 2.0], rtol=1e-8)


@pytest.mark.parallel
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_ranks_do_not_matter(cube, strain):
    path = cube.with_name("cubes.msh")
    one, several = solved(path, SELF, True, strain), solved(path, WORLD, True, strain)
    np.testing.assert_allclose(several["probes"]["top"]["mean"], one["probes"]["top"]["mean"], rtol=1e-8)
    np.testing.assert_allclose(several["reactions"]["bottom"], one["reactions"]["bottom"], rtol=1e-7)
    assert one["imbalance"] < 1e-8 and one["contacts"]["right-plane"]["force"][0] > 0.01
