"""Small decks, and what becomes of them."""

import numpy as np

from pcontact.importer.translate import import_file
from pcontact.runtime.petsc import MPI
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation

SELF = MPI.COMM_SELF
BRICK = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))


def bricks(*boxes, quadratic=False):
    """Cards of unit bricks, (foot, sides) each, with node numbers from 1, 101, ...: no nodes are shared."""
    nodes, elements = ["*NODE, NSET=NALL"], [f"*ELEMENT, TYPE={'C3D20' if quadratic else 'C3D8'}, ELSET=EALL"]
    for k, (foot, sides) in enumerate(boxes):
        corners = np.array(foot) + np.array(BRICK) * np.array(sides)
        points = np.vstack([corners, corners[np.array(EDGES)].mean(axis=1)]) if quadratic else corners
        nodes += [f"{100 * k + i}, {', '.join(f'{x:g}' for x in p)}" for i, p in enumerate(points, 1)]
        elements.append(f"{k + 1}, " + ",\n".join(", ".join(map(str, row)) for row in np.array_split(
            np.arange(100 * k + 1, 100 * k + 1 + len(points)), 2)))  # fmt: skip
    return "\n".join([*nodes, *elements])


STEEL = """
*MATERIAL, NAME=Steel
*ELASTIC
200000., 0.0
*SOLID SECTION, ELSET=EALL, MATERIAL=steel
"""
BLOCKS = (
    bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1)))
    + STEEL
    + """
*NSET, NSET=foot
1, 2, 3, 4
*NSET, NSET=sides
NALL,
*SURFACE, NAME=lower
1, S2
*SURFACE, NAME=upper
2, S1
*BOUNDARY
foot, 1, 3
sides, 1, 2
"""
)
PAIR = """
*SURFACE INTERACTION, NAME=si
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD
*FRICTION
0.25,
*CONTACT PAIR, INTERACTION=SI, TYPE=SURFACE TO SURFACE
upper, lower
"""


def imported(tmp_path, text):
    """Exit status, list, scene."""
    (tmp_path / "deck.inp").write_text(text)
    status = import_file(tmp_path / "deck.inp", tmp_path / "out")
    return status, (tmp_path / "out" / "import.txt").read_text(), read_scene(tmp_path / "out" / "scene.toml")


def solved(scene, probes=()):
    """The last load step, with the motion of groups."""
    scene.output.probes, scene.output.fields = probes, False
    scene.petsc = {"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}
    simulation = Simulation(scene, SELF)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation.records.data()["steps"]
