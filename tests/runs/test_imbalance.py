"""Balance of forces: none is missed where they balance each other, and load steps that are no solutions are told."""

import numpy as np
import pytest

import pcontact as pc
from drivers.studies._harness import solved
from meshes.blocks import two_blocks
from pcontact.runtime.petsc import MPI

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


def annulus(inner, outer, n=16):
    """Points and quadrilaterals of a closed ring, two of them across."""
    angles, radii = np.meshgrid(2.0 * np.pi * np.arange(n) / n, np.linspace(inner, outer, 3))
    at = (np.arange(2)[:, None] * n + np.arange(n)).ravel()
    after = (np.arange(2)[:, None] * n + (np.arange(n) + 1) % n).ravel()
    points = np.column_stack([(radii * np.cos(angles)).ravel(), (radii * np.sin(angles)).ravel()])
    return points, np.column_stack([at, at + n, after + n, after])


def shrunk():
    """A ring that is too large by a thousandth in another one; soft springs hold them, whose forces have no sum."""
    (points, cells), (more, around) = annulus(0.5, 1.001), annulus(1.0, 1.5)
    cells = np.concatenate([cells, around + len(points)])
    own = np.arange(len(cells)) < len(around)
    circles = {name: np.column_stack([first + np.arange(16), first + (np.arange(16) + 1) % 16])
               for name, first in (("hole", 0), ("skin", 32), ("seat", 48), ("rim", 80))}  # fmt: skip
    mesh = pc.mesh_from((np.concatenate([points, more]), {"quad": cells}), groups={"in": own, "out": ~own},
                        facets=circles)  # fmt: skip
    return pc.Scene(
        mesh=mesh, materials={"m": {"E": 1e5, "nu": 0.3}}, bodies=[pc.Body("in", "m"), pc.Body("out", "m")],
        contacts=[pc.Contact("skin", "seat", name="fit")],
        springs=[pc.Spring(name, per_area=[1e-3, 1e-3]) for name in ("hole", "rim")],
    )  # fmt: skip


@pytest.fixture
def blocks(shared_tmp):
    """One block above another one, without and with a gap."""
    paths = shared_tmp / "blocks.msh", shared_tmp / "gap.msh"
    if WORLD.rank == 0:
        two_blocks(paths[0], 2, 3, 2)
        two_blocks(paths[1], 2, 3, 2, gap=0.1)
    WORLD.Barrier()
    return paths


def pressed(path, **more):
    """The upper block is moved down, with friction, and up again."""
    return pc.Scene(
        mesh=pc.MeshSpec(path), materials={"m": {"E": 1e5, "nu": 0.3, "expansion": 1e-5}},
        bodies=[pc.Body("lower", "m"), pc.Body("upper", "m")],
        contacts=[pc.Contact("upper_bottom", "lower_top", name="pair", friction=0.3, search_radius=0.3)],
        displacements=[pc.Displacement("lower_bottom", [0, 0]),
                       pc.Displacement("upper_top", [0, -0.22], [[0, 0], [1, 1], [2, 0]])],
        steps=pc.Steps(2.0, 8), **more,
    )  # fmt: skip


def balance(scene, caplog):
    """Imbalances of the load steps, and whether a warning has said so."""
    caplog.clear()
    steps = pc.run(scene, comm=WORLD).steps
    told = WORLD.bcast(any("out of balance" in line for line in caplog.messages))
    return [step["imbalance"] for step in steps], told


@parallel(1, 2)
def test_forces_that_balance_each_other(blocks, caplog):
    """A shrink fit, blocks that do not touch yet and do no more, heated ones: nothing is out of balance."""
    heated = pressed(blocks[0], temperatures=[pc.Temperature("20 + x")])
    held = {"lower_bottom": ["free", 0], "upper_top": ["free", 1], "lower_left": [0, "free"], "upper_left": [0, "free"]}
    heated.displacements = [pc.Displacement(name, value) for name, value in held.items()]
    for scene in (shrunk(), pressed(blocks[1]), heated):
        imbalances, told = balance(scene, caplog)
        assert max(imbalances) < 1e-5 and not told


@parallel(1, 2)
def test_a_load_step_that_is_no_solution(blocks, caplog):
    """Newton's method is ended too early: a warning tells of it, also where what is left has no resultant."""
    for scene in (shrunk(), pressed(blocks[1])):
        # the few equations of the blocks would be solved exactly
        scene.petsc = {"snes_rtol": 0.3, "pc_type": "jacobi", "ksp_rtol": 0.3, "snes_ksp_ew": "false"}
        imbalances, told = balance(scene, caplog)
        assert told
    assert max(imbalances) > 1e-3


@parallel
@pytest.mark.parametrize("apart", [1e-12, 1e-4])
def test_bodies_that_move_and_do_not_touch_are_in_balance(blocks, caplog, apart):
    """What Newton's method leaves open is all that there is of forces; a motion that is wrong is told."""
    scene = pc.Scene(
        mesh=pc.MeshSpec(blocks[1]), materials={"m": {"E": 1e5, "nu": 0.3}},
        bodies=[pc.Body("lower", "m"), pc.Body("upper", "m")],
        contacts=[pc.Contact("upper_bottom", "lower_top", name="pair", search_radius=0.3)],
        displacements=[pc.Displacement("lower_bottom", [0, 0]), pc.Displacement("upper_top", [0, -0.05])],
        steps=pc.Steps(1.0, 1), output=pc.Output(fields=False),
    )  # fmt: skip
    with solved(scene) as (simulation, record):
        recorder, u, problem = simulation.stepper.recorder, simulation.stepper.u, simulation.problem
        u.setArray(u.getArray() + apart * np.random.default_rng(3).normal(size=u.getLocalSize()))
        caplog.clear()
        imbalance = recorder._imbalance(1.0, u, {**record, "reactions": {}}, problem.unbalanced(u))
    told = any("out of balance" in line for line in caplog.messages)
    assert (imbalance == 0.0 or told) and (WORLD.rank > 0 or told == (apart > 1e-6))
