"""Scenes of bodies with inertia: a bar that hits a wall, blocks that collide in free flight, a block that slides."""

import numpy as np

from meshes import one_block, two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Dynamics,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Scene,
    Steps,
)

# the bar of length 10 and unit width, whose waves go at 30, that falls from the height 5 with the velocity 10
LENGTH, YOUNG, SPEED, HEIGHT, FALL = 10.0, 900.0, 30.0, 5.0, 10.0


def make(function, path, *args, **more):
    """A mesh that rank 0 writes. *Collective.*"""
    if MPI.COMM_WORLD.rank == 0:
        function(path, *args, **more)
    MPI.COMM_WORLD.Barrier()
    return path


def bar(folder, n, end, courant=0.5, gravity=0.0, velocity=-FALL, theta=None, **dynamics):
    """A bar in one direction that falls on a wall."""
    path = make(one_block, folder / f"bar{n}.msh", 2, (1, n), size=(1.0, LENGTH), lower=(0.0, HEIGHT))
    sides = [Displacement(side, [0.0, "free"]) for side in ("left", "right")]
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    weight = [Load("block", acceleration=[0.0, -gravity], amplitude=[(0, 1), (1, 1)])] if gravity else []
    return Scene(
        MeshSpec(path), {"m": Material(YOUNG, 0.0, density=1.0)},
        [Body("block", "m", initial_velocity=[0.0, velocity])],
        contacts=[Contact("bottom", obstacle=floor, name="wall", search_radius=2.0, theta=theta)],
        displacements=sides, loads=weight, steps=Steps(end, int(np.ceil(end * SPEED * n / LENGTH / courant))),
        output=Output(fields=False, probes=["bottom"]), dynamics=Dynamics(**dynamics),
    )  # fmt: skip


def string(folder, n, periods, courant=0.5, theta=None, **dynamics):
    """A bar that is held at its upper end, stretched, and let go, above a wall: it hits it in every period of 3."""
    path = make(one_block, folder / f"string{n}.msh", 2, (1, n))
    supports = [Displacement(side, [0.0, "free"]) for side in ("left", "right")] + [Displacement("top", [0.0, 0.0])]
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    return Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)},
        [Body("block", "m", initial_displacement=[0.0, "(1 - y)/2"])],
        contacts=[Contact("bottom", obstacle=floor, name="wall", search_radius=2.0, theta=theta)],
        displacements=supports, steps=Steps(3.0 * periods, round(3.0 * periods * n / courant)),
        output=Output(fields=False), dynamics=Dynamics(**dynamics),
    )  # fmt: skip


def collision(folder, dt, end, strain="finite", friction=0.3, dim=2, **dynamics):
    """A block that turns as it flies hits one that is at rest; nothing holds either."""
    path = make(two_blocks, folder / f"two{dim}.msh", dim, 3, 4 if dim == 2 else 2, heights=(1.0, 0.8), gap=0.15)
    velocity = ["0.5 - 0.4*(y - 1.55)", "-1 + 0.4*(x - 0.5)"]
    if dim == 3:
        velocity = ["0.5 - 0.4*(z - 1.55)", "0.1", "-1 + 0.4*(x - 0.5)"]
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(100.0, 0.3, density=1.0)},
        [Body("lower", "m"), Body("upper", "m", initial_velocity=velocity)],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", friction=friction, search="ray_tracing")],
        steps=Steps(end, round(end / dt)), output=Output(fields=False), dynamics=Dynamics(**dynamics),
    )  # fmt: skip


def slider(folder, velocity, friction, gravity, count, end):
    """A stiff block that rests on a plane under its weight, and then slides on it."""
    path = make(one_block, folder / "slider.msh", 2, 1)
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    return Scene(
        MeshSpec(path), {"m": Material(1e5, 0.3, density=1.0)},
        [Body("block", "m", initial_velocity=[velocity, 0.0])],
        contacts=[Contact("bottom", obstacle=floor, name="floor", friction=friction)],
        loads=[Load("block", acceleration=[0.0, -gravity])], phases=[Phase("rest"), Phase("slide", end, count)],
        output=Output(fields=False, probes=["bottom"]), dynamics=Dynamics(phases=["slide"]),
    )  # fmt: skip


def pulled(folder, n, value, amplitude=None, end=0.9, count=72, **dynamics):
    """A rod of length, wave speed and density 1 whose left end a support moves: until waves come back from its other
    end the support exerts the force v of a velocity v."""
    path = make(one_block, folder / f"pulled{n}.msh", 2, (n, 1))
    supports = [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    supports.append(Displacement("left", [value, "free"], amplitude))
    return Scene(
        MeshSpec(path), {"m": Material(1.0, 0.0, density=1.0)}, [Body("block", "m")], displacements=supports,
        steps=Steps(end, count), output=Output(fields=False), dynamics=Dynamics(**dynamics),
    )  # fmt: skip
