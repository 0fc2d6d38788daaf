"""A normal displacement imposed by bilateral contact with a level set: convergence to an exact solution.

Beam [0, 10] x [-1, 1], plane stress, E = 1500, nu = 0.25, u = (1 + nu) / E (y^4, x^4). Its divergence is zero,
so the stress is 2 mu eps, with the one component sigma_xy = 2 (x^3 + y^3), and the body force is -(6 y^2, 6 x^2).
Left and right the displacement is prescribed; above and below its normal component is imposed by contact, and the
traction sigma_xy n_y along the side is applied as a force.
"""

import numpy as np
import pytest

from drivers.error_norms import bulk_error
from meshes import beam
from pcontact.element.geometry import facet_geometry
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape, shape_gradient
from pcontact.material.elastic import in_plane, lame
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD = MPI.COMM_WORLD
E_MODULUS, NU = 1500.0, 0.25
SCALE = (1.0 + NU) / E_MODULUS


def exact(x, body=0):
    """Displacement (n, 2) and gradient (n, 2, 2)."""
    slope = np.zeros((len(x), 2, 2))
    slope[:, 0, 1], slope[:, 1, 0] = 4.0 * SCALE * x[:, 1] ** 3, 4.0 * SCALE * x[:, 0] ** 3
    return SCALE * x[:, ::-1] ** 4, slope


def side(sign):
    """Gap and its gradient for the side with the normal (0, sign): closed where u . n is exact."""

    def gap(x, time):
        return sign * exact(x)[0][:, 1]

    def gradient(x, time):
        return np.tile([0.0, -sign], (len(x), 1))

    return Obstacle("level_set", function=gap, gradient=gradient)


def beam_scene(path, order, theta):
    contacts = [
        Contact(name, obstacle=side(sign), name=name, bilateral=True, theta=theta)
        for name, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    return Scene(
        mesh=MeshSpec(path, order=order, kinematics="plane_stress"),
        materials={"m": Material(E_MODULUS, NU)},
        bodies=[Body("beam", "m")],
        contacts=contacts,
        displacements=[Displacement("left", [0.0, 0.0]), Displacement("right", [0.0, 0.0])],
        output=Output(fields=False),
        # the level sets say what the displacement is to be at undeformed places
        petsc={"snes_rtol": "1e-10", "contact_search_again": "0"},
    )


def assembled(space, cells, force):
    """Element forces (n, nn, d) of local nodes (n, nn) as forces of the owned nodes. Collective."""
    local, total = np.zeros((space.n_local, space.dim)), space.vector()
    for nodes, values in zip(cells, force, strict=True):
        np.add.at(local, nodes, values)
    space.local.add(local, total)
    return total.getArray().reshape(-1, space.dim).copy()


def body_force(space):
    """Forces of -(6 y^2, 6 x^2). Collective."""
    cells, forces = [], []
    for block, nodes in zip(space.mesh.blocks, space.cells, strict=True):
        xi, weights = quadrature(block.cell, 2 * space.degree + 4)
        x = space.mesh.points[block.nodes[:, : CELLS[block.cell].n_vertices]]
        jacobian = np.einsum("qne,cnd->cqde", shape_gradient(block.cell, 1, xi), x)
        at = np.einsum("qn,cnd->cqd", shape(block.cell, 1, xi), x)
        weight = np.linalg.det(jacobian) * weights
        values = shape(block.cell, space.degree, xi)
        cells.append(nodes)
        forces.append(np.einsum("cq,qn,cqd->cnd", weight, values, -6.0 * at[..., ::-1] ** 2))
    return assembled(space, cells, forces)


def shear_force(space, name):
    """Forces of the tangential traction on a horizontal side. Collective."""
    cells, forces = [], []
    for facets in space.mesh.facet_groups.get(name, []):
        block = space.mesh.blocks[facets.block]
        xi, weights = quadrature("segment", 2 * space.degree + 4)
        corners = block.nodes[facets.cells][:, : CELLS[block.cell].n_vertices]
        x = np.ascontiguousarray(space.mesh.points[corners])
        at = facet_geometry(block.cell, x, facets.local, 1, space.degree, xi, weights)
        traction = np.zeros(at.points.shape)
        traction[..., 0] = 2.0 * (at.points**3).sum(axis=2) * at.normals[..., 1]
        cells.append(space.cells[facets.block][facets.cells])
        forces.append(np.einsum("fq,fqn,fqd->fnd", at.jxw, at.shape, traction))
    return assembled(space, cells, forces)


def l2_error(path, order, theta):
    """L2 error of the displacement relative to the norm of the exact one. Collective."""
    simulation = Simulation(beam_scene(path, order, theta))
    try:
        problem, space = simulation.problem, simulation.problem.space
        factor = amplitude(None, 1.0)
        forces = [body_force(space), shear_force(space, "top"), shear_force(space, "bottom")]
        problem.forces.loads += [(force, factor) for force in forces]
        problem.conditions.supports.values = lambda time: exact(space.points)[0]
        assert simulation.run()
        constants = [in_plane(*lame(E_MODULUS, NU), "plane_stress")]
        error = bulk_error(space, constants, simulation.stepper.u, exact)
        return error.displacement / error.displacement_of_exact
    finally:
        simulation.close()


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize(
    ("cell", "order"),
    [pytest.param("triangle", 1, marks=pytest.mark.parallel(2, 3)), ("quadrilateral", 1), ("triangle", 2)],
)
def test_l2_order(shared_tmp, cell, order, theta):
    errors = []
    for n in (1, 2, 4):
        path = shared_tmp / f"beam{n}.msh"
        on_root(WORLD, lambda path=path, n=n: beam(path, (20 * n, 4 * n), cell))
        errors.append(l2_error(path, order, theta))
    rates = -np.diff(np.log2(errors))
    assert rates[-1] >= 1.9 + (order - 1)
