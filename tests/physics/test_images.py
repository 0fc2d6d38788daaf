"""What must not matter: how nodes, cells and their vertices are numbered, handedness, direction and place.

Where the solution is unique, scenes that are images of each other agree to 1e-9 with tight tolerances.
"""

import numpy as np
import pytest

from meshes import ball_on_block, cylinder_on_block, two_blocks
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from tests.support.images import image, mirror, scene_image, turn

pytestmark = pytest.mark.slow
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


def press(path, contact, push, order=1, petsc=TIGHT, names=("cylinder", "cylinder_flat", "block", "block_bottom")):
    """A body pushed at its upper side and one held at its lower side."""
    lu = {"pc_type": "lu"} if WORLD.size == 1 else {}
    upper, pushed, lower, held = names
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"hard": Material(2.0, 0.25), "soft": Material(1.0, 0.3)},
        bodies=[Body(upper, "soft"), Body(lower, "hard")],
        contacts=[contact],
        displacements=[Displacement(held, [0.0] * len(push)), Displacement(pushed, push)],
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
        sums = [contact.summary(u) for contact in simulation.problem.contacts]
        # with contact of all surfaces the force of the contact itself is a sum of magnitudes
        bodies = [sorted(s.get("bodies", [{"body": "", "force": s["force"]}]), key=lambda b: b["body"]) for s in sums]
        force = np.array([one["force"] for several in bodies for one in several])
        return u_nodes[first], force, np.array([s["max_pressure"] for s in sums])
    finally:
        simulation.close()


def differences(scene, folder, kinds=tuple(IMAGES), shift=0.0):
    """Largest relative differences between a scene on one rank and its images on all. *Collective.*

    Returns
    -------
    ndarray (3,)
        Of displacement, force and largest pressure.
    """
    u, force, pressure = solve(scene, MPI.COMM_SELF)
    WORLD.Barrier()
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


def make_disk(path, cell="triangle", order=1):
    """Half a disk of radius 0.5 on a block. *Collective.*"""
    on_root(WORLD, lambda: cylinder_on_block(path, 0.1, order, cell, radius=0.5, width=2.0, depth=1.0))
    return path


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    return make_disk(tmp_path_factory.mktemp("disk") / "disk.msh")


PLANE = {
    "target curved": Contact(*SKINS[::-1]),
    "source curved": Contact(*SKINS),
    "unbiased": Contact(*SKINS, unbiased=True),
    "all": Contact(all=True),
    "friction": Contact(*SKINS[::-1], friction=0.3),
    "theta 1": Contact(*SKINS[::-1], theta=1.0),
    "rays": Contact(*SKINS[::-1], search="ray_tracing"),
    "whole facets": Contact(*SKINS[::-1], cut=False),
}


@pytest.mark.parametrize("kind", list(PLANE))
def test_numbers_and_directions_do_not_matter_in_the_plane(tmp_path, disk, kind):
    scene = press(disk, PLANE[kind], [0.002, -0.01])
    assert differences(scene, tmp_path).max() < 1e-9


BALL = ("ball", "ball_top", "block", "block_bottom")
BLOCKS = ("upper", "upper_top", "lower", "lower_bottom")
SPACE = {
    "cut, target curved": (Contact("block_top", "ball_skin", cut=True), 1),
    "cut, source curved": (Contact("ball_skin", "block_top", cut=True), 1),
    "unbiased": (Contact("ball_skin", "block_top", unbiased=True), 1),
    "degree 2": (Contact("block_top", "ball_skin"), 2),
    "friction": (Contact("block_top", "ball_skin", friction=0.3, cut=True), 1),
    "all": (Contact(all=True), 1),
}


def make_ball(path):
    """Half a ball on a block. *Collective.*"""
    on_root(WORLD, lambda: ball_on_block(path, 0.3, coarse=0.5))
    return path


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    return make_ball(tmp_path_factory.mktemp("ball") / "ball.msh")


@pytest.mark.parametrize("kind", list(SPACE))
def test_numbers_and_directions_do_not_matter_in_space(tmp_path, ball, kind):
    contact, order = SPACE[kind]
    scene = press(ball, contact, [0.003, 0.002, -0.02], order, names=BALL)
    assert differences(scene, tmp_path, ["mirrored and numbered anew", "turned and numbered anew"]).max() < 1e-9


def bulged(points):
    """Blocks whose sides, all of them, are curved."""
    x, y = points[:, :1] - 0.5, points[:, 1:2] - 0.5
    bent = np.sin(1.3 * y + 0.9 * x + [0.1, 0.7, 1.9])
    return points + 0.05 * bent + (x**2 + y**2) * np.array([0.0, 0.0, 0.1])


@pytest.mark.parametrize("unbiased", [False, True])
def test_numbers_and_directions_do_not_matter_on_hexahedra(tmp_path, unbiased):
    flat = two_blocks(tmp_path / "flat.msh", 3, 2, 3, "hexahedron")
    image(flat, tmp_path / "bulged.msh", change=bulged)
    scene = press(
        tmp_path / "bulged.msh", Contact("upper_bottom", "lower_top", cut=True, unbiased=unbiased), [0.01, 0.0, -0.05],
        names=BLOCKS,
    )  # fmt: skip
    assert differences(scene, tmp_path, ["mirrored and numbered anew", "turned and numbered anew"]).max() < 1e-9


@pytest.mark.parallel(2, 3)
def test_ranks_do_not_matter_either(shared_tmp):
    kinds = ["mirrored and numbered anew", "turned and numbered anew"]
    disk, ball = make_disk(shared_tmp / "disk.msh"), make_ball(shared_tmp / "ball.msh")
    plane = press(disk, PLANE["unbiased"], [0.002, -0.01])
    assert differences(plane, shared_tmp, kinds).max() < 1e-9
    space = press(ball, Contact("block_top", "ball_skin", cut=True, friction=0.3), [0.003, 0.002, -0.02], names=BALL)
    assert differences(space, shared_tmp, kinds).max() < 1e-9


@pytest.mark.parametrize("cell, order", [("triangle", 2), ("quadrilateral", 1)])
def test_with_default_tolerances(tmp_path, cell, order):
    """Friction, several load steps, curved sides where the degree is 2; cg and multigrid, a loose tolerance."""
    disk = make_disk(tmp_path / "disk.msh", cell, order)
    scene = press(disk, Contact(*SKINS[::-1], friction=0.3), [0.05, -0.02], order)
    scene.petsc, scene.steps.count = {}, 2
    assert differences(scene, tmp_path, ["mirrored and numbered anew", "turned and numbered anew"]).max() < 2e-5
