"""What must not matter: how nodes, cells and their vertices are numbered, handedness, direction and place.

Where the solution is unique, scenes that are images of each other agree to 1e-9 with tight tolerances.
"""

import numpy as np
import pytest
from images import image, mirror, scene_image, turn

from meshes import cylinder_on_block
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
TIGHT = {"snes_rtol": "1e-12", "ksp_rtol": "1e-10", "snes_ksp_ew": "false"}
SKINS = ("cylinder_skin", "block_top")
# seed of the numbering, and what the points are multiplied by
IMAGES = {
    "numbered anew": lambda d: (1, np.eye(d)),
    "mirrored": lambda d: (None, mirror(d)),
    "mirrored and numbered anew": lambda d: (2, mirror(d)),
    "turned and numbered anew": lambda d: (3, turn(d)),
    "turned and mirrored": lambda d: (4, turn(d) @ mirror(d)),
}


def press(path, contact, push, order=1, petsc=TIGHT):
    """A round body, its flat side pushed, on a block."""
    lu = {"pc_type": "lu"} if WORLD.size == 1 else {}
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"hard": Material(2.0, 0.25), "soft": Material(1.0, 0.3)},
        bodies=[Body("cylinder", "soft"), Body("block", "hard")],
        contacts=[contact],
        displacements=[Displacement("block_bottom", [0.0] * len(push)), Displacement("cylinder_flat", push)],
        output=Output(fields=False),
        petsc={**lu, **petsc},
    )


def solve(scene, comm=WORLD):
    """Displacement (n, d) of the nodes of the file, forces on bodies (m, d), largest pressures. *Collective.*"""
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run()
        space, u = simulation.problem.space, simulation.stepper.u
        parts = comm.allgather((space.mesh.file_nodes[space.mesh_nodes], space.local.gather(u)))
        nodes, u_nodes = (np.concatenate(part) for part in zip(*parts, strict=True))
        _, first = np.unique(nodes, return_index=True)
        sums = [item.summary(u) for item in simulation.problem.items if hasattr(item, "summary")]
        # with contact of all surfaces the force of the contact itself is a sum of magnitudes
        bodies = [sorted(s.get("bodies", [{"body": "", "force": s["force"]}]), key=lambda b: b["body"]) for s in sums]
        force = np.array([one["force"] for several in bodies for one in several])
        return u_nodes[first], force, np.array([s["max_pressure"] for s in sums])
    finally:
        simulation.close()


def differences(scene, folder, kinds=tuple(IMAGES), shift=0.0):
    """Largest relative differences between a scene and its images. *Collective.*

    Returns
    -------
    ndarray (3,)
        Of displacement, force and largest pressure.
    """
    u, force, pressure = solve(scene)
    d, worst = u.shape[1], np.zeros(3)
    for kind in kinds:
        (seed, matrix), shifts = IMAGES[kind](d), np.full(d, shift)
        path = folder / "image.msh"
        node = WORLD.bcast(on_root(WORLD, image, scene.mesh.file, path, seed, matrix, shifts))
        other_u, other_force, other_pressure = solve(scene_image(scene, path, matrix, shifts))
        # of middle nodes that only the displacement has, nobody knows the numbers
        pairs = [(other_u[node], u[: len(node)] @ matrix.T), (other_force, force @ matrix.T)]
        pairs.append((other_pressure, pressure))
        worst = np.maximum(worst, [np.abs(a - b).max() / np.abs(b).max() for a, b in pairs])
    return worst


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """Half a disk of radius 0.5 on a block."""
    folder = tmp_path_factory.mktemp("disk")
    return {cell: cylinder_on_block(folder / f"{cell}.msh", 0.1, cell=cell, radius=0.5, width=2.0, depth=1.0)
            for cell in ("triangle", "quadrilateral")}  # fmt: skip


PLANE = {
    "target curved": Contact(*SKINS[::-1]),
    "source curved": Contact(*SKINS),
    "unbiased": Contact(*SKINS, unbiased=True),
    "all": Contact(all=True),
    "friction": Contact(*SKINS[::-1], friction=0.3),
    "rays": Contact(*SKINS[::-1], search="ray_tracing"),
    "whole facets": Contact(*SKINS[::-1], cut=False),
}


@pytest.mark.parametrize("kind", list(PLANE))
def test_numbers_and_directions_do_not_matter_in_the_plane(tmp_path, disk, kind):
    scene = press(disk["triangle"], PLANE[kind], [0.002, -0.01])
    assert differences(scene, tmp_path).max() < 1e-9
