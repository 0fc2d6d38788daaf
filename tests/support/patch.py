"""Patch test of two stacked boxes."""

from drivers._common import make_mesh
from meshes import two_blocks
from pcontact.simulation import Simulation
from tests.support.small import DIMENSION


def solve(scene, measure):
    """What `measure` makes of a finished run; the run's options leave the database. Collective."""
    simulation = Simulation(scene)
    try:
        assert simulation.run()
        return measure(simulation)
    finally:
        simulation.close()


def blocks(folder, cell, n_lower, n_upper, **more):
    """Path of the mesh. Collective."""
    return make_mesh(two_blocks, folder / "blocks.msh", DIMENSION[cell], n_lower, n_upper, cell, **more)
