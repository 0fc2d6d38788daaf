"""Scenes of contact at finite motion whose supports follow any function of place and time."""

import numpy as np

from meshes.grid import add, lattice, name_boundary, near
from meshes.tools import gmsh_model, group, write
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.kinematics import mesh

WORLD = MPI.COMM_WORLD
SLOPE = 0.25


def turn(degrees):
    """Rotation in the plane."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


def _block(low, high, nx, ny, order, cell):
    """Cells between two lines y(x) over [0, 1]."""
    s, t = np.linspace(0.0, 1.0, order * nx + 1), np.linspace(0.0, 1.0, order * ny + 1)
    x, t = np.meshgrid(s, t, indexing="ij")
    y = (1.0 - t) * low(x) + t * high(x)
    return lattice(np.stack([x, y, np.zeros_like(x)], axis=-1), order, cell)


def slanted(path, n_lower=2, n_upper=4, order=1, cell="quadrilateral", slope=SLOPE, width=1.0):
    """Two blocks that meet at y = x / 4, the lower one of another width: groups lower, upper, lower_top, upper_bottom,
    and bottom, top, sides."""

    def line(x):
        return slope * x

    def meets(x):
        return np.abs(x[..., 1] - slope * x[..., 0]) < 1e-9

    with gmsh_model("slanted"):
        sides = []
        for name, side, low, high, n in (
            ("lower", "lower_top", lambda x: 0 * x - 1.0, line, n_lower),
            ("upper", "upper_bottom", line, lambda x: 0 * x + 1.0, n_upper),
        ):
            far = {"bottom": near(1, -1.0)} if name == "lower" else {"top": near(1, 1.0)}
            block = _block(low, high, n, 2, order, cell)
            block.points[:, 0] *= width if name == "lower" else 1.0
            grid = name_boundary(block, rest="sides", **{side: meets}, **far)
            body, tags = add(grid)
            group(2, name, [body])
            for key in (side, *far):
                group(1, key, [tags[key]])
            sides.append(tags["sides"])
        group(1, "sides", sides)
        return write(path)


def moved(scene, place, look=lambda simulation: None, observers=(), begin=lambda simulation: None, comm=WORLD):
    """What ``look`` makes of a simulation that converges, whose supports are at ``place(x, time)``. Collective."""
    simulation = Simulation(scene, comm)
    supports, points = simulation.problem.conditions.supports, simulation.problem.space.points
    supports.values = lambda time: np.where(supports.fixed, place(points, time) - points, 0.0)
    begin(simulation)
    try:
        assert simulation.run(None, observers)
        return look(simulation)
    finally:
        simulation.close()


def two(
    path, steps=1, materials=None, end=1.0, held=("bottom", "top", "sides"), strain="finite", order=None, **contact
):
    """The slanted blocks, Hencky unless they are told their materials, with contact of their interface."""
    said = {"source": "upper_bottom", "target": "lower_top", "name": "pair", **contact}
    lower, upper = (Material(1.0, 0.3), Material(1.0, 0.3)) if materials is None else materials
    return Scene(
        MeshSpec(path, strain="finite", order=order), {"l": lower, "u": upper},
        [Body("lower", "l"), Body("upper", "u")], contacts=[Contact(**said)],
        displacements=[Displacement(region, [0.0, 0.0]) for region in held],
        steps=Steps(end=end, count=steps), output=Output(fields=False),
        petsc={"snes_rtol": "1e-13", "pc_type": "lu", "ksp_type": "preonly"},
    )  # fmt: skip


__all__ = ["mesh", "moved", "slanted", "turn", "two"]
