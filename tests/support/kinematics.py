"""Bodies in plane stress and with axial symmetry, solved directly."""

import numpy as np

from meshes.blocks import one_block
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
E, NU = 210e3, 0.3
INNER, OUTER, PRESSURE = 10.0, 20.0, 100.0
DIRECT = {"pc_type": "lu", "ksp_type": "preonly"}


def mesh(maker, path, *args, **more):
    """The path of a mesh that rank 0 makes. Collective."""
    on_root(WORLD, lambda: maker(path, *args, **more))
    return path


def solved(scene, look):
    """What ``look`` makes of a converged simulation. Collective."""
    simulation = Simulation(scene)
    try:
        assert simulation.run()
        return look(simulation)
    finally:
        simulation.close()


def nodal(simulation):
    """Displacement and position (n_local, d) of the nodes of this rank."""
    space = simulation.problem.space
    return space.local.gather(simulation.stepper.u), space.points


def cylinder(x, body=0, nu=NU):
    """Displacement (n, 2) and gradient (n, 2, 2) of the thick cylinder in the meridian plane, no axial strain."""
    r, part = x[:, 0], PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    a, b = (1 + nu) * (1 - 2 * nu) / E * part, (1 + nu) / E * part * OUTER**2
    u, slope = np.zeros_like(x), np.zeros((len(x), 2, 2))
    u[:, 0], slope[:, 0, 0] = a * r + b / r, a - b / r**2
    return u, slope


def strip(path, n, cell, order=1, nu=NU, **more):
    """Meridian section of the thick cylinder, held between two planes."""
    one_block_file = mesh(
        one_block, path, 2, (n, max(n // 5, 1)), cell, size=(OUTER - INNER, 2.0), lower=(INNER, 0.0)
    )
    return Scene(
        mesh=MeshSpec(one_block_file, order=order, kinematics="axisymmetric", **more),
        materials={"m": Material(E, nu)},
        bodies=[Body("block", "m")],
        displacements=[Displacement("bottom", ["free", 0.0]), Displacement("top", ["free", 0.0])],
        loads=[Load("left", pressure=PRESSURE)],
        output=Output(fields=False, probes=["left"]),
        petsc=DIRECT,
    )
