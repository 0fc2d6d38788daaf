"""A displacement that no degree follows: a crack that opens."""

import gmsh
import numpy as np
import pytest

from drivers.error_norms import bulk_error
from meshes.tools import finish, gmsh_model, group, unstructured
from pcontact.adapt.effectivity import UNSEEN
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

E, NU = 10.0, 0.3
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def crack(x, _):
    """Displacement and gradient of a crack that opens: it ends at the origin, and x is ahead of it."""
    _, mu = lame(E, NU)
    r, half = np.hypot(x[:, 0], x[:, 1]), 0.5 * np.arctan2(x[:, 1], x[:, 0])
    sin, cos, kappa = np.sin(half), np.cos(half), 3.0 - 4.0 * NU
    u = np.sqrt(r)[:, None] / mu * np.column_stack([cos * (kappa - 1.0 + 2.0 * sin**2),
                                                    sin * (kappa + 1.0 - 2.0 * cos**2)])  # fmt: skip
    # u = sqrt(r) f(half): in polar coordinates u / (2 r) and f' / (2 sqrt(r))
    slope = np.column_stack([-sin * (kappa - 1.0 + 2.0 * sin**2) + 4.0 * sin * cos**2,
                             cos * (kappa + 1.0 - 2.0 * cos**2) + 4.0 * cos * sin**2])  # fmt: skip
    slope *= 0.5 / mu / np.sqrt(r)[:, None]
    along, across = x / r[:, None], np.column_stack([-x[:, 1], x[:, 0]]) / r[:, None]
    return u, u[:, :, None] / (2.0 * r)[:, None, None] * along[:, None] + slope[:, :, None] * across[:, None]


def half(path, cell):
    """Half of a square with a crack to its middle."""
    with gmsh_model("crack"):
        occ = gmsh.model.occ
        parts = [(2, occ.addRectangle(x, 0.0, 0.0, 1.0, 1.0)) for x in (-1.0, 0.0)]
        occ.fragment(parts[:1], parts[1:])
        occ.synchronize()
        group(2, "body", [tag for _, tag in gmsh.model.getEntities(2)])
        lines = {tag: np.array(occ.getCenterOfMass(1, tag)) for _, tag in gmsh.model.getEntities(1)}
        group(1, "ahead", [tag for tag, at in lines.items() if np.hypot(at[0] - 0.5, at[1]) < 0.1])
        group(1, "around", [tag for tag, at in lines.items() if at[1] > 0.1 and abs(at[0]) > 0.1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        unstructured(cell)
        return finish(path, 2, 1)


@pytest.mark.parametrize("cell, degree", [("triangle", 1), ("triangle", 2), ("quadrilateral", 2)])
def test_crack(tmp_path, cell, degree):
    """Estimate over error of a displacement that goes like the root of r: what no degree follows is missed in part, but
    not more than the safety factor of a mesh that none has been compared with."""
    mu = lame(E, NU)[1]
    r, angle, kappa = "sqrt(sqrt(x**2+y**2))", "(0.5*atan2(y,x))", 3.0 - 4.0 * NU
    prescribed = [f"{r}/{mu}*cos{angle}*({kappa - 1.0}+2*sin{angle}**2)",
                  f"{r}/{mu}*sin{angle}*({kappa + 1.0}-2*cos{angle}**2)"]  # fmt: skip
    scene = Scene(
        mesh=MeshSpec(half(tmp_path / "crack.msh", cell), order=degree),
        materials={"m": Material(E, NU)},
        bodies=[Body("body", "m")],
        displacements=[Displacement("ahead", ["free", 0.0]), Displacement("around", prescribed)],
        output=Output(fields=False, estimate=True),
        petsc=DIRECT,
    )

    simulation = Simulation(scene, MPI.COMM_SELF)
    try:
        assert simulation.run(None)
        error = bulk_error(simulation.problem.space, [lame(E, NU)], simulation.stepper.u, crack, 20).energy
        found = simulation.error_estimate.last["absolute"] / error
    finally:
        simulation.close()
    assert UNSEEN[2, degree][0] < found < 1.0
